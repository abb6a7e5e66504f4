"""The Hessian of a sampled problem's Lagrangian: casadi's derivatives, sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np
from measure import required
from scipy import sparse

from cmbot.common.arrays import FloatArray
from solvers.sampled import ROUND, SampledProblem
from solvers.symbolic_arm import SymbolicArm, verified

__all__ = ["LagrangianHessian"]

_TINY = 1e-300


class LagrangianHessian:
    """Upper triangle of the Hessian, as Ipopt wants it.

    Parameters
    ----------
    sampled : SampledProblem

    Attributes
    ----------
    pattern : sparse array (D, D)
        Where it may be other than zero.

    Raises
    ------
    MissingExtra
        When casadi is not installed.
    """

    def __init__(self, sampled: SampledProblem) -> None:
        self._sampled = sampled
        problem, arm = sampled.problem, verified(sampled.robot)
        self._of_states = _of_states(arm, sampled).map(len(problem.grid))
        self._of_task = _of_task(arm, sampled.case.request.task.path.orientation)
        self._legs = _legs(sampled)
        self._J = sampled.states_by_unknowns
        reached = abs(self._J)
        blocks = self._blocks(np.ones((len(problem.grid), *2 * (3 * sampled.robot.dof,))))
        pattern = sparse.triu(reached.T @ (blocks @ reached) + abs(sampled.smoothing_curvature))
        # The bound of the peak, last among the unknowns, is linear everywhere.
        self.pattern = sparse.csc_array(sparse.block_diag([pattern, sparse.coo_array((1, 1))], format="csc"))
        self.pattern.sort_indices()

    def __call__(self, x: FloatArray, of_objective: float, multipliers: FloatArray) -> FloatArray:
        """Return the nonzeros, in the order of `pattern`, at `x` (D,) with multipliers (K,) of the rows."""
        sampled = self._sampled
        d, N, u = sampled.robot.dof, len(sampled.problem.grid), sampled.u(x)
        states = np.hstack([W @ u for W in sampled.weights[:3]]).T
        of_rows = [
            multipliers[:N],
            *multipliers[N : N * (d + 1)].reshape(N, d).T,
            multipliers[N * (d + 1) : N * (d + 2)],
        ]
        H = np.array(self._of_states(states, np.stack(of_rows), self._legs))
        blocks = self._blocks(H.reshape(3 * d, N, 3 * d).transpose(1, 0, 2))
        total = (self._J.T @ (blocks @ self._J) + of_objective * sampled.smoothing_curvature).toarray()
        if sampled.case.sliding:
            n = len(sampled.case.via_points)
            q, shares = u[-n:], multipliers[-6 * n :].reshape(n, 6)
            for k in range(n):
                here = slice((sampled.splines.count + k) * d, (sampled.splines.count + k + 1) * d)
                unit = sampled.unit[here]
                total[here, here] += unit[:, None] * np.array(self._of_task(q[k], shares[k])) * unit
        column = np.repeat(np.arange(self.pattern.shape[1]), np.diff(self.pattern.indptr))
        return np.asarray(total[self.pattern.indices, column])

    def _blocks(self, H: FloatArray) -> sparse.bsr_array:
        N, k, _ = H.shape
        return sparse.bsr_array(
            (np.ascontiguousarray(H), np.arange(N), np.arange(N + 1)), shape=(N * k, N * k)
        )


def _of_states(arm: SymbolicArm, sampled: SampledProblem) -> Any:
    """Function of one sample's state (3d,), multipliers (d + 2,) and leg (6,): Hessian (3d, 3d)."""
    ca = required("casadi")
    problem, d = sampled.problem, sampled.robot.dof
    state = ca.vertcat(arm.q, arm.v, arm.a)
    multipliers, leg = ca.SX.sym("multipliers", d + 2), ca.SX.sym("leg", 6)
    away, edge = arm.tool_point - leg[:3], leg[3:]
    along = ca.fmin(ca.fmax(ca.dot(away, edge) / ca.fmax(ca.dot(edge, edge), _TINY), 0), 1)
    rows = ca.vertcat(
        ca.norm_2(arm.guardrail_torque) / problem.scale,
        arm.joint_torque / ca.DM(sampled.torque_bound),
        ca.sqrt(ca.sumsqr(away - along * edge) / sampled.deviation_bound**2 + ROUND**2),
    )
    H, _ = ca.hessian(ca.dot(multipliers, rows), state)
    return ca.Function("of_states", [state, multipliers, leg], [ca.densify(H)])


def _of_task(arm: SymbolicArm, orientation: FloatArray) -> Any:
    """Function of a via-point (d,) and the multipliers (6,) of its task residuals: Hessian (d, d)."""
    ca = required("casadi")
    multipliers = ca.SX.sym("multipliers", 6)
    E = arm.tool_rotation @ ca.DM(orientation.T)
    turn = 0.5 * ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1])
    H, _ = ca.hessian(ca.dot(multipliers, ca.vertcat(arm.tool_point, turn)), arm.q)
    return ca.Function("of_task", [arm.q, multipliers], [ca.densify(H)])


def _legs(sampled: SampledProblem) -> FloatArray:
    """Where the leg of each sample begins, and where it leads: (6, N), m."""
    path = sampled.case.request.task.path
    leg = np.searchsorted(path.leg_times, sampled.problem.grid, side="right") - 1
    leg = np.clip(leg, 0, len(path.seconds) - 1)
    return np.hstack([path.corners[leg], np.diff(path.corners, axis=0)[leg]]).T
