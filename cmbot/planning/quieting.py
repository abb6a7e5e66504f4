"""Vibration that is left where the tool comes to rest, taken away by the trajectory's own free numbers.

Guardrail and links answer the joints' motion as a linear system whose matrices change slowly with the
posture. With y what they move beyond the sag and beyond what the accelerations bend quasi-statically,

    M(t) y'' + D y' + K(t) y = M K^-1 B(t) snap(t),    B = M_fa + M_ff du_sag/dq

so the first modes' displacement and velocity at the end of a leg are linear in the joints' snap, and with it
in the numbers of the splines. Of all changes that bring them to zero at every end of a leg the one with the
least mean squared jerk is taken. Via-points, and C3 at the knots, stay what they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import linalg, optimize
from scipy.sparse.linalg import splu

from cmbot.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.planning.leg_vibration import LegVibration
from cmbot.planning.optimiser import Optimised
from cmbot.planning.problem import TorqueProblem
from cmbot.planning.setting import Setting
from cmbot.planning.state_functions import States
from cmbot.planning.trajectory import QuinticTrajectory
from cmbot.planning.working_set import WorkingSet, bound_values

__all__ = ["Quieting", "quiet"]

# Share of their own size that is added to the conditions' covariance.
_ALIKE = 1e-5
# Times that a change is worked out anew, and sites of a constraint that are added each time, at most.
_ROUNDS, _MOST_SITES = 12, 400
# Constraints are kept so many tolerances inside their bounds.
_INSIDE = 3.0
# What no number changes has a cost of this size, at most.
_NOTHING = 1e-300
# Shares of the last change that are tried then, the largest first; the peak may rise by this share at most.
_SHARES, _PEAK_RISE = (0.75, 0.5, 0.25), 1e-6


@dataclass(frozen=True, kw_only=True)
class Quieting:
    """What was done about the vibration.

    Attributes
    ----------
    modes : int
        The first so many are brought to rest.
    share : float
        Of the change that would take all of their vibration away; 0 when every change broke a bound.
    before, after : float, m
        Amplitude of the tool that these modes leave at the end of the motion, as predicted, without and with
        the change.
    """

    modes: int
    share: float
    before: float
    after: float


def quiet(
    setting: Setting, arm: ElasticArm, problem: TorqueProblem, optimised: Optimised
) -> tuple[Optimised, Quieting]:
    """Bring the first elastic modes to rest at the ends of the legs.

    Parameters
    ----------
    setting : Setting
    arm : ElasticArm
    problem : TorqueProblem
        Whose bounds the trajectory keeps, and goes on keeping.
    optimised : Optimised

    Returns
    -------
    optimised : Optimised
        With the changed trajectory; what it was, where no change keeps the bounds.
    quieting : Quieting
    """
    trajectory, modes = optimised.trajectory, setting.options.quiet_modes
    ends = setting.teller.each(
        "foreseeing the vibration of every leg", list(pairwise(setting.task.path.leg_times))
    )
    legs = [LegVibration(arm, trajectory, start, end, modes) for start, end in ends]
    setting.teller.step("bringing the slowest vibrations to rest")
    changed, share = _quieted(problem, trajectory, legs)
    before, after = (legs[-1].tool_amplitude(legs[-1].vibration(x)) for x in (trajectory, changed))
    return (
        replace(optimised, trajectory=changed),
        Quieting(modes=modes, share=share, before=before, after=after),
    )


def _quieted(
    problem: TorqueProblem, trajectory: QuinticTrajectory, legs: list[LegVibration]
) -> tuple[QuinticTrajectory, float]:
    """Change a trajectory so that its legs end quietly; return it and the share of the change that it took.

    Newton's method: what a step violates becomes an equation of the next one, which brings it back.
    """
    working, tolerance = WorkingSet(problem), problem.options.constraint_tolerance
    peak = working.add_violated(trajectory, np.inf, tolerance, 1, 0)[2] * (1 + _PEAK_RISE)

    def missing(candidate: QuinticTrajectory) -> float:
        _, worst, new_peak = working.add_violated(candidate, peak, tolerance, 1, _MOST_SITES)
        return max(worst.value, new_peak - peak)

    space = problem.space
    here, z = trajectory, _knot_vector(trajectory)
    X = np.zeros((space.dimension, trajectory.q.shape[1]))
    wanted = _conditions(problem, legs)
    for _ in range(_ROUNDS):
        aims = -np.concatenate([leg.vibration(here) for leg in legs])
        held, values = _held(problem, here, working, peak)
        # To first order around here, but for the change as a whole.
        R = np.stack([*wanted, *held], axis=-1)
        room = -values - _INSIDE * tolerance
        # What is at its bound, not beyond it, may stay there: some of it no number can change.
        room = np.where(values <= tolerance, np.maximum(room, 0.0), room)
        aims = np.append(aims, room) + np.einsum("bjc,bj->c", R, X)
        X = _least_jerk_change(problem, R, aims, len(wanted))
        here = space.trajectory(z + space.basis @ X)
        if missing(here) <= tolerance:
            return here, 1.0
    for share in _SHARES:
        candidate = space.trajectory(z + share * (space.basis @ X))
        if missing(candidate) <= tolerance:
            return candidate, share
    return trajectory, 0.0


def _conditions(problem: TorqueProblem, legs: list[LegVibration]) -> list[FloatArray]:
    """Derivatives (n - 4, d) of every leg's vibration by the splines' numbers."""
    rows: list[FloatArray] = []
    for leg in legs:
        by_number = (problem.space.design(leg.times, 4) @ problem.space.basis).T
        rows += [by_number @ leg.weights[:, c] for c in range(leg.weights.shape[1])]
    return rows


def _held(
    problem: TorqueProblem, trajectory: QuinticTrajectory, working: WorkingSet, peak: float
) -> tuple[list[FloatArray], FloatArray]:
    """Derivatives (n - 4, d) by the splines' numbers of the working set's constraints, and their values."""
    space, d = problem.space, trajectory.q.shape[1]
    rows: list[FloatArray] = []
    values: list[FloatArray] = [np.empty(0)]
    for number, (function, times, component) in enumerate(working.state_sites()):
        if len(times):
            at = function.linearise(States(times, *trajectory.states(times)), component)
            designs = [(space.design(times, order) @ space.basis).toarray() for order in range(3)]
            parts = zip(designs, (at.d_q, at.d_v, at.d_a), strict=True)
            rows += list(sum(D[:, :, None] * by[:, None, :] for D, by in parts))
            values.append(at.value - (peak if number == 0 else 0.0))
    for bound, times, component in working.bound_sites():
        if len(times):
            value, joint, factor = bound_values(bound, times, component, trajectory)
            design = (space.design(times, bound.order) @ space.basis).toarray()
            rows += list(design[:, :, None] * (np.eye(d)[joint] * factor[:, None])[:, None, :])
            values.append(value)
    return rows, np.concatenate(values)


def _least_jerk_change(problem: TorqueProblem, R: FloatArray, aims: FloatArray, equations: int) -> FloatArray:
    """Change X (n - 4, d) of the splines' numbers with the least jerk.

    Of the linear quantities with derivatives `R` (n - 4, d, c), the first `equations` are to change by their
    `aims` (c,), the others by no more than that. Solved for the multipliers, which are few.
    """
    gram, J_C = splu(problem.space.jerk_gram.tocsc()), problem.robot.limits.jerk
    cheapest = np.stack([bound**2 * gram.solve(R[:, joint]) for joint, bound in enumerate(J_C)], axis=1)
    cost = np.einsum("bjc,bjd->cd", R, cheapest)
    # All on one scale; quantities that are nearly the same share their multiplier.
    size = np.sqrt(np.maximum(np.diag(cost), _NOTHING))
    L = np.linalg.cholesky(cost / size[:, None] / size + _ALIKE * np.eye(len(aims)))
    upper = np.where(np.arange(len(aims)) < equations, np.inf, 0.0)
    target = linalg.solve_triangular(L, aims / size, lower=True)
    multipliers = optimize.lsq_linear(L.T, target, bounds=(-np.inf, upper), method="bvls").x
    return np.asarray(cheapest @ (multipliers / size))


def _knot_vector(trajectory: QuinticTrajectory) -> FloatArray:
    return np.stack([trajectory.q, trajectory.v, trajectory.a], axis=1).reshape(-1, trajectory.q.shape[1])
