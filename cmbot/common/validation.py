"""From data of unknown origin to a checked object, or to one error that names the key."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Sequence
from functools import cache
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from cmbot.common.errors import InputError

__all__ = ["FileModel", "counted", "hint", "input_error", "key_path", "refusal", "shown", "validated"]

T = TypeVar("T")

_LONGEST_SHOWN = 60
_PLAIN_KEY = re.compile(r"[\w.\-]{1,60}")
_REFUSAL = "refusal"
_UNKNOWN_KEY = frozenset({"extra_forbidden", "unexpected_keyword_argument"})
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


class FileModel(BaseModel):
    """Base of every model of a file: strict, closed, frozen, finite."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def validated(model: type[T], data: object, source: str, error_type: type[InputError]) -> T:
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
        checked: T = _adapter(model).validate_json(text)  # type: ignore[arg-type]
    except ValidationError as error:
        raise input_error(source, error, error_type, model) from error
    return checked


@cache
def _adapter(model: Any) -> TypeAdapter[Any]:
    return TypeAdapter(model)


def input_error(source: str, error: ValidationError, error_type: type[InputError], model: Any) -> InputError:
    """Return the one error to raise for a pydantic `ValidationError`.

    Parameters
    ----------
    source : str
        The file or argument that was validated.
    error : ValidationError
        What pydantic found.
    error_type : type
        The type of the result.
    model : type
        What was validated against; its JSON Schema tells which keys and values there are.
    """
    detail = _most_telling(error.errors(include_url=False))
    loc, kind, context = detail["loc"], detail["type"], detail.get("ctx", {})
    schema = TypeAdapter(model).json_schema()
    if kind == _REFUSAL:
        key = key_path((*loc, *context["key"]))
        return error_type(source, key, context["got"], context["expected"], context["choices"])
    if kind in _UNKNOWN_KEY:
        keys = tuple(_schema_at(schema, loc[:-1]).get("properties", {}))
        expected = f"a known key{hint(loc[-1], keys)}"
        return error_type(source, key_path(loc), "an unknown key", expected, keys)
    if kind == "literal_error":
        return _wrong_choice(source, detail, error_type, _schema_at(schema, loc))
    if kind == "missing" and isinstance(loc[-1], int):  # a list of fixed length that ends too early
        loc = loc[:-1]
    elif kind == "missing":
        return error_type(source, key_path(loc), "nothing", _PHRASES[kind])
    count = _fixed_length(_schema_at(schema, loc)) if kind in {"missing", "too_long", "too_short"} else None
    if count is not None:
        expected = f"a list of {count} items"
    elif kind in _PHRASES:
        expected = _PHRASES[kind].format(**context)
    else:
        expected = f"something else ({detail['msg']})"
    return error_type(source, key_path(loc), _got(kind, detail["input"]), expected)


def refusal(
    expected: str, *, got: object, key: Sequence[str | int] = (), choices: Sequence[str] = ()
) -> PydanticCustomError:
    """Return what a validator of ours raises, for `input_error` to read.

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
    return PydanticCustomError(_REFUSAL, "expected {expected}", context)


def key_path(steps: Sequence[str | int]) -> str:
    """Return steps into nested data as people write them: ``tool_path.legs[1].seconds``."""
    path = ""
    for step in steps:
        if isinstance(step, int):
            path += f"[{step}]"
        else:
            plain = step if _PLAIN_KEY.fullmatch(step) else shown(step)
            path += f".{plain}" if path else plain
    return path


def shown(value: object) -> str:
    """Return a value as one short line."""
    text = repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 1]}…"


def counted(number: int, noun: str, plural: str = "") -> str:
    """Return a number of things as people write it: ``1 joint``, ``2 joints``; `plural` where it is no s."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def hint(word: object, choices: Sequence[str]) -> str:
    """Return ``; did you mean X?`` for a slip of the pen; nothing where no choice is near."""
    close = difflib.get_close_matches(str(word), choices, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def _most_telling(errors: list[ErrorDetails]) -> ErrorDetails:
    """Return the first error; but where a required key is missing, an unknown one beside it first."""
    first = errors[0]
    if first["type"] == "missing":
        for other in errors:
            if other["type"] in _UNKNOWN_KEY and other["loc"][:-1] == first["loc"][:-1]:
                return other
    return first


def _wrong_choice(
    source: str, detail: ErrorDetails, error_type: type[InputError], node: dict[str, Any]
) -> InputError:
    choices = tuple(str(choice) for choice in node.get("enum", [node.get("const")]))
    key, value = key_path(detail["loc"]), detail["input"]
    if len(choices) == 1:
        return error_type(source, key, shown(value), repr(choices[0]))
    return error_type(source, key, shown(value), f"a known value{hint(value, choices)}", choices)


def _got(kind: str, value: object) -> str:
    return "text that cannot be read" if kind == "json_invalid" else shown(value)


def _fixed_length(node: dict[str, Any]) -> int | None:
    fewest, most = node.get("minItems"), node.get("maxItems")
    return most if isinstance(most, int) and fewest == most else None


def _schema_at(schema: dict[str, Any], loc: Sequence[str | int]) -> dict[str, Any]:
    """Return the part of a JSON Schema that describes the value at `loc`; empty where there is none."""
    node = _resolved(schema, schema)
    for step in loc:
        if isinstance(step, str):
            others = node.get("additionalProperties")
            node = node.get("properties", {}).get(step, others if isinstance(others, dict) else {})
        else:
            fixed = node.get("prefixItems", [])
            node = fixed[step] if step < len(fixed) else node.get("items", {})
        node = _resolved(schema, node)
    return node


def _resolved(schema: dict[str, Any], node: dict[str, Any]) -> dict[str, Any]:
    """Follow references, and pass from "this or null" to this."""
    while True:
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rsplit("/", 1)[-1]]
        elif "anyOf" in node:
            node = next(branch for branch in node["anyOf"] if branch.get("type") != "null")
        else:
            return node
