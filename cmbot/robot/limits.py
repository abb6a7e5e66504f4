"""Joint limits: ranges, velocity and torque from the URDF, acceleration and jerk from a file.

URDF has no acceleration and jerk limits; they are in a joint-limits file beside it::

    format: cmbot-joint-limits/1
    all: {acceleration_deg: 60, jerk_deg: 160}  # of joints that are not listed
    joints:
      joint_1: {acceleration_deg: 30, jerk_deg: 80}

What no file gives is assumed: an acceleration limit of 2 /s times the velocity limit, a jerk limit of 10 /s
times the acceleration limit. These are the ratios of the values that MoveIt's Ruckig smoothing falls back on:
5 rad/s, 10 rad/s2 and 100 rad/s3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from cmbot.common.arrays import BoolArray, FloatArray, read_only
from cmbot.common.errors import InputError, ModelError
from cmbot.common.validation import FileModel, counted, validated
from cmbot.common.yaml_reader import lines_named, read_yaml

__all__ = [
    "ASSUMED_ACCELERATION",
    "ASSUMED_JERK",
    "JointLimits",
    "JointLimitsFile",
    "joint_limits",
    "read_joint_limits",
]

ASSUMED_ACCELERATION = 2.0
"""Acceleration limit that is assumed where none is given, as a share of the velocity limit, 1/s."""
ASSUMED_JERK = 10.0
"""Jerk limit that is assumed where none is given, as a share of the acceleration limit, 1/s."""

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

    def contain(self, q: FloatArray) -> BoolArray:
        """Return which of the postures `q` (N, n), rad, are within the ranges, (N,)."""
        within: BoolArray = np.all((q >= self.lower) & (q <= self.upper), axis=1)
        return within

    def turned_to_middle(self, q: FloatArray) -> FloatArray:
        """Return `q` (N, n), rad, less whole turns, within half a turn of the middle of each range."""
        turn = 2 * np.pi
        # Exact for angles that are there already.
        turned: FloatArray = q - turn * np.round((q - self.range_middle) / turn)
        return turned


class JointEntry(FileModel):
    """Limits of a joint; what is left out is assumed."""

    acceleration_deg: Positive | None = None
    """deg/s2."""
    jerk_deg: Positive | None = None
    """deg/s3."""


class JointLimitsFile(FileModel):
    """A joint-limits file."""

    format: Literal["cmbot-joint-limits/1"]
    all: JointEntry = JointEntry()
    """Of the joints that `joints` does not have."""
    joints: dict[str, JointEntry] = Field(default_factory=dict)

    def entry(self, name: str) -> JointEntry:
        """Return the limits of a joint."""
        return self.joints.get(name, self.all)


def read_joint_limits(path: Path) -> JointLimitsFile:
    """Read a joint-limits file."""
    with lines_named(path):
        return validated(JointLimitsFile, read_yaml(path, ModelError), str(path), ModelError)


def joint_limits(model: Any, urdf: Path, path: Path | None) -> tuple[JointLimits, tuple[str, ...]]:
    """Join the limits in the model of an arm, from `urdf`, and those in the joint-limits file `path`.

    Returns them, and remarks on what had to be assumed.
    """
    none = JointLimitsFile(format="cmbot-joint-limits/1")
    listed, names = none if path is None else read_joint_limits(path), list(model.names)[1:]
    velocity, torque = model.upperVelocityLimit, model.upperEffortLimit
    for i, name in enumerate(names):
        for key, value in (("velocity", velocity[i]), ("effort", torque[i])):
            if not (np.isfinite(value) and value >= _LEAST):
                expected = f"a positive bound, at least {_LEAST:g}"
                raise ModelError(str(urdf), f"joint[{name}].limit.{key}", value, expected)
    given = [listed.entry(name).acceleration_deg for name in names]
    acceleration = _filled(given, ASSUMED_ACCELERATION * velocity)
    given_jerk = [listed.entry(name).jerk_deg for name in names]
    jerk = _filled(given_jerk, ASSUMED_JERK * acceleration)
    unlimited = np.abs(model.upperPositionLimit) >= 1e9
    limits = JointLimits(
        lower=np.where(unlimited, -np.inf, model.lowerPositionLimit),
        upper=np.where(unlimited, np.inf, model.upperPositionLimit),
        velocity=velocity,
        acceleration=acceleration,
        jerk=jerk,
        torque=torque,
    )
    return limits, tuple(_assumed(given, given_jerk))


def _filled(given: Sequence[float | None], assumed: FloatArray) -> FloatArray:
    """Limits in degrees, as radians; the assumed ones, in radians, where none is given."""
    return np.array(
        [other if value is None else np.deg2rad(value) for value, other in zip(given, assumed, strict=True)]
    )


def _assumed(acceleration: Sequence[float | None], jerk: Sequence[float | None]) -> Iterator[str]:
    for name, given, factor, of in (
        ("Acceleration", acceleration, ASSUMED_ACCELERATION, "velocity"),
        ("Jerk", jerk, ASSUMED_JERK, "acceleration"),
    ):
        if number := given.count(None):
            joints = "the joints" if number == len(given) else f"{counted(number, 'joint')} of {len(given)}"
            yield (
                f"{name} limits of {joints} are assumed, {factor:g} /s times the {of} limit: "
                "no joint-limits file gives them."
            )
