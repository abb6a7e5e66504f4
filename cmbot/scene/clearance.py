"""The smallest distances between the arm, the obstacles and the arm itself, by coal's GJK."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cmbot.arrays import BoolArray, FloatArray, IntArray
from cmbot.robot import Robot
from cmbot.scene.obstacles import Obstacle
from cmbot.scene.shapes import coal_shapes

__all__ = ["Clearances", "Nearest", "ShapePair", "Smallest"]


# When some point of the arm may have moved further than this, m, all pairs are looked at again.
_LOOK_AGAIN = 0.05
# Rounding that the choice of near pairs allows for, m.
_SLACK = 1e-9
# GJK's default of 1e-6 m would blur the derivatives; this costs nothing that can be measured. EPA, which
# takes over in deep overlaps, keeps its default: asked for more it fails now and then.
_GJK_TOLERANCE = 1e-10


@dataclass(frozen=True, kw_only=True)
class ShapePair:
    """Two shapes whose distance counts.

    Attributes
    ----------
    link : str
        Link of the arm.
    other : str
        Obstacle, or second link of the robot.
    of_arm : bool
        Both belong to the robot.
    at_work : bool
        The tool, which is all that the last joint carries, and a workpiece: expected to be near each other.
    """

    link: str
    other: str
    of_arm: bool
    at_work: bool

    def too_near(self, distance: float, margin: float) -> str:
        """Say that a distance of the two, m, is below the safety margin, m."""
        if distance < 0:
            how = f"{self.link} reaches {-distance:.4f} m into {self.other}"
        else:
            how = f"{self.link} comes within {distance:.4f} m of {self.other}"
        return f"{how}, the safety margin is {margin:g} m"


@dataclass(frozen=True, kw_only=True)
class Smallest:
    """The smallest distance in each of N postures.

    Attributes
    ----------
    distance : (N,), m
        Negative where shapes overlap.
    pair : (N,)
        Index into `Clearances.pairs`; -1 where no pair counts (the distance is then infinite) or the posture
        is no number (the distance is then NaN).
    """

    distance: FloatArray
    pair: IntArray


@dataclass(frozen=True, kw_only=True)
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
        self._geometry = pin.GeometryModel(robot.collision_model)
        self._data = robot.model.createData()
        own_pairs = [(pair.first, pair.second) for pair in self._geometry.collisionPairs]
        moving = [i for i, shape in enumerate(self._geometry.geometryObjects) if shape.parentJoint > 0]
        self._geometry.removeAllCollisionPairs()
        self.pairs: list[ShapePair] = []
        self._shapes: list[tuple[int, int]] = []
        for i, j in own_pairs:
            # The link further out is the one that moves.
            first, second = sorted((i, j), key=self._joint_of, reverse=True)
            if self._joint_of(first) != self._joint_of(second):
                self._add_pair(first, second, self._link_of(second), of_arm=True, at_work=False)
        tool_joint = self._model.frames[robot.tool_frame_id].parentJoint
        for obstacle in obstacles:
            for k, (shape, X_OS) in enumerate(coal_shapes(obstacle.shape, obstacle.name)):
                X_WS = pin.SE3(np.array(obstacle.X_WO)) * X_OS
                j = self._geometry.addGeometryObject(
                    pin.GeometryObject(f"obstacle {obstacle.name} {k}", 0, X_WS, shape)
                )
                for i in moving:
                    at_work = obstacle.workpiece and self._joint_of(i) == tool_joint
                    self._add_pair(i, j, obstacle.name, of_arm=False, at_work=at_work)
        self._geometry_data = pin.GeometryData(self._geometry)
        for request in self._geometry_data.distanceRequests:
            request.gjk_tolerance = _GJK_TOLERANCE
        self.reach = self._reach(moving)
        self._all = np.ones(len(self.pairs), dtype=np.bool_)
        kept_away_from = [not (pair.of_arm or pair.at_work) for pair in self.pairs]
        self._avoidable = np.array(kept_away_from, dtype=np.bool_)
        # Where all pairs were last looked at, and their distances there: nowhere yet.
        self._seen_at, self._seen = np.full(robot.dof, np.nan), np.empty(0)
        # The same pairs, the nearest first, all of them and the avoidable ones.
        self._ranked: dict[bool, tuple[list[int], list[float]]] = {}

    def smallest(self, q: FloatArray, *, avoidable_only: bool = False) -> Smallest:
        """Return the smallest distance in each of the postures `q` (N, n).

        Quick where neighbouring postures are near each other: most pairs are then known to be too far.

        Parameters
        ----------
        q : (N, n), rad
        avoidable_only : bool
            Leave out the arm with itself and the tool with a workpiece, as H of Eq. (17) does here.
        """
        counted = self._avoidable if avoidable_only else self._all
        distance, pair = np.full(len(q), np.inf), np.full(len(q), -1, dtype=np.intp)
        if counted.any():
            # Of shapes that are nowhere coal would say that they touch.
            known = np.isfinite(q).all(axis=1)
            distance[~known] = np.nan
            for k in np.flatnonzero(known):
                distance[k], pair[k] = self._smallest(q[k], avoidable_only)
        return Smallest(distance=distance, pair=pair)

    def too_near(self, q: FloatArray, margin: float) -> BoolArray:
        """Return which of the postures `q` (N, n) have any distance below `margin`, m, in any order."""
        for request in self._geometry_data.collisionRequests:
            request.security_margin = margin
        arguments = (self._model, self._data, self._geometry, self._geometry_data)
        return np.array([pin.computeCollisions(*arguments, q_k, True) for q_k in q], dtype=np.bool_)

    def within(self, q: FloatArray, distance: float) -> list[Nearest]:
        """Return every avoidable pair (see `smallest`) that is nearer than `distance` at `q`."""
        moved = self._moved(q)
        candidates = np.flatnonzero(self._avoidable & (self._seen <= distance + moved + _SLACK))
        if len(candidates) == 0:
            return []
        self._place(q)
        found = (self._nearest(int(pair)) for pair in candidates)
        return [near for near in found if near.distance < distance]

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
        jacobian = self._point_jacobian(self._joint_of(first), point)
        if self.pairs[pair].of_arm:
            jacobian = jacobian - self._point_jacobian(self._joint_of(second), other_point)
        return Nearest(
            distance=result.min_distance,
            point=np.array(point),
            other_point=np.array(other_point),
            direction=-np.array(result.normal),
            jacobian=jacobian,
        )

    def _add_pair(self, i: int, j: int, other: str, *, of_arm: bool, at_work: bool) -> None:
        self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._shapes.append((i, j))
        pair = ShapePair(link=self._link_of(i), other=other, of_arm=of_arm, at_work=at_work)
        self.pairs.append(pair)

    def _joint_of(self, shape: int) -> int:
        return int(self._geometry.geometryObjects[shape].parentJoint)

    def _link_of(self, shape: int) -> str:
        return str(self._model.frames[self._geometry.geometryObjects[shape].parentFrame].name)

    def _point_jacobian(self, joint: int, point: FloatArray) -> FloatArray:
        """Jacobian (3, n) of a point of W that is fixed to `joint`."""
        J = pin.getJointJacobian(self._model, self._data, joint, pin.ReferenceFrame.WORLD)
        return np.asarray(J[:3] - pin.skew(point) @ J[3:])

    def _smallest(self, q: FloatArray, avoidable_only: bool) -> tuple[float, int]:
        """Smallest distance among all or the avoidable pairs at `q`, and its pair."""
        moved = self._moved(q)
        pairs, seen = self._ranked[avoidable_only]
        candidates = pairs[: bisect_right(seen, seen[0] + 2 * moved + _SLACK)]
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
        return min(
            (pin.computeDistance(self._geometry, self._geometry_data, pair).min_distance, pair)
            for pair in candidates
        )

    def _moved(self, q: FloatArray) -> float:
        """How much any distance can have changed since all pairs were looked at, m; looks again if by much.

        No point of the arm moves further than the joints' moves times their reach, and two shapes of the arm
        move against each other only by the joints between them.
        """
        moved = float(np.abs(q - self._seen_at) @ self.reach)
        if moved <= _LOOK_AGAIN:
            return moved
        pin.computeDistances(self._model, self._data, self._geometry, self._geometry_data, q)
        self._seen_at = q.copy()
        self._seen = np.array([result.min_distance for result in self._geometry_data.distanceResults])
        ranked = np.argsort(self._seen, kind="stable")
        for avoidable_only, pairs in ((False, ranked), (True, ranked[self._avoidable[ranked]])):
            self._ranked[avoidable_only] = (pairs.tolist(), self._seen[pairs].tolist())
        return 0.0

    def _reach(self, moving: Sequence[int]) -> FloatArray:
        """Largest distance (n,) that any point of the arm can have from each joint's origin, m."""
        model = self._model
        radius = np.zeros(model.njoints)
        for i in moving:
            shape = self._geometry.geometryObjects[i]
            shape.geometry.computeLocalAABB()
            centre = shape.placement.act(shape.geometry.aabb_center)
            extent = float(np.linalg.norm(centre)) + float(shape.geometry.aabb_radius)
            radius[shape.parentJoint] = max(radius[shape.parentJoint], extent)
        for joint in range(model.njoints - 1, 1, -1):
            offset = float(np.linalg.norm(model.jointPlacements[joint].translation))
            parent = model.parents[joint]
            radius[parent] = max(radius[parent], offset + radius[joint])
        return radius[1:]
