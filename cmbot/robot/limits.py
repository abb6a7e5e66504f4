"""What each joint may do: ranges, velocity and torque from the URDF, acceleration and jerk from a file.

URDF has no place for acceleration and jerk limits, so they live in a joint-limits file beside it::

    format: cmbot-joint-limits/1
    joints:
      joint_1: {acceleration_deg: 60, jerk_deg: 160}
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, ModelError
from cmbot.common.validation import FileModel, validated
from cmbot.common.yaml_reader import read_yaml

__all__ = ["JointLimits", "joints_with_limits", "read_joint_limits"]

Positive = Annotated[float, Field(gt=0)]


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """Bounds of every joint, all along a motion (Chang 2021, Eqs. (31)-(32) and Table 3).

    Attributes
    ----------
    lower, upper : (n,), rad
        Position range; infinite for a continuous joint.
    velocity, acceleration, jerk : (n,), rad/s, rad/s2, rad/s3
        Bounds of the magnitude.
    torque : (n,), Nm
        Bound of the magnitude.
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
                raise InputError(
                    "JointLimits", field.name, array.tolist(), f"numbers, shape {np.shape(self.lower)}"
                )
            array.setflags(write=False)
            object.__setattr__(self, field.name, array)


class _JointEntry(FileModel):
    acceleration_deg: Positive
    jerk_deg: Positive


class _JointLimitsFile(FileModel):
    format: Literal["cmbot-joint-limits/1"]
    joints: dict[str, _JointEntry]


def read_joint_limits(path: Path, joints: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    """Read acceleration and jerk limits.

    Parameters
    ----------
    path : pathlib.Path
        The joint-limits file.
    joints : tuple of str
        Names of the joints, in order.

    Returns
    -------
    acceleration, jerk : (n,), rad/s2, rad/s3

    Raises
    ------
    ModelError
        When the file cannot be read or misses a joint.
    """
    listed = _entries(path)
    missing = [name for name in joints if name not in listed]
    if missing:
        raise ModelError(str(path), f"joints.{missing[0]}", "nothing", "acceleration_deg and jerk_deg")
    entries = [listed[name] for name in joints]
    return (
        np.deg2rad([entry.acceleration_deg for entry in entries]),
        np.deg2rad([entry.jerk_deg for entry in entries]),
    )


def joints_with_limits(path: Path) -> frozenset[str]:
    """Return the names of the joints that a joint-limits file lists.

    Raises
    ------
    ModelError
        When the file cannot be read.
    """
    return frozenset(_entries(path))


def _entries(path: Path) -> dict[str, _JointEntry]:
    return validated(_JointLimitsFile, read_yaml(path, ModelError), str(path), ModelError).joints
