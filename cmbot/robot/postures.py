"""Kinematics and statics of many postures in one call, in closed form over NumPy arrays.

pinocchio looks at one posture a call; charts of self-motion need thousands at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.robot.chain import Chain
from cmbot.robot.robot import Robot

__all__ = ["PostureBatch", "Postures", "ToolBatch"]


# Postures are evaluated in blocks of this many, whose arrays fit the processor's cache.
_BLOCK = 512
# As much as a reach, m, does for the tool's point, this does for its orientation, with room.
_TURN_BENDS = 2.0


class Postures:
    """Evaluates batches of postures of one robot.

    Parameters
    ----------
    robot : Robot
        Its arm is a serial chain of revolute joints, as `load_robot` makes sure.

    Attributes
    ----------
    bend : float, m or rad
        When the joints move by x rad in all, the tool is at most this times the square of x from where its
        Jacobian would have it: no point is further from a joint than the arm's reach.
    """

    def __init__(self, robot: Robot) -> None:
        X_JT = robot.model.frames[robot.tool_frame_id].placement
        self._model = robot.model
        self._tool = np.column_stack([X_JT.rotation, X_JT.translation]).T
        bodies = list(robot.model.inertias)[1:]
        self._levers = np.array([body.lever for body in bodies])
        self._mass = np.array([body.mass for body in bodies])
        self._gravity = np.array(robot.model.gravity.linear)
        self.bend = 0.5 * max(robot.reach, _TURN_BENDS)

    @cached_property
    def _chain(self) -> Chain:
        return Chain(self._model, [*self._levers[:-1, None], np.vstack([self._tool, self._levers[-1:]])])

    @cached_property
    def _tool_only(self) -> Chain:
        return Chain(self._model, [*(np.empty((0, 3)) for _ in self._levers[1:]), self._tool])

    def at(self, q: FloatArray) -> PostureBatch:
        """Evaluate postures `q` (N, n), rad."""
        centre = np.empty((q.shape[1], 3, len(q)))
        tool, axis, origin = self._evaluate(self._chain, q, centre)
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

    def tool_at(self, q: FloatArray) -> ToolBatch:
        """Evaluate the tool alone in postures `q` (N, n), rad, which is quicker."""
        tool, axis, origin = self._evaluate(self._tool_only, q)
        return ToolBatch(
            q=q,
            tool_point=tool[3].T,
            tool_rotation=tool[:3].transpose(2, 1, 0),
            axis=axis.transpose(2, 0, 1),
            origin=origin.transpose(2, 0, 1),
        )

    @staticmethod
    def _evaluate(
        chain: Chain, q: FloatArray, centre: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Tool (4, 3, N), joints' axes and origins (n, 3, N); the centres of mass go to `centre`."""
        N, n = q.shape
        # Components lead and postures trail, so that every operation runs along postures.
        tool, axis, origin = np.empty((4, 3, N)), np.empty((n, 3, N)), np.empty((n, 3, N))
        for start in range(0, N, _BLOCK):
            block = slice(start, start + _BLOCK)
            for i, (p, along, turned) in enumerate(chain.walk(q[block].T)):
                axis[i, :, block], origin[i, :, block] = along, p
                if centre is not None:
                    np.add(p, turned[-1], out=centre[i, :, block])
            tool[..., block] = turned[:4]
            tool[3, :, block] += p
        return tool, axis, origin


@dataclass(frozen=True, kw_only=True)
class ToolBatch:
    """The tool in N postures; everything in W.

    Attributes
    ----------
    q : (N, n), rad
    tool_point : (N, 3), m
    tool_rotation : (N, 3, 3)
    axis, origin : (N, n, 3)
        Direction of each joint's axis and a point on it, m.
    """

    q: FloatArray
    tool_point: FloatArray
    tool_rotation: FloatArray
    axis: FloatArray
    origin: FloatArray

    @cached_property
    def jacobian(self) -> FloatArray:
        """Tool Jacobians (N, 6, n): velocity of the tool point, m/rad, then angular velocity."""
        return np.ascontiguousarray(self.leading_jacobian.transpose(2, 0, 1))

    @cached_property
    def leading_jacobian(self) -> FloatArray:
        """The same as it comes, components first: (6, n, N)."""
        a = self.axis.transpose(2, 1, 0)
        arm = (self.tool_point.T - self.origin.transpose(1, 2, 0)).transpose(1, 0, 2)
        J = np.empty((6, *a.shape[1:]))
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.multiply(a[j], arm[k], out=J[i])
            J[i] -= a[k] * arm[j]
        J[3:] = a
        return J


@dataclass(frozen=True, kw_only=True)
class PostureBatch(ToolBatch):
    """N postures, evaluated; everything in W.

    Attributes
    ----------
    centre : (N, n, 3), m
        Centre of mass of what each joint carries directly.
    mass : (n,), kg
    gravity : (3,), m/s2
    """

    centre: FloatArray
    mass: FloatArray
    gravity: FloatArray

    @property
    def guardrail_force(self) -> FloatArray:
        """Static force (N, 3) on the guardrail, N: the arm's weight, whatever the posture."""
        return np.tile(self.mass.sum() * self.gravity, (len(self.q), 1))

    @cached_property
    def guardrail_torque(self) -> FloatArray:
        """Static torque (N, 3) on the guardrail about O0, Nm."""
        moment = np.tensordot(self.mass, self.centre.transpose(1, 2, 0), axes=1)
        return np.asarray((pin.skew(self.gravity).T @ moment).T)

    @cached_property
    def guardrail_torque_derivative(self) -> FloatArray:
        """Derivatives (N, 3, n) of `guardrail_torque` with respect to the joints, Nm/rad."""
        moved = np.cross(self.axis, self._beyond.transpose(2, 0, 1))
        return np.asarray(np.cross(moved, self.gravity).transpose(0, 2, 1))

    @cached_property
    def joint_torque(self) -> FloatArray:
        """Static joint torques (N, n), Nm (Chang 2021, Eq. (13))."""
        about = pin.skew(self.gravity) @ self._beyond
        return np.asarray((self.axis.transpose(1, 2, 0) * about).sum(axis=1).T)

    @cached_property
    def _beyond(self) -> FloatArray:
        """First moment of mass (n, 3, N) of all that lies beyond each joint, about its origin, kg m."""
        moment = self.mass[:, None, None] * self.centre.transpose(1, 2, 0)
        for i in reversed(range(len(moment) - 1)):
            moment[i] += moment[i + 1]
        carried = np.cumsum(self.mass[::-1])[::-1]
        moment -= carried[:, None, None] * self.origin.transpose(1, 2, 0)
        return np.asarray(moment)
