"""Standard output and standard error of the command line, and the options that every long verb has."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, SpinnerColumn, Task, TextColumn
from rich.progress import Progress as Bars
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from cmbot.planning import Progress

__all__ = [
    "JsonOption",
    "Narrator",
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

# Characters of a progress line before what is being done.
_ROOM_OF_BAR = 44
# Seconds of the past from which the remaining time is estimated.
_PAST = 600.0


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
    """How long it has taken; where the amount of work is known, about how long it will take still."""

    def render(self, task: Task) -> Text:
        elapsed, left = task.elapsed or 0.0, task.time_remaining
        known = task.total is not None and left is not None
        return Text(f"{elapsed:.0f} s, about {left:.0f} s left" if known else f"{elapsed:.0f} s")


class Narrator:
    """Tells what is being done: a moving line on a terminal, plain lines elsewhere, nothing if so wished.

    Parameters
    ----------
    quiet : bool
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet
        self._said = ""
        self._bars: Bars | None = None

    def __enter__(self) -> Narrator:
        if err.is_terminal and not self._quiet:
            self._bars = Bars(
                SpinnerColumn(),
                BarColumn(bar_width=16),
                _Seconds(),
                TextColumn("{task.description}", markup=False),
                console=err,
                transient=True,
                speed_estimate_period=_PAST,
            )
            self._task = self._bars.add_task("", total=None)
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def tell(self, progress: Progress, about: str = "") -> None:
        """Show one step of the planner, after what it is `about`."""
        if self._bars is not None or progress.failed_starts <= 1:
            self.say(about + progress.sentence())

    def say(self, what: str, share: float | None = None) -> None:
        """Show what is being done, and the share of all there is to do that is done, where that is known."""
        if self._bars is not None:
            if share is not None:
                self._bars.update(self._task, total=1.0, completed=share)
            # Cut here: rich would rather wrap the columns before it.
            room = max(err.width - _ROOM_OF_BAR, 10)
            shown = what if len(what) <= room else f"{what[: room - 1]}…"
            self._bars.update(self._task, description=shown, refresh=what != self._said)
        elif what != self._said and not self._quiet:
            err.print(what)
        self._said = what
