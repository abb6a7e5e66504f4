"""Standard output and standard error of the command line, and the options that every long verb has."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, SpinnerColumn, Task, TextColumn
from rich.progress import Progress as Bars
from rich.table import Table
from rich.text import Text

from cmbot.common.eta import Remaining

if TYPE_CHECKING:
    from cmbot.planning import Progress

__all__ = [
    "ConsoleProgress",
    "JsonOption",
    "QuietOption",
    "err",
    "flat",
    "out",
    "print_json",
    "print_table",
]

# Without markup and emoji codes, so that file names are shown as they are.
out = Console(soft_wrap=True, highlight=False, markup=False, emoji=False)
err = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output instead of tables.")
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors (and JSON).")]

# Characters of a progress line before what is being done, but for the time.
_ROOM_OF_BAR = 19
# Where there is no terminal: a line at least every so many seconds where it is known how much is done, s.
_EVERY = 10.0


def flat(text: object) -> str:
    """Return one line of printable characters: messages and file names may hold anything."""
    return "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in str(text))


def print_json(data: Mapping[str, Any]) -> None:
    """Print one JSON object; it is plain ASCII, so nothing in it can drive a terminal."""
    out.print(json.dumps({"format": "cmbot-summary/1", **data}, indent=2, allow_nan=False))


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
    else:
        out.print(title)
        for line in _aligned([headings, *rows], text_columns):
            out.print(line)


def _aligned(rows: Sequence[Sequence[str]], text_columns: int) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for cells in rows:
        padded = (
            f"{cell:<{width}}" if number < text_columns else f"{cell:>{width}}"
            for number, (cell, width) in enumerate(zip(cells, widths, strict=True))
        )
        yield "  ".join(padded).rstrip()


class _Seconds(ProgressColumn):
    """How long it has taken; where there is a basis for it, about how long it will take still."""

    def __init__(self, told: Callable[[], str]) -> None:
        super().__init__()
        self._told = told

    def render(self, task: Task) -> Text:
        return Text(f"{self._told()} ·" if task.description else self._told())


class ConsoleProgress:
    """Tells what is being done: a moving line on a terminal, plain lines elsewhere, nothing if so wished.

    Parameters
    ----------
    quiet : bool
    clock : callable
        Seconds that do not go back.
    """

    def __init__(self, *, quiet: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self._quiet = quiet
        self._clock = clock
        self._began = self._printed = clock()
        self._said = ""
        self._bars: Bars | None = None
        # Of all there is to do, where that is known: of what is said with a share.
        self._whole: Remaining | None = None
        # Of the present step: what the planner told last, and when.
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

    def tell(self, progress: Progress, about: str = "") -> None:
        """Show one step of the planner, after what it is `about`."""
        before = self._step[0] if self._step is not None else None
        self._step = (progress, self._clock())
        if self._bars is not None:
            if self._whole is None:
                if before is None or progress.step != before.step:
                    self._bars.remove_task(self._task)
                    self._task = self._bars.add_task("", total=None)
                self._show_share(self._bars, progress.share)
            new_figure = progress.left is not None and (before is None or before.left is None)
            self._describe(self._bars, about + (progress.step or progress.sentence()), new_figure)
        elif not self._quiet:
            # Not every step of a whole, every start that fails, every pass of a round.
            if self._whole is None and not progress.step and progress.failed_starts <= 1:
                self._print(about + progress.sentence(passes=not progress.rounds))
            self._print_share(about + progress.step if self._whole is None else self._said)

    def say(self, what: str, share: float | None = None) -> None:
        """Show what is being done, and the share of all there is to do that is done, where that is known."""
        self._step = None
        if share is not None:
            self._whole = self._whole or Remaining(self._began)
            self._whole.note(share, self._clock())
        if self._bars is not None:
            self._show_share(self._bars, self._share())
            self._describe(self._bars, what)
        elif not self._quiet:
            self._print(what)
            self._print_share(what)

    def _show_share(self, bars: Bars, share: float | None) -> None:
        """Draw the bar; as long as no share is known it only moves."""
        if share is not None:
            bars.update(self._task, total=1.0, completed=share)

    def _describe(self, bars: Bars, what: str, refresh: bool = False) -> None:
        # Cut here: rich would rather wrap the columns before it.
        room = max(err.width - _ROOM_OF_BAR - len(self._seconds()), 10)
        shown = what if len(what) <= room else f"{what[: room - 1]}…"
        bars.update(self._task, description=shown, refresh=refresh or what != self._said)
        self._said = what

    def _print(self, what: str) -> None:
        """Print a line where there is something new to say."""
        if what != self._said:
            err.print(what)
            self._said, self._printed = what, self._clock()

    def _print_share(self, what: str) -> None:
        """Print every so often how much is done."""
        share, left = self._share(), self._left()
        if share is not None and self._clock() - self._printed >= _EVERY:
            err.print(f"{what}: {share:.0%} done{f', {left}' if left else ''}")
            self._printed = self._clock()

    def _seconds(self) -> str:
        """How long it has taken, and about how long it will take still."""
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
        if left is None or left.most is not None:
            return "" if left is None else left.sentence()
        return f"step: {left.sentence()}"
