"""The working set while the sparse solver steps: it grows where steps lead, and is thinned where they led."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.optimization.linearization import Sites
from cmbot.optimization.working_set import Violation, WorkingSet
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.trajectory.local_basis import SparseSplines
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["ConstraintSet"]


# At most so many sites of a constraint are added for a step: the worst, which usually hold the others.
_MOST = 40
# Once there are so many times as many constraints as there were, and a few more, some are forgotten.
_MANY, _MORE = 1.2, 50
# Those without a multiplier, as a share of all: the ones this far from their bounds, as shares of these, and
# all but the worst within so many grid steps.
_NEGLIGIBLE, _FAR, _WINDOW = 1e-6, -0.5, 2.0


class ConstraintSet:
    """A working set, and what the solver has to know of it.

    Parameters
    ----------
    problem : TorqueProblem
    working : WorkingSet
    """

    def __init__(self, problem: TorqueProblem, working: WorkingSet) -> None:
        self.problem, self.working = problem, working
        self._sites: Sites | None = None
        self._sizes: dict[int, tuple[int, ...]] = {}
        self._were = len(working)

    def sites(self, splines: SparseSplines) -> Sites:
        """Where constraints are looked at now; the same object as long as there are no more of them."""
        if self._sites is None or self._sites.sizes != self.working.sizes:
            self._sites = Sites(self.working, splines)
            # Between two thinnings their number tells which ones there were.
            self._sizes[sum(self._sites.sizes)] = self._sites.sizes
        return self._sites

    def look(self, trajectory: QuinticTrajectory, bound: float) -> Violation:
        """Add what a trajectory violates, with the scaled torque compared with `bound`."""
        tolerance = self.problem.options.constraint_tolerance
        return self.working.add_violated(trajectory, bound, tolerance, 1, _MOST)[1]

    def lifted(self, multipliers: FloatArray) -> FloatArray:
        """Multipliers of the constraints that are known now from those of fewer, known some time before."""
        now = self.working.sizes
        before = self._sizes.get(len(multipliers), (0,) * len(now))
        parts = np.split(multipliers, np.cumsum(before)[:-1])
        return np.concatenate(
            [np.append(part, np.zeros(size - len(part))) for part, size in zip(parts, now, strict=True)]
        )

    def needed(self, sites: Sites, value: FloatArray, multipliers: FloatArray) -> BoolArray | None:
        """Forget constraints that do not matter where they have become many.

        Parameters
        ----------
        sites : Sites
            All that are known now.
        value, multipliers : (K,)

        Returns
        -------
        (K,) or None
            Which are left; None when all are.
        """
        if len(value) < _MANY * self._were + _MORE:
            return None
        kind, times, component = sites.kind, np.concatenate(sites.times), np.concatenate(sites.component)
        window = np.floor(times / (_WINDOW * (self.problem.grid[1] - self.problem.grid[0])))
        idle = multipliers <= _NEGLIGIBLE * multipliers.sum()
        # Those alike in kind, component and window side by side: with multipliers first, then the worst.
        order = np.lexsort((-value, idle, window, component, kind))
        alike = [np.diff(each[order], prepend=-1) == 0 for each in (window, component, kind)]
        needless = np.zeros(len(value), dtype=np.bool_)
        needless[order] = np.logical_and.reduce(alike)
        needless |= (value < _FAR) & (kind > 0)
        needless &= idle
        self.working.keep(~needless)
        self._were, self._sites = len(self.working), None
        return ~needless
