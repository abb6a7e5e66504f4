"""Input shapers: impulses that a motion is convolved with, so that a mode is hardly excited.

Extra-insensitive shapers (Singhose, Seering and Singer, 1994): they leave a small share of a mode's vibration
at its modelled frequency, and no more within an interval about it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray

LEFT = 0.05
"""Share of the vibration that shapers leave at most, in their intervals of frequency."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shaper:
    """Impulses.

    Attributes
    ----------
    amplitudes : (K,)
        All positive; their sum is one.
    delays : (K,), s
        Ascending, the first is 0.
    """

    amplitudes: FloatArray
    delays: FloatArray

    @property
    def duration(self) -> float:
        """By how much a motion becomes longer, s."""
        return float(self.delays[-1])

    def then(self, other: Shaper) -> Shaper:
        """Return the shaper of two in a row, for two modes."""
        amplitudes = np.multiply.outer(self.amplitudes, other.amplitudes).ravel()
        delays = np.add.outer(self.delays, other.delays).ravel()
        order = np.argsort(delays, kind="stable")
        return Shaper(amplitudes=amplitudes[order], delays=delays[order])

    def residual(self, omega: FloatArray, damping: float) -> FloatArray:
        """Return the shares (N,) of the vibration of modes that are left after the last impulse.

        Parameters
        ----------
        omega : (N,), rad/s
            Undamped angular frequencies.
        damping : float
            Damping ratio.
        """
        decay = damping * np.asarray(omega)[:, None]
        turn = np.asarray(omega)[:, None] * np.sqrt(1 - damping**2)
        sums = (self.amplitudes * np.exp((decay + 1j * turn) * self.delays)).sum(axis=1)
        return np.asarray(np.abs(sums) * np.exp(-decay[:, 0] * self.duration))


def extra_insensitive(omega: float, damping: float) -> Shaper:
    """Return the EI shaper of a mode: one period long, within 20 % of its frequency.

    Parameters
    ----------
    omega : float
        Undamped angular frequency, rad/s.
    damping : float
        Damping ratio.
    """
    return _of_half_periods(np.array([(1 + LEFT) / 4, (1 - LEFT) / 2, (1 + LEFT) / 4]), omega, damping)


def two_hump(omega: float, damping: float) -> Shaper:
    """Return the two-hump EI shaper of a mode: one and a half periods long, within 36 % of its frequency."""
    x = np.cbrt(LEFT**2 * (np.sqrt(1 - LEFT**2) + 1))
    first = (3 * x**2 + 2 * x + 3 * LEFT**2) / (16 * x)
    return _of_half_periods(np.array([first, 0.5 - first, 0.5 - first, first]), omega, damping)


def _of_half_periods(undamped: FloatArray, omega: float, damping: float) -> Shaper:
    """Impulses half a damped period apart: those without damping, by whose decay each one is smaller."""
    root = np.sqrt(1 - damping**2)
    count = np.arange(len(undamped))
    amplitudes = undamped * np.exp(-damping * np.pi / root) ** count
    return Shaper(amplitudes=amplitudes / amplitudes.sum(), delays=count * np.pi / (omega * root))
