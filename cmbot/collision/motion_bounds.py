"""Bounds on changes of distances: no joint moves a point faster than its rate times the point's reach.

Of a joint that slides the reach is 1, and the joints before it reach as far as it goes within its range.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.robot import Robot, prismatic_joints, slide_axes

# When some point of the arm may have moved further than this, m, all pairs are measured again.
_MAX_MOVE_M = 0.1
# In postures nearer than this to the one before, m, it is worth measuring all pairs where the bounds leave
# more than this share of them.
_NEIGHBOUR, _UNBOUNDED_PAIR_SHARE = 0.3, 0.3
# Most postures that are compared with a measured one in one call. Where it bounds fewer than the second
# number, measuring all pairs does not pay.
_MAX_COMPARED_POSTURES, _MIN_BOUNDED_POSTURES = 64, 12


def shape_reach(model: Any, shapes: Sequence[Any]) -> FloatArray:
    """Largest distance (S, m), m, of any point of a shape from each joint of a serial chain that moves it.

    It is 1 of the joints that slide.
    """
    slides, axes = prismatic_joints(model), slide_axes(model)
    start = np.array([placement.translation for placement in model.jointPlacements])
    ends = [np.where(slides, end, 0.0) for end in (model.lowerPositionLimit, model.upperPositionLimit)]
    steps = [start + np.vstack([np.zeros((1, 3)), end[:, None] * axes]) for end in ends]
    offset = np.linalg.norm(steps, axis=2).max(axis=0)
    reach = np.zeros((len(shapes), model.nv))
    for k, shape in enumerate(shapes):
        joint = int(shape.parentJoint)
        if joint > 0:
            shape.geometry.computeLocalAABB()
            centre = shape.placement.act(shape.geometry.aabb_center)
            furthest = float(np.linalg.norm(centre)) + float(shape.geometry.aabb_radius)
            while joint > 0:
                reach[k, joint - 1] = 1.0 if slides[joint - 1] else furthest
                furthest += float(offset[joint])
                joint = int(model.parents[joint])
    return reach


def pair_reach(reach: FloatArray, joints: Sequence[int], pairs: Sequence[tuple[int, int]]) -> FloatArray:
    """Reach (P, m), m, of the joints in P pairs of S shapes, from their `shape_reach` and what carries each.

    No distance changes by more than the joints' moves times it; it is zero where a joint moves both shapes.
    """
    first = np.array([reach[i] for i, _ in pairs]).reshape(-1, reach.shape[1])
    still = np.array([joints[j] for _, j in pairs]).reshape(-1, 1)
    return np.where(np.arange(reach.shape[1]) >= still, first, 0.0)


def travel(q: FloatArray, reach: FloatArray) -> FloatArray:
    """Bound (N,), m, on the way of any point since a path's start; distances change by no more in between.

    Parameters
    ----------
    q : (N, n), rad
    reach : (n,), m
        `Clearances.reach`.
    """
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)) @ reach)])


def raise_bounds(distance: FloatArray, measured: BoolArray, covered: FloatArray) -> None:
    """Raise lower bounds on distances along a path by the measured samples before and after.

    Parameters
    ----------
    distance : (N,), m
        As measured, lower bounds elsewhere: these are raised in place.
    measured : (N,)
    covered : (N,), m
        `travel` of the path.
    """
    known = np.flatnonzero(measured)
    if len(known) == 0:
        return
    after = np.searchsorted(known, np.arange(len(distance)))
    for beside in (known[np.maximum(after - 1, 0)], known[np.minimum(after, len(known) - 1)]):
        lower = distance[beside] - np.abs(covered - covered[beside])
        np.maximum(distance, lower, out=distance, where=~measured)


class DistanceCache:
    """All P distances in the posture measured last, which bound those in postures near it by `pair_reach`."""

    def __init__(self, robot: Robot, geometry: Any, data: Any, reach: FloatArray) -> None:
        model, self._coupling = robot.model, robot.coupling
        self._arguments = (model, model.createData(), geometry, data)
        self._reach, self._furthest = reach, reach.max(axis=0, initial=0.0)
        # The list of references is read much faster than the results' own container.
        self._results = list(data.distanceResults)
        self._q, self._distance = np.full(robot.dof, np.nan), np.full(len(reach), np.nan)
        self._asked = self._q
        slides = prismatic_joints(model)
        self._slides = bool(slides.any())
        self._lower = np.where(slides, model.lowerPositionLimit, -np.inf)
        self._upper = np.where(slides, model.upperPositionLimit, np.inf)

    def lower_bounds(self, q: FloatArray) -> FloatArray:
        """Return lower bounds of all distances, (P,), m, in posture `q` (n,), rad."""
        move = np.abs(q - self._q)
        if self._drawn_out(q, self._q) or not move @ self._furthest <= _MAX_MOVE_M:
            self._measure(q)
            return self._distance.copy()
        return np.asarray(self._distance - self._reach @ move)

    def near(self, q: FloatArray, distance: float) -> list[int] | None:
        """Return the pairs that may be nearer than `distance`, m, in posture `q` (n,), nearest first.

        None where what was measured says too little, and `q` is not near the posture before either.
        """
        lower = self._distance - self._reach @ np.abs(q - self._q)
        before, self._asked = self._asked, q
        few = (lower <= distance).sum() <= _UNBOUNDED_PAIR_SHARE * len(lower)
        if not few or not np.isfinite(lower).all() or self._drawn_out(q, self._q):
            if not np.abs(q - before) @ self._furthest <= _NEIGHBOUR or self._drawn_out(q):
                return None
            self._measure(q)
            lower = self._distance
        near = np.flatnonzero(lower <= distance)
        return [int(pair) for pair in near[lower[near].argsort()]]

    def _measure(self, q: FloatArray) -> None:
        pin.computeDistances(*self._arguments, self._coupling.positions(q))
        self._q = q.copy()
        self._distance = np.array([result.min_distance for result in self._results])

    def suits(self, q: FloatArray) -> bool:
        """Whether postures `q` (N, n) follow each other so closely that measuring a few bounds all."""
        moved = float((np.abs(np.diff(q, axis=0)) @ self._furthest).sum())
        return not self._drawn_out(q) and moved * _MIN_BOUNDED_POSTURES <= _MAX_MOVE_M * len(q)

    def _drawn_out(self, *q: FloatArray) -> bool:
        """Whether a joint slides further than its range in any of postures (..., n): reaches hold no more."""
        every = map(self._coupling.positions, q)
        return self._slides and any(((each < self._lower) | (each > self._upper)).any() for each in every)

    def segments(self, q: FloatArray) -> Iterator[tuple[slice, FloatArray, FloatArray]]:
        """Yield segments of postures `q` (N, n), with lower and upper bounds (N', P) of distances."""
        first = 0
        while first < len(q):
            self.lower_bounds(q[first])
            move = np.abs(q[first : first + _MAX_COMPARED_POSTURES] - self._q)
            far = np.flatnonzero(move @ self._furthest > _MAX_MOVE_M)
            last = first + (int(far[0]) if len(far) else len(move))
            moved = move[: last - first] @ self._reach.T
            yield slice(first, last), self._distance - moved, self._distance + moved
            first = last
