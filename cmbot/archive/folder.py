"""Folders and files that appear whole or not at all."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from difflib import get_close_matches
from pathlib import Path

from cmbot.archive.strict_json import read_json
from cmbot.common.errors import ArchiveError
from cmbot.common.validation import shown

__all__ = [
    "APPROACH_FILES",
    "FORMAT",
    "PLAN_FILE",
    "SAVED_FILES",
    "add_file",
    "plans_nearby",
    "read_file",
    "require_free",
    "write_file",
    "write_folder",
]

FORMAT = "cmbot-plan/1"
PLAN_FILE = "plan.json"
SAVED_FILES = ("trajectory.csv", "baseline.csv", "trajectory.npz", "trajectory.ros.json")
"""The files beside `PLAN_FILE` of every plan."""
APPROACH_FILES = ("approach.csv", "approach.npz", "approach.ros.json")
"""Those of a plan with an approach."""

_FORMAT_OF_ANY_VERSION = re.compile(r"cmbot-plan/\d+")
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._\-]{0,199}")
# Where the command line puts plans by default.
_DEFAULT_PLACE = Path("out")
_MOST_SUGGESTED = 3


def write_folder(contents: Mapping[str, bytes], directory: Path, *, force: bool) -> None:
    """Write a plan directory of files by their names: a hidden folder beside it is filled, then renamed.

    With `force` it replaces the plan that is there. An `ArchiveError` is raised when something is in the way
    or the system refuses; nothing is left behind then.
    """
    require_free(directory, force=force)
    with _refusals(directory), ExitStack() as cleanup:
        target = _resolved(directory)
        missing = [parent for parent in target.parents if not parent.exists()]
        cleanup.callback(_remove_empty, missing)
        target.parent.mkdir(parents=True, exist_ok=True)
        part = _unique(target.parent)
        cleanup.callback(shutil.rmtree, part, ignore_errors=True)
        part.mkdir()
        for name, content in contents.items():
            _write(part / name, content)
        _sync(part)
        if force and target.exists():
            _swap(part, target)
        else:
            part.rename(target)
        _sync(target.parent)


def require_free(directory: str | Path, *, force: bool = False) -> None:
    """Refuse a directory that `save` would refuse, before a long computation.

    Parameters
    ----------
    directory : str or Path
    force : bool
        A plan directory or an empty folder may be there, but nothing else.

    Raises
    ------
    ArchiveError
        When something is in the way, or no folder can be made there.
    """
    directory = Path(directory)
    with _refusals(directory):
        target = _resolved(directory)
        _require_writable(directory, target)
        if not target.exists():
            return
        if not target.is_dir():
            raise ArchiveError(str(directory), "", "a file of that name", "the name of a new folder")
        if not force:
            expected = "a new folder; --force (in Python force=True) replaces a plan"
            raise ArchiveError(str(directory), "", "a folder that is already there", expected)
        if any(target.iterdir()) and not _is_plan_directory(target):
            got = "a folder with something other than a plan in it"
            expected = "a plan directory or an empty folder: nothing else is replaced, not even with --force"
            raise ArchiveError(str(directory), "", got, expected)


def add_file(directory: str | Path, name: str, content: bytes | str) -> Path:
    """Add a file to a plan directory, whole or not at all; an earlier one of its name is replaced.

    Parameters
    ----------
    directory : str or Path
        A plan directory.
    name : str
        Of the file, such as ``replay.html``; not one of the plan's own files.
    content : bytes or str
        Text is written in UTF-8.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    ArchiveError
        When `directory` is no plan directory, the name is not possible, or the system refuses.
    """
    directory = Path(directory)
    if not _FILE_NAME.fullmatch(name):
        expected = "letters, digits, ., - and _, beginning with a letter or digit"
        raise ArchiveError("add_file", "name", shown(name), expected)
    if name in (PLAN_FILE, *SAVED_FILES, *APPROACH_FILES):
        raise ArchiveError("add_file", "name", name, "a name that is not one of the plan's own files")
    with _refusals(directory):
        target = _resolved(directory)
        if not _is_plan_directory(target):
            raise ArchiveError(str(directory), "", "no plan directory", "a folder that a plan was saved in")
        _put(target / name, _in_bytes(content))
    return directory / name


def write_file(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all; an earlier one of its name is replaced.

    Raises
    ------
    ArchiveError
        When the system refuses.
    """
    with _refusals(path.parent):
        _put(path, content)


def read_file(path: Path) -> bytes:
    """Return a file's content; an `ArchiveError` if it is missing, no regular file or unreadable."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # reading a pipe or a device may never end
            raise ArchiveError(str(path), "", "something that is not a regular file", "a file")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise ArchiveError(str(path), "", "no such file", "a file of the plan directory") from error
    except OSError as error:
        got = f"a file that cannot be read ({error.strerror})"
        raise ArchiveError(str(path), "", got, "a readable file") from error


def plans_nearby(folder: Path) -> str:
    """Return a question that names the plan directories that may have been meant.

    Those in `folder`, the one of its name in ``out``, or those with similar names here and there. It is empty
    where there are none, or `folder` is one itself.
    """
    try:
        if (folder / PLAN_FILE).exists():
            return ""
        default = _DEFAULT_PLACE / folder
        found = sorted(path.parent for path in folder.glob(f"*/{PLAN_FILE}"))
        found = found or ([default] if (default / PLAN_FILE).is_file() else [])
        found = found or [*_similar(folder), *_similar(default)]
    except OSError:  # a folder without permission, a name that is too long
        return ""
    if not found:
        return ""
    more = " or another one there" if len(found) > _MOST_SUGGESTED else ""
    return f"; did you mean {' or '.join(map(str, found[:_MOST_SUGGESTED]))}{more}?"


def _similar(folder: Path) -> list[Path]:
    """The plan directory beside a missing folder whose name is most similar."""
    if folder.exists():
        return []
    names = [path.parent.name for path in folder.parent.glob(f"*/{PLAN_FILE}")]
    return [folder.parent / name for name in get_close_matches(folder.name, names, n=1)]


def _in_bytes(content: bytes | str) -> bytes:
    if isinstance(content, bytes):
        return content
    try:
        return content.encode()
    except UnicodeEncodeError as error:
        got = f"a character that is none (at position {error.start})"
        raise ArchiveError("add_file", "content", got, "text that UTF-8 can hold") from error


def _resolved(directory: Path) -> Path:
    """Return the absolute path without links: the target of a link is replaced, not the link."""
    try:
        return directory.resolve()
    except (RuntimeError, ValueError) as error:  # links in a circle; a name that no file can have
        raise ArchiveError(shown(str(directory)), "", shown(str(error)), "the path of a folder") from error


def _require_writable(directory: Path, target: Path) -> None:
    """Refuse a directory whose nearest existing ancestor is no folder, or not writable."""
    above = next(parent for parent in target.parents if parent.exists())
    expected = "a place that can be written to"
    if not above.is_dir():
        raise ArchiveError(str(directory), "", f"a place below {above}, which is a file", expected)
    if not os.access(above, os.W_OK | os.X_OK):
        raise ArchiveError(str(directory), "", f"a place in {above}, which must not be written to", expected)


def _is_plan_directory(folder: Path) -> bool:
    """Whether the folder has a plan.json of cmbot; other programs write files of that name, too."""
    path = folder / PLAN_FILE
    try:
        data = read_json(read_file(path), str(path))
    except ArchiveError:
        return False
    return _FORMAT_OF_ANY_VERSION.fullmatch(str(data.get("format"))) is not None


def _swap(part: Path, target: Path) -> None:
    """Replace `target` by `part` and delete it; at every moment one of both can be found."""
    old = _unique(target.parent)
    try:
        target.rename(old)
        part.rename(target)
    finally:
        if old.exists() and not target.exists():
            old.rename(target)
    try:
        shutil.rmtree(old)
    except OSError as error:
        got = f"the replaced plan, which cannot be deleted ({error.strerror})"
        raise ArchiveError(str(old), "", got, "to be deleted by hand; the new plan is in place") from error


def _unique(parent: Path) -> Path:
    return parent / f".cmbot-{secrets.token_hex(8)}.part"


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # not empty, or never made
            folder.rmdir()


def _put(path: Path, content: bytes) -> None:
    """Write a hidden file beside its place, then move it there."""
    with ExitStack() as cleanup:
        part = _unique(path.parent)
        cleanup.callback(part.unlink, missing_ok=True)
        _write(part, content)
        part.replace(path)
        _sync(path.parent)


def _write(path: Path, content: bytes) -> None:
    with path.open("xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Make the names in a folder outlast a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def _refusals(directory: Path) -> Iterator[None]:
    """Turn an OSError into an ArchiveError."""
    try:
        yield
    except ArchiveError:
        raise
    except OSError as error:
        where = f" at {error.filename}" if error.filename else ""
        got = f"a refusal of the system ({error.strerror or error}{where})"
        raise ArchiveError(str(directory), "", got, "a place that can be written to") from error
