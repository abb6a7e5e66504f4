"""Vibration at the end of a leg, linear in the joints' snap, for all stiffnesses of an interval."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise

import numpy as np
import pinocchio as pin

from cmbot.accuracy.sway import require_bearing
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import Linearised, linearised, normal_modes
from cmbot.trajectory import QuinticTrajectory

# Modes at the start, the middle and the end that together carry the motion in between.
_SAMPLED_MODES_PER_LEG = 3
# Steps a period of the fastest mode that is suppressed; longest time with the same matrices, s.
_STEPS_A_PERIOD, _MATRICES_EVERY = 40, 0.25


class ElasticPath:
    """An arm along a trajectory: its matrices about the equilibria.

    Legs that overlap share them. What lies before the times asked for last is forgotten.
    """

    def __init__(self, arm: ElasticArm, trajectory: QuinticTrajectory) -> None:
        self.arm, self.trajectory = arm, trajectory
        self._known = dict[float, tuple[FloatArray, ...]]()

    def at(self, times: FloatArray) -> tuple[Linearised, FloatArray]:
        """Return the arm linearised at ascending `times` (g,), s, and its forces as by `_gyroscopic`."""
        q, v = (self.trajectory.evaluate(times, order) for order in range(2))
        for time in [time for time in self._known if time < times[0]]:
            del self._known[time]
        new = [k for k, time in enumerate(times) if time not in self._known]
        if new:
            at = linearised(self.arm, q[new])
            own = (getattr(at, each.name) for each in fields(at))
            rows = zip(*own, _gyroscopic(self.arm, q[new], at.u, v[new]), strict=True)
            self._known.update(zip(times[new], rows, strict=True))
        stacked = zip(*(self._known[time] for time in times), strict=True)
        *parts, gyroscopic = (np.stack(each) for each in stacked)
        names = (each.name for each in fields(Linearised))
        return Linearised(**dict(zip(names, parts, strict=True))), gyroscopic


class LegVibration:
    """How the joints' snap along a leg moves the first modes at its end, the arm at rest where it starts.

    The matrices are those along the path's trajectory; a small change of that hardly changes them. There are
    C `factors` on the stiffness. From `start` to the knot `end` there are b blocks of equal steps with
    the same matrices. No knot is inside a block: along it the snap of a quintic spline is linear in time, so
    its values at the blocks' ends say all. `times` (2 b,), s, are the middles of each block's first and last
    step, `weights` (2 b, C 2r, n) those of the snaps at these times in what the modes' displacements, then
    their velocities over omega, move the tool by at the end, m.
    """

    def __init__(self, path: ElasticPath, start: float, end: float, modes: int, factors: FloatArray) -> None:
        knots = path.trajectory.t
        later = knots[(knots > start + 1e-9) & (knots < end + 1e-9)]
        edges = _refined(np.append(start, later), _MATRICES_EVERY)
        at, gyroscopic = path.at(np.append(0.5 * (edges[1:] + edges[:-1]), end))
        self._carried = carried = _reduced(path.arm, at, gyroscopic, factors, modes)
        lengths = np.diff(edges)
        least = lengths * carried.omega.max() / (2 * np.pi) * _STEPS_A_PERIOD
        doublings = np.maximum(np.ceil(np.log2(least)), 0).astype(int)
        steps = lengths / 2**doublings
        half = 0.5 * steps
        self.times = np.stack([edges[:-1] + half, edges[1:] - half], axis=1).ravel()
        self._blocks = _blocks(carried, steps, doublings)
        self.cases = len(carried.omega)

    @cached_property
    def weights(self) -> FloatArray:
        """Of the snaps (m, C 2r, n)."""
        weights = _weights(self._carried, self._blocks)
        return weights.reshape(len(self.times), -1, weights.shape[-1])

    def vibration(self, trajectory: QuinticTrajectory) -> FloatArray:
        """What each mode moves the tool by at the end, for every case (C 2r,), m."""
        return np.asarray(np.einsum("kcj,kj->c", self.weights, trajectory.evaluate(self.times, 4)))


@dataclass(frozen=True, eq=False)
class _Carried:
    """The system among k carriers, for C cases and g + 1 postures, the last of them the end's."""

    mass: FloatArray  # M (C, g + 1, k, k)
    damping: FloatArray  # D (C, g + 1, k, k), with what velocities of the joints add
    stiffness: FloatArray  # K (C, g + 1, k, k)
    response: FloatArray  # K^-1 B (C, g + 1, k, n)
    momenta: FloatArray  # (C, k, r) of the modes at the end
    omega: FloatArray  # (C, r), rad/s
    to_tool: FloatArray  # (C, r): how far a mode moves the tool


def tool_amplitudes(vibration: FloatArray, cases: int) -> FloatArray:
    """Largest amplitudes of the tool point (cases,), m, when the modes of a `vibration` (C 2r,) coincide."""
    x = vibration.reshape(cases, 2, -1)
    return np.asarray(np.hypot(x[:, 0], x[:, 1]).sum(axis=1))


def _reduced(
    arm: ElasticArm, at: Linearised, gyroscopic: FloatArray, factors: FloatArray, modes: int
) -> _Carried:
    """The system with `factors` (C,) on the stiffness.

    The stiffness is that of the springs times a factor; the equilibrium hardly changes with it, nor do the
    shapes of the modes: all cases have the same carriers, which the modes of each are made of.
    """
    most, last = max(_SAMPLED_MODES_PER_LEG, modes), len(at.mass) - 1
    shapes = [normal_modes(at.mass[k], at.stiffness[k])[1][:, :most] for k in (0, (last + 1) // 2, last)]
    V = np.linalg.qr(np.hstack(shapes))[0]
    by_case = factors[:, None, None, None]
    M, K = V.T @ at.mass @ V, V.T @ at.stiffness @ V + (by_case - 1) * (V.T @ arm.stiffness @ V)
    require_bearing(K[:, -1], factors.tolist())
    own = [normal_modes(M[-1], each) for each in K[:, -1]]
    r = min(modes, *(len(omega) for omega, _ in own))
    omega, X = np.stack([omega[:r] for omega, _ in own]), np.stack([X[:, :r] for _, X in own])
    D = V.T @ gyroscopic @ V + (2 * arm.robot.damping_ratio / omega[:, 0])[:, None, None, None] * K
    forces = V.T @ at.coupling + V.T @ (at.mass @ at.sag_slope) / by_case
    to_tool = np.linalg.norm(at.lever[-1] @ V @ X, axis=1)
    M = np.broadcast_to(M, (len(factors), *M.shape))
    return _Carried(M, D, K, np.linalg.solve(K, forces), M[:, -1] @ X, omega, to_tool)


def _weights(carried: _Carried, blocks: list[_Block]) -> FloatArray:
    """Weights (2 b, C, 2r, n) of the snaps at the ends of b blocks in how far the modes move the tool.

    The adjoint of the implicit midpoint rule, run backwards from the end: one run serves all trajectories.
    """
    cases, k, r = carried.momenta.shape
    n = carried.response.shape[3]
    weights = np.empty((len(blocks), 2, cases, 2 * r, n))
    # Derivatives of displacements and velocities at the end by (y, y') after the block.
    costate = np.zeros((cases, 2 * k, 2 * r))
    costate[:, :k, :r] = carried.momenta * carried.to_tool[:, None]
    costate[:, k:, r:] = costate[:, :k, :r] / carried.omega[:, None]
    for of_block, (state, push) in zip(weights[::-1], reversed(blocks), strict=True):
        of_block[:] = (push.swapaxes(1, 2) @ costate).reshape(cases, 2, n, 2 * r).transpose(1, 0, 3, 2)
        costate = state.swapaxes(1, 2) @ costate
    return weights.reshape(-1, cases, 2 * r, n)


_Block = tuple[FloatArray, FloatArray]
"""What a block makes of the state before it (C, 2k, 2k), and of its first and last snap (C, 2k, 2n)."""


def _blocks(carried: _Carried, steps: FloatArray, doublings: IntArray) -> list[_Block]:
    """Return the blocks of two `steps` (g,), s, to the `doublings` (g,).

    A snap s that grows by d from step to step moves the carriers along ``G s - H d``; what the state before
    is apart from that is carried on by the m-th power of a step's matrix. With the force ``M r s`` G is
    ``(w, 0)``, ``w = K^-1 M r``, and H is ``((K^-1 D / h + 1/2) w, -w / h)``.
    """
    each = (carried.mass, carried.damping, carried.stiffness, carried.response)
    (M, D, K, r), h = (one[:, : len(steps)] for one in each), steps[:, None, None]
    w, lag = np.split(np.linalg.solve(K, np.concatenate([M @ r, D], axis=3)), [r.shape[3]], axis=3)
    still = np.concatenate([w, np.zeros_like(w)], axis=2).swapaxes(0, 1)
    growing = np.concatenate([lag @ w / h + 0.5 * w, -w / h], axis=2).swapaxes(0, 1)
    states = _midpoint_steps(M, D, K, steps)
    return [_block(*one) for one in zip(states, still, growing, doublings.tolist(), strict=True)]


def _block(A: FloatArray, G: FloatArray, H: FloatArray, doublings: int) -> _Block:
    """The block of steps with the matrix `A` (C, 2k, 2k); `G` and `H` (C, 2k, n) are as in `_blocks`."""
    for _ in range(doublings):
        A = A @ A
    still, growing = np.split(A @ np.concatenate([G, H], axis=2), 2, axis=2)
    by_change = (G - H + growing) / max(2**doublings - 1, 1)
    return A, np.concatenate([-still - by_change, G + by_change], axis=2)


def _midpoint_steps(M: FloatArray, D: FloatArray, K: FloatArray, steps: FloatArray) -> FloatArray:
    """What `steps` (g,), s, of the implicit midpoint rule make of (y, y') (g, C, 2k, 2k).

    Mass, damping and stiffness (C, g, k, k) are those of the posture of each.
    """
    h = steps[:, None, None]
    inverse = np.linalg.inv(M + 0.5 * h * D + 0.25 * h**2 * K)
    # The rate in the middle of the step, by y and y'.
    by_y, by_rate = -0.5 * h * inverse @ K, inverse @ M
    k, one = K.shape[2], np.eye(K.shape[2])
    state = np.empty((len(steps), len(K), 2 * k, 2 * k))
    by_case = state.swapaxes(0, 1)
    by_case[..., :k, :k], by_case[..., :k, k:] = one + h * by_y, h * by_rate
    by_case[..., k:, :k], by_case[..., k:, k:] = 2 * by_y, 2 * by_rate - one
    return state


def _refined(knots: FloatArray, longest: float) -> FloatArray:
    """The knots, and times between them, so that none are further apart than `longest`."""
    counts = np.ceil(np.diff(knots) / longest * (1 - 1e-9)).astype(int)
    pieces = [
        np.linspace(start, end, count, endpoint=False)
        for (start, end), count in zip(pairwise(knots), counts, strict=True)
    ]
    return np.concatenate([*pieces, knots[-1:]])


def _gyroscopic(arm: ElasticArm, q: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Derivatives (g, f, f) of the elastic coordinates' forces by their rates, at joint rates (g, n)."""
    data, still = arm.model.createData(), np.zeros(arm.model.nv)
    block = np.ix_(arm.elastic, arm.elastic)
    rates = arm.rates(v, np.zeros_like(u))
    found = np.empty((*u.shape, u.shape[1]))
    for k, (configuration, rate) in enumerate(zip(arm.configuration(q, u), rates, strict=True)):
        found[k] = pin.computeRNEADerivatives(arm.model, data, configuration, rate, still)[1][block]
    return found
