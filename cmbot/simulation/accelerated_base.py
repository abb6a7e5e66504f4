"""An elastic arm on a base that is shaken: three more driven joints, which carry all others.

Only their acceleration is prescribed; where they are and how fast they go changes nothing of what happens
relative to them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.elastic.generalized_alpha import DrivenMotion, ElasticSystem, ExternalForces

GroundAcceleration = Callable[[FloatArray], FloatArray]
"""The acceleration (N, 3), m/s2, in W, of what an arm stands on, at times (N,), s."""

_AXIS_COUNT = 3


def on_accelerated_base(
    system: ElasticSystem,
    motions: Sequence[DrivenMotion],
    forces: Sequence[ExternalForces],
    ground: GroundAcceleration,
) -> tuple[ElasticSystem, list[DrivenMotion], list[ExternalForces]]:
    """Return a system on a shaken base, its motions one after the other, and the external forces along each.

    Parameters
    ----------
    system : ElasticSystem
        Mass outside its model moves with its first three elastic coordinates, if any.
    motions : sequence of DrivenMotion
    forces : sequence of ExternalForces
        Along each motion.
    ground : callable
    """
    model = pin.Model()
    for axis in "XYZ":
        joint = getattr(pin, f"JointModelP{axis}")()
        last = model.addJoint(model.njoints - 1, joint, pin.SE3.Identity(), f"ground {axis}")
    frame = model.addFrame(pin.Frame("ground", last, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model = pin.appendModel(model, system.model, frame, pin.SE3.Identity())
    model.gravity = system.model.gravity
    coupling = np.zeros((len(system.elastic), _AXIS_COUNT + len(system.driven)))
    coupling[:, :_AXIS_COUNT] = system.added_mass[:, :_AXIS_COUNT]
    shaken = replace(
        system,
        model=model,
        driven=np.concatenate([np.arange(_AXIS_COUNT), system.driven + _AXIS_COUNT]),
        elastic=system.elastic + _AXIS_COUNT,
        added_coupling=coupling,
        external_forces=_shifted(system.external_forces),
    )
    begins = accumulate((motion.duration for motion in motions), initial=0.0)
    each = [_OnGround(motion, ground, begin) for motion, begin in zip(motions, begins, strict=False)]
    return shaken, list(each), [_on_ground(some) for some in forces]


@dataclass(frozen=True)
class _OnGround:
    motion: DrivenMotion
    ground: GroundAcceleration
    begin: float

    @property
    def duration(self) -> float:
        return self.motion.duration

    def states(self, times: FloatArray, /) -> tuple[FloatArray, FloatArray, FloatArray]:
        q, v, a = self.motion.states(times)
        still = np.zeros((len(q), _AXIS_COUNT))
        moved = np.asarray(self.ground(self.begin + np.asarray(times)))
        return np.hstack([still, q]), np.hstack([still, v]), np.hstack([moved, a])


def _on_ground(forces: ExternalForces) -> ExternalForces:
    return lambda t: _shifted(forces(t))


def _shifted(forces: Any) -> Any:
    """Forces by joint with those of the ground's joints, none, before the robot's."""
    if forces is None:
        return None
    shifted = pin.StdVec_Force()
    shifted.extend([pin.Force.Zero()] * _AXIS_COUNT + list(forces))
    return shifted
