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

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning import ToolTask
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.siting.arm import BaseArm
from cmbot.siting.candidates import Candidate
from cmbot.siting.loads import StanceLoads

__all__ = ["Screening", "screen"]

# Via-points of a stroke at which all stances are screened, and of one that is checked for obstacles.
_VIA_POINTS, _CHECKED = 6, 12
# Stances that are screened at once.
_AT_ONCE = 400


@dataclass(frozen=True, kw_only=True, eq=False)
class Screening:
    """What is known of C candidates.

    Attributes
    ----------
    within_reach : (C,)
        Whether the tool's places are within reach of the arm's links.
    bound : (C,)
        What each asks at least, in the objective's unit; infinite where no posture was found.
    torque, adhesion : (C,), Nm and N
        Largest torque and adhesion at rest in the postures of that bound.
    times : (K,), s
        Of the via-points that were looked at, of each stroke from its beginning.
    clearing : callable
        From a candidate, clearances of its robot and a margin, m, to its bound by more postures, those too
        near to something left out; infinite where there is none at some via-point.
    """

    within_reach: BoolArray
    bound: FloatArray
    torque: FloatArray
    adhesion: FloatArray
    times: FloatArray
    clearing: Callable[[Candidate, Clearances, float], float]


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
    arm = BaseArm(scene, robot)
    count = len(candidates)
    bound, torque, adhesion = np.full(count, -np.inf), np.zeros(count), np.zeros(count)
    bases = np.array([candidate.base for candidate in candidates]).reshape(count, 4, 4)
    looks = [(task, float(t)) for task in tasks for t in _times(task, _VIA_POINTS)]
    within = np.ones(count, dtype=np.bool_)
    for task, time in looks:
        away = np.linalg.norm(task.path.position([time]) - bases[:, :3, 3], axis=1)
        within &= (away <= robot.reach) & (away >= robot.inner_reach)
    bound[~within] = np.inf
    left = np.flatnonzero(within)
    loads = StanceLoads(scene, [candidates[k] for k in left.tolist()], options, robot)
    number = np.cumsum(within) - 1  # among those within reach
    for done, (task, time) in enumerate(looks):
        for first in range(0, len(left), _AT_ONCE):
            some = left[first : first + _AT_ONCE]
            found = arm.least(task, time, bases[some], loads, number[some])
            bound[some] = np.maximum(bound[some], found[0])
            torque[some] = np.maximum(torque[some], found[1])
            adhesion[some] = np.maximum(adhesion[some], found[2])
            report((done + first / len(left)) / len(looks))
        left = left[np.isfinite(bound[left])]
    closer = [(task, float(t)) for task in tasks for t in _times(task, _CHECKED)]

    def clearing(candidate: Candidate, clearances: Clearances, margin: float) -> float:
        load = StanceLoads(scene, [candidate], options, robot)
        largest = 0.0
        for task, time in closer:
            q, value = arm.several(task, time, candidate.base, load)
            free = value[~clearances.check_collision(q, margin)]
            largest = max(largest, float(free.min(initial=np.inf)))
            if np.isinf(largest):
                break
        return largest

    return Screening(
        within_reach=within,
        bound=bound,
        torque=torque,
        adhesion=adhesion,
        times=np.array([time for _, time in looks]),
        clearing=clearing,
    )


def _times(task: ToolTask, count: int) -> FloatArray:
    """Times (count,) of via-points from the beginning of a stroke to its end, s."""
    return np.linspace(0.0, task.path.duration, count)
