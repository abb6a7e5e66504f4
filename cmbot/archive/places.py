"""Where plans and other results may be written, and which plan directories may have been meant."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from typing import Any

from cmbot.archive.folder import (
    FILE_NAME,
    add_files,
    claim,
    drafted,
    read_file,
    read_record,
    refusals,
    replace_folder,
    resolved,
    writable,
)
from cmbot.archive.records import FORMATS, OWN_FILES, PLAN_FILE, PLAN_FILES, SHOWN_FILES, WALK_FILE, read_json
from cmbot.common.errors import ArchiveError
from cmbot.common.reading.validation import shown

# Where the command line puts plans by default.
_DEFAULT_PARENT = Path("out")
_MAX_SUGGESTIONS = 3


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
    target = writable(Path(directory))
    with refusals(target):
        if target.exists() and not target.is_dir():
            raise ArchiveError(str(directory), "", "a file of that name", "the name of a new folder")
        if not target.exists() or not any(target.iterdir()):
            return
        if not force:
            expected = "a new or empty folder; --force (in Python force=True) replaces a plan"
            raise ArchiveError(str(directory), "", "a folder that is already there", expected)
        if not _is_plan_directory(target):
            got = "a folder with something other than a plan in it"
            expected = "a plan directory or an empty folder: nothing else is replaced, not even with --force"
            raise ArchiveError(str(directory), "", got, expected)
        _require_no_folder(OWN_FILES, target)


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
    record = record_of(directory)
    if record is None:
        raise ArchiveError(str(directory), "", "no plan directory", "a folder that a plan was saved in")
    add_files(resolved(directory), record, {name: in_bytes(content)})
    return directory / name


def add_results(
    folder: Path, results: Mapping[str, bytes], shown: Mapping[str, bytes | str] | None, *, force: bool
) -> tuple[Path, ...]:
    """Add results to a plan directory with pages and plots that show them, all or none; return their paths.

    Raises
    ------
    ArchiveError
        When `folder` is no plan directory, it has such results that may not be replaced, another process is
        writing there, or the system refuses.
    """
    contents = {**results, **shown_files(shown)}
    if record_of(resolved(folder)) != PLAN_FILE:
        raise ArchiveError(str(folder), "", "no plan directory", "a folder that a plan was saved in")
    with claim(folder) as target:
        require_absent(folder, results, force=force)
        add_files(target, PLAN_FILE, contents)
        return tuple(folder / name for name in contents)


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
    target = writable(Path(directory))
    with refusals(target):
        if target.exists() and not target.is_dir():
            raise ArchiveError(str(directory), "", "a file of that name", "the name of a folder")
        _require_no_folder(names, target)
        there = [name for name in names if (target / name).exists()]
        if there and not force:
            expected = "a folder without these files, or --force (in Python force=True)"
            raise ArchiveError(str(directory), "", f"{', '.join(there)}, already there", expected)


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
    with claim(directory) as target:
        require_absent(directory, (*contents, name), force=force)
        replace_folder(target, name, {"format": FORMATS[name], **record}, contents)


@contextmanager
def new_folder(directory: str | Path) -> Iterator[Path]:
    """Give a draft of a folder that appears whole under its name, or, after an error, not at all.

    Raises
    ------
    ArchiveError
        As by `require_free`, and when the system refuses.
    """
    require_free(directory)
    with drafted(resolved(Path(directory))) as draft:
        yield draft


def record_of(directory: Path) -> str | None:
    """Return the name of the record in a folder, such as ``plan.json``; None where there is none."""
    for name in FORMATS:
        with suppress(ArchiveError):
            read_record(directory, name)
            return name
    return None


def plans_nearby(folder: Path) -> str:
    """Return a question that names the plan directories that may have been meant, or what shows a walk.

    The one around a file, those in `folder`, the one of its name in ``out`` or those in that, or those with
    similar names here and there. It is empty where there are none.
    """
    try:
        if (folder / WALK_FILE).is_file():
            return "; this folder is a walk's, which cmbot replay shows"
        if folder.is_file() and (folder.parent / PLAN_FILE).is_file():
            return f"; did you mean {folder.parent}?"
        default = _DEFAULT_PARENT / folder
        found = _inside(folder) or ([default] if (default / PLAN_FILE).is_file() else _inside(default))
        found = found or [*_similar(folder), *_similar(default)]
    except OSError:  # a folder without permission, a path that is too long
        return ""
    more = " or another one there" if len(found) > _MAX_SUGGESTIONS else ""
    meant = " or ".join(map(str, found[:_MAX_SUGGESTIONS]))
    return f"; did you mean {meant}{more}?" if found else ""


def _inside(folder: Path) -> list[Path]:
    """The plan directories in a folder; of a campaign's some of those below ``plans``, which may be many."""
    if found := sorted(path.parent for path in folder.glob(f"*/{PLAN_FILE}")):
        return found
    below = (path.parent for place in sorted(folder.glob("plans/*")) for path in place.glob(f"*/{PLAN_FILE}"))
    return list(islice(below, _MAX_SUGGESTIONS + 1))


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
    """Return a file's content, text in UTF-8; characters that are none become question marks."""
    return content if isinstance(content, bytes) else content.encode("utf-8", "replace")


def _is_plan_directory(folder: Path) -> bool:
    """Whether the folder has a plan.json of cmbot, of any version; other programs write such files, too."""
    path = folder / PLAN_FILE
    with suppress(ArchiveError):
        return str(read_json(read_file(path), str(path)).get("format")).startswith("cmbot-plan/")
    return False


def _require_no_folder(names: Collection[str], target: Path) -> None:
    """Refuse folders with the names of a plan's files."""
    for name in sorted(names):
        if (target / name).is_dir():
            raise ArchiveError(str(target / name), "", "a folder", "a file of the plan, or nothing")
