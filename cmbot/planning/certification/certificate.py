"""The certificate: everything that a plan promises, computed again apart from the optimiser, for all times.

It reads the finished trajectory and the task alone. Position, velocity, acceleration and jerk are judged at
the exact extrema of their polynomials; torques and the tool's pose by enclosures, the clearance by bounds on
the motion (`enclosure`, `nearest_approach`). Where sag is compensated its part of the tool's pose is computed
at the points of interpolation, and what lies between them is estimated from how its coefficients decay.

Ranges, rates and continuity of the joints, and the postures at both ends, are exact for all times.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from cmbot.accuracy.sway import stroke_sway
from cmbot.collision import RESOLUTION, Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import LimitViolation
from cmbot.common.limit import Limit
from cmbot.common.representation import ShortRepr
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag
from cmbot.planning.certification.check import Check, largest_check
from cmbot.planning.certification.enclosed_motion import EnclosedMotion
from cmbot.planning.certification.metrics import LimitUse, MotionMetrics
from cmbot.planning.certification.nearest_approach import NearestApproach, nearest_approach
from cmbot.planning.certification.sag_spread import spread_check
from cmbot.planning.task import ToolTask
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions
from cmbot.trajectory import Peak, QuinticTrajectory

# What "at its timed pose" means, m and rad; the same duration, as a share of it.
_AT_VIA_POINT, _SAME_DURATION = 1e-6, 1e-9
# Motions that break the bound of a rate so many times, as damaged files do, are enclosed coarsely: no closer
# look makes them hold, and it would take long.
_COARSE_RATIO = 1e5
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


@dataclass(frozen=True, kw_only=True)
class Certificate(ShortRepr):
    """What a trajectory was found to do.

    Attributes
    ----------
    checks : tuple of Check
        All promises; the plan is valid when every one holds.
    figures : MotionMetrics
        The largest and smallest values that were found.
    clearance_bound : float, m
        No distance is smaller than this at any time.
    guardrail_torque_bound : float, Nm
        The torque on the guardrail is nowhere larger: with the peak among the figures, an interval.
    adhesion_bound : float, N
        No foot needs more adhesion at any time; infinite where none holds by it.
    """

    checks: tuple[Check, ...]
    figures: MotionMetrics
    clearance_bound: float
    guardrail_torque_bound: float
    adhesion_bound: float = np.inf

    @property
    def holds(self) -> bool:
        """Whether every promise is kept."""
        return all(check.holds for check in self.checks)

    def at_all_times(self, base: str = "guardrail") -> str:
        """Return the bounds in words, rounded away from what was found; the torque acts on the `base`."""
        bounds = [f"clearance stays above {np.floor(1e4 * self.clearance_bound) / 10:.1f} mm"]
        if np.isfinite(self.guardrail_torque_bound):
            torque = np.ceil(100 * self.guardrail_torque_bound) / 100
            bounds.append(f"the torque on the {base} below {torque:.2f} Nm")
        if np.isfinite(self.adhesion_bound):
            bounds.append(f"the adhesion needed below {np.ceil(self.adhesion_bound / 10) / 100:.2f} kN")
        return " and ".join([", ".join(bounds[:-1]), bounds[-1]] if bounds[1:] else bounds)

    def require(self) -> None:
        """Refuse a trajectory that breaks a promise.

        Raises
        ------
        LimitViolation
            For the first check that does not hold.
        """
        for check in self.checks:
            if not check.holds:
                raise LimitViolation(
                    **{each.name: getattr(check, each.name) for each in fields(LimitViolation)}
                )


def certify(
    robot: Robot,
    task: ToolTask,
    trajectory: QuinticTrajectory,
    clearances: Clearances,
    options: PlannerOptions,
    *,
    via_points: int | None,
    start: FloatArray | None = None,
    end: FloatArray | None = None,
    sag: Sag | None = None,
    arm: ElasticArm | None = None,
) -> Certificate:
    """Judge a finished trajectory by its task.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
        The scene's; of an approach, the tool held where the work starts.
    trajectory : QuinticTrajectory
    clearances : Clearances
    options : PlannerOptions
        Margin, tool deviation, rotation and lag that were promised.
    via_points : int or None
        The scene's number: at their times the tool has to be at its timed pose, and between them within the
        bounds of the options. 0: within these alone. None with the tool off: then the task is only measured.
    start, end : (n,), rad, optional
        Postures that the trajectory has to start and end in.
    sag : Sag, optional
        Where it is compensated: the tool is where the bent arm is predicted to hold it; its orientation is
        the commanded one.
    arm : ElasticArm, optional
        What bends at work. A bound of its sway is judged by integrating small vibrations at the least, the
        stated and the largest stiffness: simulated, not proven.
    """
    rates = rate_checks(robot, trajectory)
    absurd = not all(check.value <= _COARSE_RATIO * check.bound for check in rates)
    motion = EnclosedMotion(robot, task, trajectory, sag, coarse=absurd)
    closely = (np.inf, -np.inf) if absurd else (RESOLUTION, options.safety_margin_m)
    nearest = nearest_approach(trajectory, clearances, *closely)
    torque, hold = motion.joint_torque(), motion.hold()
    deviation, rotation, lag = motion.tool_deviation(), motion.tool_rotation(), motion.tool_lag()
    checks = [range_check(robot, trajectory), *rates, torque, continuity_check(robot, trajectory)]
    checks += posture_checks(robot, trajectory, start, end)
    checks.append(_clearance_check(nearest, clearances, options.safety_margin_m))
    if via_points is not None:
        checks += _path_checks(task, trajectory, motion, options, via_points, sag, deviation, rotation, lag)
    checks += _speed_checks(task, motion, sag)
    checks += () if hold is None else hold.checks()
    checks += motion.holding_torque()
    guardrail, mean, rms, static = motion.guardrail_torque()
    if task.max_base_torque is not None:
        checks.append(
            _enclosed(Limit.BASE_TORQUE, "torque on the base", guardrail, task.max_base_torque, "Nm")
        )
    if arm is not None and task.max_sway is not None:
        checks += _sway_checks(arm, trajectory, options.quiet_stiffness_share, task.max_sway)
    shares = [check.value / check.bound for check in (*rates, torque)]
    figures = MotionMetrics(
        peak_guardrail_torque=guardrail.value,
        mean_guardrail_torque=mean,
        rms_guardrail_torque=rms,
        peak_static_guardrail_torque=static,
        min_clearance=nearest.distance,
        max_tool_deviation=deviation.value,
        max_tool_rotation=rotation.value,
        max_tool_lag=lag.value,
        limit_use=LimitUse(velocity=shares[0], acceleration=shares[1], jerk=shares[2], torque=shares[3]),
        adhesion_needed=None if hold is None else hold.needed,
        duration=trajectory.duration,
        guardrail_torque_integral=mean * trajectory.duration,
    )
    return Certificate(
        checks=tuple(checks),
        figures=figures,
        clearance_bound=nearest.bound,
        guardrail_torque_bound=guardrail.bound,
        adhesion_bound=np.inf if hold is None else hold.needed_bound,
    )


def _clearance_check(nearest: NearestApproach, clearances: Clearances, margin: float) -> Check:
    pair = clearances.pairs[nearest.pair] if nearest.pair >= 0 else None
    between = "" if pair is None else f" of {pair.link} from {pair.other}"
    return Check(
        quantity="clearance" + between,
        time=nearest.time,
        value=nearest.bound if nearest.distance >= margin else nearest.distance,
        bound=margin,
        unit="m",
        at_least=True,
        limit=Limit.CLEARANCE,
    )


def _path_checks(
    task: ToolTask,
    trajectory: QuinticTrajectory,
    motion: EnclosedMotion,
    options: PlannerOptions,
    via_points: int,
    sag: Sag | None,
    deviation: Peak,
    rotation: Peak,
    lag: Peak,
) -> list[Check]:
    """Where the tool is while it is on: at the via-points, and how far off its timed pose at any time."""
    expected = _expected(sag)
    quantity, most = Limit.TOOL_TILT, task.cone
    if most is None:
        # Unlike a cone, which is what is prescribed, that is for what lies between via-points.
        quantity, most = Limit.TOOL_ROTATION, float(np.deg2rad(options.max_tool_rotation_deg))
    checks = [
        _duration_check(task, trajectory),
        *(_via_point_checks(task, motion, options, via_points, expected) if via_points else ()),
        _enclosed(
            Limit.TOOL_DEVIATION, f"{expected}tool deviation", deviation, options.max_tool_deviation_m, "m"
        ),
        _enclosed(quantity, quantity.value, rotation, most, "rad"),
        _enclosed(Limit.TOOL_LAG, f"{expected}tool lag", lag, options.max_tool_lag_m, "m"),
    ]
    if sag is not None and sag.covariance is not None and options.deviation_sigmas:
        promised = (options.deviation_sigmas, options.max_tool_deviation_m)
        checks.append(spread_check(task.path, sag, trajectory, deviation.bound, *promised))
    return checks


def _speed_checks(task: ToolTask, motion: EnclosedMotion, sag: Sag | None) -> list[Check]:
    """How fast the tool is, and how far off the process speed, where the task bounds these."""
    expected, checks = _expected(sag), list[Check]()
    if task.max_speed is not None:
        speed, most = motion.tool_speed(), task.max_speed
        checks.append(_enclosed(Limit.TOOL_SPEED, f"{expected}tool speed", speed, most, "m/s"))
    if task.speed_tolerance is not None:
        quantity, missed = f"{expected}deviation of the process speed", motion.process_speed()
        checks.append(_enclosed(Limit.PROCESS_SPEED, quantity, missed, task.speed_tolerance, "of it"))
    return checks


def _sway_checks(arm: ElasticArm, trajectory: QuinticTrajectory, share: float, most: float) -> list[Check]:
    """How far the tool sways at work and swings after it, as simulated."""
    sway = stroke_sway(arm, trajectory, share)
    last, (size, swing) = float(trajectory.t[-1]), sway.largest
    when = float(sway.t[np.linalg.norm(sway.tool, axis=2).max(axis=0).argmax()])
    # By parabolas through three steps the tool sways by so much more between them.
    more = float(np.linalg.norm(np.diff(sway.tool, n=2, axis=1), axis=2).max()) / 8
    return [
        Check(quantity=f"simulated {name}", time=time, value=value, bound=most, unit="m", limit=Limit.SWAY)
        for name, time, value in (
            ("sway of the tool", min(when, last), size + more),
            ("swing of the tool after the stop", last, swing + 2 * more),
        )
    ]


def _expected(sag: Sag | None) -> str:
    """What is said before the name of a figure of the tool's point where sag is compensated."""
    return "" if sag is None else "expected "


def _via_point_checks(
    task: ToolTask, motion: EnclosedMotion, options: PlannerOptions, count: int, expected: str
) -> list[Check]:
    """Where the tool is at the via-points; its point, where sag is compensated, as `expected`."""
    off, turned = motion.at_via_points(count)
    # The compensation converges to a share of what is allowed in between.
    allowed = options.max_tool_deviation_m if expected else _AT_VIA_POINT
    place = f"{expected}distance of the tool from its place at a via-point"
    checks = [largest_check(place, *off, allowed, "m")]
    if task.cone is None:
        there = "rotation of the tool from its orientation at a via-point"
        checks.append(largest_check(there, *turned, _AT_VIA_POINT, "rad"))
    return checks


def _duration_check(task: ToolTask, trajectory: QuinticTrajectory) -> Check:
    first, last, duration = float(trajectory.t[0]), float(trajectory.t[-1]), task.path.duration
    return Check(
        quantity="difference of the trajectory's times from the tool path's",
        time=last,
        value=float(np.max(np.abs([first, last - duration]))),
        bound=_SAME_DURATION * duration,
        unit="s",
    )


def _enclosed(limit: Limit, quantity: str, peak: Peak, bound: float, unit: str) -> Check:
    value, bound = peak.bound, float(bound)
    return Check(quantity=quantity, time=peak.time, value=value, bound=bound, unit=unit, limit=limit)


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
