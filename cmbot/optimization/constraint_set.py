"""The constraints that a solver works with: of infinitely many those at a few times."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import OptimisationFailed
from cmbot.common.limit import Limit

OBJECTIVE = 0
"""Family of the objective; behind it come the program's constraints, then its bounds."""

# Constraints nearer than this share of a sampling step are the same; sharpened, this share of that.
_SAME_TIME_SHARE, _SHARPER = 0.005, 0.1
# A set that has grown by this factor and a few more drops constraints: those without a multiplier (as a share
# of all) that are this far from their bounds, and all but the worst within so many sampling steps.
_PRUNING_GROWTH, _PRUNING_MARGIN = 1.2, 50
_NEGLIGIBLE, _INACTIVE_VALUE, _WINDOW = 1e-6, -0.5, 2.0


@dataclass(frozen=True)
class Violation:
    """The constraint that is violated most, as a share of its bound, and when, s; None: nowhere."""

    name: str
    value: float
    limit: Limit = Limit.OTHER
    time: float | None = None

    def failure(self, reason: str, *, trajectory: object = None, stopped: bool = False) -> OptimisationFailed:
        """Return the error for a reason that this is the worst constraint of a trajectory."""
        return OptimisationFailed(
            reason,
            constraint=self.name,
            violation=self.value,
            limit=self.limit,
            time=self.time,
            trajectory=trajectory,
            stopped=stopped,
        )


def _none() -> IntArray:
    return np.empty(0, dtype=np.intp)


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstraintSet:
    """Which component of which family of constraints has to hold at which time: K of them.

    A set never changes. What `extended` returns has the constraints that were there first, in the same order,
    so values and multipliers of the old set are the first ones of the new one.

    Attributes
    ----------
    step : float, s
        Sampling step of the program.
    family, component : (K,)
    time : (K,), s
    """

    step: float
    family: IntArray = field(default_factory=_none)
    component: IntArray = field(default_factory=_none)
    time: FloatArray = field(default_factory=lambda: np.empty(0))
    _same: float = _SAME_TIME_SHARE
    _base: int = 0

    def __len__(self) -> int:
        return len(self.time)

    def extended(self, family: IntArray, component: IntArray, time: FloatArray) -> ConstraintSet:
        """Add the constraints that are not there yet; the same object where all are."""
        new = ~self._known(family, component, time)
        if not new.any():
            return self
        return replace(
            self,
            family=np.append(self.family, family[new]),
            component=np.append(self.component, component[new]),
            time=np.append(self.time, time[new]),
        )

    def at_all(self, families: list[int], times: FloatArray) -> ConstraintSet:
        """Add component 0 of some families at `times` (N,)."""
        family = np.repeat(np.asarray(families, dtype=np.intp), len(times))
        return self.extended(family, np.zeros_like(family), np.tile(times, len(families)))

    def sharpened(self) -> ConstraintSet:
        """Tell constraints apart from now on that are nearer to each other than before."""
        return replace(self, _same=_SHARPER * self._same)

    def rebased(self) -> ConstraintSet:
        """Count growth from here."""
        return replace(self, _base=len(self))

    def kept(self, which: BoolArray) -> ConstraintSet:
        """Return those of the K constraints that `which` names."""
        return replace(
            self,
            family=self.family[which],
            component=self.component[which],
            time=self.time[which],
            _base=int(which.sum()),
        )

    def needed(self, value: FloatArray, multipliers: FloatArray) -> BoolArray:
        """Which constraints (K,) matter, by their values and multipliers (K,); all while the set is small."""
        if len(self) < _PRUNING_GROWTH * self._base + _PRUNING_MARGIN:
            return np.ones(len(self), dtype=np.bool_)
        window = np.floor(self.time / (_WINDOW * self.step))
        idle = multipliers <= _NEGLIGIBLE * multipliers.sum()
        # Those alike in family, component and window side by side: with multipliers first, then the worst.
        order = np.lexsort((-value, idle, window, self.component, self.family))
        alike = [np.diff(each[order], prepend=-1) == 0 for each in (window, self.component, self.family)]
        needless = np.zeros(len(value), dtype=np.bool_)
        needless[order] = np.logical_and.reduce(alike)
        needless |= (value < _INACTIVE_VALUE) & (self.family != OBJECTIVE)
        return np.asarray(~(needless & idle))

    def _known(self, family: IntArray, component: IntArray, time: FloatArray) -> BoolArray:
        """Which of some constraints are nearly in time, and otherwise exactly, one of the set."""
        if len(self) == 0 or len(time) == 0:
            return np.zeros(len(time), dtype=np.bool_)
        within = self._same * self.step
        # Components one after the other, families too, as if they were later times.
        width = 1 + max(int(self.component.max()), int(component.max()))
        far = 3.0 * max(float(np.abs(self.time).max()), float(np.abs(time).max()), within)
        known = np.sort(self.time + far * (width * self.family + self.component))
        new = time + far * (width * family + component)
        after = np.searchsorted(known, new)
        before = np.abs(new - known[np.maximum(after - 1, 0)])
        return np.asarray(np.minimum(before, np.abs(new - known[np.minimum(after, len(known) - 1)])) < within)
