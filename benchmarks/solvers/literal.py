"""The torque problem in the formulation of Chang 2021, Eqs. (28)-(37), for SciPy's SLSQP.

The unknowns are the velocities and accelerations at the inner knots, 7 x 48 x 2 = 672 for 50 via-points, and
the bound b of the peak. Continuity of the jerk, zero at both ends, gives 350 equalities; the bounds on
velocity, acceleration, jerk, torque and the tool's deviation are rows at every sample. No exchange, no change
of variables; derivatives are analytic.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize, sparse

from cmbot.common.arrays import FloatArray
from cmbot.optimization.program import StateSamples
from cmbot.planning.torque.constraints import JointTorque, ToolDeviation
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.robot import Dynamics, Kinematics
from cmbot.trajectory.quintic import QuinticTrajectory
from solvers.cases import Case

__all__ = ["LiteralAnswer", "LiteralProblem", "solve_literal"]

Rows = tuple[FloatArray, FloatArray]

# Samples of a segment: with the 40 of plans the dense matrices do not fit into memory.
PER_SEGMENT = 10
_ACCURACY, _MOST_ITERATIONS = 1e-7, 1000


@dataclass(frozen=True, kw_only=True)
class LiteralAnswer:
    """Where SLSQP ended.

    Attributes
    ----------
    trajectory : QuinticTrajectory
    iterations, rows : int
    cut : bool
        Time ran out.
    status : str
        In the solver's words.
    """

    trajectory: QuinticTrajectory
    iterations: int
    rows: int
    cut: bool
    status: str


class _OutOfTimeError(Exception):
    """Stops SLSQP from inside."""


class LiteralProblem:
    """Eqs. (30)-(37) of a case with fixed via-points, over x = (v_2, a_2, ..., v_{n-1}, a_{n-1}, b).

    Parameters
    ----------
    case : Case
    per_segment : int
        Samples of a segment.
    """

    def __init__(self, case: Case, per_segment: int = PER_SEGMENT) -> None:
        self._case, robot = case, case.request.cell.robot
        self._problem = problem = case.problem()
        self._dynamics, self._kinematics = Dynamics(robot), Kinematics(robot)
        space, self._limits = problem.space, robot.limits
        limits = self._limits
        t, (n, d) = space.t, case.via_points.shape
        grid = np.linspace(t[:-1], t[1:], per_segment, endpoint=False, axis=1)
        self.times = np.append(grid.ravel(), t[-1])
        self._z = space.least_jerk(case.via_points)
        # Which knot values are unknowns: not the positions, and nothing at the ends.
        self._free = np.delete(np.arange(3 * n), [*range(0, 3 * n, 3), 1, 2, 3 * n - 2, 3 * n - 1])
        self.size = len(self._free) * d
        self.start = np.append(self._z[self._free].ravel(), 1.0)
        self._rows = [space.design(self.times, order) for order in range(4)]
        self._by_unknowns = [np.asarray(W[:, self._free].toarray()) for W in self._rows]
        for function in problem.constraints:
            if isinstance(function, JointTorque):
                self._torque_bound = function.bound
            elif isinstance(function, ToolDeviation):
                self._deviation_bound, self._path = function.bound, function.task.path
        bounds = (limits.velocity, limits.acceleration, limits.jerk)
        self._bounds = list(zip((1, 2, 3), bounds, strict=True))
        # Eqs. (34) and (37): jerk just after and just before each knot, zero outside.
        self._jumps = _jerk_jumps(problem)
        every = sparse.eye_array(3 * n)
        products = (space.speed_products(every), space.jerk_products(every))
        self._energies = tuple(energy.toarray() for energy in products)
        linear = [np.kron(self._by_unknowns[order], np.diag(1 / bound)) for order, bound in self._bounds]
        both = np.vstack([sign * rows for rows in linear for sign in (1.0, -1.0)])
        self._linear = np.hstack([both, np.zeros((len(both), 1))])
        of_jumps = np.kron(self._jumps[:, self._free], np.diag(1 / limits.jerk))
        self._equalities = np.hstack([of_jumps, np.zeros((len(of_jumps), 1))])

    def knots(self, x: FloatArray) -> FloatArray:
        """Knot vectors (3n, d)."""
        z = self._z.copy()
        z[self._free] = x[:-1].reshape(len(self._free), -1)
        return z

    def trajectory(self, x: FloatArray) -> QuinticTrajectory:
        """Return the trajectory of the unknowns."""
        return self._problem.space.trajectory(self.knots(x))

    def objective(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Return b and the smoothing, and the gradient."""
        z, limits = self.knots(x), self._limits
        bounds = (limits.velocity, limits.jerk)
        parts = (energy @ z / bound**2 for energy, bound in zip(self._energies, bounds, strict=True))
        pull = self._case.smoothing / len(limits.jerk) * sum(parts)
        gradient = np.append(pull[self._free].ravel(), 1.0)
        return float(x[-1]) + 0.5 * float(np.sum(z * pull)), gradient

    def equalities(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Jumps of the jerk as shares of its bounds, and their Jacobian."""
        jumps = (self._jumps @ self.knots(x)) / self._limits.jerk
        return jumps.ravel(), self._equalities

    def rows(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sampled rows ``c(x) >= 0`` and their Jacobian."""
        problem, z = self._problem, self.knots(x)
        states = [W @ z for W in self._rows]
        at = StateSamples(self.times, *states[:3])
        N, d = at.q.shape
        efforts = self._dynamics.derivatives(at.q, at.v, at.a)
        by = (efforts.d_q, efforts.d_v, efforts.d_a)
        norm = np.linalg.norm(efforts.value[:, :3], axis=1)
        toward = efforts.value[:, :3] / (norm * problem.scale)[:, None]
        peak = self._chained([np.einsum("ki,kij->kj", toward, part[:, :3]) for part in by])
        share = efforts.value[:, 3:] / self._torque_bound
        torque = [self._chained([part[:, 3 + i] / self._torque_bound[i] for part in by]) for i in range(d)]
        p, J = self._kinematics.tool_point_jacobians(at.q)
        away = self._path.leg_offset(at.t, p) / self._deviation_bound
        deviation = self._chained([2 * np.einsum("ki,kij->kj", away / self._deviation_bound, J)])
        linear = [sign * states[order] / bound for order, bound in self._bounds for sign in (1, -1)]
        value = [x[-1] - norm / problem.scale, 1 - share.T, 1 + share.T, 1 - (away**2).sum(axis=1)]
        value += [1 - part for part in linear]
        nonlinear = np.vstack([-peak, *(-part for part in torque), *torque, -deviation])
        last = np.zeros((len(nonlinear), 1))
        last[:N] = 1.0
        jacobian = np.vstack([np.hstack([nonlinear, last]), -self._linear])
        return np.concatenate([part.ravel() for part in value]), jacobian

    def _chained(self, parts: list[FloatArray]) -> FloatArray:
        """Derivatives (N, size) by the unknowns from those (N, d) by position, velocity, acceleration."""
        data = sum(
            W[:, :, None] * part[:, None, :] for W, part in zip(self._by_unknowns, parts, strict=False)
        )
        return np.asarray(data).reshape(len(self.times), -1)


def _jerk_jumps(problem: TorqueProblem) -> FloatArray:
    """Matrix (n, 3n) from knot vectors to the jerk after less the jerk before each knot."""
    space = problem.space
    t, h = space.t, np.diff(space.t)
    after, a_third, two_thirds = (
        space.design(t[:-1] + share * h, 3).toarray() for share in (0.0, 1 / 3, 2 / 3)
    )
    # Jerk is quadratic in time, Eq. (27).
    before = after - 3 * a_third + 3 * two_thirds
    nothing = np.zeros((1, 3 * len(t)))
    return np.vstack([after, nothing]) - np.vstack([nothing, before])


def _remembered(call: Callable[[FloatArray], Rows]) -> Callable[[FloatArray], Rows]:
    """Return the last answer where the argument is the same: SLSQP asks for values and derivatives apart."""
    last: list[tuple[FloatArray, Rows]] = []

    def remembering(x: FloatArray) -> Rows:
        if not last or not np.array_equal(x, last[0][0]):
            last[:] = [(x.copy(), call(x))]
        return last[0][1]

    return remembering


def solve_literal(
    case: Case,
    *,
    seconds: float,
    per_segment: int = PER_SEGMENT,
    clock: Callable[[], float] = time.process_time,
) -> LiteralAnswer:
    """Solve the literal problem; after `seconds` it ends with the iteration that it is in."""
    begin = clock()
    literal = LiteralProblem(case, per_segment)
    rows = _remembered(literal.rows)
    x, iterations = literal.start, 0

    def after_iteration(there: FloatArray) -> None:
        nonlocal x, iterations
        x, iterations = there.copy(), iterations + 1
        if clock() - begin > seconds:
            raise _OutOfTimeError

    constraints: list[dict[str, Any]] = [
        {"type": "eq", "fun": lambda x: literal.equalities(x)[0], "jac": lambda x: literal.equalities(x)[1]},
        {"type": "ineq", "fun": lambda x: rows(x)[0], "jac": lambda x: rows(x)[1]},
    ]
    cut, status = False, "cut"
    try:
        result = optimize.minimize(
            literal.objective,
            literal.start,
            jac=True,
            method="SLSQP",
            constraints=constraints,
            callback=after_iteration,
            options={"maxiter": _MOST_ITERATIONS, "ftol": _ACCURACY},
        )
        x, status = np.asarray(result.x), str(result.message)
    except _OutOfTimeError:
        cut = True
    return LiteralAnswer(
        trajectory=literal.trajectory(x),
        iterations=iterations,
        rows=len(rows(x)[0]),
        cut=cut,
        status=status,
    )
