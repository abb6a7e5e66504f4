"""The reference solver: SciPy's SLSQP, on the working set of an exchange."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from cmbot.common.arrays import FloatArray

__all__ = ["Remembered", "Subproblem", "solve_slsqp"]


@dataclass(frozen=True, kw_only=True)
class Subproblem:
    """A smooth problem ``min f(x), c(x) >= 0``.

    Attributes
    ----------
    start : (n,)
    objective : callable
        x to f and its gradient (n,).
    constraints : callable
        x to c (K,) and its Jacobian (K, n).
    """

    start: FloatArray
    objective: Callable[[FloatArray], tuple[float, FloatArray]]
    constraints: Callable[[FloatArray], tuple[FloatArray, FloatArray]]


def solve_slsqp(subproblem: Subproblem, accuracy: float, max_iterations: int) -> tuple[FloatArray, int]:
    """Solve a subproblem by SciPy's sequential quadratic programming.

    There are no equality constraints, so SLSQP's abort on more equalities than variables cannot happen. Its
    success flag is not believed: whoever calls looks at the constraints again.

    Parameters
    ----------
    subproblem : Subproblem
    accuracy : float
        It stops when the objective changes by less and the constraints' violations sum to less.
    max_iterations : int

    Returns
    -------
    x : (n,)
        Where it ended.
    iterations : int
    """
    constraints = Remembered(subproblem.constraints)
    result = optimize.minimize(
        subproblem.objective,
        subproblem.start,
        jac=True,
        method="SLSQP",
        constraints={
            "type": "ineq",
            "fun": lambda x: constraints(x)[0],
            "jac": lambda x: constraints(x)[1],
        },
        options={"maxiter": max_iterations, "ftol": accuracy},
    )
    return np.asarray(result.x), int(result.nit)


class Remembered:
    """SLSQP asks for values and Jacobian apart; both come from one evaluation."""

    def __init__(self, function: Callable[[FloatArray], tuple[FloatArray, FloatArray]]) -> None:
        self._function = function
        self._x: FloatArray | None = None
        self._result: tuple[FloatArray, FloatArray]

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Evaluate, unless `x` is what it was the last time."""
        if self._x is None or not np.array_equal(x, self._x):
            self._x, self._result = x.copy(), self._function(x)
        return self._result
