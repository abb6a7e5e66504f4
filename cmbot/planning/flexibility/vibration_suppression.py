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
from cmbot.optimization import (
    OBJECTIVE,
    ConstraintSet,
    Separation,
    find_violations,
    linearize,
    nearest,
)
from cmbot.planning.flexibility.leg_vibration import (
    ElasticPath,
    LegVibration,
    Uncertainty,
    tool_amplitudes,
)
from cmbot.planning.torque import Optimised, TorqueProblem
from cmbot.scene import PlannerOptions
from cmbot.trajectory import SUPPORT, QuinticTrajectory, SplineSpace

__all__ = ["Leg", "VibrationSuppression", "Window", "legs_by_window", "suppress_vibration"]

# Rounds at most, and constraints at most that are added in each round for each window.
_ROUNDS, _MOST_SITES = 12, 400
# Constraints are kept this many tolerances inside their bounds.
_INSIDE = 1.0
# Shares of the last change that are tried then, the largest first; the peak may rise by this share at most.
_SHARES, _PEAK_RISE = (0.75, 0.5, 0.25), 1e-6
# The largest swing is to fall to this share; an amplitude of the tool below the second number, m, is rest.
_WORTH, _AT_REST = 0.6, 2e-6
# What the prediction misses, as a share of the stiffness.
_MARGIN = 0.01
# Factors on the stiffness; longer paths, s, and more modes are predicted in fewer cases.
_MOST_FACTORS, _FEW_FACTORS, _LONG, _MANY = 25, 13, 60.0, 3
# By how much times may miss their knots, s.
_SAME_TIME = 1e-9
# Time before the end of a leg in which vibration was excited that still counts, s.
_KEPT = 20.0 + _SAME_TIME
# Most segments of a window of several legs; windows with fewer than the second number take one more leg.
_MOST, _FEWEST = 64, 12
# Legs with a smaller amplitude than this share of the largest are as good as at rest.
_LOUD = 0.3
# By how much more may be left where another leg of the window follows at once.
_PASSING = 2.0
# Weight of the mean squared jerk, in units of its bounds, beside the squares of amplitudes, in those before.
_JERK_WEIGHT = 100.0
# Times per segment at which the jerk is compared with the largest before, by what share of its bound it may
# exceed that, and how often at most it is compared.
_JERKS, _MORE_JERK, _JERK_ROUNDS = 5, 1e-3, 8
# Iterations of Lawson's algorithm, without bounds and within them, and the least weight of a case.
_REWEIGHTINGS, _BOUND_REWEIGHTINGS, _LEAST_WEIGHT = 40, 6, 1e-6

Leg = tuple[int, int]
"""First and last knot of a leg."""


@dataclass(frozen=True, kw_only=True)
class VibrationSuppression:
    """How the vibration was suppressed.

    Attributes
    ----------
    modes : int
        Number of the slowest modes that are brought to rest.
    shares : tuple of float
        For each leg, by which the largest amplitude of the tool at its end falls, as predicted; 0 where every
        change broke a bound, or where none is made. Short legs that follow on one another have theirs in
        common.
    before, after : float, m
        Amplitude of the tool that these modes leave at the end of the motion, as predicted, without and with
        the change: the largest over what stiffness and load may be.
    stiffness, load_kg : tuple of float
        Factors on all stiffness, and how much more the tool carries than modelled: as modelled, the most it
        may carry, the ends of the interval, and the worst of all cases without and with the change.
    swing_without, swing_with : tuple of float, m
        Largest distance between two positions of the tool after the stop in each of these, simulated as a
        linear system whose matrices change with the posture. Where the largest of all cases does not fall by
        two fifths, the change is not made, and all shares are 0.
    """

    modes: int
    shares: tuple[float, ...]
    before: float
    after: float
    stiffness: tuple[float, ...] = ()
    load_kg: tuple[float, ...] = ()
    swing_without: tuple[float, ...] = ()
    swing_with: tuple[float, ...] = ()

    @property
    def share(self) -> float:
        """Mean of the legs' shares."""
        return sum(self.shares) / len(self.shares)

    @property
    def at_rest(self) -> bool:
        """Whether the tool hardly swings anyway."""
        return self.before < _AT_REST

    @property
    def worth_it(self) -> bool:
        """Whether the largest swing that was simulated falls far enough for the change to be made."""
        return max(self.swing_with, default=0.0) <= _WORTH * max(self.swing_without, default=np.inf)


def suppress_vibration(
    arm: ElasticArm, problem: TorqueProblem, optimised: Optimised
) -> tuple[Optimised, VibrationSuppression | None]:
    """Bring the first elastic modes to rest at the ends of the legs, whatever stiffness and load may be.

    The trajectory goes on keeping the bounds of `problem`; where no change keeps them, or none lowers the
    largest swing that is simulated, it stays what it was. So it does, and nothing is said of its vibration,
    where the time is over before that is known.
    """
    context, trajectory, t = problem.context, optimised.trajectory, problem.space.t
    options, reporter = context.options, context.reporter
    leg_times = context.task.path.leg_times
    few = t[-1] - t[0] > _LONG or options.quiet_modes > _MANY
    uncertainty = _uncertainty(options, arm.robot.payload, _FEW_FACTORS if few else _MOST_FACTORS)
    groups = legs_by_window(problem.space, leg_times)
    windows = [Window(problem, group) for group in groups]
    path = ElasticPath(arm, trajectory)
    ends = [(window, leg) for window, group in zip(windows, groups, strict=True) for leg in group]
    for window, (first, last) in reporter.each("predicting the vibration of every leg", ends):
        if reporter.expired():
            return optimised, None
        # What is left of the legs before is still there, but for that of long ago.
        earlier = [time for time in leg_times if window.start <= time + _SAME_TIME < t[first]]
        start = min([t[first], *(time for time in earlier if t[last] - time <= _KEPT)])
        leg = LegVibration(path, float(start), t[last], options.quiet_modes, uncertainty)
        window.bring_to_rest(leg, trajectory)
    reporter.step("bringing the slowest vibrations to rest")
    search = _Search(problem, trajectory, windows)
    changed, shares = search.changed()
    amplitudes = [windows[-1].amplitudes(X)[-1] for X in search.last_change()]
    before, after = (float(each.max()) for each in amplitudes)
    if before < _AT_REST:
        changed, shares = trajectory, [0.0] * len(windows)
    reporter.step("simulating the swing after the stop")
    if few:
        # Between the factors that were predicted a change may do harm.
        uncertainty = _uncertainty(options, arm.robot.payload, _MOST_FACTORS)
        leg = LegVibration(path, float(start), t[last], options.quiet_modes, uncertainty)
    swings = leg.swings([trajectory, changed] if any(shares) else [trajectory])
    without, with_it = swings[0], swings[-1]
    shown = _shown(uncertainty, without, with_it, options)
    done = VibrationSuppression(
        modes=options.quiet_modes,
        shares=tuple(share for share, group in zip(shares, groups, strict=True) for _ in group),
        before=before,
        after=after,
        stiffness=tuple(uncertainty.cases[k][0] for k in shown),
        load_kg=tuple(uncertainty.cases[k][1] for k in shown),
        swing_without=tuple(without[shown].tolist()),
        swing_with=tuple(with_it[shown].tolist()),
    )
    if not done.worth_it:
        return optimised, replace(done, shares=(0.0,) * len(done.shares), after=done.before)
    return replace(optimised, trajectory=changed), done


def _uncertainty(options: PlannerOptions, payload: float, count: int) -> Uncertainty:
    """What stiffness and load may be, as the options say; with few factors of the stiffness no other load."""
    share, more = options.quiet_stiffness_share, options.quiet_payload_kg
    wide = share + _MARGIN
    factors = {1.0, *_ends(share)}
    if share:
        # Evenly spaced in frequency: so the phases at the end of a leg are.
        roots = np.linspace(np.sqrt(1 - wide), np.sqrt(1 + wide), count)
        factors |= set((roots**2).round(6).tolist())
    loads = () if count <= _FEW_FACTORS else tuple(load for load in (more, -min(more, payload)) if load)
    # Stiffness and load, one at a time.
    return Uncertainty(loads=(0.0, *loads), factors=(tuple(sorted(factors)), *[(1.0,)] * len(loads)))


def _ends(share: float) -> tuple[float, float]:
    return round(1 - share, 6), round(1 + share, 6)


def _shown(
    uncertainty: Uncertainty, without: FloatArray, with_it: FloatArray, options: PlannerOptions
) -> list[int]:
    """Which cases a plan tells of, in ascending order of stiffness and load."""
    cases, share = uncertainty.cases, options.quiet_stiffness_share
    wanted = [(1.0, load) for load in uncertainty.loads[:2]] + [(end, 0.0) for end in _ends(share)]
    numbers = {cases.index(case) for case in wanted} | {int(without.argmax()), int(with_it.argmax())}
    return sorted(numbers, key=lambda k: cases[k])


@dataclass(frozen=True)
class Change:
    """A change X (s, d) of coefficients, and the share by which the largest amplitude falls, as predicted."""

    x: FloatArray
    share: float


@dataclass(frozen=True)
class _Held:
    """Times (K,), values (K,) and derivatives (K, (n - 4) d) by the coefficients of what is held."""

    times: FloatArray
    value: FloatArray
    rows: sparse.csr_array


class _Search:
    """A change of all windows that keeps the bounds.

    Newton's method: what a step violates becomes a bound of the next one, which brings it back.
    """

    def __init__(self, problem: TorqueProblem, trajectory: QuinticTrajectory, windows: list[Window]) -> None:
        self._problem, self._windows, self._given = problem, windows, trajectory
        self._tolerance = problem.context.options.constraint_tolerance
        self._z = _knot_vector(trajectory)
        self._starts = np.array([window.start for window in windows])
        self._constraints = ConstraintSet(step=float(problem.grid[1] - problem.grid[0]))
        found = self._separated(trajectory, np.inf, 0)
        self._peak = found.peak * (1 + _PEAK_RISE)
        self._allowed = max(found.worst.value, self._tolerance)
        self._X = np.zeros((problem.space.dimension, trajectory.q.shape[1]))
        self._shares, self._hopeless = np.zeros(len(windows)), np.zeros(len(windows), dtype=np.bool_)
        self._here, self._broken = trajectory, 0.0
        self._held = self._held_here()

    def last_change(self) -> tuple[FloatArray, FloatArray]:
        """No change of the last window's coefficients (s, d), and the one that was found."""
        own = self._X[self._windows[-1].coefficients]
        return np.zeros_like(own), own

    def changed(self) -> tuple[QuinticTrajectory, list[float]]:
        """Return the changed trajectory, and the share of each window's change that it took."""
        unfit = ~self._hopeless
        for _ in range(_ROUNDS):
            if self._problem.context.reporter.expired():
                break
            self._step(unfit)
            unfit = self._unfit()
            if not unfit.any():
                break
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
        return np.asarray(unfit & ~self._hopeless)

    def _step(self, unfit: BoolArray) -> None:
        """Work out the change of the windows that are unfit, to first order around the trajectory here."""
        value, rows = self._held.value, self._held.rows
        room = -value - _INSIDE * self._tolerance
        # What is at its bound, not beyond it, may stay there: some of it no coefficient can change.
        room = np.where(value <= self._tolerance, np.maximum(room, 0.0), room)
        # For the change as a whole.
        room += rows @ self._X.ravel()
        at = self._window_at(self._held.times)
        for k in np.flatnonzero(unfit):
            window, here = self._windows[k], at == k
            found = window.change(rows[here], room[here])
            # Without a change that keeps to the room here, one is sought from the start, once.
            self._hopeless[k] = found is None and self._shares[k] == 0
            self._X[window.coefficients] = 0.0 if found is None else found.x
            self._shares[k] = 0.0 if found is None else found.share

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
        return _Held(known.time[which], np.concatenate([at.value - limit, at.cut_value]), rows)


def _knot_vector(trajectory: QuinticTrajectory) -> FloatArray:
    return np.stack([trajectory.q, trajectory.v, trajectory.a], axis=1).reshape(-1, trajectory.q.shape[1])


def legs_by_window(space: SplineSpace, leg_times: FloatArray) -> list[list[Leg]]:
    """Divide the legs between `leg_times` (m + 1,), s, all of them knots, among windows."""
    windows: list[list[Leg]] = []
    for leg in pairwise(int(k) for k in np.searchsorted(space.t, np.asarray(leg_times) - _SAME_TIME)):
        if windows and _joins(windows[-1][0][0], *leg):
            windows[-1].append(leg)
        else:
            windows.append([leg])
    if len(windows) > 1 and windows[-1][-1][1] - windows[-1][0][0] < _FEWEST:
        windows[-2:] = [windows[-2] + windows[-1]]
    return windows


def _joins(start: int, first: int, last: int) -> bool:
    """Whether a leg belongs to the window that starts at the knot `start`."""
    return last - start <= _MOST or first - start < _FEWEST


class Window:
    """The basis splines with support on some legs alone, and how they change the vibration at the legs' ends.

    Of a long leg they are those near its end: their number is bounded, however long the path is.
    `coefficients` (s,) are the splines' indices; `start`, s, is where the first leg begins.
    """

    def __init__(self, problem: TorqueProblem, legs: list[Leg]) -> None:
        space = problem.space
        self._space, self._jerk = space, problem.context.robot.limits.jerk
        self.start = float(space.t[legs[0][0]])
        near = [np.arange(max(first, last - _MOST), last) for first, last in legs]
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
        weight = wanted.weight
        for _ in range(_BOUND_REWEIGHTINGS):
            y, factor = wanted.unbounded if weight is wanted.weight else wanted.least_squares(weight)
            found = self._without_more_jerk(y, factor, C, room)
            if found is None:
                break
            largest = wanted.relative(found)
            if best is None or largest.max() < best[0]:
                best = largest.max(), found
            if found is y:
                break
            weight = _reweighted(weight, largest)
        if best is None:
            return None
        X = linalg.solve_triangular(self._factor, best[1].reshape(s, d), lower=True, trans="T") * self._jerk
        before, after = (self.amplitudes(x).max() for x in (0 * X, X))
        return Change(X, float(1 - after / before)) if after < before else None

    def _without_more_jerk(
        self, y: FloatArray, factor: FloatArray, C: FloatArray, room: FloatArray
    ) -> FloatArray | None:
        """The point nearest to `y` that keeps to the room, and to the largest jerk there was.

        Where the jerk would be larger, that is forbidden and the point sought again.
        """
        s, d = len(self.coefficients), len(self._jerk)
        rows, jerk = self._jerks
        most = np.abs(jerk).max() + _MORE_JERK
        for _ in range(_JERK_ROUNDS):
            found = nearest(y, factor, C, room)
            if found is None:
                return None
            changed = jerk + rows @ found.reshape(s, d)
            at, joint = np.nonzero(np.abs(changed) > most + _MORE_JERK)
            if not len(at):
                break
            sign = np.sign(changed[at, joint])
            more = np.zeros((len(at), s, d))
            more[np.arange(len(at)), :, joint] = sign[:, None] * rows[at]
            C = np.concatenate([C, more.reshape(len(at), s * d)])
            room = np.append(room, most - sign * jerk[at, joint])
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


class _Wanted:
    """What the splines of a window would best do without bounds: the least of the largest amplitudes.

    By Lawson's algorithm: least squares, in which an amplitude's weight grows while it is large.
    """

    def __init__(self, window: Window) -> None:
        conditions, vibration = window.conditions
        before = window.amplitudes(np.zeros(conditions[0].shape[1:]))
        # Every leg is to come to rest by the same share, but for those that nearly do so anyway.
        scale = np.maximum(before.max(axis=1), _LOUD * before.max())
        scale[:-1] *= _PASSING
        size = np.repeat(scale, [len(v) for v in vibration])
        self._E = window.whitened(np.concatenate(conditions)) / size[:, None]
        self._v, self._groups = np.concatenate(vibration) / size, before.size
        self._rows = len(size) // before.size
        gram, weight, best = self._E @ self._E.T, np.ones(before.size), np.inf
        for _ in range(_REWEIGHTINGS):
            softened = np.diag(_JERK_WEIGHT / np.repeat(weight, self._rows))
            largest = tool_amplitudes(
                self._v - gram @ np.linalg.solve(gram + softened, self._v), self._groups
            )
            if largest.max() < best:
                best, self.weight = largest.max(), weight
            weight = _reweighted(weight, largest)
        self.unbounded = self.least_squares(self.weight)

    def relative(self, y: FloatArray) -> FloatArray:
        """Amplitudes with a change `y` (s d,), as shares of the largest of before."""
        return tool_amplitudes(self._v + self._E @ y, self._groups)

    def least_squares(self, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The change y (s d,) of the least weighted squares and jerk, and a factor of its metric."""
        W = np.repeat(weight, self._rows)
        factor = np.linalg.cholesky((self._E.T * W) @ self._E + _JERK_WEIGHT * np.eye(self._E.shape[1]))
        return -linalg.cho_solve((factor, True), self._E.T @ (W * self._v)), factor


def _reweighted(weight: FloatArray, largest: FloatArray) -> FloatArray:
    """Weights that grow with amplitudes, of mean 1."""
    return np.maximum(weight * largest / (weight @ largest) * len(weight), _LEAST_WEIGHT)
