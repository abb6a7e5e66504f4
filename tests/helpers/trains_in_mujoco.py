"""Trains over a span, by another way throughout: the beam's equation by an integrator, the arm in MuJoCo."""

from __future__ import annotations

import numpy as np
from elastic_in_mujoco import TOOL, FloatArray, Twin
from scipy.integrate import solve_ivp

from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import arm_modes
from cmbot.excitation.trains import Span, Train

_MODES, _STEP, _EVERY = 5, 1e-3, 5


def deck_of(span: Span, train: Train, speed: float, t: FloatArray) -> FloatArray:
    """The deck's acceleration (N, 3), m/s2, under axles that move: each mode's equation, integrated."""
    n = np.arange(1, _MODES + 1)
    w = 2 * np.pi * span.first * n**2
    shape = np.sin(n * np.pi * span.at / span.length)

    def force(time: float) -> FloatArray:
        way = speed * time - train.axles
        way, loads = way[(way >= 0) & (way <= span.length)], train.loads[(way >= 0) & (way <= span.length)]
        return 2 / (span.mass * span.length) * (np.sin(np.outer(n, way) * np.pi / span.length) @ loads)

    def acceleration(time: float, y: FloatArray) -> FloatArray:
        return force(time) - 2 * span.damping * w * y[_MODES:] - w**2 * y[:_MODES]

    def rates(time: float, y: FloatArray) -> FloatArray:
        return np.concatenate([y[_MODES:], acceleration(time, y)])

    y = solve_ivp(rates, (0.0, t[-1]), np.zeros(2 * _MODES), t_eval=t, rtol=1e-6, atol=1e-10, max_step=4e-3).y
    down = np.array([shape @ acceleration(time, state) for time, state in zip(t, y.T, strict=True)])
    return np.outer(down, [0.0, 0.0, -1.0])


def passed(
    arm: ElasticArm, q: FloatArray, damping: float, span: Span, train: Train, speed: float, timestep: float
) -> tuple[float, float]:
    """Largest displacement of the tool, m, and torque about O0 that is added, Nm, the joints at `q`."""
    modes = arm_modes(arm, q)
    D = modes.damping(damping) + arm.damping
    steps = int((span.passage(train, speed) + 1.0) / timestep)
    coarse = np.arange(0.0, steps * timestep + 2 * _STEP, _STEP)
    deck = deck_of(span, train, speed, coarse)

    def ground(t: FloatArray) -> FloatArray:
        return np.stack([np.interp(t, coarse, axis) for axis in deck.T], axis=1)

    def still(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        held = np.tile(q, (len(t), 1))
        return held, np.zeros_like(held), np.zeros_like(held)

    twin = Twin(arm, timestep=timestep)
    base = arm.elastic[arm.springs["base", ""]]
    at = arm.springs["base", ""]

    def seen() -> FloatArray:
        """Tool, and the base's displacements, rates and accelerations."""
        data = twin.data
        return np.concatenate([data.site(TOOL).xpos, data.qpos[base], data.qacc[base]])

    rows = twin.drive(still, modes.u, steps, _EVERY, ground, D, seen)
    t = timestep * _EVERY * np.arange(len(rows))
    tool, u, a = rows[:, :3], rows[:, 3:9], rows[:, 9:]
    shaken = ground(t) @ np.eye(3, 6) + a
    wrench = (u - modes.u[at]) @ arm.base.stiffness + shaken @ arm.base.mass
    moved = np.linalg.norm(tool - tool[0], axis=1)
    return float(moved.max()), float(np.linalg.norm(wrench[:, 3:], axis=1).max())
