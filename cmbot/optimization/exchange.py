"""Exchange: solve with few constraints, find those that are violated at any time, add them, solve again.

A lexicographic program is solved in stages: the peak of the objective as low as it can be, then its mean
square with the peak held. Where the lower bound of the peak can be attained the first stage is not needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from cmbot.common.errors import OptimisationFailed
from cmbot.common.reading.file_types import Count
from cmbot.common.reading.validation import counted
from cmbot.optimization.constraint_set import OBJECTIVE, ConstraintSet, Violation
from cmbot.optimization.evaluation import NlpEvaluation, Stage
from cmbot.optimization.linearization import families_of
from cmbot.optimization.program import Program
from cmbot.optimization.separation import Separation, find_violations
from cmbot.optimization.slsqp import solve_slsqp
from cmbot.optimization.sqp import SqpOptions, SqpResult, SqpStatus, solve_sqp
from cmbot.trajectory import Parametrization

# From a start, with an accuracy and a number of iterations at most, to the end and the iterations it took.
DenseSolver = Callable[[NlpEvaluation, float, int], tuple[NlpEvaluation, int]]

# A smoothing of less than so many tolerances of the peak is not worth a lighter one.
_SMALL_RATIO = 2.0
# A motion near an earlier one may have a peak above its own by this factor.
_NEAR_PEAK = 1.05
# Steps with large penalties may creep along a curved constraint, five times as long as is needed. After so
# many the splines are built around the last motion and penalties fall: a longer step leads out of there.
_NEAR_ITERATIONS, _NEAR_PASSES = 10, 4


@dataclass(frozen=True, kw_only=True)
class ExchangeOptions:
    """How a program is solved.

    Attributes
    ----------
    solver : str or callable
        ``sqp`` or ``slsqp``; or what takes the place of `solve_slsqp`, as benchmarks do.
    smoothing : float
        Weight of half the mean squared jerk and velocity, in units of their bounds, beside the objective.
    peak_tolerance : float
        The peak is low enough within this share of its lower bound.
    least_peak_tolerance : float
        Where that is missed, which a moving arm often does narrowly, within this share of the least that was
        attained: the last thousandths of a peak would cost all the jerk that the limits allow.
    feasibility_tolerance : float
        Violations up to this count as met.
    max_passes, max_iterations : int
        Exchange iterations of all stages, and iterations of the solver in each.
    continuation : tuple of float
        Factors of the smoothing while the peak is minimised, one after the other as long as each lowers the
        peak by more than a share, and promises to: what smoothing adds to the peak is in proportion to it,
        and hardly more than its own value. The share is a quarter of `least_peak_tolerance`, or
        `peak_tolerance` where that is more. A light smoothing alone lets splines swing between the few times
        that are known.
    most_violations : int
        Constraints of a family that are added in an exchange iteration, at most.
    nearly_met : float
        An attempt at the lower bound goes on where the solver stops with violations up to this.
    nearly_ended : float
        Where it ended with violations up to this, but for that of its bound, the peak is minimised from there
        on.
    far_off : float
        Where the start violates constraints by more, the lower bound is not attempted: the peak is minimised
        first, as far as that. Where all else is violated so much a bound on the peak only stands in the way.
    attempt_steps : int
        An attempt ends after this number of steps that do not halve violations beyond that.
    attempt_stays : int
        It also ends after this number of steps that hardly lower violations, if no step can to first order.
    stalls : int
        Number of passes in which nothing new is violated by too much before the solver ends.
    slsqp_accuracy, slsqp_peak_accuracy : float
        Of the mean square, and of the peak, which need not be known better than its tolerance.
    slsqp_iterations : int
        Of SLSQP in an exchange iteration: it need not end before the next one knows more constraints.
    sqp : SqpOptions
    held_gain, held_promise : float
        Its `stall_tolerance` and `stall_promise` where the peak is held: the mean square matters less.
    stop : callable
        Asked between iterations whether the time is over: then the trajectory of least peak that met all
        constraints is the result, if there was one.
    stop_reason : callable
        What errors say then.
    """

    solver: str | DenseSolver = "sqp"
    smoothing: float = 0.1
    peak_tolerance: float = 1e-4
    least_peak_tolerance: float = 2e-3
    feasibility_tolerance: float = 1e-5
    max_passes: int = 80
    max_iterations: int = 1000
    continuation: tuple[float, ...] = (1.0, 0.1, 1e-2, 1e-3)
    most_violations: int = 400
    nearly_met: float = 1e-3
    nearly_ended: float = 0.03
    far_off: float = 4.0
    attempt_steps: int = 6
    attempt_stays: int = 2
    stalls: int = 3
    slsqp_accuracy: float = 1e-8
    slsqp_peak_accuracy: float = 1e-6
    slsqp_iterations: int = 10
    sqp: SqpOptions = field(default_factory=SqpOptions)
    held_gain: float = 2e-3
    held_promise: float = 5e-3
    stop: Callable[[], bool] = lambda: False
    stop_reason: Callable[[], str] = lambda: "the time was over"


@dataclass(frozen=True, kw_only=True)
class ExchangeReport:
    """Where the optimisation stands after an exchange iteration.

    Attributes
    ----------
    stage : str
        ``peak`` or ``mean square``.
    number : int
        Exchange iterations so far.
    iterations : int
        Solver iterations of this one.
    ended : bool
        The solver ended by itself.
    constraints : int
        Size of the constraint set.
    peak_torque : float
        Largest value of the objective at the samples, in its own unit.
    worst : Violation
        Constraint violated most; below the tolerance all are met.
    """

    stage: str
    number: Count
    iterations: Count
    ended: bool
    constraints: Count
    peak_torque: float
    worst: Violation


@dataclass(frozen=True, kw_only=True)
class Result:
    """A solved program.

    Attributes
    ----------
    parametrization : Parametrization
        Built around the solution.
    passes : tuple of ExchangeReport
    peak_bound : float
        What the peak was held below, in units of the program's scale.
    complete : bool
        It was not stopped before its end, and no stage failed; otherwise it is what the last one that met the
        constraints had found.
    failure : OptimisationFailed, optional
        Why no trajectory met all constraints: this one misses them by no more than `nearly_met`. Where they
        are kept inside what they stand for, that may still hold.
    """

    parametrization: Parametrization
    passes: tuple[ExchangeReport, ...]
    peak_bound: float
    complete: bool = True
    failure: OptimisationFailed | None = None


def minimize_peak(
    program: Program,
    options: ExchangeOptions,
    progress: Callable[[ExchangeReport], None] | None = None,
) -> Result:
    """Minimise the peak as far as its lower bound allows, and among those motions the mean square.

    With p the lower bound where that can be attained, otherwise the smallest peak that can, it solves
    ``min mean f^2 / 2 + smoothing, f(t) <= p (1 + peak_tolerance)`` subject to the program's constraints; in
    the second case with `least_peak_tolerance`.

    Parameters
    ----------
    program : Program
    options : ExchangeOptions
    progress : callable, optional
        Called after every exchange iteration.

    Raises
    ------
    OptimisationFailed
        When no trajectory was found that meets the constraints, or nearly does.
    """
    exchange = _Exchange(program, options, progress)
    bound = program.lower_bound * (1 + options.peak_tolerance)
    try:
        found = exchange.separated(bound) if program.lower_bound > 0 else None
        if found is not None and found.worst.value <= options.far_off:
            try:
                exchange.run(options.smoothing, bound=bound, attempt=True, found=found)
                return exchange.result(bound)
            except OptimisationFailed:
                if options.stop():
                    # That an attempt failed says nothing then: what would have followed was not tried.
                    raise exchange.stopped() from None
                exchange.end_attempt()
        least = exchange.lowest_peak(bound)
        # A peak is known as well as the solver's own optimality is.
        if least > bound * (1 + options.sqp.optimality_tolerance) or program.lower_bound <= 0:
            bound = least * (1 + options.least_peak_tolerance)
        exchange.run(options.smoothing, bound=bound)
    except OptimisationFailed as failure:
        best = exchange.feasible or exchange.nearest
        if best is None:
            raise
        exchange.form, peak = best
        why = None if exchange.feasible else failure
        return replace(exchange.result(peak), complete=False, failure=why)
    return exchange.result(bound)


def meet_constraints(
    program: Program,
    options: ExchangeOptions,
    progress: Callable[[ExchangeReport], None] | None = None,
) -> Result:
    """Find a motion near the start that meets the constraints, in steps that are least by the mean square.

    Its peak is at most 5 % above the start's. Parameters and errors are those of `minimize_peak`.
    """
    iterations = min(options.sqp.max_iterations, _NEAR_ITERATIONS)
    sqp = replace(options.sqp, feasible_only=True, max_iterations=iterations)
    options = replace(options, sqp=sqp, max_passes=min(options.max_passes, _NEAR_PASSES))
    exchange = _Exchange(program, options, progress)
    found = exchange.separated(np.inf)
    bound = _NEAR_PEAK * found.peak
    exchange.run(options.smoothing, bound=bound, weight=0.0, found=found)
    return exchange.result(bound)


def minimize_smoothed_peak(program: Program, options: ExchangeOptions) -> Result:
    """Minimise ``max_t f(t) + smoothing``: the first stage of a peak that is not known, alone.

    Errors are those of `minimize_peak`.
    """
    exchange = _Exchange(program, options, None)
    return exchange.result(exchange.run(options.smoothing))


class _Exchange:
    """The exchange iterations of one program; its constraint set is kept from stage to stage."""

    def __init__(
        self,
        program: Program,
        options: ExchangeOptions,
        progress: Callable[[ExchangeReport], None] | None,
    ) -> None:
        self._program, self._options, self._progress = program, options, progress
        self._families = len(families_of(program))
        self.reports: list[ExchangeReport] = []
        # The best trajectory that met all constraints, with its peak.
        self.feasible: tuple[Parametrization, float] | None = None
        # One that misses them by little, with its peak.
        self.nearest: tuple[Parametrization, float] | None = None
        self.restart()

    def restart(self) -> None:
        """Go back to the initial guess and the first constraints."""
        t = self._program.parametrization.space.t
        step = float(t[1] - t[0]) / self._program.samples_per_segment
        middles = 0.5 * (t[1:] + t[:-1])
        # Without a first hold at all times the first steps would go far where nothing has been added yet.
        single = [
            number
            for number, function in enumerate((self._program.objective, *self._program.constraints))
            if function.components == 1
        ]
        self._constraints = ConstraintSet(step=step).at_all(single, middles).at_all([OBJECTIVE], t).rebased()
        self.form = self._program.parametrization
        self._warm: SqpResult[NlpEvaluation] | None = None

    def end_attempt(self) -> None:
        """Go on where an attempt ended, if nearly all but its bound is met there; otherwise start again."""
        last = self._warm
        if last is None or last.iterate.violation_beside_peak > self._options.nearly_ended:
            self.restart()
            return
        self.form, self._warm = last.iterate.parametrization, None
        self._constraints = last.iterate.constraints.rebased()

    def result(self, peak_bound: float) -> Result:
        """Return the present trajectory, its peak held below `peak_bound`."""
        return Result(parametrization=self.form, passes=tuple(self.reports), peak_bound=peak_bound)

    def lowest_peak(self, target: float) -> float:
        """Minimise the peak with ever less smoothing, as long as that is worthwhile; return it.

        A lighter smoothing that fails, or gains next to nothing, is given up for what the heavier one found.
        """
        o, factors = self._options, self._options.continuation
        worthwhile = 1 - max(o.peak_tolerance, 0.25 * o.least_peak_tolerance)
        lowest = promise = np.inf
        for before, factor in pairwise([factors[0], *factors]):
            if promise * before < (1 - worthwhile) * lowest:
                break
            if np.isfinite(lowest) and self._smoothing(before) < _SMALL_RATIO * (1 - worthwhile) * lowest:
                break
            kept = self.form, self._constraints, self._warm
            try:
                peak = self.run(factor * o.smoothing, target=target)
            except OptimisationFailed:
                if not np.isfinite(lowest):
                    raise
                peak = np.inf
            if peak > worthwhile * lowest:
                self.form, self._constraints, self._warm = kept
                break
            if np.isfinite(lowest):
                promise = (lowest - peak) / (before - factor)
            lowest = peak
            if peak <= target * (1 + o.feasibility_tolerance):
                break
        return lowest

    def _smoothing(self, factor: float) -> float:
        """What the smoothing with that factor is at the present trajectory."""
        return factor * self._options.smoothing * self.form.smoothing()[0]

    def run(
        self,
        smoothing: float,
        *,
        bound: float | None = None,
        weight: float = 1.0,
        target: float = 0.0,
        attempt: bool = False,
        found: Separation | None = None,
    ) -> float:
        """Solve and separate until nothing is violated; return the peak.

        An attempt is given up as soon as the solver ends far from the constraints that it knows. What the
        present trajectory violates may be `found` before.
        """
        o = self._options
        tolerance = o.feasibility_tolerance
        stage = Stage(smoothing=smoothing, bound=bound, weight=weight, target=target, tolerance=tolerance)
        found = found or self.separated(np.inf if bound is None else bound)
        self._constraints, left = found.added_to(self._constraints), o.stalls
        while True:
            if len(self.reports) >= o.max_passes:
                passes = counted(o.max_passes, "pass", "passes")
                raise self._failure(f"no solution in {passes}; max_passes allows no more", found.worst)
            start = NlpEvaluation.around(self._program, stage, self.form, self._constraints)
            end, iterations, done = self._solved(start, attempt=attempt)
            self.form, self._constraints = end.parametrization, end.constraints
            limit = max(end.peak, target) if bound is None else bound
            found = self.separated(limit)
            known, self._constraints = self._constraints, found.added_to(self._constraints)
            self._report(stage, iterations, found, ended=done)
            worst, nothing_new = found.worst_beside(limit), self._constraints is known
            met = worst.value <= o.feasibility_tolerance
            self._keep(found)
            if met and nothing_new and done:
                return found.peak
            if o.stop():
                raise self.stopped()
            if met and nothing_new:
                continue
            if attempt and end.values.violation > o.nearly_met:
                raise self._failure("the known constraints were not met", worst)
            if done and nothing_new:
                if left == 0:
                    raise self._failure("the solver stopped before the constraints were met", worst)
                left -= 1
                # What is violated can lie so near to what is known that it counted as known.
                self._constraints = found.added_to(known.sharpened())

    def _keep(self, found: Separation) -> None:
        """Keep the present trajectory where it meets all constraints, its peak whatever it was to be."""
        if found.worst.value > self._options.feasibility_tolerance:
            if found.worst.value <= self._options.nearly_met:
                self.nearest = self.form, found.peak
            return
        if self.feasible is None or found.peak <= self.feasible[1] * (1 + self._options.peak_tolerance):
            self.feasible = self.form, found.peak

    def _solved(self, start: NlpEvaluation, *, attempt: bool) -> tuple[NlpEvaluation, int, bool]:
        """Solve with the constraints of `start`; return the end, the iterations, and whether it converged."""
        o = self._options
        if o.solver != "sqp":
            solve = o.solver if callable(o.solver) else solve_slsqp
            most = min(o.slsqp_iterations, o.max_iterations)
            accuracy = o.slsqp_peak_accuracy if start.stage.bound is None else o.slsqp_accuracy
            end, iterations = solve(start, accuracy, most)
            before, after = start.values, end.values
            gained = before.objective + before.peak - after.objective - after.peak
            # Where nothing more is to be gained SLSQP may go on without an end.
            met = max(before.violation, after.violation) <= o.feasibility_tolerance
            return end, iterations, iterations < most or (met and gained <= accuracy)
        sqp = o.sqp
        if start.stage.bound is not None:
            sqp = replace(sqp, stall_tolerance=o.held_gain, stall_promise=o.held_promise)
        if attempt:
            sqp = replace(
                sqp,
                stay_steps=o.attempt_stays,
                infeasible_steps=o.attempt_steps,
                infeasible_share=0.5,
                infeasible_violation=o.nearly_met,
            )
        result = solve_sqp(start, self._families, sqp, self._warm, o.stop)
        self._warm = result
        if result.status is SqpStatus.INFEASIBLE:
            self.form = result.iterate.parametrization
            limit = result.iterate.peak if start.stage.bound is None else start.stage.bound
            found = self.separated(limit)
            self._keep(found)
            reason = "near the trajectory that was found the constraints cannot all be met"
            raise self._failure(reason, found.worst_beside(limit))
        return result.iterate, result.iterations, result.status is not SqpStatus.ITERATION_LIMIT

    def separated(self, bound: float) -> Separation:
        """Find what the present trajectory violates, its peak held below a bound."""
        o, trajectory = self._options, self.form.trajectory
        return find_violations(self._program, trajectory, bound, o.feasibility_tolerance, o.most_violations)

    def _report(self, stage: Stage, iterations: int, found: Separation, *, ended: bool) -> None:
        report = ExchangeReport(
            stage=stage.name,
            number=len(self.reports) + 1,
            iterations=iterations,
            ended=ended,
            constraints=len(self._constraints),
            peak_torque=found.peak * self._program.scale,
            worst=found.worst,
        )
        self.reports.append(report)
        if self._progress is not None:
            self._progress(report)

    def stopped(self) -> OptimisationFailed:
        """Return that the time was over, with what is violated most, whatever the peak was held below."""
        reason = f"{self._options.stop_reason()} before the optimisation met every constraint"
        return self._failure(reason, self.separated(np.inf).worst, stopped=True)

    def _failure(self, reason: str, worst: Violation, *, stopped: bool = False) -> OptimisationFailed:
        return worst.failure(reason, trajectory=self.form.trajectory, stopped=stopped)
