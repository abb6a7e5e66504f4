"""Other starting postures with the same tool pose, reached by self-motion.

"The manipulator should change its initial position" when a path fails (Chang 2021, Section 3.1).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.context import PlanningContext, no_start_left
from cmbot.planning.path.gradient_projection import JointPath, follow_path
from cmbot.planning.path.projection import null_space, project_onto_task

__all__ = ["find_path", "self_motion_postures"]


# Length of the steps along a self-motion, rad, and how many are taken each way; every fourth posture is
# tried.
_STEP = 0.05
_MOST_STEPS = 400
_TRIED_EVERY = 4
# Step of a first, coarse integration of Eq. (22) from another start, s.
_COARSE_STEP = 0.05


def find_path(context: PlanningContext) -> tuple[JointPath, tuple[PathNotFound, ...]]:
    """Follow the tool path from the scene's posture; where that fails, from others at the same tool pose.

    Parameters
    ----------
    context : PlanningContext
        Its option ``other_starts`` bounds how many others are tried, the nearest first.

    Returns
    -------
    JointPath
    tuple of PathNotFound
        Failures from the starts before, the scene's first; empty when that led to the end.

    Raises
    ------
    PathNotFound
        As from the scene's posture, when no start leads to the end of the path.
    """
    report = partial(context.reporter.part, "following the tool path")
    try:
        return follow_path(context, report=report), ()
    except PathNotFound as error:
        failures = [error]
    options = context.options
    step = max(options.path_step_s, _COARSE_STEP)
    coarse = replace(context, options=replace(options, path_step_s=step))
    for start in self_motion_postures(context)[: options.other_starts]:
        context.reporter.stage("path", failed_starts=len(failures))
        try:
            follow_path(coarse, start)
            return follow_path(context, start, report=report), tuple(failures)
        except PathNotFound as error:
            failures.append(error)
    moved = "the obstacle or the tool path" if failures[0].pair else "the tool path"
    raise no_start_left(failures, f"take another posture_deg, or move {moved}") from failures[0]


def self_motion_postures(context: PlanningContext) -> list[FloatArray]:
    """Return postures (n,) within the joint ranges that hold the task's start, the scene's nearest first.

    They lie on the curves that lead from the scene's posture along each direction of the null space, both
    ways; with a full pose and seven joints that is all of the self-motion connected with it. A curve ends at
    a joint's range, or where it comes back.
    """
    posture, limits, task = context.posture, context.robot.limits, context.task
    directions = null_space(context.postures, task, posture[None])[0]
    along = np.concatenate([directions, -directions])
    q = np.tile(posture, (len(along), 1))
    found: list[FloatArray] = []
    for step in range(1, _MOST_STEPS + 1):
        N = null_space(context.postures, task, q)
        along = np.einsum("kai,kaj,kj->ki", N, N, along)
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along /= np.maximum(length, 1e-6)
        q, follows = project_onto_task(
            context.postures, task, q + _STEP * along, task.path.corners[0], steps=50, tolerance=1e-12
        )
        follows &= length[:, 0] >= 1e-6
        follows &= ((q >= limits.lower) & (q <= limits.upper)).all(axis=1)
        if step > 2:
            follows &= np.linalg.norm(q - posture, axis=1) >= _STEP
        q, along = q[follows], along[follows]
        if len(q) == 0:
            break
        if step % _TRIED_EVERY == 0:
            found += list(q)
    return sorted(found, key=lambda q: float(np.linalg.norm(q - posture)))
