"""The constraints that the optimiser works with: few times, chosen where they are or may be violated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.optimization.separation import (
    NEAR,
    WorstViolations,
    broken_between_samples,
    broken_bound,
    values_of,
)
from cmbot.planning.torque.clearance_samples import ClearanceLooks
from cmbot.planning.torque.constraints import ClearanceMargin, StateConstraint, StateSamples
from cmbot.planning.torque.families import FixedKnots
from cmbot.planning.torque.problem import KinematicBound, TorqueProblem
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["Violation", "WorkingSet", "bound_values", "signed_bound"]


# Two sites of one component nearer than this share of a grid step are the same.
_SAME_SITE = 0.005
# The peak is the objective: what exceeds it counts at this share of the constraints' tolerance.
_PEAK = 0.1
# Sharpened, sites are told apart at this share of the distance.
_SHARPER = 0.1


@dataclass(frozen=True)
class Violation:
    """The constraint that is violated most, as a share of its bound."""

    name: str
    value: float


@dataclass
class _Sites:
    """Times at which one constraint is looked at, and which component of it: grown and thinned by copies."""

    times: FloatArray = field(default_factory=lambda: np.empty(0))
    component: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    _rows: FloatArray | None = None

    def add(self, times: FloatArray, component: IntArray, problem: TorqueProblem, apart: float) -> int:
        """Add the sites that are not there yet, within so many grid steps; return how many."""
        new = ~self._there(times, component, apart * (problem.grid[1] - problem.grid[0]))
        if new.any():
            self.times = np.append(self.times, times[new])
            self.component = np.append(self.component, component[new])
            self._rows = None
        return int(new.sum())

    def keep(self, which: BoolArray) -> None:
        """Forget all sites but some."""
        if not which.all():
            self.times, self.component = self.times[which], self.component[which]
            self._rows = None

    def rows(self, family: FixedKnots) -> FloatArray:
        """The splines' rows there, which are the same for all members of a family."""
        if self._rows is None:
            self._rows = family.rows(self.times)
        return self._rows

    def _there(self, times: FloatArray, component: IntArray, step: float) -> BoolArray:
        """Which sites (K,) lie less than `step` from one that is known, and look at the same component."""
        if len(self.times) == 0 or len(times) == 0:
            return np.zeros(len(times), dtype=np.bool_)
        # Components one after the other, as if they were later times.
        far = 3.0 * max(float(np.abs(self.times).max()), float(np.abs(times).max()), step)
        known, new = np.sort(self.times + far * self.component), times + far * component
        after = np.searchsorted(known, new)
        before = np.abs(new - known[np.maximum(after - 1, 0)])
        return np.asarray(np.minimum(before, np.abs(new - known[np.minimum(after, len(known) - 1)])) < step)


class WorkingSet:
    """Constraints at chosen times, as one vector ``c(x) <= 0`` with its Jacobian.

    The guardrail torque comes first; what it is compared with (`TorqueProblem`) is left to the caller.

    Parameters
    ----------
    problem : TorqueProblem
    """

    def __init__(self, problem: TorqueProblem) -> None:
        self._problem = problem
        self._functions: tuple[StateConstraint, ...] = (problem.torque, *problem.functions)
        self._state_sites = [_Sites() for _ in self._functions]
        self._bound_sites = [_Sites() for _ in problem.bounds]
        self._apart = _SAME_SITE
        self._looks = {
            number: ClearanceLooks(function, len(problem.grid), problem.robot.dof)
            for number, function in enumerate(self._functions)
            if isinstance(function, ClearanceMargin)
        }

    def __len__(self) -> int:
        return sum(self.sizes)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of sites, function after function, then bound after bound, as in `values`."""
        return tuple(len(sites.times) for sites in (*self._state_sites, *self._bound_sites))

    def values(self, family: FixedKnots, x: FloatArray) -> tuple[FloatArray, FloatArray, int]:
        """Return values (K,), Jacobian (K, n), and how many leading rows are guardrail torques."""
        problem = self._problem
        values, jacobians = [np.empty(0)], [np.empty((0, family.dimension))]
        trajectory = problem.trajectory(family, x)
        for function, sites in zip(self._functions, self._state_sites, strict=True):
            if len(sites.times):
                at = function.linearise(
                    StateSamples(sites.times, *trajectory.states(sites.times)), sites.component
                )
                values.append(at.value)
                jacobians.append(family.chain(x, sites.rows(family), at.d_q, at.d_v, at.d_a))
        for bound, sites in zip(problem.bounds, self._bound_sites, strict=True):
            if len(sites.times):
                value, joint, factor = bound_values(bound, sites.times, sites.component, trajectory)
                values.append(value)
                jacobians.append(family.chain_one(x, sites.rows(family), bound.order, joint, factor))
        return np.concatenate(values), np.vstack(jacobians), len(self._state_sites[0].times)

    def state_sites(self) -> Iterator[tuple[StateConstraint, FloatArray, IntArray]]:
        """Go through the functions of the state, as in `values`: times and components of their sites."""
        for function, sites in zip(self._functions, self._state_sites, strict=True):
            yield function, sites.times, sites.component

    def bound_sites(self) -> Iterator[tuple[KinematicBound, FloatArray, IntArray]]:
        """Go through the joints' bounds, as in `values`: times and components of their sites.

        Component 2 j is the upper bound of joint j, 2 j + 1 the lower one.
        """
        for bound, sites in zip(self._problem.bounds, self._bound_sites, strict=True):
            yield bound, sites.times, sites.component

    def keep(self, which: BoolArray) -> None:
        """Forget all sites but some of the K, in the order of `values`."""
        parts = np.split(which, np.cumsum(self.sizes)[:-1])
        for sites, part in zip((*self._state_sites, *self._bound_sites), parts, strict=True):
            sites.keep(part)

    def add_everywhere(self, times: FloatArray) -> None:
        """Add the guardrail torque and every constraint with one component at `times`.

        Without a first hold all along, the first passes would run far away where nothing has been added yet.
        """
        for function, sites in zip(self._functions, self._state_sites, strict=True):
            if function.components == 1:
                sites.add(times, np.zeros(len(times), dtype=np.intp), self._problem, self._apart)

    def add_torque(self, times: FloatArray) -> None:
        """Add the guardrail torque at `times`."""
        self._state_sites[0].add(times, np.zeros(len(times), dtype=np.intp), self._problem, self._apart)

    def sharpen(self) -> None:
        """From now on tell sites apart that are nearer to each other than before."""
        self._apart *= _SHARPER

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
        states = self._problem.sampled(trajectory, stride)
        sampled = self._sampled(states, stride, torque_bound)
        added, peak, worst = 0, -np.inf, Violation("none", -np.inf)
        for number, (function, sites) in enumerate(zip(self._functions, self._state_sites, strict=True)):
            limit, room = (0.0, tolerance) if number else (torque_bound, _PEAK * tolerance)
            broken = broken_between_samples(
                trajectory, states.t, sampled[number], function.values, limit, room
            )
            added += self._added(sites, broken, most)
            if number == 0:
                peak = broken.largest
            else:
                worst = max(worst, Violation(function.name, broken.largest), key=lambda each: each.value)
        for bound, sites in zip(self._problem.bounds, self._bound_sites, strict=True):
            broken = broken_bound(trajectory, bound, tolerance)
            added += self._added(sites, broken, most)
            name = f"{bound.name} of {self._problem.robot.joints[broken.joint]}"
            worst = max(worst, Violation(name, broken.largest), key=lambda each: each.value)
        return added, worst, peak

    def _sampled(
        self, states: StateSamples, stride: int, torque_bound: float
    ) -> list[tuple[FloatArray, IntArray]]:
        """Values and components of every function of the state, where they matter."""
        every = [number for number in range(len(self._functions)) if number not in self._looks]
        found = dict(zip(every, values_of([self._functions[k] for k in every], states), strict=True))
        for number, looks in self._looks.items():
            found[number] = looks.values(states, stride, (0.0 if number else torque_bound) - NEAR)
        return [found[number] for number in range(len(self._functions))]

    def _added(self, sites: _Sites, broken: WorstViolations, most: int) -> int:
        return sites.add(broken.times[:most], broken.component[:most], self._problem, self._apart)


def bound_values(
    bound: KinematicBound, times: FloatArray, component: IntArray, trajectory: QuinticTrajectory
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Values (N,) of a joint's bound at its sites, the joints (N,), and their derivatives' factors (N,).

    Component 2 j is the upper bound of joint j, 2 j + 1 the lower one.
    """
    return signed_bound(bound, trajectory.evaluate(times, bound.order), component)


def signed_bound(
    bound: KinematicBound, derivative: FloatArray, component: IntArray
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return what `bound_values` does, from the bounded `derivative` (N, n) of all joints."""
    joint, upper = component // 2, component % 2 == 0
    own = derivative[np.arange(len(joint)), joint]
    value = np.where(upper, bound.above(own, joint), bound.below(own, joint))
    return value, joint, np.where(upper, 1.0, -1.0) / bound.scale[joint]
