"""The time laws of a quiet stroke: of ramps and input shapers those by which the tool sways least.

Each law takes the seconds of its leg and keeps a speed that is asked for. What a law makes of the arm is
predicted along the joint path of a motion by the scene's own law, for the stiffness as modelled and at both
ends of its interval. That path is taken by the time of the motion, not by the share of the leg: at the ends
of a leg joints move while the tool hardly does, so derivatives by the share have no bound there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import numpy as np
from scipy.interpolate import CubicSpline

from cmbot.common.arrays import FloatArray
from cmbot.planning.flexibility.leg_response import LegResponse
from cmbot.planning.request import StrokeRequest
from cmbot.planning.timing.law_search import Bounded, least_seconds
from cmbot.planning.timing.leg_paths import LegPath
from cmbot.toolpath import LegLaw, Segment, Shaper, TimeLaw, extra_insensitive, two_hump
from cmbot.trajectory import QuinticTrajectory

# Ramps, as shares of what a shaper leaves of a leg's time, and their shares of constant acceleration: the
# larger these, the smaller the acceleration and the larger the jerk.
_RAMP_SHARES, _FLAT_SHARES = (0.15, 0.2, 0.3, 0.4, 0.5), (0.0, 0.25, 0.5, 0.75)
# A shaper takes this share of a leg's time at most; ramps beside a speed that is asked for are no shorter.
_LONGEST_SHAPER, _SHORTEST_RAMP = 0.4, 0.08
# Share of the joints' bounds that a law may use along the path: splines through its points swing about it.
# Where every law is beyond it, those are tried that use so many times what the least one does.
_MAX_JOINT_USE, _MAX_USE_RATIO = 0.9, 1.1
# What swings after the stop counts so much beside what sways at work: the next leg inherits it.
_SWING_WEIGHT = 1.0
# Legs whose response is predicted; others have the ramp and shaper of the one that is most like them.
_MAX_LEGS = 8
# Times of a leg at which laws are compared, but for the bounds within this share of its ends: self-motion
# there goes by the time of the motion that is known, and is another one in a law that is planned.
_LAW_TIMES, _LEAVING = 241, 0.1
# So many times as long legs of so few periods are tried, and told where that leaves this share of the sway,
# and that is more than the last, m.
_LONGER_FACTORS, _MOST_PERIODS, _WORTH_SHARE, _LEAST_SWAY_M = (1.25, 1.5, 2.0, 3.0), 20.0, 0.5, 5e-5
# Share of the largest sway that laws may have, as predicted; factors by which they are slowed at once, and at
# most.
_SWAY_SHARE, _SLOWING, _MAX_SLOWING = 0.9, (1.02, 2.0), 20.0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Leg:
    """The motion of a leg by the scene's law."""

    number: int
    trajectory: QuinticTrajectory
    begin: float
    seconds: float
    law: TimeLaw

    def q(self, w: FloatArray, order: int) -> FloatArray:
        """Postures (N, n), or a derivative of them, by the share of the time."""
        return self.trajectory.evaluate(self.begin + w * self.seconds, order) * self.seconds**order

    def when(self, laws: Sequence[TimeLaw]) -> list[CubicSpline]:
        """Of each law, by the share of its time, that at which the leg's own law is as far."""
        u = np.linspace(0.0, 1.0, _LAW_TIMES)
        same = self.law.time_share(np.concatenate([law.share(u) for law in laws])).reshape(len(laws), -1)
        same[:, [0, -1]] = 0.0, 1.0
        return [CubicSpline(u, row) for row in same]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Candidate:
    """A law; its ramp, as a share of what a shaper leaves of the time, flat share, shaper's number."""

    kind: tuple[float, float, int]
    made: Callable[[], TimeLaw]

    @cached_property
    def law(self) -> TimeLaw:
        """The law, made when it is asked for."""
        return self.made()

    @property
    def is_flattest(self) -> bool:
        """Whether it is one of least acceleration, without a shaper."""
        return self.kind[1:] == (_FLAT_SHARES[-1], 0)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Choice:
    """The best candidate of a leg, those that fit it, and the angular frequencies (k,), rad/s, there."""

    best: _Candidate
    fitting: list[_Candidate]
    omega: FloatArray


@dataclass(frozen=True, kw_only=True)
class MoreTime:
    """What more seconds would give on a short leg, as predicted.

    Attributes
    ----------
    leg : int
    periods : float
        Of the slowest mode, in the leg.
    seconds, longer : float, s
    sway, less : float, m
        Largest sway and swing together in either time.
    """

    leg: int
    periods: float
    seconds: float
    longer: float
    sway: float
    less: float


def quiet_laws(
    request: StrokeRequest,
    trajectory: QuinticTrajectory,
    simulated: Callable[[tuple[LegLaw, ...]], FloatArray] | None = None,
) -> tuple[tuple[LegLaw, ...], MoreTime | None]:
    """Return the laws of a stroke's legs but those that have a process speed between leads, or stay.

    No laws where those of the scene are the best. With them, of the short leg with the most sway, what more
    time would give, if it is worth it.

    Parameters
    ----------
    request : StrokeRequest
        Its profile is ``quiet``.
    trajectory : QuinticTrajectory
        A motion along the stroke by the laws of the scene.
    simulated : callable, optional
        Where splines are too coarse for the laws: from laws to the largest sway (L,), m, of the legs by the
        splines through their via-points. By that laws without a shaper are preferred to those predicted.
    """
    path, arm = request.task.path, request.cell.arm
    segments = path.segments
    moving = [k for k, leg in enumerate(segments) if _moves(leg) and leg.process is None]
    if not moving:
        return (), None
    chosen, longer = dict[int, _Choice](), list[MoreTime]()
    places = np.unique(np.linspace(0, len(moving) - 1, min(len(moving), _MAX_LEGS)).round().astype(int))
    for number in (moving[k] for k in places):
        begin, end = path.leg_times[number : number + 2].tolist()
        law = segments[number].law
        motion = _Leg(number=number, trajectory=trajectory, begin=begin, seconds=end - begin, law=law)
        response = None if arm is None else LegResponse(arm, motion.q)
        omega = np.empty(0) if response is None else response.omega
        chosen[number], sway = _chosen(request, motion, response, list(_candidates(request, number, omega)))
        if response is not None:
            longer += _more_time(request, motion, response, chosen[number].best, sway)

    def laws_of(kind: tuple[float, float, int] | None = None) -> Iterator[TimeLaw]:
        for leg in moving:
            choice = chosen[min(chosen, key=partial(_unlikeness, segments, leg))]
            best = next((each for each in choice.fitting if each.kind == kind), choice.best)
            yield best.law if leg in chosen else _alike(best, _candidates(request, leg, choice.omega))

    def recorded(laws: Sequence[TimeLaw]) -> tuple[LegLaw, ...]:
        pairs = zip(moving, laws, strict=True)
        return tuple(LegLaw.of(leg, law, segments[leg].seconds) for leg, law in pairs)

    laws = list(laws_of())
    if simulated is not None:
        kinds = {each.kind for choice in chosen.values() for each in choice.fitting if each.is_flattest}
        options = [laws, *(list(laws_of(kind)) for kind in sorted(kinds))]
        sways = np.array([simulated(recorded(each))[moving] for each in options])
        laws = [options[k][place] for place, k in enumerate(sways.argmin(axis=0).tolist())]
    own = all(law is segments[leg].law for leg, law in zip(moving, laws, strict=True))
    return () if own else recorded(laws), max(longer, key=lambda each: each.sway, default=None)


def _more_time(
    request: StrokeRequest, leg: _Leg, response: LegResponse, best: _Candidate, sway: float
) -> Iterator[MoreTime]:
    """The least of some longer times of a leg of few periods in which the tool sways much less, if any.

    By the ramp and shaper that are best in its own time.
    """
    periods = leg.seconds * float(response.omega[0]) / (2 * np.pi)
    for factor in _LONGER_FACTORS if periods <= _MOST_PERIODS and sway > _LEAST_SWAY_M else ():
        longer = factor * leg.seconds
        law = _alike(best, _candidates(request, leg.number, response.omega, longer))
        less = float(_merit(request, response, leg.when([law]), longer)[0])
        if less <= _WORTH_SHARE * sway:
            yield MoreTime(
                leg=leg.number, periods=periods, seconds=leg.seconds, longer=longer, sway=sway, less=less
            )
            return


def shortest_quiet_law(
    request: StrokeRequest, path: LegPath, bounded: Sequence[Bounded], shortest: LegLaw
) -> LegLaw:
    """Return the shortest law of a leg, shaped, and slowed until it keeps the bound of the sway.

    Parameters
    ----------
    request : StrokeRequest
        Its arm bends.
    path : LegPath
    bounded : sequence of Bounded
        Along the path.
    shortest : LegLaw
        Within these bounds.
    """
    arm, most = request.cell.arm, request.stroke.file.max_sway_mm
    if arm is None:
        return shortest
    response, base, share = LegResponse(arm, path.q), shortest.law, request.cell.options.quiet_stiffness_share

    def timed(shaper: Shaper | None, factor: float) -> tuple[float, TimeLaw, float]:
        """The time in which a shaped law keeps the limits, the law, and how far the tool is moved, m."""
        seconds = factor * shortest.duration + (0.0 if shaper is None else shaper.duration)
        law = base if shaper is None else base.shaped(shaper, seconds)
        seconds = max(seconds, least_seconds(bounded, law))
        found = response.of([_derivatives(law)], seconds, sorted({1 - share, 1.0, 1 + share}))
        both = found.sway.max(), found.swing.max()
        return seconds, law, float(sum(both) if most is None else max(both))

    shapers = _shapers(response.omega, request.cell.robot.damping_ratio)
    laws = [timed(shaper, 1.0) for shaper in shapers]
    if most is None:
        seconds, law, _ = min(laws, key=lambda each: each[2])
        return LegLaw.of(path.leg, law, seconds)
    bound = _SWAY_SHARE * 1e-3 * most
    for shaper, (_, _, moved) in zip(shapers, tuple(laws), strict=True):
        factor = 1.0
        # By so much slower a law moves the tool less by about the square of it.
        while moved > bound and factor < _MAX_SLOWING:
            factor *= float(np.clip(np.sqrt(moved / bound), *_SLOWING))
            laws.append(timed(shaper, factor))
            moved = laws[-1][2]
    keeping = [law for law in laws if law[2] <= bound]
    seconds, law, _ = min(keeping) if keeping else min(laws, key=lambda each: each[2])
    return LegLaw.of(path.leg, law, seconds)


def _derivatives(law: TimeLaw) -> Callable[[FloatArray, int], FloatArray]:
    return lambda u, order: law.rate(u, order) if order else law.share(u)


def _unlikeness(segments: Sequence[Segment], leg: int, other: int) -> tuple[float, int]:
    """How far two legs are from each other: first in their durations, then in their order."""
    return abs(float(np.log(segments[other].seconds / segments[leg].seconds))), abs(other - leg)


def _alike(best: _Candidate, candidates: Iterator[_Candidate]) -> TimeLaw:
    """The law with the ramp and shaper of another leg's; where it does not fit, the first, the scene's."""
    plain = next(candidates)
    return next((each for each in candidates if each.kind == best.kind), plain).law


def _moves(leg: Segment) -> bool:
    return leg.curve.length > 0 or bool(leg.turn.any())


def _shapers(omega: FloatArray, damping: float) -> list[Shaper | None]:
    """None, and those for modes of angular frequencies (k,), rad/s, and a damping ratio."""
    if not len(omega):
        return [None]
    first, pair = float(omega[0]), float(omega[:2].mean())
    shapers: list[Shaper | None] = [None, extra_insensitive(pair, damping), two_hump(pair, damping)]
    shapers.append(extra_insensitive(first, damping))
    if len(omega) > 2:
        shapers.append(extra_insensitive(pair, damping).then(extra_insensitive(float(omega[2]), damping)))
    return shapers


def _candidates(
    request: StrokeRequest, leg: int, omega: FloatArray, seconds: float | None = None
) -> Iterator[_Candidate]:
    """The scene's law, and others in the same time, with the same speed where one is asked for.

    The time is that of the leg, or so many `seconds`.
    """
    stroke, segment = request.stroke, request.task.path.segments[leg]
    asked, own = stroke.asked_speed(leg) is not None, stroke.file.speed_profile.ramp
    yield _Candidate(kind=(own, 0.0, 0), made=lambda: segment.law)
    seconds = seconds or segment.seconds
    for number, shaper in enumerate(_shapers(omega, request.cell.robot.damping_ratio)):
        share = 0.0 if shaper is None else shaper.duration / seconds
        if share > _LONGEST_SHAPER:
            continue
        # The speed between ramps is that of the scene's law: (1 - share) (1 - ramp) is what it was.
        ramps = (1 - (1 - own) / (1 - share),) if asked else _RAMP_SHARES
        for ramp, flat in product(ramps, _FLAT_SHARES):
            if ramp < _SHORTEST_RAMP or (shaper is None and (ramp, flat) == (own, 0.0)):
                continue
            yield _Candidate(kind=(ramp, flat, number), made=partial(_shaped, ramp, flat, shaper, seconds))


def _shaped(ramp: float, flat: float, shaper: Shaper | None, seconds: float) -> TimeLaw:
    law = TimeLaw.ramped("quiet", ramp, 1 - 2 * ramp, ramp, flat=flat)
    return law if shaper is None else law.shaped(shaper, seconds)


def _chosen(
    request: StrokeRequest, leg: _Leg, response: LegResponse | None, candidates: list[_Candidate]
) -> tuple[_Choice, float]:
    """The candidate of least sway and swing within the joints' bounds, and both together, m."""
    when = leg.when([candidate.law for candidate in candidates])
    use = np.array([_use(request, leg, *pair) for pair in zip(candidates, when, strict=True)])
    allowed = max(_MAX_JOINT_USE, _MAX_USE_RATIO * use.min())
    places = np.flatnonzero(use <= allowed).tolist()
    fitting = [candidates[k] for k in places]
    if response is None:
        return _Choice(best=fitting[0], fitting=fitting, omega=np.empty(0)), 0.0
    merit = _merit(request, response, [when[k] for k in places], leg.seconds)
    best = fitting[int(merit.argmin())]
    return _Choice(best=best, fitting=fitting, omega=response.omega), float(merit.min())


def _merit(
    request: StrokeRequest, response: LegResponse, when: Sequence[CubicSpline], seconds: float
) -> FloatArray:
    """Sway and swing together (C,), m, of laws: the largest over the interval of the stiffness."""
    share = request.cell.options.quiet_stiffness_share
    found = response.of(when, seconds, sorted({1 - share, 1.0, 1 + share}))
    return np.asarray((found.sway + _SWING_WEIGHT * found.swing).max(axis=1))


def _use(request: StrokeRequest, leg: _Leg, candidate: _Candidate, when: CubicSpline) -> float:
    """Largest share of the joints' and the tool's bounds that a law asks for."""
    limits, seconds = request.cell.robot.limits, leg.seconds
    u = np.linspace(_LEAVING, 1.0 - _LEAVING, _LAW_TIMES)
    w = np.clip(when(u), 0.0, 1.0)
    d, dd, ddd = (when(u, k)[:, None] / seconds**k for k in (1, 2, 3))
    q1, q2, q3 = (leg.q(w, k) for k in (1, 2, 3))
    asked = (
        np.abs(q1 * d) / limits.velocity,
        np.abs(q2 * d**2 + q1 * dd) / limits.acceleration,
        np.abs(q3 * d**3 + 3 * q2 * d * dd + q1 * ddd) / limits.jerk,
    )
    use = max(float(part.max()) for part in asked)
    if request.task.max_speed is not None:
        length = request.task.path.segments[leg.number].curve.length
        speed = float(candidate.law.rate(u).max()) * length / seconds
        # A tool at its largest speed all along is what it is allowed.
        use = max(use, _MAX_JOINT_USE * speed / request.task.max_speed)
    return use
