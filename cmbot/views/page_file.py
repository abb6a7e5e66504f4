"""A page as a file that appears whole or not at all."""

from __future__ import annotations

import contextlib
import uuid
from pathlib import Path

from cmbot.common.errors import InputError

__all__ = ["write_page"]


def write_page(path: Path, text: str) -> None:
    """Write a page beside its place, then move it there.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    draft = path.parent / f".{uuid.uuid4().hex}.html"
    try:
        draft.write_text(text, encoding="utf-8", errors="replace", newline="\n")
        draft.replace(path)
    except (OSError, ValueError) as error:
        with contextlib.suppress(OSError, ValueError):
            draft.unlink(missing_ok=True)
        got = f"a file that cannot be written ({getattr(error, 'strerror', None) or error})"
        raise InputError(str(path), "", got, "a path where a file can be written") from error
