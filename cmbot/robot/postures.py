"""Kinematics and statics of many postures in one call, in closed form over NumPy arrays.

pinocchio looks at one posture a call; charts of self-motion need thousands at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.robot.chain import Chain
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
        model, n = robot.model, robot.dof
        self._chain = Chain(model, [model.inertias[i].lever[None] for i in range(1, n + 1)])
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
        for i, (p, along, turned) in enumerate(self._chain.walk(q)):
            axis[i], origin[i] = along, p
            centre[i] = p + turned[3]
        tool[:] = (self._tool @ turned[:3].reshape(3, -1)).reshape(4, 3, -1)
        tool[3] += p


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
