"""Clearances along trajectories that are much like each other, looked at only where they may be small.

No distance changes faster than the joints move times their reach. So what was measured bounds what is near it
in time, and what was measured along one trajectory bounds what is there along the next.
"""

from __future__ import annotations

import numpy as np

from cmbot.collision import raise_bounds, travel
from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.torque.constraints import ClearanceMargin, StateSamples

__all__ = ["ClearanceLooks"]

# Samples from one that is measured to the next, from coarse to fine.
_STRIDES = (16, 4, 1)


class ClearanceLooks:
    """Values of a clearance constraint at the samples of one trajectory after another.

    Parameters
    ----------
    margin : ClearanceMargin
    samples : int
        Number N of samples, whose times stay.
    joints : int
    """

    def __init__(self, margin: ClearanceMargin, samples: int, joints: int) -> None:
        self._margin = margin
        # Postures at the samples, and what the smallest distance is not below in them: nothing is known yet.
        self._q = np.zeros((samples, joints))
        self._at_least = np.full(samples, -np.inf)

    def values(self, states: StateSamples, stride: int, matters: float) -> tuple[FloatArray, IntArray]:
        """Return values (N', 1) at every so-manieth sample, and the nearest pairs (N', 1).

        What certainly does not exceed `matters` need not be measured; its value is minus infinity then. But
        what is beside a value that exceeds it is measured, too.

        Parameters
        ----------
        states : StateSamples
            At those samples.
        stride : int
        matters : float
        """
        margin, reach = self._margin, self._margin.clearances.reach
        some = slice(None, None, stride)
        distance = self._at_least[some] - np.abs(states.q - self._q[some]) @ reach
        pair = np.full(len(distance), -1, dtype=np.intp)
        measured = np.zeros(len(distance), dtype=np.bool_)

        def measure(which: BoolArray) -> None:
            here = np.flatnonzero(which & ~measured)
            smallest = margin.clearances.smallest(states.q[here])
            distance[here], pair[here], measured[here] = smallest.distance, smallest.pair, True

        near = margin.margin - margin.scale * matters
        covered = travel(states.q, reach)
        for every in _STRIDES:
            # Not "<=": what is no number is measured, too.
            measure(~(distance > near) & (np.arange(len(distance)) % every == 0))
            raise_bounds(distance, measured, covered)
        wanted = ~(distance > near)
        measure(wanted | np.append(wanted[1:], False) | np.append(False, wanted[:-1]))
        self._q[some], self._at_least[some] = states.q, distance
        value = np.where(measured, (margin.margin - distance) / margin.scale, -np.inf)
        return value[:, None], pair[:, None]
