"""The change of the splines on a few legs that minimises the vibration at the legs' ends.

A long path is divided into windows of a few legs: splines with support in two of them are not changed, so
that every window is a small problem of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import linalg, sparse

from cmbot.common.arrays import FloatArray
from cmbot.optimization import nearest
from cmbot.planning.flexibility.leg_vibration import LegVibration, tool_amplitudes
from cmbot.planning.torque import TorqueProblem
from cmbot.trajectory import SUPPORT, QuinticTrajectory, SplineSpace

# By how much times may miss their knots, s.
SAME_TIME = 1e-9
# Most segments of a window of several legs; windows with fewer than the second number take one more leg.
_MAX_WINDOW_SEGMENTS, _MIN_WINDOW_SEGMENTS = 64, 12
# Legs with a smaller amplitude than this share of the largest are as good as at rest.
_NEGLIGIBLE_AMPLITUDE_SHARE = 0.3
# By how much more may be left where another leg of the window follows at once.
_FOLLOWED_LEG_FACTOR = 2.0
# Weight of the mean squared jerk, in units of its bounds, beside the squares of amplitudes, in those before.
_JERK_WEIGHT = 100.0
# Weight at least, as a share of the sum of the squares' own: in slow legs rounding is larger than the jerk.
_MIN_JERK_WEIGHT = 1e-12
# Times per segment at which the jerk is compared with the largest before, by what share of its bound it may
# exceed that, and how often at most it is compared.
_JERKS, _JERK_EXCESS_SHARE, _JERK_ROUNDS = 5, 1e-3, 8
# Iterations of Lawson's algorithm, without bounds and within them, by what share one of these has to lower
# the largest amplitude for another one, but at first, and the least weight of a case.
_REWEIGHTINGS, _BOUND_REWEIGHTINGS, _MIN_REWEIGHTING_GAIN, _LEAST_WEIGHT = 12, 10, 5e-3, 1e-6

Leg = tuple[int, int]
"""First and last knot of a leg."""


@dataclass(frozen=True, eq=False)
class Change:
    """A change X (s, d) of coefficients, and the share by which the largest amplitude falls, as predicted."""

    x: FloatArray
    share: float


def legs_by_window(space: SplineSpace, leg_times: FloatArray) -> list[list[Leg]]:
    """Divide the legs between `leg_times` (m + 1,), s, all of them knots, among windows."""
    windows: list[list[Leg]] = []
    for leg in pairwise(int(k) for k in np.searchsorted(space.t, np.asarray(leg_times) - SAME_TIME)):
        if windows and _joins(windows[-1][0][0], *leg):
            windows[-1].append(leg)
        else:
            windows.append([leg])
    if len(windows) > 1 and windows[-1][-1][1] - windows[-1][0][0] < _MIN_WINDOW_SEGMENTS:
        windows[-2:] = [windows[-2] + windows[-1]]
    return windows


def _joins(start: int, first: int, last: int) -> bool:
    """Whether a leg belongs to the window that starts at the knot `start`."""
    return last - start <= _MAX_WINDOW_SEGMENTS or first - start < _MIN_WINDOW_SEGMENTS


class Window:
    """The basis splines with support on some legs alone, and how they change the vibration at the legs' ends.

    Of a long leg they are those near its end: their number is bounded, however long the path is.
    `coefficients` (s,) are the splines' indices; `start`, s, is where the first leg begins.
    """

    def __init__(self, problem: TorqueProblem, legs: list[Leg]) -> None:
        space = problem.space
        self._space, self._jerk = space, problem.request.cell.robot.limits.jerk
        self.start = float(space.t[legs[0][0]])
        near = [np.arange(max(first, last - _MAX_WINDOW_SEGMENTS), last) for first, last in legs]
        coefficients = np.concatenate(near)
        self.coefficients = coefficients[coefficients <= legs[-1][1] - SUPPORT]
        self._basis = space.basis[:, self.coefficients]
        # With y = L' X / jerk bound the mean squared jerk, in units of its bounds, is |y|^2.
        gram = space.jerk_gram[self.coefficients][:, self.coefficients].toarray()
        self._factor = np.linalg.cholesky(gram) if len(self.coefficients) else gram
        self._conditions: list[FloatArray] = []
        self._vibration: list[FloatArray] = []
        self._cases = 1
        self._wanted: _Wanted | None = None
        # What calls of `change` learn from those before: the best weighting, and where the jerk is largest.
        self._weighted: _Weighted | None = None
        width = len(self.coefficients) * len(self._jerk)
        self._most_jerk = np.empty((0, width)), np.empty(0)

    def bring_to_rest(self, leg: LegVibration, trajectory: QuinticTrajectory) -> None:
        """Take the vibration away that `trajectory` leaves at the end of one of the legs."""
        snap = (self._space.design(leg.times, 4) @ self._basis).T
        m, conditions, n = leg.weights.shape
        found = snap @ leg.weights.reshape(m, conditions * n)
        self._conditions.append(found.reshape(-1, conditions, n).transpose(1, 0, 2))
        self._vibration.append(leg.vibration(trajectory))
        self._cases, self._given = leg.cases, trajectory

    @property
    def conditions(self) -> tuple[list[FloatArray], list[FloatArray]]:
        """For each leg derivatives (C 2r, s, d) of the vibration by the coefficients, and itself (C 2r,)."""
        return self._conditions, self._vibration

    @property
    def amplitude(self) -> float:
        """Largest amplitude of the tool, m, at the end of a leg, unchanged."""
        return max(float(tool_amplitudes(v, self._cases).max()) for v in self._vibration)

    def amplitudes(self, X: FloatArray) -> FloatArray:
        """Largest amplitudes of the tool, m, at the end of every leg (legs, C), as changed by `X` (s, d)."""
        each = zip(self._conditions, self._vibration, strict=True)
        return np.array([tool_amplitudes(v + np.einsum("csd,sd->c", E, X), self._cases) for E, v in each])

    def change(self, rows: sparse.csr_array, room: FloatArray) -> Change | None:
        """Change the coefficients, X (s, d), for the least of the largest amplitudes, and for little jerk.

        `rows` (K, (n - 4) d) are derivatives of what is bounded by all coefficients, the joints of each in
        turn; `room` (K,) is by how much these may grow. None where no change keeps to the room, or helps.
        """
        s, d = len(self.coefficients), len(self._jerk)
        if s == 0:
            return None
        wanted = self._wanted = self._wanted or _Wanted(self)
        own = rows[:, (self.coefficients[:, None] * d + np.arange(d)).ravel()].toarray()
        C, best = self.whitened(own.reshape(-1, s, d)), None
        first, weighted = self._weighted is None, self._weighted or wanted.unbounded
        for _ in range(_BOUND_REWEIGHTINGS):
            found = self._without_more_jerk(weighted, C, room)
            if found is None:
                break
            each = wanted.relative(found)
            gains = best is None or each.max() < (1 - _MIN_REWEIGHTING_GAIN) * best[0]
            if best is None or each.max() < best[0]:
                best, self._weighted = (each.max(), found), weighted
            if found is weighted.y or not (first or gains):
                break
            weighted = wanted.least_squares(_reweighted(weighted.weight, each))
        if best is None:
            return None
        X = linalg.solve_triangular(self._factor, best[1].reshape(s, d), lower=True, trans="T") * self._jerk
        before, after = (self.amplitudes(x).max() for x in (0 * X, X))
        return Change(X, float(1 - after / before)) if after < before else None

    def _without_more_jerk(self, weighted: _Weighted, C: FloatArray, room: FloatArray) -> FloatArray | None:
        """The point of the least weighted squares that keeps to the room, and to the largest jerk there was.

        Where the jerk would be larger, that is forbidden and the point sought again.
        """
        s, d = len(self.coefficients), len(self._jerk)
        rows, jerk = self._jerks
        most = np.abs(jerk).max() + _JERK_EXCESS_SHARE
        for _ in range(_JERK_ROUNDS):
            known, left = self._most_jerk
            found = nearest(weighted.y, weighted.factor, np.concatenate([C, known]), np.append(room, left))
            if found is None:
                return None
            changed = jerk + rows @ found.reshape(s, d)
            at, joint = np.nonzero(np.abs(changed) > most + _JERK_EXCESS_SHARE)
            if not len(at):
                break
            sign = np.sign(changed[at, joint])
            more = np.zeros((len(at), s, d))
            more[np.arange(len(at)), :, joint] = sign[:, None] * rows[at]
            self._most_jerk = (
                np.concatenate([known, more.reshape(len(at), s * d)]),
                np.append(left, most - sign * jerk[at, joint]),
            )
        return found

    @cached_property
    def _jerks(self) -> tuple[FloatArray, FloatArray]:
        """Jerk all along, as a share of its bounds: its derivatives by y (T, s), and itself (T, d)."""
        knots = self._space.t[self.coefficients[0] : self.coefficients[-1] + SUPPORT + 1]
        times = np.linspace(knots[:-1], knots[1:], _JERKS, axis=1).ravel()
        rows = (self._space.design(times, 3) @ self._basis).toarray().T
        jerk = self._given.evaluate(times, 3) / self._jerk
        return linalg.solve_triangular(self._factor, rows, lower=True).T, jerk

    def whitened(self, rows: FloatArray) -> FloatArray:
        """Derivatives (K, s d) by y from those (K, s, d) by X."""
        k, s, d = rows.shape
        by_number = rows.transpose(1, 0, 2).reshape(s, k * d)
        y = linalg.solve_triangular(self._factor, by_number, lower=True).reshape(s, k, d) * self._jerk
        return np.asarray(y.transpose(1, 0, 2).reshape(k, s * d))


@dataclass(frozen=True, eq=False)
class _Weighted:
    """Weights of amplitudes, the change y (s d,) of the least squares by them, its metric's factor."""

    weight: FloatArray
    y: FloatArray
    factor: FloatArray


class _Wanted:
    """What the splines of a window would best do without bounds: the least of the largest amplitudes.

    By Lawson's algorithm: least squares, in which an amplitude's weight grows while it is large.
    """

    def __init__(self, window: Window) -> None:
        conditions, vibration = window.conditions
        before = window.amplitudes(np.zeros(conditions[0].shape[1:]))
        # Every leg is to come to rest by the same share, but for those that nearly do so anyway.
        scale = np.maximum(before.max(axis=1), _NEGLIGIBLE_AMPLITUDE_SHARE * before.max())
        scale[:-1] *= _FOLLOWED_LEG_FACTOR
        size = np.repeat(scale, [len(v) for v in vibration])
        self._E = window.whitened(np.concatenate(conditions)) / size[:, None]
        self._v, self._groups = np.concatenate(vibration) / size, before.size
        self._rows = len(size) // before.size
        gram, least, best = self._E @ self._E.T, np.inf, np.ones(before.size)
        weight = best
        for _ in range(_REWEIGHTINGS):
            factor = linalg.cho_factor(gram + np.diag(_JERK_WEIGHT / np.repeat(weight, self._rows)))
            left = self._v - gram @ linalg.cho_solve(factor, self._v)
            largest = tool_amplitudes(left, self._groups)
            if largest.max() < least:
                least, best = largest.max(), weight
            weight = _reweighted(weight, largest)
        self.unbounded = self.least_squares(best)

    def relative(self, y: FloatArray) -> FloatArray:
        """Amplitudes with a change `y` (s d,), as shares of the largest of before."""
        return tool_amplitudes(self._v + self._E @ y, self._groups)

    def least_squares(self, weight: FloatArray) -> _Weighted:
        """The change of the least weighted squares and jerk."""
        roots = np.sqrt(np.repeat(weight, self._rows))
        E, v = self._E * roots[:, None], self._v * roots
        squares = E.T @ E
        jerk = max(_JERK_WEIGHT, _MIN_JERK_WEIGHT * float(np.trace(squares)))
        factor = np.linalg.cholesky(squares + jerk * np.eye(len(squares)))
        return _Weighted(weight, -linalg.cho_solve((factor, True), E.T @ v), factor)


def _reweighted(weight: FloatArray, largest: FloatArray) -> FloatArray:
    """Weights that grow with amplitudes, of mean 1."""
    return np.maximum(weight * largest / (weight @ largest) * len(weight), _LEAST_WEIGHT)
