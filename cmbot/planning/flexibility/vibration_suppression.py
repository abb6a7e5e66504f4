"""Vibration suppression: the elastic modes are brought to rest where the tool comes to rest.

Guardrail and links answer the joints' motion as a linear system whose matrices change slowly with the
posture. With y what they move beyond the sag and beyond what the accelerations bend quasi-statically,

    M(t) y'' + D(t) y' + K(t) y = M K^-1 B(t) snap(t),    B = M_fa + M_ff du_sag/dq

so the first modes' displacement and velocity at the end of a leg are linear in the joints' snap, and with it
in the splines' coefficients. Of all changes that bring them to zero at every end of a leg the one with the
least mean squared jerk is taken. Via-points, and C3 at the knots, are kept.

A long path is divided into windows of a few legs: splines with support in two of them are not changed, so
that every window is a small problem of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import linalg, sparse

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import TooSoftError
from cmbot.optimization import (
    OBJECTIVE,
    ConstraintSet,
    Separation,
    find_violations,
    linearize,
    nearest,
)
from cmbot.planning.flexibility.leg_vibration import ElasticPath, LegVibration, tool_amplitudes
from cmbot.planning.torque import Optimised, TorqueProblem
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
# Rounds at most, and constraints at most that are added in each round for each window.
_MAX_ROUNDS, _MOST_SITES = 12, 400
# Earlier linearizations are kept of what was nearer to its bound than this.
_KEPT_LINEARIZATION_SHARE = 0.3
# Where a constraint of the state is violated by less than the first number, a step goes further than to its
# bound by the second share of that: about so much a step leaves, and the next one would leave of the rest.
_SMALL_VIOLATION, _FURTHER_SHARE = 0.1, 0.3
# Shares of the last change that are tried then, the largest first; the peak may rise by this share at most.
_SHARES, _PEAK_RISE = (0.75, 0.5, 0.25), 1e-6
# The largest swing is to fall to this share, and the sway at work may grow by this factor; an amplitude of
# the tool below the last, m, is rest.
_WORTHWHILE_SWING_SHARE, _MAX_SWAY_GROWTH, _AT_REST_M = 0.9, 1.02, 2e-6
# A swing is left as it is that is below this share of the sway at work, and below so many m.
_SMALL_SWING_SHARE, _SMALL_SWING_M = 0.025, 2e-5
# What the prediction misses, as a share of the stiffness.
_PREDICTION_ERROR_SHARE = 0.01
# Factors on the stiffness for which vibration is predicted.
_STIFFNESS_FACTORS = 13
# Time before the end of a leg in which vibration was excited that still counts, s.
_MEMORY_S = 20.0 + SAME_TIME
# Of a longer leg only what is excited in so many seconds before its end counts.
_MAX_WINDOW_S = 100.0


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


def suppress_vibration(arm: ElasticArm, problem: TorqueProblem, optimised: Optimised) -> Optimised:
    """Bring the first elastic modes to rest at the ends of the legs, whatever the stiffness may be.

    The trajectory goes on keeping the bounds of `problem`. It stays what it was where no change keeps them,
    where the time is over, where the largest swing after the stop is small or does not fall by a tenth, or
    the tool sways more at work, as simulated at the ends of the interval of stiffness.
    """
    request, trajectory, t = problem.request, optimised.trajectory, problem.space.t
    options, reporter = request.cell.options, request.reporter
    leg_times = request.task.path.leg_times
    sway, swing = before = request.cell.sway_of(trajectory)
    optimised = replace(optimised, sway=before)
    if swing < max(_AT_REST_M, min(_SMALL_SWING_SHARE * sway, _SMALL_SWING_M)):
        return optimised
    factors = _factors(options.quiet_stiffness_share)
    groups = legs_by_window(problem.space, leg_times)
    windows = [Window(problem, group) for group in groups]
    path = ElasticPath(arm, trajectory)
    ends = [(window, leg) for window, group in zip(windows, groups, strict=True) for leg in group]
    for window, (first, last) in reporter.each("predicting the vibration of every leg", ends):
        if request.deadline.expired():
            return optimised
        # What is left of the legs before is still there, but for that of long ago.
        earlier = [time for time in leg_times if window.start <= time + SAME_TIME < t[first]]
        start = min([t[first], *(time for time in earlier if t[last] - time <= _MEMORY_S)])
        start = max(start, t[last] - _MAX_WINDOW_S)
        try:
            leg = LegVibration(path, float(start), t[last], options.quiet_modes, factors)
        except TooSoftError:  # it bears the arm in the interval, but not where the prediction may err
            return optimised
        window.bring_to_rest(leg, trajectory)
    reporter.step("bringing the slowest vibrations to rest")
    changed, shares = _Search(problem, trajectory, windows).changed()
    if not any(shares):
        return optimised
    after, left = changed_sway = request.cell.sway_of(changed)
    pays = left <= _WORTHWHILE_SWING_SHARE * swing and after <= _MAX_SWAY_GROWTH * sway
    return replace(optimised, trajectory=changed, sway=changed_sway) if pays else optimised


def _factors(share: float) -> FloatArray:
    """Factors (C,) on the stiffness: evenly spaced in frequency, so the phases at the end of a leg are."""
    if not share:
        return np.ones(1)
    wide = share + _PREDICTION_ERROR_SHARE
    roots = np.linspace(np.sqrt(1 - wide), np.sqrt(1 + wide), _STIFFNESS_FACTORS)
    return np.union1d(roots**2, [1 - share, 1.0, 1 + share])


@dataclass(frozen=True, eq=False)
class _Held:
    """Times (K,), values (K,) and derivatives (K, (n - 4) d) by the coefficients of what is held.

    Those are `curved` (K,) that are constraints of the state.
    """

    times: FloatArray
    value: FloatArray
    rows: sparse.csr_array
    curved: BoolArray


@dataclass(frozen=True, eq=False)
class _HalfSpaces:
    """Where ``rows X <= most``: of each a time (K,), a derivative (K, (n - 4) d) and a bound (K,)."""

    times: FloatArray
    rows: sparse.csr_array
    most: FloatArray

    def where(self, which: BoolArray) -> _HalfSpaces:
        """Those that `which` (K,) names."""
        return _HalfSpaces(self.times[which], self.rows[which], self.most[which])

    def with_others(self, others: list[_HalfSpaces]) -> _HalfSpaces:
        """These and others."""
        each = [self, *others]
        return _HalfSpaces(
            np.concatenate([one.times for one in each]),
            sparse.vstack([one.rows for one in each], format="csr"),
            np.concatenate([one.most for one in each]),
        )


class _Search:
    """A change of all windows that keeps the bounds.

    Newton's method: what a step violates becomes a bound of the next one, which brings it back. What was
    linearized in steps before stays, as in the cutting-plane method (Kelley, 1960): about the path the tool's
    deviation is nearly convex, and from its last linearization alone steps go to and fro.
    """

    def __init__(self, problem: TorqueProblem, trajectory: QuinticTrajectory, windows: list[Window]) -> None:
        self._problem, self._windows, self._given = problem, windows, trajectory
        self._tolerance = problem.request.cell.options.constraint_tolerance
        self._z = _knot_vector(trajectory)
        self._starts = np.array([window.start for window in windows])
        self._constraints = ConstraintSet(step=float(problem.grid[1] - problem.grid[0]))
        found = self._separated(trajectory, np.inf, 0)
        self._peak = found.peak * (1 + _PEAK_RISE)
        self._allowed = max(found.worst.value, self._tolerance)
        self._X = np.zeros((problem.space.dimension, trajectory.q.shape[1]))
        self._shares = np.zeros(len(windows))
        # Nothing is sought where every leg ends at rest, nor where nothing was found.
        self._skipped = np.array([window.amplitude < _AT_REST_M for window in windows])
        self._here, self._broken = trajectory, 0.0
        self._held, self._earlier = self._held_here(), list[_HalfSpaces]()

    def changed(self) -> tuple[QuinticTrajectory, list[float]]:
        """Return the changed trajectory, and the share of each window's change that it took."""
        unfit = ~self._skipped
        for _ in range(_MAX_ROUNDS):
            if not unfit.any() or self._problem.request.deadline.expired():
                break
            self._step(unfit)
            unfit = self._unfit()
        whole, shares = self._X.copy(), self._shares.copy()
        for share in (*_SHARES, 0.0):
            if unfit.any():
                for k in np.flatnonzero(unfit):
                    own = self._windows[k].coefficients
                    self._X[own], self._shares[k] = share * whole[own], share * shares[k]
                unfit = self._unfit() & (self._shares > 0)
        if self._broken > self._allowed:
            self._X[:] = 0.0
            return self._given, [0.0] * len(self._windows)
        return self._here, [float(share) for share in self._shares]

    def _unfit(self) -> BoolArray:
        """Which of the windows break a bound, or have not been changed yet."""
        space, most = self._problem.space, _MOST_SITES * len(self._windows)
        self._here = space.trajectory(self._z + space.basis @ self._X)
        found = self._separated(self._here, self._peak, most)
        self._constraints = found.added_to(self._constraints)
        self._broken, self._held = max(found.worst.value, found.peak - self._peak), self._held_here()
        unfit = self._shares == 0
        np.logical_or.at(unfit, self._window_at(self._held.times), self._held.value > self._tolerance)
        return np.asarray(unfit & ~self._skipped)

    def _step(self, unfit: BoolArray) -> None:
        """Work out the change of the windows that are unfit, to first order around the trajectory here."""
        value, rows = self._held.value, self._held.rows
        # What is at its bound, not beyond it, may stay there: some of it no coefficient can change.
        further = np.where(self._held.curved & (value < _SMALL_VIOLATION), 1.0 + _FURTHER_SHARE, 1.0)
        room = np.where(value <= self._tolerance, np.maximum(-value, 0.0), -further * value)
        # For the change as a whole.
        new = _HalfSpaces(self._held.times, rows, room + rows @ self._X.ravel())
        known = new.with_others(self._earlier)
        self._earlier.append(new.where(value > -_KEPT_LINEARIZATION_SHARE))
        at = self._window_at(known.times)
        for k in np.flatnonzero(unfit):
            window, here = self._windows[k], at == k
            found = window.change(known.rows[here], known.most[here])
            # Without a change that keeps to the room here, one is sought from the start, once.
            self._skipped[k] = found is None and self._shares[k] == 0
            self._X[window.coefficients] = 0.0 if found is None else found.x
            self._shares[k] = 0.0 if found is None else found.share
        if (self._shares[unfit] == 0).any():
            self._earlier.clear()

    def _window_at(self, times: FloatArray) -> IntArray:
        return np.asarray(np.searchsorted(self._starts[1:], times, side="right"))

    def _separated(self, trajectory: QuinticTrajectory, bound: float, most: int) -> Separation:
        return find_violations(self._problem, trajectory, bound, self._tolerance, most)

    def _held_here(self) -> _Held:
        """Constraints and their cuts, linearized by the coefficients of the basis splines."""
        splines, known = self._problem.parametrization.splines, self._constraints
        at = linearize(self._problem, known, self._here)
        limit = np.where(known.family == OBJECTIVE, self._peak, 0.0)
        which = np.concatenate([np.arange(len(known)), at.cut_of])
        derivative = np.concatenate([at.derivative, at.cut_derivative], axis=1)
        rows = splines.jacobian(splines.rows(known.time[which]), derivative)[:, : self._X.size]
        curved = (known.family != OBJECTIVE) & (known.family <= len(self._problem.constraints))
        curved = np.append(curved, np.zeros(len(at.cut_of), dtype=np.bool_))
        return _Held(known.time[which], np.concatenate([at.value - limit, at.cut_value]), rows, curved)


def _knot_vector(trajectory: QuinticTrajectory) -> FloatArray:
    return np.stack([trajectory.q, trajectory.v, trajectory.a], axis=1).reshape(-1, trajectory.q.shape[1])
