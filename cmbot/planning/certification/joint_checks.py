"""Checks of the joints: ranges, rates, continuity and the postures at both ends, exact for all times."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.limit import Limit
from cmbot.planning.certification.check import Check
from cmbot.robot import Robot
from cmbot.trajectory import QuinticTrajectory

# What "continuous" and "at rest" mean in floating point: jumps relative to the joint's bound. Where knots
# are dense, the last digit of a position is a jump of a derivative; positions may be off by this many.
_JUMP, _ROUNDING_ULPS = 1e-9, 64
# What the last digit of a position does to derivative k at the end of a quintic, in units of h^-k.
_ROUNDING_GAINS = (1.0, 15.0, 60.0, 60.0)
# No allowance for rounding is larger than this share of a joint's bound, but for the jerk.
_MAX_ALLOWANCE_SHARE = 1e-6
# The same posture, rad.
_POSTURE_ROUNDING = 1e-9
_DERIVATIVES = ("velocity", "acceleration", "jerk")
# A jump of a position is judged as a share of half a turn or of a metre.
_HALF_TURN, _METRE = np.pi, 1.0


def range_check(robot: Robot, trajectory: QuinticTrajectory) -> Check:
    """Position of the joint that comes nearest to an end of its range, at its exact extrema."""
    position = trajectory.extrema(0)
    middle, half = robot.limits.range_middle, robot.limits.range_half
    # Extrema are (segments, n, k).
    value, time = (np.moveaxis(x, 1, 2).reshape(-1, robot.dof) for x in (position.value, position.time))
    quantity = "distance of {} from the middle of its range"
    return _joint_check(robot, quantity, Limit.POSITION, time, np.abs(value - middle), half)


def rate_checks(robot: Robot, trajectory: QuinticTrajectory) -> list[Check]:
    """Velocity, acceleration and jerk of the joint that uses most of its bound, at the exact extrema."""
    checks = []
    for order, name in enumerate(_DERIVATIVES, start=1):
        largest, time = trajectory.extrema(order).largest()
        bound = getattr(robot.limits, name)
        quantity, limit = f"{name} of {{}}", Limit(name)
        checks.append(_joint_check(robot, quantity, limit, time[None], largest[None], bound))
    return checks


def _joint_check(
    robot: Robot, quantity: str, limit: Limit, times: FloatArray, value: FloatArray, bound: FloatArray
) -> Check:
    """The joint, of absolute values (N, n) at `times` (N, n), that uses most of its bound (n,).

    `limit` is also what of `JointUnits` has its unit.
    """
    k, joint = np.unravel_index((value / bound).argmax(), value.shape)
    return Check(
        quantity=quantity.format(robot.joints[joint]),
        time=float(times[k, joint]),
        value=float(value[k, joint]),
        bound=float(bound[joint]),
        unit=getattr(robot.limits.units(int(joint)), limit.value),
        limit=limit,
        joint=robot.joints[joint],
    )


def posture_checks(
    robot: Robot, trajectory: QuinticTrajectory, start: FloatArray | None, end: FloatArray | None
) -> list[Check]:
    """Distances from the postures (n,), rad, that are required at the start and at the end."""
    checks = []
    for name, posture, k in (("start", start, 0), ("end", end, -1)):
        if posture is not None:
            away = np.abs(trajectory.q[k] - posture)
            checks.append(
                Check(
                    quantity=f"distance of the {name} from the posture required there",
                    time=float(trajectory.t[k]),
                    value=float(away.max()),
                    bound=_POSTURE_ROUNDING,
                    unit=robot.limits.units(int(away.argmax())).position,
                )
            )
    return checks


def continuity_check(robot: Robot, trajectory: QuinticTrajectory) -> Check:
    """Largest jump at an inner knot, or rate left at an end (Eqs. (34)-(37)), as a share of what it may be.

    That is a billionth of the joint's bound, or what the last digits of the positions do in the shorter one
    of the segments at the knot, order by order.
    """
    limits, t = robot.limits, trajectory.t
    h = np.diff(t)
    digit = _ROUNDING_ULPS * np.spacing(np.abs(trajectory.q).max(axis=0))
    shorter = np.concatenate([h[:1], np.minimum(h[:-1], h[1:]), h[-1:]])[:, None]
    shares = list[FloatArray]()
    position = np.where(limits.prismatic, _METRE, _HALF_TURN)
    bounds = (position, limits.velocity, limits.acceleration, limits.jerk)
    for order, bound in enumerate(bounds):
        jump = np.zeros_like(trajectory.q)
        jump[1:-1] = trajectory.jumps(order)
        if order > 0:
            jump[[0, -1]] = trajectory.evaluate(t[[0, -1]], order)
        rounding = _ROUNDING_GAINS[order] * digit / bound / shorter**order
        if order < len(bounds) - 1:
            rounding = np.minimum(rounding, _MAX_ALLOWANCE_SHARE)
        shares.append((np.abs(jump / bound) / np.maximum(rounding, _JUMP)).max(axis=1))
    worst = np.max(shares, axis=0)
    return Check(
        quantity="jump of a joint's position, velocity, acceleration or jerk",
        time=float(t[worst.argmax()]),
        value=float(worst.max()),
        bound=1.0,
        unit="of its allowance",
        limit=Limit.CONTINUITY,
    )
