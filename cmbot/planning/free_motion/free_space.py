"""Free space: postures within the joint ranges, clear of everything, and below a bound on their cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray, IntArray, read_only
from cmbot.robot import Robot

# Between two postures of a line that are checked no point of the arm moves further than this, m.
_CHECK_DISTANCE_M = 0.04
# Where the ends of a path spare less, this share of what they spare is required in between.
_MARGIN_SHARE_BETWEEN = 0.5
# The cost changes slowly: no point moves further than this between two postures where it is computed, m.
_COST_DISTANCE_M = 0.2
_NO_BOUND = float(np.finfo(np.float64).max)
# Postures of a line that are checked at once, in their order.
_BLOCKS = (0, 8), (8, 40), (40, 168), (168, 680), (680, None)


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Postures within the joint ranges whose shapes keep a margin, and whose cost is bounded.

    Attributes
    ----------
    robot : Robot
    clearances : Clearances
    margin : float
        Smallest distance between shapes, m.
    cost : callable
        From postures (N, n), rad, to values (N,), such as the torque at rest; infinite where the arm cannot
        rest.
    rests : callable, optional
        From postures (N, n) to whether the arm can rest there, (N,): where the cost is finite, found sooner.
    bound : float
        No posture's cost is above it.
    spare : float
        Kept beyond the margin, for the neighbours of a posture that is checked, m. With the default a line is
        free all along; with less only where it is checked, and a certificate has to cover the rest.
    """

    robot: Robot
    clearances: Clearances
    margin: float
    cost: Callable[[FloatArray], FloatArray]
    rests: Callable[[FloatArray], BoolArray] | None = None
    bound: float = _NO_BOUND
    spare: float = _CHECK_DISTANCE_M / 2

    def around(self, q: FloatArray) -> FreeSpace | None:
        """Return the space that spares at most what postures `q` (N, n) spare; None when one is not free.

        Links of some arms are always near each other and never spare much, there or elsewhere.
        """
        if not self.robot.limits.contain(q).all():
            return None
        left = float(self.clearances.query(q).distance.min()) - self.margin
        if left < 0:
            return None
        spared = self.clearances.always_near - self.margin
        left = min(left, float(spared[spared > 0].min(initial=np.inf)))
        return replace(self, spare=min(self.spare, _MARGIN_SHARE_BETWEEN * left))

    def below(self, bound: float) -> FreeSpace:
        """Return the postures whose cost is at most `bound`."""
        return replace(self, bound=bound)

    def _bears(self, q: FloatArray) -> BoolArray:
        """Whether the cost of postures `q` (N, n) is at most the bound."""
        if self.bound == _NO_BOUND and self.rests is not None:
            return self.rests(q)
        return np.asarray(self.cost(q) <= self.bound)

    def holds(self, q: FloatArray) -> BoolArray:
        """Which of the postures `q` (N, n) are free, and spare enough for their neighbours."""
        free = self.robot.limits.contain(q)
        free[free] = self._bears(q[free])
        least = self.margin + self.spare
        free[free] = self.clearances.query(q[free], least).distance >= least
        return free

    def straight(self, start: FloatArray, end: FloatArray) -> bool:
        """Whether the postures checked on the line between two postures (n,) are free."""
        postures = self._along(start[None], end[None], _CHECK_DISTANCE_M)[0]
        # What costs least to find out comes first: what feet bear takes ten times as long as a clearance.
        bears_first = self.robot.holding is None or not self.robot.holding.bounded
        if not self.robot.limits.contain(postures).all() or (bears_first and not self._bears(postures).all()):
            return False
        # Scattered over the line first: what is in the way is found by few of them.
        postures, least = postures[_scattered(len(postures))], self.margin + self.spare
        blocks = (postures[first:end] for first, end in _BLOCKS if first < len(postures))
        clear = all((self.clearances.query(block, least).distance >= least).all() for block in blocks)
        return clear and (bears_first or bool(self._bears(postures).all()))

    def _along(self, starts: FloatArray, ends: FloatArray, every: float) -> tuple[FloatArray, IntArray]:
        """Postures (M, n) on lines between postures (k, n), without the starts, and their lines (M,)."""
        moved = np.abs(ends - starts) @ self.clearances.reach
        number = np.maximum(np.ceil(moved / every).astype(np.intp), 1)
        line = np.repeat(np.arange(len(starts)), number)
        step = np.arange(1, len(line) + 1) - np.repeat(np.cumsum(number) - number, number)
        share = (step / number[line])[:, None]
        return starts[line] + share * (ends - starts)[line], line

    def highest(self, starts: FloatArray, ends: FloatArray) -> FloatArray:
        """Return the largest cost (k,) on each of the lines between postures (k, n)."""
        postures, line = self._along(starts, ends, _COST_DISTANCE_M)
        highest = self.cost(starts)
        np.maximum.at(highest, line, self.cost(postures))
        return highest

    def peak(self, path: FloatArray) -> float:
        """Return the largest cost on a broken line (k, n)."""
        return float(self.highest(path[:-1], path[1:]).max())

    def shorten(self, path: FloatArray, tries: int = 150) -> FloatArray:
        """Cut corners of a broken line (k, n) where the straight line is free."""
        rng, left, blocked = np.random.default_rng(0), list(range(len(path))), set[tuple[int, int]]()
        for _ in range(tries):
            if len(left) < 3:
                break
            first, second = np.sort(rng.choice(len(left), 2, replace=False)).tolist()
            corner = left[first], left[second]
            if second - first < 2 or corner in blocked:
                continue
            if self.straight(*path[list(corner)]):
                del left[first + 1 : second]
            else:
                blocked.add(corner)
        return path[left]


@lru_cache(maxsize=256)
def _scattered(number: int) -> IntArray:
    """Indices 0 to `number` - 1, in an order in which the first ones are spread evenly: bits reversed."""
    bits = max((number - 1).bit_length(), 1)
    indices = np.arange(1 << bits)
    reversed_bits = np.zeros_like(indices)
    for bit in range(bits):
        reversed_bits |= ((indices >> bit) & 1) << (bits - 1 - bit)
    return read_only(reversed_bits[reversed_bits < number])
