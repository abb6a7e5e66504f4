"""Changing plan directories, and what is refused of them."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cmbot.archive import load_plan
from cmbot.errors import ArchiveError


def edit(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change what stands in plan.json."""
    path = folder / "plan.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")


def rewrite(folder: Path, name: str, content: bytes) -> None:
    """Replace a file as a program would that also keeps the hashes right."""
    (folder / name).write_bytes(content)
    edit(folder, lambda data: data["files"].update({name: hashlib.sha256(content).hexdigest()}))


def npz(**arrays: Any) -> bytes:
    """Return arrays as the content of such a file."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def refused(folder: Path, file: str, key: str) -> ArchiveError:
    """Return the error for which a plan directory is not read; it names that file and key."""
    with pytest.raises(ArchiveError) as caught:
        load_plan(folder)
    assert (caught.value.source, caught.value.key) == (str(folder / file), key)
    return caught.value


def same_arrays(left: Any, right: Any) -> None:
    """Require two dataclasses to hold the same arrays."""
    for field in fields(left):
        np.testing.assert_array_equal(getattr(left, field.name), getattr(right, field.name))
