"""How an arm sways along a leg, and how it swings after it, for many time laws and stiffnesses at once.

Along a joint path q(s), s from 0 to 1, the loads on the elastic coordinates are ``A(s) s.. + B(s) s.^2``
beside those at rest. Among the slowest modes of a few postures

    M(s) w'' + D w' + K(s) w = -(A(s) s.. + B(s) s.^2)

is integrated by Newmark's method, from rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy import linalg

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import linearised, newmark, normal_modes

# Postures of a leg less one; modes of three of them that carry the motion.
_INTERVALS, _CARRIERS = 48, 3
# Steps in a period of the slowest mode, and in a leg at least and at most.
_STEPS_PER_PERIOD, _LEAST_STEPS, _LIMIT_STEPS = 24, 120, 1500


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """What laws make of a leg, the arm at rest before it.

    Attributes
    ----------
    sway : (C, F), m
        Largest distance of the tool from its place at rest, for C laws and F factors on the stiffness.
    swing : (C, F), m
        What the tool moves to and fro by after the leg, where all modes coincide.
    """

    sway: FloatArray
    swing: FloatArray


class LegResponse:
    """An arm along a joint path, reduced to its slowest modes.

    Parameters
    ----------
    arm : ElasticArm
    q : callable
        Postures (N, n) at values (N,) of s, and their derivatives by it.

    Attributes
    ----------
    omega : (k,), rad/s
        Angular frequencies of the slowest modes in the middle of the leg, ascending.
    """

    def __init__(self, arm: ElasticArm, q: Callable[[FloatArray, int], FloatArray]) -> None:
        shares = np.linspace(0.0, 1.0, _INTERVALS + 1)
        posture, first, second = (q(shares, order) for order in range(3))
        at = linearised(arm, posture)
        ends = (0, _INTERVALS // 2, _INTERVALS)
        shapes = [normal_modes(at.mass[k], at.stiffness[k]) for k in ends]
        self.omega = shapes[1][0][:_CARRIERS]
        V = np.linalg.qr(np.hstack([shape[:, :_CARRIERS] for _, shape in shapes]))[0]
        du = np.einsum("kij,kj->ki", at.sag_slope, first)
        ddu = np.gradient(du, shares, axis=0)
        data = arm.model.createData()
        x, dx, ddx = arm.configuration(posture, at.u), arm.rates(first, du), arm.rates(second, ddu)
        speeding, turning = [], []
        for k in range(len(shares)):
            still = pin.computeGeneralizedGravity(arm.model, data, x[k])[arm.elastic].copy()
            moving = [
                pin.rnea(arm.model, data, x[k], v, a)[arm.elastic] - still
                for v, a in ((np.zeros_like(dx[k]), dx[k]), (dx[k], ddx[k]))
            ]
            speeding.append(moving[0] + arm.added_mass @ du[k])
            turning.append(moving[1] + arm.added_mass @ ddu[k])
        self._loads = np.array(speeding) @ V, np.array(turning) @ V
        self._levers = at.lever @ V
        self._mass, self._stiffness = (V.T @ each @ V for each in (at.mass, at.stiffness))
        self._springs, self._damping = V.T @ arm.stiffness @ V, arm.robot.damping_ratio

    def of(
        self,
        laws: Sequence[Callable[[FloatArray, int], FloatArray]],
        seconds: float,
        factors: Sequence[float],
    ) -> Response:
        """Return the response to C laws that take `seconds`, s, with F factors on the stiffness.

        A law is s, or a derivative of it, by the share of the time.
        """
        period = 2 * np.pi / self.omega[0]
        steps = int(np.clip(np.ceil(seconds / period * _STEPS_PER_PERIOD), _LEAST_STEPS, _LIMIT_STEPS))
        u, h = np.linspace(0.0, 1.0, steps + 1), seconds / steps
        share, rate, bend = (np.array([law(u, k) for law in laws]).T / seconds**k for k in range(3))
        place = np.clip((share * _INTERVALS).astype(int), 0, _INTERVALS - 1)
        within = (share * _INTERVALS - place)[..., None]
        A, B = ((1 - within) * of[place] + within * of[place + 1] for of in self._loads)
        levers = (1 - within[..., None]) * self._levers[place] + within[..., None] * self._levers[place + 1]
        more = (np.array(factors) - 1.0)[:, None, None] * self._springs
        M = 0.5 * (self._mass[1:] + self._mass[:-1])[:, None]
        K = 0.5 * (self._stiffness[1:] + self._stiffness[:-1])[:, None] + more
        D = (2 * self._damping / self.omega[0]) * K
        push = -(A * bend[..., None] + B * (rate**2)[..., None])
        w, v = newmark(M, D, K, push, place, h)
        sway = np.linalg.norm(w @ levers.transpose(0, 1, 3, 2), axis=3).max(axis=0)
        return Response(sway=sway, swing=self._swing(w[-1], v, more))

    def _swing(self, w: FloatArray, v: FloatArray, more: FloatArray) -> FloatArray:
        """What modes at the end move the tool by, of displacements and velocities (C, F, k)."""
        swing = np.empty(w.shape[:2])
        for f, stiffer in enumerate(more):
            squares, X = linalg.eigh(self._stiffness[-1] + stiffer, self._mass[-1])
            momenta = self._mass[-1] @ X
            size = np.linalg.norm(self._levers[-1] @ X, axis=0)
            amplitude = np.hypot(w[:, f] @ momenta, v[:, f] @ momenta / np.sqrt(squares))
            swing[:, f] = 2 * amplitude @ size
        return swing
