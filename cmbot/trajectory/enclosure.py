"""Enclosures: bounds at all times of functions of a trajectory's state, by Chebyshev interpolation.

On every piece of a trajectory a function is interpolated at Chebyshev points. What the interpolant misses is
bounded by how large the function is on a Bernstein ellipse around the piece (Trefethen, "Approximation Theory
and Approximation Practice", 2013, Theorem 8.2). The interpolant lies in the convex hull of its Bernstein
coefficients, so a convex function of it is nowhere larger than at the largest of these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import comb, lcm

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.trajectory.polynomials import halves
from cmbot.trajectory.quintic import QuinticTrajectory

DEGREE = 12
"""Of the interpolants."""

_CHEBYSHEV_POINTS = np.cos(np.pi * np.arange(DEGREE, -1, -1) / DEGREE)
# Sums rho of a Bernstein ellipse's half-axes, from which the best remainder is taken.
_ELLIPSE_SUMS = np.geomspace(1.5, 1024.0, 17)
# Degree of a joint's position in time, and rounding of its Chebyshev coefficients as a share of the largest.
_POSITION_DEGREE, _COEFFICIENT_ROUNDING = 5, 1e-14
# How often pieces are halved at most, once for the remainder and once for the hull.
_MAX_PIECE_HALVINGS = 40
# Pieces that are halved at once at most: more are only asked for where a resolution is below the rounding.
_MAX_PIECES = 20_000
# Pieces are cut in four or eight at once, into as many at most, where a call of a function costs as much as
# many of its values.
_CUT_AT_ONCE = 400
# A piece is halved further only while its own hull is wider than this share of what is asked for.
_MIN_HULL_SHARE = 0.3


def _to_chebyshev() -> FloatArray:
    """Matrix (d + 1, d + 1) from values at the points to Chebyshev coefficients."""
    k = np.arange(DEGREE + 1)
    matrix = np.cos(np.pi * np.outer(k, DEGREE - k) / DEGREE) * (2.0 / DEGREE)
    matrix[:, [0, -1]] /= 2
    matrix[[0, -1]] /= 2
    return matrix


def _to_bernstein() -> FloatArray:
    """Matrix (d + 1, d + 1) from values at the points to Bernstein coefficients on the piece.

    From the Chebyshev polynomials' own: those have whole coefficients, so that none of their digits is lost.
    """
    power = [[1], [-1, 2]]  # of T_k at 2 u - 1, by powers of u
    for _ in range(DEGREE - 1):
        last, before = power[-1], power[-2]
        double = [0, *(4 * c for c in last)]
        same = [-2 * c for c in last] + [0]
        older = before + [0] * (len(double) - len(before))
        power.append([a + b - c for a, b, c in zip(double, same, older, strict=True)])
    # The share of the j-th power in the i-th Bernstein coefficient is comb(i, j) / comb(d, j).
    whole = lcm(*(comb(DEGREE, j) for j in range(DEGREE + 1)))
    weights = [whole // comb(DEGREE, j) for j in range(DEGREE + 1)]
    columns = [
        [
            sum(comb(i, j) * weights[j] * c for j, c in enumerate(of[: i + 1])) / whole
            for i in range(DEGREE + 1)
        ]
        for of in power
    ]
    return np.array(columns).T @ _to_chebyshev()


_CHEBYSHEV, _BERNSTEIN = _to_chebyshev(), _to_bernstein()
# Rounding of Bernstein coefficients as a share of the largest value.
_BERNSTEIN_ROUNDING = float(np.abs(_BERNSTEIN).sum(axis=1).max()) * (DEGREE + 2) * 2.0**-52


def clenshaw_curtis() -> FloatArray:
    """Weights (d + 1,) of the values at the points in their mean over the piece."""
    k = np.arange(0.0, DEGREE + 1, 2)
    return np.asarray(1.0 / (1.0 - k**2) @ _CHEBYSHEV[::2])


@dataclass(frozen=True, kw_only=True, eq=False)
class Ellipses:
    """How large a trajectory's state is on Bernstein ellipses around K pieces, R each.

    Attributes
    ----------
    turn : (K, R, n), rad
        Bounds on the imaginary part of the position.
    q : (K, R, n), rad
        Bounds on the absolute value of the position.
    v, a : (K, R, n), rad/s, rad/s2
        Bounds on the absolute values of velocity and acceleration.
    """

    turn: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """K intervals of a trajectory, none of which has a knot inside.

    Attributes
    ----------
    trajectory : QuinticTrajectory
    start, end : (K,), s
    """

    trajectory: QuinticTrajectory
    start: FloatArray
    end: FloatArray

    @classmethod
    def between(cls, trajectory: QuinticTrajectory, breaks: FloatArray) -> Pieces:
        """Return those between all knots and `breaks` (B,), s."""
        t = trajectory.t
        inside = breaks[(breaks > t[0]) & (breaks < t[-1])]
        # A break beside a knot that it only misses by rounding would make a piece of no length.
        near = np.abs(inside - t[np.abs(inside[:, None] - t).argmin(axis=1)]) if len(inside) else inside
        every = np.union1d(t, inside[near > 1e-9 * trajectory.duration])
        return cls(trajectory=trajectory, start=every[:-1], end=every[1:])

    @cached_property
    def times(self) -> FloatArray:
        """The Chebyshev points, (K, d + 1), s; the ends are among them."""
        share = 0.5 * (1 + _CHEBYSHEV_POINTS)
        times = self.start[:, None] + share * (self.end - self.start)[:, None]
        times[:, -1] = self.end
        return times

    @cached_property
    def middle(self) -> FloatArray:
        """Times (K,) in the middle of each, s."""
        return 0.5 * (self.start + self.end)

    @cached_property
    def states(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration at the Chebyshev points, (K (d + 1), n)."""
        return self.trajectory.states(self.times.ravel())

    def means(self, values: FloatArray) -> FloatArray:
        """Return the means over time (m,) of values (K (d + 1), m) at the Chebyshev points."""
        each = clenshaw_curtis() @ values.reshape(len(self.start), DEGREE + 1, -1)
        return np.asarray(np.average(each, axis=0, weights=self.end - self.start))

    @cached_property
    def ellipses(self) -> Ellipses:
        """Bounds of the state on the ellipses."""
        eta, k = np.log(_ELLIPSE_SUMS), np.arange(_POSITION_DEGREE + 1)
        q, v, a = (self._amplitudes(x) for x in self.states)
        growth = np.cosh(np.outer(eta, k))
        return Ellipses(turn=np.sinh(np.outer(eta, k)) @ q, q=growth @ q, v=growth @ v, a=growth @ a)

    def _amplitudes(self, values: FloatArray) -> FloatArray:
        """Upper bounds (K, 6, n) of the magnitudes of the Chebyshev coefficients of polynomials."""
        values = values.reshape(len(self.start), DEGREE + 1, -1)
        rounding = _COEFFICIENT_ROUNDING * np.abs(values).max(axis=1, keepdims=True)
        # The middle of the range plays no part in what turns.
        return np.asarray(np.abs(_CHEBYSHEV[: _POSITION_DEGREE + 1] @ values) + rounding)

    def imaginary(self, values: FloatArray) -> FloatArray:
        """Return bounds (K, R, m) of the imaginary parts of polynomials on the ellipses.

        Parameters
        ----------
        values : (K (d + 1), m)
            At the Chebyshev points; of degree d at most.
        """
        values = values.reshape(len(self.start), DEGREE + 1, -1)
        coefficients = np.abs(_CHEBYSHEV @ values) + _COEFFICIENT_ROUNDING * np.abs(values).max(
            axis=1, keepdims=True
        )
        return np.asarray(np.sinh(np.outer(np.log(_ELLIPSE_SUMS), np.arange(DEGREE + 1))) @ coefficients)

    def remainder(self, size: FloatArray) -> FloatArray:
        """Bounds (K,) of what interpolation misses of a function, with rounding.

        Parameters
        ----------
        size : (K, R)
            What the function's norm does not exceed on the ellipses. Where it is no number, as what became of
            infinities, nothing is known: it counts as infinite.
        """
        size = np.where(np.isnan(size), np.inf, size)
        with np.errstate(over="ignore"):
            missed = 4 * size * _ELLIPSE_SUMS**-DEGREE / (_ELLIPSE_SUMS - 1)
        # On the smallest ellipse the function is about as large as on the piece.
        return np.asarray(missed.min(axis=1) + _BERNSTEIN_ROUNDING * size[:, 0])

    def estimated_remainder(self, values: FloatArray) -> FloatArray:
        """Estimates (K,) of what interpolation misses of a function of which no bound is known.

        From its last two Chebyshev coefficients, whose decay it takes to go on.

        Parameters
        ----------
        values : (K (d + 1), m)
            At the Chebyshev points.
        """
        last = _CHEBYSHEV[-2:] @ values.reshape(len(self.start), DEGREE + 1, -1)
        return np.asarray(2 * np.linalg.norm(last, axis=2).sum(axis=1))

    def halved(self, which: BoolArray) -> Pieces:
        """Return the pieces with those that are marked, (K,), cut in two."""
        # Where one part ends the other begins.
        start, end = (np.sort(np.append(side, self.middle[which])) for side in (self.start, self.end))
        return Pieces(trajectory=self.trajectory, start=start, end=end)

    def refined(self, remainders: Callable[[Pieces], FloatArray], most: int) -> Pieces:
        """Return pieces that are halved while `remainders`, (K,) as shares of what is allowed, exceed 1.

        No more than `most` pieces are made: where that does not suffice the remainder stays what it is.
        """
        pieces = self
        for _ in range(_MAX_PIECE_HALVINGS):
            large = ~(remainders(pieces) <= 1.0)
            if not large.any() or len(pieces.start) + int(large.sum()) > most:
                break
            pieces = pieces.halved(large)
        return pieces

    def control_points(self, values: FloatArray) -> FloatArray:
        """Bernstein coefficients (K, m, d + 1) of interpolants, from values (K (d + 1), m) at the points."""
        values = values.reshape(len(self.start), DEGREE + 1, -1)
        return np.asarray(np.swapaxes(_BERNSTEIN @ values, 1, 2))


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The largest value of a function over all times, enclosed.

    Attributes
    ----------
    time : float, s
    value : float
        The largest value that was found, at `time`.
    bound : float
        It is nowhere larger.
    """

    time: float
    value: float
    bound: float


def highest(
    pieces: Pieces,
    control: FloatArray,
    convex: Callable[[FloatArray, IntArray], FloatArray],
    remainder: FloatArray,
    resolution: float,
    exact: Callable[[FloatArray, IntArray], FloatArray] | None = None,
) -> Peak:
    """Enclose the largest value of a convex function of interpolants.

    Parameters
    ----------
    pieces : Pieces
    control : (K, m, d + 1)
        `Pieces.control_points`.
    convex : callable
        From points (L, m, d + 1) and the piece of each, (L,), to values (L, d + 1).
    remainder : (K,)
        What the interpolants may miss, in the function's unit; infinite where that is no number.
    resolution : float
        How far the hull may lie above the largest value that was found, in the function's unit.
    exact : callable, optional
        What `convex` bounds from above, the nearer the shorter a piece, for values at the ends of pieces.
    """
    piece = np.arange(len(control))
    remainder = np.where(np.isnan(remainder), np.inf, remainder)
    start, width = pieces.start.copy(), pieces.end - pieces.start
    value, time, bound = -np.inf, float(pieces.start[0]), -np.inf
    halving, ends = 0, np.empty((0, 2)) if exact is None else exact(control[:, :, [0, -1]], piece)
    while True:
        at = convex(control, piece)
        ends = at[:, [0, -1]] if exact is None else ends
        if not (np.isfinite(at).all() and np.isfinite(ends).all()):
            return Peak(time=time, value=np.nan, bound=np.nan)
        k, side = np.unravel_index(ends.argmax(), ends.shape)
        if ends[k, side] > value:
            value, time = float(ends[k, side]), float(start[k] + side * width[k])
        hull = at.max(axis=1)
        open_ = (hull > value + resolution) & (hull - ends.max(axis=1) > _MIN_HULL_SHARE * resolution)
        number = int(open_.sum())
        open_ &= halving < _MAX_PIECE_HALVINGS and number <= _MAX_PIECES
        if (~open_).any():
            bound = float(np.maximum(bound, (hull + remainder[piece])[~open_].max()))
        if not open_.any():
            break
        control, piece, start, width, ends = (each[open_] for each in (control, piece, start, width, ends))
        times = 1 if exact is None else int(np.clip(np.log2(_CUT_AT_ONCE / number), 1, 3))
        times = min(times, _MAX_PIECE_HALVINGS - halving)
        for _ in range(times):
            control = np.stack(halves(control), axis=1).reshape(-1, *control.shape[1:])
        parts = 2**times
        if exact is not None:
            # The ends are known; the parts share what is between them.
            inner = control.reshape(number, parts, *control.shape[1:])[:, :-1, :, -1].swapaxes(1, 2)
            points = np.hstack([ends[:, :1], exact(inner, piece), ends[:, 1:]])
            ends = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2)
        width, start, piece = (np.repeat(each, parts) for each in (width / parts, start, piece))
        start += width * np.tile(np.arange(parts), number)
        halving += times
    return Peak(time=time, value=value, bound=max(bound, value))
