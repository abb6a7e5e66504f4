"""What the feet of a robot bear: the adhesion that they need, the shares of their bounds.

With the load of a foot (forces T_u, T_w along and across the member and N out of the steel, moments M_u, M_w,
M_n about the same axes through the contact's centroid), an adhesion A presses the contact with P = A - N at
the centre of pressure (M_w, -M_u) / P. It has to be so large that the foot is not pulled off (P >= 0), does
not tip, opens no gap where none is allowed, and does not slip: see `Contact`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.reading.file_types import Count, NonNegative
from cmbot.hold.contact import Contact, Gap
from cmbot.hold.foot import Foot

MODES = ("pull", "tip", "gap", "slip")
"""What the adhesion is needed against."""

# The largest of many is looked for above the largest of every so many of them.
_OF_THE_FIRST = 16

ADHESION, CLAMP_LOAD = "adhesion needed", "load of the clamp"
"""What is judged of a magnet and of a clamp: see `Holding.named`."""

LOADS = (
    *("N along the plate", "N across the plate", "N off the steel"),
    *("Nm about the length", "Nm about the width", "Nm about the normal"),
)
"""The unit and the axis of each component of a foot's load."""


@dataclass(frozen=True, kw_only=True)
class FootUse:
    """Of what it bears, what a foot uses most.

    Attributes
    ----------
    share : float
        Safety included.
    foot : int
        From 0.
    bound : str
        ``adhesion_n``, ``force_n`` or ``moment_nm``.
    axis : int
        Of a clamp's bound, from 0; else 0.
    in_words : str
        What it asks, and has.
    """

    share: float
    foot: int
    bound: str
    axis: int
    in_words: str


@dataclass(frozen=True, kw_only=True)
class AdhesionPeak:
    """The largest adhesion that a motion needs of any foot.

    Attributes
    ----------
    peak : float, N
        Without a safety factor.
    mode : str
        What would happen with less: ``pull``, ``tip``, ``gap`` or ``slip``; ``none`` where nothing would.
    tip, gap : float, N
        What the motion needs of any foot so that none tips, and so that no gap opens.
    time : float, s
    foot : int
        Which foot, from 1.
    """

    peak: NonNegative
    mode: str
    tip: NonNegative
    gap: NonNegative
    time: NonNegative
    foot: Count = 1

    @property
    def closed(self) -> float:
        """What the motion needs where no gap may open, N."""
        return max(self.peak, self.gap)


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
        # Wrenches and factors, above what the values are exact, these, and their gradients.
        self._last: tuple[object, FloatArray, FloatArray, FloatArray] | None = None

    @property
    def flat(self) -> tuple[int, ...]:
        """Numbers, from 0, of the feet with a flat contact."""
        return tuple(k for k, foot in enumerate(self.feet) if foot.contact is not None)

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

    def each(self, wrench: FloatArray, above: float = -np.inf) -> FloatArray:
        """Return the adhesion (N, k), N, that each foot with a flat contact needs, not below zero.

        Parameters
        ----------
        wrench : (N, 6), N and Nm
        above : float, N, optional
            What is not above this may be given lower.
        """
        needs = [self.needed(number, wrench, above) for number in self.flat]
        return np.maximum(np.array(needs).T.reshape(len(wrench), -1), 0.0)

    def modes(self, number: int, wrench: FloatArray) -> FloatArray:
        """Return what a foot with a flat contact needs by `MODES`, (N, 4), N."""
        return _modes(self.feet[number], self.load(number, wrench))[0]

    def needed(self, number: int, wrench: FloatArray, above: float = -np.inf) -> FloatArray:
        """Return the adhesion (N,), N, that a foot with a flat contact needs; below zero it is pressed on.

        What is not above `above`, N, may be given lower.
        """
        return needed_by_load(self.feet[number], self.load(number, wrench), above)[0]

    def pressed_without_gap(self, wrench: FloatArray) -> FloatArray:
        """Return the adhesion (N,), N, that a foot but a clamp would need most if no gap might open.

        As near as `Contact.slip_without_gap`.
        """
        feet = ((self.feet[number], self.load(number, wrench)) for number in self.adhesive)
        return np.asarray(np.max([needed_all_over(foot, load, "none")[0] for foot, load in feet], axis=0))

    def needed_between(
        self,
        number: int,
        wrench: FloatArray,
        force: FloatArray,
        torque: FloatArray,
        above: float = -np.inf,
    ) -> FloatArray:
        """Return an adhesion (N,), N, that suffices a foot for all wrenches between points (N, K, 6).

        Parameters
        ----------
        number : int
            Of the foot, from 0.
        wrench : (N, K, 6), N and Nm
        force, torque : (N,), N and Nm
            By which each wrench is off at most besides.
        above : float, N, optional
            Less than that is not looked for.
        """
        foot = self.feet[number]
        load = self.load(number, wrench.reshape(-1, 6)).reshape(wrench.shape)
        middle = 0.5 * (load.min(axis=1) + load.max(axis=1))
        off = np.abs(load - middle[:, None]).max(axis=1) + self._load_bounds(number, force, torque)
        needed, good = np.full(len(load), np.inf), np.isfinite(middle + off).all(axis=1)
        size = np.column_stack([np.hypot(off[:, 0], off[:, 1]), np.hypot(off[:, 3], off[:, 4]), off[:, 5]])
        pull = (middle + off)[good, 2]
        loads, pressing = _turning(middle)[good], above - pull
        needed[good] = pull + _flat(foot).suffices(loads, size[good], foot.friction, foot.gap, pressing)
        return needed

    def worst(self, wrench: FloatArray, time: FloatArray, needed: FloatArray | None = None) -> AdhesionPeak:
        """Return the largest adhesion that wrenches need of a foot but a clamp.

        Parameters
        ----------
        wrench : (N, 6), N and Nm
        time : (N,), s
        needed : (N, k), N, optional
            What `each` returns of them, where it is known.
        """
        columns = [self.flat.index(number) for number in self.adhesive]
        if needed is None:
            some = self.each(wrench[::_OF_THE_FIRST])
            needed = self.each(wrench, float(some[:, columns].max()))
            needed[::_OF_THE_FIRST] = some
        needed = needed[:, columns]
        k, column = np.unravel_index(int(needed.argmax()), needed.shape)
        return self.peak(
            self.adhesive[int(column)], float(needed[k, column]), float(time[k]), wrench[k], wrench
        )

    def peak(
        self, number: int, value: float, time: float, at: FloatArray, wrench: FloatArray
    ) -> AdhesionPeak:
        """Return the peak of foot `number`, at a wrench (6,) of a motion with wrenches (N, 6)."""
        loads = [(self.feet[k], self.load(k, wrench)) for k in self.adhesive]
        tip, gap = (
            max(float((load[:, 2] + _pressed(foot, load, which)[0]).max()) for foot, load in loads)
            for which in (Contact.tip, Contact.gap)
        )
        mode = self.mode(number, at)
        return AdhesionPeak(
            peak=max(value, 0.0), mode=mode, tip=max(tip, 0.0), gap=max(gap, 0.0), time=time, foot=number + 1
        )

    def magnets_asked(self, needed: AdhesionPeak) -> str:
        """Return which magnets have the adhesion that is needed, safety included, in a phrase."""
        foot = self.feet[needed.foot - 1]
        asked, steel = foot.safety * needed.peak, "" if foot.steel is None else f" on {1e3 * foot.steel:g} mm"
        more = (
            "" if asked <= foot.ceiling else f", beyond the {foot.ceiling / 1e3:.1f} kN of two poles{steel}"
        )
        return f"magnets of {asked / 1e3:.1f} kN with safety {foot.safety:g}{more}"

    def kinds_left(self, needed: AdhesionPeak, who: str) -> str:
        """Return by which kinds of hold a foot bears what needs an adhesion, in a sentence.

        Parameters
        ----------
        needed : AdhesionPeak
        who : str
            What needs it, such as ``the whole job``.
        """
        foot = self.feet[needed.foot - 1]
        asked, most = foot.safety * needed.peak, foot.most_adhesion
        steel = "" if foot.steel is None else f" on {1e3 * foot.steel:g} mm of steel"
        asks = f"with safety {foot.safety:g} {who} asks {asked / 1e3:.1f} kN (gap: {foot.gap}"
        if foot.gap == "allowed":
            asks += f"; gap: none asks {foot.safety * needed.closed / 1e3:.1f} kN"
        if asked > most:
            return f"no magnet pulls more than {most / 1e3:.1f} kN on this contact, {asks}): clamps alone"
        magnet = "a magnet" if asked <= foot.ceiling else "a magnet of more poles"
        pulls = f"clamps, or {magnet} that pulls {asked / 1e3:.1f} kN"
        return f"two-pole magnets pull {foot.ceiling / 1e3:.1f} kN at most{steel}, {asks}): {pulls}"

    def mode(self, number: int, wrench: FloatArray) -> str:
        """Return what a foot with a flat contact needs adhesion against at a wrench (6,): `AdhesionPeak`."""
        modes = self.modes(number, wrench[None])[0]
        return MODES[int(modes.argmax())] if modes.max() > 0 else "none"

    def __call__(
        self, wrench: FloatArray, /, above: FloatArray | float = -np.inf
    ) -> tuple[FloatArray, FloatArray]:
        """Return the largest adhesion that a foot needs (N,), N, and its gradients (N, 6).

        What is not above `above`, N, may be given lower.
        """
        return self._most(wrench, dict.fromkeys(self.flat, 1.0), above)

    @property
    def bounded(self) -> bool:
        """Whether something is known of what a foot can bear."""
        return any(foot.bounded for foot in self.feet)

    def share(self, wrench: FloatArray, above: FloatArray | float = -np.inf) -> tuple[FloatArray, FloatArray]:
        """Return the largest share (N,) that a foot uses of its bounds, safety included; gradients (N, 6).

        Parameters
        ----------
        wrench : (N, 6), N and Nm
        above : float or (N,), optional
            What is not above this may be given lower.
        """
        factors = {k: foot.safety / foot.adhesion for k, foot in enumerate(self.feet) if foot.adhesion}
        value, gradient = self._most(wrench, factors, above)
        rows = np.arange(len(wrench))
        for number in self.clamps:
            foot, load = self.feet[number], self.load(number, wrench)
            by_load = foot.safety * np.sign(load) / foot.bounds
            which = (shares := by_load * load).argmax(axis=1)
            more = shares[rows, which] > value
            value[more] = shares[rows, which][more]
            gradient[more] = by_load[rows, which][more, None] * foot.from_wrench[which[more]]
        return value, gradient

    def most_used(self, wrench: FloatArray) -> FootUse:
        """Return what a foot uses most of what it bears under a wrench (1, 6), where something is known."""
        uses = list[FootUse]()
        for number, foot in enumerate(self.feet):
            load = self.load(number, wrench)[0]
            names = [
                name.replace("off", "onto") if value < 0 else name
                for name, value in zip(LOADS, load, strict=True)
            ]
            asked = [*zip(np.abs(load), foot.bounds, names, strict=True)]
            if foot.adhesion is not None:
                asked.append((max(self.needed(number, wrench)[0], 0.0), foot.adhesion, "N of adhesion"))
            which = f"foot {number + 1}" if len(self.feet) > 1 else "a foot"
            for k, (value, most, name) in enumerate(asked):
                if not np.isfinite(most):
                    continue
                words = f"{value:.0f} {name}, times safety {foot.safety:g}, where {which} has {most:.0f} "
                words, share = words + name.split()[0], float(foot.safety * value / most)
                bound = ("force_n", "moment_nm", "adhesion_n")[k // 3]
                uses.append(FootUse(share=share, foot=number, bound=bound, axis=k % 3, in_words=words))
        return max(uses, key=lambda use: use.share)

    def bears(self, wrench: FloatArray, share: float = 1.0) -> BoolArray:
        """Return in which of N wrenches (N, 6) no foot uses more than a share of its bounds: see `bears`."""
        good = np.ones(len(wrench), dtype=np.bool_)
        for number, foot in enumerate(self.feet):
            good[good] = bears(foot, self.load(number, wrench[good]), share)
        return good

    def _most(
        self, wrench: FloatArray, factors: Mapping[int, float], above: FloatArray | float = -np.inf
    ) -> tuple[FloatArray, FloatArray]:
        """Largest adhesion needed (N,) of feet, each times its factor, and its gradients (N, 6).

        Objective and bounds ask for it of the same wrenches, one after the other: what was found is kept.
        """
        value, gradient = np.zeros(len(wrench)), np.zeros((len(wrench), 6))
        if not factors:
            return value, gradient
        unit = max(factors.values())
        key = wrench.shape, wrench.tobytes(), tuple((k, factor / unit) for k, factor in factors.items())
        above = np.broadcast_to(above, len(wrench))
        if self._last is None or self._last[0] != key or (self._last[1] > above / unit).any():
            feet, loads = {k: self.feet[k] for k in factors}, {k: self.load(k, wrench) for k in factors}
            kinds = {k: (foot.contact, foot.friction, foot.gap) for k, foot in feet.items()}
            for kind in {*kinds.values()}:
                # Feet that are alike at once.
                alike = [k for k in factors if kinds[k] == kind]
                levels = np.concatenate([above / factors[k] for k in alike])
                found = needed_by_load(feet[alike[0]], np.vstack([loads[k] for k in alike]), levels)
                parts = (np.split(part, len(alike)) for part in found)
                for k, needed, by_load in zip(alike, *parts, strict=True):
                    factor = factors[k] / unit
                    more = factor * needed > value
                    value[more] = factor * needed[more]
                    gradient[more] = factor * by_load[more] @ feet[k].from_wrench
            self._last = key, above / unit, value, gradient
        return unit * self._last[2], unit * self._last[3]

    def use(self, number: int, wrench: FloatArray) -> FloatArray:
        """Return the largest share (N,) of a clamp's bounds that its load uses, safety included."""
        return share_of_bounds(self.feet[number], self.load(number, wrench))

    def use_remainder(self, number: int, force: FloatArray, torque: FloatArray) -> FloatArray:
        """Bound by how much that share may change, (K,): as `remainder`."""
        clamp, loads = self.feet[number].bounds, self._load_bounds(number, force, torque)
        bounded = np.isfinite(clamp)
        shares = loads[:, bounded] / clamp[bounded]
        return np.asarray(self.feet[number].safety * shares.max(axis=1, initial=0.0))

    def _load_bounds(self, number: int, force: FloatArray, torque: FloatArray) -> FloatArray:
        rows = self.feet[number].from_wrench
        by_force, by_torque = (np.linalg.norm(part, axis=1) for part in (rows[:, :3], rows[:, 3:]))
        # Of a motion beyond all bounds force and torque are infinite, and so is what they load.
        with np.errstate(invalid="ignore"):
            loads = np.outer(force, by_force) + np.outer(torque, by_torque)
        return np.where(np.isnan(loads), np.inf, loads)


def needed_by_load(
    foot: Foot, load: FloatArray, above: FloatArray | float = -np.inf
) -> tuple[FloatArray, FloatArray]:
    """Return the adhesion (N,), N, that a foot needs under loads (N, 6), and its gradients (N, 6).

    Parameters
    ----------
    foot : Foot
        With a flat contact.
    load : (N, 6), N and Nm
        As `Foot.from_wrench` gives them.
    above : float or (N,), N, optional
        What is not above this may be given lower.
    """
    modes, gradients = _modes(foot, load, above)
    which, rows = modes.argmax(axis=1), np.arange(len(load))
    return modes[rows, which], gradients[rows, which]


def needed_all_over(foot: Foot, load: FloatArray, gap: Gap | None = None) -> tuple[FloatArray, FloatArray]:
    """Return what `needed_by_load` does, at least zero, of a contact that is pressed all over.

    Of 23,000 loads in the stances for the triangle 3 % less to 20 % more than that, half of them within 1 %,
    and 50 times as quick. `gap` says against what it is held upright; left out, the foot's.
    """
    function = Contact.tip if (gap or foot.gap) == "allowed" else Contact.gap
    upright, by_moment = _pressed(foot, load, function)
    slip, by_turning = _flat(foot).slip_without_gap(_turning(load), foot.friction)
    by = np.where((upright > slip)[:, None], np.pad(by_moment, ((0, 0), (2, 1))), by_turning)
    by[np.maximum(upright, slip) <= 0] = 0.0
    gradient = _by_load(by)
    gradient[:, 2] = 1.0
    return load[:, 2] + np.maximum(np.maximum(upright, slip), 0.0), gradient


def share_of_bounds(foot: Foot, load: FloatArray) -> FloatArray:
    """Return the largest share (N,) that loads (N, 6) use of what a foot bears, safety included."""
    share = (foot.safety * np.abs(load) / foot.bounds).max(axis=1)
    if foot.adhesion is not None:
        share = np.maximum(share, foot.safety * needed_by_load(foot, load)[0] / foot.adhesion)
    return np.asarray(share)


def bears(foot: Foot, load: FloatArray, share: float = 1.0) -> BoolArray:
    """Return whether a foot bears loads (N, 6) as far as something is known of it, (N,), safety included.

    With a `share` of its bounds. That is found quicker than which share they use.
    """
    good = np.asarray((foot.safety * np.abs(load) <= share * foot.bounds).all(axis=1))
    if foot.adhesion is not None:
        pressed = share * foot.adhesion / foot.safety - load[good, 2]
        good[good] = _flat(foot).bears(_turning(load[good]), pressed, foot.friction, foot.gap)
    return good


def _modes(
    foot: Foot, load: FloatArray, above: FloatArray | float = -np.inf
) -> tuple[FloatArray, FloatArray]:
    """What a foot needs by `MODES` (N, 4), N, and the gradients (N, 4, 6); of tip and gap one counts."""
    N = len(load)
    pressed, gradient = np.zeros((N, len(MODES))), np.zeros((N, len(MODES), 6))
    gradient[:, :, 2] = 1.0
    judged, function = (1, Contact.tip) if foot.gap == "allowed" else (2, Contact.gap)
    pressed[:, judged], by_moment = _pressed(foot, load, function)
    gradient[:, judged, 4], gradient[:, judged, 3] = by_moment[:, 0], -by_moment[:, 1]
    part = _turning(load)
    # What is beyond all bounds needs an adhesion beyond all bounds.
    good = np.isfinite(part).all(axis=1)
    pressed[~good, 3] = np.inf
    pressing = (above - load[:, 2])[good]
    pressed[good, 3], by = _flat(foot).slip(part[good], foot.friction, foot.gap, pressing)
    gradient[good, 3] += _by_load(by)
    return load[:, 2, None] + pressed, gradient


def _flat(foot: Foot) -> Contact:
    if foot.contact is None:
        raise ValueError("a foot without a flat contact")
    return foot.contact


def _moment(load: FloatArray) -> FloatArray:
    """The centre of pressure times the pressing force (N, 2), Nm."""
    return np.column_stack([load[:, 4], -load[:, 3]])


def _turning(load: FloatArray) -> FloatArray:
    """Of loads (N, 6) what `Contact.slip` takes, (N, 5)."""
    return np.column_stack([load[:, :2], _moment(load), load[:, 5]])


def _by_load(by: FloatArray) -> FloatArray:
    """Gradients (N, 6) by loads, from those (N, 5) by what `_turning` makes of them."""
    return np.column_stack([by[:, :2], np.zeros(len(by)), -by[:, 3], by[:, 2], by[:, 4]])


def _pressed(
    foot: Foot, load: FloatArray, function: Callable[[Contact, FloatArray], tuple[FloatArray, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """By how much a contact has to be pressed under loads (N, 6), and the gradients (N, 2)."""
    return function(_flat(foot), _moment(load))
