"""The torque problem with every sample of the grid as a row: what a solver without an exchange is given.

The unknowns are the local splines' (`cmbot.trajectory.local_basis`): no equality keeps them C3, and a row
touches a few of them only. Sliding via-points are unknowns themselves, kept on the tool task by equalities.
Last comes the bound b of the peak. Rows, in this order::

    f(t) - b <= 0                       the peak
    -1 <= tau(t) / tau_C <= 1           joint torques
    |offset(t)| <= bound                the tool's deviation, made smooth
    low <= q, v, a, j(t) <= high        joint limits, linear
    task(q_k) = 0                       sliding via-points only

The clearance is left out: where it is violated, `cases.judged` reports it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.optimization.program import StateSamples
from cmbot.planning.torque.constraints import JointTorque, ToolDeviation
from cmbot.robot import Dynamics, Kinematics, Postures
from cmbot.trajectory.quintic import QuinticTrajectory
from solvers.cases import Case

__all__ = ["FAR", "ROUND", "SampledProblem"]

FAR = 1e19
# Unit of a via-point that is an unknown, rad, and how many of them it may move.
_UNIT, _LONGEST = 0.1, 3.0
# A distance d in units of its bound has a kink at 0; sqrt(d^2 + ROUND^2) has none, and is as steep far away.
ROUND = 0.3
_TASK = 6


@dataclass(frozen=True)
class _Entries:
    """Splines at the samples, where they are not zero: weights (4, E), samples (E,) and columns (E,)."""

    weight: FloatArray
    row: IntArray
    column: IntArray


class SampledProblem:
    """A case with all samples as rows; only for tasks that keep the whole pose.

    Parameters
    ----------
    case : Case

    Attributes
    ----------
    start : (D,)
        The splines of least jerk, and their peak.
    lowest, highest : (D,)
        Of the unknowns.
    low, high : (K,)
        Of the rows.
    torque_bound : (d,), Nm
    deviation_bound : float, m
    """

    def __init__(self, case: Case) -> None:
        self.case, self.robot = case, case.request.cell.robot
        self.problem = problem = case.problem()
        self.splines = problem.parametrization.splines
        (n, d), count = case.via_points.shape, self.splines.count
        # All of u: coefficients, then via-points; where these stay, the last columns are no unknowns.
        self._u = np.vstack([problem.parametrization.coefficients, case.via_points])
        self.columns = len(self._u) if case.sliding else count
        self.size = self.columns * d
        self.unit = np.vstack([self.splines.unit, np.full((n, d), _UNIT)])[: self.columns].ravel()
        self.start = np.append(np.zeros(self.size), 1.0)
        self.lowest, self.highest = np.full(self.size + 1, -FAR), np.full(self.size + 1, FAR)
        if case.sliding:
            self.lowest[count * d : -1], self.highest[count * d : -1] = -_LONGEST, _LONGEST
        if case.pinned:
            first = slice(count * d, (count + 1) * d)
            self.lowest[first] = self.highest[first] = 0.0
        for function in problem.constraints:
            if isinstance(function, JointTorque):
                self.torque_bound = function.bound
            elif isinstance(function, ToolDeviation):
                self.deviation_bound = function.bound
        self._dynamics, self._kinematics = Dynamics(self.robot), Kinematics(self.robot)
        self._postures = Postures(self.robot)
        N = len(problem.grid)
        blocks = [(-FAR, 0.0, N), (-1.0, 1.0, N * d), (-FAR, float(np.hypot(1.0, ROUND)), N)]
        low, high = ([np.full(block[2], block[side]) for block in blocks] for side in (0, 1))
        for bound in problem.bounds:
            low.append(np.tile(bound.low / bound.scale, N))
            high.append(np.tile(bound.high / bound.scale, N))
        task = np.zeros(_TASK * n if case.sliding else 0)
        self.low = np.maximum(np.concatenate([*low, task]), -FAR)
        self.high = np.minimum(np.concatenate([*high, task]), FAR)

    def u(self, x: FloatArray) -> FloatArray:
        """Coefficients and via-points (2n - 4, d) of the unknowns `x` (D,)."""
        u = self._u.copy()
        u[: self.columns] += (x[:-1] * self.unit).reshape(self.columns, -1)
        return u

    def trajectory(self, x: FloatArray) -> QuinticTrajectory:
        """Return the trajectory of the unknowns."""
        return self.problem.space.trajectory(np.asarray(self.splines.columns @ self.u(x)))

    def objective(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Bound and smoothing, and the gradient (D,)."""
        u = self.u(x)
        slope = self.case.smoothing * (self.splines.smoothing_curvature @ u.ravel())
        return float(x[-1]) + 0.5 * float(u.ravel() @ slope), np.append(slope[: self.size] * self.unit, 1.0)

    @cached_property
    def smoothing_curvature(self) -> sparse.csr_array:
        """Hessian (D - 1, D - 1) of the smoothing by the unknowns but b."""
        unit = sparse.diags_array(self.unit)
        curvature = self.splines.smoothing_curvature[: self.size, : self.size]
        return sparse.csr_array(self.case.smoothing * (unit @ curvature @ unit))

    def values(self, x: FloatArray) -> FloatArray:
        """Return all rows (K,)."""
        u, problem = self.u(x), self.problem
        states = [W @ u for W in self.weights]
        of_state = self.state_values(StateSamples(problem.grid, *states[:3]))
        linear = [states[bound.order] / bound.scale for bound in problem.bounds]
        parts = [of_state[:, 0] - x[-1], of_state[:, 1:-1], of_state[:, -1], *linear, self.task(u)[0]]
        return np.concatenate([part.ravel() for part in parts])

    def state_values(self, at: StateSamples, *, peak_alone: bool = False) -> FloatArray:
        """Rows of N states (N, d + 2), but for b: peak, joint torques, distance of the tool; or (N, 1)."""
        peak = self.problem.objective.sample(at)[0]
        if peak_alone:
            return peak
        joint = self._dynamics.efforts(at.q, at.v, at.a).joint_torque / self.torque_bound
        point = self._kinematics.tool_poses(at.q)[0]
        away = self.case.request.task.path.leg_offset(at.t, point) / self.deviation_bound
        distance = np.sqrt((away**2).sum(axis=1) + ROUND**2)
        return np.hstack([peak, joint, distance[:, None]])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Nonzeros of the Jacobian, in the order of `pattern`."""
        u, problem = self.u(x), self.problem
        D = self.state_derivatives(StateSamples(problem.grid, *(W @ u for W in self.weights[:3])))
        entries, d = self._entries, self.robot.dof
        data = sum(entries.weight[o][:, None, None] * D[o][entries.row] for o in range(3))
        data = (data * self.unit.reshape(self.columns, d)[entries.column][:, None, :]).ravel()
        task = _UNIT * self.task(u)[1]
        return np.concatenate([data, self._constant, task.ravel()])[self._order]

    def state_derivatives(self, at: StateSamples, *, peak_alone: bool = False) -> FloatArray:
        """Derivatives (3, N, d + 2, d) of `state_values` by position, velocity and acceleration."""
        N, d = at.q.shape
        D = np.zeros((3, N, 1 if peak_alone else d + 2, d))
        rows = self._dynamics.derivatives(at.q, at.v, at.a)
        value = np.linalg.norm(rows.value[:, :3], axis=1)
        direction = rows.value[:, :3] / (value * self.problem.scale)[:, None]
        for order, by in enumerate((rows.d_q, rows.d_v, rows.d_a)):
            D[order, :, 0] = np.einsum("ki,kij->kj", direction, by[:, :3])
            if not peak_alone:
                D[order, :, 1:-1] = by[:, 3:] / self.torque_bound[:, None]
        if peak_alone:
            return D
        p, J = self._kinematics.tool_point_jacobians(at.q)
        away = self.case.request.task.path.leg_offset(at.t, p) / self.deviation_bound
        distance = np.sqrt((away**2).sum(axis=1) + ROUND**2)[:, None]
        D[0, :, -1] = np.einsum("ki,kij->kj", away / distance, J) / self.deviation_bound
        return D

    @cached_property
    def pattern(self) -> sparse.csc_array:
        """Where the Jacobian (K, D) may be other than zero."""
        row, column = self._places
        shape = (len(self.low), self.size + 1)
        return sparse.csc_array(sparse.coo_array((np.ones(len(row)), (row, column)), shape=shape))

    @cached_property
    def states_by_unknowns(self) -> sparse.csr_array:
        """Derivatives (N 3d, D - 1) of positions, velocities and accelerations."""
        entries, d = self._entries, self.robot.dof
        part, joint = np.arange(3)[:, None, None], np.arange(d)
        row = (3 * entries.row[:, None] + part) * d + joint
        column = np.broadcast_to(d * entries.column[:, None] + joint, row.shape)
        unit = self.unit.reshape(self.columns, d)[entries.column]
        data = entries.weight[:3, :, None] * unit
        shape = (3 * d * len(self.problem.grid), self.size)
        return sparse.csr_array((data.ravel(), (row.ravel(), column.ravel())), shape=shape)

    @cached_property
    def _order(self) -> IntArray:
        row, column = self._places
        return np.lexsort((row, column))

    @cached_property
    def _places(self) -> tuple[IntArray, IntArray]:
        """Rows and columns of the Jacobian's entries, in the order in which `jacobian` fills them."""
        entries, (n, d), N = self._entries, self.case.via_points.shape, len(self.problem.grid)
        joint = np.arange(d)
        column = d * entries.column[:, None] + joint
        first = np.concatenate([[0], N + joint, [N * (d + 1)]])
        step = np.concatenate([[1], np.full(d, d), [1]])
        of_state = first + step * entries.row[:, None]
        rows = [np.repeat(of_state, d, axis=1).ravel(), np.arange(N)]
        columns = [np.tile(column, (1, d + 2)).ravel(), np.full(N, self.size)]
        for k in range(len(self.problem.bounds)):
            rows.append((N * (d + 2 + k * d) + d * entries.row[:, None] + joint).ravel())
            columns.append(column.ravel())
        if self.case.sliding:
            shape = (n, _TASK, d)
            task = N * (d + 2 + len(self.problem.bounds) * d) + np.arange(n * _TASK).reshape(n, _TASK, 1)
            rows.append(np.broadcast_to(task, shape).ravel())
            via = d * (self.splines.count + np.arange(n))[:, None, None] + joint
            columns.append(np.broadcast_to(via, shape).ravel())
        return np.concatenate(rows), np.concatenate(columns)

    @cached_property
    def _constant(self) -> FloatArray:
        """Entries of the peak's bound and of the joint limits."""
        entries, d = self._entries, self.robot.dof
        unit = self.unit.reshape(self.columns, d)[entries.column]
        limits = (entries.weight[b.order][:, None] * unit / b.scale for b in self.problem.bounds)
        return np.concatenate([np.full(len(self.problem.grid), -1.0), *(x.ravel() for x in limits)])

    @cached_property
    def weights(self) -> list[sparse.csr_array]:
        """Matrices (N, 2n - 4) from u to positions, velocities, accelerations and jerks at the samples."""
        every, shape = self._splines, (len(self.problem.grid), self.splines.columns.shape[1])
        return [sparse.csr_array((w, (every.row, every.column)), shape=shape) for w in every.weight]

    @cached_property
    def _entries(self) -> _Entries:
        every = self._splines
        inside = every.column < self.columns
        return _Entries(every.weight[:, inside], every.row[inside], every.column[inside])

    @cached_property
    def _splines(self) -> _Entries:
        """All of them, those of via-points that stay too."""
        rows = self.splines.rows(self.problem.grid)
        column = self.splines.support[rows.segment]
        sample, place = np.nonzero(column >= 0)
        return _Entries(rows.weight[sample, :, place].T, sample, column[sample, place])

    def task(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Task residuals (n, 6) at sliding via-points, and their derivatives (n, 6, d)."""
        n, d = self.case.via_points.shape
        if not self.case.sliding:
            return np.empty((0, _TASK)), np.empty((0, _TASK, d))
        return self.task_at(np.arange(n), u[-n:])

    def task_at(self, number: IntArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Task residuals (m, 6) of some via-points at `q` (m, d), and their derivatives (m, 6, d)."""
        request = self.case.request
        at = self._postures.at(np.ascontiguousarray(q))
        E = at.tool_rotation @ request.task.path.orientation.T
        off = at.tool_point - request.task.path.position(request.times[number])
        turn = 0.5 * np.stack([E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]], 1)
        by_turn = 0.5 * (np.trace(E, axis1=1, axis2=2)[:, None, None] * np.eye(3) - E)
        J = np.concatenate([at.jacobian[:, :3], by_turn @ at.jacobian[:, 3:]], axis=1)
        return np.hstack([off, turn]), J
