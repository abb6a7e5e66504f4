"""Kinds of joints: they turn, in rad and Nm, or slide, in m and N; and how far postures of both are apart.

All that depends on the kind of a joint asks this module, also which joints follow others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray

TURN = 2 * np.pi
"""A whole turn, rad."""


def prismatic_joints(model: Any) -> BoolArray:
    """Return which joints (n,) of a pinocchio model, each of one coordinate, slide; the others turn."""
    return np.array(["JointModelP" in joint.shortname() for joint in list(model.joints)[1:]], dtype=np.bool_)


def slide_axes(model: Any) -> FloatArray:
    """Return the directions (n, 3) of the joints that slide, in the frame before each; zero for others."""
    axes = np.zeros((model.njoints - 1, 3))
    for i in np.flatnonzero(prismatic_joints(model)):
        joint = model.joints[int(i) + 1]
        moved = joint.createData()
        joint.calc(moved, np.eye(1, model.nq, joint.idx_q)[0])
        axes[i] = model.jointPlacements[int(i) + 1].rotation @ moved.M.translation
    return axes


def turn_axis(joint: Any) -> FloatArray:
    """Return the direction (3,) of a pinocchio joint model that turns, in its own frame."""
    data = joint.createData()
    joint.calc(data, np.ones(joint.idx_q + joint.nq))
    return np.asarray(data.S, dtype=np.float64).reshape(6)[3:]


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling:
    """How the m joints of an arm follow its n coordinates: ``q_full = G q + g``.

    Where no joint follows another m is n, and all here returns what it is given.

    Attributes
    ----------
    own : (n,)
        Number of the joint that has each coordinate, base to tool.
    leader : (m,)
        Number of the coordinate that each joint follows: its own, where it has one.
    multiplier, offset : (m,)
        The one row of G and of g, rad/rad and rad, m with joints that slide.
    """

    own: IntArray
    leader: IntArray
    multiplier: FloatArray
    offset: FloatArray

    @cached_property
    def is_free(self) -> bool:
        """Whether no joint follows another."""
        return len(self.own) == len(self.leader)

    @cached_property
    def matrix(self) -> FloatArray:
        """G (m, n)."""
        return np.eye(len(self.own))[self.leader] * self.multiplier[:, None]

    @cached_property
    def paired(self) -> BoolArray:
        """Which joints (m,) follow another, or are followed."""
        return np.asarray(np.bincount(self.leader)[self.leader] > 1)

    def positions(self, q: FloatArray) -> FloatArray:
        """Return the positions (..., m) of all joints in postures (..., n)."""
        return q if self.is_free else q[..., self.leader] * self.multiplier + self.offset

    def rates(self, v: FloatArray) -> FloatArray:
        """Return velocities (..., m) of all joints, or what else is linear, by the coordinates' (..., n)."""
        return v if self.is_free else v[..., self.leader] * self.multiplier

    def projected(self, rows: FloatArray, axis: int = -1) -> FloatArray:
        """Return derivatives by all joints, or torques, as those of the coordinates: ``J G``, ``G' tau``.

        `rows` have the m joints along `axis`.
        """
        if self.is_free:
            return rows
        return np.asarray(np.moveaxis(np.moveaxis(rows, axis, -1) @ self.matrix, -1, axis))

    def summed(self, bounds: FloatArray) -> FloatArray:
        """Return bounds (..., m) on the effects of all joints as the coordinates' (..., n): times ``|G|``."""
        if self.is_free:
            return bounds
        sums = np.zeros((*bounds.shape[:-1], len(self.own)))
        # Not as a product: a bound may be infinite.
        for k, (leader, factor) in enumerate(zip(self.leader, np.abs(self.multiplier), strict=True)):
            sums[..., leader] += factor * bounds[..., k]
        return sums

    def ranges(self, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the ends (m,) of the joints' positions between those of the coordinates (n,)."""
        ends = self.positions(lower), self.positions(upper)
        return np.minimum(*ends), np.maximum(*ends)


@dataclass(frozen=True)
class JointUnits:
    """Names of the units of one joint's position, its rates and its torque, which is a force where it slides.

    `factor` takes SI to those of position and rates.
    """

    position: str
    velocity: str
    acceleration: str
    jerk: str
    torque: str
    factor: float


def joint_units(prismatic: bool, *, shown: bool = False) -> JointUnits:
    """Return the units of a joint: SI, or with `shown` those of tables, plots and messages."""
    unit, torque = ("m", "N") if prismatic else ("deg" if shown else "rad", "Nm")
    factor = float(np.rad2deg(1.0)) if unit == "deg" else 1.0
    squared, cubed = "²³" if shown else "23"
    return JointUnits(unit, f"{unit}/s", f"{unit}/s{squared}", f"{unit}/s{cubed}", torque, factor)


def postures_in_words(prismatic: Sequence[bool] | BoolArray, q: FloatArray) -> str:
    """Return a posture (n,) as in ``(10.0, 90.0) deg``; where joints slide each has its unit, m to 1 mm."""
    if not any(prismatic):
        return f"({', '.join(f'{angle:.1f}' for angle in np.rad2deg(q))}) deg"
    each = (
        f"{value:.3f} m" if slides else f"{np.rad2deg(value):.1f} deg"
        for slides, value in zip(prismatic, q, strict=True)
    )
    return f"({', '.join(each)})"


@dataclass(frozen=True, kw_only=True, eq=False)
class PostureMetric:
    """How far postures are apart, rad.

    A joint that slides counts in units of a length that the arm has: 1 m is as far as the angle by which the
    stretched arm moves its tool by 1 m. So steps, spacings and least norms, which options give in rad, move
    the tool about as far by joints of either kind.

    Attributes
    ----------
    prismatic : (n,)
        Which joints slide.
    length : float, m
        That length: of the arm's links in a row.
    """

    prismatic: BoolArray
    length: float

    @cached_property
    def mixed(self) -> bool:
        """Whether any joint slides: otherwise coordinates are angles."""
        return bool(self.prismatic.any())

    @cached_property
    def weight(self) -> FloatArray:
        """What takes joint positions to coordinates of this metric, (n,), rad/rad and rad/m."""
        return np.where(self.prismatic, 1.0 / self.length, 1.0)

    @cached_property
    def period(self) -> FloatArray:
        """After what coordinates (n,) are the same again, rad: a turn, zero for joints that slide."""
        return np.where(self.prismatic, 0.0, TURN)

    def coordinates(self, q: FloatArray) -> FloatArray:
        """Return the coordinates of postures or moves (..., n) in which distances are Euclidean, rad."""
        return q * self.weight if self.mixed else q

    def positions(self, x: FloatArray) -> FloatArray:
        """Return the postures or moves (..., n) of coordinates, rad and m."""
        return x / self.weight if self.mixed else x

    def on_one_turn(self, q: FloatArray) -> FloatArray:
        """Return the coordinates of postures (N, n), those of joints that turn from 0 to below a whole turn.

        So a k-d tree with the box `period` takes them.
        """
        turned = np.where(self.prismatic, self.coordinates(q), q % TURN) if self.mixed else q % TURN
        # A tiny negative angle rounds up to a whole turn.
        turned[(turned >= TURN) & ~self.prismatic] = 0.0
        return np.asarray(turned)

    def lengths(self, moves: FloatArray) -> FloatArray:
        """Return how long moves (..., n) are, (...), rad."""
        return np.asarray(np.linalg.norm(self.coordinates(moves), axis=-1))
