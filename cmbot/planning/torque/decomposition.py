"""Long paths, stretch by stretch: cost in proportion to the path, however long it is.

Steps of one large problem are refused as a whole for what is violated anywhere, so the longer the path, the
smaller the steps. Where legs meet the tool rests, and the arm may rest as well: in the posture of the global
stage, with no acceleration and no jerk. What lies between two such rests is a problem of its own.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.trajectory.parametrization import Parametrization
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["LONGEST_WHOLE", "joined", "stretch_of", "stretches"]

LONGEST_WHOLE = 300
"""Paths of up to so many via-points are one stretch."""

# Longer ones are parted at the first corner after so many via-points, or a better one soon after.
_LEAST, _MOST = 100, 200


def stretches(problem: TorqueProblem) -> list[tuple[int, int]]:
    """Return the first and the last via-point of each stretch of a problem's path; short paths are one.

    Of the corners in reach a stretch ends at the one where the least is asked at rest.
    """
    last = len(problem.space.t) - 1
    if last + 1 <= LONGEST_WHOLE or not isinstance(problem.family, Parametrization):
        return [(0, last)]
    corners, parts, first = _corners(problem), [], 0
    while last - first > _MOST:
        candidates = corners[(corners >= first + _LEAST) & (corners <= last - _LEAST)]
        near = candidates[candidates <= first + _MOST]
        if len(candidates) == 0:
            break
        end = int(near[problem.at_via_points[near].argmin()] if len(near) else candidates[0])
        parts.append((first, end))
        first = end
    return [*parts, (first, last)]


def stretch_of(problem: TorqueProblem, first: int, last: int) -> TorqueProblem:
    """Return the problem of a stretch: at ends inside the path the arm rests in a posture that stays.

    Parameters
    ----------
    problem : TorqueProblem
        Of a family that has stretches, see `stretches`.
    first, last : int
        Via-points.
    """
    return TorqueProblem(
        problem.robot,
        problem.task,
        cast(Parametrization, problem.family).stretch(first, last),
        problem.clearances,
        problem.options,
        resting=(),
        floor=problem.floor,
        content=problem.floor,
        objective=problem.objective,
    )


def joined(trajectories: list[QuinticTrajectory]) -> QuinticTrajectory:
    """Put trajectories one behind the other; each begins at rest where and when the one before ends."""
    *some, last = trajectories

    def all_of(name: str) -> FloatArray:
        return np.concatenate([*(getattr(each, name)[:-1] for each in some), getattr(last, name)])

    return QuinticTrajectory(t=all_of("t"), q=all_of("q"), v=all_of("v"), a=all_of("a"))


def _corners(problem: TorqueProblem) -> IntArray:
    """Inner via-points at which legs meet; `ToolPath.via_times` puts one exactly there."""
    return np.flatnonzero(np.isin(problem.space.t, problem.task.path.leg_times[1:-1]))
