"""The adhesion that a foot needs so that it is not pulled off, does not tip and does not slip.

With the load of a foot (forces T_u, T_w along and across the member and N out of the steel, moments M_u, M_w,
M_n about the same axes through the contact's centre), half sides l_u, l_w, mean distance r and friction mu:

    pull  A = N
    tip   A = N + max(|M_u| / l_w, |M_w| / l_u)
    slip  A = N + ((T / mu + H)^p + (|M_n| / (mu r))^p)^(1/p),    H^2 = (M_u / l_w)^2 + (M_w / l_u)^2

with T = |(T_u, T_w)| and p = 1.25. With p = 2 and without H that would be the ellipse of friction and torsion
under uniform pressure, which is not on the safe side: a rectangle slips at 0.89 of it, and at half of it
where tipping moments move the pressure to one side. The power and H make up for both: tests compare the
formula with slipping under a pressure that is linear over the contact, without tension. All are convex
functions of the load.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.file_types import Count, NonNegative
from cmbot.hold.foot import Foot

MODES = ("pull", "tip", "slip")
"""What the adhesion is needed against."""

ADHESION, CLAMP_LOAD = "adhesion needed", "load of the clamp"
"""What is judged of a magnet and of a clamp: see `Holding.named`."""

_POWER = 1.25


class FlatContact(Protocol):
    """What the formulas take of a foot: numbers, or arrays (N,) of one for each load."""

    @property
    def half(self) -> Any:
        """Half of the sides along and across the member, m."""

    @property
    def radius(self) -> Any:
        """Mean distance of the points from the centre, m."""

    @property
    def friction(self) -> Any:
        """Between plate and steel."""


@dataclass(frozen=True, kw_only=True)
class AdhesionPeak:
    """The largest adhesion that a motion needs of any foot.

    Attributes
    ----------
    peak : float, N
        Without a safety factor.
    mode : str
        What would happen with less: ``pull``, ``tip`` or ``slip``; ``none`` where nothing would.
    time : float, s
    foot : int
        Which foot, from 1.
    """

    peak: NonNegative
    mode: str
    time: NonNegative
    foot: Count = 1


class Holding:
    """What the feet of a robot bear, as functions of the wrench of its moving arm.

    Parameters
    ----------
    feet : sequence of Foot
    constant : (6,), N and Nm
        Wrench of what does not move, about O0 in W.
    """

    def __init__(self, feet: Sequence[Foot], constant: FloatArray) -> None:
        self.feet = tuple(feet)
        self._constant = constant

    @property
    def flat(self) -> tuple[int, ...]:
        """Numbers, from 0, of the feet with a flat contact."""
        return tuple(k for k, foot in enumerate(self.feet) if foot.half is not None)

    @property
    def adhesive(self) -> tuple[int, ...]:
        """Numbers, from 0, of the feet that hold by adhesion: those that are flat, but for clamps."""
        return tuple(k for k in self.flat if self.feet[k].kind != "clamp")

    @property
    def clamps(self) -> tuple[int, ...]:
        """Numbers, from 0, of the clamps of which is known what they bear."""
        return tuple(k for k, foot in enumerate(self.feet) if foot.force is not None)

    def named(self, what: str, number: int) -> str:
        """Return what is said of a foot: ``load of the clamp of foot 2, safety 2``; `what` leaves out which.

        Parameters
        ----------
        what : str
        number : int
            Of the foot, from 0.
        """
        which = f" of foot {number + 1}" if len(self.feet) > 1 else ""
        return f"{what}{which}, safety {self.feet[number].safety:g}"

    def load(self, number: int, wrench: FloatArray) -> FloatArray:
        """Return the loads (N, 6), N and Nm, of a foot: `Foot.from_wrench`.

        Parameters
        ----------
        number : int
            Of the foot, from 0.
        wrench : (N, 6), N and Nm
            Of the moving arm on the guardrail, about O0 in W.
        """
        return np.asarray((wrench + self._constant) @ self.feet[number].from_wrench.T)

    def each(self, wrench: FloatArray) -> FloatArray:
        """Return the adhesion (N, k), N, that each foot with a flat contact needs, not below zero.

        Parameters
        ----------
        wrench : (N, 6), N and Nm
        """
        needs = [self.needed(number, wrench) for number in self.flat]
        return np.maximum(np.array(needs).T.reshape(len(wrench), -1), 0.0)

    def modes(self, number: int, wrench: FloatArray) -> FloatArray:
        """Return what a foot with a flat contact needs by `MODES`, (N, 3), N."""
        return _modes(self.feet[number], self.load(number, wrench))

    def needed(self, number: int, wrench: FloatArray) -> FloatArray:
        """Return the adhesion (N,), N, that a foot with a flat contact needs; below zero it is pressed on."""
        return np.asarray(self.modes(number, wrench).max(axis=1))

    def worst(self, wrench: FloatArray, time: FloatArray) -> AdhesionPeak:
        """Return the largest adhesion that wrenches (N, 6) at times (N,), s, need of a foot but a clamp."""
        each = self.each(wrench)[:, [self.flat.index(number) for number in self.adhesive]]
        k, column = np.unravel_index(int(each.argmax()), each.shape)
        number = self.adhesive[int(column)]
        mode = self.mode(number, wrench[k])
        return AdhesionPeak(peak=float(each[k, column]), mode=mode, time=float(time[k]), foot=number + 1)

    def mode(self, number: int, wrench: FloatArray) -> str:
        """Return what a foot with a flat contact needs adhesion against at a wrench (6,): `AdhesionPeak`."""
        modes = self.modes(number, wrench[None])[0]
        return MODES[int(modes.argmax())] if modes.max() > 0 else "none"

    def __call__(self, wrench: FloatArray, /) -> tuple[FloatArray, FloatArray]:
        """Return the largest adhesion that a foot needs (N,), N, and its gradients (N, 6)."""
        value, gradient = np.zeros(len(wrench)), np.zeros((len(wrench), 6))
        for number in self.flat:
            foot, load = self.feet[number], self.load(number, wrench)
            modes = _modes(foot, load)
            which = modes.argmax(axis=1)
            rows = np.arange(len(wrench))
            more = modes[rows, which] > value
            value[more] = modes[rows, which][more]
            by_load = _gradients(foot, load)[rows, which]
            gradient[more] = (by_load @ foot.from_wrench)[more]
        return value, gradient

    def remainder(self, number: int, force: FloatArray, torque: FloatArray) -> FloatArray:
        """Bound by how much the adhesion may change, (K,), N, with the wrench's force and torque.

        Parameters
        ----------
        number : int
            Of the foot, from 0.
        force, torque : (K,), N and Nm
            By which the wrench is off at most.
        """
        foot, size = self.feet[number], self._load_bounds(number, force, torque)
        if foot.half is None or foot.radius is None:
            return np.zeros_like(force)
        along, across = foot.half
        pull = size[:, 2]
        with np.errstate(over="ignore"):  # damaged files ask forces without end; an infinite bound is refused
            slide = np.hypot(size[:, 0], size[:, 1]) / foot.friction
            tip = size[:, 3] / across + size[:, 4] / along
            return np.asarray(pull + slide + tip + size[:, 5] / (foot.friction * foot.radius))

    @property
    def bounded(self) -> bool:
        """Whether something is known of what a foot can bear."""
        return any(foot.bounded for foot in self.feet)

    def share(self, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the largest share (N,) that a foot uses of its bounds, safety included; gradients (N, 6).

        Parameters
        ----------
        wrench : (N, 6), N and Nm
        """
        value, gradient = np.zeros(len(wrench)), np.zeros((len(wrench), 6))
        rows = np.arange(len(wrench))
        for number, foot in enumerate(self.feet):
            load = self.load(number, wrench)
            shares, by_load = np.abs(load) / self._clamp(number), np.sign(load)[:, :, None] * np.eye(6)
            by_load = by_load / self._clamp(number)
            if foot.adhesion is not None:
                shares, by_load = _modes(foot, load) / foot.adhesion, _gradients(foot, load) / foot.adhesion
            which = shares.argmax(axis=1)
            found = foot.safety * shares[rows, which]
            more = found > value
            value[more] = found[more]
            gradient[more] = foot.safety * (by_load[rows, which] @ foot.from_wrench)[more]
        return value, gradient

    def use(self, number: int, wrench: FloatArray) -> FloatArray:
        """Return the largest share (N,) of a clamp's bounds that its load uses, safety included."""
        shares = np.abs(self.load(number, wrench)) / self._clamp(number)
        return np.asarray(self.feet[number].safety * shares.max(axis=1))

    def use_remainder(self, number: int, force: FloatArray, torque: FloatArray) -> FloatArray:
        """Bound by how much that share may change, (K,): as `remainder`."""
        clamp, loads = self._clamp(number), self._load_bounds(number, force, torque)
        bounded = np.isfinite(clamp)
        shares = loads[:, bounded] / clamp[bounded]
        return np.asarray(self.feet[number].safety * shares.max(axis=1, initial=0.0))

    def _clamp(self, number: int) -> FloatArray:
        foot = self.feet[number]
        return np.array([*(foot.force or (np.inf,) * 3), *(foot.moment or (np.inf,) * 3)])

    def _load_bounds(self, number: int, force: FloatArray, torque: FloatArray) -> FloatArray:
        rows = self.feet[number].from_wrench
        by_force, by_torque = (np.linalg.norm(part, axis=1) for part in (rows[:, :3], rows[:, 3:]))
        # Of a motion beyond all bounds force and torque are infinite, and so is what they load.
        with np.errstate(invalid="ignore"):
            loads = np.outer(force, by_force) + np.outer(torque, by_torque)
        return np.where(np.isnan(loads), np.inf, loads)


def needed_by_load(contact: FlatContact, load: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the adhesion (N,), N, that flat contacts need under loads (N, 6), and its gradients (N, 6).

    Parameters
    ----------
    contact : FlatContact
        One for all loads, or one for each.
    load : (N, 6), N and Nm
        As `Foot.from_wrench` gives them.
    """
    modes = _modes(contact, load)
    which, rows = modes.argmax(axis=1), np.arange(len(load))
    return modes[rows, which], _gradients(contact, load)[rows, which]


def _parts(foot: FlatContact, load: FloatArray) -> tuple[FloatArray, ...]:
    """Friction, tipping and torsion of loads (N, 6) as forces (N,) on the contact; the tips' components."""
    if foot.half is None or foot.radius is None:
        raise ValueError("a foot without a flat contact")
    along, across = foot.half
    about_member, about_across = load[:, 3] / across, load[:, 4] / along
    slide = np.hypot(load[:, 0], load[:, 1]) / foot.friction
    both = np.hypot(about_member, about_across)
    return slide, both, np.abs(load[:, 5]) / (foot.friction * foot.radius), about_member, about_across


def _modes(foot: FlatContact, load: FloatArray) -> FloatArray:
    slide, both, torsion, about_member, about_across = _parts(foot, load)
    tip = np.maximum(np.abs(about_member), np.abs(about_across))
    slip = ((slide + both) ** _POWER + torsion**_POWER) ** (1 / _POWER)
    return np.asarray(load[:, 2, None] + np.stack([np.zeros_like(tip), tip, slip], axis=1))


def _gradients(foot: FlatContact, load: FloatArray) -> FloatArray:
    """Derivatives (N, 3, 6) of `_modes` by the load; zero where there is none."""
    slide, both, torsion, about_member, about_across = _parts(foot, load)
    along, across = foot.half or (1.0, 1.0)
    gradient = np.zeros((len(load), len(MODES), 6))
    gradient[:, :, 2] = 1.0
    rolls = np.abs(about_member) >= np.abs(about_across)
    gradient[:, 1, 3] = np.where(rolls, np.sign(about_member) / across, 0.0)
    gradient[:, 1, 4] = np.where(rolls, 0.0, np.sign(about_across) / along)
    slip = ((slide + both) ** _POWER + torsion**_POWER) ** (1 / _POWER)
    by_rest, by_torsion = (_ratio(x, slip) ** (_POWER - 1) for x in (slide + both, torsion))
    gradient[:, 2, 0] = by_rest * _ratio(load[:, 0], slide * foot.friction) / foot.friction
    gradient[:, 2, 1] = by_rest * _ratio(load[:, 1], slide * foot.friction) / foot.friction
    gradient[:, 2, 3] = by_rest * _ratio(about_member, both) / across
    gradient[:, 2, 4] = by_rest * _ratio(about_across, both) / along
    radius = 1.0 if foot.radius is None else foot.radius
    gradient[:, 2, 5] = by_torsion * np.sign(load[:, 5]) / (foot.friction * radius)
    return gradient


def _ratio(value: FloatArray, size: FloatArray) -> FloatArray:
    """Value over size, zero where there is no size."""
    return np.divide(value, size, out=np.zeros_like(value), where=size > 0)
