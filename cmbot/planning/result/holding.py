"""What the feet would bear in an emergency stop."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.hold import AdhesionPeak
from cmbot.planning.result.plan import Plan
from cmbot.robot import Dynamics, Robot

# States of a segment in which a stop is looked at.
_STATES = 200
# Arms with more joints are stopped with all of them at once alone.
_MOST_JOINTS = 8


def emergency_stop(plan: Plan) -> AdhesionPeak | None:
    """Return the largest adhesion needed where joints stop with their largest accelerations.

    At states along the job, whichever of the moving joints stop at that moment; the tool's force acts on
    while the tool is on.

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
    for segment in plan.job.segments:
        robot: Robot = plan.robot if segment.kind == "stroke" else plan.robot.tool_off
        t = np.linspace(segment.trajectory.t[0], segment.trajectory.t[-1], _STATES)
        q, v, _ = segment.trajectory.states(t)
        at = Dynamics(robot).wrench_derivatives(q, v, np.zeros_like(q))
        stops = -np.sign(v) * robot.limits.acceleration
        each = np.einsum("kin,kn->kni", at.d_a, stops)
        wrench = at.value[:, None] + _which(robot.dof) @ each
        yield wrench.reshape(-1, 6), np.repeat(segment.begin + t, wrench.shape[1])


def _which(joints: int) -> FloatArray:
    """Which joints stop, (k, n): every combination, or all of very many."""
    if joints > _MOST_JOINTS:
        return np.ones((1, joints))
    return np.array(list(product((0.0, 1.0), repeat=joints)))
