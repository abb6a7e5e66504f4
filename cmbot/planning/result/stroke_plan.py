"""What is planned of a stroke, beside the baseline that it is compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.common.reading.file_types import Count, NonNegative
from cmbot.common.representation import ShortRepr
from cmbot.optimization import ExchangeReport, StateSamples
from cmbot.planning.certification.metrics import MotionMetrics, Samples
from cmbot.planning.flexibility.sag_compensation import Compensation
from cmbot.planning.initial_guess import Choice
from cmbot.planning.selfmotion.lower_bound import LowerBound
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.objectives import Objective
from cmbot.scene import PlannerOptions, StrokeFile
from cmbot.toolpath import SpeedProfile
from cmbot.trajectory import QuinticTrajectory

T = TypeVar("T")

# Samples per segment at which the peak of an objective is taken that is not enclosed.
_PEAK_SAMPLES, _COARSE_SAMPLES = 400, 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Start(ShortRepr):
    """Where a motion starts, and the starts that failed.

    Attributes
    ----------
    posture : (n,), rad, of joints that slide m
    moved : float, rad
        Largest difference of a joint from the posture in which the arm was before, at first the scene's, of
        joints that slide in the units of `PostureMetric`; 0 when that is kept.
    failures : tuple of PathNotFound
        Of the scene's posture, then of the others that were tried.
    """

    posture: FloatArray
    moved: float
    failures: tuple[PathNotFound, ...]


@dataclass(frozen=True, kw_only=True)
class ObjectiveMetrics(ShortRepr):
    """The objective of a plan, and its peaks.

    Attributes
    ----------
    name : str
        As in the options; of a custom function, its name in Python.
    unit : str
        Of the peaks; empty when it is not known.
    own : bool
        It is a custom function: a file holds its name only, so its peaks cannot be checked again.
    moment_about : str or None
    axis_weights : three floats or None
        As in the options; None with another objective than torque.
    baseline_peak, planned_peak : float
        Its largest value over each motion; None without a baseline.
    floor : float or None
        Lower bound of its peak at rest; None with fixed knots, and near an earlier plan.
    """

    name: str
    unit: str
    own: bool
    moment_about: str | None
    axis_weights: tuple[NonNegative, NonNegative, NonNegative] | None
    baseline_peak: NonNegative | None
    planned_peak: NonNegative
    floor: NonNegative | None

    @property
    def gap(self) -> float | None:
        """How far the planned peak lies above the lower bound, as a share of it; None without one, or at 0.

        Negative where a moving arm undercuts the static bound a little.
        """
        return self.planned_peak / self.floor - 1.0 if self.floor else None

    @property
    def shown_unit(self) -> tuple[float, str]:
        """The factor from its unit to that in which it is told, and the latter."""
        return (1e3, "mm") if self.unit == "m" else (1.0, self.unit)

    @property
    def is_guardrail_torque(self) -> bool:
        """Whether it is the norm of the torque on the guardrail about O0, as metrics report it."""
        about_foot = self.moment_about == "foot" and self.axis_weights == (1.0, 1.0, 1.0)
        return not self.own and self.name == "torque" and about_foot


def baseline_task(task: ToolTask, file: StrokeFile, options: PlannerOptions) -> ToolTask:
    """Return the task that the baseline follows: the paper's motion has its trapezoid in place of quiet laws.

    Parameters
    ----------
    task : ToolTask
        Of the stroke as planned.
    file : StrokeFile
        Of the stroke.
    options : PlannerOptions
    """
    if options.baseline != "paper" or file.speed_profile.kind != "quiet" or file.is_open:
        return task
    # Leads belong to the process.
    legs = {number for number, leg in enumerate(task.path.segments) if leg.process is None}
    return replace(task, path=task.path.with_law(SpeedProfile().law, legs))


@dataclass(frozen=True, kw_only=True)
class StrokeBaseline(ShortRepr):
    """The motion along a stroke that the planned one is compared with: `PlannerOptions.baseline` says which.

    Eq. (22) of Chang 2021, or its part without the null space, integrated from the scene's posture, or from
    the posture nearest to where the baseline is before. It may break limits, and collides where the planned
    motion had to start elsewhere.

    Attributes
    ----------
    samples : Samples
        Acceleration and jerk are central differences of the rates, with rest before and after; the first and
        last acceleration are those of rest.
    figures : MotionMetrics
    drift : float, m
        Largest distance of its tool point from where it should be at that time.
    smallest_singular_value : float
        Of the task Jacobian along it.
    """

    samples: Samples
    figures: MotionMetrics
    drift: float
    smallest_singular_value: float

    @property
    def states(self) -> StateSamples:
        """Its states at the times of its samples."""
        samples = self.samples
        return StateSamples(samples.t, samples.q, samples.v, samples.a)


@dataclass(frozen=True, kw_only=True)
class StrokePlan(ShortRepr):
    """What is planned of a stroke, beside its baseline; its motion is a segment of the job.

    Attributes
    ----------
    name : str
        Of the stroke, and of its segment.
    task : ToolTask
    start : Start
    baseline : StrokeBaseline or None
        None where the options ask for none.
    passes : tuple of ExchangeReport
        Exchange iterations of the optimisation.
    objective : ObjectiveMetrics
    lower_bound : LowerBound or None
        None with fixed knots, and near an earlier plan.
    choice : Choice or None
        Peaks of the global search for both choices of the start; None as `lower_bound`.
    compensation : Compensation or None
        Of the predicted sag.
    runs : int
        Of optimise-and-certify that it took.
    """

    name: str
    task: ToolTask
    start: Start
    baseline: StrokeBaseline | None
    passes: tuple[ExchangeReport, ...]
    objective: ObjectiveMetrics
    lower_bound: LowerBound | None
    choice: Choice | None
    compensation: Compensation | None
    runs: Count


def combined(strokes: Sequence[StrokePlan]) -> dict[str, Any]:
    """Return what follows for a job from its strokes but the motions: fields of a `StrokePlan` by name.

    The largest peaks and bounds of all strokes: no admissible plan of the job rests below the largest
    lower bound of a stroke.
    """
    bounds = [stroke.lower_bound for stroke in strokes if stroke.lower_bound is not None]
    peaks = ("baseline_peak", "planned_peak", "floor")
    return {
        "task": strokes[0].task,
        "start": strokes[0].start,
        "passes": tuple(report for stroke in strokes for report in stroke.passes),
        "runs": sum(stroke.runs for stroke in strokes),
        "objective": _with_largest([stroke.objective for stroke in strokes], peaks),
        "lower_bound": _largest_bound(bounds) if bounds else None,
        "choice": _with_largest([stroke.choice for stroke in strokes]),
        "compensation": _with_largest([stroke.compensation for stroke in strokes]),
    }


def _with_largest(each: Sequence[T | None], names: Sequence[str] = ()) -> T | None:
    """The first of some records with the largest values of all, of these names or of all fields.

    What is missing in one is None. Without a record there is none.
    """
    known = [record for record in each if record is not None]
    if not known:
        return None
    first: Any = known[0]
    values = {name: [getattr(record, name) for record in known] for name in names or vars(first)}
    largest = {name: None if None in some else max(some) for name, some in values.items()}
    return cast("T", replace(first, **largest))


def _largest_bound(bounds: Sequence[LowerBound]) -> LowerBound:
    """The largest of the strokes' lower bounds, its via-point counted from the job's first one."""
    number = int(np.argmax([bound.value for bound in bounds]))
    via_point = sum(len(bound.each) for bound in bounds[:number]) + bounds[number].via_point
    return replace(bounds[number], via_point=via_point, each=np.concatenate([bound.each for bound in bounds]))


def _sampled_peak(objective: Objective, states: StateSamples) -> float:
    """The largest value: at every few samples, then at all of them next to what may be the largest."""
    times = len(states.t)
    some = np.append(np.arange(0, times - 1, _COARSE_SAMPLES), times - 1)
    values = objective.values(states[some])
    # Between two samples a value is above both by less than values differ from one to the next.
    near = some[values >= values.max() - np.abs(np.diff(values)).max(initial=0.0)]
    beside = np.unique(near[:, None] + np.arange(-_COARSE_SAMPLES, _COARSE_SAMPLES + 1))
    return float(objective.values(states[beside[(beside >= 0) & (beside < times)]]).max())


def objective_metrics(
    objective: Objective,
    options: PlannerOptions,
    *,
    own: bool,
    baseline: StrokeBaseline | None,
    planned: tuple[MotionMetrics, QuinticTrajectory],
    floor: float | None,
) -> ObjectiveMetrics:
    """Evaluate an objective over a motion, and over the baseline where there is one.

    Parameters
    ----------
    objective : Objective
    options : PlannerOptions
    own : bool
        It is a custom function, not the options' objective.
    baseline : StrokeBaseline or None
    planned : MotionMetrics and QuinticTrajectory
        Of what is not the torque about the foot the peak is sampled.
    floor : float or None
    """
    metrics, trajectory = planned

    def peak(of: MotionMetrics, at: StateSamples) -> float:
        return of.peak_guardrail_torque if objective.reported else _sampled_peak(objective, at)

    of_torque = not own and options.objective == "torque"
    return ObjectiveMetrics(
        name=objective.name,
        unit=objective.unit,
        own=own,
        moment_about=options.moment_about if of_torque else None,
        axis_weights=options.axis_weights if of_torque else None,
        baseline_peak=None if baseline is None else peak(baseline.figures, baseline.states),
        planned_peak=peak(metrics, StateSamples.even(trajectory, _PEAK_SAMPLES)),
        floor=floor,
    )
