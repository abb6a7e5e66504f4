"""Joint torques and the wrench on the guardrail (Chang 2021, Eqs. (4)-(14)), with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cmbot.arrays import FloatArray
from cmbot.robot.robot import Robot

__all__ = ["Dynamics", "EffortDerivatives", "Efforts", "WrenchDerivatives"]


@dataclass(frozen=True, kw_only=True)
class Efforts:
    """What a motion asks of the joints and of the guardrail.

    Attributes
    ----------
    joint_torque : (N, n), Nm
        Chang 2021, Eq. (13).
    guardrail_force, guardrail_torque : (N, 3), N and Nm
        Wrench that the moving arm exerts on the guardrail, at O0, in W: at rest the force is the arm's
        weight. The torque is minus n_0 of Eq. (12); the constant share of what does not move is not in it
        (`Robot.carrier_torque`).
    """

    joint_torque: FloatArray
    guardrail_force: FloatArray
    guardrail_torque: FloatArray


@dataclass(frozen=True, kw_only=True)
class EffortDerivatives:
    """Guardrail torque and joint torques at N states, stacked, with their derivatives.

    Attributes
    ----------
    value : (N, 3 + n), Nm
        Guardrail torque about O0 in W, then joint torques.
    d_q, d_v, d_a : (N, 3 + n, n)
        Derivatives of `value` with respect to position, velocity and acceleration.
    """

    value: FloatArray
    d_q: FloatArray
    d_v: FloatArray
    d_a: FloatArray


@dataclass(frozen=True, kw_only=True)
class WrenchDerivatives:
    """Wrench on the guardrail at N states, with its derivatives.

    Attributes
    ----------
    value : (N, 6), N and Nm
        Force and torque about O0, in W.
    d_q, d_v, d_a : (N, 6, n)
        Derivatives of `value` with respect to position, velocity and acceleration.
    """

    value: FloatArray
    d_q: FloatArray
    d_v: FloatArray
    d_a: FloatArray


class Dynamics:
    """Inverse dynamics of a robot whose base is held still.

    It owns pinocchio's working memory, so it is cheap to call and not to be shared between threads.

    Parameters
    ----------
    robot : Robot
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._data = robot.model.createData()
        self._floating_data = robot.floating_model.createData()

    def efforts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> Efforts:
        """Evaluate joint torques and guardrail wrench at N states.

        Parameters
        ----------
        q, v, a : (N, n), rad, rad/s, rad/s2
        """
        model, data = self.robot.model, self._data
        tau, wrench = np.empty(q.shape), np.empty((len(q), 6))
        for k in range(len(q)):
            tau[k] = pin.rnea(model, data, q[k], v[k], a[k])
            # What the base exerts on joint 1's subtree, moved from joint 1 to W; data.f[0] stays zero.
            wrench[k] = data.liMi[1].act(data.f[1]).vector
        return Efforts(joint_torque=tau, guardrail_force=-wrench[:, :3], guardrail_torque=-wrench[:, 3:])

    def static_efforts(self, q: FloatArray) -> Efforts:
        """Evaluate joint torques and guardrail wrench at rest in postures `q` (N, n), rad."""
        still = np.zeros_like(q)
        return self.efforts(q, still, still)

    def derivatives(self, q: FloatArray, v: FloatArray, a: FloatArray) -> EffortDerivatives:
        """Evaluate guardrail torque and joint torques with their derivatives at N states.

        Parameters
        ----------
        q, v, a : (N, n), rad, rad/s, rad/s2
        """
        value, d_q, d_v, d_a = self._derivatives(q, v, a, slice(3, 6 + q.shape[1]))
        for array in (value, d_q, d_v, d_a):
            array[:, :3] *= -1.0
        return EffortDerivatives(value=value, d_q=d_q, d_v=d_v, d_a=d_a)

    def wrench_derivatives(self, q: FloatArray, v: FloatArray, a: FloatArray) -> WrenchDerivatives:
        """Evaluate the wrench on the guardrail with its derivatives at N states.

        Parameters
        ----------
        q, v, a : (N, n), rad, rad/s, rad/s2
        """
        value, d_q, d_v, d_a = self._derivatives(q, v, a, slice(0, 6))
        return WrenchDerivatives(value=-value, d_q=-d_q, d_v=-d_v, d_a=-d_a)

    def _derivatives(
        self, q: FloatArray, v: FloatArray, a: FloatArray, rows: slice
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Rows of the free-flyer model's inverse dynamics (N, k), and their derivatives (N, k, n).

        The first six are the wrench of the base on the arm, the others the joint torques.
        """
        model, data = self.robot.floating_model, self._floating_data
        N, n = q.shape
        k = rows.stop - rows.start
        value = np.empty((N, k))
        d_q, d_v, d_a = (np.empty((N, k, n)) for _ in range(3))
        # The free-flyer is held at W: position zero with identity quaternion, no velocity, no acceleration.
        q_f, v_f, a_f = np.zeros(7 + n), np.zeros(6 + n), np.zeros(6 + n)
        q_f[6] = 1.0
        for i in range(N):
            q_f[7:], v_f[6:], a_f[6:] = q[i], v[i], a[i]
            dtau_dq, dtau_dv, M = pin.computeRNEADerivatives(model, data, q_f, v_f, a_f)
            value[i] = data.tau[rows]
            d_q[i], d_v[i], d_a[i] = dtau_dq[rows, 6:], dtau_dv[rows, 6:], M[rows, 6:]
        return value, d_q, d_v, d_a
