"""The time laws of a quiet stroke: of ramps and input shapers those by which the tool sways least.

Each law takes the seconds of its leg and keeps a speed that is asked for. What a law makes of the arm is
predicted along the joint path of the initial guess, for the stiffness as modelled and at both ends of its
interval.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.flexibility.leg_response import LegResponse
from cmbot.planning.request import StrokeRequest
from cmbot.planning.timing.leg_paths import LegPath, leg_paths
from cmbot.toolpath import LegLaw, Segment, Shaper, TimeLaw, extra_insensitive, two_hump
from cmbot.trajectory import QuinticTrajectory

_RAMP_SHARES = (0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
# A shaper takes this share of a leg's time at most; ramps beside a speed that is asked for are no shorter.
_LONGEST_SHAPER, _SHORTEST_RAMP = 0.4, 0.08
# Share of the joints' bounds that a law may use along the guess: splines through its points swing about it.
_MAX_JOINT_USE = 0.9
# What swings after the stop counts so much beside what sways at work: the next leg inherits it.
_SWING_WEIGHT = 2.0
# Legs whose response is predicted; others have the ramp and shaper of the one that is most like them.
_MAX_LEGS = 8
_LAW_TIMES = 241


@dataclass(frozen=True, kw_only=True, eq=False)
class _Candidate:
    """A ramp, as a share of what a shaper leaves of a leg's time, and the number of the shaper."""

    ramp: float
    shaper: int
    law: TimeLaw


def quiet_laws(request: StrokeRequest, trajectory: QuinticTrajectory) -> tuple[LegLaw, ...]:
    """Return the laws of a stroke's legs but those that have a process speed between leads, or stay.

    None where those of the scene are the best.

    Parameters
    ----------
    request : StrokeRequest
        Its profile is ``quiet``.
    trajectory : QuinticTrajectory
        Along which the laws are chosen: the initial guess's.
    """
    segments, arm = request.task.path.segments, request.cell.arm
    moving = [k for k, leg in enumerate(segments) if _moves(leg) and leg.process is None]
    if not moving:
        return ()
    places = np.unique(np.linspace(0, len(moving) - 1, min(len(moving), _MAX_LEGS)).round().astype(int))
    paths = leg_paths(request, [moving[k] for k in places], trajectory)
    chosen = dict[int, tuple[_Candidate, FloatArray]]()
    for path in paths:
        response = None if arm is None else LegResponse(arm, path.q)
        omega = np.empty(0) if response is None else response.omega
        chosen[path.leg] = _best(request, path, response, list(_candidates(request, path.leg, omega))), omega
    if all(best.law is segments[leg].law for leg, (best, _) in chosen.items()):
        return ()
    laws = []
    for leg in moving:
        best, omega = chosen[min(chosen, key=partial(_unlikeness, segments, leg))]
        law = best.law if leg in chosen else _alike(best, list(_candidates(request, leg, omega)))
        laws.append(LegLaw.of(leg, law, segments[leg].seconds))
    return tuple(laws)


def _unlikeness(segments: Sequence[Segment], leg: int, other: int) -> tuple[float, int]:
    """How far two legs are from each other: first in their durations, then in their order."""
    return abs(float(np.log(segments[other].seconds / segments[leg].seconds))), abs(other - leg)


def _alike(best: _Candidate, candidates: list[_Candidate]) -> TimeLaw:
    """The law with the ramp and the shaper of another leg's; where it does not fit, the scene's."""
    same = [each for each in candidates if (each.ramp, each.shaper) == (best.ramp, best.shaper)]
    return (same or candidates)[0].law


def _moves(leg: Segment) -> bool:
    return leg.curve.length > 0 or bool(leg.turn.any())


def _plain(request: StrokeRequest, leg: int) -> _Candidate:
    """The law as the scene has it."""
    return _Candidate(
        ramp=request.stroke.file.speed_profile.ramp, shaper=0, law=request.task.path.segments[leg].law
    )


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


def _candidates(request: StrokeRequest, leg: int, omega: FloatArray) -> Iterator[_Candidate]:
    """The scene's law, and others in the same time, with the same speed where one is asked for."""
    yield _plain(request, leg)
    stroke, seconds = request.stroke, request.task.path.segments[leg].seconds
    asked, own = stroke.asked_speed(leg) is not None, stroke.file.speed_profile.ramp
    for number, shaper in enumerate(_shapers(omega, request.cell.robot.damping_ratio)):
        share = 0.0 if shaper is None else shaper.duration / seconds
        if share > _LONGEST_SHAPER:
            continue
        # The speed between ramps is that of the scene's law: (1 - share) (1 - ramp) is what it was.
        ramps = (1 - (1 - own) / (1 - share),) if asked else _RAMP_SHARES
        for ramp in ramps:
            if ramp < _SHORTEST_RAMP or (shaper is None and ramp == own):
                continue
            law = TimeLaw.ramped("quiet", ramp, 1 - 2 * ramp, ramp)
            yield _Candidate(
                ramp=ramp, shaper=number, law=law if shaper is None else law.shaped(shaper, seconds)
            )


def _best(
    request: StrokeRequest, path: LegPath, response: LegResponse | None, candidates: list[_Candidate]
) -> _Candidate:
    """The candidate with the least sway and swing of those within the joints' bounds."""
    seconds, share = request.task.path.segments[path.leg].seconds, request.cell.options.quiet_stiffness_share
    use = np.array([_use(request, path, candidate.law, seconds) for candidate in candidates])
    allowed = max(_MAX_JOINT_USE, use.min())
    fitting = [candidate for candidate, part in zip(candidates, use, strict=True) if part <= allowed]
    if response is None:
        return fitting[0]
    factors = sorted({1 - share, 1.0, 1 + share})
    found = response.of([candidate.law for candidate in fitting], seconds, factors)
    merit = (found.sway + _SWING_WEIGHT * found.swing).max(axis=1)
    return fitting[int(merit.argmin())]


def _use(request: StrokeRequest, path: LegPath, law: TimeLaw, seconds: float) -> float:
    """Largest share of the joints' and the tool's bounds that a law asks for along a joint path."""
    u, limits = np.linspace(0.0, 1.0, _LAW_TIMES), request.cell.robot.limits
    s = law.share(u)
    d, dd, ddd = ((law.rate(u, k) / seconds**k)[:, None] for k in (1, 2, 3))
    q1, q2, q3 = (path.q(s, k) for k in (1, 2, 3))
    asked = (
        np.abs(q1 * d) / limits.velocity,
        np.abs(q2 * d**2 + q1 * dd) / limits.acceleration,
        np.abs(q3 * d**3 + 3 * q2 * d * dd + q1 * ddd) / limits.jerk,
    )
    use = max(float(part.max()) for part in asked)
    if request.task.max_speed is not None:
        length = request.task.path.segments[path.leg].curve.length
        # A tool at its largest speed all along is what it is allowed.
        use = max(use, _MAX_JOINT_USE * float(d.max()) * length / request.task.max_speed)
    return use
