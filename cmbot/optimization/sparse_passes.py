"""The sparse solver's side of the exchange: what it keeps from pass to pass."""

from __future__ import annotations

import numpy as np

from cmbot.common.errors import OptimisationFailed
from cmbot.optimization.constraint_set import ConstraintSet
from cmbot.optimization.continuation import Effort
from cmbot.optimization.iterate import NlpEvaluation
from cmbot.optimization.sqp import Descent, solve_sqp
from cmbot.optimization.working_set import WorkingSet
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.trajectory.parametrization import Parametrization

__all__ = ["SparsePasses"]


# No step is taken for less than this, relative to the objective, which is about 1. Along a flat valley steps
# gain a few times that and there are hundreds of them: with 1e-5 some ended 5e-3 above the optimum.
_ACCURACY = 1e-6
# Constraints of the working set are met so much better than they have to be.
_CLOSER = 0.5
# The first penalties, the least later ones, and how far they stay above the sums of multipliers.
_PENALTY, _LEAST_PENALTY, _ABOVE = 1e-2, 1e-3, 2.0
# A pass starts with no more damping than this.
_DAMPING = 1e-4
# Steps of a pass, at most.
_MOST_STEPS = 60


class SparsePasses:
    """Solves the subproblems of an exchange; multipliers and damping are kept from pass to pass.

    Parameters
    ----------
    problem : TorqueProblem
    working : WorkingSet
    """

    def __init__(self, problem: TorqueProblem, working: WorkingSet) -> None:
        self._problem = problem
        self._known = ConstraintSet(problem, working)
        self._multipliers = np.empty(0)
        self._penalty = np.full(len(working.sizes), _PENALTY)
        self._damping = _DAMPING

    def solve(
        self, family: Parametrization, bound: float | None, effort: Effort
    ) -> tuple[Parametrization, float, int, float]:
        """Lower the peak, or with a `bound` on it the mean square.

        Every step is looked at in full: the working set grows as it goes.

        Parameters
        ----------
        family : Parametrization
            Where to start.
        bound : float or None
            What the scaled torque is held below.
        effort : Effort

        Returns
        -------
        family : Parametrization
            Built around where it ended.
        peak : float
            Largest scaled torque at the working times.
        iterations : int
        gain : float
            How far the merit fell; 0 when nothing more is to be gained.

        Raises
        ------
        OptimisationFailed
            When the constraints cannot be met near where it ended.
        """
        options = self._problem.options
        family = family.rebuilt(family.start, options.smoothing_weight * effort.smoothing)
        start = NlpEvaluation.on(self._known, family, bound)
        ended = solve_sqp(
            start,
            self._known.lifted(self._multipliers),
            penalty=self._penalty,
            damping=min(self._damping, _DAMPING),
            accuracy=_ACCURACY,
            tolerance=_CLOSER * options.constraint_tolerance,
            max_iterations=min(effort.iterations, options.max_iterations, _MOST_STEPS),
        )
        self._keep(ended)
        peak = ended.place.values.peak if bound is None else bound
        if ended.stuck:
            worst = self._known.look(ended.place.trajectory, peak)
            raise OptimisationFailed(
                "near the trajectory that was found the constraints cannot all be met",
                constraint=worst.name,
                violation=worst.value,
            )
        done = ended.settled or ended.slow
        gain = 0.0 if done else sum(before - after for _, before, after in ended.merits)
        return ended.place.family, peak, ended.iterations, gain

    def _keep(self, ended: Descent[NlpEvaluation]) -> None:
        """Keep what the next pass starts from; penalties may fall again to what multipliers ask for."""
        values = ended.place.values
        needed = np.zeros_like(ended.penalty)
        np.add.at(needed, values.kind[values.peaks :], _ABOVE * ended.multipliers[values.peaks :])
        self._penalty = np.minimum(np.maximum(_LEAST_PENALTY, needed), ended.penalty)
        self._multipliers, self._damping = ended.multipliers, ended.damping
