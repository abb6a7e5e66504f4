"""SIGINT and SIGTERM raise exceptions, which no library may turn into something else."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_raised: list[BaseException] = []


def take_signals() -> None:
    """Let SIGINT raise KeyboardInterrupt and SIGTERM SystemExit, so that half-written files are removed."""
    signal.signal(signal.SIGINT, _raise)
    signal.signal(signal.SIGTERM, _raise)
    sys.unraisablehook = _report_others


def check_signals() -> None:
    """Raise again what a signal raised where it was lost.

    It is lost in functions whose exceptions nobody receives, such as ``__del__``, and in the initialisation
    of some extension modules.
    """
    if _raised:
        raise _raised[-1]


def interrupt_taken() -> None:
    """Forget a Ctrl-C to which something answered; what else was raised stays."""
    _raised[:] = [each for each in _raised if not isinstance(each, KeyboardInterrupt)]


@contextmanager
def raised_again() -> Iterator[None]:
    """Raise what a signal raised in place of an error that a library made of it.

    pydantic, for one, reports a KeyboardInterrupt while it builds a model as a SchemaError.
    """
    done = False
    try:
        yield
        done = True
    finally:
        # Who handles the exception itself, such as a server that Ctrl-C stops, has done what was asked.
        if not done:
            check_signals()


def _raise(number: int, frame: FrameType | None) -> None:
    del frame
    _raised.append(KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number))
    raise _raised[-1]


def _report_others(lost: sys.UnraisableHookArgs) -> None:
    """Report an exception that nobody receives, unless `check_signals` raises it again."""
    if not any(lost.exc_value is each for each in _raised):
        sys.__unraisablehook__(lost)
