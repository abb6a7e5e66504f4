"""How the tool speeds up and slows down along a leg, in shares of its length and duration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError

__all__ = ["SpeedProfile"]


@dataclass(frozen=True, kw_only=True)
class SpeedProfile:
    """A speed profile from rest to rest, symmetric in time.

    Attributes
    ----------
    kind : str
        ``trapezoidal``: constant acceleration in the ramps, as in the paper.
        ``jerk_limited``: acceleration rises and falls linearly in the ramps, so jerk is bounded.
    ramp : float
        Share of the duration spent speeding up, and again slowing down, in (0, 0.5].

    Raises
    ------
    InputError
        When `kind` is unknown or `ramp` is out of range.
    """

    kind: Literal["trapezoidal", "jerk_limited"] = "trapezoidal"
    ramp: float = 0.2

    def __post_init__(self) -> None:
        if self.kind not in ("trapezoidal", "jerk_limited"):
            raise InputError("SpeedProfile", "kind", self.kind, "a kind", ("trapezoidal", "jerk_limited"))
        if not (isinstance(self.ramp, int | float) and 0 < self.ramp <= 0.5):
            raise InputError("SpeedProfile", "ramp", self.ramp, "a share in (0, 0.5]")

    def share(self, u: FloatArray) -> FloatArray:
        """Share of the length covered at share `u` of the duration, both in [0, 1]."""
        late = u > 0.5
        x = np.where(late, 1 - u, u)
        ramp = self.ramp * self._ramp_integral(np.minimum(x / self.ramp, 1.0))
        covered = (ramp + np.maximum(x - self.ramp, 0.0)) / (1 - self.ramp)
        return np.where(late, 1 - covered, covered)

    def rate(self, u: FloatArray) -> FloatArray:
        """Derivative of `share`: speed in units of length over duration."""
        x = np.minimum(np.minimum(u, 1 - u) / self.ramp, 1.0)
        return self._ramp(x) / (1 - self.ramp)

    def _ramp(self, x: FloatArray) -> FloatArray:
        """Share of the cruising speed reached at share x of a ramp."""
        if self.kind == "trapezoidal":
            return x
        return np.where(x < 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)

    def _ramp_integral(self, x: FloatArray) -> FloatArray:
        if self.kind == "trapezoidal":
            return x**2 / 2
        return np.where(x < 0.5, 2 * x**3 / 3, x - 0.5 + 2 * (1 - x) ** 3 / 3)
