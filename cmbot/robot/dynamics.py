"""Joint torques and the wrench on the guardrail (Chang 2021, Eqs. (4)-(14)), with exact derivatives.

The force on the tool, `Robot.tool_force`, is part of both: the joints bear ``-J' F``, the guardrail F and its
moment about O0. In the frame of the last joint it is constant, so pinocchio takes it as an external force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray, cross
from cmbot.robot.kinematics import Postures
from cmbot.robot.robot import Robot


def external_forces(model: Any, tool_frame_id: int, tool_force: Sequence[float]) -> Any:
    """Return a force on the tool as pinocchio takes it: one a joint, in the joints' frames.

    Parameters
    ----------
    model : pinocchio.Model
    tool_frame_id : int
        The tool's frame in it.
    tool_force : (3,), N
        Along the tool's axes.
    """
    forces = pin.StdVec_Force()
    forces.extend([pin.Force.Zero()] * model.njoints)
    tool = model.frames[tool_frame_id]
    forces[tool.parentJoint] = tool.placement.act(pin.Force(np.array(tool_force), np.zeros(3)))
    return forces


@dataclass(frozen=True, kw_only=True, eq=False)
class Efforts:
    """Joint torques and wrench on the guardrail at N states.

    Attributes
    ----------
    joint_torque : (N, n), Nm, of joints that slide N
        Chang 2021, Eq. (13).
    guardrail_force, guardrail_torque : (N, 3), N and Nm
        Wrench that the moving arm exerts on the guardrail, at O0, in W: at rest the force is the arm's
        weight and the force on the tool. The torque is minus n_0 of Eq. (12), without the constant part
        `Robot.carrier_torque`.
    """

    joint_torque: FloatArray
    guardrail_force: FloatArray
    guardrail_torque: FloatArray

    @property
    def guardrail_wrench(self) -> FloatArray:
        """The wrench (N, 6), force then torque."""
        return np.hstack([self.guardrail_force, self.guardrail_torque])


@dataclass(frozen=True, kw_only=True, eq=False)
class EffortDerivatives:
    """Some rows of the efforts at N states, with their derivatives."""

    value: FloatArray  # (N, k), N and Nm
    d_q: FloatArray  # (N, k, n), by position
    d_v: FloatArray  # (N, k, n), by velocity
    d_a: FloatArray  # (N, k, n), by acceleration


class Dynamics:
    """Inverse dynamics of a robot whose base is held still, at N states.

    A state is `q`, `v`, `a`: (N, n), rad, rad/s, rad/s2, of joints that slide m, m/s, m/s2.
    Values come from one call for all states, `pinocchio.rneaInParallel`; derivatives from one call a state.
    ``benchmarks/kernels.py`` times the alternatives.

    It owns pinocchio's working memory, so it is cheap to call and not to be shared between threads.

    Parameters
    ----------
    robot : Robot
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._pool = pin.ModelPool(robot.floating_model, 1)
        self._data = robot.model.createData()
        self._foot_point = np.array(robot.foot_point)
        self._external = external_forces(robot.model, robot.tool_frame_id, robot.tool_force)

    @cached_property
    def _postures(self) -> Postures:
        return Postures(self.robot)

    def efforts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> Efforts:
        """Evaluate joint torques and guardrail wrench."""
        posture, (q, v, a) = q, self._every(q, v, a)
        N, n = q.shape
        # The free-flyer is held at O0: position zero with identity quaternion, no velocity, no acceleration.
        q_f, v_f, a_f = np.zeros((N, 7 + n)), np.zeros((N, 6 + n)), np.zeros((N, 6 + n))
        q_f[:, 6] = 1.0
        q_f[:, 7:], v_f[:, 6:], a_f[:, 6:] = q, v, a
        # One thread: a call is too short to wait for others.
        tau = pin.rneaInParallel(1, self._pool, q_f.T, v_f.T, a_f.T)
        # It returns a single state as a vector. The first six rows are the wrench of the base on the arm.
        tau = tau.reshape(6 + n, N).T
        joint_torque = self.robot.coupling.projected(tau[:, 6:]).copy()
        force, torque = -tau[:, :3], -tau[:, 3:6]
        if self.robot.pushed:
            tool = self._postures.tool_at(posture)
            joint_torque += tool.torque_against_push
            force, torque = force + tool.push, torque + tool.push_torque
        return Efforts(joint_torque=joint_torque, guardrail_force=force, guardrail_torque=torque)

    def static_efforts(self, q: FloatArray) -> Efforts:
        """Evaluate joint torques and guardrail wrench at rest in postures `q` (N, n), rad."""
        still = np.zeros_like(q)
        return self.efforts(q, still, still)

    def derivatives(self, q: FloatArray, v: FloatArray, a: FloatArray) -> EffortDerivatives:
        """Evaluate guardrail torque about O0 in W, then joint torques: 3 + n rows."""
        q, v, a = self._every(q, v, a)
        N, n = q.shape
        model, data, project = self.robot.model, self._data, self.robot.coupling.projected
        dF_dq, dF_dv, dF_da = data.dFdq, data.dFdv, data.dFda
        # With the force, which is dropped at the end.
        value = np.empty((N, 6 + n))
        d_q, d_v, d_a = (np.empty((N, 6 + n, n)) for _ in range(3))
        for k in range(N):
            rows = pin.computeRNEADerivatives(model, data, q[k], v[k], a[k], self._external)
            d_q[k, 6:], d_v[k, 6:], d_a[k, 6:] = rows
            d_q[k, :6], d_v[k, :6], d_a[k, :6] = dF_dq, dF_dv, dF_da
            value[k, :6], value[k, 6:] = data.of[1].vector, data.tau
        for part in (value[:, :, None], d_q, d_v, d_a):
            if self._foot_point.any():
                # From the origin of W to O0.
                part[:, 3:6] -= cross(self._foot_point, part[:, :3].swapaxes(1, 2)).swapaxes(1, 2)
            part[:, 3:6] *= -1.0
        value, *slopes = (self._projected(each[:, 3:]) for each in (value, d_q, d_v, d_a))
        d_q, d_v, d_a = map(project, slopes)
        return EffortDerivatives(value=value, d_q=d_q, d_v=d_v, d_a=d_a)

    def _every(self, *states: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A state (N, m) of all joints."""
        q, v, a = states
        coupling = self.robot.coupling
        return coupling.positions(q), coupling.rates(v), coupling.rates(a)

    def _projected(self, rows: FloatArray) -> FloatArray:
        """Rows (N, 3 + n, ...) of the base's torque and of the coordinates', by those of all joints."""
        coupling = self.robot.coupling
        if coupling.is_free:
            return rows
        return np.concatenate([rows[:, :3], coupling.projected(rows[:, 3:], axis=1)], axis=1)

    def wrench_derivatives(self, q: FloatArray, v: FloatArray, a: FloatArray) -> EffortDerivatives:
        """Evaluate the wrench on the guardrail about O0 in W: 6 rows, force then torque."""
        q, v, a = self._every(q, v, a)
        N, n = q.shape
        model, data = self.robot.model, self._data
        # For the derivatives of the joint torques pinocchio computes each joint's contribution to the forces
        # in W, one column a joint: for a chain these are the columns of the wrench's derivatives. Its arrays
        # run along columns: transposed, they are copied in one go.
        dF_dq, dF_dv, dF_da = data.dFdq.T, data.dFdv.T, data.dFda.T
        value = np.empty((N, 6))
        d_q, d_v, d_a = (np.empty((N, n, 6)) for _ in range(3))
        for k in range(N):
            pin.computeRNEADerivatives(model, data, q[k], v[k], a[k], self._external)
            value[k] = data.of[1].vector
            d_q[k], d_v[k], d_a[k] = dF_dq, dF_dv, dF_da
        for array in (value, d_q, d_v, d_a):
            if self._foot_point.any():
                array[..., 3:] -= cross(self._foot_point, array[..., :3])
            array *= -1.0
        project = self.robot.coupling.projected
        d_q, d_v, d_a = (project(array.transpose(0, 2, 1)) for array in (d_q, d_v, d_a))
        return EffortDerivatives(value=value, d_q=d_q, d_v=d_v, d_a=d_a)
