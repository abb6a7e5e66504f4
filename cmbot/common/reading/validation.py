"""Data from files and arguments from Python become checked objects, or one error that names the key."""

from __future__ import annotations

import difflib
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError, create_model
from pydantic_core import ErrorDetails, PydanticCustomError

from cmbot.common.errors import InputError
from cmbot.common.representation import fields_repr

T = TypeVar("T")

# Letters of a part by which a choice is found, and what close words have in common: more than three of five.
_LEAST_PART, _LEAST_ALIKE = 4, 0.62
# What others call what a file has.
_SYNONYMS: Mapping[str, str] = {"urdf": "model", "pos": "xyz", "position": "xyz"}
# Keys of a mapping that a message names.
_NAMED_KEYS = 3
_MAX_SHOWN_CHARACTERS = 60
_PLAIN_KEY = re.compile(r"[\w.\-]{1,60}")
_REFUSAL_TYPE = "refusal"
_UNKNOWN_KEY_TYPES = ("extra_forbidden", "unexpected_keyword_argument")
_LENGTH_TYPES = ("missing", "too_long", "too_short", "tuple_type", "list_type")
_PHRASES = {
    "missing": "a value, this key is required",
    "bool_type": "true or false",
    "string_type": "text",
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_parsing_size": "a smaller whole number",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a mapping of keys to values",
    "model_type": "a mapping of keys to values",
    "dataclass_type": "a mapping of keys to values",
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "less than {lt:g}",
    "less_than_equal": "at most {le:g}",
    "too_short": "a list of {min_length} or more items",
    "too_long": "a list of at most {max_length} items",
    "string_too_short": "text of {min_length} or more characters",
    "string_too_long": "text of at most {max_length} characters",
    "json_invalid": "valid text and a depth that a file of this format can have ({error})",
}
# What files of cmbot are, by what their formats begin with.
_FORMATS = {
    "cmbot-scene": "a scene",
    "cmbot-campaign": "a campaign",
    "cmbot-measurements": "a sheet of measurements",
    "cmbot-stiffness": "an identified stiffness",
    "cmbot-joint-limits": "a file of joint limits",
    "cmbot-elasticity": "a file of elasticity",
    "cmbot-plan": "part of a plan directory",
    "cmbot-tracking": "part of a plan directory",
    "cmbot-walk": "part of a walk's folder",
    "cmbot-tour": "part of a tour's folder",
}


class FileModel(BaseModel):
    """Base of every model of a file: strict, closed, frozen, finite."""

    # A validator is built when it is first asked for: most commands need a few of all models.
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    def model_post_init(self, context: Any, /) -> None:
        """Check it: a validator of the model would be named in messages about unions."""
        self._check()

    def _check(self) -> None:
        """Refuse values that do not go together."""

    def __repr__(self) -> str:
        """Its name and what was set, shortly."""
        return fields_repr(type(self).__name__, {name: getattr(self, name) for name in self.model_fields_set})

    def changed(self, **values: object) -> Self:
        """Return it with other values of some fields, the whole checked anew as if it were read from a file.

        Parameters
        ----------
        **values
            By the names of the fields; None takes the default. Arrays and other dataclasses are taken, too.

        Raises
        ------
        InputError
        """
        name = type(self).__name__
        return validated(type(self), self._changed_data(values, name), name, InputError)

    def _changed_data(self, values: Mapping[str, object], source: str) -> dict[str, Any]:
        """The content of its file with other values of some fields."""
        data = self.model_dump(mode="json", exclude_none=True, by_alias=True)
        keys = {name: field.alias for name, field in type(self).model_fields.items()}
        changes = {keys.get(name) or name: value for name, value in values.items()}
        data |= {key: plain(value, source, (key,)) for key, value in changes.items()}
        return {key: value for key, value in data.items() if value is not None}


def validated(
    model: type[T],
    data: object,
    source: str,
    error_type: type[InputError],
    context: Mapping[str, object] | None = None,
) -> T:
    """Return `data` as a checked `model`.

    Parameters
    ----------
    model : type
        A pydantic model, or a dataclass with ``__pydantic_config__``.
    data : object
        Plain mappings, lists, text, numbers; as read from a file.
    source : str
        The file or argument it came from, for messages.
    error_type : type
        What to raise: `SceneError`, `ModelError`, …
    context : mapping, optional
        What validators of the model are told.

    Raises
    ------
    InputError
        Of `error_type`, for the first thing that is wrong.
    """
    try:
        # Through JSON, because strict mode then takes a list for a tuple and 1 for 1.0, and nothing looser.
        text = json.dumps(data)
    except (TypeError, ValueError, RecursionError) as error:
        expected = "plain text, numbers, lists and mappings, not nested too deeply"
        raise error_type(source, "", f"something else ({error})", expected) from error
    try:
        checked: T = adapter(model).validate_json(text, context=context)  # type: ignore[arg-type]
    except ValidationError as error:
        raise input_error(source, error, error_type, model) from error
    return checked


@cache
def adapter(model: Any) -> TypeAdapter[Any]:
    """Return what reads and writes a type; making it takes some milliseconds."""
    if issubclass(model, BaseModel):
        # The adapter then takes the model's own validator, which its instances need anyway.
        model.model_rebuild()
    return TypeAdapter(model)


@cache
def _schema(model: Any) -> dict[str, Any]:
    return adapter(model).json_schema()


def check_fields(instance: object) -> None:
    """Check the fields of a dataclass's instance by the bounds in their annotations.

    Raises
    ------
    InputError
        With the name of the class as its source.
    """
    kind: Any = type(instance)
    source, model = kind.__name__, _fields_model(kind)
    data = {name: plain(getattr(instance, name), source, (name,)) for name in model.model_fields}
    validated(model, data, source, InputError)


class CheckedFields:
    """Base of frozen dataclasses whose fields are checked by `check_fields`, in files and in Python."""

    __pydantic_config__: ClassVar[ConfigDict] = FileModel.model_config

    def __post_init__(self) -> None:
        check_fields(self)
        self._check()

    def _check(self) -> None:
        """Refuse values that do not go together."""


@cache
def _fields_model(kind: Any) -> type[BaseModel]:
    """A model of a dataclass's fields: it makes no instance, which would check its fields again."""
    hints = get_type_hints(kind, include_extras=True)
    definitions: Any = {field.name: (hints[field.name], ...) for field in fields(kind)}
    return create_model(kind.__name__, __config__=FileModel.model_config, **definitions)


def checked_options(model: type[T], options: object, source: str) -> T:
    """Return options, a dataclass with ``__pydantic_config__``, when each is within its bounds.

    Raises
    ------
    InputError
        `options` are of another type, or one of them is wrong.
    """
    require_type(options, model, source, "", f"an instance of {model.__name__}")
    return validated(model, plain(options, source), source, InputError)


def require_type(value: object, kind: type | tuple[type, ...], source: str, key: str, expected: str) -> None:
    """Refuse a value of another type; `source` is what it was passed to, `key` the argument.

    Raises
    ------
    InputError
    """
    if not isinstance(value, kind):
        got = shown(value) if isinstance(value, str | int | float) else type(value).__name__
        raise InputError(source, key, got, expected)


def given_path(value: object, source: str, key: str, expected: str) -> Path:
    """Return a path from an argument.

    Raises
    ------
    InputError
        When it is neither text nor a path.
    """
    require_type(value, (str, Path), source, key, expected)
    return Path(value)  # type: ignore[arg-type]


def plain(value: object, source: str, steps: Sequence[str | int] = ()) -> Any:
    """Return paths, arrays and dataclasses as a file would hold them: text, lists, numbers, mappings.

    Raises
    ------
    InputError
        When something in `value` is none of these; `source` and `steps` name its place.
    """
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist(), source, steps)
    if isinstance(value, tuple | list):
        return [plain(item, source, (*steps, k)) for k, item in enumerate(value)]
    if isinstance(value, BaseModel):
        value = value.model_dump(by_alias=True, exclude_none=True)
    if is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item, source, (*steps, str(key))) for key, item in value.items()}
    raise InputError(source, key_path(steps), shown(value), "text, a number or a list of them")


def input_error(source: str, error: ValidationError, error_type: type[InputError], model: Any) -> InputError:
    """Return the one error to raise for those that pydantic found against `model`."""
    detail = _most_telling(error.errors(include_url=False))
    kind, context, schema = detail["type"], detail.get("ctx", {}), _schema(model)
    # Without the models that pydantic names between alternatives.
    loc = tuple(step for step in detail["loc"] if step not in schema.get("$defs", ()))
    if kind == _REFUSAL_TYPE:
        key = key_path((*loc, *context["key"]))
        return error_type(source, key, context["got"], context["expected"], context["choices"])
    if kind == "value_error" and isinstance(context.get("error"), InputError):
        # Of a dataclass, which checks itself in Python, too.
        found = context["error"]
        key = ".".join(filter(None, (key_path(loc), found.key)))
        return error_type(source, key, found.got, found.expected, found.choices)
    if kind in _UNKNOWN_KEY_TYPES:
        keys = tuple(_schema_at(schema, loc[:-1]).get("properties", {}))
        expected = f"a known key{hint(loc[-1], keys)}"
        return error_type(source, key_path(loc), "an unknown key", expected, keys)
    if kind == "missing" and isinstance(loc[-1], str):
        node = _schema_at(schema, loc)
        allowed = tuple(filter(None, node.get("enum", [node.get("const")])))
        return error_type(source, key_path(loc), "nothing", _PHRASES[kind], allowed)
    if kind == "missing":  # a list of fixed length that ends too early
        loc = loc[:-1]
    node, got = _schema_at(schema, loc), shown(detail["input"])
    choices: tuple[str, ...] = ()
    other = ""
    if kind == "literal_error":
        choices = tuple(str(choice) for choice in node.get("enum", ()))
        known = f"a known value{hint(detail['input'], choices)}"
        expected = known if choices else repr(node.get("const"))
        if loc == ("format",) and (other := _other_kind(detail["input"], choices or (node.get("const"),))):
            got = f"{_FORMATS[other]} ({detail['input']})"
            expected, choices = " or ".join(choices) or str(node.get("const")), ()
    elif kind in _LENGTH_TYPES and node.get("minItems", 0) == node.get("maxItems"):
        expected = f"a list of {node['maxItems']} items"
    elif kind in _PHRASES:
        expected = _PHRASES[kind].format(**context) + _form(schema, node, kind)
        if kind == "too_long" and isinstance(detail["input"], list):
            got = counted(len(detail["input"]), "item")
    else:
        expected = f"something else ({detail['msg']})"
    if kind == "json_invalid":
        got = "text that cannot be read"
    found = error_type(source, key_path(loc), got, expected, choices)
    found.holds = other
    return found


def refusal(
    expected: str, *, got: object, key: Sequence[str | int] = (), choices: Sequence[str] = ()
) -> PydanticCustomError:
    """Return what a validator of cmbot raises, which becomes an `InputError`.

    Parameters
    ----------
    expected : str
        What should stand there.
    got : object
        What stands there; text is taken as a phrase, anything else is shown as a value.
    key : sequence of str or int
        Steps from the validated object to the value; empty for the object itself.
    choices : sequence of str
        The valid values, when they can be listed.
    """
    context = {
        "expected": expected,
        "got": got if isinstance(got, str) else shown(got),
        "key": tuple(key),
        "choices": tuple(choices),
    }
    return PydanticCustomError(_REFUSAL_TYPE, "expected {expected}", context)


def key_path(steps: Sequence[str | int]) -> str:
    """Return steps into nested data as people write them: ``tool_path.legs[1].seconds``."""
    path = ""
    for step in steps:
        if isinstance(step, int):
            path += f"[{step}]"
        else:
            name = step if _PLAIN_KEY.fullmatch(step) else shown(step)
            path += f".{name}" if path else name
    return path


def require_unique_keys(content: bytes | str, source: str, error: type[InputError]) -> None:
    """Refuse JSON in which an object has a key twice: readers differ in which of two they take."""

    def once(pairs: list[tuple[str, object]]) -> None:
        twice = [name for name, count in Counter(name for name, _ in pairs).items() if count > 1]
        if twice:
            raise error(source, key_path(twice[:1]), "a key that is there twice", "each key once")

    json.loads(content, object_pairs_hook=once)


def shown(value: object) -> str:
    """Return a value as one short line."""
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN_CHARACTERS else f"{text[: _MAX_SHOWN_CHARACTERS - 2]}…{text[-1]}"


def counted(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun, as in ``1 joint``, ``2 joints``; `plural` where it is no s."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def hint(word: object, choices: Sequence[str]) -> str:
    """Return ``; did you mean X?`` where a choice is close to `word` or has it, otherwise nothing."""
    text = _SYNONYMS.get(str(word), str(word))
    close = difflib.get_close_matches(text, choices, n=1, cutoff=_LEAST_ALIKE)
    if not close and len(text) >= _LEAST_PART:
        # Of those that have it, the one that begins with it.
        close = sorted((each for each in choices if text in each), key=lambda each: each.find(text))
    return f"; did you mean {close[0]}?" if close else ""


def _other_kind(format_: object, known: Sequence[object]) -> str:
    """What the format of a file begins with that is another than the known ones; empty where it is none."""
    kind = str(format_).partition("/")[0]
    return kind if kind in _FORMATS and not any(str(each).startswith(f"{kind}/") for each in known) else ""


def _most_telling(errors: list[ErrorDetails]) -> ErrorDetails:
    """The first error; where it is a missing key, an unknown one beside it comes first."""
    first = errors[0]
    if first["type"] == "missing":
        for other in errors:
            if other["type"] in _UNKNOWN_KEY_TYPES and other["loc"][:-1] == first["loc"][:-1]:
                return other
    return first


def _schema_at(schema: dict[str, Any], loc: Sequence[str | int]) -> Mapping[str, Any]:
    """The part of a JSON Schema that describes the value at `loc`; empty where there is none."""
    node = resolved(schema, schema)
    for step in loc:
        if isinstance(step, str):
            others = node.get("additionalProperties")
            node = node.get("properties", {}).get(step, others if isinstance(others, dict) else {})
        else:
            fixed = node.get("prefixItems", [])
            node = fixed[step] if step < len(fixed) else node.get("items", {})
        node = resolved(schema, node)
    return node


def _form(schema: dict[str, Any], node: Mapping[str, Any], kind: str) -> str:
    """What a list has, and some keys of a mapping, in words; empty of other kinds of values."""
    is_list = _PHRASES[kind] == "a list"
    keys = list((resolved(schema, node.get("items", {})) if is_list else node).get("properties", {}))
    named = f", with keys such as {', '.join(keys[:_NAMED_KEYS])}"
    return (" of mappings" if is_list else "") + named if keys else ""


def resolved(schema: Mapping[str, Any], node: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what a node of a JSON Schema is: references followed, and of "this or null" this."""
    while True:
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rsplit("/", 1)[-1]]
        elif "anyOf" in node:
            node = next(branch for branch in node["anyOf"] if branch.get("type") != "null")
        else:
            return node
