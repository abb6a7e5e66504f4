"""Calls in a process that dies, or in which the system refuses, at the k-th step on the file system."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

import pytest

from cmbot.common.errors import ArchiveError

# What changes names; `pathlib` and `shutil` call these.
STEPS = ("chmod", "link", "mkdir", "rename", "replace", "rmdir", "unlink")


def dies_at(step: int, call: Callable[[], object]) -> bool:
    """Run a call in a process that is killed before its step number `step`, from 1; whether there was one.

    Steps are system calls that open for writing, write or change names; a file is killed after half of its
    content, too.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside threads: none is used there
        child = os.fork()
    if child == 0:
        status = 1
        try:
            with pytest.MonkeyPatch.context() as patch:
                _at(patch, step, lambda: os.kill(os.getpid(), signal.SIGKILL))
                call()
            status = 0
        finally:  # nothing of the parent's runs in it
            if status:
                traceback.print_exc(file=sys.__stderr__)
            os._exit(status)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status in (0, -signal.SIGKILL), f"step {step}: the call failed"
    return status != 0


def is_refused_from(step: int, call: Callable[[], object]) -> bool:
    """Run a call in a process for which the disk is full from its step on; whether there was one.

    What is written at that step, and after it, is refused; names may change. It has to raise `ArchiveError`,
    which says why in one line.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        status = 1
        try:
            with pytest.MonkeyPatch.context() as patch:
                _at(patch, step, _refuse, names=("mkdir",), once=False)
                call()
            status = 0
        except ArchiveError as error:
            text = str(error)
            if os.strerror(errno.ENOSPC) in text and "\n" not in text and len(text) <= 400:
                status = 3
        finally:
            if status == 1:
                traceback.print_exc(file=sys.__stderr__)
            os._exit(status)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status in (0, 3), f"step {step}: neither done nor refused"
    return status != 0


def _refuse() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def fails_at(step: int, call: Callable[[], object], error: BaseException) -> bool:
    """Run a call in which step number `step`, as those of `dies_at`, raises; whether there was one."""
    raised = []

    def fail() -> None:
        raised.append(step)
        raise error

    with pytest.MonkeyPatch.context() as patch:
        _at(patch, step, fail)
        try:
            call()
        except (ArchiveError, OSError, KeyboardInterrupt):
            assert raised
    return bool(raised)


def _at(
    patch: pytest.MonkeyPatch,
    step: int,
    end: Callable[[], None],
    *,
    names: Sequence[str] = STEPS,
    once: bool = True,
) -> None:
    """Let the calls on the file system end at a step, or from it on; of those on names only some."""
    steps = count(1)

    def reach() -> None:
        now = next(steps)
        if now == step or (now > step and not once):
            end()

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def stand_in(*args: Any, **options: Any) -> Any:
            reach()
            return function(*args, **options)

        return stand_in

    for name in names:
        patch.setattr(os, name, counted(getattr(os, name)))

    class HalfWritten(io.BufferedWriter):
        def write(self, content: Any) -> int:
            reach()
            half = len(content) // 2
            super().write(content[:half])
            self.flush()
            reach()
            return half + super().write(content[half:])

    open_file = io.open

    def open_counted(path: Any, mode: str = "r", *args: Any, **options: Any) -> Any:
        if not set(mode) & set("wxa+"):
            return open_file(path, mode, *args, **options)
        assert set(mode) <= set("wxab"), mode
        reach()
        return HalfWritten(open_file(path, mode, buffering=0))

    patch.setattr(io, "open", open_counted)
