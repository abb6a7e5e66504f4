"""Sway of the tool while the joints move: small vibrations about the moving equilibrium.

With the elastic coordinates at equilibrium u_s(q(t)) and w what is added, to first order in w

    M w'' + D w' + K w = -f,    f = inertial loads of the motion (q, u_s)(t) + D u_s',

where M and K change with the posture. It is integrated by Newmark's method, for
several factors on the stiffness at once: f is that of the stated stiffness. A force
that sets in finds the arm in its equilibrium without it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from scipy.spatial.distance import pdist

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import arm_modes, linearised, newmark
from cmbot.elastic.sag import Sag, TooSoftError
from cmbot.trajectory import QuinticTrajectory

SETTLE_S = 2.0
"""How long a tool is watched after the stop, as simulated by default, s."""

# Longest time between postures at which matrices are computed, s, and postures at most.
_MAX_MATRIX_INTERVAL_S, _MAX_MATRIX_POSTURES = 0.15, 120
# Steps in a period of the slowest mode, and steps at most.
_STEPS_PER_PERIOD, _MAX_TIME_STEPS = 24, 6000
# Periods of the slowest mode in which a force sets in that is to sway the tool hardly at all.
_RAMP_PERIODS = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Sway:
    """Displacements of the tool beside its sag.

    Attributes
    ----------
    t : (N,), s
    tool : (F, N, 3), m
        In W, for each factor on the stiffness.
    """

    t: FloatArray
    tool: FloatArray

    @cached_property
    def largest(self) -> tuple[float, float]:
        """Of a stroke: the largest sway at work, and the largest swing in the time after it, m."""
        after = self.t >= self.t[-1] - SETTLE_S
        size = float(np.linalg.norm(self.tool[:, ~after], axis=2).max())
        return size, max(float(pdist(tool[after]).max()) for tool in self.tool)

    def of_legs(self, times: FloatArray) -> FloatArray:
        """Largest sway (L,), m, from each of L + 1 times to the next; after the last one the last leg's."""
        size = np.linalg.norm(self.tool, axis=2).max(axis=0)
        return np.maximum.reduceat(size, np.searchsorted(self.t, times[:-1]))


def sway_along(
    arm: ElasticArm,
    motion: Callable[[FloatArray, int], FloatArray],
    duration: float,
    damping: float,
    factors: Sequence[float] = (1.0,),
    steps: int = _STEPS_PER_PERIOD,
    sets_in: bool = False,
) -> Sway:
    """Return the sway of an arm's tool along a motion that begins and ends at rest.

    Parameters
    ----------
    arm : ElasticArm
    motion : callable
        From times (N,), s, and an order of derivative to joint positions and their derivatives (N, n).
    duration : float, s
    damping : float
        Ratio of every mode.
    factors : sequence of float
        F factors on all stiffness.
    steps : int
        Of time, for each period of the slowest mode: motions whose acceleration jumps need twice as many.
    sets_in : bool
        The process force sets in at once when the motion begins, or in `Robot.tool_ramp` seconds before; it
        was always there otherwise.
    """
    count = int(np.clip(np.ceil(duration / _MAX_MATRIX_INTERVAL_S), 4, _MAX_MATRIX_POSTURES))
    knots = np.linspace(0.0, duration, count + 1)
    q = motion(knots, 0)
    at = linearised(arm, q)
    modes = arm_modes(arm, q[count // 2])
    modal = modes.damping(damping)
    D = modal + arm.damping
    period = 1.0 / float(modes.frequencies[0])
    number = int(np.clip(np.ceil(duration / period * steps), 2 * count, _MAX_TIME_STEPS))
    t = np.linspace(0.0, duration, number + 1)
    du = np.einsum("kij,kj->ki", at.sag_slope, motion(knots, 1))
    still = QuinticTrajectory(t=knots, q=at.u, v=du, a=np.gradient(du, knots, axis=0))
    loads = _inertial_loads(arm, t, motion, still) + still.evaluate(t, 1) @ D.T
    place = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, count - 1)
    share = ((t - knots[place]) / (knots[place + 1] - knots[place]))[:, None, None]
    # Matrices of the middle of an interval hold for all of it.
    M, K = (0.5 * (each[:-1] + each[1:])[:, None] for each in (at.mass, at.stiffness))
    K = K + (np.array(factors) - 1.0)[:, None, None] * arm.stiffness
    require_bearing(K, factors)
    start, before, loads, at_time = np.zeros((len(factors), len(D))), 0, -loads, place
    if sets_in and arm.robot.pushed:
        lacks = at.stiffness[0] @ (Sag(arm.tool_off).equilibria(q[:1])[0][0] - at.u[0])
        # A softer arm is moved by more.
        start = np.linalg.solve(K[0], lacks)
        before = int(np.ceil(arm.robot.tool_ramp / t[1]))
        set_in = arm.robot.force_share(arm.robot.tool_ramp - t[1] * np.arange(before, 0, -1))
        loads = np.concatenate([(1 - set_in)[:, None] * lacks, loads])
        at_time = np.concatenate([np.zeros(before, dtype=np.intp), place])
    # Modes keep their ratio: their frequencies go with the root of the stiffness.
    each = np.sqrt(factors)[:, None, None] * modal + arm.damping
    w = newmark(M, each, K, loads[:, None], at_time[:, None], float(t[1]), start)[0][before:]
    lever = (1 - share) * at.lever[place] + share * at.lever[place + 1]
    return Sway(t=t, tool=(w[:, 0] @ lever.transpose(0, 2, 1)).transpose(1, 0, 2))


def stroke_sway(
    arm: ElasticArm,
    trajectory: QuinticTrajectory,
    share: float,
    steps: int = _STEPS_PER_PERIOD,
    *,
    sets_in: bool = True,
) -> Sway:
    """Return the sway along a stroke, and for `SETTLE_S` after it, from its begin.

    Parameters
    ----------
    arm : ElasticArm
    trajectory : QuinticTrajectory
    share : float
        By which all stiffness is less, as stated, and more.
    steps, sets_in
        As of `sway_along`.
    """
    begin, end = trajectory.t[0], trajectory.t[-1]

    def motion(t: FloatArray, order: int) -> FloatArray:
        x = trajectory.evaluate(np.minimum(begin + t, end), order)
        if order:
            x[begin + t > end] = 0.0
        return x

    factors, damping = (1 - share, 1.0, 1 + share), arm.robot.damping_ratio
    return sway_along(arm, motion, float(end - begin) + SETTLE_S, damping, factors, steps, sets_in)


def ramped(arm: ElasticArm, q: FloatArray) -> ElasticArm:
    """Return the arm with a process force that sets in slowly: in two periods of the slowest mode.

    That keeps 3 % of what the force does in posture `q` (n,) where it sets in at once.
    """
    seconds = _RAMP_PERIODS / float(arm_modes(arm, q).frequencies[0])
    return replace(arm, robot=replace(arm.robot, tool_ramp=float(np.ceil(10 * seconds) / 10)))


def require_bearing(stiffness: FloatArray, factors: Sequence[float]) -> None:
    """Refuse stiffnesses (..., F, f, f), with the loads' own, that do not bear the arm: a `TooSoftError`."""
    symmetric = 0.5 * (stiffness + stiffness.swapaxes(-1, -2))
    try:
        np.linalg.cholesky(symmetric)
    except np.linalg.LinAlgError as error:
        factor = factors[int(np.linalg.eigvalsh(symmetric)[..., 0].argmin()) % len(factors)]
        got = f"a posture from which the arm topples with {factor:.0%} of its stiffness (stiffness_share)"
        raise TooSoftError("sway", "factors", got, "an arm and a base that are stiff enough") from error


def _inertial_loads(
    arm: ElasticArm, t: FloatArray, motion: Callable[[FloatArray, int], FloatArray], still: QuinticTrajectory
) -> FloatArray:
    """Loads (N, f) on the elastic coordinates by the motion, less those at rest."""
    # Without gravity what is at rest has no loads.
    model, data = arm.model.copy(), arm.model.createData()
    model.gravity = pin.Motion.Zero()
    q, v, a = (motion(t, order) for order in range(3))
    u, du, ddu = (still.evaluate(t, order) for order in range(3))
    x, dx, ddx = arm.configuration(q, u), arm.rates(v, du), arm.rates(a, ddu)
    loads = np.empty_like(u)
    for k in range(len(t)):
        loads[k] = pin.rnea(model, data, x[k], dx[k], ddx[k])[arm.elastic]
    return np.asarray(loads + ddu @ arm.added_mass.T)
