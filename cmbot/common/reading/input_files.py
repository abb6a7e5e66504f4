"""Input files: regular files of bounded size, read in one piece; and what is not replaced by a file.

Reading a pipe or a device may never end, and a file that fits no memory ends the process. Written files are
moved to their places: a device such as /dev/null would be gone.
"""

from __future__ import annotations

import csv
import os
import stat
from pathlib import Path

from cmbot.common.errors import InputError

LARGEST_TEXT = 20_000_000
"""Bytes of a URDF, an SRDF or a plan.json."""
LARGEST_MESH = 50_000_000
"""Bytes of a mesh."""


def is_file(path: str | Path) -> bool:
    """Return whether there is a file; False for a name that none can have, where `Path.is_file` raises."""
    return os.path.isfile(path)  # noqa: PTH113


def is_folder(path: str | Path) -> bool:
    """Return whether there is a folder; False for a name that none can have, where `Path.is_dir` raises."""
    return os.path.isdir(path)  # noqa: PTH112


def read_input(
    path: Path,
    error_type: type[InputError],
    *,
    kind: str = "a file",
    key: str = "",
    largest: int = LARGEST_TEXT,
) -> bytes:
    """Return the content of a regular file.

    Parameters
    ----------
    path : Path
    error_type : type
        What to raise: `SceneError`, `ModelError`, …
    kind : str
        What the file should be, for messages.
    key : str
        What names the file, for messages.
    largest : int
        Most bytes that it may have.

    Raises
    ------
    InputError
        Of `error_type`: the file is missing, a folder, a pipe or a device, too large, or cannot be read.
    """
    try:
        _require_regular(path.stat().st_mode, kind)
        # It may have been replaced since: opening a pipe would wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(descriptor)
            _require_regular(status.st_mode, kind)
            # A byte more than allowed shows a file that has grown since.
            content = b"" if status.st_size > largest else file.read(largest + 1)
        _require_size(max(status.st_size, len(content)), largest)
    except (OSError, ValueError) as error:
        raise _input_error(error, path, error_type, kind, key) from error
    return content


def read_csv(path: Path, error_type: type[InputError], *, kind: str, largest: int) -> list[list[str]]:
    """Return the rows of a CSV file in UTF-8, cell by cell; an `InputError` as `read_input` raises it."""
    content = read_input(path, error_type, kind=kind, largest=largest)
    try:
        return list(csv.reader(content.decode("utf-8-sig").splitlines()))
    except (UnicodeDecodeError, csv.Error) as error:
        raise error_type(str(path), "", f"text that cannot be read ({error})", "a CSV file") from error


def require_input(
    path: Path,
    error_type: type[InputError],
    *,
    kind: str = "a file",
    key: str = "",
    largest: int = LARGEST_MESH,
) -> None:
    """Refuse a file that another library will read, unless it is regular, not empty and not too large.

    Parameters and errors are those of `read_input`.
    """
    try:
        status = path.stat()
        _require_regular(status.st_mode, kind)
        _require_size(status.st_size, largest)
        if status.st_size == 0:
            raise InputError("", "", "an empty file", kind)
    except (OSError, ValueError) as error:
        raise _input_error(error, path, error_type, kind, key) from error


def require_replaceable(path: Path, error_type: type[InputError]) -> None:
    """Refuse a place for a file where a device, a pipe or a socket is."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # nothing there, or no place for a file: that shows when it is written
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        got = "something that is not a regular file"
        raise error_type(str(path), "", got, "the path of a new file, or of a regular one")


def _require_regular(mode: int, kind: str) -> None:
    if stat.S_ISDIR(mode):
        raise InputError("", "", "a folder", kind)
    if not stat.S_ISREG(mode):
        raise InputError("", "", "something that is not a regular file", kind)


def _require_size(size: int, largest: int) -> None:
    if size > largest:
        raise InputError("", "", "a larger file", f"at most {largest / 1e6:.3g} MB")


def _input_error(
    error: Exception, path: Path, error_type: type[InputError], kind: str, key: str
) -> InputError:
    if isinstance(error, InputError):
        return error_type(str(path), key, error.got, error.expected)
    if isinstance(error, FileNotFoundError):
        return error_type(str(path), key, "no such file", kind)
    # A ValueError: a name that no file can have.
    why = error.strerror if isinstance(error, OSError) else str(error)
    return error_type(str(path), key, f"a file that cannot be read ({why})", kind)
