"""Exchange: solve with few constraints, look for violated ones everywhere, add them, solve again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmbot.errors import OptimisationFailed
from cmbot.planning.feasibility import check_feasible
from cmbot.planning.problem import TorqueProblem
from cmbot.planning.slsqp import Subproblem, solve_slsqp
from cmbot.planning.trajectory import QuinticTrajectory
from cmbot.planning.working_set import Violation, WorkingSet

__all__ = ["Optimised", "PassReport", "optimise"]

FloatArray = NDArray[np.float64]

# The first passes look at every tenth sample and add few constraints: most of those that they would add are
# no longer needed once the others are met.
_COARSE_STRIDE = 10
_COARSE_MOST = 40
# A peak this near to that of the resting ends cannot be told from it.
_AT_REST = 1e-6


@dataclass(frozen=True, kw_only=True)
class PassReport:
    """Where the optimisation stands after a pass.

    Attributes
    ----------
    stage : str
        ``peak`` or ``mean square``.
    number : int
        Passes so far.
    iterations : int
        Solver iterations of this pass.
    constraints : int
        Size of the working set.
    peak_torque : float, Nm
        Largest torque on the guardrail at the samples.
    worst : Violation
        Constraint violated most; below the tolerance all are met.
    """

    stage: str
    number: int
    iterations: int
    constraints: int
    peak_torque: float
    worst: Violation


@dataclass(frozen=True, kw_only=True)
class Optimised:
    """An optimised trajectory and how it was found.

    Attributes
    ----------
    trajectory : QuinticTrajectory
    passes : tuple of PassReport
    """

    trajectory: QuinticTrajectory
    passes: tuple[PassReport, ...]


def optimise(
    problem: TorqueProblem, progress: Callable[[PassReport], None] | None = None
) -> Optimised:
    """Solve the torque problem with SLSQP.

    Parameters
    ----------
    problem : TorqueProblem
    progress : callable, optional
        Called with a `PassReport` after every pass.

    Raises
    ------
    OptimisationFailed
        When the via-points admit no trajectory within the limits, or none was found.
    """
    check_feasible(problem)
    run = _Run(problem, progress)
    y = np.zeros(problem.dimension)
    at_rest = problem.peak_at_rest / problem.scale * (1 + _AT_REST)
    peak = 1.0
    if peak > at_rest:
        y, peak = run.stage("peak", y, peak)
    if peak <= at_rest:
        y, _ = run.stage("mean square", y, at_rest)
    return Optimised(trajectory=problem.trajectory(y), passes=tuple(run.reports))


class _Run:
    """The passes of one optimisation; its working set is kept from stage to stage."""

    def __init__(self, problem: TorqueProblem, progress: Callable[[PassReport], None] | None) -> None:
        self._problem = problem
        self._progress = progress
        self._working = WorkingSet(problem)
        self._working.add_torque_times(problem.space.t)
        self.reports: list[PassReport] = []

    def stage(self, name: str, y: FloatArray, bound: float) -> tuple[FloatArray, float]:
        """Run one stage from `y`; return its end and its scaled peak torque."""
        options = self._problem.options
        stride = _COARSE_STRIDE
        self._working.add_violated(
            self._problem.trajectory(y), bound, options.constraint_tolerance, stride, _COARSE_MOST
        )
        while True:
            if len(self.reports) >= options.max_passes:
                raise self._failure(f"no solution in {options.max_passes} passes", self.reports[-1].worst)
            if name == "peak":
                x, iterations = solve_slsqp(self._peak_subproblem(y, bound), options.max_iterations)
                y, bound = x[:-1], float(x[-1])
            else:
                subproblem, C = self._mean_subproblem(y, bound)
                u, iterations = solve_slsqp(subproblem, options.max_iterations)
                y = C @ u
            most = _COARSE_MOST if stride > 1 else len(self._problem.grid)
            added, worst, peak = self._working.add_violated(
                self._problem.trajectory(y), bound, options.constraint_tolerance, stride, most
            )
            self._report(name, iterations, peak, worst)
            if added:
                continue
            if stride > 1:
                stride = 1
            elif worst.value > options.constraint_tolerance:
                raise self._failure("the solver stopped before the constraints were met", worst)
            else:
                return y, peak

    def _peak_subproblem(self, y: FloatArray, bound: float) -> Subproblem:
        """Epigraph form: unknowns (y, b)."""

        def objective(x: FloatArray) -> tuple[float, FloatArray]:
            smooth = self._problem.smoothing
            return float(x[-1] + 0.5 * smooth * (x[:-1] @ x[:-1])), np.append(smooth * x[:-1], 1.0)

        def constraints(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian, torques = self._working.values(x[:-1])
            value[:torques] -= x[-1]
            d_bound = np.zeros((len(value), 1))
            d_bound[:torques] = -1.0
            return -value, -np.hstack([jacobian, d_bound])

        return Subproblem(start=np.append(y, bound), objective=objective, constraints=constraints)

    def _mean_subproblem(self, y: FloatArray, bound: float) -> tuple[Subproblem, FloatArray]:
        """Mean square of the torque, its norm below `bound`; unknowns u with ``y = C u``.

        C whitens the objective's Gauss-Newton Hessian, so that SLSQP starts with nearly the right curvature.
        """
        L = np.linalg.cholesky(self._problem.mean_square_curvature(y))
        C = linalg.solve_triangular(L, np.eye(len(L)), lower=True).T

        def objective(u: FloatArray) -> tuple[float, FloatArray]:
            y = C @ u
            value, gradient = self._problem.mean_square(y)
            smooth = self._problem.smoothing
            return value + 0.5 * smooth * float(y @ y), C.T @ (gradient + smooth * y)

        def constraints(u: FloatArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian, torques = self._working.values(C @ u)
            value[:torques] -= bound
            return -value, -(jacobian @ C)

        return Subproblem(start=L.T @ y, objective=objective, constraints=constraints), C

    def _report(self, stage: str, iterations: int, peak: float, worst: Violation) -> None:
        report = PassReport(
            stage=stage,
            number=len(self.reports) + 1,
            iterations=iterations,
            constraints=len(self._working),
            peak_torque=peak * self._problem.scale,
            worst=worst,
        )
        self.reports.append(report)
        if self._progress is not None:
            self._progress(report)

    def _failure(self, reason: str, worst: Violation) -> OptimisationFailed:
        return OptimisationFailed(reason, constraint=worst.name, violation=worst.value)
