"""Where a trajectory breaks a constraint most: at samples and a little between them, or at exact extrema."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.torque.constraints import StateConstraint, StateSamples
from cmbot.planning.torque.problem import KinematicBound
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["NEAR", "WorstViolations", "broken_between_samples", "broken_bound", "values_of"]

NEAR = 0.02
"""Sampled constraints within this of their bound are looked at between the samples, too."""

# So many states are evaluated at once: more only ask for memory, and lose its nearness.
_BLOCK = 4096


@dataclass(frozen=True, kw_only=True)
class WorstViolations:
    """Where a constraint is broken, the worst first.

    Attributes
    ----------
    times : (K,), s
    component : (K,)
    largest : float
        The constraint's largest value anywhere; where it is not broken, the largest that was seen.
    joint : int
        With the largest value, of a joint's bound; -1 for other constraints.
    """

    times: FloatArray
    component: IntArray
    largest: float
    joint: int = -1


def values_of(
    functions: Sequence[StateConstraint], states: StateSamples
) -> list[tuple[FloatArray, IntArray]]:
    """Return values and components of functions at N states, block by block: what they share is shared."""
    each: list[list[tuple[FloatArray, IntArray]]] = [[] for _ in functions]
    for k in range(0, len(states.t), _BLOCK):
        block = states[k : k + _BLOCK]
        for parts, function in zip(each, functions, strict=True):
            parts.append(function.values(block))
    return [(np.concatenate([v for v, _ in parts]), np.concatenate([c for _, c in parts])) for parts in each]


def broken_between_samples(
    trajectory: QuinticTrajectory,
    times: FloatArray,
    sampled: tuple[FloatArray, IntArray],
    exact: Callable[[StateSamples], tuple[FloatArray, IntArray]],
    limit: float,
    tolerance: float,
) -> WorstViolations:
    """Find the local maxima of a function of the state that exceed `limit` by more than `tolerance`.

    Parameters
    ----------
    trajectory : QuinticTrajectory
    times : (N,), s
    sampled : value and component, (N, c) each
        At those times; exact where a value exceeds `limit` less `NEAR`, and beside.
    exact : callable
        The function itself: from states to values and components.
    limit, tolerance : float
    """
    value, component = sampled
    row, column = np.nonzero(_local_maxima(value) & (value > limit - NEAR))
    if len(row) == 0:
        return WorstViolations(
            times=np.empty(0), component=np.empty(0, dtype=np.intp), largest=float(value.max())
        )
    top, where = value[row, column], component[row, column]
    shifted = times[row] + _shifts(times, value, row, column)
    again, which = exact(StateSamples(shifted, *trajectory.states(shifted)))
    k = np.arange(len(row))
    better = again[k, column] > top
    when = np.where(better, shifted, times[row])
    where = np.where(better, which[k, column], where)
    top = np.maximum(again[k, column], top)
    order = np.argsort(-top)
    order = order[top[order] > limit + tolerance]
    return WorstViolations(times=when[order], component=where[order], largest=float(top.max()))


def broken_bound(trajectory: QuinticTrajectory, bound: KinematicBound, tolerance: float) -> WorstViolations:
    """Find the worst time of each segment, joint and side at which a joint's bound is broken.

    Component 2 j is the upper bound of joint j, 2 j + 1 the lower one.
    """
    at_knots = trajectory.evaluate(trajectory.t, bound.order)
    attained = np.maximum(bound.above(at_knots), bound.below(at_knots))
    joint, largest = int(attained.max(axis=0).argmax()), float(attained.max())
    # Extrema are worked out only where one may be broken.
    low, high = trajectory.hull(bound.order)
    possible = np.maximum(bound.above(high), bound.below(low))
    segment, joints = np.nonzero(possible > tolerance)
    if len(segment) == 0:
        return WorstViolations(
            times=np.empty(0), component=np.empty(0, dtype=np.intp), largest=largest, joint=joint
        )
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
