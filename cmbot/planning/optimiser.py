"""Exchange: solve with few constraints, look for violated ones everywhere, add them, solve again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cmbot.arrays import FloatArray
from cmbot.errors import OptimisationFailed
from cmbot.planning.feasibility import check_feasible
from cmbot.planning.problem import TorqueProblem
from cmbot.planning.slsqp import Subproblem, solve_slsqp
from cmbot.planning.trajectory import QuinticTrajectory
from cmbot.planning.working_set import Violation, WorkingSet

__all__ = ["Optimised", "PassReport", "optimise"]


# The first passes look at every tenth sample and add few constraints: most of those that they would add are
# no longer needed once the others are met.
_COARSE_STRIDE = 10
_COARSE_MOST = 40
# In those passes the smoothing weighs more, so that splines do not swing between the few working times.
_COARSE_SMOOTHING = 1000.0
# SLSQP's line search can stall short of the constraints; started afresh from there it gets on.
_MOST_STALLS = 3
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


def optimise(problem: TorqueProblem, progress: Callable[[PassReport], None] | None = None) -> Optimised:
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
        t = problem.space.t
        self._working.add_everywhere(0.5 * (t[1:] + t[:-1]))
        self.reports: list[PassReport] = []

    def stage(self, name: str, y: FloatArray, bound: float) -> tuple[FloatArray, float]:
        """Run one stage from `y`; return its end and its scaled peak torque."""
        options, tolerance = self._problem.options, self._problem.options.constraint_tolerance
        stride, most, stalls = _COARSE_STRIDE, _COARSE_MOST, 0
        self._working.add_violated(self._problem.trajectory(y), bound, tolerance, stride, most)
        while True:
            if len(self.reports) >= options.max_passes:
                raise self._failure(f"no solution in {options.max_passes} passes", self.reports[-1].worst)
            if name == "peak":
                y, bound, iterations = self._lower_peak(y, bound, _COARSE_SMOOTHING if stride > 1 else 1.0)
            else:
                y, iterations = self._lower_mean_square(y, bound)
            added, worst, peak = self._working.add_violated(
                self._problem.trajectory(y), bound, tolerance, stride, most
            )
            self._report(name, iterations, peak, worst)
            if added:
                continue
            if stride > 1:
                stride, most = 1, len(self._problem.grid)
            elif worst.value <= tolerance:
                return y, peak
            elif stalls == _MOST_STALLS:
                raise self._failure("the solver stopped before the constraints were met", worst)
            else:
                stalls += 1

    def _lower_peak(self, y: FloatArray, bound: float, smoothing: float) -> tuple[FloatArray, float, int]:
        """Solve the peak stage's subproblem in epigraph form; its `smoothing` is so many times the problem's.

        Unknowns are (u, b) with ``y = u / sqrt(smoothing)``, which keeps the smoothing term's Hessian.
        """
        scale = 1.0 / np.sqrt(smoothing)
        smooth = self._problem.smoothing

        def objective(x: FloatArray) -> tuple[float, FloatArray]:
            return float(x[-1] + 0.5 * smooth * (x[:-1] @ x[:-1])), np.append(smooth * x[:-1], 1.0)

        def constraints(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian, torques = self._working.values(scale * x[:-1])
            value[:torques] -= x[-1]
            d_bound = np.zeros((len(value), 1))
            d_bound[:torques] = -1.0
            return -value, -np.hstack([scale * jacobian, d_bound])

        start = np.append(y / scale, bound)
        x, iterations = solve_slsqp(
            Subproblem(start=start, objective=objective, constraints=constraints),
            self._problem.options.max_iterations,
        )
        return scale * x[:-1], float(x[-1]), iterations

    def _lower_mean_square(self, y: FloatArray, bound: float) -> tuple[FloatArray, int]:
        """Solve the mean-square stage's subproblem, the torque's norm held below `bound`.

        Unknowns are u with ``y = C u``, where C whitens the objective's Gauss-Newton Hessian: SLSQP then
        starts with nearly the right curvature.
        """
        L = np.linalg.cholesky(self._problem.mean_square_curvature(y))
        C = linalg.solve_triangular(L, np.eye(len(L)), lower=True).T
        smooth = self._problem.smoothing

        def objective(u: FloatArray) -> tuple[float, FloatArray]:
            y = C @ u
            value, gradient = self._problem.mean_square(y)
            return value + 0.5 * smooth * float(y @ y), C.T @ (gradient + smooth * y)

        def constraints(u: FloatArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian, torques = self._working.values(C @ u)
            value[:torques] -= bound
            return -value, -(jacobian @ C)

        u, iterations = solve_slsqp(
            Subproblem(start=L.T @ y, objective=objective, constraints=constraints),
            self._problem.options.max_iterations,
        )
        return C @ u, iterations

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
