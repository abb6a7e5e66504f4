"""Types of values that several parts of the scene file share, and the rule for the units in its keys."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetPydanticSchema,
    PlainSerializer,
    ValidationInfo,
    WithJsonSchema,
    WrapSerializer,
    WrapValidator,
)

from cmbot.common.errors import InputError
from cmbot.common.reading.input_files import is_file, is_folder
from cmbot.common.reading.validation import FileModel, hint, refusal, shown

SHORTEST_LEG = 1e-6
"""m."""

# No part of a robot is larger, m.
_LARGEST_PART_M = 10.0
# Nothing that bends is thicker or longer, m, or softer, Pa: such numbers are in mm and N/mm2.
_THICKEST_M, _THICKEST_WALL_M, LONGEST_TUBE_M, _SOFTEST_PA, _MOST_GPA = 4.0, 0.5, 50.0, 1e6, 1e3
MILLIMETRES = "metres: millimetres"
"""What `no_thousands` asks of too long a length, m."""
SHORTEST, LONGEST = 1e-6, 1e4
"""Bounds of a length, m: they catch some millimetres given for metres, and keep every power finite."""

FOLDER = "folder"
"""In the context of a validation the folder at which relative paths start; without one they stay."""
MESH_FORMATS = ("glb", "obj", "off", "ply", "stl")
"""Of mesh files: those that trimesh reads without further packages."""

# Axes are unit vectors up to what people round.
_UNIT_LENGTH_TOLERANCE = 1e-2
_SLUG = re.compile(r"[A-Za-z0-9][A-Za-z0-9_\-]{0,99}")
_UNIT_SUFFIX = re.compile("_(deg|hz|kg_m3|kg|m|pa)$")


def _slug(text: str) -> str:
    if not _SLUG.fullmatch(text):
        expected = "1 to 100 letters, digits, - and _, beginning with a letter or digit"
        raise refusal(expected, got=shown(text))
    return text


def _long_enough(by: Vector) -> Vector:
    if max(map(abs, by)) < SHORTEST_LEG:
        raise refusal("a leg longer than a micrometre", got=by)
    return by


def _unit_vector(axis: Vector) -> Vector:
    if abs(math.hypot(*axis) - 1.0) > _UNIT_LENGTH_TOLERANCE:
        raise refusal("a unit vector", got=axis)
    return axis


def is_mesh_file(text: str) -> bool:
    """Whether a text is the path of a mesh file by its ending, not the name of an obstacle."""
    return Path(text).suffix.lower().removeprefix(".") in MESH_FORMATS


def place_of(text: str, info: ValidationInfo) -> Path | None:
    """Return where a file is that is named in a scene; None where it is not sought."""
    if info.data.get("model") == "cmbot":
        return None  # beside the shipped robot there is none: `RobotFile` says so
    folder = (info.context or {}).get(FOLDER)
    return None if folder is None else folder / text


def _existing(text: str, info: ValidationInfo, is_there: Callable[[Path], bool], kind: str) -> str:
    path = place_of(text, info)
    if path is None:
        return text
    if not is_there(path):
        raise refusal(f"{kind} that exists (relative to the scene file)", got=shown(text))
    return str(path.resolve())


def existing_file(text: str, info: ValidationInfo) -> str:
    """Return the absolute path of a file; refuse one that does not exist."""
    return _existing(text, info, is_file, "a file")


def _folder(text: str, info: ValidationInfo) -> str:
    return _existing(text, info, is_folder, "a folder")


def _mesh_name(text: str, info: ValidationInfo) -> str:
    return existing_file(text, info) if is_mesh_file(text) else text


def _in_pascals(modulus: float) -> float:
    if modulus < _SOFTEST_PA:
        told = f"GPa? then {modulus:g}e+9" if modulus < _MOST_GPA else f"N/mm2? then {modulus:g}e+6"
        raise refusal(f"Pa: {told}", got=modulus)
    return modulus


def no_thousands(most: float, units: str) -> AfterValidator:
    """Return what refuses numbers that are larger, with their thousandths and the `units` meant."""

    def checked(value: Any) -> Any:
        each = value if isinstance(value, tuple) else (value,)
        if max(map(abs, each)) > most:
            less = ", ".join(f"{number / 1000:g}" for number in each)
            raise refusal(f"{units}? then {f'[{less}]' if each is value else less}", got=value)
        return value

    return AfterValidator(checked)


def require_tube(start: Sequence[float], end: Sequence[float], diameter: float, wall: float) -> None:
    """Refuse a tube with a wall that it has no room for, or with ends as far apart as if in millimetres."""
    if 2 * wall > diameter:
        thinner = f"; millimetres? then {wall / 1000:g}" if wall >= _THICKEST_WALL_M else ""
        raise refusal(f"at most half of outer_diameter_m{thinner}", got=wall, key=("wall_m",))
    if math.dist(start, end) > LONGEST_TUBE_M:
        key, far = max(("start_m", start), ("end_m", end), key=lambda each: math.hypot(*each[1]))
        metres = ", ".join(f"{x / 1000:z.6g}" for x in far)
        raise refusal(f"metres: millimetres? then [{metres}]", got=far, key=(key,))


Length = Annotated[float, Field(ge=SHORTEST, le=LONGEST)]
Thickness = Annotated[float, Field(ge=1e-5, le=LONGEST), no_thousands(_THICKEST_M, MILLIMETRES)]
"""Of a tube, a bar or a leg, m."""
Modulus = Annotated[float, Field(gt=0, le=1e13), AfterValidator(_in_pascals)]
Coordinate = Annotated[float, Field(ge=-LONGEST, le=LONGEST)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
IN_REACH = no_thousands(_LARGEST_PART_M, MILLIMETRES)
"""Of what is fixed to a robot, or holds it."""
Sides = Annotated[tuple[Length, Length], IN_REACH]
"""Of a part of a robot, m."""
Place = Annotated[Vector, IN_REACH]
"""On a link or a tool, m."""
Site = Annotated[Vector, no_thousands(LONGEST_TUBE_M, MILLIMETRES)]
"""On a workpiece, or where the tool touches it, m."""
LongVector = Annotated[Vector, AfterValidator(_long_enough)]
UnitVector = Annotated[Vector, AfterValidator(_unit_vector)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Angles = tuple[Angle, Angle, Angle]
Mass = Annotated[float, Field(ge=0, le=1e4)]
Text = Annotated[str, Field(min_length=1, max_length=4096)]
Posture = Annotated[tuple[Coordinate, ...], Field(min_length=1, max_length=100)]
Slug = Annotated[
    str, AfterValidator(_slug), WithJsonSchema({"type": "string", "pattern": f"^{_SLUG.pattern}$"})
]
FilePath = Annotated[Text, AfterValidator(existing_file)]
"""Of a file, relative to the scene file; in a scene that is read absolute."""
FolderPath = Annotated[Text, AfterValidator(_folder)]
"""Of a folder, likewise."""
MeshName = Annotated[Text, AfterValidator(_mesh_name)]
"""The path of a mesh file, likewise, or the name of an obstacle."""


def given_of(entry: object, names: Sequence[str]) -> list[str]:
    """Return those of the keys `names` that an entry of a file gives."""
    return [name for name in names if getattr(entry, name) is not None]


def exactly_one(entry: object, names: Sequence[str]) -> None:
    """Refuse an entry of a file, or a dataclass, that gives none or several of the keys `names`."""
    given = given_of(entry, names)
    if len(given) != 1:
        got = " and ".join(given) or "none"
        raise InputError(type(entry).__name__, "", got, "exactly one of these keys", tuple(names))


def _one_of_schema(schema: dict[str, Any], model: type[OneOf]) -> None:
    """Add `exactly_one` to a JSON Schema; a null counts as not given."""
    given = {"not": {"type": "null"}}
    schema["oneOf"] = [{"required": [name], "properties": {name: given}} for name in model.one_of]


class OneOf(FileModel):
    """An entry of a file that gives exactly one of some keys."""

    model_config = ConfigDict(json_schema_extra=_one_of_schema)

    one_of: ClassVar[tuple[str, ...]] = ()

    def _check(self) -> None:
        exactly_one(self, self.one_of)

    @property
    def given(self) -> str:
        """The key that is given."""
        return given_of(self, self.one_of)[0]


def read_as(kind: Any, words: Sequence[str] = ()) -> GetPydanticSchema:
    """Return what checks and writes a type as files have it, as a `kind` or as one of some `words`."""
    if not words:
        return GetPydanticSchema(lambda _, handler: handler(kind))
    # The kind first: messages name its keys.
    return GetPydanticSchema(
        lambda _, handler: handler(kind),
        lambda schema, handler: {"anyOf": [handler(schema), {"enum": list(words), "type": "string"}]},
    )


def mapping_of(names: Any, values: Any) -> GetPydanticSchema:
    """Return what reads and writes a mapping, which is kept as pairs: they have a hash."""
    return read_as(
        Annotated[
            dict[names, values],
            Field(max_length=100),
            AfterValidator(lambda mapping: tuple(sorted(mapping.items()))),
            WrapSerializer(lambda pairs, handler: handler(dict(pairs))),
        ]
    )


def word_or(words: Sequence[str], model: type[BaseModel], example: str) -> GetPydanticSchema:
    """Return what makes of a type one of `words` or a `model`, such as the `example` in a message.

    There is one error for what is neither, where a union would have several.
    """

    def checked(value: Any, of_model: Any) -> Any:
        if isinstance(value, str) and value in words:
            return value
        if isinstance(value, dict | model):
            return of_model(value)
        raise refusal(f"a known value{hint(value, words)}", got=shown(value), choices=(*words, example))

    def as_data(kept: Any) -> Any:
        return kept if isinstance(kept, str) else kept.model_dump()

    return read_as(Annotated[model, WrapValidator(checked), PlainSerializer(as_data)], words)


def si_fields(model: BaseModel) -> dict[str, Any]:
    """Return a file model's values by their names without the unit, angles in radians."""
    values = {}
    for name in type(model).model_fields:
        value = getattr(model, name)
        if name.endswith("_deg"):
            value = tuple(map(math.radians, value)) if isinstance(value, tuple) else math.radians(value)
        values[_UNIT_SUFFIX.sub("", name)] = value
    return values
