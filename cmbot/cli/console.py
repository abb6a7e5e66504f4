"""Standard output and standard error of the command line, exit statuses, options that verbs share."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer
from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, SpinnerColumn, Task, TextColumn
from rich.progress import Progress as Bars
from rich.table import Table
from rich.text import Text

from cmbot.common.errors import CmbotError
from cmbot.common.errors import one_line as flat
from cmbot.common.eta import Remaining

if TYPE_CHECKING:
    from cmbot.planning import Progress

__all__ = [
    "ConsoleProgress",
    "ExitStatus",
    "FiguresOption",
    "JsonOption",
    "LostOutputError",
    "QuietOption",
    "discard",
    "err",
    "flat",
    "out",
    "print_json",
    "print_pairs",
    "print_result",
    "print_table",
]


class LostOutputError(CmbotError):
    """Standard output takes nothing more, such as on a full disk."""

    def __init__(self, error: OSError) -> None:
        got = f"a refusal of the system ({error.strerror})"
        super().__init__(f"standard output: got {got}, expected room for what is printed")


class _Output(Console):
    """A stream of the command line; a reader that has stopped, such as ``head``, does not stop the work."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does; what standard error does not take is lost."""
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

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output instead of tables.")
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors (and JSON).")]

FiguresOption = Annotated[
    bool, typer.Option("--figures", help="Draw plots as PNG and SVG into the plan directory, too.")
]

# Characters of a progress line before the description, without the time.
_BAR_WIDTH = 19
# Seconds between two lines of progress without a terminal.
_PRINT_INTERVAL = 10.0


class ExitStatus(IntEnum):
    """Exit statuses of the command line."""

    DONE, FAILED, BAD_INPUT, NO_PLAN, STOPPED = 0, 1, 2, 3, 130


def print_json(data: Mapping[str, Any]) -> None:
    """Print one JSON object; it is plain ASCII, so nothing in it can drive a terminal."""
    out.print(json.dumps({"format": "cmbot-summary/1", **data}, indent=2, allow_nan=False))


def print_result(verb: str, directory: Path, entries: Mapping[str, Any]) -> None:
    """Print as JSON what a verb wrote into a directory."""
    files = sorted(path.name for path in directory.iterdir())
    print_json({"verb": verb, "directory": str(directory), "files": files, **entries})


def print_pairs(pairs: Mapping[str, str]) -> None:
    """Print names and values: a table on a terminal, aligned columns elsewhere."""
    if out.is_terminal and pairs:
        table = Table(show_header=False)
        for name, value in pairs.items():
            table.add_row(name, flat(value))
        out.print(table)
        return
    for name, value in pairs.items():
        out.print(f"{name:<34}{flat(value)}")


def print_table(
    title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], *, text_columns: int
) -> None:
    """Print numbers behind some columns of text: a table on a terminal, aligned columns elsewhere."""
    if out.is_terminal:
        table = Table(title=title, title_justify="left")
        for number, heading in enumerate(headings):
            table.add_column(heading, justify="left" if number < text_columns else "right")
        for row in rows:
            table.add_row(*row)
        out.print(table)
        return
    widths = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    formats = [f"{'<' if number < text_columns else '>'}{width}" for number, width in enumerate(widths)]
    out.print(title)
    for cells in (headings, *rows):
        out.print("  ".join(map(format, cells, formats)).rstrip())


class _Seconds(ProgressColumn):
    """The elapsed time and, where it can be estimated, the remaining time."""

    def __init__(self, text: Callable[[], str]) -> None:
        super().__init__()
        self._text = text

    def render(self, task: Task) -> Text:
        return Text(f"{self._text()} ·" if task.description else self._text())


class ConsoleProgress:
    """Progress on standard error: a moving line on a terminal, plain lines elsewhere.

    Parameters
    ----------
    quiet : bool
        Print nothing.
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, *, quiet: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self._quiet = quiet
        self._clock = clock
        self._began = self._printed = clock()
        self._description = ""
        self._bars: Bars | None = None
        # Of all the work, where its share is known.
        self._whole: Remaining | None = None
        # The planner's last report on the present step, and when it came.
        self._step: tuple[Progress, float] | None = None

    def __enter__(self) -> ConsoleProgress:
        if err.is_terminal and not self._quiet:
            self._bars = Bars(
                SpinnerColumn(),
                BarColumn(bar_width=12),
                _Seconds(self._seconds),
                TextColumn("{task.description}", markup=False),
                console=err,
                transient=True,
            )
            self._task = self._bars.add_task("", total=None)
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def update(self, progress: Progress, prefix: str = "") -> None:
        """Show the planner's progress, after a prefix such as the scene's name."""
        before = self._step[0] if self._step is not None else None
        self._step = (progress, self._clock())
        if self._bars is not None:
            if self._whole is None:
                if before is None or progress.step != before.step:
                    self._bars.remove_task(self._task)
                    self._task = self._bars.add_task("", total=None)
                self._show_share(self._bars, progress.share)
            first_estimate = progress.left is not None and (before is None or before.left is None)
            self._describe(self._bars, prefix + (progress.step or progress.sentence()), first_estimate)
        elif not self._quiet:
            # Printed once: the steps of a whole, the failed starts, the iterations of a round.
            if self._whole is None and not progress.step and progress.failed_starts <= 1:
                self._print(prefix + progress.sentence(passes=not progress.rounds))
            self._print_share(prefix + progress.step if self._whole is None else self._description)

    def stage(self, description: str, share: float | None = None) -> None:
        """Show what is being done, and the share of all the work that is done, where it is known."""
        self._step = None
        if share is not None:
            self._whole = self._whole or Remaining(self._began)
            self._whole.note(share, self._clock())
        if self._bars is not None:
            self._show_share(self._bars, self._share())
            self._describe(self._bars, description)
        elif not self._quiet:
            self._print(description)
            self._print_share(description)

    def _show_share(self, bars: Bars, share: float | None) -> None:
        """Draw the bar; without a share it only moves."""
        if share is not None:
            bars.update(self._task, total=1.0, completed=share)

    def _describe(self, bars: Bars, description: str, refresh: bool = False) -> None:
        # Cut here: rich would wrap the columns before it.
        room = max(err.width - _BAR_WIDTH - len(self._seconds()), 10)
        shown = description if len(description) <= room else f"{description[: room - 1]}…"
        bars.update(self._task, description=shown, refresh=refresh or description != self._description)
        self._description = description

    def _print(self, description: str) -> None:
        if description != self._description:
            err.print(description)
            self._description, self._printed = description, self._clock()

    def _print_share(self, description: str) -> None:
        share, left = self._share(), self._left()
        if share is not None and self._clock() - self._printed >= _PRINT_INTERVAL:
            err.print(f"{description}: {share:.0%} done{f', {left}' if left else ''}")
            self._printed = self._clock()

    def _seconds(self) -> str:
        elapsed, left = self._clock() - self._began, self._left()
        return f"{elapsed:.0f} s, {left}" if left else f"{elapsed:.0f} s"

    def _share(self) -> float | None:
        if self._whole is not None:
            return self._whole.share
        return None if self._step is None else self._step[0].share

    def _left(self) -> str:
        now = self._clock()
        if self._whole is not None:
            left = self._whole.left(now)
            return "" if left is None else left.sentence()
        if self._step is None or self._step[0].left is None:
            return ""
        left = self._step[0].left.after(now - self._step[1])
        if left is None:
            return ""
        return left.sentence() if left.most is not None else f"step: {left.sentence()}"
