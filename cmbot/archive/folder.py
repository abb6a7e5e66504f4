"""Folders that change at once: a record names every file beside it by its hash, and is written last.

Who writes to the folder NAME holds a lock, ``.NAME.lock`` beside it. The parts of what is new are written as
``.FILE.part``; the part of the record is the last. From then on the new content counts: what the new record
lacks is removed, each part gets its name, the record the last. `claim` goes on with what a call that was
killed has begun, or, where the record's part is missing or incomplete, removes the other parts. Readers take
no lock: `read_folder` reads each file from its part or its name, whichever has the hash in the record.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import shutil
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from io import BufferedIOBase
from pathlib import Path
from typing import Any

from cmbot.archive.records import FORMATS, json_bytes, read_json
from cmbot.common.errors import ArchiveError
from cmbot.common.reading.input_files import LARGEST_TEXT, read_input, require_replaceable
from cmbot.common.reading.validation import shown

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._\-]{0,199}")
_PART_NAME = re.compile(r"\.([A-Za-z0-9][A-Za-z0-9._\-]{0,199})\.part")
_FILES, _CONTENT = "files", "content"
# How often a lock is tried, and how long to wait in between, s.
_ATTEMPTS, _PAUSE = 20, 0.02
# How long a reader waits for a writer that is between two files, s.
_WRITER_WAIT_S = 1.0
_LARGEST_FILE = 500_000_000

_held: ContextVar[frozenset[Path]] = ContextVar("held", default=frozenset())


# One process at a time


@contextmanager
def claim(directory: str | Path) -> Iterator[Path]:
    """Keep other processes and threads from writing to a place, and finish or undo what one has left there.

    Folders above it are made as needed, and removed again if nothing is in them at the end. Inside another
    `claim` of the same place this does nothing.

    Parameters
    ----------
    directory : str or Path
        A folder with a record, or a file. It need not exist.

    Yields
    ------
    Path
        The absolute path, without links.

    Raises
    ------
    ArchiveError
        When another process has the place, nothing can be written there, or the system refuses.
    """
    target = writable(Path(directory))
    if target in _held.get():
        yield target
        return
    lock = target.with_name(f".{target.name}.lock")
    with ExitStack() as cleanup:
        with refusals(target):
            missing = [place for place in (target, *target.parents) if not place.exists()]
            cleanup.callback(_remove_empty, missing)
            cleanup.callback(_remove, lock)
            _lock(lock, target, cleanup)
            _settle(target)
        cleanup.callback(_held.reset, _held.set(_held.get() | {target}))
        yield target


def _lock(lock: Path, target: Path, cleanup: ExitStack) -> None:
    """Hold a lock until the cleanup, which closes its file. A signal may end the call at any line."""
    for attempt in range(_ATTEMPTS):
        time.sleep(_PAUSE if attempt else 0.0)
        try:
            lock.parent.mkdir(parents=True, exist_ok=True)
            file = lock.open("ab")
        except FileNotFoundError:
            # The call before this one has removed an empty folder; or, as in /proc, none can be made.
            if attempt + 1 < _ATTEMPTS:
                continue
            got, expected = "a place where no file can be made", "a place that can be written to"
            raise ArchiveError(str(target), "", got, expected) from None
        cleanup.callback(file.close)
        if _taken(file, lock):
            return
    expected = "one process at a time: wait until it has finished, or take another place"
    raise ArchiveError(str(target), "", "a place where another process is writing", expected)


def _taken(file: BufferedIOBase, lock: Path) -> bool:
    with suppress(BlockingIOError, FileNotFoundError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # The call before this one may have removed it.
        return os.path.samestat(os.fstat(file.fileno()), lock.stat())
    return False


def _remove(lock: Path) -> None:
    """Remove the file of a lock that nobody holds."""
    with suppress(OSError), lock.open("rb") as file:
        if _taken(file, lock):
            lock.unlink()


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # not empty, never made, or a file
            folder.rmdir()


@contextmanager
def refusals(directory: Path) -> Iterator[None]:
    """Turn an OSError into an ArchiveError."""
    try:
        yield
    except OSError as error:
        # Hidden files of ours say nothing to who called.
        named = error.filename and not Path(str(error.filename)).name.startswith(".")
        where = f" at {error.filename}" if named else ""
        got = f"a refusal of the system ({error.strerror or error}{where})"
        raise ArchiveError(str(directory), "", got, "a place that can be written to") from error


# Writing


def replace_folder(
    target: Path,
    name: str,
    record: Mapping[str, Any],
    contents: Mapping[str, bytes],
    kept: Collection[str] = (),
) -> None:
    """Make a folder hold the files `contents` and a record of them, all at once.

    What an earlier record there names is removed, but for the files `kept`, whose hashes the new one takes
    over. What no record names stays.

    Parameters
    ----------
    target : Path
    name : str
        Of the record.
    record : mapping
        Without the hashes.
    contents : mapping of str to bytes
        By the names of the files.
    kept : collection of str
    """
    with claim(target), refusals(target):
        target.mkdir(exist_ok=True)
        earlier = _files(_whole(target / name))
        for file in (*contents, name, *earlier):
            if (target / file).is_dir():
                raise ArchiveError(str(target / file), "", "a folder", "a file, or nothing")
        whole = sealed(record, contents, {file: earlier[file] for file in kept})
        try:
            for file, content in (*contents.items(), (name, json_bytes(whole, indent=2))):
                _write(_part(target / file), content)
        finally:
            _settle(target)


def add_files(target: Path, name: str, contents: Mapping[str, bytes]) -> None:
    """Add files to a folder and its record, all or none; earlier ones of their names are replaced."""
    with claim(target):
        record = read_record(target, name)
        kept = record[_FILES].keys() - contents.keys()
        replace_folder(target, name, record, contents, kept)


def write_file(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all; an earlier one of its name is replaced, folders are made as needed.

    Raises
    ------
    ArchiveError
        When the system refuses, or another process is writing it.
    """
    with claim(path) as target, refusals(path.parent):
        require_replaceable(target, ArchiveError)
        try:
            _write(_part(target), content)
            _part(target).replace(target)
        finally:
            _part(target).unlink(missing_ok=True)


def sealed(
    record: Mapping[str, Any], contents: Mapping[str, bytes], kept: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return a record with the hashes of all files beside it, and of its own content."""
    files = {**(kept or {}), **{name: _hash(content) for name, content in contents.items()}}
    data = {**without_hashes(record), _FILES: files}
    return {**data, _CONTENT: _content_hash(data)}


def without_hashes(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a record says beside the hashes of files and of its own content."""
    return {key: value for key, value in record.items() if key not in (_FILES, _CONTENT)}


def resolved(directory: Path) -> Path:
    """Return the absolute path without links: the target of a link is replaced, not the link."""
    try:
        target = directory.resolve()
    except (RuntimeError, ValueError) as error:  # links in a circle; a name that no file can have
        raise ArchiveError(shown(str(directory)), "", shown(str(error)), "the path of a folder") from error
    if not target.name:
        raise ArchiveError(str(directory), "", "the root of all folders", "the path of a folder below it")
    return target


def writable(directory: Path) -> Path:
    """Return the absolute path of a place; refuse one that cannot be written to, or be made."""
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


@contextmanager
def drafted(target: Path) -> Iterator[Path]:
    """Give a draft of a folder that appears whole under its name, or, after an error, not at all.

    An empty folder of that name is replaced.
    """
    with claim(target):
        # Nobody else knows the draft: it needs no lock of its own.
        draft = _part(target)
        token = _held.set(_held.get() | {draft})
        try:
            with refusals(target):
                draft.mkdir()
            yield draft
            with refusals(target):
                draft.rename(target)
        finally:
            _held.reset(token)
            shutil.rmtree(draft, ignore_errors=True)


def _part(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")


def _write(path: Path, content: bytes) -> None:
    with path.open("xb") as file:
        file.write(content)


def _settle(target: Path) -> None:
    """Give the parts in a folder their names, if its new record is complete; remove them otherwise."""
    if (draft := _part(target)).is_dir():
        shutil.rmtree(draft)
    draft.unlink(missing_ok=True)
    if not target.is_dir():
        return
    for name in FORMATS:
        if new := _whole(_part(target / name)):
            earlier = _whole(target / name)
            for file in _files(earlier).keys() - _files(new).keys():
                (target / file).unlink(missing_ok=True)
            for file in _files(new):
                with suppress(FileNotFoundError):  # kept, or moved before
                    _part(target / file).replace(target / file)
            _part(target / name).replace(target / name)
    for path in target.iterdir():
        if _PART_NAME.fullmatch(path.name) and not path.is_dir():
            path.unlink()


# Reading


def read_file(path: Path, largest: int = LARGEST_TEXT) -> bytes:
    """Return a file's content; an `ArchiveError` if it is missing, no regular file, too large, unreadable."""
    return read_input(path, ArchiveError, kind="a file of the plan directory", largest=largest)


def require_settled(folder: Path) -> None:
    """Refuse a folder with parts of what is being written: these count here, but not for who reads the names.

    Raises
    ------
    ArchiveError
        For the first part.
    """
    for path in sorted(folder.glob(".*.part")):
        expected = "none: whoever writes there finishes it, or the next command that does"
        raise ArchiveError(str(path), "", "a part of what is being written", expected)


def read_record(folder: Path, name: str) -> dict[str, Any]:
    """Return the record that counts in a folder, also where a call was killed before it had its name.

    Raises
    ------
    ArchiveError
        When it is missing, damaged, of another version or changed.
    """
    if whole := _whole(_part(folder / name)):
        return whole
    path = folder / name
    data, expected = read_json(read_file(path), str(path)), FORMATS[name]
    written, kind = shown(data.get("format")), expected.partition("/")[0]
    verb = kind.removeprefix("cmbot-").replace("stances", "stand")
    why = f"written by a development version; cmbot {verb} SCENE makes it anew"
    if data.get("format") != expected:
        older = str(data.get("format")).partition("/")[0] == kind
        raise ArchiveError(str(path), "format", written, f"{expected!r}: {why}" if older else repr(expected))
    if missing := [name for name in (_FILES, _CONTENT) if name not in data]:
        raise ArchiveError(str(path), missing[0], "no such key", f"hashes, as every {name} has: {why}")
    if not _is_sealed(data):
        raise ArchiveError(str(path), _CONTENT, "another hash", "the content that cmbot wrote, unchanged")
    return data


def read_folder(
    folder: Path, name: str, wanted: Callable[[Mapping[str, str]], Collection[str]]
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Read a record and files beside it as they were written together, whatever is written meanwhile.

    Parameters
    ----------
    folder : Path
    name : str
        Of the record.
    wanted : callable
        From the record's hashes by the names of files to the names of those that are read.

    Returns
    -------
    tuple of dict
        The record without the hashes, and the files' contents by their names.

    Raises
    ------
    ArchiveError
        As by `read_record`; also for a file that is missing, or of another hash than the record has.
    """
    deadline = time.monotonic() + _WRITER_WAIT_S
    while True:
        version = _version(folder / name)
        try:
            record = read_record(folder, name)
            hashes = _files(record)
            contents = {file: _read(folder / file, hashes, name) for file in wanted(hashes)}
            return without_hashes(record), contents
        except ArchiveError:
            # A writer was between two files, or there is one.
            between = _part(folder / name).exists() or _version(folder / name) != version
            if not between or time.monotonic() > deadline:
                raise
        time.sleep(_PAUSE)


def missing_files(folder: Path, name: str) -> tuple[str, ...]:
    """Return which files a record lists that are not there; errors as `read_record`."""
    return tuple(file for file in _files(read_record(folder, name)) if not (folder / file).exists())


def listed_name(path: Path) -> str:
    """Return a file's name as it is listed beside others: in one line, in quotes where it is odd."""
    return path.name if re.fullmatch(r"[\w.+-]+", path.name) else shown(path.name)


def _version(path: Path) -> tuple[int, int] | None:
    """What differs between two records that have had the same name; None where there is none."""
    with suppress(OSError, ValueError):  # a ValueError: a name that no file can have
        status = path.stat()
        return status.st_ino, status.st_mtime_ns
    return None


def _read(path: Path, hashes: Mapping[str, str], record: str) -> bytes:
    expected = f"the file that was saved with {record}"
    if path.name not in hashes:
        raise ArchiveError(str(path.with_name(record)), _FILES, f"no {path.name}", expected)
    with suppress(ArchiveError):  # there is none, or it has been given its name
        content = read_file(_part(path), _LARGEST_FILE)
        if _hash(content) == hashes[path.name]:
            return content
    content = read_file(path, _LARGEST_FILE)
    if _hash(content) == hashes[path.name]:
        return content
    raise ArchiveError(str(path), "", "other content", expected)


def _whole(path: Path) -> dict[str, Any] | None:
    """The record in a file; None where it is none, incomplete or changed."""
    with suppress(ArchiveError):
        data = read_json(read_file(path), str(path))
        return data if _is_sealed(data) else None
    return None


def _is_sealed(data: Mapping[str, Any]) -> bool:
    content = {key: value for key, value in data.items() if key != _CONTENT}
    return data.get(_CONTENT) == _content_hash(content)


def _content_hash(data: Mapping[str, Any]) -> str:
    # A file may hold halves of characters, which UTF-8 cannot.
    return _hash(json.dumps(data).encode("ascii"))


def _files(record: Mapping[str, Any] | None) -> dict[str, str]:
    """The hashes of a record by the names of files; empty without one."""
    files = {} if record is None else record.get(_FILES)
    names = files.items() if isinstance(files, dict) else ()
    return {name: value for name, value in names if FILE_NAME.fullmatch(name) and name not in FORMATS}


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
