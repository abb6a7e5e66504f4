"""Exchange: solve with few constraints, look for violated ones everywhere, add them, solve again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed
from cmbot.common.validation import counted
from cmbot.optimization.continuation import COARSE, LIGHTER, SKETCH, SMOOTH, Effort
from cmbot.optimization.slsqp import solve_slsqp
from cmbot.optimization.sparse_passes import SparsePasses
from cmbot.optimization.subproblems import mean_square_subproblem, peak_subproblem
from cmbot.optimization.working_set import Violation, WorkingSet
from cmbot.planning.torque.decomposition import joined, stretch_of, stretches
from cmbot.planning.torque.families import FixedKnots
from cmbot.planning.torque.feasibility import check_feasible
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.trajectory.parametrization import Parametrization
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["ExchangeReport", "Optimised", "optimise"]


# SLSQP's line search can stall short of the constraints; started afresh from there it gets on.
_MOST_STALLS = 3
# A peak this near to that of the resting ends cannot be told from it.
_AT_REST = 1e-6


# A pass that ends worse than it began is done again with the smoothing this many times heavier, so often.
_CAUTION, _RETRIES = 10.0, 3
# The solver can end early; started afresh it ends for good when it gains no more than this.
_SETTLED = 1e-7
# A lighter smoothing must lower the peak by this share of the gap target for a still lighter one to be tried.
_WORTHWHILE = 0.1

# The mean square falls off slowly; its passes must be so much more accurate not to end far from feasible.
_MEAN_ACCURACY = 0.1


@dataclass(frozen=True, kw_only=True)
class ExchangeReport:
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
    passes : tuple of ExchangeReport
    whole_because : str
        Of a long path that had to be solved whole: why its stretches could not be; else empty.
    """

    trajectory: QuinticTrajectory
    via_points: FloatArray
    passes: tuple[ExchangeReport, ...]
    whole_because: str = ""


def optimise(problem: TorqueProblem, progress: Callable[[ExchangeReport], None] | None = None) -> Optimised:
    """Solve the torque problem, with the solver that its family of splines is made for.

    Parameters
    ----------
    problem : TorqueProblem
    progress : callable, optional
        Called with a `ExchangeReport` after every pass.

    Raises
    ------
    OptimisationFailed
        When the via-points admit no trajectory within the limits, or none was found.
    """
    at_rest = problem.peak_at_rest * (1 + _AT_REST)
    parts = stretches(problem)
    if len(parts) > 1:
        try:
            return _stretch_by_stretch(problem, parts, at_rest, progress)
        except OptimisationFailed as failure:
            # To rest at every end of a stretch may be too much to ask; the path as a whole does not ask it.
            return replace(_whole(problem, at_rest, progress), whole_because=failure.reason)
    return _whole(problem, at_rest, progress)


def _stretch_by_stretch(
    problem: TorqueProblem,
    parts: list[tuple[int, int]],
    at_rest: float,
    progress: Callable[[ExchangeReport], None] | None,
) -> Optimised:
    """Solve a long path's problem in parts; passes are counted through."""
    done: list[Optimised] = []
    passes: list[ExchangeReport] = []

    def tell(report: ExchangeReport) -> None:
        passes.append(replace(report, number=len(passes) + 1))
        if progress is not None:
            progress(passes[-1])

    for first, last in parts:
        done.append(_whole(stretch_of(problem, first, last), at_rest, tell))
    return Optimised(
        trajectory=joined([each.trajectory for each in done]),
        via_points=np.concatenate([*(each.via_points[:-1] for each in done[:-1]), done[-1].via_points]),
        passes=tuple(passes),
    )


def _whole(
    problem: TorqueProblem, at_rest: float, progress: Callable[[ExchangeReport], None] | None
) -> Optimised:
    """Solve a problem at once; `at_rest` is what a posture asks that the arm cannot help resting in."""
    if not problem.family.sliding:
        check_feasible(problem)
    run = _Run(problem, progress)
    # Where a resting end that cannot change asks the most, there is nothing to lower but the mean square.
    # With sliding knots that is known beforehand.
    peak = problem.via_point_peak if problem.family.slides else problem.scale
    lowered = peak > at_rest
    if lowered:
        peak = problem.scale * run.stage("peak", 1.0)
    if peak <= at_rest:
        try:
            run.stage("mean square", at_rest / problem.scale)
        except OptimisationFailed:
            if lowered:
                raise
            # The arm may be unable to set off without asking more than at rest: then that is made small.
            run = _Run(problem, progress)
            run.stage("peak", 1.0)
    return Optimised(
        trajectory=problem.trajectory(run.family, run.x),
        via_points=run.family.via_points_at(run.x),
        passes=tuple(run.reports),
    )


class _Run:
    """The passes of one optimisation; its working set is kept from stage to stage."""

    def __init__(self, problem: TorqueProblem, progress: Callable[[ExchangeReport], None] | None) -> None:
        self._problem = problem
        self._progress = progress
        self._working = WorkingSet(problem)
        t = problem.space.t
        self._working.add_everywhere(0.5 * (t[1:] + t[:-1]))
        if isinstance(problem.family, Parametrization):
            # Few more rows for it, and its first steps need not find out that the peak moves.
            self._working.add_torque(t)
        self._sparse = SparsePasses(problem, self._working)
        self.family = problem.family
        self.x = problem.family.start
        self.reports: list[ExchangeReport] = []

    def stage(self, name: str, bound: float) -> float:
        """Run one stage from where the last one ended; return its scaled peak torque.

        A lighter smoothing that leads nowhere is given up for what was found with the heavier one: its last
        report then has a violated constraint.
        """
        # The sparse solver takes no step for the worse, however rough the way: it needs no sketch of one.
        sketches = (SKETCH, COARSE) if self.family.slides else (COARSE,)
        first = (SMOOTH,) if isinstance(self.family, Parametrization) else (*sketches, SMOOTH)
        self._look(bound, first[0])
        peak = bound
        for effort in first:
            bound, peak = self._passes(name, bound, effort)
        for effort in LIGHTER if name == "peak" else ():
            if peak <= self._problem.low_enough:
                break
            kept = self.family, self.x
            try:
                bound, lower = self._passes(name, bound, effort)
            except OptimisationFailed:
                self.family, self.x = kept
                break
            gain, peak = peak - lower, lower
            # Without a floor to be content with, the peak is lowered to the end.
            if self._problem.low_enough > 0 and gain < _WORTHWHILE * self._problem.options.gap_target * peak:
                break
        return peak

    def _passes(self, name: str, bound: float, effort: Effort) -> tuple[float, float]:
        """Solve and look until nothing is violated; return the subproblem's bound and the scaled peak."""
        options, stalls = self._problem.options, 0
        while True:
            if len(self.reports) >= options.max_passes:
                passes = counted(options.max_passes, "pass", "passes")
                reason = f"no solution in {passes}, and planner.max_passes allows no more"
                raise self._failure(reason, self.reports[-1].worst)
            bound, iterations, gain = self._solve(name, bound, effort)
            added, worst, peak = self._look(bound, effort)
            self._report(name, iterations, peak, worst)
            if effort.slides_only:
                return bound, peak
            if added:
                continue
            if effort is COARSE:
                return bound, peak
            if worst.value <= options.constraint_tolerance:
                sparse = isinstance(self.family, Parametrization)
                if gain > _SETTLED and (sparse or effort is LIGHTER[-1]):
                    continue
                return bound, peak
            if stalls == _MOST_STALLS:
                raise self._failure("the solver stopped before the constraints were met", worst)
            stalls += 1
            # What is violated can lie so near to what is known that it counted as known.
            self._working.sharpen()
            self._look(bound, effort)

    def _look(self, bound: float, effort: Effort) -> tuple[int, Violation, float]:
        """Add what the present trajectory violates."""
        trajectory = self._problem.trajectory(self.family, self.x)
        tolerance = self._problem.options.constraint_tolerance
        return self._working.add_violated(trajectory, bound, tolerance, effort.stride, effort.most)

    def _solve(self, name: str, bound: float, effort: Effort) -> tuple[float, int, float]:
        """Solve a subproblem from where the last one ended; return its bound, the iterations and the gain.

        The solver can diverge; a step for the worse is not taken but tried again more cautiously.
        """
        if isinstance(self.family, Parametrization):
            self.family, peak, iterations, gain = self._sparse.solve(
                self.family, None if name == "peak" else bound, effort
            )
            self.x = self.family.start
            return peak, iterations, gain
        iterations, weight = 0, self._problem.options.smoothing_weight * effort.smoothing
        # The way through the charts is rough; smoothing it is all that is wanted of the first pass.
        lower_peak = name == "peak" or effort.slides_only
        for _ in range(_RETRIES + 1):
            family = cast(FixedKnots, self.family).rebuilt(self.x, weight)
            subproblem = (
                peak_subproblem(self._working, family, bound, effort)
                if lower_peak
                else mean_square_subproblem(self._problem, self._working, family, bound)
            )
            try:
                x, count = solve_slsqp(
                    subproblem.problem,
                    effort.accuracy if lower_peak else _MEAN_ACCURACY * effort.accuracy,
                    min(effort.iterations, self._problem.options.max_iterations),
                )
                iterations += count
                gain = -np.inf
                if np.isfinite(x).all():
                    gain = subproblem.merit(subproblem.problem.start) - subproblem.merit(x)
            except (OptimisationFailed, np.linalg.LinAlgError):
                gain = -np.inf
            if gain >= -effort.accuracy:
                self.family, self.x = family, subproblem.unknowns(x)
                return (float(x[-1]) if name == "peak" else bound), iterations, gain
            weight *= _CAUTION
        if effort.slides_only:
            # Sliding alone may be no way to go on; with all unknowns there may be one.
            return bound, iterations, 0.0
        look = self._look(bound, effort)
        raise self._failure("the solver diverges, however cautiously it is asked", look[1])

    def _report(self, stage: str, iterations: int, peak: float, worst: Violation) -> None:
        report = ExchangeReport(
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
        return OptimisationFailed(reason, constraint=worst.name, violation=worst.value, undecided=True)
