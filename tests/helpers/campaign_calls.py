"""What the tasks of the campaign's tests call: in processes of their own."""

import os
import resource
import signal
import sys
import time


def add(x: int, y: int) -> int:
    return x + y


def own_process() -> list[int]:
    """Return this process's number and the bytes that it may ask for, after a word to standard error."""
    # As without PYTHONUNBUFFERED: the part of a line stays in the stream.
    sys.stderr.reconfigure(write_through=False)  # type: ignore[union-attr]
    sys.stderr.write("said")
    return [os.getpid(), resource.getrlimit(resource.RLIMIT_AS)[0]]


def grow(megabytes: int) -> int:
    """Take so much memory more, which stays; return this process's number."""
    _taken.append(bytearray(os.urandom(1)) * (megabytes * 1_000_000))
    return os.getpid()


_taken = list[bytearray]()


def abort() -> None:
    os.abort()


def hang() -> None:
    time.sleep(100)


def refuse(reason: str) -> None:
    raise ValueError(reason)


def exhaust() -> None:
    raise MemoryError("all of it")


def end_worker() -> None:
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(100)


def leave() -> None:
    os._exit(0)
