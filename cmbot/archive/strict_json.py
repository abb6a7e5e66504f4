"""Standard JSON: no NaN, no repeated keys, UTF-8."""

from __future__ import annotations

import json
from typing import Any, NoReturn

from cmbot.common.errors import ArchiveError
from cmbot.common.validation import shown

__all__ = ["json_bytes", "read_json"]


class _RefusedError(Exception):
    """Something that Python's reader accepts; `read_json` adds the file."""

    def __init__(self, key: str, got: str, expected: str) -> None:
        super().__init__(got)
        self.key, self.got, self.expected = key, got, expected


def read_json(content: bytes, source: str) -> dict[str, Any]:
    """Return the JSON object in a file's `content`; errors name `source` as the file.

    Refused is what is no JSON or no object, or has a key twice or a number that is none.
    """
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


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data: dict[str, Any] = {}
    for key, value in pairs:
        if key in data:
            raise _RefusedError(shown(key), "the same key again", "each key once")
        data[key] = value
    return data


def _no_number(name: str) -> NoReturn:
    raise _RefusedError("", name, "finite numbers")
