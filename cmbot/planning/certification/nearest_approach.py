"""The smallest clearance of a trajectory over all times, by subdivision with bounds on the motion.

Schwarzer, Saha and Latombe, "Adaptive dynamic collision checking for single and multiple articulated robots
in complex environments", 2005: within an interval no distance is smaller than in its middle, less the moves
of the joints from there times their reach. Where that is not enough for a pair the interval is halved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.trajectory import QuinticTrajectory, bernstein_coefficients, halves

# What coal's distances may be too large, m.
_DISTANCE_ERROR_M = 1e-6
# Distances that are less above a margin, m, are not told from it.
_MIN_ROOM_M = 5e-6
# Halvings of a segment at most, and intervals of one level; where they do not suffice the bound stays lower.
_MAX_SEGMENT_HALVINGS, _MOST_INTERVALS = 40, 20_000
# Pairs that are left for each interval where all of them are measured.
_MAX_LEFT_PAIRS = 2


@dataclass(frozen=True, kw_only=True)
class NearestApproach:
    """Where a motion comes nearest to an obstacle or to itself.

    Attributes
    ----------
    time : float, s
    distance : float, m
        The smallest that was found, at `time`; infinite where no pair counts, minus infinity where one is no
        number.
    pair : int
        Index into `Clearances.pairs`; -1 where none counts.
    bound : float, m
        No distance is smaller at any time.
    """

    time: float
    distance: float
    pair: int
    bound: float


def nearest_approach(
    trajectory: QuinticTrajectory, clearances: Clearances, resolution: float, margin: float = 0.0
) -> NearestApproach:
    """Enclose the smallest distance of any pair along a trajectory.

    Parameters
    ----------
    trajectory : QuinticTrajectory
    clearances : Clearances
    resolution : float, m
        How far the bound may lie below the smallest distance that was found.
    margin : float, m
        Where that distance keeps it and the bound does not, the bound is raised by a closer look.
    """
    found = _enclosed(trajectory, clearances, resolution)
    room = found.distance - margin
    if found.bound >= margin or room < _MIN_ROOM_M:
        return found
    return _enclosed(trajectory, clearances, 0.5 * room)


def _enclosed(trajectory: QuinticTrajectory, clearances: Clearances, resolution: float) -> NearestApproach:
    control = bernstein_coefficients(trajectory.coefficients)
    start, width = trajectory.t[:-1], np.diff(trajectory.t)
    reach = clearances.pair_reach
    nearest = NearestApproach(time=float(start[0]), distance=np.inf, pair=-1, bound=np.inf)
    if len(reach) == 0:
        return nearest
    alive = np.ones((len(start), len(reach)), dtype=np.bool_)
    bound = np.inf
    halving = 0
    while len(start):
        left, right = halves(control)
        q = left[..., -1]
        travel = np.abs(control - q[..., None]).max(axis=-1) @ reach.T
        middle = start + 0.5 * width
        if halving == 0:
            # Nothing is nearer than in the middles to begin with: what is found first rules out most.
            guide = clearances.query(q)
            nearest = _nearest(middle, _known(guide.distance), guide.pair)
        if alive.sum() > _MAX_LEFT_PAIRS * len(q):
            lower = clearances.lower_bounds(q) - travel
        else:
            # It takes longer to bound all distances than to measure these.
            lower = np.full(alive.shape, -np.inf)
        row, pair = np.nonzero(alive & ~(lower >= nearest.distance - resolution))
        measured = _known(clearances.distances(q, row, pair))
        lower[row, pair] = measured - travel[row, pair]
        if len(measured) and measured.min() < nearest.distance:
            nearest = _nearest(middle[row], measured, pair)
        undecided = alive & ~(lower >= nearest.distance - resolution)
        some = undecided.any(axis=1)
        if halving == _MAX_SEGMENT_HALVINGS or 2 * int(some.sum()) > _MOST_INTERVALS:
            undecided[:], some[:] = False, False
        bound = float(np.minimum(bound, lower[alive & ~undecided].min(initial=np.inf)))
        control = np.concatenate([left[some], right[some]])
        width = 0.5 * width[some]
        start = np.concatenate([start[some], start[some] + width])
        width = np.concatenate([width, width])
        alive = np.concatenate([undecided[some], undecided[some]])
        halving += 1
    return replace(nearest, bound=float(np.minimum(bound, nearest.distance)) - _DISTANCE_ERROR_M)


def _nearest(time: FloatArray, distance: FloatArray, pair: IntArray) -> NearestApproach:
    """The least of distances at times; by it alone nothing is bounded."""
    k = int(distance.argmin())
    return NearestApproach(time=float(time[k]), distance=float(distance[k]), pair=int(pair[k]), bound=0.0)


def _known(distance: FloatArray) -> FloatArray:
    """Distances, m; what is no number says nothing: it counts as less than any."""
    return np.where(np.isnan(distance), -np.inf, distance)
