"""Joint limits: ranges, velocity and torque from the URDF, acceleration and jerk from a file.

URDF has no acceleration and jerk limits; they are in a joint-limits file beside it, `read_joint_limits`.

What no file gives is assumed: an acceleration limit of 2 /s times the velocity limit, a jerk limit of 10 /s
times the acceleration limit. These are the ratios of the values that MoveIt's Ruckig smoothing falls back on:
5 rad/s, 10 rad/s2 and 100 rad/s3. Joints that slide have the same ratios. A velocity limit of zero, as many
URDFs have it for one that is not known, is assumed to be 1 rad/s, what MoveIt falls back on, or 0.1 m/s; an
effort of zero is assumed to be twice what may hold the arm beyond the joint at rest, stretched out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, read_only
from cmbot.common.errors import InputError, ModelError
from cmbot.common.reading.validation import counted
from cmbot.common.representation import ShortRepr
from cmbot.robot.description.limits_file import (
    LEAST_LIMIT,
    RATE_KEYS,
    GivenLimits,
    JointLimitsFile,
    MoveItLimitsFile,
    read_joint_limits,
)
from cmbot.robot.elasticity import require_joints
from cmbot.robot.joint_kinds import TURN, Coupling, JointUnits, joint_units, prismatic_joints

ASSUMED_ACCELERATION = 2.0
"""Acceleration limit that is assumed where none is given, as a share of the velocity limit, 1/s."""
ASSUMED_JERK = 10.0
"""Jerk limit that is assumed where none is given, as a share of the acceleration limit, 1/s."""

# Velocity limits that are assumed, rad/s and m/s; the share of the torque of the arm stretched out that its
# drives are assumed to have, and the least as a share of the strongest one's.
_ASSUMED_TURNING, _ASSUMED_SLIDING, _ASSUMED_EFFORT, _EFFORT_FLOOR = 1.0, 0.1, 2.0, 0.01
# A range, rad, that ends between these is likely to be in degrees: after four turns, or with no end meant.
_MANY_TURNS, _NO_END = 8 * np.pi, 1e3
# Numbers in deg/s of at most so many times those in rad/s are in rad/s themselves.
_TURN, _SAME_NUMBERS = 2 * np.pi, 3.0
# The range of a joint that slides ends somewhere, m.
_MAX_RANGE_M = 1e3
# Fields of `JointLimits` that say yes or no of each joint.
_RATES = ("velocity", "acceleration", "jerk", "torque")
_FLAG_FIELDS = ("prismatic", *(f"assumed_{name}" for name in _RATES))


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLimits(ShortRepr):
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
    assumed_velocity, assumed_acceleration, assumed_jerk, assumed_torque : (n,)
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
    assumed_velocity: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    assumed_acceleration: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    assumed_jerk: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    assumed_torque: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        for name in _FLAG_FIELDS:
            if np.size(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.zeros(np.shape(self.lower), dtype=np.bool_))
        for each in fields(self):
            array = np.array(getattr(self, each.name), dtype=bool if each.name in _FLAG_FIELDS else float)
            if array.shape != np.shape(self.lower) or np.isnan(array).any():
                expected = f"numbers, shape {np.shape(self.lower)}"
                raise InputError("JointLimits", each.name, array.tolist(), expected)
            object.__setattr__(self, each.name, read_only(array))

    def narrowed(self, margin: float, sliding_margin: float) -> JointLimits:
        """Return limits whose ranges end so much earlier at both ends, rad, and m where joints slide.

        Raises
        ------
        InputError
            When that leaves a joint nothing.
        """
        by = np.where(self.prismatic, sliding_margin, margin)
        lower, upper = self.lower + by, self.upper - by
        if (empty := np.flatnonzero((by > 0) & (lower >= upper))).size:
            got = f"more than half the range of joint {empty[0] + 1}, {self.range_in_words(int(empty[0]))}"
            raise InputError("JointLimits", "range_margin", got, "a margin that leaves each joint a range")
        return replace(self, lower=lower, upper=upper)

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
        return np.asarray(~self.prismatic & (self.upper - self.lower > TURN))

    @property
    def sampled_half(self) -> FloatArray:
        """Half the range (n,) about its middle that has all postures once: at most half a turn."""
        return np.where(self.prismatic, self.range_half, np.minimum(self.range_half, 0.5 * TURN))

    @property
    def sampled(self) -> tuple[FloatArray, FloatArray]:
        """Ends (n,) of the ranges that have all postures once, lower and upper."""
        return self.range_middle - self.sampled_half, self.range_middle + self.sampled_half

    def drawn(self, rng: np.random.Generator, number: int) -> FloatArray:
        """Return random postures (N, n) within the ranges, each angle on one turn."""
        return rng.uniform(*self.sampled, (number, len(self.lower)))

    @property
    def within_a_turn(self) -> tuple[FloatArray, FloatArray]:
        """Ends (n,) of the ranges, lower and upper, at most half a turn from zero where joints turn."""
        half = np.where(self.prismatic, np.inf, 0.5 * TURN)
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
        turns = np.where(self.winding if winding is None else winding, TURN, np.inf)
        near = q - TURN * np.where(np.isfinite(turns), np.round((q - posture) / turns), 0.0)
        return np.where((near >= self.lower) & (near <= self.upper), near, q)

    def turned_to_middle(self, q: FloatArray) -> FloatArray:
        """Return `q` (N, n) less whole turns of joints, within half a turn of the middle of each range."""
        # Exact for angles that are there already.
        turns = np.round((q - self.range_middle) / TURN)
        turned: FloatArray = q - TURN * np.where(self.prismatic, 0.0, turns)
        return turned


def joint_limits(
    model: Any, coupling: Coupling, urdf: Path, path: Path | None
) -> tuple[JointLimits, tuple[str, ...]]:
    """Join the limits in the model of an arm, from `urdf`, and those in the joint-limits file `path`.

    A file of cmbot's replaces what the URDF says; one of MoveIt's narrows it. Ranges and rates that are given
    of joints which follow others narrow those of the joints that they follow; a torque is that of the joint
    with the drive. Returns the limits, and remarks on what had to be assumed.
    """
    listed = JointLimitsFile(format="cmbot-joint-limits/1") if path is None else read_joint_limits(path)
    names, prismatic = list(model.names)[1:], prismatic_joints(model)
    if isinstance(listed, JointLimitsFile):
        require_joints(listed.joints, model, path)
        _require_units(listed, names, prismatic, path)
    given = [listed.of(name, slides) for name, slides in zip(names, prismatic.tolist(), strict=True)]
    narrows = isinstance(listed, MoveItLimitsFile)
    velocity = _joined(model.upperVelocityLimit, [each.velocity for each in given], narrows=narrows)
    torque = _joined(model.upperEffortLimit, [each.torque for each in given], narrows=narrows)
    acceleration, jerk = (
        _filled([getattr(each, name) for each in given]) for name in ("acceleration", "jerk")
    )
    rates = {"velocity": velocity, "acceleration": acceleration, "jerk": jerk, "torque": torque}
    unknown = {name: ~(rate >= LEAST_LIMIT) for name, rate in rates.items()}
    lower, upper = _range(model, urdf, given, prismatic)
    own = coupling.own

    def joined(name: str, assumed: FloatArray) -> FloatArray:
        """What a joint may do, given or assumed, and what those that follow it may, where that is given."""
        most = np.where(unknown[name][own], assumed, rates[name][own])
        each = np.where(unknown[name], np.inf, rates[name] / np.abs(coupling.multiplier))
        np.minimum.at(most, coupling.leader, each)
        return most

    velocity = joined("velocity", np.where(prismatic[own], _ASSUMED_SLIDING, _ASSUMED_TURNING))
    acceleration = joined("acceleration", ASSUMED_ACCELERATION * velocity)
    stretched = coupling.summed(_stretched_efforts(model, lower, upper))
    lower, upper = _led_range(coupling, lower, upper, names, urdf)
    assumed = _are_assumed(unknown, given, by_file=listed.assumed)
    limits = JointLimits(
        lower=lower,
        upper=upper,
        velocity=velocity,
        acceleration=acceleration,
        jerk=joined("jerk", ASSUMED_JERK * acceleration),
        torque=np.where(unknown["torque"][own], stretched, torque[own]),
        prismatic=prismatic[own],
        **{name: each[own] for name, each in assumed.items()},
    )
    unknown = {name: none[own] for name, none in unknown.items()}
    told = (*_said_by_moveit(listed, path, given), *_assumed(unknown), *_in_radians(given, model, path))
    if listed.assumed:
        told += (f"{_named(unknown, given)} limits in {path} are assumed: it says assumed: true.",)
    return limits, told


def _in_radians(given: Sequence[GivenLimits], model: Any, path: Path | None) -> Iterator[str]:
    """What velocities of a file, in deg/s, look like where they are numbers as the URDF has them in rad/s."""
    listed, described = np.degrees(_filled([each.velocity for each in given])), model.upperVelocityLimit
    both = (listed > 0) & np.isfinite(described) & ~prismatic_joints(model)
    if both.any() and (listed <= _SAME_NUMBERS * described)[both].all():
        yield f"Velocities in {path} look like rad/s; they are taken as deg/s, far below those of the URDF."


def _named(unknown: Mapping[str, BoolArray], given: Sequence[GivenLimits]) -> str:
    """The kinds of limits that a file gives, as words."""
    names = [name for name in unknown if any(getattr(each, name) is not None for each in given)]
    words = [ASSUMPTIONS[name][0].lower() for name in names] or ["all"]
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1]))).capitalize()


def _are_assumed(
    unknown: Mapping[str, BoolArray], given: Sequence[GivenLimits], *, by_file: bool
) -> dict[str, BoolArray]:
    """Which limits no file gives, or a file that says that it assumes them."""
    return {
        f"assumed_{name}": none
        | np.array([by_file and getattr(each, name) is not None for each in given], dtype=np.bool_)
        for name, none in unknown.items()
    }


def _require_units(
    listed: JointLimitsFile, names: Sequence[str], prismatic: BoolArray, path: Path | None
) -> None:
    """Refuse limits of one of the arm's joints in the units of the other kind; `all` may have both."""
    for name, slides in zip(names, prismatic.tolist(), strict=True):
        for key, other in zip(RATE_KEYS[not slides], RATE_KEYS[slides], strict=True):
            if name in listed.joints and getattr(listed.joints[name], key) is not None:
                kind = "slides" if slides else "turns"
                raise ModelError(
                    str(path), f"joints.{name}.{key}", "that key", f"{other}: this joint {kind}", (other,)
                )


def _filled(given: Sequence[float | None]) -> FloatArray:
    """The limits that are given, zero elsewhere."""
    return np.array([0.0 if value is None else value for value in given])


def _joined(described: FloatArray, given: Sequence[float | None], *, narrows: bool) -> FloatArray:
    """The limits of the URDF and of a file, which replaces or `narrows` them; zero where neither has one."""
    known = np.where(np.isfinite(described) & (described >= LEAST_LIMIT), described, 0.0)
    replaced = _filled(given)
    both = np.minimum(known, replaced) if narrows else replaced
    return np.where(replaced == 0, known, np.where(known == 0, replaced, both))


def _range(
    model: Any, urdf: Path, given: Sequence[GivenLimits], prismatic: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """The positions (n,) at which the ranges end, narrowed by a file; refused where they cannot be meant."""
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    unlimited = (np.abs(upper) >= 1e9) & ~prismatic
    lower, upper = np.where(unlimited, -np.inf, lower), np.where(unlimited, np.inf, upper)
    for i, each in enumerate(given):
        if each.lower is not None and each.upper is not None:
            ends = max(lower[i], each.lower), min(upper[i], each.upper)
            lower[i], upper[i] = ends if ends[0] < ends[1] else (lower[i], upper[i])
    for i, name in enumerate(list(model.names)[1:]):
        for key, value in (("lower", lower[i]), ("upper", upper[i])):
            where, far = f"joint[{name}].limit.{key}", abs(value)
            if prismatic[i] and not far <= _MAX_RANGE_M:
                got = f"{getattr(model, f'{key}PositionLimit')[i]:g}"
                raise ModelError(str(urdf), where, got, f"of a joint that slides, at most {_MAX_RANGE_M:g} m")
            if not prismatic[i] and _MANY_TURNS < far <= _NO_END:
                expected = "radians (degrees?), at most four turns, or continuous as the type of the joint"
                raise ModelError(str(urdf), where, f"{value:g} rad", expected)
        if not lower[i] < upper[i]:
            got = f"the range {lower[i]:g} to {upper[i]:g}"
            expected = "lower < upper; a joint that does not move has the type fixed"
            raise ModelError(str(urdf), f"joint[{name}].limit", got, expected)
    return lower, upper


def _led_range(
    coupling: Coupling, lower: FloatArray, upper: FloatArray, names: Sequence[str], urdf: Path
) -> tuple[FloatArray, FloatArray]:
    """The ranges (n,) in which coordinates keep all joints that follow them within their own ones (m,)."""
    ends = (np.array([lower, upper]) - coupling.offset) / coupling.multiplier
    least, most = lower[coupling.own], upper[coupling.own]
    np.maximum.at(least, coupling.leader, ends.min(axis=0))
    np.minimum.at(most, coupling.leader, ends.max(axis=0))
    for k in np.flatnonzero(~(least < most)[coupling.leader]).tolist():
        leader = names[int(coupling.own[coupling.leader[k]])]
        if names[k] != leader:
            got = f"a range, {lower[k]:g} to {upper[k]:g}, that leaves {leader} none"
            expected = "limits within which both move, by multiplier and offset"
            raise ModelError(str(urdf), f"joint[{names[k]}].mimic", got, expected)
    return least, most


def _stretched_efforts(model: Any, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Efforts (n,), Nm and N, that are assumed: a multiple of what the weight beyond each joint may ask."""
    prismatic = prismatic_joints(model)
    bodies = list(model.inertias)[1:]
    stroke = np.where(prismatic, np.maximum(np.abs(lower), np.abs(upper)), 0.0)
    steps = [
        np.linalg.norm(X.translation) + out
        for X, out in zip(list(model.jointPlacements)[1:], stroke, strict=True)
    ]
    along = np.cumsum(steps)
    weights = np.array([body.mass for body in bodies]) * np.linalg.norm(model.gravity.linear)
    distances = along - along[:, None] + [np.linalg.norm(body.lever) for body in bodies]
    beyond = np.triu(np.ones_like(distances))
    torques = np.where(prismatic, beyond @ weights, (beyond * distances) @ weights)
    return np.asarray(_ASSUMED_EFFORT * np.maximum(torques, _EFFORT_FLOOR * torques.max(initial=1.0)))


def _said_by_moveit(
    listed: JointLimitsFile | MoveItLimitsFile, path: Path | None, given: Sequence[GivenLimits]
) -> Iterator[str]:
    if isinstance(listed, MoveItLimitsFile):
        names = ("velocity", "acceleration", "jerk")
        numbers = (sum(getattr(each, name) is not None for each in given) for name in names)
        counts = ", ".join(f"{name} of {number}" for name, number in zip(names, numbers, strict=True))
        yield (
            f"{path} is MoveIt's; of the arm's {counted(len(given), 'joint')} it limits {counts}: "
            f"the lower limit holds, its or the URDF's.{listed.scaling_remark}"
        )


ASSUMPTIONS = {
    "velocity": ("Velocity", "1 rad/s or 0.1 m/s"),
    "acceleration": ("Acceleration", f"{ASSUMED_ACCELERATION:g} /s times the velocity limit"),
    "jerk": ("Jerk", f"{ASSUMED_JERK:g} /s times the acceleration limit"),
    "torque": ("Effort", "twice what the arm beyond the joint, stretched out, asks of it at rest"),
}
"""What limits are called, and what is assumed where no file gives them."""


def _assumed(unknown: Mapping[str, BoolArray]) -> Iterator[str]:
    for name, (limit, by) in ASSUMPTIONS.items():
        if number := int(unknown[name].sum()):
            total = len(unknown[name])
            joints = "the joints" if number == total else f"{counted(number, 'joint')} of {total}"
            yield f"{limit} limits of {joints} are assumed, {by}: no joint-limits file gives them."
