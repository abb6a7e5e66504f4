"""Standard output and standard error of the command line, exit statuses, and signals."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from enum import IntEnum
from math import isfinite
from time import monotonic
from types import FrameType
from typing import Any, Self, TextIO

from rich.console import Console
from rich.control import Control
from rich.segment import ControlType
from rich.table import Table

from cmbot.common.errors import CmbotError, PlanningError, one_line
from cmbot.common.progress_display import ProgressDisplay
from cmbot.common.representation import aligned


class LostOutputError(CmbotError):
    """Standard output takes nothing more, such as on a full disk."""

    def __init__(self, error: OSError) -> None:
        got = f"a refusal of the system ({error.strerror})"
        super().__init__(f"standard output: got {got}, expected room for what is printed")


class _Output(Console):
    """A stream of the command line; a reader that has stopped, such as ``head``, does not stop the work."""

    _sign = False

    def show_sign(self, text: str) -> None:
        """Say on a terminal what has begun, until something else is shown; elsewhere nothing."""
        if self.is_terminal and not self.is_dumb_terminal:
            self.print(text, end="")
            self._sign = True

    def erase_sign(self) -> None:
        """Take that away."""
        if self._sign:
            self._sign = False
            self.print(Control(ControlType.CARRIAGE_RETURN, (ControlType.ERASE_IN_LINE, 2)), end="")

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does; what standard error does not take is lost."""
        err.erase_sign()
        try:
            super().print(*objects, **options)
        except OSError as error:
            if not self.stderr:
                raise LostOutputError(error) from error
            discard(sys.stderr)

    def on_broken_pipe(self) -> None:
        """Write nothing any more."""
        self.quiet = True
        discard(sys.stderr if self.stderr else sys.stdout)


def discard(stream: TextIO | None) -> None:
    """Let all that is still written to a standard stream be lost."""
    with suppress(OSError, ValueError, AttributeError):  # no stream, or one without a file
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())  # type: ignore[union-attr]
        os.close(nowhere)


# Without markup and emoji codes, so that file names are shown as they are.
out = _Output(soft_wrap=True, highlight=False, markup=False, emoji=False)
err = _Output(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)


@contextmanager
def scenes_named(*scenes: str) -> Iterator[None]:
    """Name in an error the scenes for which there is no plan, as they were called."""
    try:
        yield
    except PlanningError as error:
        error.add_source(", ".join(scenes))
        raise


class ExitStatus(IntEnum):
    """Exit statuses of the command line."""

    DONE, FAILED, BAD_INPUT, NO_PLAN, STOPPED = 0, 1, 2, 3, 130


def print_json(data: Mapping[str, Any]) -> None:
    """Print one JSON object; it is plain ASCII, so nothing in it can drive a terminal.

    JSON has no infinite numbers, such as the clearance without shapes: they are null.
    """
    summary = {"format": "", **data} | {"format": "cmbot-summary/1"}
    out.print(json.dumps(_finite(summary), indent=2, allow_nan=False))


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def print_lines(lines: Iterable[str]) -> None:
    """Print sentences, each in a line."""
    for line in lines:
        out.print(one_line(line))


def print_pairs(pairs: Mapping[str, str]) -> None:
    """Print names and values: a table on a terminal, aligned columns elsewhere."""
    print_table("", (), [(name, one_line(value)) for name, value in pairs.items()], text_columns=2)


def print_table(
    title: str, headings: Sequence[str], rows: Iterable[Sequence[str]], *, text_columns: int = 1
) -> None:
    """Print numbers behind some columns of text: a table on a terminal, aligned columns elsewhere.

    Without rows nothing is printed.
    """
    if not (rows := list(rows)):
        return
    lines = [headings, *rows] if headings else rows
    if out.is_terminal:
        table = Table(title=title or None, title_justify="left", show_header=bool(headings))
        for number, heading in enumerate(headings or [""] * text_columns):
            table.add_column(heading, justify="left" if number < text_columns else "right")
        for row in rows:
            table.add_row(*row)
        out.print(table)
        return
    if title:
        out.print(title)
    out.print(aligned(lines, text_columns, least=0))


# Seconds between lines of progress where no bar can be drawn.
_LINE_SECONDS = 30.0


class ConsoleProgress(ProgressDisplay):
    """Progress on standard error: a bar on a terminal, elsewhere a line now and then; signals are checked."""

    def __init__(self, *, quiet: bool = False) -> None:
        super().__init__(err, quiet=quiet)
        self._begun = self._told = monotonic()
        self._in_lines = not (quiet or err.is_terminal)

    def __enter__(self) -> Self:
        err.erase_sign()
        return super().__enter__()

    def __exit__(self, *error: object) -> None:
        super().__exit__(*error)
        if error[0] is None:
            check_signals()

    def _show(self, description: str, share: float | None) -> None:
        check_signals()
        super()._show(description, share)
        if self._in_lines and (now := monotonic()) >= self._told + _LINE_SECONDS:
            self._told = now
            done = "" if share is None else f" ({100 * share:.0f} %)"
            err.print(one_line(f"{now - self._begun:.0f} s: {description}{done}"))


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
