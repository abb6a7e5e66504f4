"""Vibration at the end of a leg, linear in the joints' snap, for every stiffness and load that may be."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin
from scipy import linalg

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import Linearised, linearised
from cmbot.trajectory import QuinticTrajectory

__all__ = ["LegVibration", "Uncertainty", "tool_amplitudes"]

# Modes at the start, the middle and the end that together carry the motion in between.
_CARRIERS = 5
# Steps a period of the fastest mode that is suppressed; longest time with the same matrices, s.
_STEPS_A_PERIOD, _MATRICES_EVERY = 40, 0.1
# Damping ratio of the modes that are suppressed, as simulated by default: it hardly matters within a leg.
_DAMPING = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty:
    """What may be other than modelled: every case is a load at the tool and a factor on all stiffness.

    Attributes
    ----------
    loads : tuple of float
        More than the modelled payload, kg; the first is 0.
    factors : tuple of tuple of float
        Of the stiffness, for each load.
    """

    loads: tuple[float, ...] = (0.0,)
    factors: tuple[tuple[float, ...], ...] = ((1.0,),)

    @property
    def cases(self) -> tuple[tuple[float, float], ...]:
        """Every case's factor and load, kg."""
        pairs = zip(self.loads, self.factors, strict=True)
        return tuple((factor, load) for load, factors in pairs for factor in factors)


class LegVibration:
    """How the joints' snap along a leg moves the first modes at its end, the arm at rest where it starts.

    The matrices are those of the postures along `trajectory`; a small change of it hardly changes them. There
    are C cases of the `uncertainty`. `times` (m,), s, are the middles of the steps between the knots `start`
    and `end`, `weights` (m, C 2r, n) those of the snaps at these times in what the modes' displacements, then
    their velocities over omega, move the tool by at the end, m.
    """

    def __init__(
        self,
        arm: ElasticArm,
        trajectory: QuinticTrajectory,
        start: float,
        end: float,
        modes: int,
        uncertainty: Uncertainty,
    ) -> None:
        knots = trajectory.t[(trajectory.t > start - 1e-9) & (trajectory.t < end + 1e-9)]
        edges = _refined(knots, _MATRICES_EVERY)
        q = trajectory.evaluate(np.append(0.5 * (edges[1:] + edges[:-1]), end))
        reduced = [
            _reduced(loaded, at, factor, q[-1], modes)
            for load, factors in zip(uncertainty.loads, uncertainty.factors, strict=True)
            for loaded in [arm.softened(1.0, load) if load else arm]
            for at in [linearised(loaded, q)]
            for factor in factors
        ]
        M, K, KB, momenta, omega, to_tool = (np.stack(each) for each in zip(*reduced, strict=True))
        lengths = np.diff(edges)
        counts = np.ceil(lengths * omega.max() / (2 * np.pi) * _STEPS_A_PERIOD).astype(int)
        each = [
            start + length * (np.arange(n) + 0.5) / n
            for start, length, n in zip(edges[:-1], lengths, counts, strict=True)
        ]
        self.times = np.concatenate(each)
        weights = _weights(M, K, KB, lengths / counts, counts, momenta, omega)
        weights *= np.concatenate([to_tool, to_tool], axis=1)[:, None, :, None]
        cases, m, conditions, n = weights.shape
        self.weights = weights.transpose(1, 0, 2, 3).reshape(m, cases * conditions, n)
        self.cases = cases

    def vibration(self, trajectory: QuinticTrajectory) -> FloatArray:
        """What each mode moves the tool by at the end, for every case (C 2r,), m."""
        return np.asarray(np.einsum("kcj,kj->c", self.weights, trajectory.evaluate(self.times, 4)))


def tool_amplitudes(vibration: FloatArray, cases: int) -> FloatArray:
    """Largest amplitudes of the tool point (cases,), m, when the modes of a `vibration` (C 2r,) coincide."""
    x = vibration.reshape(cases, 2, -1)
    return np.asarray(np.hypot(x[:, 0], x[:, 1]).sum(axis=1))


def _reduced(
    arm: ElasticArm, at: Linearised, factor: float, last: FloatArray, modes: int
) -> tuple[FloatArray, ...]:
    """M (g, k, k), K (g, k, k), K^-1 B (g, k, n) among carriers, then at the end: momenta, omega, to tool.

    The stiffness is that of the springs times `factor`; the equilibrium hardly changes with it.
    """
    stiffness = at.stiffness + (factor - 1) * arm.stiffness
    most = max(_CARRIERS, modes)
    shapes = [_slowest(at.mass[k], stiffness[k], most) for k in (0, len(stiffness) // 2, -1)]
    omega, own = shapes[-1]
    V = np.linalg.qr(np.hstack([each for _, each in shapes]))[0]
    sag_slope = -np.linalg.solve(stiffness, at.weight)
    K = V.T @ stiffness @ V
    KB = np.linalg.solve(K, V.T @ (at.coupling + at.mass @ sag_slope))
    J = _tool_jacobian(arm, last, at.u[-1])
    r = min(modes, len(omega))
    to_tool = np.linalg.norm(J[:, arm.elastic] @ own[:, :r], axis=0)
    M = V.T @ at.mass @ V
    return M[:-1], K[:-1], KB[:-1], V.T @ at.mass[-1] @ own[:, :r], omega[:r], to_tool


def _slowest(mass: FloatArray, stiffness: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """Angular frequencies (k,), ascending, and shapes (f, k) of unit modal mass of the slowest modes."""
    squares, X = linalg.eigh(mass, stiffness)
    squares, X = squares[: -most - 1 : -1], X[:, : -most - 1 : -1]
    moving = squares > 0
    squares, X = squares[moving], X[:, moving]
    return 1 / np.sqrt(squares), X / np.sqrt(squares)


def _weights(
    M: FloatArray,
    K: FloatArray,
    KB: FloatArray,
    steps: FloatArray,
    counts: IntArray,
    momenta: FloatArray,
    omega: FloatArray,
) -> FloatArray:
    """Weights (C, m, 2r, n) of the snaps in every step in the modes' displacements and velocities at the end.

    The adjoint of the implicit midpoint rule, run backwards from the end: one run serves all trajectories.
    The matrices (C, g, ...) are those of g blocks of `counts` (g,) equal steps (g,), s.
    """
    cases, k, r = momenta.shape
    weights = np.empty((cases, int(counts.sum()), 2 * r, KB.shape[3]))
    p, s = np.zeros((cases, k, 2 * r)), np.zeros((cases, k, 2 * r))
    c = 2 * _DAMPING / omega[:, 0, None, None]
    p[..., :r], s[..., r:] = momenta, momenta / omega[:, None, :]
    end = weights.shape[1]
    for block in range(len(counts) - 1, -1, -1):
        h, count = float(steps[block]), int(counts[block])
        # With G = M^-1 K and damping c G, a step back from (p, s) solves (1 - h/2 A)' (x, M y) = (p, s), an
        # equation for y alone, and goes on to (1 + h/2 A)' (x, M y).
        inverse = np.linalg.inv(M[:, block] + (0.5 * c * h + 0.25 * h**2) * K[:, block])
        back = np.concatenate([M[:, block], h * K[:, block]], axis=1) @ inverse
        moved = np.empty((count, cases, k, 2 * r))
        for i in range(count - 1, -1, -1):
            both = back @ (s + 0.5 * h * p)
            moved[i] = both[:, :k]
            p = p - both[:, k:]
            s = 2 * moved[i] - s
        weights[:, end - count : end] = h * (moved.transpose(1, 0, 3, 2) @ KB[:, None, block])
        end -= count
    return weights


def _refined(knots: FloatArray, longest: float) -> FloatArray:
    """The knots, and times between them, so that none are further apart than `longest`."""
    counts = np.ceil(np.diff(knots) / longest * (1 - 1e-9)).astype(int)
    pieces = [
        np.linspace(start, end, count, endpoint=False)
        for (start, end), count in zip(pairwise(knots), counts, strict=True)
    ]
    return np.concatenate([*pieces, knots[-1:]])


def _tool_jacobian(arm: ElasticArm, q: FloatArray, u: FloatArray) -> FloatArray:
    """Jacobian (3, n + f) of the bent arm's tool point."""
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    configuration = arm.configuration(q, u)
    J = pin.computeFrameJacobian(arm.model, arm.model.createData(), configuration, arm.tool_frame_id, world)
    return np.asarray(J[:3])
