"""Advice: slower legs, an eased bound or less that is kept, tried where a stroke is refused, and told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any, assert_never

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import FAR_BEYOND, LimitViolation, PathNotFound
from cmbot.common.limit import Limit
from cmbot.planning.attempts.agenda import Remedy, Solved, Trial
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.attempts.failure import (
    Failure,
    JointRate,
    NearObstacle,
    NoTrajectory,
    NoWay,
    OtherLimit,
    OutOfTime,
    ToolOff,
    Uncertified,
)
from cmbot.planning.path.nearest_miss import less_kept, nearest_miss
from cmbot.planning.request import StrokeRequest
from cmbot.scene import Stroke
from cmbot.trajectory import QuinticTrajectory

# A little more than the ratio, for what the optimiser needs beside.
_DURATION_MARGIN = 1.05
# Where legs would have to take longer by a larger factor, something else is the matter.
_MAX_STRETCH = 30.0
# A limit is reached from this share of it on; then a leg is to take so much longer.
_AT_LIMIT, _DOUBLE = 0.99, 2.0
# More legs than these are not listed one by one.
_MOST_LISTED, _MOST_DIGITS = 3, 9
# Options that have the bounds of what keeps the tool on its path; eased by a larger factor than this, a bound
# is another one.
_EASED_OPTIONS = {
    Limit.TOOL_DEVIATION: "max_tool_deviation_m",
    Limit.SHIFT: "max_tool_deviation_m",
    Limit.TOOL_ROTATION: "max_tool_rotation_deg",
    Limit.TOOL_LAG: "max_tool_lag_m",
}
_MARGIN_OPTION, _MOST_EASED = "safety_margin_m", 3.0


def slower_legs(request: StrokeRequest, failure: Failure) -> FloatArray | None:
    """Return by which factors (L,) the legs would have to take longer; None where time is not the matter.

    A velocity of r times its bound asks for r times the seconds, an acceleration for r^(1/2), a jerk for
    r^(1/3).
    """
    factors = np.ones(len(request.task.path.seconds))
    match failure:
        case NoWay():
            factors[request.task.path.leg_to(failure.error.time)] = failure.error.pace
        case Uncertified(broken=JointRate(order=order, ratio=ratio)) if order:
            factors[request.task.path.leg_to(failure.error.time)] = ratio ** (1 / order)
        case NoTrajectory(broken=OtherLimit(what=Limit.LEAP)):
            return None
        case NoTrajectory():
            factors = _factors(request, failure.error.trajectory)
            if not isinstance(failure.broken, JointRate):
                # Joints at their limits leave the tool behind.
                hasty = (factors >= _AT_LIMIT) & (failure.error.violation > FAR_BEYOND)
                factors = np.where(hasty, _DOUBLE, 1.0)
        case Uncertified() | OutOfTime():
            return None
        case _:
            assert_never(failure)
    factors = np.where(factors > 1.0, _DURATION_MARGIN * factors, 1.0)
    return factors if 1.0 < factors.max() <= _MAX_STRETCH else None


def eased(request: StrokeRequest, failure: Failure) -> StrokeRequest | None:
    """Return the request with an option eased that has the bound which could not be kept.

    A smaller safety margin, a tool that may leave its path further, or a process force that sets in slowly.
    None where it is another bound, or one that would have to be eased by far.
    """
    options = request.cell.options
    match failure:
        case Uncertified(error=LimitViolation(limit=Limit.SWAY)):
            # What a force adds that sets in at once no motion changes.
            if not request.cell.robot.pushed_at_once:
                return None
            return replace(request, cell=request.cell.ramped(request.first))
        case NoTrajectory(broken=broken) | Uncertified(broken=broken):
            pass
        case NoWay(error=PathNotFound(pair=(_, _))):
            # In the best posture for the place that is furthest from one, unless the start itself is near.
            miss = None if failure.is_start_near else nearest_miss(request, is_clear=True)
            nearest = miss.missed.best if miss and miss.pair else request.first
            distance = float(request.cell.clearances.query(nearest[None]).distance[0])
            broken = NearObstacle(distance=distance, margin=options.safety_margin_m)
        case _:
            return None
    match broken:
        case NearObstacle(distance=near, margin=margin) if near < margin <= _MOST_EASED * near:
            return request.with_options(**{_MARGIN_OPTION: _rounded_down(near / _DURATION_MARGIN)})
        case ToolOff(what=what, ratio=ratio) if what in _EASED_OPTIONS and ratio <= _MOST_EASED:
            name = _EASED_OPTIONS[what]
            most = _rounded_up(_DURATION_MARGIN * ratio * getattr(options, name))
            return request.with_options(**{name: most})
    return None


def changed_in_words(before: StrokeRequest, after: StrokeRequest) -> str:
    """Say by the keys of the scene what was eased, what is kept instead, and which legs take longer."""
    words = list[str]()
    for option in dict.fromkeys((_MARGIN_OPTION, *_EASED_OPTIONS.values())):
        old, new = (getattr(request.cell.options, option) for request in (before, after))
        if new != old:
            words.append(_changed(f"planner.{option}", new, old, 4))
    old, new = (request.cell.robot.tool_ramp for request in (before, after))
    if new != old:
        words.append(_changed("tool.process_ramp_s", new, old, 3))
    if after.task.kept != before.task.kept:
        words.append(f"{before.stroke.key}.keep {after.task.kept} instead of {before.task.kept}")
    if (after.task.path.seconds > before.task.path.seconds).any():
        words.append(in_keys(before, after))
    return " and ".join(words)


def _slower_legs(trial: Trial[Attempt, Any]) -> Iterator[Attempt]:
    """Slower legs, where velocities, accelerations or jerks are what fails."""
    request, outcome = trial.attempt.request, trial.outcome
    if not isinstance(outcome, Solved) and (factors := slower_legs(request, outcome)) is not None:
        yield Attempt.of(slower(request, factors))


def _eased_bound(trial: Trial[Attempt, Any]) -> Iterator[Attempt]:
    """An eased bound, of what was refused itself."""
    request, outcome = trial.attempt.request, trial.outcome
    if not isinstance(outcome, Solved) and trial.parent is None and (easier := eased(request, outcome)):
        yield Attempt.of(easier)


def _less_kept(trial: Trial[Attempt, Any]) -> Iterator[Attempt]:
    """Less that is kept of the tool's pose, where no posture or no trajectory leads on with all of it."""
    request = trial.attempt.request
    match trial.outcome:
        case NoWay(is_start_near=False) | NoTrajectory() if trial.parent is None:
            for keep in less_kept(request.stroke.file.keep):
                yield Attempt.of(replace(request, task=replace(request.task, keep=keep, cone=None)))


SLOWER_LEGS = Remedy(cost=10_000, propose=_slower_legs, most=2)
EASED_BOUND = Remedy(cost=10_000, propose=_eased_bound)
LESS_KEPT = Remedy(cost=20_000, propose=_less_kept)


def slower(request: StrokeRequest, factors: FloatArray) -> StrokeRequest:
    """Return the request of legs that take longer by `factors` (L,), to round numbers of the scene's keys.

    More than a few, and those that share a key, are slowed down as one.
    """
    path, stroke = request.task.path, request.stroke
    if (factors > 1.0).sum() > _MOST_LISTED or not _have_own_keys(stroke):
        factors = np.full(len(factors), factors.max())
    seconds = path.seconds.copy()
    for k in np.flatnonzero(factors > 1.0):
        # A speed, or else the duration in the file, which the legs of a raster share.
        speed = stroke.asked_speed(int(k))
        if speed is not None:
            seconds[k] *= speed / _rounded_down(speed / factors[k])
        else:
            own = _own_seconds(stroke, float(path.seconds[k]))
            seconds[k] *= _rounded_up(own * factors[k]) / own
    path = path.in_seconds(seconds)
    times = path.via_times(len(request.times))
    return replace(request, task=replace(request.task, path=path), times=times)


def _own_seconds(stroke: Stroke, leg: float) -> float:
    """The seconds that a stroke's file has: of a leg, which takes `leg` s, or else of the whole path."""
    return leg if stroke.file.legs else stroke.file.given_time or leg


def in_keys(before: StrokeRequest, after: StrokeRequest) -> str:
    """Say by the keys of the scene which legs take longer after than before, and how long."""
    stroke, old, new = before.stroke, before.task.path.seconds, after.task.path.seconds
    changed = np.flatnonzero(new > old)
    ratio = float((new / old).max())
    if stroke.file.legs and (len(changed) > _MOST_LISTED or not _have_own_keys(stroke)):
        return f"every leg of {stroke.key}.legs in {ratio:.2g} times its seconds"
    words = list[str]()
    for k in changed if stroke.file.legs else changed[:1]:
        key = stroke.leg_key(int(k)) if stroke.file.legs else stroke.key
        speed = stroke.asked_speed(int(k))
        if speed is not None:
            words.append(_changed(f"{key}.speed_m_s", speed * old[k] / new[k], speed, 3))
        else:
            own = _own_seconds(stroke, float(old[k]))
            words.append(_changed(f"{key}.seconds", own * new[k] / old[k], own, 4))
    return " and ".join(words)


def _changed(key: str, new: float, old: float, digits: int) -> str:
    """Say what a key is to be instead of what it is, with as many digits as tell the two apart."""
    while f"{new:.{digits}g}" == f"{old:g}" and digits < _MOST_DIGITS:
        digits += 1
    return f"{key} {new:.{digits}g} instead of {old:g}"


def _have_own_keys(stroke: Stroke) -> bool:
    """Whether every leg of the timed path has an entry of its own in the scene."""
    file = stroke.file
    return bool(file.legs) and not file.blend_radius_m and (file.passes or 1) == 1


def _factors(request: StrokeRequest, trajectory: object) -> FloatArray:
    """By which factors (L,) legs would have to take longer, or may take less, for a trajectory's limits."""
    if not isinstance(trajectory, QuinticTrajectory):
        return np.ones(len(request.task.path.seconds))
    limits, edges = request.cell.robot.limits, request.task.path.leg_times
    middles = 0.5 * (trajectory.t[1:] + trajectory.t[:-1])
    needed = np.zeros(len(middles))
    for order, bound in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        share = np.abs(trajectory.extrema(order).value).max(axis=2) / bound
        needed = np.maximum(needed, share.max(axis=1) ** (1 / order))
    return np.array([needed[(middles >= a) & (middles < b)].max(initial=0.0) for a, b in pairwise(edges)])


def _rounded_up(value: float) -> float:
    """To two digits."""
    digit = 10.0 ** (np.floor(np.log10(abs(value))) - 1)
    return float(round(np.ceil(value / digit - 1e-9) * digit, 9))


def _rounded_down(value: float) -> float:
    """To two digits."""
    return -_rounded_up(-value)
