"""casadi and Ipopt on the very problems that cmbot solves, with analytic derivatives.

All samples as rows: derivatives from cmbot's own kernels, the Hessian from casadi's of the same dynamics, or
none (L-BFGS). Or only the rows that cmbot's exchange ends with, which tells how much of a difference is the
formulation's and how much the solver's.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import cast
from unittest import mock

import numpy as np
from cases import Case
from ipopt_problem import Program, solve
from lagrangian import LagrangianHessian
from sampled import FAR, SampledProblem
from scipy import sparse

from cmbot.common.arrays import FloatArray
from cmbot.optimization import exchange as optimiser
from cmbot.optimization.slsqp import Remembered, Subproblem, solve_slsqp
from cmbot.planning.torque.families import FixedKnots
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["Answer", "solve_sampled", "solve_working_set"]

# On Ipopt's scaled optimality conditions; constraints as closely as cmbot meets them.
_TOLERANCE, _CONSTRAINTS = 1e-6, 1e-5
# The start is near the optimum: a first barrier as large as Ipopt's own, 0.1, would lead far away from it.
# Where via-points slide, it has to be smaller, and monotone, which with L-BFGS is not the default.
_BARRIER = {"mu_init": 1e-4}
_SLIDING_BARRIER = {"mu_init": 1e-6, "mu_strategy": "monotone"}


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a solver found.

    Attributes
    ----------
    trajectory : QuinticTrajectory
    iterations : int
    status : str
        In the solver's words.
    rows : int
        Constraints.
    seconds : float
        Of processor time.
    """

    trajectory: QuinticTrajectory
    iterations: int
    status: str
    rows: int
    seconds: float


def solve_sampled(case: Case, *, exact: bool, seconds: float = 600.0) -> Answer:
    """Solve a case with all samples as rows, cut after `seconds` of processor time.

    Raises
    ------
    MissingExtra
        When casadi is not installed.
    """
    begin = time.process_time()
    sampled = SampledProblem(case, case.problem("slsqp"))
    program = Program(
        start=sampled.start,
        lowest=sampled.lowest,
        highest=sampled.highest,
        low=sampled.low,
        high=sampled.high,
        objective=sampled.objective,
        values=sampled.values,
        jacobian=sampled.jacobian,
        pattern=sampled.pattern,
        hessian=LagrangianHessian(sampled) if exact else None,
    )
    options = {"tol": _TOLERANCE, "constr_viol_tol": _CONSTRAINTS}
    options |= _SLIDING_BARRIER if case.sliding else _BARRIER
    ended = solve(program, {**options, "max_cpu_time": float(seconds)})
    return Answer(
        trajectory=sampled.trajectory(ended.x),
        iterations=ended.iterations,
        status=ended.status,
        rows=len(sampled.low),
        seconds=time.process_time() - begin,
    )


def solve_working_set(case: Case) -> Answer:
    """Solve a case with fixed via-points on the last working set of cmbot's exchange, from where all start.

    Only what Ipopt takes counts as `seconds`: the working set is given.

    Raises
    ------
    MissingExtra
        When casadi is not installed.
    """
    problem, asked = case.problem("slsqp"), []

    def recorded(subproblem: Subproblem, accuracy: float, most: int) -> tuple[FloatArray, int]:
        asked.append(subproblem)
        return solve_slsqp(subproblem, accuracy, most)

    with mock.patch.object(optimiser, "solve_slsqp", recorded):
        optimiser.optimise(problem)
    last = asked[-1]
    begin = time.process_time()
    # Without any number of the whitened splines the spline is that of least jerk.
    start = np.append(np.zeros(len(last.start) - 1), 1.0)
    far, rows = np.full(len(start), FAR), len(last.constraints(start)[0])
    constraints = Remembered(last.constraints)
    program = Program(
        start=start,
        lowest=-far,
        highest=far,
        low=np.zeros(rows),
        high=np.full(rows, FAR),
        objective=last.objective,
        values=lambda x: constraints(x)[0],
        jacobian=lambda x: constraints(x)[1].T.ravel(),
        pattern=sparse.csc_array(np.ones((rows, len(start)))),
    )
    ended = solve(program, {"tol": _TOLERANCE, **_BARRIER})
    seconds = time.process_time() - begin
    family = cast(FixedKnots, problem.family).rebuilt(problem.family.start, case.weight)
    trajectory = problem.trajectory(family, ended.x[:-1])
    return Answer(
        trajectory=trajectory, iterations=ended.iterations, status=ended.status, rows=rows, seconds=seconds
    )
