"""Files of joint limits: cmbot's own, and MoveIt's of the name ``joint_limits.yaml``.

A file of cmbot's::

    format: cmbot-joint-limits/1
    all: {acceleration_deg: 60, jerk_deg: 160}  # of joints that are not listed
    joints:
      joint_1: {acceleration_deg: 30, jerk_deg: 80}
      joint_2: {velocity_deg: 90, effort: 200}  # in place of the URDF's; Nm, of a joint that slides N
      lift: {acceleration_m_s2: 0.2, jerk_m_s3: 2}  # of a joint that slides
    masses_kg: {link_1: 12.5}  # of links to which the URDF gives none

MoveIt's has ``joint_limits`` in place of ``format``, each limit with a key that says whether it holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, Field

from cmbot.common.errors import ModelError
from cmbot.common.reading.validation import FileModel, validated
from cmbot.common.reading.yaml_reader import lines_named, read_yaml

LEAST_LIMIT = 1e-6
"""Smallest limit that is one, SI."""

RATE_KEYS = (
    ("velocity_deg", "acceleration_deg", "jerk_deg"),
    ("velocity_m_s", "acceleration_m_s2", "jerk_m_s3"),
)
"""Keys of a joint's limits, of one that turns and of one that slides."""

# Beyond any robot, but nothing made of them overflows.
Positive = Annotated[float, Field(ge=LEAST_LIMIT, le=1e9)]
Mass = Annotated[float, Field(ge=1e-3, le=1e5)]
# What MoveIt's parameters are nested in where they are those of a ROS node.
_ROS_NESTING = ("/**", "ros__parameters", "robot_description_planning")
_SCALING_KEYS = ("default_velocity_scaling_factor", "default_acceleration_scaling_factor")


@dataclass(frozen=True, kw_only=True)
class GivenLimits:
    """What a file says of one joint, SI, each None where it says nothing."""

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    torque: float | None = None


class JointEntry(FileModel):
    """Limits of a joint; what is left out is the URDF's or assumed."""

    velocity_deg: Positive | None = None
    """deg/s, of a joint that turns, in place of the URDF's."""
    acceleration_deg: Positive | None = None
    """deg/s2, of a joint that turns."""
    jerk_deg: Positive | None = None
    """deg/s3, of a joint that turns."""
    velocity_m_s: Positive | None = None
    """m/s, of a joint that slides, in place of the URDF's."""
    acceleration_m_s2: Positive | None = None
    """m/s2, of a joint that slides."""
    jerk_m_s3: Positive | None = None
    """m/s3, of a joint that slides."""
    effort: Positive | None = None
    """Nm, of a joint that slides N, in place of the URDF's."""
    holding_torque: Positive | None = None
    """Nm, what the brake of a joint holds while it is locked; left out: the effort."""

    def given(self, prismatic: bool) -> GivenLimits:
        """Return the limits that are given, in SI."""
        unit = 1.0 if prismatic else float(np.deg2rad(1.0))
        listed = (getattr(self, key) for key in RATE_KEYS[prismatic])
        velocity, acceleration, jerk = (None if rate is None else unit * rate for rate in listed)
        return GivenLimits(velocity=velocity, acceleration=acceleration, jerk=jerk, torque=self.effort)


class JointLimitsFile(FileModel):
    """A joint-limits file of cmbot's."""

    format: Literal["cmbot-joint-limits/1"]
    assumed: bool = False
    """Whether the numbers are assumed, as `cmbot new` writes them; a plan says so."""
    all: JointEntry = JointEntry()
    """Of the joints that `joints` does not have."""
    joints: dict[str, JointEntry] = Field(default_factory=dict)
    masses_kg: dict[str, Mass] = Field(default_factory=dict)
    """Of links to which the URDF gives none, kg: of even density in their shapes."""

    def of(self, joint: str, prismatic: bool) -> GivenLimits:
        """Return what the file says of a joint."""
        return self.joints.get(joint, self.all).given(prismatic)


class _MoveItEntry(FileModel):
    model_config = ConfigDict(extra="ignore", strict=False)

    has_position_limits: bool = False
    min_position: float | None = None
    max_position: float | None = None
    has_velocity_limits: bool = False
    max_velocity: float | None = None
    has_acceleration_limits: bool = False
    max_acceleration: float | None = None
    has_jerk_limits: bool = False
    max_jerk: float | None = None
    has_effort_limits: bool = False
    max_effort: float | None = None

    def limit(self, name: str) -> float | None:
        """Return a limit that the file says holds."""
        value: float | None = getattr(self, f"max_{name}")
        return value if getattr(self, f"has_{name}_limits") and value and value >= LEAST_LIMIT else None


class MoveItLimitsFile(FileModel):
    """A file of joint limits of MoveIt's: SI and radians."""

    model_config = ConfigDict(extra="ignore")

    joint_limits: dict[str, _MoveItEntry]
    default_velocity_scaling_factor: float = 1.0
    default_acceleration_scaling_factor: float = 1.0

    assumed: ClassVar[bool] = False
    masses_kg: ClassVar[Mapping[str, float]] = {}

    def of(self, joint: str, prismatic: bool) -> GivenLimits:
        """Return what the file says of a joint."""
        del prismatic
        entry = self.joint_limits.get(joint, _MoveItEntry())
        limits = {name: entry.limit(name) for name in ("velocity", "acceleration", "jerk")}
        if entry.has_position_limits:
            limits |= {"lower": entry.min_position, "upper": entry.max_position}
        return GivenLimits(**limits, torque=entry.limit("effort"))

    @property
    def scaling_remark(self) -> str:
        """What its factors are, where there are any; they are no limits."""
        factors = [f"{name} {getattr(self, name):g}" for name in _SCALING_KEYS if getattr(self, name) != 1.0]
        if not factors:
            return ""
        return f" Its {' and '.join(factors)}: what MoveIt asks for by default, no limits, and not used."


def read_joint_limits(path: Path) -> JointLimitsFile | MoveItLimitsFile:
    """Read a joint-limits file: cmbot's, or one of MoveIt's, known by its key ``joint_limits``.

    Raises
    ------
    ModelError
        When it cannot be read, or something in it is wrong.
    """
    with lines_named(path):
        data = read_yaml(path, ModelError)
        inner: Any = data
        while isinstance(inner, dict) and (nests := [key for key in _ROS_NESTING if key in inner]):
            inner = inner[nests[0]]
        if "format" not in data and isinstance(inner, dict) and "joint_limits" in inner:
            return validated(MoveItLimitsFile, inner, str(path), ModelError)
        return validated(JointLimitsFile, data, str(path), ModelError)
