"""Kinematics and statics of many postures in one call, in closed form over NumPy arrays.

pinocchio looks at one posture a call; charts of self-motion need thousands at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from cmbot.arrays import FloatArray
from cmbot.robot.robot import Robot

__all__ = ["PostureBatch", "Postures"]


class Postures:
    """Evaluates batches of postures of one robot.

    Parameters
    ----------
    robot : Robot
        Its arm is a serial chain of revolute joints, as `load_robot` makes sure.
    """

    def __init__(self, robot: Robot) -> None:
        model, data = robot.model, robot.model.createData()
        n = robot.dof
        pin.computeJointJacobians(model, data, pin.neutral(model))
        local = [
            pin.getJointJacobian(model, data, i, pin.ReferenceFrame.LOCAL)[3:, i - 1] for i in range(1, n + 1)
        ]
        self._skew = np.array([pin.skew(axis) for axis in local])
        self._axes = np.array(local)
        self._R_fixed = np.array([model.jointPlacements[i].rotation for i in range(1, n + 1)])
        self._p_fixed = np.array([model.jointPlacements[i].translation for i in range(1, n + 1)])
        self._mass = np.array([model.inertias[i].mass for i in range(1, n + 1)])
        self._lever = np.array([model.inertias[i].lever for i in range(1, n + 1)])
        X_JT = model.frames[robot.tool_frame_id].placement
        self._R_JT, self._p_JT = X_JT.rotation, X_JT.translation
        self._gravity = np.array(model.gravity.linear)

    def at(self, q: FloatArray) -> PostureBatch:
        """Evaluate postures `q` (N, n), rad."""
        N, n = q.shape
        sine, cosine = np.sin(q), np.cos(q)
        R, p = np.broadcast_to(np.eye(3), (N, 3, 3)), np.zeros((N, 3))
        axis, origin, centre = (np.empty((N, n, 3)) for _ in range(3))
        for i in range(n):
            K = self._skew[i]
            p = p + R @ self._p_fixed[i]
            # Rodrigues: the joint's rotation is I + sin K + (1 - cos) K^2.
            turn = np.eye(3) + sine[:, i, None, None] * K + (1 - cosine[:, i, None, None]) * (K @ K)
            R = R @ (self._R_fixed[i] @ turn)
            axis[:, i], origin[:, i], centre[:, i] = R @ self._axes[i], p, p + R @ self._lever[i]
        return PostureBatch(
            q=q,
            tool_point=p + R @ self._p_JT,
            tool_rotation=R @ self._R_JT,
            axis=axis,
            origin=origin,
            centre=centre,
            mass=self._mass,
            gravity=self._gravity,
        )


@dataclass(frozen=True, kw_only=True)
class PostureBatch:
    """N postures, evaluated; everything in W.

    Attributes
    ----------
    q : (N, n), rad
    tool_point : (N, 3), m
    tool_rotation : (N, 3, 3)
    axis, origin : (N, n, 3)
        Direction of each joint's axis and a point on it, m.
    centre : (N, n, 3), m
        Centre of mass of what each joint carries directly.
    mass : (n,), kg
    gravity : (3,), m/s2
    """

    q: FloatArray
    tool_point: FloatArray
    tool_rotation: FloatArray
    axis: FloatArray
    origin: FloatArray
    centre: FloatArray
    mass: FloatArray
    gravity: FloatArray

    @cached_property
    def jacobian(self) -> FloatArray:
        """Tool Jacobians (N, 6, n): velocity of the tool point, m/rad, then angular velocity."""
        arm = self.tool_point[:, None] - self.origin
        return np.asarray(np.concatenate([np.cross(self.axis, arm), self.axis], axis=2).transpose(0, 2, 1))

    @cached_property
    def guardrail_torque(self) -> FloatArray:
        """Static torque (N, 3) on the guardrail about O0, Nm."""
        return np.asarray(np.cross(self._moment[:, 0], self.gravity))

    @cached_property
    def guardrail_torque_derivative(self) -> FloatArray:
        """Derivatives (N, 3, n) of `guardrail_torque` with respect to the joints, Nm/rad."""
        moved = np.cross(self.axis, self._beyond)
        return np.asarray(np.cross(moved, self.gravity).transpose(0, 2, 1))

    @cached_property
    def joint_torque(self) -> FloatArray:
        """Static joint torques (N, n), Nm (Chang 2021, Eq. (13))."""
        return np.asarray(-np.einsum("kid,kid->ki", self.axis, np.cross(self._beyond, self.gravity)))

    @cached_property
    def _moment(self) -> FloatArray:
        """First moment of mass (N, n, 3) of all that lies beyond each joint, about O0, kg m."""
        weighted = self.mass[:, None] * self.centre
        return np.asarray(np.flip(np.cumsum(np.flip(weighted, axis=1), axis=1), axis=1))

    @cached_property
    def _beyond(self) -> FloatArray:
        """The same about each joint's origin."""
        carried = np.cumsum(self.mass[::-1])[::-1]
        return np.asarray(self._moment - carried[:, None] * self.origin)
