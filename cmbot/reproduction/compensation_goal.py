"""Goal: with the predicted sag compensated the arm errs less, with the modelled stiffness and with others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning import Plan
from cmbot.reproduction.experiment import Variant, reduction
from cmbot.reproduction.tables import GoalRow, GoalTable, Verdict
from cmbot.simulation import Statistics, Tracking, statistics

__all__ = ["compensation_goal"]

# Least reductions, per cent: at the modelled stiffness, and at any other within this share of it.
_NOMINAL, _OTHER, _SHARE = 90.0, 65.0, 0.3
_ASKED = "sag compensated: errors"
# A smaller figure of the baseline, m, is not judged.
_SMALLEST = 1e-3
_TITLE = "Compensation: with the predicted sag compensated, where the baseline has more than 1 mm"
_COLUMNS = ("x", "y", "z")


def compensation_goal(variant: Variant) -> GoalTable:
    """Compare means and standard deviations at every stiffness that was simulated."""
    if variant.plan is None:
        remark = f"There is no plan: {variant.why_not}."
        none = Verdict(asked=f"{_ASKED} {_NOMINAL:g} % less", found="no plan", holds=False)
        return GoalTable(title=_TITLE, columns=_COLUMNS, rows=(), remarks=(remark,), verdicts=(none,))
    predicted = _predicted(variant.plan)
    cases = [
        _compared(tracking, name, predicted)
        for tracking in variant.trackings
        for name in ("mean", "standard deviation")
    ]
    judged = list(_judged(cases))
    reasons = (reason for case in cases for reason in case.reasons())
    return GoalTable(
        title=_TITLE,
        columns=_COLUMNS,
        rows=tuple(row for case in cases for row in case.rows()),
        remarks=(*(remark for _, remark in judged), *reasons, _off_path(variant)),
        verdicts=tuple(verdict for verdict, _ in judged),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Case:
    """One quantity at one stiffness; arrays are (3,)."""

    stiffness: float  # as a multiple of the modelled one
    name: str
    asked: BoolArray  # where the baseline's figure is large enough to be judged
    cut: FloatArray  # reduction, per cent
    ratio: FloatArray  # predicted sag of the planned motion over the baseline's figure at that stiffness
    vibration: FloatArray  # the same quantity of the dynamic part, m

    @property
    def goal(self) -> float:
        return _NOMINAL if self.stiffness == 1.0 else _OTHER

    @property
    def allowed(self) -> FloatArray:
        """Approximate bound of the reduction, (3,), per cent, if all error is sag.

        At stiffness f the sag is 1/f of the predicted one, so the share abs(1/f - 1) of the latter stays. The
        bound is approximate: the sag is not exactly 1/f, and vibration may cancel part of the rest.
        """
        return np.asarray(100 * (1 - abs(1 / self.stiffness - 1) * self.ratio))

    @property
    def judged(self) -> bool:
        """Whether the goal covers this stiffness."""
        return abs(self.stiffness - 1.0) <= _SHARE * (1 + 1e-9)

    @property
    def missed(self) -> BoolArray:
        return np.asarray(self.judged & self.asked & (self.cut < self.goal))

    def rows(self) -> Iterator[GoalRow]:
        setting, judged = f"stiffness times {self.stiffness:g}", self.judged and bool(self.asked.any())
        yield GoalRow(
            setting=setting,
            what=f"reduction of {self.name}, %",
            values=self._where_asked(self.cut),
            goal=f"at least {self.goal:g}" if judged else "",
            holds=not self.missed.any() if judged else None,
        )
        if self.stiffness != 1.0:
            bound = self._where_asked(self.allowed)
            yield GoalRow(setting=setting, what=f"approximate bound of {self.name}, %", values=bound)

    def reasons(self) -> Iterator[str]:
        for axis in np.flatnonzero(self.missed):
            found = (
                f"At stiffness times {self.stiffness:g} the {self.name} along {'xyz'[axis]} falls by "
                f"{self.cut[axis]:.1f} %"
            )
            if self.allowed[axis] < self.goal:
                yield (
                    f"{found}: {100 * abs(1 - self.stiffness):.0f} % of the sag was not predicted, and "
                    f"along this axis the planned motion's sag is {self.ratio[axis] / self.stiffness:.2f} "
                    f"times the baseline's {self.name}. That bounds the reduction at about "
                    f"{self.allowed[axis]:.1f} %."
                )
            else:
                yield (
                    f"{found}, the sag alone would allow {self.allowed[axis]:.1f} %: vibration has a "
                    f"{self.name} of {1e3 * abs(self.vibration[axis]):.3f} mm there."
                )

    def _where_asked(self, values: FloatArray) -> tuple[float | None, ...]:
        return tuple(float(x) if asked else None for asked, x in zip(self.asked, values, strict=True))


def _compared(tracking: Tracking, name: str, predicted: Statistics) -> _Case:
    attribute = name.replace(" ", "_")
    baseline, planned = tracking.baseline.metrics, tracking.planned.metrics
    before = np.abs(getattr(baseline.total, attribute)[:3])
    return _Case(
        stiffness=tracking.options.guardrail_factor,
        name=name,
        asked=before > _SMALLEST,
        cut=reduction(before, getattr(planned.total, attribute)[:3]),
        ratio=np.abs(getattr(predicted, attribute)[:3]) / before,
        vibration=getattr(planned.dynamic, attribute)[:3],
    )


def _predicted(plan: Plan) -> Statistics:
    """Of the predicted sag along the planned motion; zeros where the plan predicts none."""
    samples = plan.samples
    expected = samples.tool_point if samples.expected_tool_point is None else samples.expected_tool_point
    return statistics(samples.t, expected - samples.tool_point)


def _judged(cases: list[_Case]) -> Iterator[tuple[Verdict, str]]:
    """Yield verdict and sentence at the modelled stiffness, then at the others; none without figures."""
    for nominal, where, less in (
        (True, "At the modelled stiffness", f"{_NOMINAL:g} % less"),
        (False, f"At any other stiffness within {100 * _SHARE:g} % of it", f"{_OTHER:g} % less"),
    ):
        judged = [case for case in cases if case.judged and (case.stiffness == 1.0) == nominal]
        count = sum(int(case.asked.sum()) for case in judged)
        if not count:
            continue
        missed = sum(int(case.missed.sum()) for case in judged)
        found, goal = f"{count - missed} of {count} figures", "does not hold" if missed else "holds"
        asked = f"{_ASKED} {less}" + ("" if nominal else f", stiffness up to {100 * _SHARE:g} % off")
        yield (
            Verdict(asked=asked, found=found, holds=not missed),
            f"{where}, {found} are at least {less}; the goal {goal}.",
        )


def _off_path(variant: Variant) -> str:
    parts = []
    for tracking in variant.trackings:
        left, right = (motion.metrics.path.rms[3] for motion in (tracking.baseline, tracking.planned))
        stiffness = tracking.options.guardrail_factor
        parts.append(f"{1e3 * right:.2f} instead of {1e3 * left:.2f} at stiffness times {stiffness:g}")
    return f"Distance of the elastic arm's tool from its path, RMS, mm: {', '.join(parts)}."
