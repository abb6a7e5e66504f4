"""The third goal: after the stop the tool hardly swings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning import Plan
from cmbot.reproduction.experiment import Experiment
from cmbot.reproduction.goal_table import GoalRow, GoalTable, Verdict, axes_where, values
from cmbot.simulation import Tracking

__all__ = ["rest_goal"]

# Share of the baseline's, per cent.
_GOAL = 5.0
_COLUMNS = ("x", "y", "z", "largest distance")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Case:
    """What the tool does after the stop, in (4,), m: extent along x, y, z and the largest distance."""

    setting: str
    plan: Plan
    stiffness: float
    before: FloatArray
    after: FloatArray

    @property
    def share(self) -> FloatArray:
        """Of the baseline's, (4,), per cent."""
        return np.asarray(100 * self.after / self.before)

    @property
    def missed(self) -> list[int]:
        return axes_where(self.share > _GOAL)

    def row(self) -> GoalRow:
        nominal = self.stiffness == 1.0
        return GoalRow(
            setting=self.setting if nominal else f"{self.setting}, stiffness times {self.stiffness:g}",
            what="share of the baseline's, %",
            values=values(self.share),
            goal=f"at most {_GOAL:g}" if nominal else "",
            holds=not self.missed if nominal else None,
        )

    def why(self) -> str:
        """Say why the goal is missed."""
        figures = ", ".join(
            f"{1e3 * self.after[k]:.4f} of {1e3 * self.before[k]:.3f} mm ({_COLUMNS[k]})" for k in self.missed
        )
        return f"More than that is left with {self.setting}: {figures}. {self._cause()}"

    def _cause(self) -> str:
        quieting = self.plan.quieting
        if quieting is None:
            return "No mode was quieted."
        if quieting.share < 1.0:
            return f"Of the change that quiets, only the share {quieting.share:g} kept the bounds."
        return (
            f"Of the {quieting.modes} modes that were quieted {2e3 * quieting.after:.4f} mm should be left: "
            "the rest swings in faster ones, or was not foreseen."
        )


def rest_goal(experiment: Experiment) -> GoalTable | None:
    """Compare what is left after the stop; None where the arm was not watched."""
    found = list(_cases(experiment))
    if not found:
        return None
    first = found[0]
    verdict = "holds" if not first.missed else "does not hold"
    mm = 1e3 * np.array([first.after[3], first.before[3]])
    told = (
        f"The planned motion leaves {mm[0]:.4f} mm instead of {mm[1]:.4f} mm (largest distance), "
        f"{first.share[3]:.2f} %, and along no axis more than {first.share[:3].max():.2f} %: the goal "
        f"{verdict}."
    )
    missed = (case.why() for case in found if case.stiffness == 1.0 and case.missed)
    return GoalTable(
        title="Rest: what is left after the stop",
        columns=_COLUMNS,
        rows=tuple(case.row() for case in found),
        remarks=(told, *missed, *_elsewhere(found)),
        verdicts=(
            Verdict(
                asked=f"after the stop at most {_GOAL:g} % of the swing left",
                found=f"{first.share.max():.1f} %",
                holds=not first.missed,
            ),
        ),
    )


def _elsewhere(found: list[_Case]) -> Iterator[str]:
    others = [case for case in found if case.stiffness != 1.0]
    if others:
        worst = max(others, key=lambda case: case.share[3])
        speed = np.sqrt(worst.stiffness)
        yield (
            f"At another stiffness the modes are not those that were quieted: up to {worst.share[3]:.1f} % "
            f"is left, {1e3 * worst.after[3]:.3f} of {1e3 * worst.before[3]:.3f} mm, at stiffness times "
            f"{worst.stiffness:g}, where they are about {speed:.2f} times as fast."
        )


def _cases(experiment: Experiment) -> Iterator[_Case]:
    run, loud, compensated = experiment.planned, experiment.loud, experiment.compensated
    yield from _case("no compensation", run.plan, run.equilibrium)
    for setting, variant in (("no compensation, quiet_modes: 0", loud), ("compensation", compensated)):
        if variant.plan is not None:
            for tracking in variant.trackings:
                yield from _case(setting, variant.plan, tracking)


def _case(setting: str, plan: Plan, tracking: Tracking) -> Iterator[_Case]:
    left, right = tracking.baseline.figures.residual, tracking.planned.figures.residual
    if left is None or right is None:
        return
    before, after = (np.append(found.peak_to_peak, found.diameter) for found in (left, right))
    yield _Case(
        setting=setting,
        plan=plan,
        stiffness=tracking.options.guardrail_factor,
        before=before,
        after=after,
    )
