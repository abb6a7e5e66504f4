"""Vibration at the end of a leg, linear in the joints' snap."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import ArmModes, arm_modes, linearised
from cmbot.trajectory import QuinticTrajectory

__all__ = ["LegVibration"]

# Modes at either end of a leg that together carry the motion in between.
_CARRIERS = 8
# Steps a period of the fastest mode that is suppressed; longest time between evaluations of the matrices, s.
_STEPS_A_PERIOD, _MATRICES_EVERY = 60, 0.1
# Steps whose matrices are held at a time.
_TOGETHER = 500
# Damping ratio of the modes that are suppressed, as simulated by default: it hardly matters within a leg.
_DAMPING = 0.01


class LegVibration:
    """How the joints' snap along a leg moves the first modes at its end, the arm at rest where it starts.

    The matrices are those of the postures along `trajectory`; a small change of it hardly changes them.
    `times` (m,), s, are the middles of the steps between the knots `start` and `end`, `weights` (m, 2r, n)
    those of the snaps at these times in the modes' displacements and velocities at the end.
    """

    def __init__(
        self, arm: ElasticArm, trajectory: QuinticTrajectory, start: float, end: float, modes: int
    ) -> None:
        postures = trajectory.evaluate(np.array([start, end]))
        first, last = (arm_modes(arm, q) for q in postures)
        r = min(modes, last.shapes.shape[1])
        self._to_tool = _tool_motion(arm, postures[1], last)[:, :r]
        omega = 2 * np.pi * last.frequencies[:r]
        knots = trajectory.t[(trajectory.t > start - 1e-9) & (trajectory.t < end + 1e-9)]
        edges = _steps(knots, 2 * np.pi / omega.max() / _STEPS_A_PERIOD)
        self.times = 0.5 * (edges[1:] + edges[:-1])
        V = np.linalg.qr(np.hstack([first.shapes[:, :_CARRIERS], last.shapes[:, :_CARRIERS]]))[0]
        momenta = V.T @ last.mass @ last.shapes[:, :r]
        self.weights = _weights(
            *_matrices(arm, trajectory, V, start, end), self.times, np.diff(edges), momenta, omega
        )

    def vibration(self, trajectory: QuinticTrajectory) -> FloatArray:
        """Displacements of the modes at the end, then their velocities over omega, (2r,), kg^(1/2) m."""
        return np.asarray(np.einsum("kcj,kj->c", self.weights, trajectory.evaluate(self.times, 4)))

    def tool_amplitude(self, vibration: FloatArray) -> float:
        """Largest amplitude of the tool point, m, when these vibrations coincide."""
        amplitude = np.hypot(*vibration.reshape(2, -1))
        return float(np.linalg.norm(self._to_tool, axis=0) @ amplitude)


def _matrices(
    arm: ElasticArm, trajectory: QuinticTrajectory, V: FloatArray, start: float, end: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times (g,), and there M (g, k, k), K (g, k, k) and K^-1 B (g, k, n) among the carriers `V` (f, k)."""
    grid = np.linspace(start, end, max(8, int(np.ceil((end - start) / _MATRICES_EVERY)) + 1))
    at = linearised(arm, trajectory.evaluate(grid))
    sag_slope = -np.linalg.solve(at.stiffness, at.weight)
    K = V.T @ at.stiffness @ V
    KB = np.linalg.solve(K, V.T @ (at.coupling + at.mass @ sag_slope))
    return grid, V.T @ at.mass @ V, K, np.asarray(KB)


def _weights(
    grid: FloatArray,
    M: FloatArray,
    K: FloatArray,
    KB: FloatArray,
    times: FloatArray,
    steps: FloatArray,
    momenta: FloatArray,
    omega: FloatArray,
) -> FloatArray:
    """Weights (m, 2r, n) of the snaps at `times` in the modes' displacements and velocities at the end.

    The adjoint of the implicit midpoint rule, run backwards from the end: one run serves all trajectories.
    """
    k, r = momenta.shape
    lower = np.clip(np.searchsorted(grid, times) - 1, 0, len(grid) - 2)
    share = (times - grid[lower]) / (grid[lower + 1] - grid[lower])
    weights = np.empty((len(times), 2 * r, KB.shape[2]))
    p, s, c = np.zeros((k, 2 * r)), np.zeros((k, 2 * r)), 2 * _DAMPING / omega[0]
    p[:, :r], s[:, r:] = momenta, momenta / omega
    for last in range(len(times), 0, -_TOGETHER):
        some = slice(max(last - _TOGETHER, 0), last)
        h, at, b = steps[some], lower[some], share[some, None, None]
        M_h, K_h, KB_h = ((1 - b) * X[at] + b * X[at + 1] for X in (M, K, KB))
        # With G = M^-1 K and damping c G, a step back from (p, s) solves (1 - h/2 A)' (x, M y) = (p, s), an
        # equation for y alone, and goes on to (1 + h/2 A)' (x, M y).
        inverse = np.linalg.inv(M_h + (0.5 * c * h + 0.25 * h**2)[:, None, None] * K_h)
        moved = np.empty((len(h), k, 2 * r))
        for i in range(len(h) - 1, -1, -1):
            y = inverse[i] @ (s + 0.5 * h[i] * p)
            moved[i] = M_h[i] @ y
            p = p - h[i] * (K_h[i] @ y)
            s = 2 * moved[i] - s
        weights[some] = h[:, None, None] * (moved.transpose(0, 2, 1) @ KB_h)
    return weights


def _steps(knots: FloatArray, longest: float) -> FloatArray:
    """Edges of steps, none longer than `longest`, that end at every knot: snap jumps there."""
    counts = np.ceil(np.diff(knots) / longest).astype(int)
    pieces = [
        np.linspace(start, end, count, endpoint=False)
        for (start, end), count in zip(pairwise(knots), counts, strict=True)
    ]
    return np.concatenate([*pieces, knots[-1:]])


def _tool_motion(arm: ElasticArm, q: FloatArray, modes: ArmModes) -> FloatArray:
    """Motion (3, k) of the tool point in each mode."""
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    configuration = arm.configuration(q, modes.u)
    J = pin.computeFrameJacobian(arm.model, arm.model.createData(), configuration, arm.tool_frame_id, world)
    return np.asarray(J[:3, arm.elastic] @ modes.shapes)
