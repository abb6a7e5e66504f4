"""Processor time inside one process, wall time of whole commands, the machine, and optional packages."""

from __future__ import annotations

import importlib
import math
import multiprocessing
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from importlib import metadata
from typing import Any, TypeVar, cast

from cmbot.common.errors import MissingExtra

__all__ = ["command", "in_a_child", "machine", "process_time", "required", "wall_time"]

Result = TypeVar("Result")
_PACKAGES = ("pin", "numpy", "scipy", "piqp", "casadi", "drake")


def process_time(action: Callable[[], Result], repeats: int = 3) -> tuple[float, Result]:
    """Shortest of several processor times, s, and what the last call returned."""
    return _shortest(action, repeats, time.process_time)


def wall_time(action: Callable[[], Result], repeats: int = 3) -> tuple[float, Result]:
    """Shortest of several wall times, s, and what the last call returned."""
    return _shortest(action, repeats, time.perf_counter)


def _shortest(action: Callable[[], Result], repeats: int, clock: Callable[[], float]) -> tuple[float, Result]:
    shortest = float("inf")
    for _ in range(repeats):
        begin = clock()
        result = action()
        shortest = min(shortest, clock() - begin)
    return shortest, result


def in_a_child(action: Callable[[], Result], seconds: float) -> Result | None:
    """Return what `action` returns in a child process; None when that took more than `seconds`.

    Seconds of processor time, for solvers that read no clock. The child is a copy of this process, so that
    nothing is loaded again.
    """
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)

    def limited() -> None:
        most = math.ceil(seconds)
        resource.setrlimit(resource.RLIMIT_CPU, (most, most))
        sender.send(action())

    child = context.Process(target=limited)
    child.start()
    sender.close()
    try:
        return cast(Result, receiver.recv())
    except EOFError:
        return None
    finally:
        child.join()


def command(*words: str) -> Callable[[], object]:
    """Return a call that runs Python with `words` in a fresh process.

    The first call compiles all modules into a folder of this process; later ones find them there, as a
    user's do, whatever the environment says about byte code.
    """
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    variables["PYTHONPYCACHEPREFIX"] = _compiled().name
    return lambda: subprocess.run([sys.executable, *words], check=True, capture_output=True, env=variables)


@cache
def _compiled() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory()


def machine() -> dict[str, object]:
    """What the figures depend on, and no name of a machine or a folder."""
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "packages": versions,
    }


def required(package: str) -> Any:
    """Import a package of the extra ``bench``.

    Raises
    ------
    MissingExtra
        When it is not installed.
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise MissingExtra(package, "bench") from error
