"""A promise of a plan, judged."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from cmbot.common.arrays import FloatArray
from cmbot.common.limit import Limit
from cmbot.common.reading.file_types import OrInfinite


@dataclass(frozen=True, kw_only=True)
class Check:
    """One promise of a plan: the worst value against its bound.

    Attributes
    ----------
    quantity : str
    time : float, s
        Where the worst value is.
    value, bound : float
        The value is not passed at any time; where interpolation leaves a remainder, it is included.
    unit : str
    at_least : bool
        The bound is a lower one.
    limit : Limit
        What the quantity is.
    joint : str
        Whose it is; empty where it is no joint's.
    """

    quantity: str
    time: float
    value: OrInfinite
    bound: OrInfinite
    unit: str
    at_least: bool = False
    limit: Limit = Limit.OTHER
    joint: str = ""

    @property
    def holds(self) -> bool:
        """Whether the value keeps its bound; never true of what is not a number, nor of endlessly much."""
        if self.at_least:
            return self.value >= self.bound
        return self.value <= self.bound and self.value < inf


def largest_check(quantity: str, times: FloatArray, value: FloatArray, bound: float, unit: str) -> Check:
    """Return the check of the largest of values (N,) at `times` (N,)."""
    worst = int(value.argmax())
    return Check(
        quantity=quantity, time=float(times[worst]), value=float(value[worst]), bound=bound, unit=unit
    )
