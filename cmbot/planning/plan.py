"""The plan: a certified trajectory beside the baseline that it is compared with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Literal

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.common.validation import require_type
from cmbot.elastic.sag import Sag
from cmbot.optimization import ExchangeReport, StateSamples
from cmbot.planning.context import bending_arm, end_posture_of, sag_of
from cmbot.planning.flexibility.sag_compensation import Compensation
from cmbot.planning.flexibility.vibration_suppression import VibrationSuppression
from cmbot.planning.free_motion.return_move import SAME_POSTURE
from cmbot.planning.free_motion.straight_move import quickest_straight
from cmbot.planning.initial_guess import Choice
from cmbot.planning.job import APPROACH, RETURN, Job, Segment, SegmentMetrics, job_metrics
from cmbot.planning.objectives import Objective
from cmbot.planning.selfmotion.lower_bound import LowerBound
from cmbot.planning.task import ToolTask
from cmbot.planning.verification.certificate import Certificate
from cmbot.planning.verification.metrics import MotionMetrics, Samples, figures, measure
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.trajectory import QuinticTrajectory

__all__ = ["ObjectiveMetrics", "Plan", "Seconds", "Start", "objective_metrics", "require_plan"]

# Step of the sampled motions, s.
_SAMPLE_STEP = 0.01
# Samples per segment at which the peak of an objective is taken that is not enclosed.
_PEAK_SAMPLES = 400


@dataclass(frozen=True, kw_only=True)
class Seconds:
    """Wall time of each stage, s."""

    path: float
    optimise: float
    certify: float
    total: float


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where a motion starts, and the starts that failed.

    Attributes
    ----------
    posture : (n,), rad, of joints that slide m
    moved : float, rad
        Largest difference of a joint from the scene's posture, of joints that slide in the units of
        `PostureMetric`; 0 when that is kept.
    failures : tuple of PathNotFound
        Of the scene's posture, then of the others that were tried.
    """

    posture: FloatArray
    moved: float
    failures: tuple[PathNotFound, ...]


@dataclass(frozen=True, kw_only=True)
class ObjectiveMetrics:
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
        Its largest value over each motion.
    floor : float or None
        Lower bound of its peak at rest; None with fixed knots.
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
        """How far the planned peak lies above the lower bound, as a share of it; None without one, or at 0.

        Negative where a moving arm undercuts the static bound a little.
        """
        return self.planned_peak / self.floor - 1.0 if self.floor else None

    @property
    def is_guardrail_torque(self) -> bool:
        """Whether it is the norm of the torque on the guardrail about O0, as metrics report it."""
        return not self.own and (self.name, self.moment_about, self.axis_weights) == (
            "torque",
            "foot",
            (1.0, 1.0, 1.0),
        )


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A motion whose certificate holds, and the baseline.

    Attributes
    ----------
    scene : Scene
    options : PlannerOptions
        What it was planned with.
    robot : Robot
    task : ToolTask
    start : Start
    baseline : Samples
        The paper's motion without optimisation: Chang 2021, Eq. (22) integrated from the scene's posture;
        its acceleration and jerk are central differences of its rates, with rest before and after, and its
        first and last acceleration are those of rest. It may break limits, and collides where the planned
        motion had to start elsewhere.
    baseline_figures : MotionMetrics
    drift : float, m
        Largest distance of the baseline's tool point from where it should be at that time.
    smallest_singular_value : float
        Of the task Jacobian along the baseline.
    job : Job
        The planned motion: the work; before it the approach, where the work starts elsewhere than the arm
        does; after it the return, where the scene asks for one.
    passes : tuple of ExchangeReport
        Exchange iterations of the optimisation.
    objective : ObjectiveMetrics
    lower_bound : LowerBound or None
        None with fixed knots.
    choice : Choice or None
        Peaks of the global search for both choices of the start; None with fixed knots.
    compensation : Compensation or None
        Of the predicted sag.
    quieting : VibrationSuppression or None
        None with fixed knots, where nothing bends, or unasked.
    sag : Sag or None
        The sag that was compensated.
    fallbacks : tuple of str
        What failed, and what was done instead, a sentence each.
    seconds : Seconds
    """

    scene: Scene
    options: PlannerOptions
    robot: Robot
    task: ToolTask
    start: Start
    baseline: Samples
    baseline_figures: MotionMetrics
    drift: float
    smallest_singular_value: float
    job: Job
    passes: tuple[ExchangeReport, ...]
    objective: ObjectiveMetrics
    lower_bound: LowerBound | None
    choice: Choice | None
    compensation: Compensation | None
    quieting: VibrationSuppression | None
    sag: Sag | None
    fallbacks: tuple[str, ...]
    seconds: Seconds

    @cached_property
    def baseline_return(self) -> Samples | None:
        """The baseline's return every 0.01 s, from time 0: the quickest straight joint motion within limits.

        It starts where the baseline ends; torques and collisions are ignored. None without a return.
        """
        start, end = self.baseline.q[-1], end_posture_of(self.scene, self.robot)
        if end is None or np.abs(end - start).max() <= SAME_POSTURE:
            return None
        robot = self.robot.tool_off
        t, motion = quickest_straight(robot.limits, start, end, _SAMPLE_STEP)
        clearances = Clearances(robot, self.scene.obstacles)
        return measure(robot, self.task.held_at_start(), clearances, t, motion)

    @cached_property
    def baseline_job_figures(self) -> MotionMetrics:
        """Figures of the baseline over the whole job: it begins where the arm is."""
        figures_of_work, back = self.baseline_figures, self.baseline_return
        parts = [
            SegmentMetrics(figures=figures_of_work, seconds=float(self.baseline.t[-1]), kind="stroke"),
        ]
        if back is not None:
            measured = figures(self.robot.tool_off, back)
            parts.append(SegmentMetrics(figures=measured, seconds=float(back.t[-1]), kind="free"))
        return job_metrics(parts)

    @property
    def work(self) -> Segment:
        """The stroke of the job."""
        return self.job.strokes[0]

    @property
    def trajectory(self) -> QuinticTrajectory:
        """The motion of the work."""
        return self.work.trajectory

    @property
    def certificate(self) -> Certificate:
        """The certificate of the work."""
        return self.work.certificate

    @property
    def figures(self) -> MotionMetrics:
        """Figures of the work, as certified."""
        return self.certificate.figures

    @property
    def approach(self) -> Segment | None:
        """The free move from the scene's posture to the start of the work.

        None where the work starts there, or where the knots are fixed.
        """
        return self.job.segment(APPROACH)

    @property
    def samples(self) -> Samples:
        """The work every 0.01 s, from time 0."""
        return self.segment_samples[self.work.name]

    @property
    def approach_samples(self) -> Samples | None:
        """The approach every 0.01 s, from time 0; its tool deviation is that from where the work starts."""
        return self.segment_samples.get(APPROACH)

    @cached_property
    def job_samples(self) -> tuple[Samples, tuple[str, ...]]:
        """The whole job every 0.01 s on one clock, and the name of each sample's segment.

        A join belongs to the segment that ends there. Where sag is compensated the tool is expected with its
        predicted sag in the free moves, too.
        """
        each = [self._on_the_clock(segment) for segment in self.job.segments]
        joined: dict[str, FloatArray | None] = {}
        for field in fields(Samples):
            arrays = [getattr(samples, field.name) for samples in each]
            first, *others = arrays
            joined[field.name] = (
                None if first is None else np.concatenate([first, *(array[1:] for array in others)])
            )
        # The first row of a later segment is the join.
        counts = [len(samples.t) - (k > 0) for k, samples in enumerate(each)]
        names = np.repeat([segment.name for segment in self.job.segments], counts)
        return Samples(**joined), tuple(names.tolist())  # type: ignore[arg-type]

    def _on_the_clock(self, segment: Segment) -> Samples:
        samples = self.segment_samples[segment.name]
        expected = samples.expected_tool_point
        if self.sag is not None and expected is None:
            # The tool is off: no process force bends the arm.
            sag = sag_of(self.scene, bending_arm(self.scene, self.robot.tool_off), self.options) or self.sag
            expected = samples.tool_point + sag.along(samples.t, samples.q)
        return replace(samples, t=segment.begin + samples.t, expected_tool_point=expected)

    @cached_property
    def segment_samples(self) -> dict[str, Samples]:
        """Each segment of the job by its name, every 0.01 s, from time 0."""
        clearances = Clearances(self.robot, self.scene.obstacles)
        return {segment.name: self._sampled(segment, clearances) for segment in self.job.segments}

    def _sampled(self, segment: Segment, clearances: Clearances) -> Samples:
        t = _sample_times(segment.duration)
        motion = [segment.trajectory.evaluate(t, order) for order in range(4)]
        at_work = segment.kind == "stroke"
        robot, sag = (self.robot, self.sag) if at_work else (self.robot.tool_off, None)
        return measure(robot, segment.task, clearances, t, motion, sag)

    @property
    def largest_torque_difference(self) -> tuple[float, float]:
        """Largest value over time of baseline's less planned torque norm, Nm, and when, s."""
        baseline = np.linalg.norm(self.baseline.guardrail_torque, axis=1)
        planned = np.linalg.norm(self.samples.guardrail_torque, axis=1)
        difference = baseline - np.interp(self.baseline.t, self.samples.t, planned)
        k = int(difference.argmax())
        return float(difference[k]), float(self.baseline.t[k])

    @property
    def torque_floor(self) -> float | None:
        """Lower bound of the torque on the guardrail, Nm; None with fixed knots or another objective."""
        return self.objective.floor if self.objective.is_guardrail_torque else None

    @property
    def torque_floor_kind(self) -> Literal["proven", "estimated"] | None:
        """Whether `torque_floor` is proven or estimated; None without one."""
        bound = None if self.torque_floor is None else self.lower_bound
        return None if bound is None else bound.kind

    @property
    def torque_floor_error(self) -> float | None:
        """How far the true value of `torque_floor` may lie below it, Nm; None without one."""
        bound = None if self.torque_floor is None else self.lower_bound
        return None if bound is None else bound.error

    @property
    def gap_to_floor(self) -> float | None:
        """How far the certified peak torque lies above its lower bound, as a share of it; None without one.

        Negative where a moving arm undercuts the static bound a little.
        """
        return self.objective.gap if self.objective.is_guardrail_torque else None

    @property
    def peak_static_reduction(self) -> float:
        """How much lower the planned motion's static torque peak is than the baseline's, as a share."""
        baseline = self.baseline_figures.peak_static_guardrail_torque
        return 1.0 - self.figures.peak_static_guardrail_torque / baseline

    def summary(self) -> str:
        """Return the figures as an aligned table of plain text."""
        rows = [("", "baseline", "planned"), *self.rows()]
        width = max(len(row[0]) for row in rows)
        return "\n".join(f"{name:<{width}}  {left:>12}  {right:>12}" for name, left, right in rows)

    def rows(self) -> Iterator[tuple[str, str, str]]:
        """Yield the figures, each as its name and unit, the baseline's value and the planned one."""
        work, job = (self.baseline_figures, self.figures), (self.baseline_job_figures, self.job.figures)
        for words, attribute, unit, factor, digits in _ROWS:
            part = "static" if self.robot.pushed else "gravity"
            name = words.format(base=self.scene.base_name, part=part)
            pair = job if "whole job" in name else work
            left, right = (f"{factor * getattr(figures, attribute):.{digits}f}" for figures in pair)
            yield f"{name}, {unit}", left, right
            if name == _PEAK_AT_WORK:
                yield from self._peaks_of_free_moves()
        duration = float(self.baseline.t[-1])
        if self.baseline_return is not None:
            duration += float(self.baseline_return.t[-1])
        yield "time of the whole job, s", f"{duration:.1f}", f"{self.job.duration:.1f}"
        for limit in ("velocity", "acceleration", "jerk", "torque"):
            left, right = (f"{getattr(figures.limit_use, limit):.3f}" for figures in work)
            yield f"joint {limit} at work, share of its bound", left, right

    def _peaks_of_free_moves(self) -> Iterator[tuple[str, str, str]]:
        back = self.baseline_return
        for segment in self.job.segments:
            if segment.kind == "free":
                baseline = "-"
                if segment.name == RETURN and back is not None:
                    baseline = f"{np.linalg.norm(back.guardrail_torque, axis=1).max():.2f}"
                name = f"peak torque on the {segment.name}, Nm"
                yield name, baseline, f"{segment.figures.peak_guardrail_torque:.2f}"


def objective_metrics(
    objective: Objective,
    options: PlannerOptions,
    *,
    own: bool,
    baseline: tuple[MotionMetrics, Samples],
    planned: tuple[MotionMetrics, QuinticTrajectory],
    floor: float | None,
) -> ObjectiveMetrics:
    """Evaluate an objective over both motions.

    Parameters
    ----------
    objective : Objective
    options : PlannerOptions
    own : bool
        It is a custom function, not the options' objective.
    baseline : MotionMetrics and Samples
    planned : MotionMetrics and QuinticTrajectory
        Of what is not the torque about the foot the peak is sampled.
    floor : float or None
    """
    (baseline_metrics, samples), (metrics, trajectory) = baseline, planned
    t = trajectory.t
    grid = np.append(np.linspace(t[:-1], t[1:], _PEAK_SAMPLES, endpoint=False, axis=1).ravel(), t[-1])

    def peak(of: MotionMetrics, t: FloatArray, q: FloatArray, v: FloatArray, a: FloatArray) -> float:
        if objective.reported:
            return of.peak_guardrail_torque
        return float(objective.values(StateSamples(t, q, v, a)).max())

    of_torque = not own and options.objective == "torque"
    return ObjectiveMetrics(
        name=objective.name,
        unit=objective.unit,
        own=own,
        moment_about=options.moment_about if of_torque else None,
        axis_weights=options.axis_weights if of_torque else None,
        baseline_peak=peak(baseline_metrics, samples.t, samples.q, samples.v, samples.a),
        planned_peak=peak(metrics, grid, *trajectory.states(grid)),
        floor=floor,
    )


def require_plan(value: object, source: str) -> None:
    """Refuse what is no plan, such as the path of a plan directory, as an argument of `source`.

    Raises
    ------
    InputError
    """
    require_type(value, Plan, source, "plan", "a Plan, as cmbot.plan and cmbot.load_plan return it")


_PEAK_AT_WORK = "peak torque at work"
_ROWS = (
    ("peak torque on the {base}, whole job", "peak_guardrail_torque", "Nm", 1.0, 2),
    (_PEAK_AT_WORK, "peak_guardrail_torque", "Nm", 1.0, 2),
    ("mean torque, whole job", "mean_guardrail_torque", "Nm", 1.0, 2),
    ("mean torque at work", "mean_guardrail_torque", "Nm", 1.0, 2),
    ("peak of its {part} part at work", "peak_static_guardrail_torque", "Nm", 1.0, 2),
    ("smallest clearance, whole job", "min_clearance", "mm", 1e3, 1),
    ("largest tool deviation", "max_tool_deviation", "mm", 1e3, 3),
    ("largest tool rotation", "max_tool_rotation", "deg", float(np.rad2deg(1.0)), 3),
)


def _sample_times(duration: float) -> FloatArray:
    """Return times from 0 to `duration` every 0.01 s (the last step shorter if need be)."""
    count = int(np.floor(duration / _SAMPLE_STEP * (1 + 1e-12)))
    t: FloatArray = _SAMPLE_STEP * np.arange(count + 1, dtype=np.float64)
    return t if duration - t[-1] < 1e-9 * duration else np.append(t, duration)
