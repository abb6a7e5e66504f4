"""Torques and tool of a trajectory, enclosed for all times: what was found, and what bounds it.

So is how far the tool's speed is from that of its process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.limit import Limit
from cmbot.elastic.sag import Sag
from cmbot.planning.certification.check import Check
from cmbot.planning.certification.enclosed_hold import EnclosedHold
from cmbot.planning.certification.norm_bounds import NormBounds, norm_bounds, timed_pose_bounds
from cmbot.planning.task import ToolTask
from cmbot.robot import Dynamics, Efforts, Kinematics, Robot
from cmbot.toolpath import ToolPath
from cmbot.trajectory import Peak, Pieces, QuinticTrajectory, highest

# How far bounds may lie beyond what was found: of torques, as a share of the bound or of the largest value;
# of the tool, m and rad, or m/s.
_TORQUE_RESOLUTION, _TOOL_RESOLUTION = 1e-6, 1e-8
# Pieces of a trajectory at most, a segment, before the remainder of interpolation stays what it is.
_MAX_PIECES_PER_SEGMENT = 64
# How far the bound may lie above what was found, as a share of the process speed.
_SPEED_RESOLUTION = 1e-6


class EnclosedMotion:
    """Torques and tool of a trajectory at the points of interpolation, and their enclosures.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
    trajectory : QuinticTrajectory
    sag : Sag, optional
        Where it is compensated.
    coarse : bool
        Bounds may lie far beyond what was found.
    """

    def __init__(
        self,
        robot: Robot,
        task: ToolTask,
        trajectory: QuinticTrajectory,
        sag: Sag | None,
        *,
        coarse: bool = False,
    ) -> None:
        self._robot, self._task, self._trajectory, self._sag = robot, task, trajectory, sag
        self._dynamics = Dynamics(robot)
        pieces = Pieces.between(trajectory, task.path.breaks)
        self._pieces = (
            pieces if coarse else pieces.refined(self._share, _MAX_PIECES_PER_SEGMENT * len(pieces.start))
        )
        self._bounds = norm_bounds(robot, self._pieces.ellipses)
        q, v, a = self._pieces.states
        self._efforts: Efforts = self._dynamics.efforts(q, v, a)
        self._p_WT, self._R_WT = Kinematics(robot).tool_poses(q)
        self._goals = task.path.poses(self._pieces.times.ravel())
        self._goal_remainder, self._goal_rotation = timed_pose_bounds(task.path, self._pieces)
        self._unknown = np.zeros(len(self._pieces.start))
        if sag is not None:
            bent = sag.following(q)
            self._p_WT = self._p_WT + bent
            self._unknown = self._pieces.estimated_remainder(bent)

    def _share(self, pieces: Pieces) -> FloatArray:
        """Remainders (K,) as shares of what they may be."""
        of: NormBounds = norm_bounds(self._robot, pieces.ellipses)
        torque, turns = self._robot.limits.torque, ~self._robot.limits.prismatic
        scale = float((torque[turns] if turns.any() else torque).max())
        bounded = self._task.max_speed is not None or self._task.speed_tolerance is not None
        speed = _TOOL_RESOLUTION if bounded else np.inf
        # Infinite where a torque bound is next to nothing: then no number of pieces suffices.
        with np.errstate(over="ignore", invalid="ignore"):
            shares = [
                pieces.remainder(of.guardrail_torque) / (_TORQUE_RESOLUTION * scale),
                pieces.remainder(of.tool_point) / _TOOL_RESOLUTION,
                pieces.remainder(of.tool_rotation) / _TOOL_RESOLUTION,
                pieces.remainder(of.tool_velocity) / speed,
                *(
                    pieces.remainder(of.joint_torque[..., j]) / (_TORQUE_RESOLUTION * torque[j])
                    for j in range(self._robot.dof)
                ),
            ]
        return np.asarray(np.max(shares, axis=0))

    def _highest(
        self,
        values: FloatArray,
        convex: Callable[[FloatArray, IntArray], FloatArray],
        remainder: FloatArray,
        resolution: float,
    ) -> Peak:
        return highest(self._pieces, self._pieces.control_points(values), convex, remainder, resolution)

    def joint_torque(self) -> Check:
        """The torque of the joint that uses most of its bound (Chang 2021, Eq. (32))."""
        robot, bound = self._robot, self._robot.limits.torque
        each = [
            self._pieces.remainder(self._bounds.joint_torque[..., j]) / bound[j] for j in range(robot.dof)
        ]
        peak = self._highest(
            self._efforts.joint_torque / bound,
            lambda share, piece: np.abs(share).max(axis=1),
            np.max(each, axis=0),
            _TORQUE_RESOLUTION,
        )
        there = self._dynamics.efforts(*self._trajectory.states([peak.time]))
        joint = int((np.abs(there.joint_torque[0]) / bound).argmax())
        return Check(
            quantity=f"torque of {robot.joints[joint]}",
            time=peak.time,
            value=peak.bound * float(bound[joint]),
            bound=float(bound[joint]),
            unit=robot.limits.units(joint).torque,
            limit=Limit.JOINT_TORQUE,
            joint=robot.joints[joint],
        )

    def holding_torque(self) -> Iterator[Check]:
        """Yield what each locked joint between the feet and the arm holds."""
        robot, wrench = self._robot, self._efforts.guardrail_wrench
        parts = [
            self._pieces.remainder(of) for of in (self._bounds.guardrail_force, self._bounds.guardrail_torque)
        ]
        held, (rows, _) = robot.holding_torque(wrench), robot.holding_rows
        for k, joint in enumerate(robot.holding_joints):
            sizes = np.linalg.norm(rows[k].reshape(2, 3), axis=1)
            # A part that the joint does not feel may be without end.
            size = np.sum([of * part for of, part in zip(sizes, parts, strict=True) if of > 0], axis=0)
            resolution = _TORQUE_RESOLUTION * float(np.abs(held[:, k]).max())
            peak = self._highest(
                held[:, k : k + 1], lambda values, piece: np.abs(values).max(axis=1), size, resolution
            )
            yield Check(
                quantity=f"torque that {joint.name} holds",
                time=peak.time,
                value=peak.bound,
                bound=joint.limit,
                unit="Nm",
                limit=Limit.HOLDING_TORQUE,
                joint=joint.name,
            )

    def guardrail_torque(self) -> tuple[Peak, float, float, float]:
        """Peak, time mean and root mean square of the norm of the torque, and its peak at rest, Nm."""
        pieces, torque = self._pieces, self._efforts.guardrail_torque
        size = np.linalg.norm(torque, axis=1)
        resolution = _TORQUE_RESOLUTION * float(size.max())
        remainder = pieces.remainder(self._bounds.guardrail_torque)
        peak = self._highest(torque, _norm, remainder, resolution)
        mean, square = pieces.means(np.stack([size, size**2], axis=1))
        static = self._dynamics.static_efforts(pieces.states[0]).guardrail_torque
        return (
            peak,
            float(mean),
            float(np.sqrt(square)),
            self._highest(static, _norm, remainder, resolution).value,
        )

    def hold(self) -> EnclosedHold | None:
        """What the feet bear; None of a robot without any."""
        if (holding := self._robot.holding) is None:
            return None
        wrench = self._efforts.guardrail_wrench
        return EnclosedHold(holding, self._pieces, self._bounds, wrench, _TORQUE_RESOLUTION)

    def tool_deviation(self) -> Peak:
        """Distance of the tool point from the leg of its time, m; see `ToolPath.leg_offset`."""
        path, pieces = self._task.path, self._pieces
        middle, curved = pieces.middle, path.is_curved(pieces.middle)
        along, bend = path.leg_directions(middle), path.bend(pieces.start, pieces.end)
        # From the leg itself, which is convex, or from the timed place, across the tangent in the middle.
        origin = np.where(np.repeat(curved, len(self._p_WT) // len(curved))[:, None], self._goals.point, 0.0)

        def distance(p: FloatArray, piece: IntArray) -> FloatArray:
            points = np.swapaxes(p, 1, 2)
            times = np.repeat(middle[piece], points.shape[1])
            offset = path.leg_offset(times, points.reshape(-1, 3))
            straight = np.linalg.norm(offset, axis=1).reshape(points.shape[:2])
            forward = np.einsum("knd,kd->kn", points, along[piece])
            across = points - forward[:, :, None] * along[piece][:, None]
            # The tangent is turned by so much at most: |x - (x t) t| <= |x - (x m) m| + |x m| |m - t|.
            slanted = np.linalg.norm(across, axis=2) + bend[piece][:, None] * np.abs(forward)
            return np.asarray(np.where(curved[piece][:, None], slanted, straight))

        return self._highest(self._p_WT - origin, distance, self._point_remainder, _TOOL_RESOLUTION)

    def tool_lag(self) -> Peak:
        """Distance along its leg of the tool point from its timed place, m."""
        pieces, path = self._pieces, self._task.path
        along, bend = path.leg_directions(pieces.middle), path.bend(pieces.start, pieces.end)

        def lag(away: FloatArray, piece: IntArray) -> FloatArray:
            forward = np.einsum("kdn,kd->kn", away, along[piece])
            return np.asarray(np.abs(forward) + bend[piece][:, None] * np.linalg.norm(away, axis=1))

        away = self._p_WT - self._goals.point
        return self._highest(away, lag, self._point_remainder, _TOOL_RESOLUTION)

    def tool_speed(self) -> Peak:
        """Speed of the tool point, m/s."""
        velocity, remainder = self._tool_velocity()
        return self._highest(velocity, _norm, remainder, _TOOL_RESOLUTION)

    def process_speed(self) -> Peak:
        """By what share the tool's speed misses that of the process: `speed_deviation`."""
        return speed_deviation(self._task.path, self._pieces, *self._tool_velocity())

    def _tool_velocity(self) -> tuple[FloatArray, FloatArray]:
        """Velocity of the tool point at the points of interpolation, m/s, and what that misses (K,)."""
        q, v, _ = self._pieces.states
        J = Kinematics(self._robot).tool_point_jacobians(q)[1]
        remainder = self._pieces.remainder(self._bounds.tool_velocity)
        if self._sag is not None:
            bending = self._sag.at(q).d_tool
            J = J + bending
            remainder = remainder + self._pieces.estimated_remainder(np.einsum("kij,kj->ki", bending, v))
        return np.einsum("kij,kj->ki", J, v), remainder

    def tool_rotation(self) -> Peak:
        """Angle by which the tool misses what is prescribed of its orientation, rad: `ToolTask.rotation`."""
        goal, task = self._goals, self._task
        if task.keep == "position" and task.cone is None:
            return Peak(time=float(self._trajectory.t[0]), value=0.0, bound=0.0)
        # Both chords are 2 k sin(angle/2): of the axis as a vector, of the orientation as a matrix.
        columns, k = (slice(None), np.sqrt(2.0)) if task.keep == "pose" else (slice(2, 3), 1.0)
        away = (self._R_WT - goal.rotation)[:, :, columns].reshape(len(self._R_WT), -1)
        size = self._bounds.tool_rotation + self._goal_rotation
        remainder = self._pieces.remainder(size) * np.sqrt(away.shape[1] / 3)
        chord = self._highest(away, _norm, remainder, _TOOL_RESOLUTION)
        value, bound = (2 * np.arcsin(np.minimum(x / (2 * k), 1.0)) for x in (chord.value, chord.bound))
        return Peak(time=chord.time, value=float(value), bound=float(bound))

    def at_via_points(self, count: int) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Times and distances of the tool from its place, m, and rotations, rad, at the via-points."""
        task, trajectory = self._task, self._trajectory
        times = task.path.via_times(count)
        # What is not in the trajectory's time is where it rests; another check says so.
        q = trajectory.evaluate(np.clip(times, trajectory.t[0], trajectory.t[-1]))
        p_WT, R_WT = Kinematics(self._robot).tool_poses(q)
        if self._sag is not None:
            p_WT = p_WT + self._sag.following(q)
        goals = task.path.poses(times)
        away = np.linalg.norm(p_WT - goals.point, axis=1)
        return (times, np.asarray(away)), (times, task.rotation(R_WT, goals))

    @property
    def _point_remainder(self) -> FloatArray:
        remainder = self._pieces.remainder(self._bounds.tool_point)
        return np.asarray(remainder + self._goal_remainder + self._unknown)


def _norm(vectors: FloatArray, piece: IntArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=1))


def speed_deviation(path: ToolPath, pieces: Pieces, velocity: FloatArray, remainder: FloatArray) -> Peak:
    """Enclose the share by which the tool's speed misses that of the process.

    Parameters
    ----------
    path : ToolPath
    pieces : Pieces
        K of them, none of which has a break of the path inside.
    velocity : (K (d + 1), 3), m/s
        Of the tool point, at the points of interpolation.
    remainder : (K,), m/s
        What interpolation may miss of it.

    Notes
    -----
    A speed is not below the velocity's component in any direction. In that of the mean of the control points
    of a piece, which shrinks, the bound from below is as tight as is asked.
    """
    asked = path.process_speed(pieces.middle)
    on = asked > 0
    if not on.any():
        return Peak(time=float(pieces.trajectory.t[0]), value=0.0, bound=0.0)
    speed = asked[on]

    def missed(control: FloatArray, piece: IntArray) -> FloatArray:
        mean = control.mean(axis=2)
        along = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), np.finfo(float).tiny)
        above = np.linalg.norm(control, axis=1) / speed[piece, None] - 1
        below = 1 - np.einsum("kdn,kd->kn", control, along) / speed[piece, None]
        return np.asarray(np.maximum(above, below))

    def exact(control: FloatArray, piece: IntArray) -> FloatArray:
        return np.asarray(np.abs(np.linalg.norm(control, axis=1) / speed[piece, None] - 1))

    between = Pieces(trajectory=pieces.trajectory, start=pieces.start[on], end=pieces.end[on])
    control = pieces.control_points(velocity)[on]
    return highest(between, control, missed, remainder[on] / speed, _SPEED_RESOLUTION, exact)
