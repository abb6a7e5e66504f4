"""Progress drawn by rich: a bar on a terminal or in a notebook, and nothing elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column


class Report(Protocol):
    """What is being done, such as a `cmbot.planning.Progress`."""

    @property
    def step(self) -> str:
        """The step, in words; may be empty."""

    @property
    def share(self) -> float | None:
        """Of the step that is done, 0 to 1; None where unknown."""

    def sentence(self) -> str:
        """Return what is being done, in words."""


class ProgressDisplay:
    """A bar with what is being done, the time that it took so far and the time that it will still take.

    Parameters
    ----------
    console : rich.console.Console
        The bar is drawn where this is a terminal.
    quiet : bool
        Draw nothing.
    display : callable, optional
        IPython's function that shows something in a notebook's cell, where the bar is drawn instead.
    """

    def __init__(
        self, console: Console, *, quiet: bool = False, display: Callable[..., Any] | None = None
    ) -> None:
        # What does not fit is cut: a second line would stay on the terminal.
        description = Column(no_wrap=True, overflow="ellipsis", ratio=1)
        self._bars = Progress(
            SpinnerColumn(),
            BarColumn(bar_width=12),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.description}", markup=False, table_column=description),
            console=console,
            transient=True,
            expand=True,
            disable=quiet or not (console.is_terminal or display),
        )
        self._display = display
        self._cell: Any = None
        self._task = self._bars.add_task("", total=None)
        self._step = ""
        # What is drawn, with the share in percent.
        self._drawn: tuple[str, int | None] = ("", None)
        # Whether the bar is of all the work, not of the present step.
        self._whole = False

    def __enter__(self) -> Self:
        if self._display is None:
            self._bars.start()
        else:
            self._cell = self._display(self._bars, display_id=True)
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()
        if self._cell is not None:
            self._cell.update({"text/plain": "", "text/html": ""}, raw=True)

    def update(self, report: Report, prefix: str = "") -> None:
        """Show a report, after a prefix such as the scene's name."""
        if report.step != self._step and not self._whole:
            self._begin()
        self._step = report.step
        self._show(prefix + (report.step or report.sentence()), None if self._whole else report.share)

    def stage(self, description: str, share: float | None = None) -> None:
        """Show what is being done, and the share of all the work that is done, where it is known."""
        if share is not None and not self._whole:
            self._whole = True
            self._begin()
        self._show(description, share)

    def _begin(self) -> None:
        """Begin a bar, of a size that is not known yet."""
        self._bars.remove_task(self._task)
        self._task = self._bars.add_task("", total=None)

    def _show(self, description: str, share: float | None) -> None:
        done = None if share is None else round(100 * share)
        if (description, done) != self._drawn:
            self._drawn = description, done
            total = None if done is None else 100
            self._bars.update(self._task, description=description, total=total, completed=done, refresh=True)
            if self._cell is not None:
                self._cell.update(self._bars)
