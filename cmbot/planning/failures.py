"""Failures: what is in the way by its name, and what is to be tried: slower legs, a bound that is eased."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import (
    FAR_BEYOND,
    LimitViolation,
    OptimisationFailed,
    PathNotFound,
    PlanningError,
)
from cmbot.planning.context import PlanningContext
from cmbot.robot import Dynamics
from cmbot.scene import Stroke
from cmbot.trajectory import QuinticTrajectory

__all__ = ["constraints_named", "eased", "in_keys", "slower", "slower_legs"]

# Samples per segment at which the nearest pair and the weakest joint are sought.
_SAMPLES = 10
# Slowing a leg down by r divides the derivative of this order by r^order.
_ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3}
# A little more than the ratio, for what the optimiser needs beside.
_ROOM = 1.05
# Where legs would have to take longer by a larger factor, something else is the matter.
_SLOWEST = 30.0
# A limit is reached from this share of it on; then a leg is to take so much longer.
_AT_LIMIT, _DOUBLE = 0.99, 2.0
# More legs than these are not listed one by one.
_MOST_LISTED, _MOST_DIGITS = 3, 9
# Options that have the bounds of constraints, by how their names begin; eased by a larger factor than this,
# a bound is another one.
_EASED = {
    "tool deviation": "max_tool_deviation_m",
    "change of the shift": "max_tool_deviation_m",
    "tool rotation": "max_tool_rotation_deg",
    "tool lag": "max_tool_lag_m",
}
_MOST_EASED, _NOTHING = 3.0, 1e-9
# How the optimiser, which knows no limit, says that it had to stop.
_LATE = "the time was over"


@contextmanager
def constraints_named(context: PlanningContext) -> Iterator[None]:
    """Name in an `OptimisationFailed` the link and obstacle, or the joint, of its worst constraint."""
    try:
        yield
    except OptimisationFailed as failure:
        raise OptimisationFailed(
            failure.reason.replace(_LATE, _time_over(context)),
            constraint=_named(context, failure),
            violation=failure.violation,
            undecided=failure.undecided,
            trajectory=failure.trajectory,
        ) from failure


def _time_over(context: PlanningContext) -> str:
    """Say that the time was over: what it was, and what was used of it."""
    return f"{context.time_in_words}, was over after {context.reporter.used:.3g} s,"


def _named(context: PlanningContext, failure: OptimisationFailed) -> str:
    trajectory, name = failure.trajectory, failure.constraint
    if not isinstance(trajectory, QuinticTrajectory):
        return name
    q, v, a = trajectory.sampled(_SAMPLES)
    if name == "clearance":
        smallest = context.clearances.smallest(q)
        pair = context.clearances.pairs[int(smallest.pair[smallest.distance.argmin()])]
        return f"clearance of {pair.link} from {pair.other}"
    if name == "joint torque":
        use = np.abs(Dynamics(context.robot).efforts(q, v, a).joint_torque) / context.robot.limits.torque
        return f"torque of {context.robot.joints[int(use.max(axis=0).argmax())]}"
    return name


def slower_legs(context: PlanningContext, failure: PlanningError) -> FloatArray | None:
    """Return by which factors (L,) the legs would have to take longer; None where time is not the matter.

    A velocity of r times its bound asks for r times the seconds, an acceleration for r^(1/2), a jerk for
    r^(1/3).
    """
    factors = np.ones(len(context.task.path.seconds))
    if isinstance(failure, PathNotFound):
        factors[_leg(context, failure.time)] = failure.pace
    elif isinstance(failure, LimitViolation):
        if order := _order(failure.quantity):
            factors[_leg(context, failure.time)] = (failure.value / failure.bound) ** (1 / order)
    elif isinstance(failure, OptimisationFailed):
        factors = _factors(context, failure.trajectory)
        if not _order(failure.constraint):
            # Joints at their limits leave the tool behind.
            hasty = (factors >= _AT_LIMIT) & (failure.violation > FAR_BEYOND)
            factors = np.where(hasty, _DOUBLE, 1.0)
    factors = np.where(factors > 1.0, _ROOM * factors, 1.0)
    return factors if 1.0 < factors.max() <= _SLOWEST else None


def eased(context: PlanningContext, failure: PlanningError) -> tuple[str, PlanningContext] | None:
    """Return the context with an option eased that has the bound which could not be kept, and that in words.

    A smaller safety margin, or a tool that may leave its path further. None where it is another bound, or one
    that would have to be eased by far.
    """
    name, margin = None, context.options.safety_margin_m
    if isinstance(failure, OptimisationFailed):
        name, ratio, distance = failure.constraint, 1 + failure.violation, 0.0
        if isinstance(failure.trajectory, QuinticTrajectory):
            distance = float(
                context.clearances.smallest(failure.trajectory.sampled(_SAMPLES)[0]).distance.min()
            )
    elif isinstance(failure, LimitViolation):
        name, ratio, distance = failure.quantity, failure.value / failure.bound, failure.value
    elif isinstance(failure, PathNotFound) and failure.pair is not None and failure.time == 0.0:
        name, ratio = "clearance", 1.0
        distance = float(context.clearances.smallest(context.first[None]).distance[0])
    if name is None:
        return None
    option = next((option for begin, option in _EASED.items() if name.startswith(begin)), None)
    value = None if option is None else _rounded_up(_ROOM * ratio * getattr(context.options, option))
    if name.startswith("clearance"):
        option, ratio = "safety_margin_m", margin / max(distance, _NOTHING)
        value = _rounded_down(distance / _ROOM) if distance > 0 else None
    if option is None or value is None or not 0 < ratio <= _MOST_EASED:
        return None
    change: dict[str, Any] = {option: value}
    changed = replace(context, options=replace(context.options, **change))
    return _changed(f"planner.{option}", value, getattr(context.options, option), 4), changed


def slower(context: PlanningContext, factors: FloatArray) -> PlanningContext:
    """Return the context of legs that take longer by `factors` (L,), to round numbers of the scene's keys.

    More than a few, and those that share a key, are slowed down as one.
    """
    path, stroke = context.task.path, context.stroke
    if (factors > 1.0).sum() > _MOST_LISTED or not _have_own_keys(stroke):
        factors = np.full(len(factors), factors.max())
    seconds = path.seconds.copy()
    for k in np.flatnonzero(factors > 1.0):
        # A speed, or else the duration in the file, which the legs of a raster share.
        speed = stroke.asked_speed(int(k))
        if speed is not None:
            seconds[k] *= speed / _rounded_down(speed / factors[k])
        else:
            own = float(path.seconds[k] if stroke.file.legs else stroke.file.seconds or path.seconds[k])
            seconds[k] *= _rounded_up(own * factors[k]) / own
    path = replace(path, seconds=seconds)
    times = path.via_times(len(context.times))
    return replace(context, task=replace(context.task, path=path), times=times)


def in_keys(before: PlanningContext, after: PlanningContext) -> str:
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
            own = float(old[k] if stroke.file.legs else stroke.file.seconds or old[k])
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


def _factors(context: PlanningContext, trajectory: object) -> FloatArray:
    """By which factors (L,) legs would have to take longer, or may take less, for a trajectory's limits."""
    if not isinstance(trajectory, QuinticTrajectory):
        return np.ones(len(context.task.path.seconds))
    limits, edges = context.robot.limits, context.task.path.leg_times
    middles = 0.5 * (trajectory.t[1:] + trajectory.t[:-1])
    needed = np.zeros(len(middles))
    for order, bound in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        share = np.abs(trajectory.extrema(order).value).max(axis=2) / bound
        needed = np.maximum(needed, share.max(axis=1) ** (1 / order))
    return np.array([needed[(middles >= a) & (middles < b)].max(initial=0.0) for a, b in pairwise(edges)])


def _order(constraint: str) -> int:
    return next((order for name, order in _ORDERS.items() if constraint.startswith(name)), 0)


def _leg(context: PlanningContext, time: float) -> int:
    """The leg that leads to a time."""
    edges = context.task.path.leg_times
    return int(np.clip(np.searchsorted(edges, time) - 1, 0, len(edges) - 2))


def _rounded_up(seconds: float) -> float:
    """To two digits."""
    digit = 10.0 ** (np.floor(np.log10(seconds)) - 1)
    return float(round(np.ceil(seconds / digit - 1e-9) * digit, 9))


def _rounded_down(speed: float) -> float:
    """To two digits."""
    digit = 10.0 ** (np.floor(np.log10(speed)) - 1)
    return float(round(np.floor(speed / digit + 1e-9) * digit, 9))
