"""Time laws: which share of its length the tool has covered at which share of a leg's duration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Protocol

import numpy as np
from pydantic import Field

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.validation import CheckedFields

_Duration = Annotated[float, Field(gt=0, le=36_000)]
_Jerk = Annotated[float, Field(ge=-1e9, le=1e9)]
# Halvings that find when a share is covered.
_HALVINGS = 60


class TimeLaw(Protocol):
    """From rest to rest along a leg."""

    @property
    def breaks(self) -> FloatArray:
        """Shares (B,) of the duration between which the law is a polynomial, 0 and 1 among them."""

    def share(self, u: FloatArray) -> FloatArray:
        """Share of the length covered at share `u` of the duration, both in [0, 1]."""

    def rate(self, u: FloatArray) -> FloatArray:
        """Derivative of `share`: speed in units of length over duration."""

    def time_share(self, share: FloatArray) -> FloatArray:
        """Share of the duration at which shares (N,) of the length are covered: the inverse of `share`."""

    def reversed(self) -> TimeLaw:
        """Return the law of the way back."""


@dataclass(frozen=True, kw_only=True)
class SpeedProfile(CheckedFields):
    """How the tool speeds up and slows down along a leg: from rest to rest, symmetric in time.

    Attributes
    ----------
    kind : str
        ``trapezoidal``: constant acceleration in the ramps, as in the paper.
        ``jerk_limited``: acceleration rises and falls linearly in the ramps, so jerk is bounded.
    ramp : float
        Share of a leg's duration spent speeding up, and again slowing down, 0.001 to 0.5.

    Raises
    ------
    InputError
        When `kind` is unknown or `ramp` is out of range.
    """

    kind: Literal["trapezoidal", "jerk_limited"] = "trapezoidal"
    ramp: Annotated[float, Field(ge=1e-3, le=0.5)] = 0.2

    def share(self, u: FloatArray) -> FloatArray:
        """Share of the length covered at share `u` of the duration, both in [0, 1]."""
        late = u > 0.5
        x = np.where(late, 1 - u, u)
        ramp = self.ramp * self._ramp_integral(np.minimum(x / self.ramp, 1.0))
        covered = (ramp + np.maximum(x - self.ramp, 0.0)) / (1 - self.ramp)
        return np.where(late, 1 - covered, covered)

    def rate(self, u: FloatArray) -> FloatArray:
        """Derivative of `share`: speed in units of length over duration."""
        x = np.minimum(np.minimum(u, 1 - u) / self.ramp, 1.0)
        return self._ramp(x) / (1 - self.ramp)

    def time_share(self, share: FloatArray) -> FloatArray:
        """Share of the duration at which shares (N,) of the length are covered: the inverse of `share`."""
        return _inverse(self.share, share)

    @property
    def breaks(self) -> FloatArray:
        """Shares (B,) of the duration between which the law is a polynomial, 0 and 1 among them."""
        shares = [0.0, self.ramp, 1 - self.ramp, 1.0]
        if self.kind == "jerk_limited":
            shares += [0.5 * self.ramp, 1 - 0.5 * self.ramp]
        return np.unique(shares)

    def reversed(self) -> SpeedProfile:
        """Return the law of the way back, which is the same."""
        return self

    def _ramp(self, x: FloatArray) -> FloatArray:
        """Share of the cruising speed reached at share x of a ramp."""
        if self.kind == "trapezoidal":
            return x
        return np.where(x < 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)

    def _ramp_integral(self, x: FloatArray) -> FloatArray:
        if self.kind == "trapezoidal":
            return x**2 / 2
        return np.where(x < 0.5, 2 * x**3 / 3, x - 0.5 + 2 * (1 - x) ** 3 / 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class PiecewiseLaw:
    """A law of its own for a leg: a polynomial in each phase.

    Attributes
    ----------
    breaks : (K + 1,)
        Shares of the duration at which the phases begin and the last one ends.
    coefficients : (K, D + 1)
        Of the share covered, by powers of the share of the duration since the phase began.
    """

    breaks: FloatArray
    coefficients: FloatArray

    def share(self, u: FloatArray) -> FloatArray:
        """Share of the length covered at share `u` of the duration, both in [0, 1]."""
        return np.clip(self._value(self.coefficients, u), 0.0, 1.0)

    def rate(self, u: FloatArray) -> FloatArray:
        """Derivative of `share`: speed in units of length over duration."""
        powers = np.arange(1, self.coefficients.shape[1])
        return self._value(self.coefficients[:, 1:] * powers, u)

    def time_share(self, share: FloatArray) -> FloatArray:
        """Share of the duration at which shares (N,) of the length are covered: the inverse of `share`."""
        return _inverse(self.share, share)

    def reversed(self) -> PiecewiseLaw:
        """Return the law of the way back."""
        h, (phases, terms) = np.diff(self.breaks), self.coefficients.shape
        back = np.zeros((phases, terms))
        for k in range(phases):
            from_end = np.polynomial.Polynomial(self.coefficients[k])(np.polynomial.Polynomial([h[k], -1.0]))
            back[phases - 1 - k, : len(from_end.coef)] = -from_end.coef
        back[:, 0] += 1.0
        return PiecewiseLaw(breaks=1.0 - self.breaks[::-1], coefficients=back)

    def _value(self, coefficients: FloatArray, u: FloatArray) -> FloatArray:
        phase = np.clip(np.searchsorted(self.breaks, u, side="right") - 1, 0, len(coefficients) - 1)
        x, value = u - self.breaks[phase], np.zeros(len(u))
        for column in coefficients.T[::-1]:
            value = value * x + column[phase]
        return value


@dataclass(frozen=True, kw_only=True)
class LegLaw(CheckedFields):
    """The law of a leg with ``seconds: auto``, as planning found it.

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

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.jerk) != len(self.seconds) + 1:
            raise InputError("LegLaw", "jerk", f"{len(self.jerk)} numbers", f"{len(self.seconds) + 1}")
        if not self._covered > 0:
            raise InputError("LegLaw", "jerk", "a law that leads back", "one that leads forward")

    @property
    def duration(self) -> float:
        """Of the leg, s."""
        return sum(self.seconds)

    @property
    def law(self) -> PiecewiseLaw:
        """The law over shares of the duration."""
        whole = self.duration
        scale = whole ** np.arange(5.0) / self._covered
        terms = np.array([each for each, _ in self._phases]) * scale
        breaks = np.append(0.0, np.cumsum(self.seconds)) / whole
        breaks[-1] = 1.0
        return PiecewiseLaw(breaks=breaks, coefficients=terms)

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
) -> tuple[PiecewiseLaw, tuple[float, float], float]:
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
    PiecewiseLaw, (two floats), float
        The law, the shares of the duration between which the speed is constant, and the duration in units of
        that in which the whole length is covered at that speed.
    """
    # At a constant speed of one: on a ramp the mean speed is half of that.
    process = (1 - before - after) / (1 - 0.5 * sum(ramps))
    durations = np.array([2 * before + ramps[0] * process, 0.0, 2 * after + ramps[1] * process])
    durations[1] = 2 * before + process + 2 * after - durations[0] - durations[2]
    whole = float(durations.sum())
    rate = whole  # share over share of the duration
    up, cruise, down = durations / whole
    phases: list[tuple[float, list[float]]]
    if profile.kind == "trapezoidal":
        phases = [
            (up, [0.0, 0.5 * rate / up]),
            (cruise, [rate]),
            (down, [rate, -0.5 * rate / down]),
        ]
    else:
        a, b = 2 * rate / up**2, 2 * rate / down**2
        phases = [
            (0.5 * up, [0.0, 0.0, a / 3]),
            (0.5 * up, [0.5 * rate, 0.5 * a * up, -a / 3]),
            (cruise, [rate]),
            (0.5 * down, [rate, 0.0, -b / 3]),
            (0.5 * down, [0.5 * rate, -0.5 * b * down, b / 3]),
        ]
    return _joined(phases), (up, up + cruise), whole


def _joined(phases: list[tuple[float, list[float]]]) -> PiecewiseLaw:
    """Put phases, of so long durations, one after the other; of each the coefficients but the first."""
    phases = [(duration, terms) for duration, terms in phases if duration > 0]
    breaks = np.append(0.0, np.cumsum([duration for duration, _ in phases]))
    coefficients = np.zeros((len(phases), 1 + max(len(terms) for _, terms in phases)))
    covered = 0.0
    for k, (duration, terms) in enumerate(phases):
        coefficients[k, 0], coefficients[k, 1 : 1 + len(terms)] = covered, terms
        covered += sum(each * duration**power for power, each in enumerate(terms, start=1))
    breaks[-1] = 1.0
    return PiecewiseLaw(breaks=breaks, coefficients=coefficients)


def _inverse(of: Callable[[FloatArray], FloatArray], share: FloatArray) -> FloatArray:
    """Where an increasing function from [0, 1] to [0, 1] has the values `share` (N,)."""
    low, high = np.zeros(len(share)), np.ones(len(share))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        early = of(middle) < share
        low, high = np.where(early, middle, low), np.where(early, high, middle)
    return 0.5 * (low + high)
