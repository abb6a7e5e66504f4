"""The constraints that the optimiser works with: few times, chosen where they are or may be violated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cmbot.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.family import Family
from cmbot.planning.problem import KinematicBound, TorqueProblem
from cmbot.planning.state_functions import StateFunction, States, ToolDeviation
from cmbot.planning.trajectory import QuinticTrajectory

__all__ = ["Violation", "WorkingSet", "bound_values"]


# Two sites of one component nearer than this share of a grid step are the same.
_SAME_SITE = 0.005
# The peak is the objective: what exceeds it counts at this share of the constraints' tolerance.
_PEAK = 0.1
# Sampled constraints within this of their bound are looked at between the samples, too.
_NEAR = 0.02


@dataclass(frozen=True)
class Violation:
    """The constraint that is violated most, as a share of its bound."""

    name: str
    value: float


@dataclass
class _Sites:
    """Times at which one constraint is looked at, which component of it, and the splines' rows there."""

    times: FloatArray = field(default_factory=lambda: np.empty(0))
    component: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    rows: Any = None

    def add(self, times: FloatArray, component: IntArray, problem: TorqueProblem) -> int:
        """Add the sites that are not there yet; return how many."""
        step = _SAME_SITE * (problem.grid[1] - problem.grid[0])
        known = (np.abs(self.times - times[:, None]) < step) & (self.component == component[:, None])
        new = ~known.any(axis=1)
        if new.any():
            self.times = np.append(self.times, times[new])
            self.component = np.append(self.component, component[new])
            self.rows = problem.family.rows(self.times)
        return int(new.sum())


class WorkingSet:
    """Constraints at chosen times, as one vector ``c(x) <= 0`` with its Jacobian.

    The guardrail torque comes first; what it is compared with (`TorqueProblem`) is left to the caller.

    Parameters
    ----------
    problem : TorqueProblem
    """

    def __init__(self, problem: TorqueProblem) -> None:
        self._problem = problem
        self._functions: tuple[StateFunction, ...] = (problem.torque, *problem.functions)
        self._state_sites = [_Sites() for _ in self._functions]
        self._bound_sites = [_Sites() for _ in problem.bounds]

    def __len__(self) -> int:
        return sum(self.sizes)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of sites, function after function, then bound after bound, as in `values`."""
        return tuple(len(sites.times) for sites in (*self._state_sites, *self._bound_sites))

    def values(self, family: Family, x: FloatArray) -> tuple[FloatArray, Any, int]:
        """Return values (K,), Jacobian (K, .), and how many leading rows are guardrail torques."""
        problem = self._problem
        values, jacobians = [], []
        trajectory = problem.trajectory(family, x)
        for function, sites in zip(self._functions, self._state_sites, strict=True):
            if len(sites.times):
                at = function.linearise(States(sites.times, *trajectory.states(sites.times)), sites.component)
                values.append(at.value)
                jacobians.append(family.chain(x, sites.rows, at.d_q, at.d_v, at.d_a))
        for bound, sites in zip(problem.bounds, self._bound_sites, strict=True):
            if len(sites.times):
                value, joint, factor = bound_values(bound, sites.times, sites.component, trajectory)
                values.append(value)
                jacobians.append(family.chain_one(x, sites.rows, bound.order, joint, factor))
        if not values:
            return np.empty(0), family.stacked([]), 0
        return np.concatenate(values), family.stacked(jacobians), len(self._state_sites[0].times)

    def faces(self, family: Family, x: FloatArray) -> tuple[FloatArray, Any]:
        """Return values (F,) and derivatives (F, .) of what never exceeds the tool's deviations: offsets."""
        values, jacobians = [], []
        trajectory = self._problem.trajectory(family, x)
        for function, sites in zip(self._functions, self._state_sites, strict=True):
            if isinstance(function, ToolDeviation) and len(sites.times):
                for at in function.faces(States(sites.times, *trajectory.states(sites.times))):
                    values.append(at.value)
                    jacobians.append(family.chain(x, sites.rows, at.d_q, at.d_v, at.d_a))
        return np.concatenate([np.empty(0), *values]), family.stacked(jacobians)

    def state_sites(self) -> Iterator[tuple[StateFunction, FloatArray, IntArray]]:
        """Go through the functions of the state, as in `values`: times and components of their sites."""
        for function, sites in zip(self._functions, self._state_sites, strict=True):
            yield function, sites.times, sites.component

    def bound_sites(self) -> Iterator[tuple[KinematicBound, FloatArray, IntArray]]:
        """Go through the joints' bounds, as in `values`: times and components of their sites.

        Component 2 j is the upper bound of joint j, 2 j + 1 the lower one.
        """
        for bound, sites in zip(self._problem.bounds, self._bound_sites, strict=True):
            yield bound, sites.times, sites.component

    def add_everywhere(self, times: FloatArray) -> None:
        """Add the guardrail torque and every constraint with one component at `times`.

        Without a first hold all along, the first passes would run far away where nothing has been added yet.
        """
        for function, sites in zip(self._functions, self._state_sites, strict=True):
            if function.components == 1:
                sites.add(times, np.zeros(len(times), dtype=np.intp), self._problem)

    def add_violated(
        self, trajectory: QuinticTrajectory, torque_bound: float, tolerance: float, stride: int, most: int
    ) -> tuple[int, Violation, float]:
        """Add the local maxima of every constraint that `trajectory` violates.

        Parameters
        ----------
        trajectory : QuinticTrajectory
        torque_bound : float
            What the scaled guardrail torque is compared with.
        tolerance : float
            Violations up to this count as met.
        stride : int
            Every which grid time is looked at; polynomials are always looked at in full.
        most : int
            At most so many sites of each constraint are added.

        Returns
        -------
        added : int
        worst : Violation
            Of all constraints but the guardrail torque's bound.
        peak : float
            Largest scaled guardrail torque seen.
        """
        times = self._problem.grid[::stride]
        states = States(times, *trajectory.states(times))
        added, worst, peak = 0, Violation("none", -np.inf), 0.0
        for number, (function, sites) in enumerate(zip(self._functions, self._state_sites, strict=True)):
            value, component = function.values(states)
            row, column = np.nonzero(_local_maxima(value))
            top, limit = value[row, column], torque_bound if number == 0 else 0.0
            if number == 0:
                peak = float(top.max())
            # What is near its bound between samples is looked at where it is largest.
            near = top > limit - _NEAR
            row, column, top = row[near], column[near], top[near]
            when, where = times[row], component[row, column]
            if len(when):
                when = when + _shifts(times, value, row, column)
                again, which = function.values(States(when, *trajectory.states(when)))
                k = np.arange(len(when))
                better = again[k, column] > top
                when = np.where(better, when, times[row])
                where = np.where(better, which[k, column], where)
                top = np.maximum(again[k, column], top)
            if number == 0:
                peak = max(peak, float(top.max(initial=0.0)))
            else:
                largest = float(value.max()) if len(top) == 0 else float(top.max())
                if largest > worst.value:
                    worst = Violation(function.name, largest)
            order = np.argsort(-top)
            order = order[top[order] > limit + (_PEAK if number == 0 else 1.0) * tolerance][:most]
            added += sites.add(when[order], where[order], self._problem)
        for bound, sites in zip(self._problem.bounds, self._bound_sites, strict=True):
            extrema = trajectory.extrema(bound.order)
            over = (extrema.value - bound.high[:, None]) / bound.scale[:, None]
            under = (bound.low[:, None] - extrema.value) / bound.scale[:, None]
            value = np.stack([over, under], axis=2)
            if value.max() > worst.value:
                name = self._problem.robot.joints[np.unravel_index(value.argmax(), value.shape)[1]]
                worst = Violation(f"{bound.name} of {name}", float(value.max()))
            # The worst time of each segment, joint and side.
            segment, joint, side = np.nonzero(value.max(axis=3) > tolerance)
            if len(segment) == 0:
                continue
            at = value[segment, joint, side].argmax(axis=1)
            order = np.argsort(-value[segment, joint, side, at])[:most]
            when = extrema.time[segment, joint, at][order]
            added += sites.add(when, (2 * joint + side)[order], self._problem)
        return added, worst, peak


def bound_values(
    bound: KinematicBound, times: FloatArray, component: IntArray, trajectory: QuinticTrajectory
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Values (N,) of a joint's bound at its sites, the joints (N,), and their derivatives' factors (N,).

    Component 2 j is the upper bound of joint j, 2 j + 1 the lower one.
    """
    joint, upper = component // 2, component % 2 == 0
    derivative = trajectory.evaluate(times, bound.order)[np.arange(len(joint)), joint]
    sign = np.where(upper, 1.0, -1.0)
    limit = np.where(upper, bound.high[joint], bound.low[joint])
    return sign * (derivative - limit) / bound.scale[joint], joint, sign / bound.scale[joint]


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
