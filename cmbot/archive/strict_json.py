"""Standard JSON of bounded size."""

from __future__ import annotations

import json
from typing import Any

from pydantic_core import from_json

from cmbot.common.errors import ArchiveError
from cmbot.common.validation import shown

# No plan has as many: 20,000 via-points make 20,000 numbers, 2,000 legs and 1,000 obstacles some ten each.
_MOST_VALUES = 200_000


def read_json(content: bytes, source: str) -> dict[str, Any]:
    """Return the JSON object in a file's `content`; errors name `source` as the file.

    Refused is what is no JSON in UTF-8 or no object, has a number that is none, or brackets deeper than 200.
    So is JSON of more than 200,000 values, which are counted before anything is made of the text.
    """
    # Each value comes after a comma or an opening bracket.
    if sum(map(content.count, (b",", b"[", b"{"))) > _MOST_VALUES:
        raise ArchiveError(source, "", "more values", f"at most {_MOST_VALUES}")
    try:
        data = from_json(content, allow_inf_nan=False)
    except ValueError as error:
        raise ArchiveError(source, "", f"text that is no JSON ({error})", "valid JSON in UTF-8") from error
    if not isinstance(data, dict):
        raise ArchiveError(source, "", shown(data), "a JSON object")
    return data


def json_bytes(data: object, *, indent: int | None = None) -> bytes:
    """Return `data` as JSON; its keys keep their order. A number that is not finite is a ValueError."""
    text = json.dumps(data, indent=indent, ensure_ascii=False, allow_nan=False)
    return f"{text}\n".encode()
