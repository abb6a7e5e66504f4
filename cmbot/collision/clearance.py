"""The smallest distances between the arm, the obstacles and the arm itself, by coal's GJK."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from cmbot.collision.broad_phase import BroadPhase, LowerBounds
from cmbot.collision.motion_bounds import DistanceCache, pair_reach, shape_reach
from cmbot.collision.obstacles import Obstacle
from cmbot.collision.shapes import PairedShapes
from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.robot import Robot

RESOLUTION = 1e-4
"""To which the smallest distance of a motion is known, m: what lies so near a margin may count as below."""

# From this number of postures on the broad phase is worth its calls: benchmarks/kernels.py.
_MIN_BROAD_PHASE_POSTURES = 24
# One of this many neighbouring postures is measured first: its nearest pair often is that of the others.
_GUIDE_STRIDE = 8
# Rounding that the choice of near pairs allows for, m.
_NEAR_PAIR_TOLERANCE = 1e-9
# GJK's default of 1e-6 m would blur the derivatives; this costs nothing that can be measured. EPA, which
# takes over in deep overlaps, keeps its default: with a smaller tolerance it fails now and then.
_GJK_TOLERANCE = 1e-10
# Links are always near each other that in half of so many random postures are nearer than this, m.
_POSTURES_OF_LINKS, _NEAR_LINKS_M = 32, 0.05
# Steps in which a tip's length is sought, of which one is left as room beside, m.
_DEPTH_STEP_M = 1e-3

_T = TypeVar("_T")


class Smallest(NamedTuple):
    """The smallest distance in each of N postures.

    Attributes
    ----------
    distance : (N,), m
        Negative where shapes overlap.
    pair : (N,)
        Index into `Clearances.pairs`; -1 where no pair counts (the distance is then infinite) or the posture
        is not finite (the distance is then NaN).
    """

    distance: FloatArray
    pair: IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Nearest:
    """The nearest points of one pair in one posture.

    Attributes
    ----------
    distance : float, m
    point, other_point : (3,), m
        On the arm (C of Chang 2021, Eq. (17)) and on the other shape, in W.
    direction : (3,)
        u of Eq. (17): from the other shape to the arm, unit length, also where shapes touch or overlap.
    jacobian : (3, n), m/rad
        J_C of the point on the arm, less that of the other point where it moves with the arm.
    """

    distance: float
    point: FloatArray
    other_point: FloatArray
    direction: FloatArray
    jacobian: FloatArray

    @property
    def gradient(self) -> FloatArray:
        """Derivative of the distance with respect to the joints, (n,), m/rad."""
        return np.asarray(self.direction @ self.jacobian)


class Clearances:
    """Distances of a robot's moving shapes to obstacles and to its own other shapes.

    It owns working memory, so threads must not share it.

    Parameters
    ----------
    robot : Robot
    obstacles : sequence of Obstacle
        Placed in W. A mesh counts as the convex hulls of its connected parts, a part that is a sheet as
        those of its patches: its clearance is never overestimated.

    Attributes
    ----------
    pairs : list of ShapePair
        The P pairs whose distances count.
    reach : (n,), m
        Of the joints: no distance changes by more than the joints' moves times these.
    pair_reach : (P, n), m
        The same for each pair.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Obstacle]) -> None:
        self._robot, self._obstacles = robot, obstacles
        paired = PairedShapes(robot, obstacles)
        self.pairs, self._shapes, self._joints = paired.pairs, paired.shapes, paired.joints
        self._model, self._data, self._coupling = robot.model, robot.model.createData(), robot.coupling
        self._geometry, self._geometry_data = paired.geometry, pin.GeometryData(paired.geometry)
        for request in self._geometry_data.distanceRequests:
            request.gjk_tolerance = _GJK_TOLERANCE
        _disable_guesses([*self._geometry_data.distanceRequests, *self._geometry_data.collisionRequests])
        shapes = list(self._geometry.geometryObjects)
        reach = shape_reach(self._model, shapes)
        self.reach = self._coupling.summed(reach).max(axis=0, initial=0.0)
        self._broad_phase = BroadPhase(robot, shapes, self._shapes)
        self.pair_reach = self._coupling.summed(pair_reach(reach, self._joints, self._shapes))
        self._cache = DistanceCache(robot, self._geometry, self._geometry_data, self.pair_reach)
        self._avoidable = np.array([pair.avoidable for pair in self.pairs], dtype=np.bool_)
        self._any_avoidable = bool(self._avoidable.any())
        self._margin = np.nan
        self._all = (self._model, self._data, self._geometry, self._geometry_data)

    def no_deeper(self, q: FloatArray, margin: float) -> Clearances:
        """Return the distances by which the tip enters no workpiece deeper than in postures, within 2 mm.

        Parameters
        ----------
        q : (N, n), rad
            Such as a free move's ends. What is not entered in these may be touched.
        margin : float, m
            Kept by the rest of the tool.
        """
        if not any(obstacle.contact for obstacle in self._obstacles):
            return self
        return Clearances(self._robot, [self._no_deeper(each, q, margin) for each in self._obstacles])

    def _no_deeper(self, obstacle: Obstacle, q: FloatArray, margin: float) -> Obstacle:
        """An obstacle that no more of the tip may touch than keeps the margin in postures."""
        # What is that long touches no more than the surface.
        tip = margin
        while tip < obstacle.contact:
            rest = Clearances(self._robot, [replace(obstacle, contact=tip)])
            pairs = np.flatnonzero([pair.tool_at_work for pair in rest.pairs])
            if (rest._distances_of(q, pairs) >= margin).all():
                break
            tip += _DEPTH_STEP_M
        return replace(obstacle, contact=min(obstacle.contact, tip + _DEPTH_STEP_M))

    @cached_property
    def always_near(self) -> FloatArray:
        """The least distances, m, of links in random postures, of those that are always near each other.

        Such are neighbours of neighbours: an SRDF leaves them out as ones that never collide.
        """
        lower, upper = self._robot.limits.within_a_turn
        q = np.random.default_rng(0).uniform(lower, upper, (_POSTURES_OF_LINKS, len(lower)))
        own = np.flatnonzero([pair.self_collision for pair in self.pairs])
        near = own[np.median(self.lower_bounds(q)[:, own], axis=0) < _NEAR_LINKS_M]
        distances = self._distances_of(q, near)
        return np.asarray(distances.min(axis=0)[np.median(distances, axis=0) < _NEAR_LINKS_M])

    def query(
        self, q: FloatArray, below: float | FloatArray | None = None, *, avoidable_only: bool = False
    ) -> Smallest:
        """Return the smallest distance in each of the postures `q` (N, n), and its pair.

        Quickest for many postures in one call, or for one that is near the last.

        Parameters
        ----------
        q : (N, n), rad
        below : float or (N,), m, optional
            Say only whether it is below this: as distances then count minus infinity, of a pair that is
            nearer, and infinity. A posture that is not finite counts as one of overlapping shapes.
        avoidable_only : bool
            Leave out the arm with itself and the tool with a workpiece, as H of Eq. (17) does here.
        """
        left_out = ~self._avoidable & avoidable_only
        distance, pair = np.full(len(q), np.inf), np.full(len(q), -1, dtype=np.intp)
        # coal takes shapes at positions that are not finite for touching.
        known: BoolArray = np.all(np.isfinite(q), axis=1)
        if below is not None:
            if isinstance(below, np.ndarray):
                pair[known] = self._below(q[known], below[known])
            else:
                pair[known] = self._within_margin(q[known], below)
            distance[(pair >= 0) | ~known] = -np.inf
        elif not left_out.all():
            distance[~known] = np.nan
            if len(q) < _MIN_BROAD_PHASE_POSTURES:
                for k in np.flatnonzero(known):
                    distance[k], pair[k] = self._smallest_at(q[k], left_out)
            else:
                distance[known], pair[known] = self._smallest_of(q[known], left_out)
        return Smallest(distance, pair)

    def lower_bounds(self, q: FloatArray) -> FloatArray:
        """Return lower bounds (N, P), m, of the distances of all pairs in postures `q` (N, n), cheaply."""
        blocks = [bounds.value.T for bounds in self._broad_phase.lower_bounds(q)]
        return np.concatenate([np.empty((0, len(self.pairs))), *blocks])

    def distances(self, q: FloatArray, posture: IntArray, pair: IntArray) -> FloatArray:
        """Return the distances (M,), m, of pairs (M,) in postures (M,), ascending, of `q` (N, n)."""
        found = np.empty(len(pair))
        for k, items in _grouped(posture, list(enumerate(pair.tolist()))):
            self._place_shapes(q[k])
            for item, number in items:
                found[item] = self._distance(number)
        return found

    def _distances_of(self, q: FloatArray, pairs: IntArray) -> FloatArray:
        """Distances (N, K), m, of pairs (K,) in all postures `q` (N, n)."""
        posture = np.arange(len(q)).repeat(len(pairs))
        return self.distances(q, posture, np.tile(pairs, len(q))).reshape(len(q), len(pairs))

    def _within_margin(self, q: FloatArray, margin: float) -> IntArray:
        """A pair (N,) that is nearer than `margin`, m, in each of the postures `q` (N, n); -1 without."""
        if margin != self._margin:
            for request in self._geometry_data.collisionRequests:
                request.security_margin = margin
            self._margin = margin
        found = np.full(len(q), -1, dtype=np.intp)
        if len(q) < _MIN_BROAD_PHASE_POSTURES:
            results = self._geometry_data.collisionResults
            for k, q_k in enumerate(q):
                pairs = self._cache.near(q_k, margin + _NEAR_PAIR_TOLERANCE)
                if pairs is not None:
                    self._place_shapes(q_k)
                    found[k] = self._first_colliding(pairs)
                elif pin.computeCollisions(*self._all, self._coupling.positions(q_k), True):
                    # It stops at the first pair: what comes after that is of another posture.
                    found[k] = next(pair for pair, result in enumerate(results) if result.isCollision())
            return found
        for bounds in self._broad_phase.lower_bounds(q):
            row, pair = np.nonzero((bounds.value <= margin + _NEAR_PAIR_TOLERANCE).T)
            for k, pairs in _grouped(row, pair.tolist()):
                self._place_shapes(q[bounds.block][k])
                found[bounds.block][k] = self._first_colliding(pairs)
        return found

    def _first_colliding(self, pairs: Iterable[int]) -> int:
        """The first of some pairs that is nearer than the requests' margin; -1 without."""
        collide = partial(pin.computeCollision, self._geometry, self._geometry_data)
        return next((pair for pair in pairs if collide(pair)), -1)

    def _below(self, q: FloatArray, least: FloatArray) -> IntArray:
        """A pair (N,) that is nearer than `least` (N,), m, in each of the postures `q` (N, n); -1 without."""
        found = np.full(len(q), -1, dtype=np.intp)
        for bounds in self._broad_phase.lower_bounds(q):
            most, block = least[bounds.block], found[bounds.block]
            pair, row = np.nonzero(bounds.value <= most + _NEAR_PAIR_TOLERANCE)
            lower = bounds.tightened(pair, row)
            order = np.lexsort((lower, row))
            order = order[lower[order] <= most[row[order]] + _NEAR_PAIR_TOLERANCE]
            for k, pairs in _grouped(row[order], pair[order].tolist()):
                self._place_shapes(q[bounds.block][k])
                block[k] = next((p for p in pairs if self._distance(p) < most[k]), -1)
        return found

    def within(self, q: FloatArray, distance: float) -> list[Nearest]:
        """Return every avoidable pair (see `query`) that is nearer than `distance` at `q`."""
        if not self._any_avoidable:
            return []
        near = self._cache.lower_bounds(q) <= distance + _NEAR_PAIR_TOLERANCE
        candidates = (near & self._avoidable).nonzero()[0].tolist()
        if not candidates:
            return []
        self._update_jacobians(q)
        found = [(pair, self._measured_at(pair)) for pair in candidates]
        return [self._nearest(pair, result) for pair, result in found if result.min_distance < distance]

    def nearest(self, q: FloatArray, pair: int) -> Nearest:
        """Return the nearest points of pair number `pair` at posture `q` (n,)."""
        self._update_jacobians(q)
        return self._nearest(pair, self._measured_at(pair))

    def nearest_points(self, q: FloatArray, pair: int) -> FloatArray:
        """Return those points alone, one after the other, (6,), which is quicker."""
        self._place_shapes(q)
        result = self._measured_at(pair)
        return np.concatenate([result.getNearestPoint1(), result.getNearestPoint2()])

    def _nearest(self, pair: int, result: Any) -> Nearest:
        first, second = self._shapes[pair]
        point, other_point = result.getNearestPoint1(), result.getNearestPoint2()
        jacobian = self._point_jacobian(self._joints[first], point)
        if self.pairs[pair].self_collision:
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
        return self._coupling.projected(np.asarray(J[:3] - pin.skew(point) @ J[3:]))

    def _smallest_at(self, q: FloatArray, left_out: BoolArray) -> tuple[float, int]:
        """Smallest distance and its pair in posture `q` (n,), by the cached bounds."""
        lower = self._cache.lower_bounds(q)
        lower[left_out] = np.inf
        self._place_shapes(q)
        first = int(lower.argmin())
        least = self._distance(first)
        lower[first] = np.inf
        near = np.flatnonzero(lower <= least + _NEAR_PAIR_TOLERANCE)
        near = near[lower[near].argsort()]
        return self._least((least, first), list(zip(near.tolist(), lower[near].tolist(), strict=True)))

    def _smallest_of(self, q: FloatArray, left_out: BoolArray) -> tuple[FloatArray, IntArray]:
        """Smallest distances (N,) and their pairs (N,) in postures `q` (N, n)."""
        distance, pair = np.full(len(q), np.inf), np.full(len(q), -1, dtype=np.intp)
        if self._cache.suits(q):
            for some, lower, upper in self._cache.segments(q):
                lower[:, left_out] = upper[:, left_out] = np.inf
                row, near = np.nonzero(lower <= upper.min(axis=1, keepdims=True) + _NEAR_PAIR_TOLERANCE)
                self._lower(q[some], row, near, lower[row, near], distance[some], pair[some])
            return distance, pair
        for bounds in self._broad_phase.lower_bounds(q):
            bounds.value[left_out] = np.inf
            number, block = np.arange(bounds.value.shape[1]), bounds.block
            guides, others = number[::_GUIDE_STRIDE], number[number % _GUIDE_STRIDE > 0]
            first = bounds.value[:, guides].argmin(axis=0)
            least, guided = self._measured(q[block], bounds, guides, first)
            distance[block][guides], pair[block][guides] = least, guided
            first = guided[others // _GUIDE_STRIDE]
            distance[block][others], pair[block][others] = self._measured(q[block], bounds, others, first)
        return distance, pair

    def _measured(
        self, q: FloatArray, bounds: LowerBounds, which: IntArray, first: IntArray
    ) -> tuple[FloatArray, IntArray]:
        """Smallest distances and their pairs in the postures `which` of `q`, pairs `first` measured first."""
        pair, least = first.copy(), np.empty(len(first))
        for k, (at, p) in enumerate(zip(which.tolist(), first.tolist(), strict=True)):
            self._place_shapes(q[at])
            least[k] = self._distance(p)
        row, near = np.nonzero((bounds.value[:, which] <= least + _NEAR_PAIR_TOLERANCE).T)
        lower = bounds.tightened(near, which[row])
        doubtful = (lower <= least[row] + _NEAR_PAIR_TOLERANCE) & (near != first[row])
        self._lower(q[which], row[doubtful], near[doubtful], lower[doubtful], least, pair)
        return least, pair

    def _lower(
        self,
        q: FloatArray,
        row: IntArray,
        candidate: IntArray,
        lower: FloatArray,
        least: FloatArray,
        pair: IntArray,
    ) -> None:
        """Lower the `least` distances so far to those of candidates, pairs (M,) in rows (M,) of `q`."""
        order = np.lexsort((lower, row))
        found = list(zip(candidate[order].tolist(), lower[order].tolist(), strict=True))
        for k, candidates in _grouped(row[order], found):
            self._place_shapes(q[k])
            least[k], pair[k] = self._least((least[k], pair[k]), candidates)

    def _least(self, best: tuple[float, int], candidates: list[tuple[int, float]]) -> tuple[float, int]:
        """Smallest distance and its pair among `best` and candidates, sorted by their lower bounds."""
        for pair, lower in candidates:
            if lower > best[0] + _NEAR_PAIR_TOLERANCE:
                break
            best = min(best, (self._distance(pair), pair))
        return best

    def _place_shapes(self, q: FloatArray) -> None:
        every = self._coupling.positions(q)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, every)

    def _update_jacobians(self, q: FloatArray) -> None:
        pin.computeJointJacobians(self._model, self._data, self._coupling.positions(q))
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data)

    def _distance(self, pair: int) -> float:
        return float(self._measured_at(pair).min_distance)

    def _measured_at(self, pair: int) -> Any:
        return pin.computeDistance(self._geometry, self._geometry_data, pair)


def _disable_guesses(requests: Sequence[Any]) -> None:
    """Let GJK start anew in every posture: from its last end it ends elsewhere, within its tolerance.

    Then distances do not depend on earlier queries; it takes no longer.
    """
    with warnings.catch_warnings():
        # Deprecated in coal, but it is the attribute that pinocchio sets.
        warnings.simplefilter("ignore", DeprecationWarning)
        for request in requests:
            request.enable_cached_gjk_guess = False


def _grouped(row: IntArray, values: list[_T]) -> Iterator[tuple[int, list[_T]]]:
    """Yield each number that occurs in `row`, which ascends, with the `values` that belong to it."""
    ends = np.flatnonzero(np.diff(row, prepend=-1, append=-1))
    for start, end in pairwise(ends.tolist()):
        yield int(row[start]), values[start:end]
