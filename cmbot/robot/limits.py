"""Joint limits: ranges, velocity and torque from the URDF, acceleration and jerk from a file.

URDF has no acceleration and jerk limits; they are in a joint-limits file beside it::

    format: cmbot-joint-limits/1
    all: {acceleration_deg: 60, jerk_deg: 160}  # of joints that are not listed
    joints:
      joint_1: {acceleration_deg: 30, jerk_deg: 80}
      lift: {acceleration_m_s2: 0.2, jerk_m_s3: 2}  # of a joint that slides

What no file gives is assumed: an acceleration limit of 2 /s times the velocity limit, a jerk limit of 10 /s
times the acceleration limit. These are the ratios of the values that MoveIt's Ruckig smoothing falls back on:
5 rad/s, 10 rad/s2 and 100 rad/s3. Joints that slide have the same ratios.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from cmbot.common.arrays import BoolArray, FloatArray, read_only
from cmbot.common.errors import InputError, ModelError
from cmbot.common.representation import short_repr
from cmbot.common.validation import FileModel, counted, validated
from cmbot.common.yaml_reader import lines_named, read_yaml
from cmbot.robot.joint_kinds import JointUnits, joint_units, prismatic_joints

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
_TURN = 2 * np.pi
# The range of a joint that slides ends somewhere, m.
_FURTHEST = 1e3
# Fields of `JointLimits` that say yes or no of each joint.
_KINDS = ("prismatic", "assumed_acceleration", "assumed_jerk")


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLimits:
    """Bounds of every joint (Chang 2021, Eqs. (31)-(32) and Table 3); the arrays are read-only.

    Attributes
    ----------
    lower, upper : (n,), rad, m
        Position range; infinite for a continuous joint.
    velocity, acceleration, jerk : (n,), rad/s, rad/s2, rad/s3, of joints that slide m/s, m/s2, m/s3
        Bounds of the magnitude.
    torque : (n,), Nm, of joints that slide N
        Bound of the magnitude.
    prismatic : (n,)
        Which joints slide; left out: none.
    assumed_acceleration, assumed_jerk : (n,)
        Which of these limits no file gives, or a file that says that it assumes them; left out: none.

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
    prismatic: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    assumed_acceleration: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    assumed_jerk: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in _KINDS:
            if np.size(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.zeros(np.shape(self.lower), dtype=np.bool_))
        for each in fields(self):
            array = np.array(getattr(self, each.name), dtype=bool if each.name in _KINDS else float)
            if array.shape != np.shape(self.lower) or np.isnan(array).any():
                expected = f"numbers, shape {np.shape(self.lower)}"
                raise InputError("JointLimits", each.name, array.tolist(), expected)
            object.__setattr__(self, each.name, read_only(array))

    def units(self, joint: int, *, shown: bool = False) -> JointUnits:
        """Return the units of a joint, by its index: SI, or with `shown` those of tables."""
        return joint_units(bool(self.prismatic[joint]), shown=shown)

    def range_in_words(self, joint: int) -> str:
        """Return the range of a joint, by its index, as in ``-90 to 90 deg`` or ``0 to 0.35 m``."""
        unit = self.units(joint, shown=True)
        return f"{unit.factor * self.lower[joint]:g} to {unit.factor * self.upper[joint]:g} {unit.position}"

    @property
    def range_half(self) -> FloatArray:
        """Half the range (n,) of each joint, rad or m; infinite for a continuous joint."""
        half = 0.5 * (self.upper - self.lower)
        return np.where(np.isfinite(half), half, np.inf)

    @property
    def range_middle(self) -> FloatArray:
        """Middle (n,) of each range, rad or m; zero for a continuous joint."""
        finite = np.isfinite(self.lower)
        return np.where(finite, self.upper, 0.0) - np.where(finite, self.range_half, 0.0)

    @property
    def winding(self) -> BoolArray:
        """Which joints (n,) can turn by more than a whole turn."""
        return np.asarray(~self.prismatic & (self.upper - self.lower > _TURN))

    @property
    def sampled_half(self) -> FloatArray:
        """Half the range (n,) about its middle that has all postures once: at most half a turn."""
        return np.where(self.prismatic, self.range_half, np.minimum(self.range_half, 0.5 * _TURN))

    @property
    def within_a_turn(self) -> tuple[FloatArray, FloatArray]:
        """Ends (n,) of the ranges, lower and upper, at most half a turn from zero where joints turn."""
        half = np.where(self.prismatic, np.inf, 0.5 * _TURN)
        return np.maximum(self.lower, -half), np.minimum(self.upper, half)

    def contain(self, q: FloatArray) -> BoolArray:
        """Return which of the postures `q` (N, n) are within the ranges, (N,)."""
        within: BoolArray = np.all((q >= self.lower) & (q <= self.upper), axis=1)
        return within

    def turned_towards(
        self, posture: FloatArray, q: FloatArray, winding: BoolArray | None = None
    ) -> FloatArray:
        """Return `q` (N, n) on the turns nearest to a posture (n,), as far as they are within the ranges.

        Only joints that are `winding` (n,) change, by default those that can turn by more than a whole turn.
        """
        turns = np.where(self.winding if winding is None else winding, _TURN, np.inf)
        near = q - _TURN * np.where(np.isfinite(turns), np.round((q - posture) / turns), 0.0)
        return np.where((near >= self.lower) & (near <= self.upper), near, q)

    def turned_to_middle(self, q: FloatArray) -> FloatArray:
        """Return `q` (N, n) less whole turns of joints, within half a turn of the middle of each range."""
        # Exact for angles that are there already.
        turns = np.round((q - self.range_middle) / _TURN)
        turned: FloatArray = q - _TURN * np.where(self.prismatic, 0.0, turns)
        return turned


class JointEntry(FileModel):
    """Limits of a joint; what is left out is assumed."""

    acceleration_deg: Positive | None = None
    """deg/s2, of a joint that turns."""
    jerk_deg: Positive | None = None
    """deg/s3, of a joint that turns."""
    acceleration_m_s2: Positive | None = None
    """m/s2, of a joint that slides."""
    jerk_m_s3: Positive | None = None
    """m/s3, of a joint that slides."""

    def acceleration(self, prismatic: bool) -> float | None:
        """Return the limit in SI, if it is given."""
        return self.acceleration_m_s2 if prismatic else _radians(self.acceleration_deg)

    def jerk(self, prismatic: bool) -> float | None:
        """Return the limit in SI, if it is given."""
        return self.jerk_m_s3 if prismatic else _radians(self.jerk_deg)


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else float(np.deg2rad(degrees))


class JointLimitsFile(FileModel):
    """A joint-limits file."""

    format: Literal["cmbot-joint-limits/1"]
    assumed: bool = False
    """Whether the numbers are assumed, as `cmbot new` writes them; a plan says so."""
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
    prismatic = prismatic_joints(model)
    for i, name in enumerate(names):
        for key, value in (("velocity", velocity[i]), ("effort", torque[i])):
            if not (np.isfinite(value) and value >= _LEAST):
                expected = f"a positive bound, at least {_LEAST:g}"
                raise ModelError(str(urdf), f"joint[{name}].limit.{key}", value, expected)
        ends = (("lower", model.lowerPositionLimit[i]), ("upper", model.upperPositionLimit[i]))
        for key, value in ends if prismatic[i] else ():
            if not abs(value) <= _FURTHEST:
                expected = f"of a joint that slides, at most {_FURTHEST:g} m"
                raise ModelError(str(urdf), f"joint[{name}].limit.{key}", f"{value:g}", expected)
    if path is not None:
        _require_units(listed, names, prismatic, path)
    kinds = list(zip(names, prismatic.tolist(), strict=True))
    given = [listed.entry(name).acceleration(slides) for name, slides in kinds]
    acceleration = _filled(given, ASSUMED_ACCELERATION * velocity)
    given_jerk = [listed.entry(name).jerk(slides) for name, slides in kinds]
    jerk = _filled(given_jerk, ASSUMED_JERK * acceleration)
    unlimited = np.abs(model.upperPositionLimit) >= 1e9
    limits = JointLimits(
        lower=np.where(unlimited, -np.inf, model.lowerPositionLimit),
        upper=np.where(unlimited, np.inf, model.upperPositionLimit),
        velocity=velocity,
        acceleration=acceleration,
        jerk=jerk,
        torque=torque,
        prismatic=prismatic,
        assumed_acceleration=np.array([listed.assumed or value is None for value in given]),
        assumed_jerk=np.array([listed.assumed or value is None for value in given_jerk]),
    )
    told = tuple(_assumed(given, given_jerk))
    if listed.assumed:
        told += (f"Acceleration and jerk limits in {path} are assumed: it says assumed: true.",)
    return limits, told


def _require_units(listed: JointLimitsFile, names: Sequence[str], prismatic: BoolArray, path: Path) -> None:
    """Refuse limits of one of the arm's joints in the units of the other kind; `all` may have both."""
    wrong = (("acceleration_m_s2", "jerk_m_s3"), ("acceleration_deg", "jerk_deg"))
    right = (("acceleration_deg", "jerk_deg"), ("acceleration_m_s2", "jerk_m_s3"))
    for name, slides in zip(names, prismatic.tolist(), strict=True):
        for key, other in zip(wrong[slides], right[slides], strict=True):
            if name in listed.joints and getattr(listed.joints[name], key) is not None:
                kind = "slides" if slides else "turns"
                raise ModelError(
                    str(path), f"joints.{name}.{key}", "that key", f"{other}: this joint {kind}", (other,)
                )


def _filled(given: Sequence[float | None], assumed: FloatArray) -> FloatArray:
    """The limits that are given, the assumed ones elsewhere."""
    return np.array([other if value is None else value for value, other in zip(given, assumed, strict=True)])


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
