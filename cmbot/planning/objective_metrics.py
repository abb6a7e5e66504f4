"""The figures of what was made small: torque on the guardrail or not, they say how far it went."""

from __future__ import annotations

from dataclasses import dataclass

from cmbot.optimization.program import StateSamples
from cmbot.planning.objectives import Objective
from cmbot.planning.verification.metrics import MotionMetrics
from cmbot.scene import PlannerOptions

__all__ = ["ObjectiveMetrics", "objective_metrics"]


@dataclass(frozen=True, kw_only=True)
class ObjectiveMetrics:
    """What a plan made small, and how small.

    Attributes
    ----------
    name : str
        As in the options; of a function of someone's own, the name it has in Python.
    unit : str
        Of the figures; empty when nobody said.
    own : bool
        It is such a function: a file holds its name only, so its figures cannot be checked again.
    moment_about : str or None
    axis_weights : three floats or None
        As in the options; None where no torque is made small, and with a function of someone's own.
    baseline_peak, planned_peak : float
        Its largest value over each motion.
    floor : float or None
        What no admissible plan can go below at rest; None with fixed knots.
    """

    name: str
    unit: str
    own: bool
    moment_about: str | None
    axis_weights: tuple[float, float, float] | None
    baseline_peak: float
    planned_peak: float
    floor: float | None

    @property
    def gap(self) -> float | None:
        """How far the planned peak lies above the floor, as a share of it; None where there is none to share.

        A moving arm may undercut a static floor a little: then it is negative.
        """
        return self.planned_peak / self.floor - 1.0 if self.floor else None

    @property
    def is_guardrail_torque(self) -> bool:
        """Whether it is the norm of the torque on the guardrail about O0, as figures report it."""
        return not self.own and (self.name, self.moment_about, self.axis_weights) == (
            "torque",
            "foot",
            (1.0, 1.0, 1.0),
        )


def objective_metrics(
    objective: Objective,
    options: PlannerOptions,
    *,
    own: bool,
    baseline: tuple[MotionMetrics, StateSamples],
    planned: tuple[MotionMetrics, StateSamples],
    floor: float | None,
) -> ObjectiveMetrics:
    """Evaluate an objective over both motions.

    Parameters
    ----------
    objective : Objective
    options : PlannerOptions
    own : bool
        The objective is not the options'.
    baseline, planned : MotionMetrics and StateSamples
        The motions' figures, and the motions as finely sampled as these.
    floor : float or None
    """
    of_torque = not own and options.objective == "torque"
    return ObjectiveMetrics(
        name=objective.name,
        unit=objective.unit,
        own=own,
        moment_about=options.moment_about if of_torque else None,
        axis_weights=options.axis_weights if of_torque else None,
        baseline_peak=_peak(objective, *baseline),
        planned_peak=_peak(objective, *planned),
        floor=floor,
    )


def _peak(objective: Objective, figures: MotionMetrics, states: StateSamples) -> float:
    return figures.peak_guardrail_torque if objective.reported else float(objective.values(states).max())
