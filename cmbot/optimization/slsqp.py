"""SciPy's SLSQP on a program made dense and whitened."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed
from cmbot.optimization.constraint_set import OBJECTIVE
from cmbot.optimization.evaluation import NlpEvaluation

# Unknowns without any effect keep the Hessian regular by this.
_LEAST_CURVATURE = 1e-6
# What a point costs that cannot be evaluated: the line search turns back from it.
_UNDEFINED_POINT_COST = 1e6


def solve_slsqp(start: NlpEvaluation, accuracy: float, max_iterations: int) -> tuple[NlpEvaluation, int]:
    """Minimise with the constraints of `start`; return the end and the number of iterations.

    Unknowns are whitened by the Hessian of the smoothing and, by Gauss and Newton, of the mean square; it
    then is the identity, which SLSQP starts with. The peak is minimised in epigraph form. There are no
    equality constraints, with which SLSQP can abort the process. No constraint is added on the way, and its
    success flag is not believed: whoever calls evaluates the constraints again.

    It stops when the objective changes by less than `accuracy` and the constraints' violations sum to less.

    Raises
    ------
    OptimisationFailed
        When it ends where the program cannot be evaluated.
    """
    # Not loaded where another solver is taken.
    from scipy.optimize import Bounds, minimize

    dense = DenseProgram(start)
    result = minimize(
        lambda y: dense.at(y).objective,
        dense.y,
        jac=lambda y: dense.at(y).gradient,
        method="SLSQP",
        bounds=Bounds(dense.lowest, np.inf),
        constraints={
            "type": "ineq",
            "fun": lambda y: -dense.at(y).constraints,
            "jac": lambda y: -dense.at(y).jacobian,
        },
        options={"maxiter": max_iterations, "ftol": accuracy},
    )
    return dense.end(result.x), int(result.nit)


@dataclass(frozen=True, eq=False)
class DenseValues:
    """Objective, its gradient (n,), constraints ``c <= 0`` (K,) and their Jacobian (K, n) at y."""

    y: FloatArray
    objective: float
    gradient: FloatArray
    constraints: FloatArray
    jacobian: FloatArray


class DenseProgram:
    """A program by unknowns y, with the peak behind them where that is minimised.

    Parameters
    ----------
    start : NlpEvaluation
    whitened : bool
        Or the unknowns are those of a step, by which few of the derivatives are other than zero.

    Attributes
    ----------
    n : int
        Unknowns but for the peak.
    y, lowest : (n,) or (n + 1,)
        The start, and what unknowns may not fall below.
    """

    def __init__(self, start: NlpEvaluation, *, whitened: bool = True) -> None:
        self._start, self.n = start, start.parametrization.dimension
        self.whitening = self._whitening() if whitened else np.eye(self.n)
        self._last: DenseValues | None = None
        peak = [max(start.peak, start.stage.target)] if start.stage.bound is None else []
        self.y = np.append(np.zeros(self.n), peak)
        self.lowest = np.append(np.full(self.n, -np.inf), [start.stage.target] * len(peak))

    def _whitening(self) -> FloatArray:
        """Steps (n, n) in which the Hessian of smoothing and mean square is the identity."""
        start, form = self._start, self._start.parametrization
        residuals = start.dense(form.map.toarray())[2]
        H = start.stage.smoothing * form.smoothing_hessian.toarray() + residuals.T @ residuals
        L = np.linalg.cholesky(H + _LEAST_CURVATURE * np.eye(self.n))
        return np.asarray(linalg.solve_triangular(L, np.eye(self.n), lower=True).T)

    def end(self, y: FloatArray) -> NlpEvaluation:
        """Return the program at y.

        Raises
        ------
        OptimisationFailed
            When y is not finite, or the program cannot be evaluated there.
        """
        if not np.isfinite(y).all():
            raise OptimisationFailed("the solver diverged", constraint="any", violation=float("inf"))
        return self._start.displaced(self.whitening @ y[: self.n])

    def at(self, y: FloatArray) -> DenseValues:
        """Evaluate, unless `y` is what it was the last time: SLSQP asks for each value apart."""
        if self._last is None or not np.array_equal(y, self._last.y):
            self._last = self._evaluated(y.copy())
        return self._last

    def _evaluated(self, y: FloatArray) -> DenseValues:
        x, bound = self.whitening @ y[: self.n], self._start.stage.bound
        try:
            here = self._start.displaced(x)
            by = self._start.parametrization.step_jacobian(x) @ self.whitening
        except OptimisationFailed:
            before = self.at(np.append(np.zeros(self.n), y[self.n :]))
            return DenseValues(y, _UNDEFINED_POINT_COST, before.gradient, before.constraints, before.jacobian)
        objective, value = here.values.objective, here.values.value
        gradient, jacobian, _ = here.dense(by)
        if bound is None:
            in_epigraph = here.constraints.family == OBJECTIVE
            objective, gradient = objective + float(y[self.n]), np.append(gradient, 1.0)
            value = value - y[self.n] * in_epigraph
            jacobian = np.hstack([jacobian, -in_epigraph[:, None].astype(float)])
        return DenseValues(y, objective, gradient, value, jacobian)
