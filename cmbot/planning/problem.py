"""The torque problem with fixed knots (Chang 2021, Eqs. (30)-(37)), without its equalities.

Unknown are the numbers x of `SplineSpace` (46 a joint for 50 via-points), whitened: y = 0 is the least-jerk
spline and ``|y|^2 / 2`` is the smoothing term, so that its Hessian, the identity, is what SLSQP starts with.
Stages share the constraints of Eqs. (31)-(32), the tool's deviation and the clearance:

- peak: minimise ``b + |y|^2 / 2`` with ``|n_0(t)| <= b scale`` at the working times (Eq. (30));
- mean square: where the peak sits at a resting end it cannot fall, so with ``|n_0(t)|`` held below it
  ``mean |n_0 / scale|^2 / 2 + |y|^2 / 2`` is minimised instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cmbot.arrays import FloatArray, IntArray
from cmbot.planning.spline_space import SplineSpace
from cmbot.planning.state_functions import (
    ClearanceMargin,
    GuardrailTorque,
    JointTorque,
    StateFunction,
    States,
    ToolDeviation,
)
from cmbot.planning.task import ToolTask
from cmbot.planning.trajectory import QuinticTrajectory
from cmbot.robot import Dynamics, Kinematics, Robot
from cmbot.scene.clearance import Clearances
from cmbot.scene.options import PlannerOptions

__all__ = ["TorqueProblem"]


# Sampled constraints are kept this share inside their bounds, for what lies between the samples; bounds on
# polynomials are met at their exact extrema and need only room for the solver's tolerance.
_SAMPLED_SHARE = 1e-3
_EXACT_SHARE_IN_TOLERANCES = 10.0
# The same room for the clearance, m.
_CLEARANCE_ROOM = 1e-5
# Smoothing below this weight whitens no better.
_LEAST_WHITENING = 1e-6
# Gauss points per segment at which the mean square of the torque is taken.
_MEAN_SAMPLES = 3


@dataclass(frozen=True)
class KinematicBound:
    """``low <= derivative of the joint's position <= high``, all along (Chang 2021, Eq. (31))."""

    order: int
    low: FloatArray
    high: FloatArray
    scale: FloatArray
    name: str


class TorqueProblem:
    """Splines through fixed via-points, their constraints and the torque that they put on the guardrail.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
    t : (n,), s
        Times of the via-points.
    via_points : (n, d), rad
    clearances : Clearances
    options : PlannerOptions
    """

    def __init__(
        self,
        robot: Robot,
        task: ToolTask,
        t: FloatArray,
        via_points: FloatArray,
        clearances: Clearances,
        options: PlannerOptions,
    ) -> None:
        self.robot = robot
        self.options = options
        self.dynamics = Dynamics(robot)
        self.space = SplineSpace(t)
        self._origin = self.space.least_jerk(via_points)
        whitening = max(options.smoothing_weight, _LEAST_WHITENING)
        self.smoothing = options.smoothing_weight / whitening
        L = np.linalg.cholesky(self.space.jerk_gram.toarray())
        self.whitened_basis = linalg.solve_triangular(L, self.space.basis.toarray().T, lower=True).T
        self.joint_scale = robot.limits.jerk * np.sqrt(robot.dof / whitening)

        grid = np.linspace(t[:-1], t[1:], options.samples_per_segment, endpoint=False, axis=1)
        self.grid = np.append(grid.ravel(), t[-1])
        ends = self.dynamics.static_efforts(via_points[[0, -1]]).guardrail_torque
        self.peak_at_rest = float(np.linalg.norm(ends, axis=1).max())
        start = np.zeros(self.dimension)
        states = self.states(start, self.grid)
        torque = self.dynamics.efforts(states.q, states.v, states.a).guardrail_torque
        self.scale = float(np.linalg.norm(torque, axis=1).max())
        self.torque = GuardrailTorque(self.dynamics, self.scale)
        self.bounds = _kinematic_bounds(robot, 1 - _EXACT_SHARE_IN_TOLERANCES * options.constraint_tolerance)
        kinematics = Kinematics(robot)
        inside = 1 - _SAMPLED_SHARE
        self.functions: tuple[StateFunction, ...] = (
            JointTorque(self.dynamics, robot.limits.torque * inside),
            ToolDeviation(kinematics, task, options.max_tool_deviation_m * inside),
            ClearanceMargin(clearances, options.safety_margin_m + _CLEARANCE_ROOM),
        )
        nodes, weights = np.polynomial.legendre.leggauss(_MEAN_SAMPLES)
        h = np.diff(t)[:, None]
        self._mean_times = (t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
        self._mean_weights = (0.5 * h * weights).ravel() / (t[-1] - t[0])
        self._mean_rows = self.rows(self._mean_times)

    @property
    def dimension(self) -> int:
        """Number of unknowns."""
        return self.robot.dof * self.space.dimension

    def trajectory(self, y: FloatArray) -> QuinticTrajectory:
        """Return the trajectory of the unknowns `y`."""
        return self.space.trajectory(self._knots(y))

    def states(self, y: FloatArray, times: FloatArray) -> States:
        """Return the joints' states at `times` (N,)."""
        return States(times, *self.trajectory(y).states(times))

    def rows(self, times: FloatArray) -> FloatArray:
        """Whitened basis splines and their first three derivatives at `times`, (4, N, n - 4)."""
        return np.stack([self.space.design(times, order) @ self.whitened_basis for order in range(4)])

    def chain(self, rows: FloatArray, d_q: FloatArray, d_v: FloatArray, d_a: FloatArray) -> FloatArray:
        """Take derivatives by the states (N, d) to derivatives by the unknowns, (N, dimension)."""
        parts = (d[:, :, None] * rows[order][:, None, :] for order, d in enumerate((d_q, d_v, d_a)))
        return np.asarray(sum(parts) * self.joint_scale[:, None]).reshape(len(d_q), -1)

    def chain_one(self, rows: FloatArray, joint: IntArray, factor: FloatArray) -> FloatArray:
        """Derivatives (N, dimension) of ``factor * derivative of one joint``, `rows` (N, n - 4)."""
        J = np.zeros((len(rows), self.robot.dof, rows.shape[1]))
        J[np.arange(len(rows)), joint] = (factor * self.joint_scale[joint])[:, None] * rows
        return J.reshape(len(rows), -1)

    def mean_square(self, y: FloatArray) -> tuple[float, FloatArray]:
        """Half the time mean of ``|n_0 / scale|^2``, and its gradient."""
        states = self.states(y, self._mean_times)
        at = self.dynamics.derivatives(states.q, states.v, states.a)
        torque = at.value[:, :3] / self.scale
        weighted = self._mean_weights[:, None] * torque / self.scale
        d = [np.einsum("ki,kij->kj", weighted, x[:, :3]) for x in (at.d_q, at.d_v, at.d_a)]
        gradient = sum(
            (self._mean_rows[order].T @ d[order]).T * self.joint_scale[:, None] for order in range(3)
        )
        value = 0.5 * float(self._mean_weights @ np.einsum("ki,ki->k", torque, torque))
        return value, np.asarray(gradient).ravel()

    def mean_square_curvature(self, y: FloatArray) -> FloatArray:
        """Gauss-Newton Hessian (dimension, dimension) of `mean_square` with the smoothing term, at `y`."""
        states = self.states(y, self._mean_times)
        at = self.dynamics.derivatives(states.q, states.v, states.a)
        weight = np.sqrt(self._mean_weights)[:, None] / self.scale
        J = np.vstack(
            [
                self.chain(self._mean_rows, *(weight * x[:, axis] for x in (at.d_q, at.d_v, at.d_a)))
                for axis in range(3)
            ]
        )
        return np.asarray(J.T @ J + self.smoothing * np.eye(self.dimension))

    def _knots(self, y: FloatArray) -> FloatArray:
        x = y.reshape(self.robot.dof, -1) * self.joint_scale[:, None]
        return np.asarray(self._origin + self.whitened_basis @ x.T)


def _kinematic_bounds(robot: Robot, inside: float) -> tuple[KinematicBound, ...]:
    limits = robot.limits
    middle = np.where(np.isfinite(limits.lower), 0.5 * (limits.lower + limits.upper), 0.0)
    half = np.where(np.isfinite(limits.lower), 0.5 * (limits.upper - limits.lower), np.inf)
    low, high = middle - half * inside, middle + half * inside
    symmetric = ((limits.velocity, "velocity"), (limits.acceleration, "acceleration"), (limits.jerk, "jerk"))
    return (
        KinematicBound(0, low, high, np.where(np.isfinite(half), half, 1.0), "position"),
        *(
            KinematicBound(order, -bound * inside, bound * inside, bound, name)
            for order, (bound, name) in enumerate(symmetric, start=1)
        ),
    )
