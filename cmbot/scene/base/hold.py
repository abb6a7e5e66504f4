"""How the feet hold: the ``guardrail.hold:`` block, and the flat faces of members on which plates sit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, GetPydanticSchema, PlainSerializer, WrapValidator, model_validator

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.fields import Length
from cmbot.common.validation import FileModel, refusal, shown
from cmbot.elastic import AngleSection, Guardrail, Section
from cmbot.hold import Foot

Load = Annotated[float, Field(ge=1e-3, le=1e9)]
FACES = {
    "post": {"outer": (0, 1, 0), "inner": (0, -1, 0), "right": (1, 0, 0), "left": (-1, 0, 0)},
    "rail": {"outer": (0, 1, 0), "inner": (0, -1, 0), "top": (0, 0, 1), "bottom": (0, 0, -1)},
}
"""Faces of a member by their normals."""

# Members closer than this to the foot are those that it holds, m.
_SAME_PLACE = 1e-3


class HoldFile(FileModel):
    """How a foot holds; what is left out of its bounds is not checked."""

    kind: Literal["magnet", "clamp", "welded"]
    """``welded`` says nothing about whether it holds."""
    plate_m: tuple[Length, Length] = (0.15, 0.13)
    """Sides of the plate along the member and across it, m."""
    friction: Annotated[float, Field(ge=1e-3, le=10)] = 0.4
    """Between plate and steel."""
    safety: Annotated[float, Field(ge=1, le=100)] = 2.0
    """Safety factor on the load of the foot, or on the adhesion that it needs."""
    adhesion_n: Load | None = None
    """Of a magnet: the pull that takes it off, N, on this steel and with this paint; see docs/hold.md."""
    force_n: tuple[Load, Load, Load] | None = None
    """Of a clamp: the forces that it bears along the member, across it and out of the steel, N."""
    moment_nm: tuple[Load, Load, Load] | None = None
    """Of a clamp: the moments that it bears about these axes, Nm."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        of = {"adhesion_n": "magnet", "force_n": "clamp", "moment_nm": "clamp"}
        for name, kind in of.items():
            if getattr(self, name) is not None and self.kind != kind:
                raise refusal(f"no such key beside kind: {self.kind}", got=name, key=(name,))
        if (self.force_n is None) != (self.moment_nm is None):
            missing = "force_n" if self.force_n is None else "moment_nm"
            raise refusal("three numbers beside the other bound", got="nothing", key=(missing,))
        return self


def _one_or_more(value: Any, one: Any) -> tuple[HoldFile, ...]:
    """What `one` makes of a mapping, or of those of a list: one error, where a union would have several."""
    if isinstance(value, HoldFile | dict):
        return (one(_with_tuples(value)),)
    if not isinstance(value, list | tuple) or not 1 <= len(value) <= 2:
        raise refusal("how a foot holds, or a list of that for two feet", got=shown(value))
    return tuple(one(_with_tuples(item)) for item in value)


def _with_tuples(value: Any) -> Any:
    """A mapping with tuples for lists: past a validator pydantic no longer knows that it came from JSON."""
    if not isinstance(value, dict):
        return value
    return {key: tuple(item) if isinstance(item, list) else item for key, item in value.items()}


def _as_data(holds: Any) -> Any:
    data = [hold.model_dump(mode="json", exclude_none=True) for hold in holds]
    return data[0] if len(data) == 1 else data


def _json_schema(schema: Any, handler: Any) -> dict[str, Any]:
    one = handler(schema)
    # The mapping first: messages name its keys.
    return {"anyOf": [one, {"type": "array", "items": one, "minItems": 1, "maxItems": 2}]}


Holds = Annotated[
    tuple[HoldFile, ...],
    GetPydanticSchema(
        lambda _, handler: handler(
            Annotated[HoldFile, WrapValidator(_one_or_more), PlainSerializer(_as_data)]
        ),
        _json_schema,
    ),
]
"""How each foot holds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Face:
    """A side of a member, taken as flat where the member is an angle.

    Attributes
    ----------
    axes : (3, 3)
        Rows in W: along the member, across it, out of the steel.
    depth : float, m
        From the member's axis to the face.
    width : float or None, m
        Of the flat part; None: a round bar.
    ends : two floats, m
        Along the member, as its coordinate in W.
    """

    axes: FloatArray
    depth: float
    width: float | None
    ends: tuple[float, float]


def face_of(guardrail: Guardrail, member: str, face: str) -> Face:
    """Return a face of a member, by the member's name and that of the face in `FACES`.

    Parameters
    ----------
    guardrail : Guardrail
        That has the member.
    member, face : str
    """
    posts = {f"post_{number}": x for number, x in enumerate(guardrail.post_positions, start=1)}
    if member in posts:
        section, along = guardrail.post.section, (0, 0, 1)
        ends = (guardrail.post.bottom, guardrail.post.top)
    else:
        (section,) = (rail.section for rail in guardrail.rails if rail.name == member)
        along, ends = (1, 0, 0), (guardrail.post_positions[0], guardrail.post_positions[-1])
    normal = FACES["post" if member in posts else "rail"][face]
    depth, width = _half_and_width(section)
    return Face(axes=_axes(along, normal), depth=depth, width=width, ends=ends)


@cache
def _axes(along: tuple[int, int, int], normal: tuple[int, int, int]) -> FloatArray:
    return read_only(np.array([along, np.cross(normal, along), normal], dtype=float))


def _half_and_width(section: Section) -> tuple[float, float | None]:
    if isinstance(section, AngleSection):
        return section.leg / 2, section.leg
    return section.diameter / 2, None


def foot_on(face: Face, at: FloatArray, hold: HoldFile, foot_point: FloatArray, share: FloatArray) -> Foot:
    """Return the foot whose plate is centred on a face; its contact is what lies on the face.

    Parameters
    ----------
    face : Face
    at : (3,), m
        On the member's axis, in W.
    hold : HoldFile
    foot_point : (3,), m
        O0 in W.
    share : (6, 6)
        Of the whole wrench about O0.
    """
    along, _, out = face.axes
    place = float(along @ at)
    low, high = (np.clip(place + side * hold.plate_m[0] / 2, *face.ends) - place for side in (-1, 1))
    half = None
    if face.width is not None:
        half = (float(high - low) / 2, min(hold.plate_m[1], face.width) / 2)
    else:
        low = high = 0.0
    return Foot(
        kind=hold.kind,
        centre=read_only(at - foot_point + face.depth * out + float(low + high) / 2 * along),
        axes=face.axes,
        half=half,
        friction=hold.friction,
        safety=hold.safety,
        adhesion=hold.adhesion_n,
        force=hold.force_n,
        moment=hold.moment_nm,
        share=read_only(share),
    )


def held_member(guardrail: Guardrail) -> str | None:
    """Return the member that the foot holds at the origin of W; None without one."""
    for number, x in enumerate(guardrail.post_positions, start=1):
        if abs(x) <= _SAME_PLACE:
            return f"post_{number}"
    if not guardrail.post_positions:
        return None
    return next((rail.name for rail in guardrail.rails if abs(rail.height) <= _SAME_PLACE), None)
