"""Sequential quadratic programming with an exact penalty in a trust region, for sparse problems.

The merit is the objective, plus the largest of the constraints in the epigraph (the peak), plus for each
family of the others a penalty times its largest violation. A step minimises the merit's second-order model
in a box, the trust region; it is accepted if the merit falls by a share of what the model predicts. So the
merit falls with every accepted step, and the loop ends (Nocedal and Wright, Numerical Optimization, 2006,
Section 18.5).

Of very many constraints only some are known; where a step violates others they are added, and count from
then on. Where constraints bend away from a step it is corrected by the least change that meets them as they
are linearized after the step: a second-order correction with fresh derivatives (there, Section 18.3).
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from scipy import sparse

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed
from cmbot.optimization.qp import NlpModel, NlpValues, QpStep, solve_qp

# Predictions are no smaller than this, so that ratios exist.
_MIN_PREDICTION = 1e-15


@dataclass(frozen=True, kw_only=True)
class SqpOptions:
    """Constants of the method.

    Attributes
    ----------
    optimality_tolerance : float
        It has converged when the model predicts no larger decrease in a box of radius `optimality_radius`.
    feasibility_tolerance : float
        Violations up to this count as met.
    optimality_radius : float
    max_iterations : int
        Quadratic programs, but for corrections.
    initial_penalty, min_penalty, max_penalty : float
        Weights of the largest violation of each family. The objective is about 1: with a first weight far
        below, steps would trade it for violations that later ones cannot undo, as through an obstacle.
    penalty_growth : float
        Factor by which a penalty grows where violations stay.
    penalty_margin : float
        How far penalties stay above the sums of multipliers.
    accept, shrink, expand : float
        Shares of the predicted decrease: a step is accepted above the first, the trust region shrinks below
        the second, and grows above the third.
    correct_below : float
        A step that keeps less than this share is corrected.
    max_corrections : int
    correction_penalty, correction_damping : float
        By how much more a correction weighs violations than the rest, and what a change of all of the step
        costs, in units of its predicted decrease.
    initial_radius, min_radius : float
        Of the trust region: it doubles where steps reach its sides and keep their prediction. No step is
        sought in a smaller one than the least.
    contraction : float
        Radius after a step that was too long, as a share of that step.
    steering : float
        Share that a step removes, at least, of the violations that can be removed where nothing else counts.
        One that leaves more than this share does little about them.
    infeasible_ratio : float
        Where no penalty brings violations down to this share the problem is taken for locally infeasible.
    stall_steps, stall_tolerance, stall_promise : int, float, float
        So many iterations that together gain less than the second end it where the constraints are met and a
        step within `optimality_radius` promises no more than the third: near a solution it takes fewer,
        elsewhere progress is slow. Where they are not met, the trust region shrinks.
    stall_patience : int
        So many times as many iterations that together gain no more end it whatever is promised: along curved
        constraints only short steps are accepted, and what longer ones promise is not kept.
    stay_steps : int
        Where so many iterations do not bring the violation down to the share `infeasible_ratio`, it ends if
        no step can.
    infeasible_steps, infeasible_share, infeasible_violation : int, float, float
        So many steps that leave this share of what is violated by more than that end it.
    feasible_only : bool
        It ends as soon as the constraints are met.
    close_gap : bool
        Quadratic programs are solved until their duality gap is closed, too. It takes a little longer, and
        is needed where the optimum is wanted to more than four digits.
    """

    optimality_tolerance: float = 1e-7
    feasibility_tolerance: float = 5e-6
    optimality_radius: float = 1.0
    max_iterations: int = 60
    initial_penalty: float = 1.0
    min_penalty: float = 0.1
    max_penalty: float = 1e4
    penalty_growth: float = 10.0
    penalty_margin: float = 2.0
    accept: float = 1e-3
    shrink: float = 0.25
    expand: float = 0.75
    correct_below: float = 0.5
    max_corrections: int = 3
    correction_penalty: float = 30.0
    correction_damping: float = 100.0
    initial_radius: float = 4.0
    min_radius: float = 1e-6
    contraction: float = 0.4
    steering: float = 0.5
    infeasible_ratio: float = 0.9
    stall_steps: int = 8
    stall_tolerance: float = 1e-5
    stall_promise: float = 5e-4
    stall_patience: int = 3
    stay_steps: int = 8
    infeasible_steps: int = 30
    infeasible_share: float = 0.8
    infeasible_violation: float = 2e-2
    feasible_only: bool = False
    close_gap: bool = False


class SqpStatus(enum.Enum):
    """How a run ended."""

    CONVERGED = "no step promises more than the tolerance, and the constraints are met"
    STALLED = "the constraints are met, and the last steps together gained no more than the tolerance"
    FEASIBLE = "the constraints are met, and nothing else was asked for"
    INFEASIBLE = "constraints are violated, and no step, or none of many, does much about it"
    ITERATION_LIMIT = "it was stopped before it ended by itself"


class Iterate(Protocol):
    """A point of a nonlinear program with some of its constraints."""

    @property
    def values(self) -> NlpValues:
        """Values alone."""

    @property
    def model(self) -> NlpModel:
        """Values and first derivatives; the Hessian is left empty."""

    def hessian(self, multipliers: FloatArray) -> sparse.csr_array:
        """Positive definite Hessian (n, n) of the Lagrangian; multipliers (K,) as constraints."""

    def displaced(self, p: FloatArray) -> Self:
        """Return the point after a step `p` (n,), with the same constraints.

        An `OptimisationFailed` is raised when there is no such point.
        """

    def separated(self) -> Self:
        """Return the same point with all that is violated there among its constraints, the old ones first."""

    def refresh(self, other: Self) -> Self:
        """Return the same point with the constraints of `other`, which extend its own: itself if they are."""

    def drop_constraints(self, multipliers: FloatArray) -> tuple[Self, FloatArray]:
        """Return the same point without constraints that do not matter, and the others' multipliers."""


AnyIterate = TypeVar("AnyIterate", bound=Iterate)


@dataclass(frozen=True, kw_only=True, eq=False)
class SqpResult(Generic[AnyIterate]):
    """Where a run ended, and what the next one may go on with."""

    iterate: AnyIterate
    status: SqpStatus
    multipliers: FloatArray  # (K,)
    penalty: FloatArray  # (families,)
    iterations: int  # quadratic programs, but for corrections
    # Penalty, and the merit for it before and after, of each accepted step.
    merits: tuple[tuple[FloatArray, float, float], ...]


def solve_sqp(
    start: AnyIterate,
    families: int,
    options: SqpOptions,
    warm: SqpResult[AnyIterate] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> SqpResult[AnyIterate]:
    """Lower the merit from `start`, with so many families of constraints, until nothing more is to be gained.

    `warm` is a run with the first of the constraints, for its multipliers and penalties. Where
    `stop` says so after an iteration it ends as at the iteration limit; within one nothing is corrected then.
    """
    state = _SqpState(start, families, options, warm, stop)
    iterations = 0
    while iterations < options.max_iterations and state.status is SqpStatus.ITERATION_LIMIT:
        if iterations and stop():
            break
        iterations += 1
        model = replace(state.iterate.model, hessian=state.hessian)
        step = state.steered(model)
        predicted = state.predicted(model, step.p)
        if predicted > options.optimality_tolerance or not state.ends(model, step):
            state.take(model, step, predicted)
    return SqpResult(
        iterate=state.iterate,
        status=state.status,
        multipliers=_extended(state.multipliers, state.iterate),
        penalty=state.penalty,
        iterations=iterations,
        merits=tuple(state.merits),
    )


class _SqpState(Generic[AnyIterate]):
    """The state of a run between two steps."""

    def __init__(
        self,
        start: AnyIterate,
        families: int,
        options: SqpOptions,
        warm: SqpResult[AnyIterate] | None,
        stop: Callable[[], bool],
    ) -> None:
        self._options, self._stop = options, stop
        self.iterate = start
        self.multipliers = np.zeros(len(start.values.value))
        self.penalty = np.full(families, options.initial_penalty)
        if warm is not None:
            self.multipliers = _extended(warm.multipliers, start)
            # Penalties fall again to what the multipliers need.
            needed, others = np.zeros(families), ~start.values.in_epigraph
            np.add.at(needed, start.values.family[others], options.penalty_margin * self.multipliers[others])
            self.penalty = np.clip(needed, options.min_penalty, options.max_penalty)
        self.hessian = start.hessian(self.multipliers)
        self.merits: list[tuple[FloatArray, float, float]] = []
        self._status = SqpStatus.ITERATION_LIMIT
        self._radius = options.initial_radius
        # Of each iteration: the decrease of the merit, and the largest violation at its end.
        self._gained: list[float] = []
        # What the last step was predicted to gain, as if it went as far as `optimality_radius`.
        self._promised = np.inf
        self._violations = [start.values.violation]

    @property
    def status(self) -> SqpStatus:
        """How it has ended; the iteration limit while it has not."""
        met = self.iterate.values.violation <= self._options.feasibility_tolerance
        if self._status is not SqpStatus.ITERATION_LIMIT or not met:
            return self._status
        if self._options.feasible_only:
            return SqpStatus.FEASIBLE
        return SqpStatus.STALLED if self._is_stalling else self._status

    @property
    def _is_stalling(self) -> bool:
        """Whether the last steps have gained little, and the next ones promise little or many have."""
        o = self._options
        steps = o.stall_steps if self._promised <= o.stall_promise else o.stall_patience * o.stall_steps
        last = self._gained[-steps:]
        return len(last) == steps and sum(last) <= o.stall_tolerance

    def steered(self, model: NlpModel) -> QpStep:
        """Solve the quadratic program; where violations stay that need not, with larger penalties.

        What need not stay is what a step takes away for which nothing else counts (there, Algorithm 18.5).
        """
        o, families = self._options, len(self.penalty)
        step = self._step(model, self.penalty, self._radius)
        here, left = model.violations(families=families), model.violations(step.p, families=families)
        enough = np.maximum(o.feasibility_tolerance, o.steering * here)
        firmest = float(self.penalty.max())
        if firmest >= o.max_penalty or not (left > enough).any() or self._stop():
            return step
        alone = self._step(model, o.max_penalty / firmest * self.penalty, self._radius)
        least = model.violations(alone.p, families=families)
        enough = np.maximum(enough, least + (1 - o.steering) * np.maximum(here - least, 0.0))
        while True:
            lacking = (left > enough) & (self.penalty < o.max_penalty)
            if not lacking.any() or self._stop():
                return step
            grown = np.where(lacking, o.penalty_growth * self.penalty, self.penalty)
            self.penalty = np.minimum(grown, o.max_penalty)
            step = self._step(model, self.penalty, self._radius)
            left = model.violations(step.p, families=families)

    def predicted(self, model: NlpModel, p: FloatArray) -> float:
        """Decrease of the merit by the step `p` (n,) if the model is right."""
        return max(model.merit(self.penalty) - model.after(p, self.penalty), _MIN_PREDICTION)

    def ends(self, model: NlpModel, step: QpStep) -> bool:
        """Whether a step of little predicted decrease is refused, with the status or penalties set."""
        o, families = self._options, len(self.penalty)
        if not step.solved:
            self._shorten(model, step)
            return True
        if model.violation <= o.feasibility_tolerance:
            far = self._step(model, self.penalty, o.optimality_radius).p
            converged = self.predicted(model, far) <= o.optimality_tolerance
            if converged:
                self._status = SqpStatus.CONVERGED
            return converged
        if model.violations(step.p, families=families).max() <= o.steering * model.violation:
            return False
        if self.penalty.min() >= o.max_penalty or self._is_infeasible(model, step):
            self._status = SqpStatus.INFEASIBLE
        else:
            self.penalty = np.minimum(o.penalty_growth * self.penalty, o.max_penalty)
        return True

    def take(self, model: NlpModel, step: QpStep, predicted: float) -> None:
        """Try a step; accept it if the merit falls, and adapt the trust region to how far it does."""
        o, length = self._options, float(np.abs(step.p).max())
        self._promised = predicted / max(min(1.0, length / o.optimality_radius), o.min_radius)
        trial, gained = self._tried(model, step.p, predicted)
        # Where little is to be gained only violations are left, and the shorter the steps, the fewer.
        stalling = self._is_stalling and self.iterate.values.violation > o.feasibility_tolerance
        if gained < o.shrink * predicted or stalling:
            self._shorten(model, step)
        elif gained > o.expand * predicted and length > 0.9 * self._radius:
            self._radius *= 2.0
        if trial is not None and gained > o.accept * predicted:
            before, after = (at.values.merit(self.penalty) for at in (self.iterate, trial))
            self.merits.append((self.penalty, before, after))
            self._gained.append(before - after)
            self.iterate, self.multipliers = trial.drop_constraints(_extended(step.multipliers, trial))
            self.hessian = self.iterate.hessian(self.multipliers)
        else:
            self._gained.append(0.0)
        self._violations.append(self.iterate.values.violation)
        if self._makes_no_progress(model, step):
            self._status = SqpStatus.INFEASIBLE

    def _shorten(self, model: NlpModel, step: QpStep) -> None:
        """Contract the trust region; where it is too small, that is the end."""
        o, length = self._options, float(np.abs(step.p).max())
        self._radius = o.contraction * min(self._radius, length or np.inf)
        if self._radius < o.min_radius:
            met = model.violation <= o.feasibility_tolerance
            self._status = SqpStatus.STALLED if met else SqpStatus.INFEASIBLE

    def _step(self, model: NlpModel, penalty: FloatArray, radius: float, damping: float = 0.0) -> QpStep:
        return solve_qp(model, penalty, radius, damping, close_gap=self._options.close_gap)

    def _makes_no_progress(self, model: NlpModel, step: QpStep) -> bool:
        """Whether many steps have left violations, or some have most of them and no step can lower them."""
        o = self._options
        last, few = (self._violations[-1 - steps :] for steps in (o.infeasible_steps, o.stay_steps))
        most = max(o.infeasible_violation, o.infeasible_share * last[0])
        if len(last) > o.infeasible_steps and min(last) > most:
            return True
        stays = len(few) > o.stay_steps and min(few) > max(
            o.feasibility_tolerance, o.infeasible_ratio * few[0]
        )
        return stays and self._is_infeasible(model, step)

    def _is_infeasible(self, model: NlpModel, step: QpStep) -> bool:
        """Whether a step does not lower violations, and not even one for which only they count."""
        o, families = self._options, len(self.penalty)
        enough = o.infeasible_ratio * model.violation
        if model.violations(step.p, families=families).max() <= enough:
            return False
        firmest = self._step(model, np.full(families, o.max_penalty), o.optimality_radius).p
        return bool(model.violations(firmest, families=families).max() > enough)

    def _tried(self, model: NlpModel, p: FloatArray, predicted: float) -> tuple[AnyIterate | None, float]:
        """Take the step `p` (n,) and evaluate what it gains; where that is little, correct it.

        The iterate gets every constraint that one of the trials violates, but for corrections on the way to
        others: what they break of the known constraints is enough to correct them.
        """
        o, length = self._options, float(np.abs(p).max())
        stiffness = o.correction_damping * predicted / max(length**2, _MIN_PREDICTION)
        trial = _displaced(self.iterate, p)
        best: AnyIterate | None = None
        most = -np.inf
        for correction in range(o.max_corrections + 1):
            if trial is None:
                break
            last = correction == o.max_corrections or self._stop()
            gained = self._gain(trial)
            if correction == 0 or last or gained >= o.correct_below * predicted:
                trial = trial.separated()
                self.iterate = self.iterate.refresh(trial)
                gained = self._gain(trial)
                if gained > most:
                    best, most = trial, gained
                if last or gained >= o.correct_below * predicted:
                    break
            bent = replace(trial.model, gradient=model.gradient + model.hessian @ p, hessian=model.hessian)
            change = self._step(bent, o.correction_penalty * self.penalty, length, stiffness).p
            p, trial = p + change, _displaced(trial, change)
        return (None if best is None else best.refresh(self.iterate)), most

    def _gain(self, trial: AnyIterate) -> float:
        """How far the merit falls from the iterate to a trial with the same constraints."""
        return self.iterate.values.merit(self.penalty) - trial.values.merit(self.penalty)


def _extended(multipliers: FloatArray, iterate: Iterate) -> FloatArray:
    """Multipliers of the constraints of `iterate` from those of the first of them."""
    return np.append(multipliers, np.zeros(len(iterate.values.value) - len(multipliers)))


def _displaced(iterate: AnyIterate, p: FloatArray) -> AnyIterate | None:
    try:
        trial = iterate.displaced(p)
    except OptimisationFailed:
        return None
    at = trial.values
    return trial if np.isfinite(at.objective + at.peak + at.violation) else None
