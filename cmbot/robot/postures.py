"""Kinematics and statics of many postures in one call, in closed form over NumPy arrays.

pinocchio looks at one posture a call; charts of self-motion need thousands at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.arrays import FloatArray
from cmbot.robot.robot import Robot

__all__ = ["PostureBatch", "Postures"]


# Postures are evaluated in blocks of this many, whose arrays fit the processor's cache.
_BLOCK = 512


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
        axes = [
            pin.getJointJacobian(model, data, i, pin.ReferenceFrame.LOCAL)[3:, i - 1] for i in range(1, n + 1)
        ]
        self._steps = [
            _step(model.jointPlacements[i], axis, model.inertias[i].lever)
            for i, axis in enumerate(axes, start=1)
        ]
        self._mass = np.array([model.inertias[i].mass for i in range(1, n + 1)])
        X_JT = model.frames[robot.tool_frame_id].placement
        self._tool = np.column_stack([X_JT.rotation, X_JT.translation]).T
        self._gravity = np.array(model.gravity.linear)

    def at(self, q: FloatArray) -> PostureBatch:
        """Evaluate postures `q` (N, n), rad."""
        N, n = q.shape
        # Components lead and postures trail, so that every operation runs along postures.
        tool = np.empty((4, 3, N))
        axis, origin, centre = (np.empty((n, 3, N)) for _ in range(3))
        for start in range(0, N, _BLOCK):
            block = slice(start, start + _BLOCK)
            self._evaluate(
                q[block].T, tool[..., block], axis[..., block], origin[..., block], centre[..., block]
            )
        return PostureBatch(
            q=q,
            tool_point=tool[3].T,
            tool_rotation=tool[:3].transpose(2, 1, 0),
            axis=axis.transpose(2, 0, 1),
            origin=origin.transpose(2, 0, 1),
            centre=centre.transpose(2, 0, 1),
            mass=self._mass,
            gravity=self._gravity,
        )

    def _evaluate(
        self, q: FloatArray, tool: FloatArray, axis: FloatArray, origin: FloatArray, centre: FloatArray
    ) -> None:
        N = q.shape[1]
        sine, cosine = np.sin(q), np.cos(q)
        # Columns of the rotation to the frame before the joint, one after the other, (3, 3 N).
        columns = np.repeat(np.eye(3)[:, :, None], N, axis=2).reshape(3, -1)
        p = np.zeros((3, N))
        for i, step in enumerate(self._steps):
            moved = (step @ columns).reshape(-1, 3, N)
            p = p + moved[0]
            axis[i], origin[i] = moved[1], p
            turned = moved[2:6] + sine[i] * moved[6:10] + cosine[i] * moved[10:14]
            centre[i] = p + turned[3]
            columns = turned[:3].reshape(3, -1)
        tool[:] = (self._tool @ columns).reshape(4, 3, N)
        tool[3] += p


def _step(placement: Any, axis: FloatArray, lever: FloatArray) -> FloatArray:
    """Vectors (14, 3) of one joint in the frame of the one before.

    Its origin, its axis, and then what is constant, what goes with the sine and what with the cosine in
    Rodrigues' formula I + sin K + (1 - cos) K^2: the joint's three axes and its lever.
    """
    R, K = placement.rotation, pin.skew(axis)
    body = np.column_stack([np.eye(3), lever])
    parts = [R @ M @ body for M in (np.eye(3) + K @ K, K, -K @ K)]
    return np.column_stack([placement.translation, R @ axis, *parts]).T


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
        axis, origin = self.axis.transpose(1, 2, 0), self.origin.transpose(1, 2, 0)
        a, arm = axis.transpose(1, 0, 2), (self.tool_point.T - origin).transpose(1, 0, 2)
        J = np.concatenate(
            [
                [a[1] * arm[2] - a[2] * arm[1], a[2] * arm[0] - a[0] * arm[2], a[0] * arm[1] - a[1] * arm[0]],
                a,
            ]
        )
        return np.ascontiguousarray(J.transpose(2, 0, 1))

    @property
    def guardrail_force(self) -> FloatArray:
        """Static force (N, 3) on the guardrail, N: the arm's weight, whatever the posture."""
        return np.tile(self.mass.sum() * self.gravity, (len(self.q), 1))

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
