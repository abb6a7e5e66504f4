"""Joint limits: ranges, velocity and torque from the URDF, acceleration and jerk from a file.

URDF has no acceleration and jerk limits; they are in a joint-limits file beside it::

    format: cmbot-joint-limits/1
    joints:
      joint_1: {acceleration_deg: 60, jerk_deg: 160}
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.errors import InputError, ModelError
from cmbot.common.validation import FileModel, validated
from cmbot.common.yaml_reader import lines_named, read_yaml

__all__ = ["JointLimits", "joint_limits", "read_joint_limits"]

# Beyond any robot, but nothing made of them overflows. The least is also that of velocity and effort.
_LEAST = 1e-6
Positive = Annotated[float, Field(ge=_LEAST, le=1e9)]


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """Bounds of every joint (Chang 2021, Eqs. (31)-(32) and Table 3); the arrays are read-only.

    Attributes
    ----------
    lower, upper : (n,), rad
        Position range; infinite for a continuous joint.
    velocity, acceleration, jerk : (n,), rad/s, rad/s2, rad/s3
        Bounds of the magnitude.
    torque : (n,), Nm
        Bound of the magnitude.

    Raises
    ------
    InputError
        When an array has another length or is not a number.
    """

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    torque: FloatArray

    def __post_init__(self) -> None:
        for field in fields(self):
            array = np.array(getattr(self, field.name), dtype=float)
            if array.shape != np.shape(self.lower) or np.isnan(array).any():
                expected = f"numbers, shape {np.shape(self.lower)}"
                raise InputError("JointLimits", field.name, array.tolist(), expected)
            object.__setattr__(self, field.name, read_only(array))

    @property
    def range_half(self) -> FloatArray:
        """Half the range (n,) of each joint, rad; infinite for a continuous joint."""
        half = 0.5 * (self.upper - self.lower)
        return np.where(np.isfinite(half), half, np.inf)

    @property
    def range_middle(self) -> FloatArray:
        """Middle (n,) of each range, rad; zero for a continuous joint."""
        finite = np.isfinite(self.lower)
        return np.where(finite, self.upper, 0.0) - np.where(finite, self.range_half, 0.0)


class _JointEntry(FileModel):
    acceleration_deg: Positive
    jerk_deg: Positive


class _JointLimitsFile(FileModel):
    format: Literal["cmbot-joint-limits/1"]
    joints: dict[str, _JointEntry]


def read_joint_limits(path: Path) -> dict[str, _JointEntry]:
    """Read the entries of a joint-limits file by the names of the joints."""
    with lines_named(path):
        return validated(_JointLimitsFile, read_yaml(path, ModelError), str(path), ModelError).joints


def joint_limits(model: Any, urdf: Path, path: Path) -> JointLimits:
    """Join the limits in the model of an arm, from `urdf`, and those in the joint-limits file `path`."""
    listed, names = read_joint_limits(path), list(model.names)[1:]
    missing = [name for name in names if name not in listed]
    if missing:
        raise ModelError(str(path), f"joints.{missing[0]}", "nothing", "acceleration_deg and jerk_deg")
    entries = [listed[name] for name in names]
    velocity, torque = model.upperVelocityLimit, model.upperEffortLimit
    for i, name in enumerate(names):
        for key, value in (("velocity", velocity[i]), ("effort", torque[i])):
            if not (np.isfinite(value) and value >= _LEAST):
                expected = f"a positive bound, at least {_LEAST:g}"
                raise ModelError(str(urdf), f"joint[{name}].limit.{key}", value, expected)
    unlimited = np.abs(model.upperPositionLimit) >= 1e9
    return JointLimits(
        lower=np.where(unlimited, -np.inf, model.lowerPositionLimit),
        upper=np.where(unlimited, np.inf, model.upperPositionLimit),
        velocity=velocity,
        acceleration=np.deg2rad([entry.acceleration_deg for entry in entries]),
        jerk=np.deg2rad([entry.jerk_deg for entry in entries]),
        torque=torque,
    )
