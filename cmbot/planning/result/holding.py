"""What the feet would bear in an emergency stop."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import TooSoftError
from cmbot.hold import AdhesionPeak
from cmbot.planning.result.plan import Plan
from cmbot.planning.workcell.workcell import bending_arm
from cmbot.robot import Dynamics, Robot

# States of a segment in which a stop is looked at.
_STATES = 200
# Arms with more joints are stopped with all of them at once alone.
_MOST_JOINTS = 8
# Of the slowest modes the quickest one of so many decides how much of a short stop reaches the feet.
_SLOW_MODES = 4


def emergency_stop(plan: Plan) -> AdhesionPeak | None:
    """Return the largest adhesion needed where joints stop with their largest accelerations.

    At states along the job, whichever of the moving joints stop at that moment; the tool's force acts on
    while the tool is on. A joint stops for |v| / a. Of a pulse that is shorter than a sixth of the period
    1 / f of what bends, only 2 sin(pi f |v| / a) reaches the feet.

    Parameters
    ----------
    plan : Plan
    """
    holding = plan.robot.holding
    if holding is None or not holding.adhesive:
        return None
    return max((holding.worst(*stops) for stops in _stops(plan)), key=lambda peak: peak.peak)


def clamp_in_stop(plan: Plan, number: int) -> float:
    """Return the share of its bounds that a clamp would use in such a stop; `number` counts feet from 0."""
    holding = plan.robot.holding
    return max(float(holding.use(number, wrench).max()) for wrench, _ in _stops(plan)) if holding else 0.0


def _stops(plan: Plan) -> Iterator[tuple[FloatArray, FloatArray]]:
    """The wrenches (N, 6) of stops along each segment of the job, and when on its clock, (N,), s."""
    frequency = _frequency(plan)
    for segment in plan.job.segments:
        robot: Robot = plan.robot if segment.kind == "stroke" else plan.robot.tool_off
        t = np.linspace(segment.trajectory.t[0], segment.trajectory.t[-1], _STATES)
        q, v, _ = segment.trajectory.states(t)
        at = Dynamics(robot).wrench_derivatives(q, v, np.zeros_like(q))
        lasts = np.abs(v) / robot.limits.acceleration
        felt = np.where(6 * frequency * lasts < 1, 2 * np.sin(np.pi * frequency * lasts), 1.0)
        stops = -np.sign(v) * robot.limits.acceleration * felt
        each = np.einsum("kin,kn->kni", at.d_a, stops)
        wrench = at.value[:, None] + _which(robot.dof) @ each
        yield wrench.reshape(-1, 6), np.repeat(segment.begin + t, wrench.shape[1])


def _frequency(plan: Plan) -> float:
    """Of the modes that a stop moves, Hz, where the arm begins; 1 THz where nothing bends."""
    arm = bending_arm(plan.scene, plan.robot)
    if arm is None:
        return 1e12
    try:
        frequencies = arm_modes(arm, plan.job.segments[0].trajectory.q[0]).frequencies
    except TooSoftError:  # it topples: then nothing is told of its modes
        return 1e12
    return float(frequencies[:_SLOW_MODES].max(initial=0.0)) or 1e12


def _which(joints: int) -> FloatArray:
    """Which joints stop, (k, n): every combination, or all of very many."""
    if joints > _MOST_JOINTS:
        return np.ones((1, joints))
    return np.array(list(product((0.0, 1.0), repeat=joints)))
