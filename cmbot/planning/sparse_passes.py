"""The sparse solver's side of the exchange: descend a little, look, descend on."""

from __future__ import annotations

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.errors import OptimisationFailed
from cmbot.planning.efforts import COARSE, Effort
from cmbot.planning.problem import TorqueProblem
from cmbot.planning.sparse_family import LocalKnots
from cmbot.planning.sparse_place import TorquePlace
from cmbot.planning.sqp import descend
from cmbot.planning.working_set import Violation, WorkingSet

__all__ = ["SparsePasses"]


# So few quadratic programs, coarsely and on all samples, before new violations are looked for: long steps are
# only safe where there are constraints to hold them.
_COARSE_STEPS, _FINE_STEPS = 5, 10
# A coarse pass need neither end at the optimum nor meet its constraints better than this.
_COARSE_ACCURACY = 1e-3
# No pass goes on for less than this: in one step, or with those between two looks.
_FINEST, _SLOW = 1e-6, 1e-5
# Constraints of the working set are met so much better than they have to be at the samples.
_CLOSER = 0.1
# The first penalty, how far it stays above the sum of multipliers, the radius that a pass may try again.
_PENALTY, _ABOVE, _LEAST_RADIUS = 0.1, 2.0, 0.1
_FIRST_RADIUS = 1.0
# Quadratic programs of a pass, at most; one that uses them all has to bring violations down to this share.
_MOST_STEPS, _STALLED = 60, 0.9


class SparsePasses:
    """Solves the subproblems of an exchange; multipliers and radius are kept from pass to pass.

    Parameters
    ----------
    problem : TorqueProblem
    working : WorkingSet
    """

    def __init__(self, problem: TorqueProblem, working: WorkingSet) -> None:
        self._problem = problem
        self._working = working
        self._multipliers: tuple[FloatArray, ...] = ()
        self._radius, self._penalty = _FIRST_RADIUS, _PENALTY

    def solve(
        self, family: LocalKnots, bound: float | None, effort: Effort
    ) -> tuple[LocalKnots, float, int, float]:
        """Lower the peak, or with a `bound` on it the mean square.

        Parameters
        ----------
        family : LocalKnots
            Where to start.
        bound : float or None
            What the scaled torque is held below.
        effort : Effort

        Returns
        -------
        family : LocalKnots
            Built around where it ended.
        peak : float
            Largest scaled torque at the working times.
        iterations : int
        gain : float
            How far the merit fell since the working set was last added to.

        Raises
        ------
        OptimisationFailed
            When the constraints cannot be met near where it ended.
        """
        options = self._problem.options
        most = min(effort.iterations, options.max_iterations, _MOST_STEPS)
        family = family.rebuilt(family.start, options.smoothing_weight * effort.smoothing)
        coarse = effort is COARSE
        iterations, radius = 0, max(self._radius, _LEAST_RADIUS)
        violated, lowest = np.inf, np.inf
        while True:
            start = TorquePlace(self._problem, self._working, family, bound)
            ended = descend(
                start,
                self._guess(),
                penalty=self._penalty,
                radius=radius,
                accuracy=_COARSE_ACCURACY if coarse else max(effort.accuracy, _FINEST),
                tolerance=_COARSE_ACCURACY if coarse else _CLOSER * options.constraint_tolerance,
                max_iterations=min(_COARSE_STEPS if coarse else _FINE_STEPS, most - iterations),
            )
            violated = min(violated, start.first.violation)
            self._keep(ended.multipliers)
            radius = self._radius = ended.radius
            needed = _ABOVE * float(ended.multipliers[ended.place.first.peaks :].sum())
            self._penalty = min(max(_PENALTY, needed), ended.penalty)
            iterations += ended.iterations
            family, first = ended.place.family, ended.place.first
            peak = float(first.value[: first.peaks].max()) if bound is None else bound
            gain = start.first.merit(ended.penalty) - first.merit(ended.penalty)
            met = first.violation <= options.constraint_tolerance
            now = first.merit(_PENALTY)
            slow = met and not coarse and min(gain, lowest - now) < _SLOW
            lowest = min(lowest, now) if met else lowest
            if ended.stuck or ended.settled or slow or iterations >= most:
                break
            self._look(family, peak, effort)
        # Whoever gets nowhere in so many steps will not get there in many times as many.
        stalled = (
            not met and not ended.settled and first.violation > max(_STALLED * violated, _COARSE_ACCURACY)
        )
        if (ended.stuck or stalled) and not coarse:
            worst = self._look(family, peak, effort)
            raise OptimisationFailed(
                "near the trajectory that was found the constraints cannot all be met",
                constraint=worst.name,
                violation=worst.value,
            )
        return family, peak, iterations, gain

    def _look(self, family: LocalKnots, bound: float, effort: Effort) -> Violation:
        trajectory = self._problem.trajectory(family, family.start)
        tolerance = self._problem.options.constraint_tolerance
        return self._working.add_violated(trajectory, bound, tolerance, effort.stride, effort.most)[1]

    def _guess(self) -> FloatArray:
        """Multipliers of the working set: those of old sites, none for new ones."""
        sizes = self._working.sizes
        known = self._multipliers or tuple(np.empty(0) for _ in sizes)
        parts = [np.append(old, np.zeros(size - len(old))) for old, size in zip(known, sizes, strict=True)]
        return np.concatenate(parts)

    def _keep(self, multipliers: FloatArray) -> None:
        self._multipliers = tuple(np.split(multipliers, np.cumsum(self._working.sizes)[:-1]))
