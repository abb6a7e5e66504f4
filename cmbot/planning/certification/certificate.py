"""The certificate: everything that a plan promises, computed again apart from the optimiser, for all times.

It reads the finished trajectory and the task alone. Position, velocity, acceleration and jerk are judged at
the exact extrema of their polynomials; torques and the tool's pose by enclosures, the clearance by bounds on
the motion (`enclosure`, `nearest_approach`). Where sag is compensated its part of the tool's pose is computed
at the points of interpolation, and what lies between them is estimated from how its coefficients decay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cmbot.collision import RESOLUTION, Clearances
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import LimitViolation
from cmbot.elastic.sag import Sag
from cmbot.planning.certification.check import Check, largest_check
from cmbot.planning.certification.enclosed_hold import EnclosedHold
from cmbot.planning.certification.metrics import LimitUse, MotionMetrics
from cmbot.planning.certification.nearest_approach import nearest_approach
from cmbot.planning.certification.norm_bounds import NormBounds, norm_bounds, timed_pose_bounds
from cmbot.planning.certification.process_speed import speed_deviation
from cmbot.planning.certification.sag_spread import spread_check
from cmbot.planning.task import ToolTask
from cmbot.robot import Dynamics, Efforts, Kinematics, Robot
from cmbot.scene import PlannerOptions
from cmbot.trajectory import Peak, Pieces, QuinticTrajectory, highest

__all__ = ["Certificate", "Check", "certify"]

# How far bounds may lie beyond what was found: of torques, as a share of the bound or of the largest value;
# of the tool, m and rad, or m/s.
_TORQUE_RESOLUTION, _TOOL_RESOLUTION = 1e-6, 1e-8
# Pieces of a trajectory at most, a segment, before the remainder of interpolation stays what it is.
_MOST_PIECES = 64
# What "continuous" and "at rest" mean in floating point: jumps relative to the joint's bound. Where knots
# are dense, the last digit of a position is a jump of a derivative; positions may be off by this many.
_JUMP, _DIGITS = 1e-9, 64
# What the last digit of a position does to derivative k at the end of a quintic, in units of h^-k.
_AMPLIFIED = (1.0, 15.0, 60.0, 60.0)
# No allowance for rounding is larger than this share of a joint's bound, but for the jerk.
_LARGEST_ALLOWANCE = 1e-6
# What "at its timed pose" means, m and rad; the same posture, rad; the same duration, as a share of it.
_AT_VIA_POINT, _SAME_POSTURE, _SAME_DURATION = 1e-6, 1e-9, 1e-9
_DERIVATIVES = ("velocity", "acceleration", "jerk")
# A jump of a position is judged as a share of half a turn or of a metre.
_HALF_TURN, _METRE = np.pi, 1.0


@dataclass(frozen=True, kw_only=True)
class Certificate:
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
        No foot needs more adhesion at any time; infinite where none has a flat contact.
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
                    check.quantity, time=check.time, value=check.value, bound=check.bound, unit=check.unit
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
        bounds of the options. None with the tool off: then the task is only measured.
    start, end : (n,), rad, optional
        Postures that the trajectory has to start and end in.
    sag : Sag, optional
        Where it is compensated: the tool is where the bent arm is predicted to hold it; its orientation is
        the commanded one.
    """
    work = _Work(robot, task, trajectory, sag)
    nearest = nearest_approach(trajectory, clearances, RESOLUTION, options.safety_margin_m)
    rates = _rate_checks(robot, trajectory)
    torque = work.joint_torque()
    checks = [_range_check(robot, trajectory), *rates, torque, _continuity_check(robot, trajectory)]
    for name, posture, k in (("start", start, 0), ("end", end, -1)):
        if posture is not None:
            away = np.abs(trajectory.q[k] - posture)
            checks.append(
                Check(
                    quantity=f"distance of the {name} from the posture required there",
                    time=float(trajectory.t[k]),
                    value=float(away.max()),
                    bound=_SAME_POSTURE,
                    unit=robot.limits.units(int(away.argmax())).position,
                )
            )
    pair = clearances.pairs[nearest.pair] if nearest.pair >= 0 else None
    between = "" if pair is None else f" of {pair.link} from {pair.other}"
    checks.append(
        Check(
            quantity="clearance" + between,
            time=nearest.time,
            value=nearest.bound if nearest.distance >= options.safety_margin_m else nearest.distance,
            bound=options.safety_margin_m,
            unit="m",
            at_least=True,
        )
    )
    deviation, rotation, lag = work.tool_deviation(), work.tool_rotation(), work.tool_lag()
    expected = "" if sag is None else "expected "
    if via_points is not None:
        checks.append(_duration_check(task, trajectory))
        off, turned = work.at_via_points(via_points)
        # The compensation converges to a share of what is allowed in between.
        allowed = _AT_VIA_POINT if sag is None else options.max_tool_deviation_m
        checks.append(
            largest_check(f"{expected}distance of the tool from its place at a via-point", *off, allowed, "m")
        )
        quantity, most = "tool tilt", task.cone
        if most is None:
            # Unlike a cone, which is what is prescribed, that is for what lies between via-points.
            quantity, most = "tool rotation", float(np.deg2rad(options.max_tool_rotation_deg))
            there = "rotation of the tool from its orientation at a via-point"
            checks.append(largest_check(there, *turned, _AT_VIA_POINT, "rad"))
        checks += [
            _enclosed(f"{expected}tool deviation", deviation, options.max_tool_deviation_m, "m"),
            _enclosed(quantity, rotation, most, "rad"),
            _enclosed(f"{expected}tool lag", lag, options.max_tool_lag_m, "m"),
        ]
        if sag is not None and sag.covariance is not None and options.deviation_sigmas:
            promised = (options.deviation_sigmas, options.max_tool_deviation_m)
            checks.append(spread_check(task.path, sag, trajectory, deviation.bound, *promised))
    if task.max_speed is not None:
        checks.append(_enclosed(f"{expected}tool speed", work.tool_speed(), task.max_speed, "m/s"))
    if task.speed_tolerance is not None:
        missed = work.process_speed()
        checks.append(
            _enclosed(f"{expected}deviation of the process speed", missed, task.speed_tolerance, "of it")
        )
    guardrail, mean, rms, static = work.guardrail_torque()
    hold = work.hold()
    checks += () if hold is None else hold.checks()
    if task.max_base_torque is not None:
        checks.append(_enclosed("torque on the base", guardrail, task.max_base_torque, "Nm"))
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


class _Work:
    """Torques and tool of a trajectory at the points of interpolation, and their enclosures."""

    def __init__(self, robot: Robot, task: ToolTask, trajectory: QuinticTrajectory, sag: Sag | None) -> None:
        self._robot, self._task, self._trajectory, self._sag = robot, task, trajectory, sag
        self._dynamics = Dynamics(robot)
        pieces = Pieces.between(trajectory, task.path.breaks)
        self._pieces = pieces.refined(self._share, _MOST_PIECES * len(pieces.start))
        self._bounds = norm_bounds(robot, self._pieces.ellipses)
        q, v, a = self._pieces.states
        self._efforts: Efforts = self._dynamics.efforts(q, v, a)
        self._p_WT, self._R_WT = Kinematics(robot).tool_poses(q)
        self._goals = task.path.poses(self._pieces.times.ravel())
        self._goal_remainder, self._goal_rotation = timed_pose_bounds(task.path, self._pieces)
        self._unknown = np.zeros(len(self._pieces.start))
        if sag is not None:
            bent = sag.at(q).tool
            self._p_WT = self._p_WT + bent
            self._unknown = self._pieces.estimated_remainder(bent)

    def _share(self, pieces: Pieces) -> FloatArray:
        """Remainders (K,) as shares of what they may be."""
        of: NormBounds = norm_bounds(self._robot, pieces.ellipses)
        torque, turns = self._robot.limits.torque, ~self._robot.limits.prismatic
        scale = float((torque[turns] if turns.any() else torque).max())
        bounded = self._task.max_speed is not None or self._task.speed_tolerance is not None
        speed = _TOOL_RESOLUTION if bounded else np.inf
        # Infinite where a torque bound is next to nothing: then no number of pieces suffices.
        with np.errstate(over="ignore", invalid="ignore"):
            shares = [
                pieces.remainder(of.guardrail_torque) / (_TORQUE_RESOLUTION * scale),
                pieces.remainder(of.tool_point) / _TOOL_RESOLUTION,
                pieces.remainder(of.tool_rotation) / _TOOL_RESOLUTION,
                pieces.remainder(of.tool_velocity) / speed,
                *(
                    pieces.remainder(of.joint_torque[..., j]) / (_TORQUE_RESOLUTION * torque[j])
                    for j in range(self._robot.dof)
                ),
            ]
        return np.asarray(np.max(shares, axis=0))

    def _highest(
        self,
        values: FloatArray,
        convex: Callable[[FloatArray, IntArray], FloatArray],
        remainder: FloatArray,
        resolution: float,
    ) -> Peak:
        return highest(self._pieces, self._pieces.control_points(values), convex, remainder, resolution)

    def joint_torque(self) -> Check:
        """The torque of the joint that uses most of its bound (Chang 2021, Eq. (32))."""
        robot, bound = self._robot, self._robot.limits.torque
        each = [
            self._pieces.remainder(self._bounds.joint_torque[..., j]) / bound[j] for j in range(robot.dof)
        ]
        peak = self._highest(
            self._efforts.joint_torque / bound,
            lambda share, piece: np.abs(share).max(axis=1),
            np.max(each, axis=0),
            _TORQUE_RESOLUTION,
        )
        there = self._dynamics.efforts(*self._trajectory.states([peak.time]))
        joint = int((np.abs(there.joint_torque[0]) / bound).argmax())
        return Check(
            quantity=f"torque of {robot.joints[joint]}",
            time=peak.time,
            value=peak.bound * float(bound[joint]),
            bound=float(bound[joint]),
            unit=robot.limits.units(joint).torque,
        )

    def guardrail_torque(self) -> tuple[Peak, float, float, float]:
        """Peak, time mean and root mean square of the norm of the torque, and its peak at rest, Nm."""
        pieces, torque = self._pieces, self._efforts.guardrail_torque
        size = np.linalg.norm(torque, axis=1)
        resolution = _TORQUE_RESOLUTION * float(size.max())
        remainder = pieces.remainder(self._bounds.guardrail_torque)
        peak = self._highest(torque, _norm, remainder, resolution)
        mean, square = pieces.means(np.stack([size, size**2], axis=1))
        static = self._dynamics.static_efforts(pieces.states[0]).guardrail_torque
        return (
            peak,
            float(mean),
            float(np.sqrt(square)),
            self._highest(static, _norm, remainder, resolution).value,
        )

    def hold(self) -> EnclosedHold | None:
        """What the feet bear; None of a robot without any."""
        if (holding := self._robot.holding) is None:
            return None
        wrench = self._efforts.guardrail_wrench
        return EnclosedHold(holding, self._pieces, self._bounds, wrench, _TORQUE_RESOLUTION)

    def tool_deviation(self) -> Peak:
        """Distance of the tool point from the leg of its time, m; see `ToolPath.leg_offset`."""
        path, pieces = self._task.path, self._pieces
        middle, curved = pieces.middle, path.is_curved(pieces.middle)
        along, bend = path.leg_directions(middle), path.bend(pieces.start, pieces.end)
        # From the leg itself, which is convex, or from the timed place, across the tangent in the middle.
        origin = np.where(np.repeat(curved, len(self._p_WT) // len(curved))[:, None], self._goals.point, 0.0)

        def distance(p: FloatArray, piece: IntArray) -> FloatArray:
            points = np.swapaxes(p, 1, 2)
            times = np.repeat(middle[piece], points.shape[1])
            offset = path.leg_offset(times, points.reshape(-1, 3))
            straight = np.linalg.norm(offset, axis=1).reshape(points.shape[:2])
            forward = np.einsum("knd,kd->kn", points, along[piece])
            across = points - forward[:, :, None] * along[piece][:, None]
            # The tangent is turned by so much at most: |x - (x t) t| <= |x - (x m) m| + |x m| |m - t|.
            slanted = np.linalg.norm(across, axis=2) + bend[piece][:, None] * np.abs(forward)
            return np.asarray(np.where(curved[piece][:, None], slanted, straight))

        return self._highest(self._p_WT - origin, distance, self._point_remainder, _TOOL_RESOLUTION)

    def tool_lag(self) -> Peak:
        """Distance along its leg of the tool point from its timed place, m."""
        pieces, path = self._pieces, self._task.path
        along, bend = path.leg_directions(pieces.middle), path.bend(pieces.start, pieces.end)

        def lag(away: FloatArray, piece: IntArray) -> FloatArray:
            forward = np.einsum("kdn,kd->kn", away, along[piece])
            return np.asarray(np.abs(forward) + bend[piece][:, None] * np.linalg.norm(away, axis=1))

        away = self._p_WT - self._goals.point
        return self._highest(away, lag, self._point_remainder, _TOOL_RESOLUTION)

    def tool_speed(self) -> Peak:
        """Speed of the tool point, m/s."""
        velocity, remainder = self._tool_velocity()
        return self._highest(velocity, _norm, remainder, _TOOL_RESOLUTION)

    def process_speed(self) -> Peak:
        """By what share the tool's speed misses that of the process: `speed_deviation`."""
        return speed_deviation(self._task.path, self._pieces, *self._tool_velocity())

    def _tool_velocity(self) -> tuple[FloatArray, FloatArray]:
        """Velocity of the tool point at the points of interpolation, m/s, and what that misses (K,)."""
        q, v, _ = self._pieces.states
        J = Kinematics(self._robot).tool_point_jacobians(q)[1]
        remainder = self._pieces.remainder(self._bounds.tool_velocity)
        if self._sag is not None:
            bending = self._sag.at(q).d_tool
            J = J + bending
            remainder = remainder + self._pieces.estimated_remainder(np.einsum("kij,kj->ki", bending, v))
        return np.einsum("kij,kj->ki", J, v), remainder

    def tool_rotation(self) -> Peak:
        """Angle by which the tool misses what is prescribed of its orientation, rad: `ToolTask.rotation`."""
        goal, task = self._goals, self._task
        if task.keep == "position" and task.cone is None:
            return Peak(time=float(self._trajectory.t[0]), value=0.0, bound=0.0)
        # Both chords are 2 k sin(angle/2): of the axis as a vector, of the orientation as a matrix.
        columns, k = (slice(None), np.sqrt(2.0)) if task.keep == "pose" else (slice(2, 3), 1.0)
        away = (self._R_WT - goal.rotation)[:, :, columns].reshape(len(self._R_WT), -1)
        size = self._bounds.tool_rotation + self._goal_rotation
        remainder = self._pieces.remainder(size) * np.sqrt(away.shape[1] / 3)
        chord = self._highest(away, _norm, remainder, _TOOL_RESOLUTION)
        value, bound = (2 * np.arcsin(np.minimum(x / (2 * k), 1.0)) for x in (chord.value, chord.bound))
        return Peak(time=chord.time, value=float(value), bound=float(bound))

    def at_via_points(self, count: int) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Times and distances of the tool from its place, m, and rotations, rad, at the via-points."""
        task, trajectory = self._task, self._trajectory
        times = task.path.via_times(count)
        # What is not in the trajectory's time is where it rests; another check says so.
        q = trajectory.evaluate(np.clip(times, trajectory.t[0], trajectory.t[-1]))
        p_WT, R_WT = Kinematics(self._robot).tool_poses(q)
        if self._sag is not None:
            p_WT = p_WT + self._sag.at(q).tool
        goals = task.path.poses(times)
        away = np.linalg.norm(p_WT - goals.point, axis=1)
        return (times, np.asarray(away)), (times, task.rotation(R_WT, goals))

    @property
    def _point_remainder(self) -> FloatArray:
        remainder = self._pieces.remainder(self._bounds.tool_point)
        return np.asarray(remainder + self._goal_remainder + self._unknown)


def _norm(vectors: FloatArray, piece: IntArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=1))


def _range_check(robot: Robot, trajectory: QuinticTrajectory) -> Check:
    """Position of the joint that comes nearest to an end of its range, at its exact extrema."""
    position = trajectory.extrema(0)
    middle, half = robot.limits.range_middle, robot.limits.range_half
    # Extrema are (segments, n, k).
    value, time = (np.moveaxis(x, 1, 2).reshape(-1, robot.dof) for x in (position.value, position.time))
    quantity = "distance of {} from the middle of its range"
    return _joint_check(robot, quantity, "position", time, np.abs(value - middle), half)


def _rate_checks(robot: Robot, trajectory: QuinticTrajectory) -> list[Check]:
    """Velocity, acceleration and jerk of the joint that uses most of its bound, at the exact extrema."""
    checks = []
    for order, name in enumerate(_DERIVATIVES, start=1):
        largest, time = trajectory.extrema(order).largest()
        bound = getattr(robot.limits, name)
        checks.append(_joint_check(robot, f"{name} of {{}}", name, time[None], largest[None], bound))
    return checks


def _joint_check(
    robot: Robot, quantity: str, kind: str, times: FloatArray, value: FloatArray, bound: FloatArray
) -> Check:
    """The joint, of absolute values (N, n) at `times` (N, n), that uses most of its bound (n,).

    `kind` is what of `JointUnits` has its unit.
    """
    k, joint = np.unravel_index((value / bound).argmax(), value.shape)
    return Check(
        quantity=quantity.format(robot.joints[joint]),
        time=float(times[k, joint]),
        value=float(value[k, joint]),
        bound=float(bound[joint]),
        unit=getattr(robot.limits.units(int(joint)), kind),
    )


def _continuity_check(robot: Robot, trajectory: QuinticTrajectory) -> Check:
    """Largest jump at an inner knot, or rate left at an end (Eqs. (34)-(37)), as a share of what it may be.

    That is a billionth of the joint's bound, or what the last digits of the positions do in the shorter one
    of the segments at the knot, order by order.
    """
    limits, t = robot.limits, trajectory.t
    h = np.diff(t)
    digit = _DIGITS * np.spacing(np.abs(trajectory.q).max(axis=0))
    shorter = np.concatenate([h[:1], np.minimum(h[:-1], h[1:]), h[-1:]])[:, None]
    worst, where = 0.0, float(t[0])
    position = np.where(limits.prismatic, _METRE, _HALF_TURN)
    bounds = (position, limits.velocity, limits.acceleration, limits.jerk)
    for order, bound in enumerate(bounds):
        jump = np.zeros_like(trajectory.q)
        jump[1:-1] = trajectory.jumps(order)
        if order > 0:
            jump[[0, -1]] = trajectory.evaluate(t[[0, -1]], order)
        rounding = _AMPLIFIED[order] * digit / bound / shorter**order
        if order < len(bounds) - 1:
            rounding = np.minimum(rounding, _LARGEST_ALLOWANCE)
        share = (np.abs(jump / bound) / np.maximum(rounding, _JUMP)).max(axis=1)
        if not share.max() <= worst:
            worst, where = float(share.max()), float(t[share.argmax()])
    return Check(
        quantity="jump of a joint's position, velocity, acceleration or jerk",
        time=where,
        value=worst,
        bound=1.0,
        unit="of its allowance",
    )


def _duration_check(task: ToolTask, trajectory: QuinticTrajectory) -> Check:
    first, last, duration = float(trajectory.t[0]), float(trajectory.t[-1]), task.path.duration
    return Check(
        quantity="difference of the trajectory's times from the tool path's",
        time=last,
        value=max(abs(first), abs(last - duration)),
        bound=_SAME_DURATION * duration,
        unit="s",
    )


def _enclosed(quantity: str, peak: Peak, bound: float, unit: str) -> Check:
    return Check(quantity=quantity, time=peak.time, value=peak.bound, bound=float(bound), unit=unit)
