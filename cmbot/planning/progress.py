"""Progress reports of the planner."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from cmbot.common.errors import beyond
from cmbot.common.representation import ShortRepr
from cmbot.optimization.exchange import ExchangeReport

_STAGE_PHRASES = {"path": "following the tool path", "optimise": "optimising", "certify": "certifying"}
# A step's share is reported when it has risen by this.
_REPORTED_SHARE_STEP = 0.01

T = TypeVar("T")
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Progress(ShortRepr):
    """What the planner is doing.

    Attributes
    ----------
    stage : str
        ``path``, ``optimise`` or ``certify``.
    stroke : str
        Name of the stroke of several that is planned; empty where there is one.
    failed_starts : int
        Starting postures from which no path was found so far.
    report : ExchangeReport or None
        After each exchange iteration.
    unit : str
        Of its peak.
    step : str
        Of the stage, in words; may be empty.
    share : float or None
        Of the step that is done, 0 to 1. It never falls until another step begins; None where unknown.
    """

    stage: str
    stroke: str = ""
    failed_starts: int = 0
    report: ExchangeReport | None = None
    unit: str = "Nm"
    step: str = ""
    share: float | None = None

    def sentence(self) -> str:
        """Return the stage in words, and after an exchange iteration its peak and violation."""
        of = f"{self.stroke}: " if self.stroke else ""
        return of + self._sentence()

    def _sentence(self) -> str:
        text = _STAGE_PHRASES[self.stage]
        if self.failed_starts:
            text += f" from another start ({self.failed_starts} failed)"
        report = self.report
        if report is None:
            return text
        # What would print as 0.00 % is within the optimiser's tolerance.
        met = report.worst.value < 5e-5
        worst = f"{report.worst.name} {beyond(report.worst.value)}"
        return (
            f"{text}, pass {report.number} ({report.stage}): peak {self._peak(report)}, "
            f"{'all constraints met' if met else worst}"
        )

    def _peak(self, report: ExchangeReport) -> str:
        digits = ".2f" if self.unit == "Nm" else ".5g"
        return f"{report.peak_torque:{digits}} {self.unit}".rstrip()


class ProgressReporter:
    """Reports what the planner is doing; keeps the times of its stages.

    `progress` is called with a `Progress`; `clock` gives seconds that do not go back.
    """

    def __init__(
        self,
        progress: Callable[[Progress], None] | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._progress = progress or (lambda _: None)
        self._clock = clock
        self._stroke = ""
        self._now = Progress(stage="path")
        self._seconds = dict.fromkeys(_STAGE_PHRASES, 0.0)
        self._stage_began = clock()

    def begin_stroke(self, name: str) -> None:
        """Begin a stroke of several."""
        self._stroke = name
        self.stage("path")

    def stage(self, stage: str, *, failed_starts: int = 0) -> None:
        """Begin a stage."""
        now = self._clock()
        self._seconds[self._now.stage] += now - self._stage_began
        self._stage_began = now
        self._begin(Progress(stage=stage, stroke=self._stroke, failed_starts=failed_starts))

    def seconds(self) -> dict[str, float]:
        """Return the time of each stage so far, and ``total``, s."""
        seconds = dict(self._seconds)
        seconds[self._now.stage] += self._clock() - self._stage_began
        return {**seconds, "total": sum(seconds.values())}

    def step(self, step: str) -> None:
        """Begin a step of the stage of unknown duration."""
        if step != self._now.step:
            self._begin(self._fresh(step=step))

    def part(self, step: str, done: float, total: float) -> None:
        """Report how much of a step is done, in parts of about the same cost; its first part begins it."""
        share, told = min(max(done / total, 0.0), 1.0), self._now.share or 0.0
        if step != self._now.step or share >= told + _REPORTED_SHARE_STEP or told < share == 1.0:
            self._begin(self._fresh(step=step, share=share))

    def each(self, step: str, things: Sequence[T]) -> Iterator[T]:
        """Yield the things that a step handles, one after the other, and report its share."""
        for done, thing in enumerate(things):
            self.part(step, done, len(things))
            yield thing
        self.part(step, 1, 1)

    def passed(self, report: ExchangeReport, unit: str) -> None:
        """Report an exchange iteration; `unit` is that of its peak."""
        self._begin(Progress(stage="optimise", stroke=self._stroke, report=report, unit=unit))

    def _begin(self, progress: Progress) -> None:
        if _LOG.isEnabledFor(logging.DEBUG) and (progress.share is None or progress.step != self._now.step):
            _LOG.debug("%s", ": ".join(filter(None, (progress.sentence(), progress.step))))
        self._now = progress
        self._progress(progress)

    def _fresh(self, step: str, share: float | None = None) -> Progress:
        """Progress of a step of the present stage."""
        return replace(self._now, report=None, step=step, share=share)
