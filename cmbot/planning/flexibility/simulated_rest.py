"""How the tool swings after the stop, simulated for every stiffness and load that may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial.distance import pdist

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.generalized_alpha import ElasticSystem, GeneralizedAlpha
from cmbot.elastic.modes import arm_modes
from cmbot.trajectory import QuinticTrajectory

__all__ = ["swing_at_rest"]

# Damping ratio of every mode, step, s, and the time after the stop, s, of which each such time is looked at.
_DAMPING, _STEP, _SETTLE, _OUTPUT = 0.01, 0.005, 1.0, 0.01
# Motion before the stop that is simulated, s: at 1 % damping what was before has died away.
_MOTION = 30.0


@dataclass(frozen=True)
class _Piece:
    """A trajectory from `start`, s, on."""

    trajectory: QuinticTrajectory
    start: float

    @property
    def duration(self) -> float:
        return float(self.trajectory.t[-1]) - self.start

    def states(self, times: FloatArray, /) -> tuple[FloatArray, FloatArray, FloatArray]:
        q, v, a = (self.trajectory.evaluate(self.start + np.asarray(times), order) for order in range(3))
        return q, v, a


@dataclass(frozen=True)
class _Held:
    """A posture that is held."""

    q: FloatArray
    duration: float

    def states(self, times: FloatArray, /) -> tuple[FloatArray, FloatArray, FloatArray]:
        still = np.zeros((len(times), len(self.q)))
        return self.q + still, still, still


def swing_at_rest(arm: ElasticArm, trajectory: QuinticTrajectory, leg_times: FloatArray) -> float:
    """Return the largest distance between two positions of the tool in the second after the stop, m.

    A long motion is simulated from the start of one of its legs, or from 30 s before the stop.
    """
    late = leg_times[leg_times >= trajectory.t[-1] - _MOTION]
    first, last = float(trajectory.t[0]), float(trajectory.t[-1])
    start = float(late[0]) if len(late) > 1 else max(first, last - _MOTION)
    piece = _Piece(trajectory, start)
    modes = arm_modes(arm, trajectory.evaluate(np.array([start]))[0])
    system = ElasticSystem.of(arm, modes.damping(_DAMPING) + arm.damping)
    integrator = GeneralizedAlpha(system, step=_STEP, rho_inf=0.8, corrections=2, tolerance=1e-8)
    held = _Held(trajectory.q[-1], _SETTLE)
    motion = integrator.run([piece, held], modes.u, np.zeros_like(modes.u))
    after = motion.t >= piece.duration
    some = slice(None, None, round(_OUTPUT / _STEP))
    model, data = arm.model, arm.model.createData()
    points = []
    for configuration in arm.configuration(motion.joints[after][some], motion.u[after][some]):
        pin.forwardKinematics(model, data, configuration)
        points.append(pin.updateFramePlacement(model, data, arm.tool_frame_id).translation.copy())
    return float(pdist(np.array(points)).max())
