"""Standard JSON: no NaN, no repeated keys, UTF-8, of bounded size and depth."""

from __future__ import annotations

import json
import re
from typing import Any, NoReturn

from cmbot.common.errors import ArchiveError
from cmbot.common.validation import shown

# No plan has as many: 20,000 via-points make 20,000 numbers, 2,000 legs and 1,000 obstacles some ten each.
_MOST_VALUES = 200_000
_MOST_KEYS = 1000
_DEEPEST = 50
# Up to the next bracket outside of strings, or the end; possessive, so that the time is linear.
_TO_BRACKET = re.compile(rb'(?:[^"\[\]{}]|"(?:[^"\\]|\\.)*+(?:"|\\?\Z))*+([\[\]{}]|\Z)', re.DOTALL)


class _RefusedError(Exception):
    """Something that Python's reader accepts; `read_json` adds the file."""

    def __init__(self, key: str, got: str, expected: str) -> None:
        super().__init__(got)
        self.key, self.got, self.expected = key, got, expected


def read_json(content: bytes, source: str) -> dict[str, Any]:
    """Return the JSON object in a file's `content`; errors name `source` as the file.

    Refused is what is no JSON or no object, has a key twice or a number that is none. So is JSON of more than
    200,000 values, or of brackets deeper than 50; both are counted before anything is made of the text.
    """
    _require_bounds(content, source)
    try:
        data = json.loads(content.decode("utf-8"), object_pairs_hook=_each_once, parse_constant=_no_number)
    except _RefusedError as error:
        raise ArchiveError(source, error.key, error.got, error.expected) from error
    except UnicodeDecodeError as error:
        got = f"a byte that is not UTF-8 (byte {error.start})"
        raise ArchiveError(source, "", got, "JSON in UTF-8") from error
    except json.JSONDecodeError as error:
        got = f"text that breaks off or is no JSON ({error.msg}, line {error.lineno}, column {error.colno})"
        raise ArchiveError(source, "", got, "valid JSON") from error
    except (ValueError, RecursionError) as error:  # a whole number of thousands of digits; nesting too deep
        raise ArchiveError(source, "", shown(str(error)), "JSON that a plan can be made of") from error
    if not isinstance(data, dict):
        raise ArchiveError(source, "", shown(data), "a JSON object")
    return data


def json_bytes(data: object, *, indent: int | None = None) -> bytes:
    """Return `data` as JSON; its keys keep their order. A number that is not finite is a ValueError."""
    text = json.dumps(data, indent=indent, ensure_ascii=False, allow_nan=False)
    return f"{text}\n".encode()


def _require_bounds(content: bytes, source: str) -> None:
    # Each value comes after a comma or an opening bracket.
    values, ends = sum(map(content.count, (b",", b"[", b"{"))), sum(map(content.count, (b"]", b"}")))
    if max(values, ends) > _MOST_VALUES:
        raise ArchiveError(source, "", "more values", f"at most {_MOST_VALUES}")
    depth = 0
    for match in _TO_BRACKET.finditer(content):
        depth += {b"[": 1, b"{": 1, b"": 0}.get(match[1], -1)
        if depth > _DEEPEST:
            got = f"brackets deeper than {_DEEPEST} (byte {match.start(1)})"
            raise ArchiveError(source, "", got, "JSON that a plan can be made of")


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(pairs) > _MOST_KEYS:
        raise _RefusedError("", f"{len(pairs)} keys in one object", f"at most {_MOST_KEYS}")
    data: dict[str, Any] = {}
    for key, value in pairs:
        if key in data:
            raise _RefusedError(shown(key), "the same key again", "each key once")
        data[key] = value
    return data


def _no_number(name: str) -> NoReturn:
    raise _RefusedError("", name, "finite numbers")
