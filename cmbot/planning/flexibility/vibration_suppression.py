"""Vibration suppression: the elastic modes are brought to rest where the tool comes to rest.

Guardrail and links answer the joints' motion as a linear system whose matrices change slowly with the
posture. With y what they move beyond the sag and beyond what the accelerations bend quasi-statically,

    M(t) y'' + D y' + K(t) y = M K^-1 B(t) snap(t),    B = M_fa + M_ff du_sag/dq

so the first modes' displacement and velocity at the end of a leg are linear in the joints' snap, and with it
in the splines' coefficients. Of all changes that bring them to zero at every end of a leg the one with the
least mean squared jerk is taken. Via-points, and C3 at the knots, are kept.

A long path is divided into windows of a few legs: splines with support in two of them are not changed, so
that every window is a small problem of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import linalg, sparse

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.elastic.arm import ElasticArm
from cmbot.optimization import (
    OBJECTIVE,
    ConstraintSet,
    LeastChange,
    Separation,
    find_violations,
    least_distance,
    linearize,
)
from cmbot.planning.flexibility.leg_vibration import LegVibration
from cmbot.planning.torque import Optimised, TorqueProblem
from cmbot.trajectory import SUPPORT, QuinticTrajectory, SplineSpace

__all__ = ["Leg", "VibrationSuppression", "Window", "legs_by_window", "suppress_vibration"]

# Rounds at most, and constraints at most that are added in each round for each window.
_ROUNDS, _MOST_SITES = 12, 400
# Constraints are kept this many tolerances inside their bounds.
_INSIDE = 1.0
# Shares of the last change that are tried then, the largest first; the peak may rise by this share at most.
_SHARES, _PEAK_RISE = (0.75, 0.5, 0.25), 1e-6
# Most segments of a window of several legs; windows with fewer than the second number take one more leg.
_MOST, _FEWEST = 64, 12
# By how much times may miss their knots, s.
_SAME_TIME = 1e-9

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
        For each leg, of the change that would take all of their vibration at its end away; 0 where every
        change broke a bound. Short legs that follow on one another have theirs in common.
    before, after : float, m
        Amplitude of the tool that these modes leave at the end of the motion, as predicted, without and with
        the change.
    """

    modes: int
    shares: tuple[float, ...]
    before: float
    after: float

    @property
    def share(self) -> float:
        """Mean of the legs' shares."""
        return sum(self.shares) / len(self.shares)


def suppress_vibration(
    arm: ElasticArm, problem: TorqueProblem, optimised: Optimised
) -> tuple[Optimised, VibrationSuppression | None]:
    """Bring the first elastic modes to rest at the ends of the legs.

    The trajectory goes on keeping the bounds of `problem`; where no change keeps them, it stays what it was.
    So it does, and nothing is said of its vibration, where the time is over before that is predicted.
    """
    context, trajectory, t = problem.context, optimised.trajectory, problem.space.t
    modes = context.options.quiet_modes
    groups = legs_by_window(problem.space, context.task.path.leg_times)
    windows = [Window(problem, group) for group in groups]
    ends = [(window, leg) for window, group in zip(windows, groups, strict=True) for leg in group]
    for window, (first, last) in context.reporter.each("predicting the vibration of every leg", ends):
        if context.reporter.expired():
            return optimised, None
        leg = LegVibration(arm, trajectory, t[first], t[last], modes)
        window.bring_to_rest(leg, trajectory)
    context.reporter.step("bringing the slowest vibrations to rest")
    changed, shares = _Search(problem, trajectory, windows).changed()
    before, after = (leg.tool_amplitude(leg.vibration(x)) for x in (trajectory, changed))
    return (
        replace(optimised, trajectory=changed),
        VibrationSuppression(
            modes=modes,
            shares=tuple(share for share, group in zip(shares, groups, strict=True) for _ in group),
            before=before,
            after=after,
        ),
    )


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

    def bring_to_rest(self, leg: LegVibration, trajectory: QuinticTrajectory) -> None:
        """Take the vibration away that `trajectory` leaves at the end of one of the legs."""
        snap = (self._space.design(leg.times, 4) @ self._basis).T
        self._conditions += [snap @ leg.weights[:, c] for c in range(leg.weights.shape[1])]
        self._vibration.append(leg.vibration(trajectory))

    def change(self, rows: sparse.csr_array, room: FloatArray) -> LeastChange | None:
        """Change the coefficients, X (s, d), with the least jerk; None where no change keeps to the room.

        `rows` (K, (n - 4) d) are derivatives of what is bounded by all coefficients, the joints of each in
        turn; `room` (K,) is by how much these may grow.
        """
        s, d = len(self.coefficients), len(self._jerk)
        if s == 0:
            return None
        own = rows[:, (self.coefficients[:, None] * d + np.arange(d)).ravel()].toarray()
        E = self._whitened(np.stack(self._conditions))
        found = least_distance(
            E, -np.concatenate(self._vibration), self._whitened(own.reshape(-1, s, d)), room
        )
        if found is None:
            return None
        X = linalg.solve_triangular(self._factor, found.x.reshape(s, d), lower=True, trans="T") * self._jerk
        return LeastChange(X, found.share)

    def _whitened(self, rows: FloatArray) -> FloatArray:
        """Derivatives (K, s d) by y from those (K, s, d) by X."""
        k, s, d = rows.shape
        by_number = rows.transpose(1, 0, 2).reshape(s, k * d)
        y = linalg.solve_triangular(self._factor, by_number, lower=True).reshape(s, k, d) * self._jerk
        return np.asarray(y.transpose(1, 0, 2).reshape(k, s * d))
