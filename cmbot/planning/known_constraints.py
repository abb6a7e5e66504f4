"""The working set while the sparse solver steps: it grows where steps lead, and is thinned where they led."""

from __future__ import annotations

import numpy as np

from cmbot.arrays import FloatArray, IntArray
from cmbot.planning.problem import TorqueProblem
from cmbot.planning.sparse_family import LocalKnots
from cmbot.planning.state_functions import ToolDeviation
from cmbot.planning.working_set import Violation, WorkingSet

__all__ = ["KnownConstraints"]


# At most so many sites of a constraint are added for a step: the worst, which usually hold the others.
_MOST = 40
# Once there are so many times as many constraints as there were, and a few more, some are forgotten.
_MANY, _MORE = 1.2, 50
# Those without a multiplier, as a share of all: the ones this far from their bounds, as shares of these, and
# all but the worst within so many grid steps.
_NEGLIGIBLE, _FAR, _WINDOW = 1e-6, -0.5, 2.0


class KnownConstraints:
    """A working set, and what the solver has to know of it.

    Parameters
    ----------
    problem : TorqueProblem
    working : WorkingSet
    """

    def __init__(self, problem: TorqueProblem, working: WorkingSet) -> None:
        self.problem, self.working = problem, working
        self.stride = 1
        """Every which sample a step is looked at."""
        self._sizes: dict[int, tuple[int, ...]] = {}
        self._were = len(working)

    def count(self) -> int:
        """Number of constraints."""
        sizes = self.working.sizes
        # Between two thinnings their number tells which ones there were.
        self._sizes[sum(sizes)] = sizes
        return sum(sizes)

    def kinds(self, faces: int) -> tuple[IntArray, IntArray]:
        """What kind of constraint each one is, and each of so many `faces`."""
        sizes = self.working.sizes
        deviation = [isinstance(function, ToolDeviation) for function, _, _ in self.working.state_sites()]
        return np.repeat(np.arange(len(sizes)), sizes), np.full(faces, np.argmax(deviation))

    def look(self, family: LocalKnots, bound: float) -> Violation:
        """Add what a spline violates, with the scaled torque compared with `bound`."""
        trajectory = self.problem.trajectory(family, family.start)
        tolerance = self.problem.options.constraint_tolerance
        return self.working.add_violated(trajectory, bound, tolerance, self.stride, _MOST)[1]

    def lifted(self, multipliers: FloatArray) -> FloatArray:
        """Multipliers of the constraints that are known now from those of fewer, known some time before."""
        self.count()
        now = self.working.sizes
        before = self._sizes.get(len(multipliers), (0,) * len(now))
        parts = np.split(multipliers, np.cumsum(before)[:-1])
        return np.concatenate(
            [np.append(part, np.zeros(size - len(part))) for part, size in zip(parts, now, strict=True)]
        )

    def thinned(self, value: FloatArray, multipliers: FloatArray) -> FloatArray:
        """Forget constraints that do not matter where they have become many; return the multipliers left.

        Parameters
        ----------
        value, multipliers : (K,)
        """
        if self.count() < _MANY * self._were + _MORE:
            return multipliers
        sites = [*self.working.state_sites(), *self.working.bound_sites()]
        kind = self.kinds(0)[0]
        times, component = (np.concatenate([each[part] for each in sites]) for part in (1, 2))
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
        self._were = self.count()
        return multipliers[~needless]
