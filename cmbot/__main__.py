"""``python -m cmbot`` and the command ``cmbot``: the command line."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import signal
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType

_INTERRUPTED_STATUS = 128 + signal.SIGINT
# Of the objects that are made between two searches for reference cycles. Importing makes some 200,000 that
# stay: with Python's own 700 it takes a fifth longer.
_OBJECTS_PER_COLLECTION = 250_000
# Of mallopt(3) in glibc: memory at the top beyond which it goes back to the system, and the size from which a
# block is mapped by itself. Arrays come and go; what has gone back comes again page by page, each zeroed.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = (-1, 2**30), (-3, 2**25)
_LEAST_ADDRESS_SPACE = 400_000_000  # byte
# SciPy imports all of NumPy: these parts, which nothing here uses, take half as long as NumPy itself.
_LAZY_MODULES = ("numpy.f2py", "numpy.testing")


class _WhenUsed:
    """Finds modules that are to be loaded when they are first used, not when they are imported."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in _LAZY_MODULES else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def main() -> None:
    """Run the command line; Ctrl-C during the imports ends it as quietly as later on."""
    signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED_STATUS))
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit not in (resource.RLIM_INFINITY, max(limit, _LEAST_ADDRESS_SPACE)):
        # With less BLAS tries without end to get some when it is imported.
        least = f"{_LEAST_ADDRESS_SPACE / 1e6:.0f} MB or more (ulimit -v)"
        sys.exit(f"error: memory: got a limit of {limit / 1e6:.0f} MB, expected {least}")
    gc.set_threshold(_OBJECTS_PER_COLLECTION)
    sys.meta_path.insert(0, _WhenUsed)
    if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
        for setting in (_TRIM_THRESHOLD, _MMAP_THRESHOLD):
            mallopt(*setting)
    # Matrices are small: the threads of BLAS would mostly wait for each other. Read when NumPy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # pydantic would look for plugins through all packages that are installed.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    from cmbot.cli import main as run, take_signals

    try:
        take_signals()
        run()
    except KeyboardInterrupt:
        # Before `run` could turn it into an exit status.
        sys.exit(_INTERRUPTED_STATUS)
    finally:
        # All is done: there is nothing left to stop.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    main()
