"""Speed laws of a leg by another route than `cmbot.scene`: phases of constant jerk, integrated.

A lead is the tangent where its leg begins or ends, by differences of points beyond its ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray

__all__ = ["TimedLeg", "covered", "cruise_share", "found", "led", "led_row", "reversed_leg", "with_seconds"]

_Points = Callable[[FloatArray], FloatArray]
# Step of the differences, as a share of the leg: exact for what is cubic beyond its ends.
_STEP = 1e-3


class TimedLeg(NamedTuple):
    """A leg of a scene's tool path."""

    seconds: float
    points: _Points  # by the share that is covered
    orientations: _Points
    length: float = 0.0  # m
    cruises: bool = False  # at a speed that is given
    edges: tuple[float, float] | None = None  # shares of its overscan, where these are not its lengths'
    phases: tuple[float, float, float] | None = None  # shares of ramps and process in its time, with leads
    speed: float = 0.0  # of the process, m/s
    law: Any | None = None


def led(leg: TimedLeg, profile: Any, before: float, after: float) -> TimedLeg:
    """Return a leg with straight leads of so many metres on which the tool speeds up and slows down."""
    ends = [_tangent(leg.points, end) for end in (0.0, 1.0)]
    lead_shares = [lead / float(np.linalg.norm(way)) for lead, way in zip((before, after), ends, strict=True)]
    own = _own_ramps(profile, (before, after))
    speed = leg.length / (leg.seconds * (1 - (profile.ramp if leg.cruises else sum(own) / 2)))
    begin, end = leg.points(np.array([0.0, 1.0]))
    whole = 1 + sum(lead_shares)

    def points(share: FloatArray) -> FloatArray:
        inner = share * whole - lead_shares[0]
        p = leg.points(np.clip(inner, 0.0, 1.0))
        early, late = inner < 0, inner > 1
        p[early] = begin + inner[early, None] * ends[0]
        p[late] = end + (inner[late, None] - 1) * ends[1]
        return p

    rates = [_turn_rate(leg.orientations, end) for end in (0.0, 1.0)]

    def orientations(share: FloatArray) -> FloatArray:
        inner = share * whole - lead_shares[0]
        inside = np.clip(inner, 0.0, 1.0)
        turn = (inner - inside)[:, None] * np.where((inner < 0)[:, None], *rates)
        return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ leg.orientations(inside))

    # In units of the time in which the whole leg is covered at the speed of the process.
    path = 1 / (1 - sum(own) / 2)
    times = [2 * lead_shares[0] + own[0] * path, 0.0, 2 * lead_shares[1] + own[1] * path]
    times[1] = path * (1 - sum(own))
    return leg._replace(
        seconds=sum(times) * leg.length / speed,
        points=points,
        orientations=orientations,
        phases=_normed(times),
        speed=speed,
    )


def led_row(leg: TimedLeg, profile: Any, overscan: float) -> TimedLeg:
    """Return a row of a raster whose overscan is its leads."""
    before, after = leg.edges or (overscan / leg.length, overscan / leg.length)
    times = (2 * before, 1 - before - after, 2 * after)
    seconds = leg.seconds
    if leg.cruises:
        seconds *= cruise_share(profile) * sum(times)
    return leg._replace(seconds=seconds, phases=_normed(times), speed=sum(times) * leg.length / seconds)


def reversed_leg(leg: TimedLeg) -> TimedLeg:
    """Return a leg from its end to its start."""

    def back(of: _Points) -> _Points:
        return lambda share: of(1 - share)

    phases = None if leg.phases is None else (leg.phases[2], leg.phases[1], leg.phases[0])
    law = (
        None if leg.law is None else replace(leg.law, seconds=leg.law.seconds[::-1], jerk=leg.law.jerk[::-1])
    )
    return leg._replace(points=back(leg.points), orientations=back(leg.orientations), phases=phases, law=law)


def found(leg: TimedLeg, law: Any) -> TimedLeg:
    """Return a leg in the time that was found for it."""
    return leg._replace(seconds=float(np.sum(law.seconds)), law=law)


def with_seconds(file: Any) -> Any:
    """Return a stroke with some seconds where these were to be found: its laws have the right ones."""
    legs = tuple(replace(leg, seconds=1.0) if leg.seconds == "auto" else leg for leg in file.legs)
    seconds = 1.0 if file.seconds == "auto" else file.seconds
    return file.changed(legs=legs, seconds=seconds)


def covered(leg: TimedLeg, profile: Any, u: FloatArray) -> FloatArray:
    """Return the shares of a leg's length that are covered at shares `u` (N,) of its time."""
    if leg.law is not None:
        # Imported where needed: it takes a while to load, and few paths need it.
        from scipy.interpolate import make_interp_spline

        ends = np.append(0.0, np.cumsum(leg.law.seconds))
        times = np.append(u * ends[-1], ends[-1])
        shares = make_interp_spline(ends, leg.law.jerk, k=1).antiderivative(3)(times)
        return np.asarray(shares[:-1] / shares[-1])
    phases = leg.phases or (profile.ramp, 1 - 2 * profile.ramp, profile.ramp)
    return np.asarray(_travelled(profile, phases, u) / _travelled(profile, phases, np.ones(1)))


def cruise_share(profile: Any) -> float:
    """Return the share of a time of 1 in which a leg would be covered at its largest speed."""
    phases = (profile.ramp, 1 - 2 * profile.ramp, profile.ramp)
    return float(_travelled(profile, phases, np.ones(1))[0])


def _own_ramps(profile: Any, leads: tuple[float, float]) -> list[float]:
    """Shares of the ramps where there is no lead."""
    return [0.0 if lead else profile.ramp for lead in leads]


def _normed(times: Sequence[float]) -> tuple[float, float, float]:
    first, second, third = (each / sum(times) for each in times)
    return first, second, third


def _tangent(points: _Points, at: float) -> FloatArray:
    """Derivative by the share, of fourth order."""
    p = points(at + _STEP * np.array([-2.0, -1.0, 1.0, 2.0]))
    return np.asarray((p[0] - 8 * p[1] + 8 * p[2] - p[3]) / (12 * _STEP))


def _turn_rate(orientations: _Points, at: float) -> FloatArray:
    """Derivative of the rotation vector by the share, of fourth order."""
    R = Rotation.from_matrix(orientations(at + _STEP * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])))
    turn = (R * R[2].inv()).as_rotvec()
    return np.asarray((turn[0] - 8 * turn[1] + 8 * turn[3] - turn[4]) / (12 * _STEP))


def _travelled(profile: Any, shares: Sequence[float], u: FloatArray) -> FloatArray:
    """Length at share `u` of a time of 1 with a cruising speed of 1: phases of constant jerk, integrated."""
    a, cruise, b = shares
    # Duration, acceleration at the beginning and jerk of each phase.
    phases = [(a, 1 / a, 0.0), (cruise, 0.0, 0.0), (b, -1 / b, 0.0)]
    if profile.kind == "jerk_limited":
        up, down = 4 / a**2, 4 / b**2
        phases = [
            (a / 2, 0.0, up),
            (a / 2, 2 / a, -up),
            (cruise, 0.0, 0.0),
            (b / 2, 0.0, -down),
            (b / 2, -2 / b, down),
        ]
    if profile.kind == "quiet":
        return _tents(a, cruise, b, u)
    travelled, begin, speed = np.zeros_like(u), 0.0, 0.0
    for duration, acceleration, jerk in phases:
        x = np.clip(u - begin, 0.0, duration)
        travelled += x * (speed + x * (acceleration / 2 + x * jerk / 6))
        speed += duration * (acceleration + duration * jerk / 2)
        begin += duration
    return travelled


def _tents(a: float, cruise: float, b: float, u: FloatArray) -> FloatArray:
    """Length with ramps whose jerk rises and falls linearly: as powers of the time since each kink of it."""
    slope, travelled = {}, np.zeros_like(u)
    for begin, ramp, sign in ((0.0, a, 1.0), (a + cruise, b, -1.0)):
        if ramp > 0:
            # The fourth derivative of the length: J' = 32 / ramp^3, and how it changes at each quarter.
            for quarter, change in ((0, 1), (1, -2), (3, 2), (4, -1)):
                at = begin + quarter * ramp / 4
                slope[at] = slope.get(at, 0.0) + sign * change * 32 / ramp**3
    for at, change in slope.items():
        travelled += change * np.maximum(u - at, 0.0) ** 4 / 24
    return travelled
