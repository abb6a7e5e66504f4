"""Sequential quadratic programming with an exact penalty and damped steps, for sparse problems.

The merit is the objective, plus the largest of some constraints (the peak), plus for each kind of the others
a penalty times their largest violation. A step minimises the merit's second-order model plus half the damping
times its square; it is taken if the merit falls as far as that promises, roughly. So the merit falls with
every step that is taken, and the loop ends (Nocedal and Wright, Numerical Optimization, 2006, Section 18.5).

Of very many constraints only some are known; where a step leads to others come into view, and count from
then on. Where constraints bend away from a step it is corrected by the least change that meets them as they
look from where it led: a second-order correction with fresh derivatives (there, Section 18.3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from scipy import sparse

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed
from cmbot.optimization.qp import LocalModel, LocalValues, Step, solve_qp

__all__ = ["Descent", "Iterate", "solve_sqp"]


# Shares of the promised decrease: below, a step is not taken; below, it is too long; above, it may be longer.
_TAKEN, _TOO_LONG, _LONGER = 1e-3, 0.25, 0.75
# A step that keeps less than this is corrected, so often at most; by how much more a correction cares for
# violations than for the rest, and how much it costs to change all of the step.
_CORRECTED, _CORRECTIONS, _FIRM, _STIFF = 0.5, 2, 1e3, 100.0
_LEAST_PROMISE = 1e-15
# The box that steps stay in, at first and at most: it doubles where steps reach its sides and keep their
# promise. How far a promise is made when it tells whether the end is reached.
_BOX, _LARGEST_BOX, _UNIT = 4.0, 1e3, 1.0
# The least damping is next to none: where via-points are dense, many unknowns move far together.
_LEAST_DAMPING, _MOST_DAMPING, _DAMPING_STEP, _RELEASE = 1e-10, 1e6, 4.0, 16.0
_MOST_PENALTY, _PENALTY_STEP = 1e4, 10.0
# A step that leaves this share of the violations does little about them; a larger penalty is worthwhile if it
# brings that down to this share; where none brings violations down to this share they cannot be met.
_STAYS, _WORTHWHILE, _HOPELESS = 0.5, 0.5, 0.9
# So many steps that together gain less than the accuracy are enough; so many that leave this share of what is
# violated by more than that lead nowhere.
_SLOW = 5
_LONG, _LEFT, _FAR = 30, 0.8, 2e-2
# Objective and peak below this do not make the accuracy finer.
_SMALLEST = 1e-2


class Iterate(Protocol):
    """A point of the problem, with the constraints that were known when it was made."""

    @property
    def values(self) -> LocalValues:
        """Values alone."""

    @property
    def first(self) -> LocalModel:
        """Values and first derivatives; the Hessian is left empty."""

    def curvature(self, multipliers: FloatArray) -> sparse.csr_array:
        """Positive definite Hessian (n, n) of the Lagrangian; multipliers (K,) as constraints."""

    def moved(self, p: FloatArray) -> Self:
        """Step by `p` (n,); what is violated there is known from then on.

        Raises
        ------
        OptimisationFailed
            When that leads nowhere.
        """

    def renewed(self) -> Self:
        """Return the same point with the constraints that are known by now: itself, if these are the same."""

    def lifted(self, multipliers: FloatArray) -> FloatArray:
        """Multipliers of the constraints known by now, from those of constraints known some time before."""

    def thinned(self, multipliers: FloatArray) -> tuple[Self, FloatArray]:
        """Return the same point when constraints that do not matter are forgotten, and multipliers (K,)."""


AnyIterate = TypeVar("AnyIterate", bound=Iterate)


@dataclass(frozen=True, kw_only=True)
class Descent(Generic[AnyIterate]):
    """Where a descent ended.

    Attributes
    ----------
    place : Iterate
    multipliers : (K,)
    penalty : (kinds,)
    damping : float
        To go on with.
    iterations : int
        Quadratic programs, but for corrections.
    merits : tuple of (kinds,), float, float
        Penalty, and the merit for it before and after, of each step that was taken.
    settled : bool
        No step promises more than the accuracy, and the constraints are met.
    stuck : bool
        Constraints are violated, and no step makes that better, or many have done little about it.
    slow : bool
        Constraints are met, and the last steps together gained no more than the accuracy.
    """

    place: AnyIterate
    multipliers: FloatArray
    penalty: FloatArray
    damping: float
    iterations: int
    merits: tuple[tuple[FloatArray, float, float], ...]
    settled: bool
    stuck: bool
    slow: bool


def solve_sqp(
    place: AnyIterate,
    multipliers: FloatArray,
    *,
    penalty: FloatArray,
    damping: float,
    accuracy: float,
    tolerance: float,
    max_iterations: int,
) -> Descent[AnyIterate]:
    """Lower the merit from `place` until nothing more is to be gained.

    Parameters
    ----------
    place : Iterate
    multipliers : (K,)
        First guess.
    penalty : (kinds,)
        Weight of the largest violation of each kind of constraints; grows where violations stay.
    damping : float
        Weight of half the step's square; grows where the model promises too much.
    accuracy : float
        It ends when the model, not damped, promises less in a box of radius 1; as a share of objective and
        peak where these are below 1.
    tolerance : float
        Violations up to this count as met.
    max_iterations : int
    """
    walk = _SqpState(place, multipliers, penalty, damping, accuracy, tolerance)
    iterations = 0
    while iterations < max_iterations and not (walk.settled or walk.stuck or walk.slow):
        iterations += 1
        model = walk.model()
        step = walk.steered(model)
        promised = walk.promise(model, step.p)
        if promised > walk.accuracy or not walk.ends(model, step):
            walk.take(model, step, promised)
    return Descent(
        place=walk.place,
        multipliers=walk.place.lifted(walk.multipliers),
        penalty=walk.penalty,
        damping=walk.damping,
        iterations=iterations,
        merits=tuple(walk.merits),
        settled=walk.settled,
        stuck=walk.stuck,
        slow=walk.slow,
    )


class _SqpState(Generic[AnyIterate]):
    """Where a descent has come to."""

    def __init__(
        self,
        place: AnyIterate,
        multipliers: FloatArray,
        penalty: FloatArray,
        damping: float,
        accuracy: float,
        tolerance: float,
    ) -> None:
        self.place, self.multipliers = place, multipliers
        self.penalty, self.damping = penalty, damping
        self.settled = self.stuck = False
        self.merits: list[tuple[FloatArray, float, float]] = []
        self._accuracy, self._tolerance = accuracy, tolerance
        self._hessian = place.curvature(multipliers)
        self._excused, self._box = False, _BOX
        self._violations = [place.values.violation]

    @property
    def accuracy(self) -> float:
        """What nothing is worth doing for, where the walk is."""
        here = self.place.values
        return self._accuracy * min(1.0, max(abs(here.objective + here.peak), _SMALLEST))

    @property
    def slow(self) -> bool:
        """The last steps together gained no more than the accuracy."""
        last = self.merits[-_SLOW:]
        gained = sum(before - after for _, before, after in last)
        met = self.place.values.violation <= self._tolerance
        return met and len(last) == _SLOW and gained <= self.accuracy

    def model(self) -> LocalModel:
        """Return the problem to second order where the walk is."""
        return replace(self.place.first, hessian=self._hessian)

    def steered(self, model: LocalModel) -> Step:
        """Solve the quadratic program; where violations stay that need not, with larger penalties."""
        step = solve_qp(model, self.penalty, self._box, self.damping)
        kinds = len(self.penalty)
        here, left = model.violations(kinds=kinds), model.violations(step.p, kinds=kinds)
        while True:
            stays = (left > np.maximum(self._tolerance, _STAYS * here)) & (self.penalty < _MOST_PENALTY)
            if not stays.any():
                return step
            penalty = np.where(stays, _PENALTY_STEP, 1.0) * self.penalty
            firmer = solve_qp(model, penalty, self._box, self.damping)
            better = model.violations(firmer.p, kinds=kinds)
            helps = stays & (better < _WORTHWHILE * left)
            if not helps.any():
                return step
            step, left, self.penalty = firmer, better, np.where(helps, penalty, self.penalty)

    def promise(self, model: LocalModel, p: FloatArray) -> float:
        """How far the merit falls by the step `p` (n,) if the model is right."""
        return max(model.merit(self.penalty) - model.after(p, self.penalty), _LEAST_PROMISE)

    def ends(self, model: LocalModel, step: Step) -> bool:
        """Whether a step that promises little is not worth taking; settle then, or find out what is wrong."""
        if not step.solved or self.damping > _MOST_DAMPING:
            self.stuck = self.damping > _MOST_DAMPING
            self.damping *= _DAMPING_STEP
            return True
        if model.violation <= self._tolerance:
            far = solve_qp(model, self.penalty, _UNIT, 0.0).p
            self.settled = self.promise(model, far) <= self.accuracy
            return self.settled
        kinds = len(self.penalty)
        if model.violations(step.p, kinds=kinds).max() <= _STAYS * model.violation:
            return False
        firmest = solve_qp(model, np.full(kinds, _MOST_PENALTY), _UNIT, 0.0).p
        least = model.violations(firmest, kinds=kinds).max()
        self.stuck = bool(self.penalty.min() >= _MOST_PENALTY or least > _HOPELESS * model.violation)
        self.penalty = np.minimum((1.0 if self.stuck else _PENALTY_STEP) * self.penalty, _MOST_PENALTY)
        return True

    def take(self, model: LocalModel, step: Step, promised: float) -> None:
        """Try a step; move if the merit falls, and judge the damping by how far it does."""
        trial, gained = self._tried(model, step.p, promised)
        missed = self.place.renewed() is not self.place
        self.place = self.place.renewed()
        # What a step overlooked does not make it too long, unless it does so again.
        self._excused = missed and gained < _TOO_LONG * promised and not self._excused
        if gained < _TOO_LONG * promised and not self._excused:
            halving = promised / max(float(step.p @ step.p), _LEAST_PROMISE)
            self.damping = max(_DAMPING_STEP * self.damping, halving)
            self._box = max(0.5 * self._box, _BOX)
        elif gained > _LONGER * promised:
            self.damping = max(self.damping / _RELEASE, _LEAST_DAMPING)
            if float(np.abs(step.p).max()) > 0.9 * self._box:
                self._box = min(2.0 * self._box, _LARGEST_BOX)
        if trial is not None and gained > _TAKEN * promised:
            trial = trial.renewed()
            before, after = (at.values.merit(self.penalty) for at in (self.place, trial))
            self.merits.append((self.penalty, before, after))
            self.place, self.multipliers = trial.thinned(trial.lifted(step.multipliers))
            self._hessian = self.place.curvature(self.multipliers)
        elif self.damping > _MOST_DAMPING:
            self.settled = model.violation <= self._tolerance
            self.stuck = not self.settled
        self._violations.append(self.place.values.violation)
        last = self._violations[-1 - _LONG :]
        self.stuck |= len(last) > _LONG and min(last) > max(_FAR, _LEFT * last[0])

    def _tried(self, model: LocalModel, p: FloatArray, promised: float) -> tuple[AnyIterate | None, float]:
        """Take the step `p` (n,) and look what it gains; where that is little, correct it."""
        length = float(np.abs(p).max())
        stiffness = _STIFF * promised / max(length**2, _LEAST_PROMISE)
        trial = _moved(self.place, p)
        best: tuple[AnyIterate | None, float] = (None, -np.inf)
        for correction in range(_CORRECTIONS + 1):
            if trial is None:
                break
            here, trial = self.place.renewed(), trial.renewed()
            gained = here.values.merit(self.penalty) - trial.values.merit(self.penalty)
            if gained > best[1]:
                best = trial, gained
            if gained >= _CORRECTED * promised or correction == _CORRECTIONS:
                break
            bent = replace(trial.first, gradient=model.gradient + model.hessian @ p, hessian=model.hessian)
            change = solve_qp(bent, _FIRM * self.penalty, length, stiffness).p
            p, trial = p + change, _moved(trial, change)
        return best


def _moved(place: AnyIterate, p: FloatArray) -> AnyIterate | None:
    try:
        trial = place.moved(p)
    except OptimisationFailed:
        return None
    at = trial.values
    return trial if np.isfinite(at.objective + at.peak + at.violation) else None
