"""Sequential quadratic programming with a trust region and an exact penalty, for sparse problems.

The merit is the objective, plus the largest of some constraints (the peak), plus a penalty times the largest
violation of the others. A step minimises the merit's second-order model in a box; it is taken if the merit
falls as far as that promises, roughly. So the merit falls with every step that is taken, and the loop ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.errors import OptimisationFailed
from cmbot.planning.sparse_qp import LocalModel, Step, solve_qp

__all__ = ["Descent", "Place", "descend"]


# Shares of the promised decrease: below, a step is not taken; below, it is too long; above, it may be longer.
_TAKEN, _TOO_LONG, _LONGER = 1e-3, 0.25, 0.75
# A step that keeps less than this is corrected for what the constraints bend, unless it is hopeless.
_CORRECTED, _HOPELESS = 0.5, -50.0
_LEAST_PROMISE = 1e-15
_SMALLEST_RADIUS, _LARGEST_RADIUS = 1e-6, 10.0
_MOST_PENALTY, _PENALTY_STEP = 1e4, 10.0
# A step that leaves this share of the violations does little about them; a larger penalty is worthwhile if it
# brings that down to this share.
_STAYS, _WORTHWHILE = 0.5, 0.9


class Place(Protocol):
    """A point of the problem."""

    @property
    def first(self) -> LocalModel:
        """Values and first derivatives here; the Hessian is left empty."""

    def second(self, multipliers: FloatArray) -> LocalModel:
        """The same with a positive definite Hessian of the Lagrangian; multipliers (K,) as constraints."""

    def moved(self, p: FloatArray) -> Self:
        """Step by `p` (n,).

        Raises
        ------
        OptimisationFailed
            When that leads nowhere.
        """


AnyPlace = TypeVar("AnyPlace", bound=Place)


@dataclass(frozen=True, kw_only=True)
class Descent(Generic[AnyPlace]):
    """Where a descent ended.

    Attributes
    ----------
    place : Place
    multipliers : (K,)
    penalty, radius : float
        To go on with.
    iterations : int
        Quadratic programs, but for corrections.
    merits : tuple of three float
        Penalty, and the merit for it before and after, of each step that was taken.
    settled : bool
        No step promises more than the accuracy, and the constraints are met; otherwise iterations ran out.
    stuck : bool
        Constraints are violated, and no step makes that better.
    """

    place: AnyPlace
    multipliers: FloatArray
    penalty: float
    radius: float
    iterations: int
    merits: tuple[tuple[float, float, float], ...]
    settled: bool
    stuck: bool


def descend(
    place: AnyPlace,
    multipliers: FloatArray,
    *,
    penalty: float,
    radius: float,
    accuracy: float,
    tolerance: float,
    max_iterations: int,
) -> Descent[AnyPlace]:
    """Lower the merit from `place` until nothing more is to be gained.

    Parameters
    ----------
    place : Place
    multipliers : (K,)
        First guess.
    penalty : float
        Weight of the largest violation; grows where violations stay.
    radius : float
        Of the box, in the unknowns' units.
    accuracy : float
        It ends when less is to be gained in a box of radius 1.
    tolerance : float
        Violations up to this count as met.
    max_iterations : int
    """
    iterations, settled, stuck = 0, False, False
    merits: list[tuple[float, float, float]] = []
    model = place.second(multipliers)
    while iterations < max_iterations and not (settled or stuck):
        iterations += 1
        step, penalty = _steered(model, penalty, radius, tolerance)
        promised = max(model.merit(penalty) - model.after(step.p, penalty), _LEAST_PROMISE)
        if radius < _SMALLEST_RADIUS:
            settled, stuck = model.violation <= tolerance, model.violation > tolerance
            break
        if promised <= accuracy * min(1.0, radius):
            if not step.solved:
                radius *= _TOO_LONG
                continue
            if model.violation <= tolerance:
                settled = True
                break
            if model.linear_violation(step.p) > _STAYS * model.violation:
                least = model.linear_violation(solve_qp(model, _MOST_PENALTY, radius).p)
                if penalty >= _MOST_PENALTY or least > _WORTHWHILE * model.violation:
                    stuck = True
                    break
                penalty *= _PENALTY_STEP
                continue
        trial, gained = _tried(place, model, step, penalty, promised)
        length = float(np.abs(step.p).max())
        if gained < _TOO_LONG * promised:
            radius = 0.5 * min(radius, length)
        elif gained > _LONGER * promised and length > 0.9 * radius:
            radius = min(2.0 * radius, _LARGEST_RADIUS)
        if trial is not None and gained > _TAKEN * promised:
            merits.append((penalty, place.first.merit(penalty), trial.first.merit(penalty)))
            place, multipliers = trial, step.multipliers
        else:
            # Constraints that the model took for straight may have been in the way: both kinds count now.
            multipliers = 0.5 * (multipliers + step.multipliers)
        model = place.second(multipliers)
    return Descent(
        place=place,
        multipliers=multipliers,
        penalty=penalty,
        radius=radius,
        iterations=iterations,
        merits=tuple(merits),
        settled=settled,
        stuck=stuck,
    )


def _steered(model: LocalModel, penalty: float, radius: float, tolerance: float) -> tuple[Step, float]:
    """Solve the quadratic program; where violations stay that need not, with a larger penalty."""
    step = solve_qp(model, penalty, radius)
    left = model.linear_violation(step.p)
    while left > max(tolerance, _STAYS * model.violation) and penalty < _MOST_PENALTY:
        firmer = solve_qp(model, _PENALTY_STEP * penalty, radius)
        better = model.linear_violation(firmer.p)
        if better > _WORTHWHILE * left:
            break
        step, left, penalty = firmer, better, _PENALTY_STEP * penalty
    return step, penalty


def _tried(
    place: AnyPlace, model: LocalModel, step: Step, penalty: float, promised: float
) -> tuple[AnyPlace | None, float]:
    """Take a step and look what it gains; correct it once if constraints bend away from it."""
    before = model.merit(penalty)
    trial = _moved(place, step.p)
    if trial is None:
        return None, -np.inf
    gained = before - trial.first.merit(penalty)
    if not _HOPELESS * promised < gained < _CORRECTED * promised:
        return trial, gained
    bent = replace(model, value=trial.first.value - model.jacobian @ step.p)
    corrected = _moved(place, solve_qp(bent, penalty, float(np.abs(step.p).max())).p)
    if corrected is None:
        return trial, gained
    again = before - corrected.first.merit(penalty)
    return (corrected, again) if again > gained else (trial, gained)


def _moved(place: AnyPlace, p: FloatArray) -> AnyPlace | None:
    try:
        trial = place.moved(p)
    except OptimisationFailed:
        return None
    return trial if np.isfinite(trial.first.merit(1.0)) else None
