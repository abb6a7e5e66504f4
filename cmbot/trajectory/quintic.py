"""The trajectory: piecewise quintic polynomials in every joint (Chang 2021, Eqs. (24)-(29))."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cmbot.common.arrays import FloatArray, IntArray, read_only
from cmbot.common.errors import InputError
from cmbot.common.reading.file_types import Row, Rows
from cmbot.common.representation import ShortRepr
from cmbot.trajectory.polynomials import derivative, hull, roots_in_unit_interval, values

# By how much times may miss the ends, as a share of the duration: they come from sums of steps.
_TIME_ROUNDING = 1e-9
# So many times are evaluated at once: more only ask for memory, and lose its nearness.
_TIMES_PER_BLOCK = 2048

LARGEST = 1e12
"""No time, position, velocity or acceleration is larger in magnitude: nothing made of them overflows."""
# Knots are no nearer to each other, s, for the same reason.
_MIN_KNOT_INTERVAL_S = 1e-9

POSITION, VELOCITY, ACCELERATION, JERK = range(4)

SAMPLE_STEP = 0.01
"""Step of the sampled motions, s; of long ones it is longer: `sample_step`."""
# Steps of a motion at most; steps grow by these factors.
_MAX_MOTION_STEPS, _LONGER = 40_000, (1.0, 2.0, 5.0)


def sample_step(duration: float, step: float = SAMPLE_STEP) -> float:
    """Return the step, s, by which a motion of a duration, s, is sampled: the number of steps is bounded.

    That is `step`, or it times 2, 5, 10, 20 and so on.
    """
    power = 1.0
    while True:
        for factor in _LONGER:
            if duration <= _MAX_MOTION_STEPS * step * factor * power:
                return step * factor * power
        power *= 10.0


def hermite_coefficients(
    h: FloatArray, start: tuple[FloatArray, ...], end: tuple[FloatArray, ...]
) -> FloatArray:
    """Coefficients (m, n, 6) of quintics from position, velocity and acceleration (m, n) at both ends.

    Chang 2021, Eqs. (28)-(29), with time counted in units of the segment's duration `h` (m,), s:
    ``q(t) = sum_k c_k (t/h)^k``.
    """
    h = h[:, None]
    q_0, v_0, a_0 = start[0], start[1] * h, start[2] * h**2
    q_1, v_1, a_1 = end[0], end[1] * h, end[2] * h**2
    D = q_1 - q_0
    return np.stack(
        [
            q_0,
            v_0,
            a_0 / 2,
            (20 * D - (8 * v_1 + 12 * v_0) - (3 * a_0 - a_1)) / 2,
            (-30 * D + (14 * v_1 + 16 * v_0) + (3 * a_0 - 2 * a_1)) / 2,
            (12 * D - 6 * (v_1 + v_0) - (a_0 - a_1)) / 2,
        ],
        axis=-1,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Extrema:
    """The exact extremes of one derivative on every segment of a trajectory.

    Attributes
    ----------
    time : (m, n, k), s, or (..., k)
        Ends and stationary points of each segment and joint.
    value : (m, n, k), or (..., k)
        The derivative there; its largest magnitude bounds it at *all* times of the segment.
    """

    time: FloatArray
    value: FloatArray

    def largest(self) -> tuple[FloatArray, FloatArray]:
        """Return magnitude and time of the largest magnitude of each joint, both (n,)."""
        magnitude = np.abs(self.value).transpose(1, 0, 2).reshape(self.value.shape[1], -1)
        time = self.time.transpose(1, 0, 2).reshape(self.value.shape[1], -1)
        worst = magnitude.argmax(axis=1)
        joint = np.arange(len(worst))
        return magnitude[joint, worst], time[joint, worst]


@dataclass(frozen=True, kw_only=True, eq=False)
class QuinticTrajectory(ShortRepr):
    """Piecewise quintics through knots with given position, velocity and acceleration.

    Position, velocity and acceleration are continuous whatever the knots' values are; jerk is continuous
    only if they are chosen so, as `SplineSpace` does.

    Attributes
    ----------
    t : (m + 1,), s
        Strictly increasing times of the knots.
    q, v, a : (m + 1, n), rad, rad/s, rad/s2
        Position, velocity and acceleration at the knots.

    Raises
    ------
    InputError
        When shapes differ, a number is not finite or beyond `LARGEST`, or times do not increase.
    """

    t: Row
    q: Rows
    v: Rows
    a: Rows

    def __post_init__(self) -> None:
        for name in ("t", "q", "v", "a"):
            object.__setattr__(self, name, read_only(np.array(getattr(self, name), dtype=float)))
        increases = self.t.ndim == 1 and len(self.t) >= 2 and np.all(np.diff(self.t) >= _MIN_KNOT_INTERVAL_S)
        if not increases or not (np.abs(self.t) <= LARGEST).all():
            expected = f"two or more finite, increasing times, {_MIN_KNOT_INTERVAL_S:g} s or more apart"
            raise InputError("QuinticTrajectory", "t", self.t.tolist(), expected)
        for name in ("q", "v", "a"):
            array = getattr(self, name)
            if array.ndim != 2 or array.shape != (len(self.t), self.q.shape[-1]):
                expected = f"one row per knot, ({len(self.t)}, n), the same for q, v and a"
                raise InputError("QuinticTrajectory", name, f"shape {array.shape}", expected)
            if not (np.abs(array) <= LARGEST).all():
                got = "a number that is too large or none"
                raise InputError("QuinticTrajectory", name, got, f"finite numbers of at most {LARGEST:g}")

    @classmethod
    def through(cls, t: FloatArray, q: FloatArray, rates: FloatArray | None = None) -> QuinticTrajectory:
        """Return the cubic spline through positions, whose velocity and acceleration are continuous.

        Parameters
        ----------
        t : (m + 1,), s
        q : (m + 1, n), rad
        rates : (2, n), rad/s, optional
            At both ends; left out: it rests there.

        Raises
        ------
        InputError
            When shapes differ, a number is not finite or beyond `LARGEST`, or times do not increase.
        """
        # It is slow to import.
        from scipy.interpolate import CubicSpline

        still = np.zeros_like(q)
        known = cls(t=t, q=q, v=still, a=still)
        begin, end = still[:2] if rates is None else rates
        curve = CubicSpline(known.t, known.q, bc_type=((1, begin), (1, end)))
        # A cubic is a quintic.
        return cls(t=t, q=q, v=curve(t, 1), a=curve(t, 2))

    @classmethod
    def held(cls, q: FloatArray, seconds: float) -> QuinticTrajectory:
        """Return what holds the joints at `q` (n,), rad, for some seconds."""
        still = np.zeros((2, len(q)))
        return cls(t=np.array([0.0, seconds]), q=still + q, v=still, a=still)

    @classmethod
    def joined(cls, parts: Sequence[QuinticTrajectory]) -> QuinticTrajectory:
        """Return motions that follow on each other as one; the knot at a join is the one before it."""
        first, *others = parts

        def all_of(name: str) -> FloatArray:
            return np.concatenate([getattr(first, name), *(getattr(each, name)[1:] for each in others)])

        return cls(t=all_of("t"), q=all_of("q"), v=all_of("v"), a=all_of("a"))

    def standing(self, begin: float, end: float) -> QuinticTrajectory:
        """Return a motion from rest to rest with the joints held before it, from `begin`, and after it, s."""
        before, after = int(begin < self.t[0]), int(end > self.t[-1])
        t = np.concatenate([[begin] * before, self.t, [end] * after])
        q, v, a = (np.pad(x, ((before, after), (0, 0)), "edge") for x in (self.q, self.v, self.a))
        return QuinticTrajectory(t=t, q=q, v=v, a=a)

    def begun_at(self, q: FloatArray) -> QuinticTrajectory:
        """Return the motion moved as a whole so that it begins at `q` (n,), rad, exactly."""
        return replace(self, q=np.vstack([q, self.q[1:] + (q - self.q[0])]))

    @property
    def duration(self) -> float:
        """Time from the first knot to the last, s."""
        return float(self.t[-1] - self.t[0])

    @cached_property
    def coefficients(self) -> FloatArray:
        """Coefficients of ``q(t) = sum_k c_k ((t - t_j)/h_j)^k``, (m, n, 6), rad."""
        knots = (self.q, self.v, self.a)
        start, end = tuple(x[:-1] for x in knots), tuple(x[1:] for x in knots)
        return read_only(hermite_coefficients(np.diff(self.t), start, end))

    def evaluate(self, times: ArrayLike, order: int = 0) -> FloatArray:
        """Evaluate the trajectory or one of its derivatives.

        Parameters
        ----------
        times : (N,), s
            From the first knot to the last; beyond them by no more than rounding.
        order : int
            0 position, 1 velocity, 2 acceleration, 3 jerk, up to 5. At an inner knot a discontinuous
            derivative has the value of the later segment.

        Returns
        -------
        (N, n)

        Raises
        ------
        InputError
            When a time is no number, or not one of the trajectory's.
        """
        return self.derivatives(times, (order,))[0]

    def derivatives(self, times: ArrayLike, orders: tuple[int, ...]) -> tuple[FloatArray, ...]:
        """Evaluate derivatives of several `orders` at the same `times` (N,): as many arrays (N, n).

        Raises
        ------
        InputError
            When a time is no number, or not one of the trajectory's.
        """
        t = self._own(_numbers(times))
        segment = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        h = self.t[segment + 1] - self.t[segment]
        u = (t - self.t[segment]) / h
        each = tuple(np.empty((len(t), self.q.shape[1])) for _ in orders)
        for first in range(0, len(t), _TIMES_PER_BLOCK):
            block = slice(first, first + _TIMES_PER_BLOCK)
            c = self.coefficients[segment[block]]
            for order, out in zip(orders, each, strict=True):
                here = values(derivative(c, order), u[block, None, None])[..., 0]
                out[block] = here / h[block, None] ** order
        return each

    def _own(self, t: FloatArray) -> FloatArray:
        """Return times (N,) when they are the trajectory's, rounding at its ends taken off."""
        slack = _TIME_ROUNDING * self.duration
        # In this form NaN counts as outside.
        outside = ~((self.t[0] - slack <= t) & (t <= self.t[-1] + slack))
        if outside.any():
            expected = f"times from {self.t[0]:g} to {self.t[-1]:g} s"
            raise InputError("QuinticTrajectory", "times", f"{t[outside][0]:g} s", expected)
        return np.clip(t, self.t[0], self.t[-1])

    def states(self, times: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration at `times` (N,), each (N, n)."""
        q, v, a = self.derivatives(times, (POSITION, VELOCITY, ACCELERATION))
        return q, v, a

    def sampled(self, samples: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what `states` does at so many even times of every segment, from its start, and at the last.

        Quicker: all segments are weighed alike.
        """
        powers = (np.arange(samples)[:, None] / samples) ** np.arange(6)
        by_power = self.coefficients.transpose(0, 2, 1)
        h, ends = np.diff(self.t)[:, None, None], (self.q[-1], self.v[-1], self.a[-1])
        each = []
        for order, end in enumerate(ends):
            weight = derivative(np.eye(6), order).T
            inside = powers[:, : len(weight)] @ weight @ by_power / h**order
            each.append(np.vstack([inside.reshape(-1, len(end)), end]))
        q, v, a = each
        return q, v, a

    def extrema(self, order: int) -> Extrema:
        """Return the exact extremes of derivative `order` (0 to 4) on every segment and joint."""
        every = np.indices(self.coefficients.shape[:2])
        return self.extrema_at(order, np.asarray(every[0]), np.asarray(every[1]))

    def extrema_at(self, order: int, segment: IntArray, joint: IntArray) -> Extrema:
        """Return the exact extremes of derivative `order` (0 to 4) on some segments (...) of joints (...)."""
        h = (self.t[segment + 1] - self.t[segment])[..., None]
        c = derivative(self.coefficients[segment, joint], order)
        u = roots_in_unit_interval(derivative(c))
        u = np.concatenate([np.zeros_like(u[..., :1]), u, np.ones_like(u[..., :1])], axis=-1)
        return Extrema(time=self.t[segment][..., None] + u * h, value=values(c, u) / h**order)

    def hull(self, order: int) -> tuple[FloatArray, FloatArray]:
        """Return bounds (m, n) below and above derivative `order` on every segment; not exact ones."""
        h = np.diff(self.t)[:, None]
        low, high = hull(derivative(self.coefficients, order))
        return low / h**order, high / h**order

    def jumps(self, order: int) -> FloatArray:
        """Return how far derivative `order` jumps at each inner knot, (m - 1, n)."""
        h = np.diff(self.t)[:, None]
        c = derivative(self.coefficients, order)
        return np.asarray(c[1:, :, 0] / h[1:] ** order - c[:-1].sum(axis=-1) / h[:-1] ** order)


def _numbers(times: ArrayLike) -> FloatArray:
    try:
        t = np.asarray(times, dtype=np.float64)
    except (TypeError, ValueError):
        t = None
    if t is None or t.ndim != 1:
        one = "" if t is None or t.ndim else f": [{times!r}]"
        raise InputError("QuinticTrajectory", "times", repr(times), f"a row of numbers, s{one}")
    return t
