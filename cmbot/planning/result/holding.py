"""What the feet would bear in an emergency stop."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from threadpoolctl import threadpool_limits

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import TooSoftError
from cmbot.hold import AdhesionPeak, Holding
from cmbot.planning.job import Job
from cmbot.planning.workcell.workcell import bending_arm
from cmbot.robot import Dynamics, Robot
from cmbot.scene import Scene

# States of a segment in which a stop is looked at.
_STATES_PER_SEGMENT = 200
# Arms with more joints are stopped with all of them at once alone.
_MAX_STOPPED_JOINTS = 8
# Of the slowest modes the quickest one of so many decides how much of a short stop reaches the feet.
_SLOW_MODES = 4
# Stops of a segment whose adhesion is computed with gaps: those that need most if no gap may open, in all
# states and in each.
_CANDIDATES, _IN_EACH_STATE = 500, 2


def emergency_stop(scene: Scene, robot: Robot, job: Job) -> AdhesionPeak | None:
    """Return the largest adhesion needed where joints stop with their largest accelerations.

    At states along the job, whichever of the moving joints stop at that moment; the tool's force acts on
    while the tool is on. A joint stops for |v| / a. Of a pulse that is shorter than a sixth of the period
    1 / f of what bends, only 2 sin(pi f |v| / a) reaches the feet.

    Parameters
    ----------
    scene : Scene
    robot : Robot
    job : Job
    """
    holding = robot.holding
    if holding is None or not holding.adhesive:
        return None
    peaks = list[AdhesionPeak]()
    with threadpool_limits(limits=1, user_api="blas"):
        for wrench, t in _stops(scene, robot, job):
            worst = _worst(holding, wrench)
            peaks.append(holding.worst(wrench.reshape(-1, 6)[worst], np.repeat(t, wrench.shape[1])[worst]))
    return max(peaks, key=lambda peak: peak.peak)


def clamp_in_stop(scene: Scene, robot: Robot, job: Job, number: int) -> float:
    """Return the share of its bounds that a clamp would use in such a stop; `number` counts feet from 0."""
    holding = robot.holding
    if holding is None:
        return 0.0
    stops = _stops(scene, robot, job)
    return max(float(holding.use(number, wrench.reshape(-1, 6)).max()) for wrench, _ in stops)


def _worst(holding: Holding, wrench: FloatArray) -> IntArray:
    """The numbers of the stops (N K) of wrenches (N, K, 6) that may need most: see `_CANDIDATES`."""
    pressed = holding.pressed_without_gap(wrench.reshape(-1, 6)).reshape(wrench.shape[:2])
    rows = np.arange(wrench.shape[0])[:, None] * wrench.shape[1]
    in_state = rows + np.argsort(pressed, axis=1)[:, -_IN_EACH_STATE:]
    return np.union1d(in_state.ravel(), np.argsort(pressed, axis=None)[-_CANDIDATES:])


def _stops(scene: Scene, robot_at_work: Robot, job: Job) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Wrenches (N, K, 6) of stops in N states of each segment, and when on the job's clock, (N,), s."""
    frequency = _frequency(scene, robot_at_work, job)
    for segment in job.segments:
        robot = robot_at_work if segment.kind == "stroke" else robot_at_work.tool_off
        t = np.linspace(segment.trajectory.t[0], segment.trajectory.t[-1], _STATES_PER_SEGMENT)
        q, v, _ = segment.trajectory.states(t)
        at = Dynamics(robot).wrench_derivatives(q, v, np.zeros_like(q))
        lasts = np.abs(v) / robot.limits.acceleration
        felt = np.where(6 * frequency * lasts < 1, 2 * np.sin(np.pi * frequency * lasts), 1.0)
        stops = -np.sign(v) * robot.limits.acceleration * felt
        each = np.einsum("kin,kn->kni", at.d_a, stops)
        yield at.value[:, None] + _which(robot.dof) @ each, segment.begin + t


def _frequency(scene: Scene, robot: Robot, job: Job) -> float:
    """Of the modes that a stop moves, Hz, where the arm begins; 1 THz where nothing bends."""
    arm = bending_arm(scene, robot)
    if arm is None:
        return 1e12
    try:
        frequencies = arm_modes(arm, job.segments[0].trajectory.q[0]).frequencies
    except TooSoftError:  # it topples: then nothing is told of its modes
        return 1e12
    return float(frequencies[:_SLOW_MODES].max(initial=0.0)) or 1e12


def _which(joints: int) -> FloatArray:
    """Which joints stop, (k, n): every combination, or all of very many."""
    if joints > _MAX_STOPPED_JOINTS:
        return np.ones((1, joints))
    return np.array(list(product((0.0, 1.0), repeat=joints)))
