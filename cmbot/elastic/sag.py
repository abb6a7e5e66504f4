"""Sag of the arm at rest: static equilibrium of springs, weights and the force on the tool.

Its derivatives are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.first_order import StandingArm
from cmbot.elastic.stiffness_parameters import StiffnessParameters
from cmbot.robot import Kinematics

# Newton's method: most iterations, and the step, m and rad, at which it ends; the remaining error is about
# the step's square.
_MAX_NEWTON_STEPS, _NEWTON_TOLERANCE = 30, 1e-7
# Of iterations with the stiffness of another posture: the remaining error is a share of the step.
_MAX_FIXED_STIFFNESS_STEPS, _FIXED_STIFFNESS_TOLERANCE = 15, 1e-11
# Longest interval, s, between computed postures of a smooth motion; a spline interpolates between them.
_MAX_POSTURE_INTERVAL_S = 0.02
# By this share of itself a distance to first order, scaled to be exact where it is largest, is believed.
_FIRST_ORDER_ERROR = 0.005
# Below this length, m, the gradient of a length is taken as zero.
_ZERO_LENGTH_M = 1e-12


class TooSoftError(InputError):
    """An arm on its guardrail is too soft to carry itself in a posture."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SagStates:
    """An arm at rest in N postures, compared with the rigid arm at the same joint angles."""

    u: FloatArray  # (N, f), m and rad: elastic coordinates
    tool: FloatArray  # (N, 3), m: displacement of the tool point, in W, of a fixed tool in the part's frame
    rotation: FloatArray  # (N, 3), rad: rotation vector of the tool, likewise
    d_tool: FloatArray  # (N, 3, n), m/rad: derivative of `tool` with respect to the joint angles


class Sag:
    """Static equilibrium of an elastic arm under its own weight and the force on its tool.

    All weight counts, that of the climbing mechanism and the payload included, from the undeformed state. The
    weights move with the deflections, which need not be small, and the force turns with the bent tool.
    Without a force equilibrium is a minimum of potential energy.

    It owns pinocchio's working memory, so it is cheap to call and not to be shared between threads.

    Parameters
    ----------
    arm : ElasticArm
    covariance : (p, p), optional
        Of its `StiffnessParameters`, where they were identified.
    """

    def __init__(self, arm: ElasticArm, covariance: FloatArray | None = None) -> None:
        self.arm, self.covariance = arm, covariance
        self._data = arm.model.createData()
        self._rigid = Kinematics(arm.robot)

    def at(self, q: FloatArray) -> SagStates:
        """Find the equilibrium in N postures `q` (N, n), rad; errors as `equilibria`."""
        arm, (N, n) = self.arm, q.shape
        u, tangent, by_joints = self.equilibria(q)
        d_tool, tool, rotation = np.empty((N, 3, n)), np.empty((N, 3)), np.empty((N, 3))
        # Implicit function theorem on stiffness u + loads(q, u) = 0.
        du_dq = -np.linalg.solve(tangent, by_joints)
        for k in range(N):
            X_WT, J = arm.tool_jacobian(arm.configuration(q[k], u[k]), self._data)
            X_WR, J_rigid = self._rigid.tool_jacobian(q[k])
            tool[k] = X_WT.translation - X_WR.translation
            rotation[k] = pin.log3(X_WT.rotation @ X_WR.rotation.T)
            # pinocchio's Jacobian of a single joint is a vector.
            J_rigid = J_rigid.reshape(6, n)
            d_tool[k] = arm.by_joints(J[:3]) + J[:3, arm.elastic] @ du_dq[k] - J_rigid[:3]
        return SagStates(u=u, tool=tool, rotation=rotation, d_tool=d_tool)

    def along(self, t: FloatArray, q: FloatArray) -> FloatArray:
        """Return the tool's displacements (N, 3), m, on a smooth motion `q` (N, n) at times `t` (N,)."""
        every = max(1, int(_MAX_POSTURE_INTERVAL_S / max(float(np.diff(t).max(initial=0.0)), 1e-9)))
        some = np.unique(np.append(np.arange(0, len(t), every), len(t) - 1))
        if every == 1 or len(some) < 4:
            return self.following(q)
        # Imported here, as it is slow to load and needed only where sag is compensated.
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(t[some], self.following(q[some]))(t))

    def loaded(
        self, q: FloatArray, start: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return how the springs hold the tool in N postures `q` (N, n); errors as `equilibria`.

        The tool's displacements (N, 3), m, the elastic coordinates (N, f), and by how much a force on each of
        these moves the tool (N, 3, f), m/N and m/Nm. Equilibria are sought from `start` (N, f), by default
        from zero.
        """
        u, tangent, _ = self.equilibria(q, start)
        rigid = self._rigid.tool_poses(q)[0]
        tool, lever = np.empty((len(q), 3)), np.empty((len(q), 3, u.shape[1]))
        for k in range(len(q)):
            X_WT, J = self.arm.tool_jacobian(self.arm.configuration(q[k], u[k]), self._data)
            tool[k] = X_WT.translation - rigid[k]
            lever[k] = np.linalg.solve(tangent[k].T, J[:3, self.arm.elastic].T).T
        return tool, u, lever

    def by_stiffness(self, q: FloatArray) -> FloatArray:
        """Return the derivatives (N, 3, p), m, of the tool's displacements by the `StiffnessParameters`."""
        _, u, lever = self.loaded(q)
        return np.asarray(lever @ StiffnessParameters(self.arm).relaxation(u))

    def spread(self, q: FloatArray) -> FloatArray:
        """Return the covariances (N, 3, 3), m2, of the tool's displacements at postures `q` (N, n).

        To first order; zero where no covariance is known.
        """
        if self.covariance is None:
            return np.zeros((len(q), 3, 3))
        slope = self.by_stiffness(q)
        return np.asarray(slope @ self.covariance @ slope.transpose(0, 2, 1))

    def following(self, q: FloatArray) -> FloatArray:
        """Return the tool's displacements (N, 3), m, in postures `q` (N, n), each close to the one before.

        The same as `at` finds, quicker: all equilibria are sought with the stiffness of the first one's.
        """
        arm, model, data = self.arm, self.arm.model, self._data
        u = np.zeros((len(q), len(arm.elastic)))
        if u.size:
            tangent, _ = self._solve(q[:1], u[:1])
            chord = np.linalg.inv(0.5 * (tangent[0] + tangent[0].T))
            u[1:], left = u[0], np.arange(1, len(q))
            before = np.full(len(left), np.finfo(np.float64).tiny)
            for _ in range(_MAX_FIXED_STIFFNESS_STEPS):
                loads = np.empty((len(left), u.shape[1]))
                for k, configuration in enumerate(arm.configuration(q[left], u[left])):
                    torque = pin.computeStaticTorque(model, data, configuration, arm.external_forces)
                    loads[k] = torque[arm.elastic]
                step = (chord @ ((arm.stiffness @ u[left, :, None])[:, :, 0] + loads)[:, :, None])[:, :, 0]
                u[left] -= step
                size = np.abs(step).max(axis=1)
                # Steps fall by about the same ratio: so much of the last one is left.
                goes_on = ~(size * np.minimum(size / before, 1.0) < _FIXED_STIFFNESS_TOLERANCE)
                left, before = left[goes_on], size[goes_on]
                if not len(left):
                    break
            u[left] = 0.0
            for number in left.tolist():
                alone = slice(number, number + 1)
                self._solve(q[alone], u[alone], first=number)
        return arm.tool_points(q, u, data) - Kinematics(arm.robot).tool_poses(q)[0]

    def length(self, q: FloatArray, /) -> tuple[FloatArray, FloatArray]:
        """Return the tool's distances (N,), m, at postures `q` (N, n), and their gradients (N, n), m/rad."""
        at = self.at(q)
        length = np.linalg.norm(at.tool, axis=1)
        unit = at.tool / np.maximum(length, _ZERO_LENGTH_M)[:, None]
        return np.asarray(length), np.einsum("ki,kij->kj", unit, at.d_tool)

    def distance(self, q: FloatArray, above: float = -np.inf) -> FloatArray:
        """Return the distances (N,), m, of `length`, without gradients: quicker.

        What is not above `above` is known to about 1 %: it is that of first order, in units of the largest.
        """
        if not np.isfinite(above) or self.arm.robot.pushed or not self.arm.elastic.size or not len(q):
            return np.asarray(np.linalg.norm(self.following(q), axis=1))
        value = np.linalg.norm(self._first_order.sag(q), axis=1)
        largest = [int(value.argmax())]
        value *= self.distance(q[largest])[0] / max(float(value[largest[0]]), _ZERO_LENGTH_M)
        near = value > (1 - 2 * _FIRST_ORDER_ERROR) * above
        exact = self.distance(q[near])
        if (np.abs(value[near] - exact) > _FIRST_ORDER_ERROR * exact).any():
            return self.distance(q)
        value[near] = exact
        return np.asarray(value)

    @cached_property
    def _first_order(self) -> StandingArm:
        return StandingArm(self.arm)

    def equilibria(
        self, q: FloatArray, start: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Find the elastic coordinates (N, f) in N postures `q` (N, n), and their `balance_derivatives`.

        They are sought from `start` (N, f), by default from zero.

        Raises
        ------
        InputError
            When the arm is too soft to carry itself in a posture.
        """
        u = np.zeros((len(q), len(self.arm.elastic))) if start is None else start.copy()
        tangent, by_joints = self._solve(q, u)
        return u, tangent, by_joints

    def balance_derivatives(self, q: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of springs and loads at `q` (n,) and `u` (f,), N/m, N/rad, Nm/rad.

        With respect to the elastic coordinates (f, f): the tangent stiffness, of springs and loads, symmetric
        where no force acts on the tool. With respect to the joint angles (f, n): of the loads alone.
        """
        _, tangent, by_joints = self._balance(q[None], u[None])
        return tangent[0], by_joints[0]

    def _balance(self, q: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What springs and loads lack of balance (N, f) at `q` (N, n) and `u` (N, f), and its derivatives."""
        arm, data = self.arm, self._data
        loads, rows = np.empty(u.shape), np.empty((*u.shape, arm.model.nv))
        for k, configuration in enumerate(arm.configuration(q, u)):
            slopes = pin.computeStaticTorqueDerivatives(arm.model, data, configuration, arm.external_forces)
            loads[k], rows[k] = data.tau[arm.elastic], slopes[arm.elastic]
        # One product for each posture: what is found does not depend on how many there are.
        balance = (arm.stiffness @ u[:, :, None])[:, :, 0] + loads
        return balance, arm.stiffness + rows[:, :, arm.elastic], arm.by_joints(rows)

    def _solve(self, q: FloatArray, u: FloatArray, first: int = 0) -> tuple[FloatArray, FloatArray]:
        """Move `u` (N, f) to the equilibria by Newton's method; the balance's derivatives there.

        Errors count postures from `first`.
        """

        def refused(index: int, why: str) -> InputError:
            expected = "an arm and a guardrail that are stiff enough to carry the weight"
            return TooSoftError("Sag.at", f"q[{first + index}]", f"a posture {why}", expected)

        left = np.arange(len(q))
        for _ in range(_MAX_NEWTON_STEPS):
            balance, tangent, _by_joints = self._balance(q[left], u[left])
            try:
                step = np.linalg.solve(tangent, balance[:, :, None])[:, :, 0]
            except np.linalg.LinAlgError as error:
                singular = int(np.abs(np.linalg.det(tangent)).argmin())
                raise refused(int(left[singular]), "without equilibrium") from error
            u[left] -= step
            left = left[~(np.abs(step).max(axis=1, initial=0.0) < _NEWTON_TOLERANCE)]
            if not len(left):
                break
        else:
            raise refused(int(left[0]), "whose equilibrium was not found")
        _, tangent, by_joints = self._balance(q, u)
        try:
            # Then no small displacement gains more from the loads than it costs the springs.
            np.linalg.cholesky(0.5 * (tangent + tangent.transpose(0, 2, 1)))
        except np.linalg.LinAlgError as error:
            least = np.linalg.eigvalsh(0.5 * (tangent + tangent.transpose(0, 2, 1)))[:, 0]
            raise refused(int(least.argmin()), "from which the arm topples") from error
        return tangent, by_joints
