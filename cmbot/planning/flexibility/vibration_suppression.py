"""Vibration suppression: the elastic modes are brought to rest where the tool comes to rest.

Guardrail and links answer the joints' motion as a linear system whose matrices change slowly with the
posture. With y what they move beyond the sag and beyond what the accelerations bend quasi-statically,

    M(t) y'' + D(t) y' + K(t) y = M K^-1 B(t) snap(t),    B = M_fa + M_ff du_sag/dq

so the first modes' displacement and velocity at the end of a leg are linear in the joints' snap, and with it
in the splines' coefficients. Of all changes that bring them to zero at every end of a leg the one with the
least mean squared jerk is taken. Via-points, and C3 at the knots, are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.reading.file_types import Count, NonNegative, Share
from cmbot.common.representation import short_repr
from cmbot.elastic.arm import ElasticArm
from cmbot.optimization import (
    OBJECTIVE,
    ConstraintSet,
    Separation,
    find_violations,
    linearize,
)
from cmbot.planning.flexibility.leg_vibration import (
    ElasticPath,
    LegVibration,
    Uncertainty,
)
from cmbot.planning.flexibility.leg_window import SAME_TIME, Window, legs_by_window
from cmbot.planning.torque import Optimised, TorqueProblem
from cmbot.scene import PlannerOptions
from cmbot.trajectory import QuinticTrajectory

# Rounds at most, and constraints at most that are added in each round for each window.
_ROUNDS, _MOST_SITES = 12, 400
# Earlier linearizations are kept of what was nearer to its bound than this.
_KEPT_LINEARIZATION_SHARE = 0.3
# Where a constraint of the state is violated by less than the first number, a step goes further than to its
# bound by the second share of that: about so much a step leaves, and the next one would leave of the rest.
_SMALL, _FURTHER = 0.1, 0.3
# Shares of the last change that are tried then, the largest first; the peak may rise by this share at most.
_SHARES, _PEAK_RISE = (0.75, 0.5, 0.25), 1e-6
# The largest swing is to fall to this share; an amplitude of the tool below the second number, m, is rest.
_WORTH, _AT_REST = 0.9, 2e-6
# What the prediction misses, as a share of the stiffness.
_PREDICTION_ERROR_SHARE = 0.01
# Factors on the stiffness; longer paths, s, and more modes are predicted in fewer cases.
_MOST_FACTORS, _FEW_FACTORS, _LONG, _MANY = 25, 13, 60.0, 3
# Time before the end of a leg in which vibration was excited that still counts, s.
_MEMORY_S = 20.0 + SAME_TIME
# Of a longer leg only what is excited in so many seconds before its end counts.
_MAX_WINDOW_S = 100.0


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
        a tenth, the change is not made, and all shares are 0.
    """

    modes: Count
    shares: tuple[Share, ...]
    before: NonNegative
    after: NonNegative
    stiffness: tuple[NonNegative, ...] = ()
    load_kg: tuple[float, ...] = ()
    swing_without: tuple[NonNegative, ...] = ()
    swing_with: tuple[NonNegative, ...] = ()

    __repr__ = short_repr

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
    request, trajectory, t = problem.request, optimised.trajectory, problem.space.t
    options, reporter = request.cell.options, request.reporter
    leg_times = request.task.path.leg_times
    few = t[-1] - t[0] > _LONG or options.quiet_modes > _MANY
    uncertainty = _uncertainty(options, arm.robot.payload, _FEW_FACTORS if few else _MOST_FACTORS)
    groups = legs_by_window(problem.space, leg_times)
    windows = [Window(problem, group) for group in groups]
    path = ElasticPath(arm, trajectory)
    ends = [(window, leg) for window, group in zip(windows, groups, strict=True) for leg in group]
    for window, (first, last) in reporter.each("predicting the vibration of every leg", ends):
        if request.deadline.expired():
            return optimised, None
        # What is left of the legs before is still there, but for that of long ago.
        earlier = [time for time in leg_times if window.start <= time + SAME_TIME < t[first]]
        start = min([t[first], *(time for time in earlier if t[last] - time <= _MEMORY_S)])
        start = max(start, t[last] - _MAX_WINDOW_S)
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
    wide = share + _PREDICTION_ERROR_SHARE
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
        self._skipped = np.array([window.amplitude < _AT_REST for window in windows])
        self._here, self._broken = trajectory, 0.0
        self._held, self._earlier = self._held_here(), list[_HalfSpaces]()

    def last_change(self) -> tuple[FloatArray, FloatArray]:
        """No change of the last window's coefficients (s, d), and the one that was found."""
        own = self._X[self._windows[-1].coefficients]
        return np.zeros_like(own), own

    def changed(self) -> tuple[QuinticTrajectory, list[float]]:
        """Return the changed trajectory, and the share of each window's change that it took."""
        unfit = ~self._skipped
        for _ in range(_ROUNDS):
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
        further = np.where(self._held.curved & (value < _SMALL), 1.0 + _FURTHER, 1.0)
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
