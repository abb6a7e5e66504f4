"""What planning yields: a certified trajectory beside the baseline it is compared with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.errors import PathNotFound
from cmbot.planning.approach import Approach
from cmbot.planning.certificate import Certificate
from cmbot.planning.figures import MotionFigures, Samples, measure
from cmbot.planning.global_stage import Floor
from cmbot.planning.optimiser import PassReport
from cmbot.planning.task import ToolTask
from cmbot.planning.trajectory import QuinticTrajectory
from cmbot.planning.ways import Choice
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.scene.clearance import Clearances

__all__ = ["Plan", "Seconds", "Start"]


SAMPLE_STEP = 0.01
"""Step of the sampled motions, s."""


@dataclass(frozen=True, kw_only=True)
class Seconds:
    """Wall time of each stage, s."""

    path: float
    optimise: float
    certify: float
    total: float


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where a motion starts, and why not elsewhere.

    Attributes
    ----------
    posture : (n,), rad
    moved : float, rad
        Largest difference of a joint from the scene's posture; 0 when that is kept.
    failures : tuple of PathNotFound
        What happened from the scene's posture, then from the others that were tried.
    """

    posture: FloatArray
    moved: float
    failures: tuple[PathNotFound, ...]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A motion that keeps every promise of its certificate, and the baseline.

    Attributes
    ----------
    scene : Scene
    options : PlannerOptions
        What it was planned with.
    robot : Robot
    task : ToolTask
    start : Start
        Where the planned motion starts, and why, if not at the scene's posture.
    baseline : Samples
        The paper's motion without optimisation: Chang 2021, Eq. (22) integrated from the scene's posture; its
        acceleration and jerk are differences of its rates. It is a motion to compare with, not a plan: it may
        break limits, and when the planned motion had to start elsewhere it runs into something.
    baseline_figures : MotionFigures
    drift : float, m
        Largest distance of the baseline's tool point from where it should be at that time.
    smallest_singular_value : float
        Of the task Jacobian along the baseline.
    trajectory : QuinticTrajectory
        The planned motion.
    certificate : Certificate
    passes : tuple of PassReport
        How the optimiser came there.
    floor : Floor or None
        What no admissible plan can go below at rest; None with fixed knots.
    choice : Choice or None
        The global stage's peaks for both choices of the start; None with fixed knots.
    approach : Approach or None
        How the arm gets from the scene's posture to the start; None where it starts there, or where the knots
        are fixed.
    seconds : Seconds
    """

    scene: Scene
    options: PlannerOptions
    robot: Robot
    task: ToolTask
    start: Start
    baseline: Samples
    baseline_figures: MotionFigures
    drift: float
    smallest_singular_value: float
    trajectory: QuinticTrajectory
    certificate: Certificate
    passes: tuple[PassReport, ...]
    floor: Floor | None
    choice: Choice | None
    approach: Approach | None
    seconds: Seconds

    @property
    def figures(self) -> MotionFigures:
        """Figures of the planned motion, as certified."""
        return self.certificate.figures

    @cached_property
    def samples(self) -> Samples:
        """The planned motion every 0.01 s."""
        t = sample_times(self.trajectory.duration, SAMPLE_STEP)
        q, v, a, j = (self.trajectory.evaluate(t, order) for order in range(4))
        clearances = Clearances(self.robot, self.scene.obstacles)
        return measure(self.robot, self.task, clearances, t, (q, v, a, j))

    @property
    def largest_torque_difference(self) -> tuple[float, float]:
        """Largest value over time of baseline's less planned torque norm, Nm, and when, s."""
        baseline = np.linalg.norm(self.baseline.guardrail_torque, axis=1)
        planned = np.linalg.norm(self.samples.guardrail_torque, axis=1)
        difference = baseline - np.interp(self.baseline.t, self.samples.t, planned)
        k = int(difference.argmax())
        return float(difference[k]), float(self.baseline.t[k])

    @property
    def gap_to_floor(self) -> float | None:
        """How far the certified peak torque lies above the floor, as a share of it; None with fixed knots.

        A moving arm may undercut a static floor a little: then it is negative.
        """
        if self.floor is None:
            return None
        return self.figures.peak_guardrail_torque / self.floor.torque - 1.0

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
        pair = (self.baseline_figures, self.figures)
        for name, attribute, unit, factor, digits in _ROWS:
            left, right = (f"{factor * getattr(figures, attribute):.{digits}f}" for figures in pair)
            yield f"{name}, {unit}", left, right
        for limit in ("velocity", "acceleration", "jerk", "torque"):
            left, right = (f"{getattr(figures.limit_use, limit):.3f}" for figures in pair)
            yield f"joint {limit}, share of its bound", left, right


_ROWS = (
    ("peak torque on the guardrail", "peak_guardrail_torque", "Nm", 1.0, 2),
    ("mean torque on the guardrail", "mean_guardrail_torque", "Nm", 1.0, 2),
    ("peak of its gravity part", "peak_static_guardrail_torque", "Nm", 1.0, 2),
    ("smallest clearance", "min_clearance", "mm", 1e3, 1),
    ("largest tool deviation", "max_tool_deviation", "mm", 1e3, 3),
    ("largest tool rotation", "max_tool_rotation", "deg", float(np.rad2deg(1.0)), 3),
)


def sample_times(duration: float, step: float) -> FloatArray:
    """Return times from 0 to `duration` every `step` (the last one shorter if need be), s."""
    count = int(np.floor(duration / step * (1 + 1e-12)))
    t: FloatArray = step * np.arange(count + 1, dtype=np.float64)
    return t if duration - t[-1] < 1e-9 * duration else np.append(t, duration)
