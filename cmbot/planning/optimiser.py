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


# SLSQP's line search can stall short of the constraints; started afresh from there it gets on.
_MOST_STALLS = 3
# Unknowns without any effect, such as the slide of a pinned via-point, keep the Hessian regular.
_LEAST_CURVATURE = 1e-6
# A peak this near to that of the resting ends cannot be told from it.
_AT_REST = 1e-6


@dataclass(frozen=True, kw_only=True)
class _Effort:
    """How hard a pass tries.

    Attributes
    ----------
    stride : int
        Every which sample is looked at for violations.
    most : int
        At most so many violated sites of a constraint are added: many are no longer once others are met.
    smoothing : float
        Weight of the smoothing in multiples of the option's: with few working times a light one lets splines
        swing between them.
    accuracy : float
        Of the solver, relative to the objective, which is about 1.
    """

    stride: int
    most: int
    smoothing: float
    accuracy: float


# Via-points first slide alone; then all unknowns look for a smooth trajectory, coarsely and on all samples.
# Only a peak that is not yet low enough is worth giving up smoothness for.
_SKETCH = _Effort(stride=10, most=40, smoothing=1000.0, accuracy=1e-4)
_COARSE = _Effort(stride=10, most=40, smoothing=1000.0, accuracy=1e-4)
_SMOOTH = _Effort(stride=1, most=400, smoothing=1000.0, accuracy=1e-5)
_FULL = _Effort(stride=1, most=400, smoothing=1.0, accuracy=1e-8)


# The mean square falls off slowly; its passes must be so much more accurate not to end far from feasible.
_MEAN_ACCURACY = 0.1


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
    at_rest = problem.peak_at_rest * (1 + _AT_REST)
    # Where a resting end that cannot change asks the most, there is nothing to lower but the mean square.
    # With sliding knots that is known beforehand.
    peak = problem.via_point_peak if problem.family.slides else problem.scale
    if peak > at_rest:
        peak = problem.scale * run.stage("peak", 1.0)
    if peak <= at_rest:
        run.stage("mean square", at_rest / problem.scale)
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
        effort, stalls = _SKETCH if self.family.slides else _COARSE, 0
        self._look(bound, effort)
        while True:
            if len(self.reports) >= options.max_passes:
                raise self._failure(f"no solution in {options.max_passes} passes", self.reports[-1].worst)
            if name == "peak":
                bound, iterations = self._lower_peak(bound, effort)
            elif effort is _SKETCH:
                # The way through the charts is rough; smoothing it is all that is wanted here.
                _, iterations = self._lower_peak(bound, effort)
            else:
                iterations = self._lower_mean_square(bound, effort)
            added, worst, peak = self._look(bound, effort)
            self._report(name, iterations, peak, worst)
            if effort is _SKETCH:
                effort = _COARSE
            elif added:
                continue
            elif effort is _COARSE:
                effort = _SMOOTH
            elif worst.value > tolerance:
                if stalls == _MOST_STALLS:
                    raise self._failure("the solver stopped before the constraints were met", worst)
                stalls += 1
            elif effort is _SMOOTH and name == "peak" and peak > self._problem.low_enough:
                effort = _FULL
            else:
                return peak

    def _look(self, bound: float, effort: _Effort) -> tuple[int, Violation, float]:
        """Add what the present trajectory violates."""
        trajectory = self._problem.trajectory(self.family, self.x)
        tolerance = self._problem.options.constraint_tolerance
        return self._working.add_violated(trajectory, bound, tolerance, effort.stride, effort.most)

    def _weight(self, effort: _Effort) -> float:
        return self._problem.options.smoothing_weight * effort.smoothing

    def _lower_peak(self, bound: float, effort: _Effort) -> tuple[float, int]:
        """Solve the peak stage's subproblem in epigraph form: unknowns are (x, b), or slides alone and b."""
        family = self.family = self.family.rebuilt(self.x, self._weight(effort))
        full = family.start
        free = family.slides if effort is _SKETCH else len(full)

        def unknowns(x: FloatArray) -> FloatArray:
            return np.concatenate([x[:-1], full[free:]])

        def objective(x: FloatArray) -> tuple[float, FloatArray]:
            value, gradient = family.smoothing(unknowns(x))
            return float(x[-1]) + value, np.append(gradient[:free], 1.0)

        def constraints(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian, torques = self._working.values(family, unknowns(x))
            value[:torques] -= x[-1]
            d_bound = np.zeros((len(value), 1))
            d_bound[:torques] = -1.0
            return -value, -np.hstack([jacobian[:, :free], d_bound])

        x, iterations = solve_slsqp(
            Subproblem(start=np.append(full[:free], bound), objective=objective, constraints=constraints),
            effort.accuracy,
            self._problem.options.max_iterations,
        )
        self.x = unknowns(x)
        return float(x[-1]), iterations

    def _lower_mean_square(self, bound: float, effort: _Effort) -> int:
        """Solve the mean-square stage's subproblem, the torque's norm held below `bound`.

        Unknowns are u with ``x = C u``, where C whitens the objective's Gauss-Newton Hessian: SLSQP then
        starts with nearly the right curvature.
        """
        problem = self._problem
        family = self.family = self.family.rebuilt(self.x, self._weight(effort))
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
            _MEAN_ACCURACY * effort.accuracy,
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
