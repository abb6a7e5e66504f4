"""The smallest distances between the arm, the obstacles and the arm itself, by coal's GJK."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from cmbot.collision.broad_phase import BroadPhase, LowerBounds
from cmbot.collision.distance_cache import DistanceMemory
from cmbot.collision.distances import Nearest, ShapePair, Smallest
from cmbot.collision.motion_bounds import pair_reach, shape_reach, spread, way_covered
from cmbot.collision.shape_pairs import PairedShapes
from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.robot import Robot
from cmbot.scene import Obstacle

__all__ = ["Clearances", "Nearest", "ShapePair", "Smallest"]


# In fewer postures the broad phase is not worth its calls: benchmarks/kernels.py.
_FEW = 24
# Of so many neighbouring postures one is looked at first.
_TOGETHER = 8
# Samples of a path from one look to the next, from coarse to fine; of fewer than these all are looked at.
_STRIDES, _SHORT = (16, 4, 1), 200
# Rounding that the choice of near pairs allows for, m.
_SLACK = 1e-9
# GJK's default of 1e-6 m would blur the derivatives; this costs nothing that can be measured. EPA, which
# takes over in deep overlaps, keeps its default: asked for more it fails now and then.
_GJK_TOLERANCE = 1e-10

_T = TypeVar("_T")


class Clearances:
    """Distances of a robot's moving shapes to obstacles and to its own other shapes.

    It owns working memory, so it is not to be shared between threads.

    Parameters
    ----------
    robot : Robot
    obstacles : sequence of Obstacle
        Placed in W. A mesh counts as the convex hulls of its connected parts: its clearance is never
        overestimated.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Obstacle]) -> None:
        self._model = robot.model
        paired = PairedShapes(robot, obstacles)
        self.pairs = paired.pairs
        self._geometry, self._shapes, self._joints = paired.geometry, paired.shapes, paired.joints
        self._data = robot.model.createData()
        self._geometry_data = pin.GeometryData(self._geometry)
        for request in self._geometry_data.distanceRequests:
            request.gjk_tolerance = _GJK_TOLERANCE
        _forget_guesses([*self._geometry_data.distanceRequests, *self._geometry_data.collisionRequests])
        shapes = list(self._geometry.geometryObjects)
        reach = shape_reach(self._model, shapes)
        self.reach = reach.max(axis=0, initial=0.0)
        self._broad_phase = BroadPhase(robot, shapes, self._shapes)
        between = pair_reach(reach, self._joints, self._shapes)
        self._memory = DistanceMemory(self._model, self._geometry, self._geometry_data, between)
        self._nothing = np.zeros(len(self.pairs), dtype=np.bool_)
        self._unavoidable = np.array([pair.of_arm or pair.at_work for pair in self.pairs], dtype=np.bool_)
        self._any_avoidable = not self._unavoidable.all()
        self._margin = np.nan

    def smallest(self, q: FloatArray, *, avoidable_only: bool = False) -> Smallest:
        """Return the smallest distance in each of the postures `q` (N, n).

        Quickest for many postures in one call, or for one that is near the last.

        Parameters
        ----------
        q : (N, n), rad
        avoidable_only : bool
            Leave out the arm with itself and the tool with a workpiece, as H of Eq. (17) does here.
        """
        left_out = self._unavoidable if avoidable_only else self._nothing
        if len(self._unavoidable) == 0 or (avoidable_only and not self._any_avoidable):
            return Smallest(distance=np.full(len(q), np.inf), pair=np.full(len(q), -1, dtype=np.intp))
        # Of shapes that are nowhere coal would say that they touch.
        distance, pair = np.full(len(q), np.nan), np.full(len(q), -1, dtype=np.intp)
        if len(q) < _FEW:
            for k, q_k in enumerate(q):
                if np.isfinite(q_k).all():
                    distance[k], pair[k] = self._least_at(q_k, left_out)
        else:
            known: BoolArray = np.all(np.isfinite(q), axis=1)
            distance[known], pair[known] = self._least_of(q[known], left_out)
        return Smallest(distance=distance, pair=pair)

    def along(self, q: FloatArray, spare: float) -> FloatArray:
        """Return the smallest distance at every sample of a path, (N,), m, exactly where it matters.

        Where it is certainly more than `spare`, m, above the path's smallest, a lower bound that is so, too,
        stands in its place: no distance changes faster than the joints move times their reach.

        Parameters
        ----------
        q : (N, n), rad
        spare : float, m
        """
        N = len(q)
        if N < _SHORT:
            return self.smallest(q).distance
        covered = way_covered(q, self.reach)
        distance, looked = np.full(N, -np.inf), np.zeros(N, dtype=np.bool_)
        for stride in _STRIDES:
            # Not "<=": what is no number is looked at, too.
            least = distance[looked].min(initial=np.inf)
            asked = np.flatnonzero(~looked & ~(distance > least + spare))
            asked = asked[(asked % stride == 0) | (asked == N - 1)]
            looked[asked] = True
            distance[asked] = self.smallest(q[asked]).distance
            spread(distance, looked, covered)
        return distance

    def too_near(self, q: FloatArray, margin: float) -> BoolArray:
        """Return which of the postures `q` (N, n) have any distance below `margin`, m, in any order."""
        if margin != self._margin:
            for request in self._geometry_data.collisionRequests:
                request.security_margin = margin
            self._margin = margin
        arguments = (self._model, self._data, self._geometry, self._geometry_data)
        if len(q) < _FEW:
            return np.array([pin.computeCollisions(*arguments, q_k, True) for q_k in q], dtype=np.bool_)
        # As coal says of shapes that are nowhere.
        near: BoolArray = ~np.all(np.isfinite(q), axis=1)
        known = np.flatnonzero(~near)
        for bounds in self._broad_phase.look(q[known]):
            row, pair = np.nonzero((bounds.value <= margin + _SLACK).T)
            for k, pairs in _grouped(known[bounds.some][row], pair.tolist()):
                self._put(q[k])
                near[k] = any(pin.computeCollision(self._geometry, self._geometry_data, p) for p in pairs)
        return near

    def within(self, q: FloatArray, distance: float) -> list[Nearest]:
        """Return every avoidable pair (see `smallest`) that is nearer than `distance` at `q`."""
        if not self._any_avoidable:
            return []
        lower = self._memory.lower_bounds(q)
        candidates = np.flatnonzero(~self._unavoidable & (lower <= distance + _SLACK))
        if len(candidates) == 0:
            return []
        self._place(q)
        found = [pair for pair in candidates.tolist() if self._distance(pair) < distance]
        return [self._nearest(pair) for pair in found]

    def nearest(self, q: FloatArray, pair: int) -> Nearest:
        """Return the nearest points of pair number `pair` at posture `q` (n,)."""
        self._place(q)
        return self._nearest(pair)

    def _place(self, q: FloatArray) -> None:
        pin.computeJointJacobians(self._model, self._data, q)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data)

    def _nearest(self, pair: int) -> Nearest:
        result = pin.computeDistance(self._geometry, self._geometry_data, pair)
        first, second = self._shapes[pair]
        point, other_point = result.getNearestPoint1(), result.getNearestPoint2()
        jacobian = self._point_jacobian(self._joints[first], point)
        if self.pairs[pair].of_arm:
            jacobian = jacobian - self._point_jacobian(self._joints[second], other_point)
        return Nearest(
            distance=result.min_distance,
            point=np.array(point),
            other_point=np.array(other_point),
            direction=-np.array(result.normal),
            jacobian=jacobian,
        )

    def _point_jacobian(self, joint: int, point: FloatArray) -> FloatArray:
        """Jacobian (3, n) of a point of W that is fixed to `joint`."""
        J = pin.getJointJacobian(self._model, self._data, joint, pin.ReferenceFrame.WORLD)
        return np.asarray(J[:3] - pin.skew(point) @ J[3:])

    def _least_at(self, q: FloatArray, left_out: BoolArray) -> tuple[float, int]:
        """Smallest distance and its pair in posture `q` (n,), by what is remembered."""
        lower = self._memory.lower_bounds(q)
        if left_out is not self._nothing:
            lower[left_out] = np.inf
        self._put(q)
        first = int(lower.argmin())
        least = self._distance(first)
        lower[first] = np.inf
        near = np.flatnonzero(lower <= least + _SLACK)
        if len(near) == 0:
            return least, first
        near = near[lower[near].argsort()]
        return self._least((least, first), list(zip(near.tolist(), lower[near].tolist(), strict=True)))

    def _least_of(self, q: FloatArray, left_out: BoolArray) -> tuple[FloatArray, IntArray]:
        """Smallest distances (N,) and their pairs (N,) in postures `q` (N, n)."""
        distance, pair = np.full(len(q), np.inf), np.full(len(q), -1, dtype=np.intp)
        if self._memory.serves(q):
            for some, lower, upper in self._memory.stretches(q):
                lower[:, left_out] = upper[:, left_out] = np.inf
                row, near = np.nonzero(lower <= upper.min(axis=1, keepdims=True) + _SLACK)
                self._try(q[some], row, near, lower[row, near], distance[some], pair[some])
            return distance, pair
        for bounds in self._broad_phase.look(q):
            bounds.value[left_out] = np.inf
            number = np.arange(bounds.value.shape[1])
            # What is nearest in one posture often is in those after it, too: tried first, it saves others.
            guides = number[::_TOGETHER]
            least, guided = self._settled(
                q[bounds.some], bounds, guides, bounds.value[:, guides].argmin(axis=0)
            )
            others = number[number % _TOGETHER > 0]
            distance[bounds.some][guides], pair[bounds.some][guides] = least, guided
            least, found = self._settled(q[bounds.some], bounds, others, guided[others // _TOGETHER])
            distance[bounds.some][others], pair[bounds.some][others] = least, found
        return distance, pair

    def _settled(
        self, q: FloatArray, bounds: LowerBounds, which: IntArray, first: IntArray
    ) -> tuple[FloatArray, IntArray]:
        """Smallest distances and their pairs in the postures `which` of `q`; `first` are tried first."""
        pair, least = first.copy(), np.empty(len(first))
        for k, (at, p) in enumerate(zip(which.tolist(), first.tolist(), strict=True)):
            self._put(q[at])
            least[k] = self._distance(p)
        row, near = np.nonzero((bounds.value[:, which] <= least + _SLACK).T)
        lower = bounds.tightened(near, which[row])
        doubtful = (lower <= least[row] + _SLACK) & (near != first[row])
        self._try(q[which], row[doubtful], near[doubtful], lower[doubtful], least, pair)
        return least, pair

    def _try(
        self,
        q: FloatArray,
        row: IntArray,
        candidate: IntArray,
        lower: FloatArray,
        least: FloatArray,
        pair: IntArray,
    ) -> None:
        """Take what is smaller among candidates, pairs (M,) in rows (M,) of `q`, for the least so far."""
        order = np.lexsort((lower, row))
        found = list(zip(candidate[order].tolist(), lower[order].tolist(), strict=True))
        for k, candidates in _grouped(row[order], found):
            self._put(q[k])
            least[k], pair[k] = self._least((least[k], pair[k]), candidates)

    def _least(self, best: tuple[float, int], candidates: list[tuple[int, float]]) -> tuple[float, int]:
        """Smallest distance and its pair: the best so far or one of the candidates, with their lower bounds.

        The most promising ones come first; as soon as one cannot be better, none can.
        """
        for pair, lower in candidates:
            if lower > best[0] + _SLACK:
                break
            best = min(best, (self._distance(pair), pair))
        return best

    def _put(self, q: FloatArray) -> None:
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)

    def _distance(self, pair: int) -> float:
        return float(pin.computeDistance(self._geometry, self._geometry_data, pair).min_distance)


def _forget_guesses(requests: Sequence[Any]) -> None:
    """Let GJK start anew for every posture: from where it ended last, it ends a little elsewhere.

    So distances do not depend on what was asked before, and it takes no longer.
    """
    with warnings.catch_warnings():
        # coal says how to ask for guesses from now on; pinocchio asks for them in the old way, unasked.
        warnings.simplefilter("ignore", DeprecationWarning)
        for request in requests:
            request.enable_cached_gjk_guess = False


def _grouped(row: IntArray, values: list[_T]) -> Iterator[tuple[int, list[_T]]]:
    """Go through the numbers that occur in `row`, which ascends, with the `values` that belong to each."""
    ends = np.flatnonzero(np.diff(row, prepend=-1, append=-1))
    for start, end in pairwise(ends.tolist()):
        yield int(row[start]), values[start:end]
