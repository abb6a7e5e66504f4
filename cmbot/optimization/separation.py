"""Separation: where a trajectory violates the constraints of a program most.

Functions of the state are sampled, and evaluated between the samples where they are near their bounds; bounds
on the splines' derivatives are met at exact extrema of polynomials.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.limit import Limit
from cmbot.optimization.constraint_set import OBJECTIVE, ConstraintSet, Violation
from cmbot.optimization.program import KinematicBound, Program, StateFunction, StateSamples
from cmbot.trajectory import QuinticTrajectory

# Sampled functions within this of their bound are evaluated between the samples, too.
_NEARLY_ACTIVE = 0.02
# So many states are evaluated at once: more only ask for memory, and lose its nearness.
_STATES_PER_BLOCK = 4096
# The peak is the objective: what exceeds it counts at this share of the constraints' tolerance.
_PEAK_TOLERANCE_SHARE = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Separation:
    """What a trajectory violates.

    Attributes
    ----------
    family, component : (K,)
    time : (K,), s
        Local maxima of violated constraints, family after family, the worst of each first.
    worst : Violation
        Of all constraints but the bound on the objective.
    peak : float
        Largest value of the objective that was seen.
    """

    family: IntArray
    component: IntArray
    time: FloatArray
    worst: Violation
    peak: float

    def worst_beside(self, limit: float) -> Violation:
        """Return the worst violation, with that of the peak beyond `limit` among them."""
        peak = Violation("peak", self.peak - limit, Limit.PEAK)
        return max(self.worst, peak, key=lambda each: each.value)

    def added_to(self, constraints: ConstraintSet) -> ConstraintSet:
        """Return a set with what is violated; the same object where all of it is there."""
        return constraints.extended(self.family, self.component, self.time)


@dataclass(frozen=True, kw_only=True, eq=False)
class WorstViolations:
    """Where one family of constraints is violated, the worst first."""

    largest: float  # value anywhere; where nothing is violated, that was seen
    times: FloatArray = field(default_factory=lambda: np.empty(0))  # (K,), s
    component: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.intp))  # (K,)
    joint: int = -1  # with the largest value, of a bound on a joint; -1 otherwise

    def violation(self, name: str, limit: Limit) -> Violation:
        """Return the worst of them."""
        time = float(self.times[0]) if len(self.times) else None
        return Violation(name, self.largest, limit, time)


def find_violations(
    program: Program, trajectory: QuinticTrajectory, bound: float, tolerance: float, most: int
) -> Separation:
    """Find the local maxima of every constraint that a trajectory violates.

    Parameters
    ----------
    program : Program
    trajectory : QuinticTrajectory
    bound : float
        What the objective is compared with.
    tolerance : float
        Violations up to this count as met.
    most : int
        At most so many of each family, the worst.
    """
    states = StateSamples.even(trajectory, program.samples_per_segment)
    functions = (program.objective, *program.constraints)
    limits = [bound] + [0.0] * len(program.constraints)
    found: list[WorstViolations] = []
    violations = [Violation("none", -np.inf)]
    for number, (sampled, function, limit) in enumerate(
        zip(_sampled(functions, states, limits), functions, limits, strict=True)
    ):
        room = _PEAK_TOLERANCE_SHARE * tolerance if number == OBJECTIVE else tolerance
        found.append(violated_function(trajectory, states.t, sampled, function, limit, room))
        if number != OBJECTIVE:
            violations.append(found[-1].violation(function.name, function.limit))
    for each in program.bounds:
        found.append(violated_bound(trajectory, each, tolerance))
        name = f"{each.name} of {program.joints[found[-1].joint]}"
        violations.append(found[-1].violation(name, each.limit))
    sizes = [min(len(each.times), most) for each in found]
    return Separation(
        family=np.repeat(np.arange(len(found)), sizes),
        component=np.concatenate([each.component[:most] for each in found]),
        time=np.concatenate([each.times[:most] for each in found]),
        worst=max(violations, key=lambda each: each.value),
        peak=found[OBJECTIVE].largest,
    )


def _sampled(
    functions: tuple[StateFunction, ...], states: StateSamples, limits: list[float]
) -> list[tuple[FloatArray, IntArray]]:
    """Values and components of functions at N states, block by block, so that what they share is shared.

    What is skipped below a threshold depends on its neighbours, so such functions get all states at once.
    """
    each: list[list[tuple[FloatArray, IntArray]]] = [[] for _ in functions]
    for first in range(0, len(states.t), _STATES_PER_BLOCK):
        block = states[first : first + _STATES_PER_BLOCK]
        for parts, function, limit in zip(each, functions, limits, strict=True):
            if function.components is not None:
                parts.append(function.sample(block, limit - _NEARLY_ACTIVE))
    for parts, function, limit in zip(each, functions, limits, strict=True):
        if function.components is None:
            parts.append(function.sample(states, limit - _NEARLY_ACTIVE))
    return [(np.concatenate([v for v, _ in parts]), np.concatenate([c for _, c in parts])) for parts in each]


def violated_function(
    trajectory: QuinticTrajectory,
    times: FloatArray,
    sampled: tuple[FloatArray, IntArray],
    function: StateFunction,
    limit: float,
    tolerance: float,
) -> WorstViolations:
    """Find the local maxima of a function of the state that exceed `limit` by more than `tolerance`.

    `sampled` has its values and components, (N, c) each, at `times` (N,), s; exact where a value exceeds
    `limit` less 0.02.
    """
    value, component = sampled
    row, column = np.nonzero(_local_maxima(value) & (value > limit - _NEARLY_ACTIVE))
    if len(row) == 0:
        return WorstViolations(largest=float(value.max()))
    top, where = value[row, column], component[row, column]
    shifted = times[row] + _shifts(times, value, row, column)
    again, which = function.sample(StateSamples.along(trajectory, shifted))
    k = np.arange(len(row))
    better = again[k, column] > top
    when = np.where(better, shifted, times[row])
    where = np.where(better, which[k, column], where)
    top = np.maximum(again[k, column], top)
    order = np.argsort(-top)
    order = order[top[order] > limit + tolerance]
    return WorstViolations(times=when[order], component=where[order], largest=float(top.max()))


def violated_bound(trajectory: QuinticTrajectory, bound: KinematicBound, tolerance: float) -> WorstViolations:
    """Find the worst time of each segment, joint and side at which a bound is violated."""
    at_knots = trajectory.evaluate(trajectory.t, bound.order)
    attained = np.maximum(bound.above(at_knots), bound.below(at_knots))
    joint, largest = int(attained.max(axis=0).argmax()), float(attained.max())
    # Extrema are worked out only where one may be violated.
    low, high = trajectory.hull(bound.order)
    possible = np.maximum(bound.above(high), bound.below(low))
    segment, joints = np.nonzero(possible > tolerance)
    if len(segment) == 0:
        return WorstViolations(largest=largest, joint=joint)
    extrema = trajectory.extrema_at(bound.order, segment, joints)
    of = joints[:, None]
    value = np.stack([bound.above(extrema.value, of), bound.below(extrema.value, of)], axis=1)
    worst = value.max(axis=2)
    if worst.max() > largest:
        joint, largest = int(joints[worst.max(axis=1).argmax()]), float(worst.max())
    k, side = np.nonzero(worst > tolerance)
    order = np.argsort(-worst[k, side])
    k, side = k[order], side[order]
    return WorstViolations(
        times=extrema.time[k, value[k, side].argmax(axis=1)],
        component=2 * joints[k] + side,
        largest=largest,
        joint=joint,
    )


def _local_maxima(value: FloatArray) -> BoolArray:
    """Where each column of `value` (N, c) is not exceeded by its neighbours."""
    padded = np.pad(value, ((1, 1), (0, 0)), constant_values=-np.inf)
    return np.asarray((value >= padded[:-2]) & (value >= padded[2:]))


def _shifts(times: FloatArray, value: FloatArray, row: IntArray, column: IntArray) -> FloatArray:
    """Times from local maxima to the tops of the parabolas through them and their neighbours."""
    before, after = np.maximum(row - 1, 0), np.minimum(row + 1, len(times) - 1)
    inner = (before < row) & (row < after)
    a = np.where(inner, times[row] - times[before], 1.0)
    b = np.where(inner, times[after] - times[row], 1.0)
    middle = value[row, column]
    rise, fall = (middle - value[before, column]) / a, (middle - value[after, column]) / b
    slope, bend = (rise * b - fall * a) / (a + b), (rise + fall) / (a + b)
    inner &= bend > 0
    return np.where(inner, 0.5 * slope / np.where(inner, bend, 1.0), 0.0)
