"""Values and derivatives of a program's constraints along one trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.optimization.constraint_set import ConstraintSet
from cmbot.optimization.program import KinematicBound, Linearization, Program, StateFunction, StateSamples
from cmbot.trajectory import QuinticTrajectory

# Position, velocity, acceleration and jerk.
_DERIVATIVE_ORDERS = (0, 1, 2, 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstraintValues:
    """K constraints along a trajectory, and the C direction cuts of some of them.

    Derivatives are by position, velocity, acceleration and jerk.
    """

    value: FloatArray  # (K,)
    derivative: FloatArray  # (4, K, d)
    cut_of: IntArray  # (C,), which of the constraints each cut belongs to
    cut_value: FloatArray  # (C,)
    cut_derivative: FloatArray  # (4, C, d)

    def kept(self, which: BoolArray) -> ConstraintValues:
        """Return those of the K constraints that `which` names, with their cuts."""
        cuts = which[self.cut_of]
        return ConstraintValues(
            value=self.value[which],
            derivative=self.derivative[:, which],
            cut_of=(np.cumsum(which) - 1)[self.cut_of[cuts]],
            cut_value=self.cut_value[cuts],
            cut_derivative=self.cut_derivative[:, cuts],
        )


def families_of(program: Program) -> tuple[StateFunction | KinematicBound, ...]:
    """Return the families of a program's constraints in order: objective, constraints, bounds."""
    return (program.objective, *program.constraints, *program.bounds)


def linearize(
    program: Program,
    constraints: ConstraintSet,
    trajectory: QuinticTrajectory,
    known: ConstraintValues | None = None,
) -> ConstraintValues:
    """Evaluate constraints along a trajectory.

    Parameters
    ----------
    program : Program
    constraints : ConstraintSet
    trajectory : QuinticTrajectory
    known : ConstraintValues, optional
        Of the first constraints of the set along the same trajectory: not evaluated again.
    """
    first = 0 if known is None else len(known.value)
    family, component = constraints.family[first:], constraints.component[first:]
    times = constraints.time[first:]
    orders = trajectory.derivatives(times, _DERIVATIVE_ORDERS)
    K, d = len(times), trajectory.q.shape[1]
    value, derivative = np.empty(K), np.zeros((4, K, d))
    cut_of, cut_value, cut_derivative = [_NO_INDEX], [np.empty(0)], [np.empty((4, 0, d))]
    for number, each in enumerate(families_of(program)):
        here = np.flatnonzero(family == number)
        if len(here) == 0:
            continue
        if isinstance(each, KinematicBound):
            value[here], derivative[each.order, here] = each.values(orders[each.order][here], component[here])
            continue
        q, v, a = (order[here] for order in orders[:3])
        states = StateSamples(times[here], q, v, a)
        at = each.linearize(states, component[here])
        value[here], derivative[:3, here] = at.value, at.derivatives
        for cut in at.cuts:
            cut_of.append(first + here)
            cut_value.append(cut.value)
            cut_derivative.append(_with_jerk(cut))
    new = ConstraintValues(
        value=value,
        derivative=derivative,
        cut_of=np.concatenate(cut_of),
        cut_value=np.concatenate(cut_value),
        cut_derivative=np.concatenate(cut_derivative, axis=1),
    )
    return new if known is None else _joined(known, new)


_NO_INDEX = np.empty(0, dtype=np.intp)


def _with_jerk(at: Linearization) -> FloatArray:
    return np.concatenate([at.derivatives, np.zeros((1, *at.d_q.shape))])


def _joined(a: ConstraintValues, b: ConstraintValues) -> ConstraintValues:
    return replace(
        a,
        value=np.append(a.value, b.value),
        derivative=np.concatenate([a.derivative, b.derivative], axis=1),
        cut_of=np.append(a.cut_of, b.cut_of),
        cut_value=np.append(a.cut_value, b.cut_value),
        cut_derivative=np.concatenate([a.cut_derivative, b.cut_derivative], axis=1),
    )
