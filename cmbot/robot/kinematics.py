"""Kinematics of the tool and of the centre of mass (Chang 2021, Eqs. (1)-(3), (15)), and statics.

pinocchio evaluates one posture a call. Charts of the self-motion need thousands: these are evaluated in one
call, in closed form over NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray, cross, read_only
from cmbot.robot.joint_kinds import prismatic_joints
from cmbot.robot.robot import Robot

# Postures are evaluated in blocks of this size, whose arrays fit the processor's cache.
_POSTURES_PER_BLOCK = 512
# Bound of the second derivative of the tool's orientation, where the reach is that of its point.
_ROTATION_CURVATURE = 2.0
# The x axis turns towards y, the y axis away from x.
_TURNING = np.array([1.0, -1.0])[:, None, None]
# From this number of postures on a batch is quicker than one call each: benchmarks/kernels.py.
_MIN_BATCH_POSTURES = 64


class Chain:
    """Vectors that are fixed to the joints of an arm, rotated to W in N postures.

    Parameters
    ----------
    model : pinocchio.Model
        A serial chain of joints that turn or slide, as `load_robot` guarantees.
    vectors : n arrays (k, 3)
        In the frame of each joint; k may differ between joints.
    """

    def __init__(self, model: Any, vectors: Sequence[FloatArray]) -> None:
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        # In a frame whose z axis is the joint's, a rotation mixes the two other axes only.
        self.steps, before = list[tuple[FloatArray, FloatArray]](), np.eye(3)
        self._slides = prismatic_joints(model).tolist()
        for i, fixed in enumerate(vectors, start=1):
            column = pin.getJointJacobian(model, data, i, pin.ReferenceFrame.LOCAL)[:, i - 1]
            own = frame_about(column[:3] if self._slides[i - 1] else column[3:])
            X = model.jointPlacements[i]
            step = np.column_stack([X.translation, X.rotation @ own])
            self.steps.append((step.T @ before, fixed @ own))
            before = own

    def walk(self, q: FloatArray) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Iterate over the joints, base to tool.

        Parameters
        ----------
        q : (n, N), rad, m
            Components lead and postures trail, here and below, so that every operation runs along postures.

        Yields
        ------
        origin : (3, N), m
            Of what the joint moves.
        axis : (3, N)
            Of the joint.
        turned : (k, 3, N)
            Its vectors in W.
        """
        N = q.shape[1]
        cosines, sines = np.cos(q), np.sin(q)
        sines = sines[:, None, None] * _TURNING
        # The axes of the rotated frame, one after the other, each with its components.
        axes = np.repeat(np.eye(3)[:, :, None], N, axis=2).reshape(3, -1)
        origin = np.zeros((3, N))
        for i, (step, fixed) in enumerate(self.steps):
            flat = step @ axes
            axes, moved = flat[1:], flat.reshape(4, 3, N)
            origin, plane, axis = np.add(origin, moved[0], out=moved[0]), moved[1:3], moved[3]
            if self._slides[i]:
                origin += q[i] * axis
            else:
                np.add(cosines[i] * plane, sines[i] * plane[::-1], out=plane)
            yield origin, axis, (fixed @ axes).reshape(-1, 3, N) if len(fixed) else moved[:0]


def frame_about(axis: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) whose third column is the unit vector `axis` (3,)."""
    k = np.abs(axis).argmin()
    x = np.eye(3)[k] - axis[k] * axis
    x /= np.sqrt(x @ x)
    return np.column_stack([x, pin.skew(axis) @ x, axis])


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldPart:
    """The part that an arm holds to a fixed tool, in N postures, and that tool's point.

    Attributes
    ----------
    rotation : (N, 3, 3)
        From the part's frame to W.
    tool_point : (3,), m
        In W.
    """

    rotation: FloatArray
    tool_point: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolBatch:
    """The tool in N postures; everything in W, but for a fixed tool and its Jacobian: in the part's frame.

    Attributes
    ----------
    q : (N, n), rad
    tool_point : (N, 3), m
    tool_rotation : (N, 3, 3)
    axis, origin : (N, m, 3)
        Direction of the axis of each of all joints and a point on it, m.
    arm : Postures
        What evaluated them.
    part : HeldPart or None
        Where the tool is fixed: `Robot.fixed_tool`.
    """

    q: FloatArray
    tool_point: FloatArray
    tool_rotation: FloatArray
    axis: FloatArray
    origin: FloatArray
    arm: Postures
    part: HeldPart | None = None

    def point_velocity(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocity of the tool point (N, 3), m/s, at joint rates `v` (N, n), and its derivatives by position.

        These are (N, 3, n), m/s/rad or 1/s; those by the rates are the first rows of the Jacobian.
        """
        # A subclass may add to the coordinates' Jacobian what moves the point beside the joints.
        J = self.leading_jacobian if self.arm.coupling.is_free else self._joints_jacobian
        # From a part to a fixed tool the chain begins with the last joint.
        step = 1 if self.part is None else -1
        linear, angular = np.split(J.transpose(0, 2, 1)[..., ::step], 2)
        rates = self.arm.coupling.rates(v)[:, ::step]
        moved, turned = linear * rates, angular * rates
        # A joint turns what the joints from it on add, and is turned by the joints before it.
        beyond = np.cumsum(moved[..., ::-1], axis=2)[..., ::-1]
        before = np.cumsum(turned, axis=2) - turned
        d_q = np.cross(angular, beyond, axis=0) + np.cross(before, linear, axis=0)
        slopes = np.asarray(d_q.transpose(1, 0, 2)[..., ::step])
        if self.arm.coupling.is_free:
            return moved.sum(axis=2).T, slopes
        velocity = np.einsum("ijk,kj->ki", self.leading_jacobian[:3], v)
        return velocity, self.arm.coupling.projected(slopes)

    @cached_property
    def push(self) -> FloatArray:
        """The force on the tool (N, 3), N."""
        return np.asarray(self.tool_rotation @ self.arm.tool_force)

    @property
    def push_torque(self) -> FloatArray:
        """Its torque (N, 3) about O0, Nm."""
        return cross(self.tool_point - self.arm.foot_point, self.push)

    @property
    def torque_against_push(self) -> FloatArray:
        """What the joints bear of it (N, n), Nm; forces, N, of joints that slide."""
        return np.asarray(-np.einsum("kij,ki->kj", self.jacobian[:, :3], self.push))

    @cached_property
    def jacobian(self) -> FloatArray:
        """Tool Jacobians (N, 6, n): velocity of the tool point, m/rad or m/m, then angular velocity."""
        return np.ascontiguousarray(self.leading_jacobian.transpose(2, 0, 1))

    @cached_property
    def leading_jacobian(self) -> FloatArray:
        """The same with components first, as it is computed: (6, n, N)."""
        return self.arm.coupling.projected(self._joints_jacobian, axis=1)

    @cached_property
    def _joints_jacobian(self) -> FloatArray:
        """That of all joints: (6, m, N)."""
        a = self.axis.transpose(2, 1, 0)
        point = self.tool_point.T if self.part is None else self.part.tool_point[:, None]
        arm = (point - self.origin.transpose(1, 2, 0)).transpose(1, 0, 2)
        J = np.empty((6, *a.shape[1:]))
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.multiply(a[j], arm[k], out=J[i])
            J[i] -= a[k] * arm[j]
        J[3:] = a
        if self.arm.prismatic.any():
            J[:3, self.arm.prismatic], J[3:, self.arm.prismatic] = a[:, self.arm.prismatic], 0.0
        if self.part is not None:
            # That of the part's point at the tool: see `Robot.tool_seen`.
            halves = J.reshape(2, 3, *J.shape[1:])
            J = -np.einsum("kij,piqk->pjqk", self.part.rotation, halves).reshape(J.shape)
        return J


@dataclass(frozen=True, kw_only=True, eq=False)
class PostureBatch(ToolBatch):
    """The tool and the masses in N postures; everything in W.

    Attributes
    ----------
    centre : (N, m, 3), m
        Centre of mass of each joint's body.
    """

    centre: FloatArray

    @property
    def guardrail_force(self) -> FloatArray:
        """Static force (N, 3) on the guardrail, N: the arm's weight, and the force on the tool."""
        weight = np.full((len(self.q), 3), self.arm.mass.sum() * self.arm.gravity)
        return weight + self.push if self.arm.tool_force.any() else weight

    @cached_property
    def guardrail_wrench(self) -> FloatArray:
        """Static force and torque on the guardrail about O0 (N, 6), N and Nm; read-only."""
        return read_only(np.hstack([self.guardrail_force, self.guardrail_torque]))

    @cached_property
    def guardrail_torque(self) -> FloatArray:
        """Static torque (N, 3) on the guardrail about O0, Nm."""
        moment = np.tensordot(self.arm.mass, self.centre.transpose(1, 2, 0), axes=1)
        if self.arm.foot_point.any():
            moment = moment - self.arm.mass.sum() * self.arm.foot_point[:, None]
        torque = np.asarray((pin.skew(self.arm.gravity).T @ moment).T)
        return torque + self.push_torque if self.arm.tool_force.any() else torque

    @cached_property
    def joint_torque(self) -> FloatArray:
        """Static joint torques (N, n), Nm (Chang 2021, Eq. (13)); forces, N, of joints that slide."""
        about = pin.skew(self.arm.gravity) @ self.carried_moment
        for i in np.flatnonzero(self.arm.prismatic):
            about[i] = -self.arm.carried[i] * self.arm.gravity[:, None]
        torque = self.arm.coupling.projected((self.axis.transpose(1, 2, 0) * about).sum(axis=1).T)
        return torque + self.torque_against_push if self.arm.tool_force.any() else torque

    @cached_property
    def carried_moment(self) -> FloatArray:
        """First moment (m, 3, N), kg m, about each joint's origin of all mass from that joint to the tool."""
        moment = self.arm.mass[:, None, None] * self.centre.transpose(1, 2, 0)
        for i in reversed(range(len(moment) - 1)):
            moment[i] += moment[i + 1]
        moment -= self.arm.carried[:, None, None] * self.origin.transpose(1, 2, 0)
        return np.asarray(moment)


class Postures:
    """Evaluates batches of postures of one robot.

    Parameters
    ----------
    robot : Robot
        Its arm is a serial chain of joints that turn or slide, as `load_robot` guarantees.

    Attributes
    ----------
    bend : float, m or rad
        Bound of the error of a linear prediction: when the joints move by x rad in total, by the coordinates
        of `metric`, the tool is at most this times the square of x from where its Jacobian predicts it.
    metric : PostureMetric
        How far postures are apart.
    coupling : Coupling
        How all m joints follow those of a posture.
    prismatic : (m,)
        Which of them slide.
    mass, carried : (m,), kg
        Of each joint's body, and of all from it to the tool.
    gravity : (3,), m/s2
    tool_force : (3,), N
        That acts on the tool, along its axes; zero with the tool off.
    foot_point : (3,), m
        O0.
    """

    def __init__(self, robot: Robot) -> None:
        X_JT = robot.model.frames[robot.tool_frame_id].placement
        self._model, self.coupling = robot.model, robot.coupling
        self.prismatic = prismatic_joints(robot.model)
        self._tool = np.column_stack([X_JT.rotation, X_JT.translation]).T
        bodies = list(robot.model.inertias)[1:]
        self._levers = np.array([body.lever for body in bodies])
        self.mass = np.array([body.mass for body in bodies])
        self.carried = np.cumsum(self.mass[::-1])[::-1]
        self.gravity = np.array(robot.model.gravity.linear)
        self.tool_force = np.array(robot.tool_force)
        self._fixed_tool, self.foot_point = robot.fixed_tool, np.array(robot.foot_point)
        # A move of one joint by one is one of those that follow it, too.
        moved = float(self.coupling.summed(np.ones(len(bodies))).max())
        self.bend = 0.5 * max(robot.reach, robot.levers.max(), _ROTATION_CURVATURE) * moved**2
        self.metric = robot.metric

    @cached_property
    def _chain(self) -> Chain:
        return Chain(self._model, [*self._levers[:-1, None], np.vstack([self._tool, self._levers[-1:]])])

    @cached_property
    def _tool_only(self) -> Chain:
        return Chain(self._model, [*(np.empty((0, 3)) for _ in self._levers[1:]), self._tool])

    @cached_property
    def geometry(self) -> tuple[bytes, ...]:
        """What `tool_at`, `bend` and `metric` follow from: equal for equal arms, whatever they weigh."""
        chain, metric = self._tool_only, self.metric
        follow = self.coupling
        numbers = (
            *(self._tool, np.array([self.bend, metric.length]), metric.prismatic),
            *(follow.leader, follow.multiplier, follow.offset),
        )
        placed = () if self._fixed_tool is None else (self._fixed_tool.homogeneous,)
        return (
            *(step.tobytes() for step, _ in chain.steps),
            *(each.tobytes() for each in (*numbers, *placed)),
        )

    def at(self, q: FloatArray) -> PostureBatch:
        """Evaluate postures `q` (N, n)."""
        centre = np.empty((len(self.mass), 3, len(q)))
        tool = self._evaluate(self._chain, q, centre)
        return PostureBatch(**tool, centre=centre.transpose(2, 0, 1))

    def tool_at(self, q: FloatArray) -> ToolBatch:
        """Evaluate the tool alone in postures `q` (N, n), which is quicker."""
        return ToolBatch(**self._evaluate(self._tool_only, q))

    def _evaluate(self, chain: Chain, q: FloatArray, centre: FloatArray | None = None) -> dict[str, Any]:
        """The fields of a `ToolBatch`; the centres of mass (m, 3, N) are written to `centre`."""
        every, N = self.coupling.positions(q), len(q)
        tool, axis, origin = np.empty((4, 3, N)), *np.empty((2, every.shape[1], 3, N))
        for start in range(0, N, _POSTURES_PER_BLOCK):
            block = slice(start, start + _POSTURES_PER_BLOCK)
            for i, (p, along, turned) in enumerate(chain.walk(every[block].T)):
                axis[i, :, block], origin[i, :, block] = along, p
                if centre is not None:
                    np.add(p, turned[-1], out=centre[i, :, block])
            tool[..., block] = turned[:4]
            tool[3, :, block] += p
        point, rotation, part = tool[3].T, tool[:3].transpose(2, 1, 0), None
        if (fixed := self._fixed_tool) is not None:
            part = HeldPart(rotation=rotation, tool_point=fixed.translation)
            point = np.einsum("kji,kj->ki", rotation, fixed.translation - point)
            rotation = rotation.transpose(0, 2, 1) @ fixed.rotation
        return {
            "q": q,
            "arm": self,
            "part": part,
            "tool_point": point,
            "tool_rotation": rotation,
            "axis": axis.transpose(2, 0, 1),
            "origin": origin.transpose(2, 0, 1),
        }


class Kinematics:
    """Forward kinematics and Jacobians of a robot's tool and centre of mass, in W.

    Those of a fixed tool, `Robot.fixed_tool`, are in the frame of the part that the arm holds.

    It owns pinocchio's working memory, so it is cheap to call and not to be shared between threads.

    Parameters
    ----------
    robot : Robot
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._data = robot.model.createData()
        self._tool = robot.tool_frame_id

    @cached_property
    def _postures(self) -> Postures:
        return Postures(self.robot)

    def tool_pose(self, q: FloatArray) -> Any:
        """Pose X_WT of the tool frame, a `pinocchio.SE3`, at posture `q` (n,)."""
        X_WE, fixed = self._end_pose(q), self.robot.fixed_tool
        return X_WE if fixed is None else X_WE.actInv(fixed)

    def _end_pose(self, q: FloatArray) -> Any:
        """Pose in W of the robot's tool frame, which has the part where the tool is fixed."""
        pin.forwardKinematics(self.robot.model, self._data, self.robot.coupling.positions(q))
        return pin.updateFramePlacement(self.robot.model, self._data, self._tool).copy()

    def in_world(self, q: FloatArray, points: FloatArray) -> FloatArray:
        """Return in W points (N, 3), m, of a part in postures `q` (N, n); the same without a fixed tool."""
        if self.robot.fixed_tool is None:
            return points
        return np.array([self._end_pose(q_k).act(p) for q_k, p in zip(q, points, strict=True)])

    def tool_poses(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tool points p_WT (N, 3), m, and orientations R_WT (N, 3, 3) at postures `q` (N, n)."""
        if len(q) >= _MIN_BATCH_POSTURES:
            at = self._postures.tool_at(q)
            return at.tool_point, at.tool_rotation
        poses = [self.tool_pose(q_k) for q_k in q]
        p, R = [X_WT.translation for X_WT in poses], [X_WT.rotation for X_WT in poses]
        return np.array(p).reshape(-1, 3), np.array(R).reshape(-1, 3, 3)

    def tool_jacobian(self, q: FloatArray) -> tuple[Any, FloatArray]:
        """Pose X_WT and Jacobian (6, n) of the tool at `q` (n,).

        The Jacobian's rows are the velocity of the tool point, m/rad, then the angular velocity, both in W
        (Chang 2021, Eq. (15)).
        """
        model, data, every = self.robot.model, self._data, self.robot.coupling.positions(q)
        J = pin.computeFrameJacobian(model, data, every, self._tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        X_WE = pin.updateFramePlacement(model, data, self._tool).copy()
        return self.robot.tool_seen(X_WE, self.robot.coupling.projected(J))

    def tool_point_jacobians(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tool points p_WT (N, 3), m, and their Jacobians (N, 3, n), m/rad, at postures `q` (N, n)."""
        if len(q) >= _MIN_BATCH_POSTURES:
            at = self._postures.tool_at(q)
            return at.tool_point, at.jacobian[:, :3]
        p, J = np.empty((len(q), 3)), np.empty((len(q), 3, q.shape[1]))
        for k, q_k in enumerate(q):
            X_WT, J_k = self.tool_jacobian(q_k)
            p[k], J[k] = X_WT.translation, J_k[:3]
        return p, J

    def centre_of_mass(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centre of mass (3,) of the moving arm, m, in W, and its Jacobian (3, n) at `q` (n,)."""
        model, data = self.robot.model, self._data
        # pinocchio leaves the universe's inertia out: this is the arm's centre of mass alone.
        J = pin.jacobianCenterOfMass(model, data, self.robot.coupling.positions(q))
        return data.com[0].copy(), self.robot.coupling.projected(J).copy()


def link_poses(robot: Robot, q: FloatArray) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of all L links and their poses in W at postures `q` (N, n).

    Poses (N, L, 7) are positions, m, and quaternions x, y, z, w.
    """
    model, data = robot.model, robot.model.createData()
    links = [k for k, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    poses = np.empty((len(q), len(links), 7))
    for i, q_i in enumerate(robot.coupling.positions(q)):
        pin.framesForwardKinematics(model, data, q_i)
        for j, link in enumerate(links):
            poses[i, j] = pin.SE3ToXYZQUAT(data.oMf[link])
    return tuple(model.frames[link].name for link in links), poses
