"""Progress on a stream: a moving line on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol, Self

from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, SpinnerColumn, Task, TextColumn
from rich.progress import Progress as Bars
from rich.text import Text

from cmbot.common.eta import Eta, Remaining

__all__ = ["ProgressLine", "Report"]

# Characters of a progress line before the description, without the time.
_BAR_WIDTH = 19
# Seconds between two lines of progress without a terminal.
_PRINT_INTERVAL = 10.0


class Report(Protocol):
    """What is being done, such as a `cmbot.planning.Progress`."""

    @property
    def step(self) -> str:
        """The step, in words; may be empty."""

    @property
    def share(self) -> float | None:
        """Of the step that is done, 0 to 1; None where unknown."""

    @property
    def left(self) -> Eta | None:
        """Time that the step will still take; None where unknown."""

    @property
    def rounds(self) -> int:
        """Number of the present round, 0 without rounds."""

    @property
    def failed_starts(self) -> int:
        """Attempts that failed so far."""

    def sentence(self, *, passes: bool = True) -> str:
        """Return what is being done, in words."""


class _Seconds(ProgressColumn):
    """The elapsed time and, where it can be estimated, the remaining time."""

    def __init__(self, text: Callable[[], str]) -> None:
        super().__init__()
        self._text = text

    def render(self, task: Task) -> Text:
        return Text(f"{self._text()} ·" if task.description else self._text())


class ProgressLine:
    """Progress on a stream: a moving line on a terminal, plain lines elsewhere.

    Parameters
    ----------
    console : rich.console.Console
    quiet : bool
        Print nothing.
    clock : callable
        Monotonic time, s.
    """

    def __init__(
        self, console: Console, *, quiet: bool = False, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._console = console
        self._quiet = quiet
        self._clock = clock
        self._began = self._printed = clock()
        self._description = ""
        self._bars: Bars | None = None
        # Of all the work, where its share is known.
        self._whole: Remaining | None = None
        # The last report on the present step, and when it came.
        self._step: tuple[Report, float] | None = None

    def __enter__(self) -> Self:
        if self._console.is_terminal and not self._quiet:
            self._bars = Bars(
                SpinnerColumn(),
                BarColumn(bar_width=12),
                _Seconds(self._seconds),
                TextColumn("{task.description}", markup=False),
                console=self._console,
                transient=True,
            )
            self._task = self._bars.add_task("", total=None)
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def update(self, progress: Report, prefix: str = "") -> None:
        """Show a report, after a prefix such as the scene's name."""
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

    def _say(self, text: str) -> None:
        self._console.out(text, highlight=False)

    def _show_share(self, bars: Bars, share: float | None) -> None:
        """Draw the bar; without a share it only moves."""
        if share is not None:
            bars.update(self._task, total=1.0, completed=share)

    def _describe(self, bars: Bars, description: str, refresh: bool = False) -> None:
        # Cut here: rich would wrap the columns before it.
        room = max(self._console.width - _BAR_WIDTH - len(self._seconds()), 10)
        shown = description if len(description) <= room else f"{description[: room - 1]}…"
        bars.update(self._task, description=shown, refresh=refresh or description != self._description)
        self._description = description

    def _print(self, description: str) -> None:
        if description != self._description:
            self._say(description)
            self._description, self._printed = description, self._clock()

    def _print_share(self, description: str) -> None:
        share, left = self._share(), self._left()
        if share is not None and self._clock() - self._printed >= _PRINT_INTERVAL:
            self._say(f"{description}: {share:.0%} done{f', {left}' if left else ''}")
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
