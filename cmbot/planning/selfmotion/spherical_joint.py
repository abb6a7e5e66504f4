"""Arms with a spherical joint at one end: three successive axes that meet in one point.

Such a joint decouples position from orientation (Siciliano et al., Robotics, Section 2.12): the other joints
alone place its centre, which the tool's pose prescribes, and its own three angles follow from theirs. A
spherical wrist is at the tool, a spherical shoulder at the base; a shoulder is the wrist of the same arm from
its tool to its base. `WristChain` is the arm in the order in which the spherical joint comes last.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray, IntArray, cross
from cmbot.planning.request import StrokeRequest

# Axes meet when they pass a point at no more than this distance, m: URDFs are rounded.
_MEET_M = 2e-5
# Sine of the angle between successive axes of a spherical joint at least.
_MIN_AXES_SINE = 0.1
# Joints before the spherical one.
_INNER = (3, 4)
# A tool is on the last axis when its point is this near to it, m, and its axis this near to parallel.
_ON_AXIS = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class WristChain:
    """An arm whose last three joints are spherical: axes in W while all joints are at zero.

    Attributes
    ----------
    joints : (n,)
        Numbers of the arm's joints in the order of the chain.
    axis, origin : (n, 3)
        Directions, those of a chain from tool to base reversed, and points on the axes, m.
    centre : (3,), m
        Of the spherical joint.
    slack : float, m
        How far the centre, as a point of the last link, may be from where the other joints put it.
    free_axis : (3,) or None
        The direction about which the last link may turn freely; None where its whole pose is prescribed.
    goal_rotation, goal_centre : (3, 3), (k, 3)
        What the task prescribes: rotation of the last link from where it is with all joints at zero, and its
        centre at the k via-points, m.
    """

    joints: IntArray
    axis: FloatArray
    origin: FloatArray
    centre: FloatArray
    slack: float
    free_axis: FloatArray | None
    goal_rotation: FloatArray
    goal_centre: FloatArray

    @property
    def inner(self) -> int:
        """Number of joints that place the centre."""
        return len(self.joints) - 3

    def walk(self, q: FloatArray) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Yield each joint's axis (N, 3), origin (N, 3) and the rotation (N, 3, 3) after it.

        `q` (N, k), rad, are the angles of the first k joints of the chain.
        """
        R = np.broadcast_to(np.eye(3), (len(q), 3, 3))
        origin = before = np.broadcast_to(self.origin[0], (len(q), 3))
        for i, angle in enumerate(q.T):
            origin = before + R @ (self.origin[i] - self.origin[max(i - 1, 0)])
            axis = R @ self.axis[i]
            R = R @ turns(self.axis[i], angle)
            before = origin
            yield axis, origin, R

    def lever_bounds(self) -> FloatArray:
        """Bounds (n - 3,), m, of the centre's distance from each axis before the spherical joint."""
        points = np.vstack([self.origin[: self.inner], self.centre])
        steps = np.diff(points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        beyond = np.append(np.cumsum(lengths[::-1])[::-1][1:], 0.0)
        across = np.linalg.norm(cross(steps, self.axis[: self.inner]), axis=1)
        return np.asarray(across + beyond)


def wrist_chain(request: StrokeRequest) -> WristChain | None:
    """Return the chain of a request's arm and task; None where they do not decouple.

    They do for arms of six or seven revolute joints, none of which follows another and the first or the last
    three of which meet, and ``keep: pose``; with a wrist and a tool on its last axis, which is not fixed,
    also for ``keep: axis``.
    """
    robot, task = request.cell.robot, request.task
    if task.lean is not None or not robot.coupling.is_free:
        return None
    n = robot.dof
    if n - 3 not in _INNER or task.keep == "position" or task.path.turns or robot.limits.prismatic.any():
        return None
    at = request.cell.postures.tool_at(np.zeros((1, n)))
    axis, origin = at.axis[0], at.origin[0]
    point, R = at.tool_point[0], at.tool_rotation[0]
    goals, R_goal = request.goals.point, task.path.orientation
    if at.part is not None:
        if task.keep != "pose":
            return None
        # Where the part has to be follows from where a fixed tool has to be on it.
        fixed, R = robot.fixed_tool, at.part.rotation[0]
        R_goal = fixed.rotation @ R_goal.T
        point, goals = fixed.translation - R @ point, fixed.translation - goals @ R_goal.T
    turned = R_goal @ R.T
    joints = np.arange(n)
    for reverse in (False, True):
        if reverse:
            joints, axis, origin = joints[::-1], -axis[::-1], origin[::-1]
        centre, off = _meeting_point(axis[-3:], origin[-3:])
        if off.max() > _MEET_M:
            continue
        free_axis = None
        if task.keep == "axis":
            aside = cross(point - centre, axis[-1])
            askew = cross(R[:, 2], axis[-1])
            if reverse or np.linalg.norm(aside) > _ON_AXIS or np.linalg.norm(askew) > _ON_AXIS:
                continue
            free_axis = axis[-1]
        if reverse:
            rotation, goal = turned.T, point + (centre - goals) @ turned
        else:
            rotation, goal = turned, goals + turned @ (centre - point)
        return WristChain(
            joints=joints,
            axis=axis,
            origin=origin,
            centre=centre,
            slack=2 * float(off.sum()),
            free_axis=free_axis,
            goal_rotation=rotation,
            goal_centre=goal,
        )
    return None


def turns(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Return rotations (N, 3, 3) about a unit vector `axis` (3,) by angles (N,), rad."""
    return np.asarray(Rotation.from_rotvec(angle[:, None] * axis).as_matrix())


def _meeting_point(axis: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The point (3,) nearest to three lines, and its distances (3,); infinite where lines are parallel."""
    across = np.eye(3) - axis[:, :, None] * axis[:, None]
    successive = np.linalg.norm(cross(axis[:-1], axis[1:]), axis=1)
    if successive.min() < _MIN_AXES_SINE:
        return origin[0], np.full(3, np.inf)
    point = np.linalg.solve(across.sum(axis=0), np.einsum("kij,kj->i", across, origin))
    return point, np.linalg.norm(np.einsum("kij,kj->ki", across, point - origin), axis=1)
