"""Calls in a process that dies at its k-th step on the file system."""

from __future__ import annotations

import io
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

from cmbot.archive import atomic

# What changes names, or makes them outlast a power cut; `pathlib` and `shutil` call these.
STEPS = ("chmod", "fsync", "link", "mkdir", "rename", "replace", "rmdir", "unlink")


def dies_at(step: int, call: Callable[[], object], *, swaps: bool = True) -> bool:
    """Run a call in a process that is killed before its step number `step`, from 1; whether there was one.

    Steps are system calls that open for writing, write, change names or synchronise; a file is killed after
    half of its content, too. Without `swaps` the system seems to have no swap of names.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside threads: none is used there
        child = os.fork()
    if child == 0:
        _end_at(step, swaps)
        status = 1
        try:
            call()
            status = 0
        finally:  # nothing of the parent's runs in it
            if status:
                traceback.print_exc(file=sys.__stderr__)
            os._exit(status)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status in (0, -signal.SIGKILL), f"step {step}: the call failed"
    return status != 0


def _end_at(step: int, swaps: bool) -> None:
    """Make this process die at a step."""
    steps = count(1)

    def reach() -> None:
        if next(steps) == step:
            os.kill(os.getpid(), signal.SIGKILL)

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def stand_in(*args: Any, **options: Any) -> Any:
            reach()
            return function(*args, **options)

        return stand_in

    for name in STEPS:
        setattr(os, name, counted(getattr(os, name)))
    atomic._swap_at_once = counted(atomic._swap_at_once) if swaps else _no_swap

    class HalfWritten(io.BufferedWriter):
        def write(self, content: Any) -> int:
            reach()
            half = len(content) // 2
            super().write(content[:half])
            self.flush()
            reach()
            return half + super().write(content[half:])

    open_file, open_descriptor = io.open, os.open

    def open_counted(path: Any, mode: str = "r", *args: Any, **options: Any) -> Any:
        if not set(mode) & set("wxa+"):
            return open_file(path, mode, *args, **options)
        assert set(mode) <= set("wxb"), mode
        reach()
        return HalfWritten(open_file(path, mode, buffering=0))

    def open_descriptor_counted(path: Any, flags: int, *args: Any, **options: Any) -> int:
        if flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            reach()
        return open_descriptor(path, flags, *args, **options)

    io.open = open_counted  # type: ignore[assignment]
    os.open = open_descriptor_counted


def _no_swap(one: Path, other: Path) -> bool:
    del one, other
    return False
