"""Where else the arm may start: postures with the same tool pose, reached by self-motion.

"The manipulator should change its initial position" when a path fails (Chang 2021, Section 3.1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from cmbot.collision.clearance import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.common.validation import counted
from cmbot.planning.path.gradient_projection import JointPath, follow_path, place_on_task
from cmbot.planning.path.task import ToolTask
from cmbot.robot import Kinematics, Robot
from cmbot.scene.options import PlannerOptions

__all__ = ["find_path", "no_start_left", "self_motion_postures"]


# Self-motion is followed in steps of this length, rad, at most so many of them each way; every fourth posture
# is tried.
_STEP = 0.05
_MOST_STEPS = 400
_TRIED_EVERY = 4
# Step at which Eq. (22) is integrated to see whether a start is worth a proper look, s.
_COARSE_STEP = 0.05


def find_path(
    robot: Robot,
    task: ToolTask,
    posture: FloatArray,
    clearances: Clearances,
    options: PlannerOptions,
    tell: Callable[[int], None],
    steps: Callable[[int, int], None] | None = None,
) -> tuple[JointPath, tuple[PathNotFound, ...]]:
    """Follow the tool path from `posture`; where that fails, from others at the same tool pose.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
    posture : (n,), rad
    clearances : Clearances
    options : PlannerOptions
        ``other_starts`` bounds how many others are tried, the nearest first.
    tell : callable
        Called with the number of failures so far before each further try.
    steps : callable, optional
        Called with the number of steps of the path that are done, and of all.

    Returns
    -------
    JointPath
    tuple of PathNotFound
        What happened from the starts before, `posture` first; empty when that led to the end.

    Raises
    ------
    PathNotFound
        As from `posture`, when no start leads to the end of the path.
    """
    try:
        path = follow_path(robot, task, posture, clearances, options, tell=steps)
    except PathNotFound as error:
        failures = [error]
    else:
        return path, ()
    coarse = replace(options, path_step_s=max(options.path_step_s, _COARSE_STEP))
    for start in self_motion_postures(robot, task, posture)[: options.other_starts]:
        tell(len(failures))
        try:
            follow_path(robot, task, start, clearances, coarse)
            path = follow_path(robot, task, start, clearances, options, tell=steps)
        except PathNotFound as error:
            failures.append(error)
        else:
            return path, tuple(failures)
    moved = "the obstacle or the tool path" if failures[0].pair else "the tool path"
    raise no_start_left(failures, f"take another posture_deg, or move {moved}") from failures[0]


def no_start_left(failures: Sequence[PathNotFound], remedy: str = "") -> PathNotFound:
    """Return the first failure, with a word on the others, and on what to do where it does not say so."""
    first, others = failures[0], len(failures) - 1
    furthest = max(failure.progress for failure in failures)
    reason = first.reason
    if others:
        postures = counted(others, "other starting posture")
        fail = "fails" if others == 1 else "fail"
        reason += f"; {postures} {fail} as well (the best at {furthest:.0%} of the path)"
    if remedy:
        reason += f"; {remedy}"
    return PathNotFound(
        reason,
        time=first.time,
        progress=first.progress,
        smallest_singular_value=first.smallest_singular_value,
        pair=first.pair,
    )


def self_motion_postures(robot: Robot, task: ToolTask, posture: FloatArray) -> list[FloatArray]:
    """Return postures (n,) within the joint ranges that hold the task's start, nearest to `posture` first.

    They lie on the curves that lead from `posture` along each direction of the null space, both ways; with a
    full pose and seven joints that is all of the self-motion connected with it.
    """
    kinematics = Kinematics(robot)
    found: list[FloatArray] = []
    for direction in _null_space(kinematics, task, posture).T:
        for way in (direction, -direction):
            found += _follow_self_motion(robot, kinematics, task, posture, way)
    return sorted(found, key=lambda q: float(np.linalg.norm(q - posture)))


def _follow_self_motion(
    robot: Robot, kinematics: Kinematics, task: ToolTask, posture: FloatArray, direction: FloatArray
) -> list[FloatArray]:
    """Postures along one curve of self-motion, until a joint's range or the start again."""
    found: list[FloatArray] = []
    q = posture
    for step in range(1, _MOST_STEPS + 1):
        N = _null_space(kinematics, task, q)
        direction = N @ (N.T @ direction)
        length = np.linalg.norm(direction)
        if length < 1e-6:
            break
        direction = direction / length
        placed = place_on_task(kinematics, task, q + _STEP * direction, task.path.corners[0])
        if placed is None or (placed < robot.limits.lower).any() or (placed > robot.limits.upper).any():
            break
        q = placed
        if step > 2 and np.linalg.norm(q - posture) < _STEP:
            break
        if step % _TRIED_EVERY == 0:
            found.append(q)
    return found


def _null_space(kinematics: Kinematics, task: ToolTask, q: FloatArray) -> FloatArray:
    """Orthonormal basis (n, n - m) of the joint rates that leave the task alone."""
    X_WT, J = kinematics.tool_jacobian(q)
    J = task.jacobian(X_WT, J)
    return np.asarray(np.linalg.svd(J)[2][len(J) :].T)
