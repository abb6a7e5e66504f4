"""SNOPT in cmbot's exchange, in the place of SLSQP: what is left of a ratio is the solver's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.optimization.evaluation import NlpEvaluation
from cmbot.optimization.exchange import Result, minimize_smoothed_peak
from cmbot.optimization.slsqp import DenseProgram
from cmbot.planning.torque.decomposition import exchange_options
from solvers.cases import Case
from solvers.drake import Block, DrakeProgram, solve_with_drake

__all__ = ["solve_by_exchange"]

# With it SNOPT ends within some 1e-5 of the optimum; iterations in a pass, at most.
_OPTIMALITY, _MOST = 1e-4, 100
# Where zeros are looked for, beside the start.
_ASIDE = 1e-3


def solve_by_exchange(case: Case) -> Result:
    """Solve a case; errors are those of the exchange.

    Raises
    ------
    MissingExtra
        When Drake is not installed.
    """
    problem = case.problem()
    return minimize_smoothed_peak(
        problem, replace(exchange_options(problem), solver=_snopt, slsqp_iterations=_MOST)
    )


def _snopt(start: NlpEvaluation, accuracy: float, max_iterations: int) -> tuple[NlpEvaluation, int]:
    """Minimise with the constraints of `start`, as `cmbot.optimization.slsqp.solve_slsqp` does."""
    sliding = start.parametrization.movable.size > 0
    dense = DenseProgram(start, whitened=sliding)
    pattern = None
    if not sliding:
        # The splines are linear in a step then: what is zero at two points stays so.
        moved = dense.y + np.append(np.full(dense.n, _ASIDE), np.zeros(len(dense.y) - dense.n))
        pattern = (dense.at(moved).jacobian != 0) | (dense.at(dense.y).jacobian != 0)
    rows = len(start.values.value)

    def objective(y: FloatArray) -> tuple[float, FloatArray]:
        at = dense.at(y)
        return at.objective, at.gradient

    def constraints(y: FloatArray) -> tuple[FloatArray, FloatArray]:
        at = dense.at(y)
        return at.constraints, at.jacobian

    block = Block(
        of=np.arange(len(dense.y)),
        low=np.full(rows, -np.inf),
        high=np.zeros(rows),
        rows=lambda y: dense.at(y).constraints,
        jacobian=constraints,
        pattern=pattern,
    )
    program = DrakeProgram(
        start=dense.y,
        lowest=dense.lowest,
        highest=np.full(len(dense.y), np.inf),
        objective=objective,
        blocks=(block,),
    )
    limits = {"Major iterations limit": max_iterations, "Major optimality tolerance": _OPTIMALITY}
    ended = solve_with_drake(program, "snopt", **limits)
    return dense.end(ended.x), ended.iterations
