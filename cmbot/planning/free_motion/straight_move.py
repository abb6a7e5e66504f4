"""The quickest straight motion in joint space within the limits of velocity, acceleration and jerk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.robot import JointLimits


def quickest_straight(
    limits: JointLimits, start: FloatArray, end: FloatArray, step: float, stands: Sequence[float] = (0.0, 0.0)
) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Return the quickest motion from rest to rest on the straight line between two postures.

    The joint that uses most of a bound decides; torques, ranges and collisions are ignored. Its jerk jumps
    between its bounds and zero: of all such motions none is quicker, but no spline of ours follows it.

    Parameters
    ----------
    limits : JointLimits
    start, end : (n,), rad, of joints that slide m
        Two different postures.
    step : float, s
        Between samples; the last one may be shorter.
    stands : (2,), s
        How long the arm stands before, and after it.

    Returns
    -------
    (N,), s, and four arrays (N, n)
        Times from 0; position, velocity, acceleration and jerk.
    """
    way = end - start
    moves = way != 0
    velocity, acceleration, jerk = (
        float((bound[moves] / np.abs(way[moves])).min())
        for bound in (limits.velocity, limits.acceleration, limits.jerk)
    )
    durations, jerks = _phases(velocity, acceleration, jerk)
    ends = np.cumsum(durations)
    t = np.append(np.arange(0.0, ends[-1] - 1e-9, step), ends[-1])
    s = _integrated(t, durations, jerks)
    # Rounding of the sums.
    s[0] /= s[0, -1]
    before, after = (np.linspace(0.0, x, int(np.ceil(x / step - 1e-9)) + 1) for x in stands)
    t = np.concatenate([before[:-1], before[-1] + t, before[-1] + t[-1] + after[1:]])
    s = np.pad(s, ((0, 0), (len(before) - 1, len(after) - 1)))
    s[0, len(t) - len(after) + 1 :] = 1.0
    q, v, a, j = (x[:, None] * way for x in s)
    return t, (start + q, v, a, j)


def _phases(v: float, a: float, j: float) -> tuple[FloatArray, FloatArray]:
    """Durations (7,), s, and jerks (7,) of the quickest way from 0 to 1 at rest at both ends."""
    # Up to the largest acceleration, or to the largest velocity before that.
    rise = min(a / j, np.sqrt(v / j))
    ramp = rise + v / (j * rise)
    if v * ramp > 1.0:
        # The largest velocity is not reached.
        rise = min(a / j, np.cbrt(0.5 / j))
        ramp = 0.5 * rise + np.sqrt(0.25 * rise**2 + 1.0 / (j * rise))
        cruise = 0.0
    else:
        cruise = 1.0 / v - ramp
    level = max(ramp - 2 * rise, 0.0)
    durations = np.array([rise, level, rise, cruise, rise, level, rise])
    return durations, j * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])


def _integrated(t: FloatArray, durations: FloatArray, jerks: FloatArray) -> FloatArray:
    """Share of the way, and its derivatives up to the third, (4, N), at times `t` (N,)."""
    s = np.zeros((4, len(t)))
    begin, state = 0.0, np.zeros(3)
    for duration, jerk in zip(durations, jerks, strict=True):
        here = (t >= begin) & (t <= begin + duration)
        s[:, here] = _at_constant_jerk(state, jerk, t[here] - begin)
        state = _at_constant_jerk(state, jerk, np.array([duration]))[:3, 0]
        begin += duration
    return s


def _at_constant_jerk(state: FloatArray, jerk: float, x: FloatArray) -> FloatArray:
    """Position, velocity, acceleration and jerk (4, N), `x` (N,) s after the first three were `state`."""
    position, velocity, acceleration = state
    return np.stack(
        [
            position + x * (velocity + x * (acceleration / 2 + x * jerk / 6)),
            velocity + x * (acceleration + x * jerk / 2),
            acceleration + x * jerk,
            np.full_like(x, jerk),
        ]
    )
