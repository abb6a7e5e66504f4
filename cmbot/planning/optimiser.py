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
# The mean square is not worth jerk at its bound all along: so many times the peak stage's smoothing.
_MEAN_SMOOTHING = 100.0
# Accuracy of a pass, relative to the objective, which is about 1.
_COARSE_ACCURACY, _ACCURACY = 1e-5, 1e-8
# SLSQP's line search can stall short of the constraints; started afresh from there it gets on.
_MOST_STALLS = 3
# Unknowns without any effect, such as the slide of a pinned via-point, keep the Hessian regular.
_LEAST_CURVATURE = 1e-6
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
    via_points : (n, d), rad
        What it was to pass through: those given, or where they slid to.
    passes : tuple of PassReport
    """

    trajectory: QuinticTrajectory
    via_points: FloatArray
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
    if not problem.family.sliding:
        check_feasible(problem)
    run = _Run(problem, progress)
    at_rest = problem.peak_at_rest / problem.scale * (1 + _AT_REST)
    peak = 1.0
    if peak > at_rest:
        peak = run.stage("peak", peak)
    if peak <= at_rest:
        run.stage("mean square", at_rest)
    return Optimised(
        trajectory=problem.trajectory(run.family, run.x),
        via_points=run.family.via_points_at(run.x),
        passes=tuple(run.reports),
    )


class _Run:
    """The passes of one optimisation; its working set is kept from stage to stage."""

    def __init__(self, problem: TorqueProblem, progress: Callable[[PassReport], None] | None) -> None:
        self._problem = problem
        self._progress = progress
        self._working = WorkingSet(problem)
        t = problem.space.t
        self._working.add_everywhere(0.5 * (t[1:] + t[:-1]))
        self.family = problem.family
        self.x = problem.family.start
        self.reports: list[PassReport] = []

    def stage(self, name: str, bound: float) -> float:
        """Run one stage from where the last one ended; return its scaled peak torque."""
        options, tolerance = self._problem.options, self._problem.options.constraint_tolerance
        stride, most, stalls = _COARSE_STRIDE, _COARSE_MOST, 0
        self._look(bound, stride, most)
        while True:
            if len(self.reports) >= options.max_passes:
                raise self._failure(f"no solution in {options.max_passes} passes", self.reports[-1].worst)
            coarse = stride > 1
            if name == "peak":
                bound, iterations = self._lower_peak(bound, coarse=coarse)
            else:
                iterations = self._lower_mean_square(bound, coarse=coarse)
            added, worst, peak = self._look(bound, stride, most)
            self._report(name, iterations, peak, worst)
            if added:
                continue
            if stride > 1:
                stride, most = 1, len(self._problem.grid)
            elif worst.value <= tolerance:
                return peak
            elif stalls == _MOST_STALLS:
                raise self._failure("the solver stopped before the constraints were met", worst)
            else:
                stalls += 1

    def _look(self, bound: float, stride: int, most: int) -> tuple[int, Violation, float]:
        """Add what the present trajectory violates."""
        trajectory = self._problem.trajectory(self.family, self.x)
        tolerance = self._problem.options.constraint_tolerance
        return self._working.add_violated(trajectory, bound, tolerance, stride, most)

    def _lower_peak(self, bound: float, *, coarse: bool) -> tuple[float, int]:
        """Solve the peak stage's subproblem in epigraph form: unknowns are (x, b)."""
        weight = self._problem.options.smoothing_weight * (_COARSE_SMOOTHING if coarse else 1.0)
        family = self.family = self.family.rebuilt(self.x, weight)

        def objective(x: FloatArray) -> tuple[float, FloatArray]:
            value, gradient = family.smoothing(x[:-1])
            return float(x[-1]) + value, np.append(gradient, 1.0)

        def constraints(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian, torques = self._working.values(family, x[:-1])
            value[:torques] -= x[-1]
            d_bound = np.zeros((len(value), 1))
            d_bound[:torques] = -1.0
            return -value, -np.hstack([jacobian, d_bound])

        x, iterations = solve_slsqp(
            Subproblem(start=np.append(family.start, bound), objective=objective, constraints=constraints),
            _COARSE_ACCURACY if coarse else _ACCURACY,
            self._problem.options.max_iterations,
        )
        self.x = x[:-1]
        return float(x[-1]), iterations

    def _lower_mean_square(self, bound: float, *, coarse: bool) -> int:
        """Solve the mean-square stage's subproblem, the torque's norm held below `bound`.

        Unknowns are u with ``x = C u``, where C whitens the objective's Gauss-Newton Hessian: SLSQP then
        starts with nearly the right curvature.
        """
        problem = self._problem
        weight = problem.options.smoothing_weight * (_COARSE_SMOOTHING if coarse else _MEAN_SMOOTHING)
        family = self.family = self.family.rebuilt(self.x, weight)
        H = problem.mean_square_curvature(family, family.start) + family.smoothing_curvature()
        L = np.linalg.cholesky(H + _LEAST_CURVATURE * np.eye(len(H)))
        C = linalg.solve_triangular(L, np.eye(len(L)), lower=True).T

        def objective(u: FloatArray) -> tuple[float, FloatArray]:
            x = C @ u
            value, gradient = problem.mean_square(family, x)
            smoothing, pull = family.smoothing(x)
            return value + smoothing, C.T @ (gradient + pull)

        def constraints(u: FloatArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian, torques = self._working.values(family, C @ u)
            value[:torques] -= bound
            return -value, -(jacobian @ C)

        u, iterations = solve_slsqp(
            Subproblem(start=L.T @ family.start, objective=objective, constraints=constraints),
            _COARSE_ACCURACY if coarse else _ACCURACY,
            problem.options.max_iterations,
        )
        self.x = C @ u
        return iterations

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
