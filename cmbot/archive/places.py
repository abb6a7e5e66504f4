"""Where plans and other results may be written, and which plan directories may have been meant."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from typing import Any

from cmbot.archive.folder import (
    FILE_NAME,
    add_files,
    drafted,
    exclusive,
    read_file,
    read_record,
    refusals,
    replace_folder,
    resolved,
)
from cmbot.archive.names import FORMATS, OWN_FILES, PLAN_FILE, PLAN_FILES, SHOWN_FILES, WALK_FILE
from cmbot.archive.strict_json import read_json
from cmbot.common.errors import ArchiveError
from cmbot.common.validation import shown

# Where the command line puts plans by default.
_DEFAULT_PLACE = Path("out")
_MOST_SUGGESTED = 3


@contextmanager
def claim(directory: str | Path) -> Iterator[None]:
    """Keep other processes from writing to a folder, or to where one is to be, in the meantime.

    What a call that was killed has begun there is finished or removed first.

    Raises
    ------
    ArchiveError
        When another process has claimed it, or nothing can be written there.
    """
    with ExitStack() as claimed:
        claimed.enter_context(exclusive(_writable(Path(directory))))
        yield


def require_free(directory: str | Path, *, force: bool = False) -> None:
    """Refuse a directory that `save` would refuse, before a long computation.

    Parameters
    ----------
    directory : str or Path
    force : bool
        A plan directory may be there, but nothing else.

    Raises
    ------
    ArchiveError
        When something is in the way, or no folder can be made there.
    """
    directory = Path(directory)
    target = _writable(directory)
    with refusals(directory):
        if not target.exists():
            return
        if not target.is_dir():
            raise ArchiveError(str(directory), "", "a file of that name", "the name of a new folder")
        if not any(target.iterdir()):
            return
        if not force:
            expected = "a new folder; --force (in Python force=True) replaces a plan"
            raise ArchiveError(str(directory), "", "a folder that is already there", expected)
        if not _is_plan_directory(target):
            got = "a folder with something other than a plan in it"
            expected = "a plan directory or an empty folder: nothing else is replaced, not even with --force"
            raise ArchiveError(str(directory), "", got, expected)
        _require_no_folder(OWN_FILES, target)


def write_plan_files(
    directory: Path, record: Mapping[str, Any], contents: Mapping[str, bytes], *, force: bool
) -> None:
    """Write a plan directory: it appears whole or not at all; errors are those of `require_free`."""
    with claim(directory):
        require_free(directory, force=force)
        replace_folder(resolved(directory), PLAN_FILE, record, contents)


def add_file(directory: str | Path, name: str, content: bytes | str) -> Path:
    """Add a file to a plan directory or a walk's, or not at all; an earlier one of its name is replaced.

    Parameters
    ----------
    directory : str or Path
    name : str
        Of the file, such as ``replay.html``; not one of those that a plan is read from.
    content : bytes or str
        Text is written in UTF-8.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    ArchiveError
        When `directory` is none of these, the name is not possible, another process is writing there, or the
        system refuses.
    """
    directory = Path(directory)
    if not FILE_NAME.fullmatch(name):
        expected = "letters, digits, ., - and _, beginning with a letter or digit"
        raise ArchiveError("add_file", "name", shown(name), expected)
    if name in (*FORMATS, *PLAN_FILES):
        raise ArchiveError("add_file", "name", name, "a name that is not one of the plan's own files")
    data = in_bytes(content)
    record = record_of(directory)
    if record is None:
        raise ArchiveError(str(directory), "", "no plan directory", "a folder that a plan was saved in")
    add_files(resolved(directory), record, {name: data})
    return directory / name


def add_results(
    folder: Path, contents: Mapping[str, bytes], require: Callable[[Path], object]
) -> tuple[Path, ...]:
    """Add results to a plan directory that `require` takes, all files or none; return their paths.

    Raises
    ------
    ArchiveError
        When `folder` is no plan directory, `require` refuses it, another process is writing there, or the
        system refuses.
    """
    target = require_plan_directory(folder)
    with claim(folder):
        require(folder)
        add_files(target, PLAN_FILE, contents)
        return tuple(folder / name for name in contents)


def require_no_results(directory: str | Path, names: Collection[str], expected: str, *, force: bool) -> None:
    """Refuse a plan directory that has results of some names, unless they may be replaced.

    Raises
    ------
    ArchiveError
        That says what is `expected`.
    """
    for name in () if force else names:
        path = Path(directory) / name
        if path.exists():
            raise ArchiveError(str(path), "", "a file that is already there", expected)


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
    target = _writable(directory)
    with refusals(directory):
        if target.exists() and not target.is_dir():
            raise ArchiveError(str(directory), "", "a file of that name", "the name of a folder")
        _require_no_folder(names, target)
        there = [name for name in names if (target / name).exists()]
        if there and not force:
            expected = "a folder without these files, or --force"
            raise ArchiveError(str(directory), "", ", ".join(there), expected)


def write_results(
    directory: str | Path,
    name: str,
    record: Mapping[str, Any],
    contents: Mapping[str, bytes],
    *,
    force: bool = False,
) -> None:
    """Write files and their record into a folder, which is made as needed: all of them or none.

    Parameters
    ----------
    directory : str or Path
        Need not be empty; what no earlier record there names stays.
    name : str
        Of the record: ``walk.json``, ``tour.json`` or ``stances.json``.
    record : mapping
        Ready for JSON; the hashes of the files are added.
    contents : mapping of str to bytes
        By the names of the files.
    force : bool
        Earlier ones of their names are replaced.

    Raises
    ------
    ArchiveError
        As by `require_absent`, and when another process is writing there.
    """
    with claim(directory):
        require_absent(directory, (*contents, name), force=force)
        replace_folder(resolved(Path(directory)), name, {"format": FORMATS[name], **record}, contents)


@contextmanager
def new_folder(directory: str | Path) -> Iterator[Path]:
    """Give a draft of a folder that appears whole under its name, or, after an error, not at all.

    Raises
    ------
    ArchiveError
        As by `require_new_folder`, and when the system refuses.
    """
    require_new_folder(directory)
    with drafted(resolved(Path(directory))) as draft:
        yield draft


def require_new_folder(directory: str | Path) -> None:
    """Refuse a folder that is there and not empty, before a long computation.

    Raises
    ------
    ArchiveError
        When one is there, or no folder can be made there.
    """
    target = _writable(Path(directory))
    with refusals(Path(directory)):
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise ArchiveError(str(directory), "", "something that is already there", "a new or empty folder")


def record_of(directory: Path) -> str | None:
    """Return the name of the record in a folder, such as ``plan.json``; None where there is none."""
    for name in FORMATS:
        try:
            read_record(directory, name)
        except ArchiveError:
            continue
        return name
    return None


def require_plan_directory(directory: Path) -> Path:
    """Return the absolute path of a plan directory; refuse any other folder."""
    target = resolved(directory)
    if record_of(target) != PLAN_FILE:
        raise ArchiveError(str(directory), "", "no plan directory", "a folder that a plan was saved in")
    return target


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
    return {name: in_bytes(content) for name, content in given.items()}


def in_bytes(content: bytes | str) -> bytes:
    """Return a file's content, text in UTF-8."""
    if isinstance(content, bytes):
        return content
    try:
        return content.encode()
    except UnicodeEncodeError as error:
        got = f"a character that is none (at position {error.start})"
        raise ArchiveError("add_file", "content", got, "text that UTF-8 can hold") from error


def _writable(directory: Path) -> Path:
    """The absolute path of a directory; refuse one that cannot be written to, or be made."""
    expected = "a place that can be written to"
    with refusals(directory):
        target = resolved(directory)
        above = next(parent for parent in target.parents if parent.exists())
        if not above.is_dir():
            raise ArchiveError(str(directory), "", f"a place below {above}, which is a file", expected)
        if not os.access(above, os.W_OK | os.X_OK):
            got = f"a place in {above}, where this user may not write"
            raise ArchiveError(str(directory), "", got, expected)
        if target.is_dir() and not os.access(target, os.W_OK | os.X_OK):
            raise ArchiveError(str(directory), "", "a folder in which this user may not write", expected)
    return target


def _is_plan_directory(folder: Path) -> bool:
    """Whether the folder has a plan.json of cmbot, of any version; other programs write such files, too."""
    path = folder / PLAN_FILE
    try:
        data = read_json(read_file(path), str(path))
    except ArchiveError:
        return False
    return str(data.get("format")).startswith("cmbot-plan/")


def _require_no_folder(names: Collection[str], target: Path) -> None:
    """Refuse folders with the names of a plan's files."""
    for name in sorted(names):
        if (target / name).is_dir():
            raise ArchiveError(str(target / name), "", "a folder", "a file of the plan, or nothing")
