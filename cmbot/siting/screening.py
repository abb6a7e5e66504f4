"""Screening: what a stance asks at least at some via-points, by sampled postures, for thousands of stances.

The arm is the same in every stance; only its base is elsewhere. So all postures are found in the base's
frame, in a few large batches: near neighbours of the tool's pose in a table of random postures, put on the
task and moved along the self-motion to where the objective is less. Obstacles are left out, so a stance may
be blocked; joint ranges, joint torques and the feet's bounds count, and the velocities by which the joints
lead the tool through a posture at the path's own speed. The largest, over the via-points, of the smallest
value that was found is an estimate of the stance's lower bound from above.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning import ToolTask
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.siting.arm import BaseArm
from cmbot.siting.candidates import Candidate
from cmbot.siting.loads import StanceLoads

__all__ = ["Screening", "screen"]

# Via-points of a stroke at which all stances are screened.
_VIA_POINTS = 6
# Stances that are screened at once.
_AT_ONCE = 400


@dataclass(frozen=True, kw_only=True, eq=False)
class Screening:
    """What is known of C candidates for each of S strokes.

    Attributes
    ----------
    within_reach : (S, C)
        Whether the tool's places are within reach of the arm's links.
    bound : (S, C)
        What each asks at least, in the objective's unit; infinite where no posture was found.
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
    bound, torque, adhesion = np.where(within, -np.inf, np.inf), np.zeros(shape), np.zeros(shape)
    near = np.flatnonzero(within.any(axis=0))
    loads = StanceLoads(scene, [candidates[k] for k in near.tolist()], options, robot)
    number = np.cumsum(within.any(axis=0)) - 1  # among those within reach
    for s, task in enumerate(tasks):
        left = np.flatnonzero(within[s])
        for k, time in enumerate(_times(task, _VIA_POINTS).tolist()):
            for first in range(0, len(left), _AT_ONCE):
                some = left[first : first + _AT_ONCE]
                found = arm.least(task, time, bases[some], loads, number[some])
                for values, new in zip((bound, torque, adhesion), found, strict=True):
                    values[s, some] = np.maximum(values[s, some], new)
                report((s + (k + first / len(left)) / _VIA_POINTS) / len(tasks))
            left = left[np.isfinite(bound[s, left])]

    return Screening(within_reach=within, bound=bound, torque=torque, adhesion=adhesion)


def _within_reach(task: ToolTask, bases: FloatArray, robot: Robot) -> BoolArray:
    """Which bases (C, 4, 4) have all places of a stroke within reach of the arm's links."""
    points = task.path.position(_times(task, _VIA_POINTS))
    away = np.linalg.norm(points[:, None] - bases[:, :3, 3], axis=2)
    return np.asarray(((away <= robot.reach) & (away >= robot.inner_reach)).all(axis=0))


def _times(task: ToolTask, count: int) -> FloatArray:
    """Times (count,) of via-points from the beginning of a stroke to its end, s."""
    return np.linspace(0.0, task.path.duration, count)
