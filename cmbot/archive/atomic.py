"""Folders and files that change at once, whatever stops the process.

Whoever changes ``NAME`` works beside it, in the hidden folder ``.NAME.cmbot-part``::

    lock    held by the process (flock); the system releases it when the process ends
    file    a file that is being written
    new     the next content of NAME; after the swap, the folder that NAME was before
    old     NAME between two renames, where the system cannot swap names
    names   of the files that are being written, where they are not those of a plan

`settle` brings these to rest. It runs when the work ends, and again in the next call on NAME, because a call
may be killed at any time.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import itertools
import os
import shutil
import time
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from cmbot.archive.names import OWN_FILES, is_own
from cmbot.common.errors import ArchiveError
from cmbot.common.input_files import require_replaceable

__all__ = ["exclusive", "put_file", "recover", "refusals", "replace_folder"]

_LOCK, _FILE, _NEW, _OLD, _NAMES = "lock", "file", "new", "old", "names"
# How often the lock is tried, and how long to wait in between, s: whoever reads may hold it for a moment.
_ATTEMPTS, _PAUSE = 20, 0.02

# linux/fcntl.h, linux/fs.h
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
# What renameat2 says where kernel, file system or a sandbox does not have it.
_NO_SWAP = (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP, errno.EPERM)

_held: ContextVar[frozenset[Path]] = ContextVar("held", default=frozenset())


@contextmanager
def exclusive(target: Path, attempts: int = _ATTEMPTS) -> Iterator[Path]:
    """Keep other processes and threads away from a target; yield the work folder beside it.

    Folders above the target are made as needed, and removed again if nothing is in them at the end. Inside
    another `exclusive` of the same target this does nothing.

    Parameters
    ----------
    target : Path
        Absolute and without links; it need not exist.
    attempts : int
        How often the lock is tried.

    Raises
    ------
    ArchiveError
        When another process has the target, the system refuses, or something cannot be brought to rest.
    """
    work = _work_folder(target)
    if target in _held.get():
        yield work
        return
    with ExitStack() as cleanup:
        with refusals(target):
            cleanup.callback(_remove_empty, [parent for parent in target.parents if not parent.exists()])
            lock = _Lock(work)
            cleanup.callback(lock.release)
            lock.acquire(target, attempts)
        cleanup.callback(_held.reset, _held.set(_held.get() | {target}))
        if put_back := _settle(work, target):
            text = f"{target}: a call was interrupted when it wrote there; put back: {', '.join(put_back)}"
            warnings.warn(text, stacklevel=2)
        try:
            yield work
        finally:
            _settle(work, target)


def recover(path: Path) -> None:
    """Bring to rest what a call that was killed has left of a target, unless another process has it.

    Where nothing can be written, or the path is impossible, nothing is done.
    """
    with suppress(OSError, RuntimeError, ValueError):  # an ArchiveError is a ValueError
        target = path.resolve()
        if _work_folder(target).exists():
            with exclusive(target, attempts=1):
                pass


def replace_folder(contents: Mapping[str, bytes], target: Path, keep: Collection[str] = ()) -> None:
    """Make a folder hold the files `contents` and, of a plan's files, those in `keep`: all at once.

    What is not the plan's, and of another name than `contents` has, stays in it. To be called inside
    `exclusive`.
    """
    with exclusive(target) as work, refusals(target):
        if others := contents.keys() - OWN_FILES:
            _write(work / _NAMES, "\n".join(sorted(others)).encode())
        new = work / _NEW
        new.mkdir()
        for name in keep:
            _link(target / name, new / name)
        # Each waits for the disk: all at once wait hardly longer than one.
        with ThreadPoolExecutor() as threads:
            list(threads.map(_write, [new / name for name in contents], contents.values()))
        _sync(new)
        if not target.exists():
            new.rename(target)
            _sync(target.parent)
            return
        shutil.copymode(target, new)
        _swap(new, target, work / _OLD)
        _sync(target.parent)
        # The folder itself gets the same files and its name back: shells and programs may be open in it, and
        # what is not the plan's has never left it.
        replaced = [path for path in new.iterdir() if is_own(path) or path.name in contents]
        # Large files take long to free.
        with ThreadPoolExecutor() as threads:
            list(threads.map(Path.unlink, replaced))
        for name in (*keep, *contents):
            _link(target / name, new / name)
        _sync(new)
        _swap(new, target, work / _OLD)
        _sync(target.parent)


def put_file(path: Path, content: bytes, work: Path) -> None:
    """Write a file into a work folder and move it to its place, where it replaces an earlier one."""
    require_replaceable(path, ArchiveError)
    part = work / _FILE
    _write(part, content)
    part.replace(path)
    _sync(path.parent)


@contextmanager
def refusals(directory: Path) -> Iterator[None]:
    """Turn an OSError into an ArchiveError."""
    try:
        yield
    except OSError as error:
        # What lies in hidden folders of ours says nothing to who called.
        named = error.filename and ".cmbot-" not in str(error.filename)
        where = f" at {error.filename}" if named else ""
        got = f"a refusal of the system ({error.strerror or error}{where})"
        raise ArchiveError(str(directory), "", got, "a place that can be written to") from error


def _work_folder(target: Path) -> Path:
    return target.with_name(f".{target.name}.cmbot-part")


# The lock


class _Lock:
    """A work folder and the lock in it.

    `release` undoes what `acquire` has done so far, also where a signal has interrupted it.
    """

    def __init__(self, work: Path) -> None:
        self._work, self._descriptor = work, -1

    def acquire(self, target: Path, attempts: int) -> None:
        """Make the folder and lock it, for what is done to a target."""
        for attempt in range(attempts):
            time.sleep(_PAUSE if attempt else 0.0)
            try:
                self._work.mkdir(parents=True, exist_ok=True)
                if self._take(os.O_CREAT):
                    return
            except (FileNotFoundError, FileExistsError):
                # The call that had the lock removes it at this moment; or, as in /proc, nothing can be made.
                if attempt + 1 < attempts:
                    continue
                got, expected = "a place where no file can be made", "a place that can be written to"
                raise ArchiveError(str(target), "", got, expected) from None
        expected = "one process at a time: wait until it has finished, or take another place"
        raise ArchiveError(str(target), "", "a place where another process is writing", expected)

    def release(self) -> None:
        """Remove lock and folder, unless another call has them."""
        with suppress(OSError):  # there is none
            if self._descriptor >= 0 or self._take():
                (self._work / _LOCK).unlink()
        with suppress(OSError):  # not empty: another call has it, or has taken it between the two
            self._work.rmdir()
        if self._descriptor >= 0:
            os.close(self._descriptor)

    def _take(self, flags: int = 0) -> bool:
        """Lock the file; return False where another call has it."""
        descriptor = os.open(self._work / _LOCK, os.O_RDWR | flags, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(descriptor), (self._work / _LOCK).stat()):
                self._descriptor = descriptor
        except BlockingIOError:
            pass
        finally:
            if self._descriptor != descriptor:
                os.close(descriptor)
        return self._descriptor >= 0


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # not empty, or never made
            folder.rmdir()


# What a call leaves


def _settle(work: Path, target: Path) -> list[str]:
    """Empty the work folder but for the lock; return what had to be put back to the target."""
    old, put_back = work / _OLD, list[str]()
    try:
        (work / _FILE).unlink(missing_ok=True)
        if old.exists() and not target.exists():
            old.rename(target)
            _sync(target.parent)
            put_back.append("the plan")
        names = work / _NAMES
        written = names.read_text(encoding="utf-8").split("\n") if names.exists() else []
        for folder in (work / _NEW, old):
            if folder.exists():
                put_back += _discard(folder, target, written)
        names.unlink(missing_ok=True)
    except OSError as error:
        got = f"remains of a call that cannot be cleared ({error.strerror} at {error.filename})"
        raise ArchiveError(str(work), "", got, "a folder that can be cleared, or to be moved away") from error
    return put_back


def _discard(folder: Path, target: Path, written: Collection[str]) -> list[str]:
    """Delete a folder; what is neither the plan's nor `written` goes to `target` and is named."""
    moved = []
    for path in sorted(folder.iterdir()):
        if is_own(path) or path.name in written:
            path.unlink()
        else:
            moved.append(_move(path, target))
    folder.rmdir()
    return moved


def _move(path: Path, target: Path) -> str:
    """Move something into the folder `target`, where nothing is replaced; return its name there."""
    if not target.is_dir():
        got = "a file that is not the plan's; the plan directory that it was in is gone"
        raise ArchiveError(str(path), "", got, "it to be moved elsewhere by hand")
    names = itertools.chain([path.name], (f"{path.name}.{number}" for number in itertools.count(1)))
    name = next(name for name in names if not os.path.lexists(target / name))
    path.rename(target / name)
    return name


# Names and files


def _swap(one: Path, other: Path, spare: Path) -> None:
    """Swap two names; by way of a third, `spare`, where that cannot be done at once."""
    if not _swap_at_once(one, other):
        other.rename(spare)
        _sync(spare.parent)
        one.rename(other)
        _sync(other.parent)
        spare.rename(one)


def _swap_at_once(one: Path, other: Path) -> bool:
    """Swap two names in one system call; return False where there is none."""
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if renameat2 is None:
        return False
    paths = (_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other))
    if renameat2(*paths, _RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in _NO_SWAP:
        return False
    raise OSError(code, os.strerror(code), str(other))


def _link(source: Path, place: Path) -> None:
    """Give a file a second name, or copy it where the file system has no links."""
    try:
        place.hardlink_to(source)
    except OSError:
        _write(place, source.read_bytes())


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
