"""The second goal: with the predicted sag compensated the arm errs less, its stiffness known or not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning import Plan
from cmbot.reproduction.experiment import Variant, reduction
from cmbot.reproduction.goal_table import GoalRow, GoalTable, Verdict, axes_where, values
from cmbot.simulation import Tracking
from cmbot.simulation.metrics import Statistics, statistics

__all__ = ["compensation_goal"]

# Per cent, with the stiffness that was planned with, and with any other within this share of it.
_NOMINAL, _WITHIN, _SHARE = 90.0, 65.0, 0.3
_ASKED = "sag compensated: errors"
# Where the baseline's figure is no larger than this, m, nothing is asked.
_WORTH = 1e-3
_QUANTITIES = (("mean", "mean"), ("standard deviation", "standard_deviation"))


def compensation_goal(variant: Variant) -> GoalTable:
    """Compare means and standard deviations at every stiffness that was simulated."""
    title = "Compensation: the same with the predicted sag compensated, where the baseline has more than 1 mm"
    if variant.plan is None:
        remark = f"There is no plan: {variant.why_not}."
        none = Verdict(asked=f"{_ASKED} {_NOMINAL:g} % less", found="no plan", holds=False)
        return GoalTable(title=title, columns=("x", "y", "z"), rows=(), remarks=(remark,), verdicts=(none,))
    found = [
        _compared(tracking, name, attribute, _predicted(variant.plan))
        for tracking in variant.trackings
        for name, attribute in _QUANTITIES
    ]
    rows = tuple(row for case in found for row in case.rows())
    judged = list(_judged(found))
    verdicts = tuple(_verdict(*each) for each in judged)
    told = (_told(*each) for each in judged)
    remarks = (*told, *(why for case in found for why in case.reasons()), _off_path(variant))
    return GoalTable(title=title, columns=("x", "y", "z"), rows=rows, remarks=remarks, verdicts=verdicts)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Case:
    """One quantity at one stiffness; arrays are (3,), cuts in per cent.

    Attributes
    ----------
    stiffness : float
        As a multiple of what was planned with.
    name : str
    asked : indices of the axes on which the baseline's figure is large enough
    cut : by how much it falls
    ratio : sag of the planned motion, as predicted, in units of the baseline's figure at that stiffness
    vibration : the same quantity of the dynamic part, m
    """

    stiffness: float
    name: str
    asked: list[int]
    cut: FloatArray
    ratio: FloatArray
    vibration: FloatArray

    @property
    def goal(self) -> float:
        return _NOMINAL if self.stiffness == 1.0 else _WITHIN

    @property
    def allowed(self) -> FloatArray:
        """What the reduction can be at most, (3,), per cent, if all is sag.

        At stiffness f the sag is 1/f of the predicted one, so the share abs(1/f - 1) of the latter stays. It
        is not quite 1/f, and vibration may make up for some of what stays: a bound of about this size.
        """
        return np.asarray(100 * (1 - abs(1 / self.stiffness - 1) * self.ratio))

    @property
    def judged(self) -> bool:
        """Whether the goal speaks of this stiffness."""
        return abs(self.stiffness - 1.0) <= _SHARE * (1 + 1e-9)

    @property
    def missed(self) -> list[int]:
        return [axis for axis in self.asked if self.cut[axis] < self.goal] if self.judged else []

    def rows(self) -> Iterator[GoalRow]:
        setting, what = f"stiffness times {self.stiffness:g}", f"reduction of {self.name}, %"
        cut, speaks = self._where_asked(self.cut), self.judged and bool(self.asked)
        yield GoalRow(
            setting=setting,
            what=what,
            values=cut,
            goal=f"at least {self.goal:g}" if speaks else "",
            holds=not self.missed if speaks else None,
        )
        if self.stiffness != 1.0:
            most = self._where_asked(self.allowed)
            yield GoalRow(setting=setting, what=f"bound of {self.name}, about, %", values=most)

    def reasons(self) -> Iterator[str]:
        for axis in self.missed:
            found = (
                f"At stiffness times {self.stiffness:g} the {self.name} along {'xyz'[axis]} falls by "
                f"{self.cut[axis]:.1f} %"
            )
            if self.allowed[axis] < self.goal:
                size = self.ratio[axis] / self.stiffness
                yield (
                    f"{found}: {100 * abs(1 - self.stiffness):.0f} % of the sag was not foreseen, and along "
                    f"this axis the planned motion's sag has {size:.2f} times the baseline's {self.name}. "
                    f"That bounds the reduction at about {self.allowed[axis]:.1f} %."
                )
            else:
                yield (
                    f"{found}, though the sag would let it fall by {self.allowed[axis]:.1f} %: vibration has "
                    f"a {self.name} of {1e3 * abs(self.vibration[axis]):.3f} mm there."
                )

    def _where_asked(self, numbers: FloatArray) -> tuple[float | None, ...]:
        return tuple(x if axis in self.asked else None for axis, x in enumerate(values(numbers)))


def _compared(tracking: Tracking, name: str, attribute: str, predicted: Statistics) -> _Case:
    baseline, planned = tracking.baseline.figures, tracking.planned.figures
    before = np.abs(getattr(baseline.total, attribute)[:3])
    return _Case(
        stiffness=tracking.options.guardrail_factor,
        name=name,
        asked=axes_where(before > _WORTH),
        cut=reduction(before, getattr(planned.total, attribute)[:3]),
        ratio=np.abs(getattr(predicted, attribute)[:3]) / before,
        vibration=getattr(planned.dynamic, attribute)[:3],
    )


def _predicted(plan: Plan) -> Statistics:
    """Of the predicted sag along the planned motion; zeros where the plan reckons with none."""
    samples = plan.samples
    expected = samples.tool_point if samples.expected_tool_point is None else samples.expected_tool_point
    return statistics(samples.t, expected - samples.tool_point)


def _judged(found: list[_Case]) -> Iterator[tuple[bool, int, int]]:
    """Yield whether it is the stiffness that was planned with, how many figures are asked, and missed."""
    for nominal in (True, False):
        cases = [case for case in found if case.judged and (case.stiffness == 1.0) == nominal]
        count = sum(len(case.asked) for case in cases)
        if count:
            yield nominal, count, sum(len(case.missed) for case in cases)


def _told(nominal: bool, count: int, missed: int) -> str:
    text = (
        f"At the stiffness that was planned with, at least {_NOMINAL:g} % less"
        if nominal
        else f"At any other within {100 * _SHARE:g} % of it, at least {_WITHIN:g} % less"
    )
    verdict = "the goal holds" if not missed else "the goal does not hold"
    return f"{text}: so it is for {count - missed} of {count} figures; {verdict}."


def _verdict(nominal: bool, count: int, missed: int) -> Verdict:
    less = (
        f"{_NOMINAL:g} % less" if nominal else f"{_WITHIN:g} % less, stiffness up to {100 * _SHARE:g} % off"
    )
    return Verdict(asked=f"{_ASKED} {less}", found=f"{count - missed} of {count} figures", holds=not missed)


def _off_path(variant: Variant) -> str:
    told = []
    for tracking in variant.trackings:
        left, right = (motion.figures.path.rms[3] for motion in (tracking.baseline, tracking.planned))
        stiffness = tracking.options.guardrail_factor
        told.append(f"{1e3 * right:.2f} instead of {1e3 * left:.2f} at stiffness times {stiffness:g}")
    return f"Off its path, whatever the plan expects, the bent tool is, RMS, mm: {', '.join(told)}."
