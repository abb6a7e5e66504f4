"""Time laws: which share of its length the tool has covered at which share of a leg's duration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import CheckedFields
from cmbot.common.representation import ShortRepr
from cmbot.toolpath.shaper import Shaper

_Duration = Annotated[float, Field(gt=0, le=36_000)]
_Jerk = Annotated[float, Field(ge=-1e9, le=1e9)]
# Halvings that find when a share is covered.
_SHARE_HALVINGS = 60
# Shares of a duration that are nearer to each other are one break.
_BREAK_TOLERANCE = 1e-12
# The order of the derivative of the share covered that is continuous.
_CONTINUITY = {"trapezoidal": 1, "jerk_limited": 2, "quiet": 3}

# A law leads back where its rate is below zero by this share of its mean, as sampled so often a phase.
_BACK, _RATES_PER_PHASE = 1e-6, 33

Kind = Literal["trapezoidal", "jerk_limited", "quiet"]
"""How the speed rises and falls."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeLaw(ShortRepr):
    """A law from rest to rest: a polynomial in each of K phases.

    Attributes
    ----------
    breaks : (K + 1,)
        Shares of the duration at which the phases begin and the last one ends: from 0 to 1.
    coefficients : (K, D + 1)
        Of the share covered, by powers of the share of the duration since the phase began.
    continuity : (K + 1,)
        Of each break the order of the highest derivative without a jump; before and after it the tool rests.
    """

    breaks: FloatArray
    coefficients: FloatArray
    continuity: IntArray

    @staticmethod
    def ramped(kind: Kind, up: float, cruise: float, down: float, *, flat: float = 0.0) -> TimeLaw:
        """Return a law with a ramp up, a constant speed and a ramp down, of so long durations.

        Parameters
        ----------
        kind : str
            ``trapezoidal``: constant acceleration in the ramps, so C1. ``jerk_limited``: it rises and falls
            linearly, C2. ``quiet``: jerk rises and falls linearly, C3: tents of it, +J at a quarter of the
            ramp, -J at three quarters.
        up, cruise, down : float
            In any unit.
        flat : float
            Share of a quiet ramp with its largest acceleration, between tents that are the shorter for it:
            0 to less than 1. The acceleration is 2 / (1 + flat) times the mean.
        """
        whole = up + cruise + down
        up, cruise, down = up / whole, cruise / whole, down / whole
        speed = 1 / (cruise + 0.5 * (up + down))
        phases = [(length, speed * terms) for length, terms in _ramp(kind, flat, up)]
        if cruise > 0:
            phases.append((cruise, np.array([speed])))
        for length, terms in _ramp(kind, flat, down):
            falling = -speed * terms
            falling[0] += speed
            phases.append((length, falling))
        return TimeLaw._of_speeds(phases, _CONTINUITY[kind])

    @staticmethod
    def _of_speeds(phases: Sequence[tuple[float, FloatArray]], order: int) -> TimeLaw:
        """The law of phases, each of a duration and a polynomial of the speed."""
        breaks = np.append(0.0, np.cumsum([length for length, _ in phases]))
        coefficients = np.zeros((len(phases), 1 + max(len(terms) for _, terms in phases)))
        covered = 0.0
        for row, (length, terms) in zip(coefficients, phases, strict=True):
            row[0], row[1 : 1 + len(terms)] = covered, terms / np.arange(1, 1 + len(terms))
            covered = float(np.polynomial.polynomial.polyval(length, row))
        breaks[-1] = 1.0
        return TimeLaw(breaks=breaks, coefficients=coefficients, continuity=np.full(len(breaks), order))

    def share(self, u: FloatArray) -> FloatArray:
        """Return the shares (N,) of the length covered at shares `u` (N,) of the duration, in [0, 1]."""
        return np.where(u < 1, np.clip(self._value(self.coefficients, u), 0.0, 1.0), 1.0)

    def rate(self, u: FloatArray, order: int = 1) -> FloatArray:
        """Return a derivative (N,) of `share`, the first one: speed in units of length over duration."""
        coefficients = self.coefficients
        for _ in range(order):
            coefficients = coefficients[:, 1:] * np.arange(1, coefficients.shape[1])
        value = self._value(coefficients, u)
        # At rest, whatever rounding says.
        return np.where(u < 1, value, 0.0) if order <= self.continuity[-1] else value

    def time_share(self, share: FloatArray) -> FloatArray:
        """Return the shares (N,) of the duration at which shares (N,) of the length are covered."""
        low, high = np.zeros(len(share)), np.ones(len(share))
        for _ in range(_SHARE_HALVINGS):
            middle = 0.5 * (low + high)
            early = self.share(middle) < share
            low, high = np.where(early, middle, low), np.where(early, high, middle)
        return 0.5 * (low + high)

    def reversed(self) -> TimeLaw:
        """Return the law of the way back."""
        breaks = 1.0 - self.breaks[::-1]
        terms = self._taylor(self.breaks[1:], np.arange(len(self.coefficients)))[::-1]
        back = -terms * (-1.0) ** np.arange(terms.shape[1])
        back[:, 0] += 1.0
        return TimeLaw(breaks=breaks, coefficients=back, continuity=self.continuity[::-1])

    def shaped(self, shaper: Shaper, seconds: float) -> TimeLaw:
        """Return the law of `seconds`, s, that an input shaper makes of this one in the time that is left.

        It is the sum of the law, delayed by each of the shaper's impulses, in proportion to these: it stays
        on the path, and is as smooth as before.
        """
        delays, stretch = shaper.delays / seconds, 1.0 - shaper.delays[-1] / seconds
        breaks = (delays[:, None] + stretch * self.breaks).ravel()
        order = np.argsort(breaks, kind="stable")
        breaks, continuity = breaks[order], np.tile(self.continuity, len(delays))[order]
        first = np.append(True, np.diff(breaks) > _BREAK_TOLERANCE)
        continuity = np.minimum.reduceat(continuity, np.flatnonzero(first))
        breaks = breaks[first]
        breaks[-1] = 1.0
        begin, middle = breaks[:-1], 0.5 * (breaks[1:] + breaks[:-1])
        coefficients = np.zeros((len(begin), self.coefficients.shape[1]))
        for amplitude, delay in zip(shaper.amplitudes, delays, strict=True):
            at, inside = (begin - delay) / stretch, (middle - delay) / stretch
            terms = self._taylor(at, self._phase(inside)) / stretch ** np.arange(coefficients.shape[1])
            terms[inside < 0] = 0.0
            terms[inside > 1] = np.eye(1, terms.shape[1])
            coefficients += amplitude * terms
        return TimeLaw(breaks=breaks, coefficients=coefficients, continuity=continuity)

    def _taylor(self, u: FloatArray, phase: IntArray) -> FloatArray:
        """Coefficients (N, D + 1) of phases (N,) by powers of the share of the duration since `u` (N,)."""
        x, terms = u - self.breaks[phase], self.coefficients[phase].copy()
        for lowest in range(terms.shape[1] - 1):
            # Horner's scheme, again and again: the value, then each derivative over its factorial.
            for power in range(terms.shape[1] - 2, lowest - 1, -1):
                terms[:, power] += x * terms[:, power + 1]
        return terms

    def _phase(self, u: FloatArray) -> IntArray:
        return np.clip(np.searchsorted(self.breaks, u, side="right") - 1, 0, len(self.coefficients) - 1)

    def _value(self, coefficients: FloatArray, u: FloatArray) -> FloatArray:
        phase = self._phase(u)
        x, value = u - self.breaks[phase], np.zeros(np.shape(u))
        for column in coefficients.T[::-1, phase]:
            value = value * x + column
        return value


def _ramp(kind: Kind, flat: float, length: float) -> list[tuple[float, FloatArray]]:
    """The phases of a ramp of some `length`: their durations, and the speed from 0 to 1 by powers of time."""
    if not length > 0:
        return []
    return [
        (length * part, np.array(terms) / length ** np.arange(len(terms)))
        for part, terms in _unit_ramp(kind, flat)
        if part > 0
    ]


def _unit_ramp(kind: Kind, flat: float) -> list[tuple[float, tuple[float, ...]]]:
    """The phases of a ramp of length 1, the speed in each by powers of what is behind since it began."""
    if kind == "trapezoidal":
        return [(1.0, (0.0, 1.0))]
    if kind == "jerk_limited":
        return [(0.5, (0.0, 0.0, 2.0)), (0.5, (0.5, 2.0, -2.0))]
    # Tents of jerk of the length `tent`, between which the acceleration `a` is constant.
    tent = 0.5 * (1 - flat)
    a = 1 / (1 - tent)
    bend, cube = a / tent, 2 * a / (3 * tent**2)
    return [
        (0.5 * tent, (0.0, 0.0, 0.0, cube)),
        (0.5 * tent, (a * tent / 12, a / 2, bend, -cube)),
        (flat, (a * tent / 2, a)),
        (0.5 * tent, (1 - a * tent / 2, a, 0.0, -cube)),
        (0.5 * tent, (1 - a * tent / 12, a / 2, -bend, cube)),
    ]


@dataclass(frozen=True, kw_only=True)
class SpeedProfile(CheckedFields):
    """How the tool speeds up and slows down along a leg: from rest to rest, symmetric in time.

    Attributes
    ----------
    kind : str
        ``trapezoidal``: constant acceleration in the ramps, as in the paper.
        ``jerk_limited``: acceleration rises and falls linearly in the ramps, so jerk is bounded.
        ``quiet``: jerk is continuous. Planning takes ramps and an input shaper in its place, by which the
        tool sways and swings least as predicted, in the same seconds; laws of legs with leads stay. With
        ``seconds: auto`` the shortest law, shaped.
        ``shortest``: with ``seconds: auto``, the shortest law within the limits.
    ramp : float
        Share of a leg's duration spent speeding up, and again slowing down, 0.001 to 0.5.

    Raises
    ------
    InputError
        When `kind` is unknown or `ramp` is out of range.
    """

    kind: Literal["trapezoidal", "jerk_limited", "quiet", "shortest"] = "trapezoidal"
    ramp: Annotated[float, Field(ge=1e-3, le=0.5)] = 0.2

    @property
    def law(self) -> TimeLaw:
        """The law of a leg, before a shorter or a quieter one is found."""
        return TimeLaw.ramped(self.ramps, self.ramp, 1 - 2 * self.ramp, self.ramp)

    @property
    def ramps(self) -> Kind:
        """How the speed rises and falls in its ramps."""
        return "quiet" if self.kind == "shortest" else self.kind


@dataclass(frozen=True, kw_only=True)
class LegLaw(CheckedFields):
    """The law of a leg, as planning found it.

    Attributes
    ----------
    leg : int
        Its number along the timed path, in all passes, from 0; legs that are blended are one.
    seconds : tuple of float
        Durations of its phases, s.
    jerk : tuple of float
        Third derivative of the share of the leg that is covered, 1/s^3, where phases begin and at the end;
        in between it is linear. The leg begins at rest.

    Raises
    ------
    InputError
        When a field is out of its bounds, or there is not one jerk more than phases.
    """

    leg: Annotated[int, Field(ge=0, le=1_000_000)]
    seconds: Annotated[tuple[_Duration, ...], Field(min_length=1, max_length=1000)]
    jerk: Annotated[tuple[_Jerk, ...], Field(min_length=2, max_length=1001)]

    def _check(self) -> None:
        if len(self.jerk) != len(self.seconds) + 1:
            raise InputError("LegLaw", "jerk", f"{len(self.jerk)} numbers", f"{len(self.seconds) + 1}")
        if not self._covered > 0 or self._least_rate < -_BACK:
            raise InputError("LegLaw", "jerk", "a law that leads back", "one that leads forward")

    @property
    def duration(self) -> float:
        """Of the leg, s."""
        return sum(self.seconds)

    @property
    def _least_rate(self) -> float:
        """Smallest rate of the law, as a share of its mean."""
        law = self.law
        u = law.breaks[:-1, None] + np.diff(law.breaks)[:, None] * np.linspace(0.0, 1.0, _RATES_PER_PHASE)
        return float(law.rate(u.ravel()).min())

    @property
    def law(self) -> TimeLaw:
        """The law over shares of the duration."""
        whole = self.duration
        scale = whole ** np.arange(5.0) / self._covered
        terms = np.array([each for each, _ in self._phases]) * scale
        breaks = np.append(0.0, np.cumsum(self.seconds)) / whole
        breaks[-1] = 1.0
        return TimeLaw(breaks=breaks, coefficients=terms, continuity=np.full(len(breaks), 3))

    @staticmethod
    def of(leg: int, law: TimeLaw, seconds: float) -> LegLaw:
        """Return the record of a law with continuous jerk that takes so many seconds."""
        jerk = law.rate(law.breaks, 3) / seconds**3
        durations = np.diff(law.breaks) * seconds
        return LegLaw(leg=leg, seconds=tuple(durations.tolist()), jerk=tuple(jerk.tolist()))

    def slowed(self, factor: float) -> LegLaw:
        """Return the law that takes so many times as long."""
        return replace(
            self,
            seconds=tuple(factor * each for each in self.seconds),
            jerk=tuple(each / factor**3 for each in self.jerk),
        )

    @property
    def _covered(self) -> float:
        """What is covered in the end: one, but for rounding."""
        return self._phases[-1][1]

    @property
    def _phases(self) -> list[tuple[list[float], float]]:
        """Of each phase the coefficients by powers of the time since it began, and the share at its end."""
        share = speed = acceleration = 0.0
        phases = []
        for h, begin, end in zip(self.seconds, self.jerk[:-1], self.jerk[1:], strict=True):
            slope = (end - begin) / h
            terms = [share, speed, acceleration / 2, begin / 6, slope / 24]
            share = sum(term * h**power for power, term in enumerate(terms))
            speed += h * (acceleration + h * (begin / 2 + h * slope / 6))
            acceleration += h * (begin + h * slope / 2)
            phases.append((terms, share))
        return phases


@dataclass(frozen=True, kw_only=True)
class ProcessPart:
    """The part of a leg on which the tool has its process speed.

    Attributes
    ----------
    begin, end : float
        Shares of the leg's duration between which it is.
    length : float
        m.
    """

    begin: float
    end: float
    length: float


def law_with_leads(
    profile: SpeedProfile, before: float, after: float, ramps: tuple[float, float]
) -> tuple[TimeLaw, tuple[float, float], float]:
    """Return the law of a leg that begins or ends with a lead, in which the tool speeds up or slows down.

    Parameters
    ----------
    profile : SpeedProfile
        Of the ramps; without a lead one takes its share of the time in which the rest is covered.
    before, after : float
        Shares of the leg's length that are leads; 0 where there is none.
    ramps : two floats
        For a lead-in and a lead-out 0, otherwise `profile.ramp`.

    Returns
    -------
    TimeLaw, (two floats), float
        The law, the shares of the duration between which the speed is constant, and the duration in units of
        that in which the whole length is covered at that speed.
    """
    # At a constant speed of one: on a ramp the mean speed is half of that.
    process = (1 - before - after) / (1 - 0.5 * sum(ramps))
    up, down = 2 * before + ramps[0] * process, 2 * after + ramps[1] * process
    whole = 2 * before + process + 2 * after
    law = TimeLaw.ramped(profile.ramps, up, whole - up - down, down)
    return law, (up / whole, (whole - down) / whole), whole
