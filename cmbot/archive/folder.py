"""Plan directories on the disk: what may be written where, and how it is read."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from tempfile import mkdtemp

from cmbot.archive.atomic import exclusive, put_file, recover, refusals, replace_folder
from cmbot.archive.names import (
    EARLIER_FILES,
    JOB_FILES,
    OWN_FILES,
    PLAN_FILE,
    SAVED_FILES,
    SHOWN_FILES,
    WALK_FILE,
    is_own,
)
from cmbot.archive.strict_json import read_json
from cmbot.common.errors import ArchiveError
from cmbot.common.input_files import LARGEST_TEXT, read_input
from cmbot.common.validation import shown

__all__ = [
    "add_file",
    "add_files",
    "claim",
    "new_folder",
    "plans_nearby",
    "read_file",
    "require_absent",
    "require_free",
    "require_new_folder",
    "require_plan_directory",
    "shown_files",
    "write_file",
    "write_files",
    "write_folder",
]

_FORMAT_OF_ANY_VERSION = re.compile(r"cmbot-plan/\d+")
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._\-]{0,199}")
# Where the command line puts plans by default.
_DEFAULT_PLACE = Path("out")
_MOST_SUGGESTED = 3


@contextmanager
def claim(directory: str | Path) -> Iterator[None]:
    """Keep other processes from writing to a plan directory, or to where one is to be, in the meantime.

    What a call that was killed has left there is brought to rest first.

    Raises
    ------
    ArchiveError
        When another process has claimed it, or nothing can be written there.
    """
    directory = Path(directory)
    with ExitStack() as claimed:
        with refusals(directory):
            target = _resolved(directory)
            _require_writable(directory, target)
        claimed.enter_context(exclusive(target))
        yield


def write_folder(contents: Mapping[str, bytes], directory: Path, *, force: bool) -> None:
    """Write a plan directory of files by their names: it appears whole or not at all.

    With `force` it replaces the plan that is there. What is not the plan's stays there. An `ArchiveError` is
    raised when something is in the way or the system refuses; nothing is left behind then.
    """
    with claim(directory):
        require_free(directory, force=force)
        _require_names(contents)
        replace_folder(contents, _resolved(directory))


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
    with refusals(directory):
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
        _require_no_folder(OWN_FILES, target)


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
        When `directory` is no plan directory, the name is not possible, another process is writing there, or
        the system refuses.
    """
    directory = Path(directory)
    if not _FILE_NAME.fullmatch(name):
        expected = "letters, digits, ., - and _, beginning with a letter or digit"
        raise ArchiveError("add_file", "name", shown(name), expected)
    if name in (PLAN_FILE, *SAVED_FILES, *JOB_FILES, *EARLIER_FILES):
        raise ArchiveError("add_file", "name", name, "a name that is not one of the plan's own files")
    target, data = require_plan_directory(directory), _in_bytes(content)
    with exclusive(target) as work, refusals(directory):
        put_file(target / name, data, work)
    return directory / name


def add_files(directory: Path, contents: Mapping[str, bytes]) -> tuple[Path, ...]:
    """Add files, all of them or none, to a plan directory; earlier ones of their names are replaced.

    The names are those of files that cmbot adds. An `ArchiveError` is raised as by `add_file`.
    """
    target = require_plan_directory(directory)
    with claim(directory):
        _require_names(contents)
        _require_no_folder(contents, target)
        with refusals(directory):
            keep = {path.name for path in target.iterdir() if is_own(path)} - contents.keys()
        replace_folder(contents, target, sorted(keep))
    return tuple(directory / name for name in contents)


def write_file(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all; an earlier one of its name is replaced, folders are made as needed.

    Raises
    ------
    ArchiveError
        When the system refuses, or another process is writing it.
    """
    target = _resolved(path)
    with exclusive(target) as work, refusals(path.parent):
        put_file(target, content, work)


def require_absent(directory: str | Path, names: Collection[str], *, force: bool = False) -> None:
    """Refuse a folder that has files of some names, unless they may be replaced; folders are always refused.

    Parameters
    ----------
    directory : str or Path
    names : collection of str
    force : bool
        They may be replaced.

    Raises
    ------
    ArchiveError
        When one is there, or nothing can be written there.
    """
    directory = Path(directory)
    with refusals(directory):
        target = _resolved(directory)
        _require_writable(directory, target)
        if target.exists() and not target.is_dir():
            raise ArchiveError(str(directory), "", "a file of that name", "the name of a folder")
        _require_no_folder(names, target)
        there = [name for name in names if (target / name).exists()]
        if there and not force:
            expected = "a folder without these files, or --force"
            raise ArchiveError(str(directory), "", ", ".join(there), expected)


def write_files(directory: str | Path, contents: Mapping[str, bytes], *, force: bool = False) -> None:
    """Write files into a folder, which is made as needed: all of them or none; others stay there.

    Parameters
    ----------
    directory : str or Path
        Need not be a plan directory.
    contents : mapping of str to bytes
        By the names of the files.
    force : bool
        Earlier ones of their names are replaced.

    Raises
    ------
    ArchiveError
        As by `require_absent`, and when another process is writing there.
    """
    directory = Path(directory)
    with claim(directory):
        require_absent(directory, contents.keys(), force=force)
        target = _resolved(directory)
        with refusals(directory):
            there = target.iterdir() if target.exists() else ()
            keep = {path.name for path in there if is_own(path)} - contents.keys()
        replace_folder(contents, target, sorted(keep))


@contextmanager
def new_folder(directory: str | Path) -> Iterator[Path]:
    """Give a draft of a folder that appears whole under its name, or, after an error, not at all.

    Raises
    ------
    ArchiveError
        As by `require_new_folder`, and when the system refuses.
    """
    directory = Path(directory)
    require_new_folder(directory)
    target = _resolved(directory)
    with refusals(directory):
        target.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(mkdtemp(prefix=f".{target.name}.cmbot-", dir=target.parent))
    try:
        yield draft
        with refusals(directory):
            draft.chmod(0o755)
            # An empty folder of that name is replaced, any other one is not.
            draft.rename(target)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def require_new_folder(directory: str | Path) -> None:
    """Refuse a folder that is there and not empty, before a long computation.

    Raises
    ------
    ArchiveError
        When one is there, or no folder can be made there.
    """
    directory = Path(directory)
    with refusals(directory):
        target = _resolved(directory)
        _require_writable(directory, target)
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise ArchiveError(str(directory), "", "something that is already there", "a new or empty folder")


def read_file(path: Path, largest: int = LARGEST_TEXT) -> bytes:
    """Return a file's content; an `ArchiveError` if it is missing, no regular file, too large, unreadable."""
    return read_input(path, ArchiveError, kind="a file of the plan directory", largest=largest)


def plans_nearby(folder: Path) -> str:
    """Return a question that names the plan directories that may have been meant, or what shows a walk.

    The one around a file, those in `folder`, the one of its name in ``out`` or those in that, or those with
    similar names here and there. It is empty where there are none, or `folder` is one itself.
    """
    try:
        if (folder / PLAN_FILE).exists():
            return ""
        if (folder / WALK_FILE).is_file():
            return "; this folder is a walk's, which cmbot replay shows"
        if folder.is_file() and (folder.parent / PLAN_FILE).is_file():
            return f"; did you mean {folder.parent}?"
        default = _DEFAULT_PLACE / folder
        found = _inside(folder) or ([default] if (default / PLAN_FILE).is_file() else _inside(default))
        found = found or [*_similar(folder), *_similar(default)]
    except OSError:  # a folder without permission, a name that is too long
        return ""
    if not found:
        return ""
    more = " or another one there" if len(found) > _MOST_SUGGESTED else ""
    return f"; did you mean {' or '.join(map(str, found[:_MOST_SUGGESTED]))}{more}?"


def _inside(folder: Path) -> list[Path]:
    """The plan directories in a folder; of a campaign's some of those below ``plans``, which may be many."""
    if found := sorted(path.parent for path in folder.glob(f"*/{PLAN_FILE}")):
        return found
    below = (path.parent for place in sorted(folder.glob("plans/*")) for path in place.glob(f"*/{PLAN_FILE}"))
    return list(islice(below, _MOST_SUGGESTED + 1))


def _similar(folder: Path) -> list[Path]:
    """The plan directory beside a missing folder whose name is most similar."""
    if folder.exists():
        return []
    names = [path.parent.name for path in folder.parent.glob(f"*/{PLAN_FILE}")]
    return [folder.parent / name for name in get_close_matches(folder.name, names, n=1)]


def shown_files(contents: Mapping[str, bytes | str] | None) -> dict[str, bytes]:
    """Return the bytes of pages and plots by their names; refuse other names."""
    given = contents or {}
    if strange := sorted(given.keys() - set(SHOWN_FILES)):
        raise ArchiveError("added", "", shown(strange[0]), "a page or a plot of a plan", SHOWN_FILES)
    return {name: _in_bytes(content) for name, content in given.items()}


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
        target = directory.resolve()
    except (RuntimeError, ValueError) as error:  # links in a circle; a name that no file can have
        raise ArchiveError(shown(str(directory)), "", shown(str(error)), "the path of a folder") from error
    if not target.name:
        raise ArchiveError(str(directory), "", "the root of all folders", "the path of a folder below it")
    return target


def _require_writable(directory: Path, target: Path) -> None:
    """Refuse a directory that is not writable, or whose nearest existing ancestor is no folder or not."""
    above = next(parent for parent in target.parents if parent.exists())
    expected = "a place that can be written to"
    if not above.is_dir():
        raise ArchiveError(str(directory), "", f"a place below {above}, which is a file", expected)
    if not os.access(above, os.W_OK | os.X_OK):
        raise ArchiveError(str(directory), "", f"a place in {above}, where this user may not write", expected)
    if target.is_dir() and not os.access(target, os.W_OK | os.X_OK):
        raise ArchiveError(str(directory), "", "a folder in which this user may not write", expected)


def _is_plan_directory(folder: Path) -> bool:
    """Whether the folder has a plan.json of cmbot; other programs write files of that name, too."""
    path = folder / PLAN_FILE
    try:
        data = read_json(read_file(path), str(path))
    except ArchiveError:
        return False
    return _FORMAT_OF_ANY_VERSION.fullmatch(str(data.get("format"))) is not None


def require_plan_directory(directory: Path) -> Path:
    """Return the absolute path of a plan directory; refuse any other folder."""
    with refusals(directory):
        target = _resolved(directory)
        recover(target)
        if not _is_plan_directory(target):
            raise ArchiveError(str(directory), "", "no plan directory", "a folder that a plan was saved in")
    return target


def _require_names(names: Collection[str]) -> None:
    """Refuse names other than those of a plan's files: what has another name is never replaced or deleted."""
    if strange := sorted(set(names) - OWN_FILES):
        expected = "names of the files that cmbot writes into a plan directory"
        raise ArchiveError("a plan directory", "", f"a file {shown(strange[0])}", expected)


def _require_no_folder(names: Collection[str], target: Path) -> None:
    """Refuse folders with the names of a plan's files."""
    for name in sorted(names):
        if (target / name).is_dir():
            raise ArchiveError(str(target / name), "", "a folder", "a file of the plan, or nothing")
