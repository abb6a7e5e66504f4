"""Screening: bounds of thousands of stances, from sampled postures at some via-points.

The arm is the same in every stance; only its base is elsewhere. So all postures are found in the base's
frame, in a few large batches: near neighbours of the tool's pose in a table of random postures, put on the
task and moved along the self-motion to where the objective is less; more of them at the via-point of the
largest value, until that has been searched closely. Obstacles are left out, so a stance may be blocked; joint
ranges, joint torques and the feet's bounds count, and the velocities by which the joints lead the tool
through a posture at the path's own speed. The largest, over the via-points, of the smallest value that was
found is an estimate of the stance's lower bound from above.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning import ToolTask
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.stances.arm import CLOSELY, ROUGHLY, BaseArm, Effort
from cmbot.stances.candidates import Candidate
from cmbot.stances.loads import StanceLoads

# Via-points of a stroke at which all stances are screened.
_VIA_POINTS = 6
# Postures that are tried at once.
_AT_ONCE = 12_000
# The share of the time that the rough search takes.
_ROUGH = 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class Screening:
    """What is known of C candidates for each of S strokes.

    Attributes
    ----------
    within_reach : (S, C)
        Whether the tool's places are within reach of the arm's links.
    bound : (S, C)
        Bound of each, in the objective's unit; infinite where no posture was found.
    torque, adhesion : (S, C), Nm and N
        Largest torque and adhesion at rest in the postures of that bound.
    """

    within_reach: BoolArray
    bound: FloatArray
    torque: FloatArray
    adhesion: FloatArray


def screen(
    scene: Scene,
    robot: Robot,
    tasks: Sequence[ToolTask],
    candidates: Sequence[Candidate],
    options: PlannerOptions,
    report: Callable[[float], None] = lambda _: None,
) -> Screening:
    """Screen candidates.

    Parameters
    ----------
    scene : Scene
    robot : Robot
        In the scene's stance.
    tasks : sequence of ToolTask
        Of the strokes, in W.
    candidates : sequence of Candidate
    options : PlannerOptions
        The objective is ``torque`` or ``hold``.
    report : callable
        Takes the share that is done.
    """
    arm, shape = BaseArm(scene, robot), (len(tasks), len(candidates))
    bases = np.array([candidate.base for candidate in candidates]).reshape(-1, 4, 4)
    within = np.array([_within_reach(task, bases, robot) for task in tasks]).reshape(shape)
    figures = np.stack([np.full(shape, np.inf), np.zeros(shape), np.zeros(shape)])
    near = np.flatnonzero(within.any(axis=0))
    if not len(near):
        return Screening(within_reach=within, bound=figures[0], torque=figures[1], adhesion=figures[2])
    loads = StanceLoads(scene, [candidates[k] for k in near.tolist()], options, robot)
    number = np.cumsum(within.any(axis=0)) - 1  # among those within reach
    for s, task in enumerate(tasks):

        def told(share: float, done: int = s) -> None:
            report((done + share) / len(tasks))

        left = np.flatnonzero(within[s])
        stroke = _Stroke(arm=arm, task=task, bases=bases[left], loads=loads, number=number[left])
        figures[:, s, left] = stroke.bounded(told)
    bound, torque, adhesion = figures
    return Screening(within_reach=within, bound=bound, torque=torque, adhesion=adhesion)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stroke:
    """A stroke, and the bases (C, 4, 4) of the stances that have it within reach, with their numbers."""

    arm: BaseArm
    task: ToolTask
    bases: FloatArray
    loads: StanceLoads
    number: IntArray

    def bounded(self, report: Callable[[float], None]) -> FloatArray:
        """Largest over the via-points of the smallest objective, its torque and its adhesion, (3, C)."""
        K, C = _VIA_POINTS, len(self.bases)
        every = np.arange(C)
        found = np.empty((3, K, C))
        for k in range(K):
            found[:, k] = self._least(k, every, ROUGHLY)
            report(_ROUGH * (k + 1) / K)
        # What is not the largest may be as large as it is: only where most is asked it pays to look closely.
        closely = np.zeros((K, C), dtype=np.bool_)
        while True:
            worst = found[0].argmax(axis=0)
            open_ = ~closely[worst, every]
            if not open_.any():
                return found[:, worst, every]
            for k in range(K):
                some = np.flatnonzero(open_ & (worst == k))
                again = self._least(k, some, CLOSELY)
                better = again[0] < found[0, k, some]
                found[:, k, some[better]] = again[:, better]
                closely[k, some] = True
            report(_ROUGH + (1 - _ROUGH) * float(1 - open_.mean()))

    def _least(self, via_point: int, some: IntArray, effort: Effort) -> FloatArray:
        """Values of some of the stances at a via-point, (3, k)."""
        time = float(_times(self.task, _VIA_POINTS)[via_point])
        at_once = max(_AT_ONCE // (effort.tried * (1 + 2 * effort.walked)), 1)
        parts = [np.empty((3, 0))]
        for first in range(0, len(some), at_once):
            part = some[first : first + at_once]
            bases, number = self.bases[part], self.number[part]
            parts.append(self.arm.least(self.task, time, bases, self.loads, number, effort))
        return np.concatenate(parts, axis=1)


def _within_reach(task: ToolTask, bases: FloatArray, robot: Robot) -> BoolArray:
    """Which bases (C, 4, 4) have all places of a stroke within reach of the arm's links."""
    points = task.path.position(_times(task, _VIA_POINTS))
    away = np.linalg.norm(points[:, None] - bases[:, :3, 3], axis=2)
    return np.asarray(((away <= robot.reach) & (away >= robot.inner_reach)).all(axis=0))


def _times(task: ToolTask, count: int) -> FloatArray:
    """Times (count,) of via-points from the beginning of a stroke to its end, s."""
    return np.linspace(0.0, task.path.duration, count)
