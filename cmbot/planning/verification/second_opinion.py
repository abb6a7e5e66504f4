"""A second opinion on a trajectory, from the scene and the robot's files by another route.

Optimiser and certificate share the dynamics, the kinematics, the distances, the timed tool path and the joint
limits of the package: a mistake there would fool both. Here these are computed again at some hundred states:
kinematics, dynamics and the base's wrench by MuJoCo, where it is installed, distances by coal pair by pair,
limits, timed path and hold from the files. What both say is compared, and what a plan promises is judged a
second time.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest

import numpy as np
from scipy.interpolate import BPoly

from cmbot.collision import Clearances, Obstacle, PointDistances
from cmbot.common.arrays import FloatArray
from cmbot.elastic.sag import Sag
from cmbot.planning.certification.check import Check, largest_check
from cmbot.planning.verification.bent_tool import bent_tool_points, seen_from_part
from cmbot.planning.verification.described_arm import DescribedArm, pose_of
from cmbot.planning.verification.engine import engine_states, is_installed
from cmbot.planning.verification.hold import hold_checks
from cmbot.planning.verification.timed_path import DescribedPath
from cmbot.robot import Dynamics, Efforts, Kinematics, Robot
from cmbot.scene import SPEED_TOLERANCE, AxisCone, PlannerOptions, Scene, Stroke
from cmbot.trajectory import QuinticTrajectory

# States at which everything is computed again, and how many of them at most are knots.
_STATES, _MAX_KNOT_STATES = 300, 100
# What two computations of the same may differ by: torques and forces as a share of the largest, tool points
# and angles in m and rad, limits and times as a share, distances in m, points that a file names in m.
_EFFORTS, _POSES, _SHARES, _DISTANCES, _NAMED = 1e-6, 1e-9, 1e-9, 1e-5, 1e-4
_MIN_EFFORT = 1e-9
# Of the sag a share and a length, m: a tube that bends in one place sags a tenth less by its own weight.
_SAG, _LEAST_SAG = 0.01, 2e-5
# By what share a limit, by how much (m) a margin, by how much (m, rad) a via-point may be missed.
_LIMIT, _MARGIN_TOLERANCE_M, _VIA_POINT = 1e-9, 1e-6, 1e-6
# A position that is off by x is off by up to 60 x / h^3 in the jerk of a segment of duration h; so many last
# digits of a position are left to rounding.
_JERK_PER_POSITION, _ROUNDING_DIGITS = 60, 8
# How the checks are called.
_FROM, _BY = "from a second computation", "by a second computation"


def second_opinion(
    scene: Scene,
    options: PlannerOptions,
    trajectory: QuinticTrajectory,
    *,
    robot: Robot,
    stroke: int | None,
    sag: Sag | None = None,
) -> tuple[Check, ...]:
    """Compute again, by another route, what a certificate stands on.

    The checks on differences hold where the package agrees with the second computation; the others are the
    plan's promises, judged by the second computation at 300 states spread over the trajectory and its knots.
    What lies between those states is not looked at; the stiffness of what bends is taken as it is.

    Parameters
    ----------
    scene : Scene
    options : PlannerOptions
        The safety margin that was promised and, where sag is compensated, the deviation.
    trajectory : QuinticTrajectory
    robot : Robot
        What the package made of the scene's robot.
    stroke : int or None
        Number of the stroke, from 0. None with the tool off: it may be anywhere, and no process force acts on
        it.
    sag : Sag, optional
        Where it is compensated. Then it is the bent tool that has to be on the path.

    Raises
    ------
    ModelError
        When the robot's files cannot be read as they were for `robot`.
    """
    robot = robot.tool_off if stroke is None else robot
    margin, arm = options.safety_margin_m, DescribedArm.of(scene, robot)
    checks = judged_motion(arm, robot, scene.all_obstacles, trajectory, margin)
    if stroke is None or not all(check.holds for check in checks[:1]):
        return checks
    return (*checks, *_stroke_checks(scene, stroke, robot, trajectory, sag, options.max_tool_deviation_m))


def judged_motion(
    arm: DescribedArm,
    robot: Robot,
    obstacles: tuple[Obstacle, ...],
    trajectory: QuinticTrajectory,
    margin: float,
) -> tuple[Check, ...]:
    """Compute again what holds of every motion, with the tool on or off.

    Parameters
    ----------
    arm : DescribedArm
        What the files say of the robot.
    robot : Robot
        What the package made of it.
    obstacles : tuple of Obstacle
    trajectory : QuinticTrajectory
    margin : float, m
        Least distance that was promised.

    Raises
    ------
    ModelError
        When the robot's files cannot be read as they were for `robot`.
    """
    wrong = sum(mine != other for mine, other in zip_longest(arm.joints, robot.joints))
    quantity, begin = "joints that are not those of the robot's files", float(trajectory.t[0])
    known = Check(quantity=quantity, time=begin, value=float(wrong), bound=0.0, unit="joints")
    if wrong:
        # Without them nothing compares.
        return (known,)
    times, motion = _states(trajectory)
    efforts = Dynamics(robot).efforts(*motion[:3])
    checks = [
        known,
        _limits_check(arm, robot, begin),
        *_bound_checks(arm, trajectory, times, motion),
        _joint_check(arm, f"torque of {{}} {_BY}", times, np.abs(efforts.joint_torque), "torque", _TORQUE),
        *hold_checks(robot, times, efforts.guardrail_wrench),
        *_clearance_checks(robot, obstacles, margin, times, motion[0]),
    ]
    if is_installed():
        checks += _engine_checks(arm, robot, times, motion, efforts)
    return tuple(checks)


def _states(trajectory: QuinticTrajectory) -> tuple[FloatArray, list[FloatArray]]:
    """Times (N,), s, evenly spread ones and knots; position to jerk there, four (N, n).

    By SciPy's polynomials from the knots' first three; a trajectory is held at its ends.
    """
    knots = trajectory.t
    some = knots[np.linspace(0, len(knots) - 1, min(len(knots), _MAX_KNOT_STATES)).round().astype(np.intp)]
    times = np.union1d(some, np.linspace(knots[0], knots[-1], _STATES - len(some)))
    return times, [_rates(trajectory, times, order) for order in range(4)]


def _rates(trajectory: QuinticTrajectory, times: FloatArray, order: int) -> FloatArray:
    """The derivative of so high an order (N, n) at `times` (N,)."""
    rows = np.stack([trajectory.q, trajectory.v, trajectory.a], axis=1)
    return np.asarray(BPoly.from_derivatives(trajectory.t, rows)(times, order))


_TORQUE = ("Nm", "N")
_BOUNDED_RATES = (
    ("velocity", ("rad/s", "m/s")),
    ("acceleration", ("rad/s2", "m/s2")),
    ("jerk", ("rad/s3", "m/s3")),
)


def _limits_check(arm: DescribedArm, robot: Robot, time: float) -> Check:
    """The limit that the package has read most differently, as a share of it."""
    worst = 0.0
    for name, own in vars(arm.limits).items():
        other = getattr(robot.limits, name)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(own == other, 0.0, np.abs(other - own) / np.abs(own))
        worst = float(np.maximum(worst, share.max()))
    quantity = "difference of a joint limit from the robot's files"
    return Check(quantity=quantity, time=time, value=worst, bound=_SHARES, unit="of the limit")


def _bound_checks(
    arm: DescribedArm, trajectory: QuinticTrajectory, times: FloatArray, motion: list[FloatArray]
) -> Iterator[Check]:
    """Position, velocity, acceleration and jerk, less their rounding, against the limits in the files."""
    lower, upper = arm.limits.lower, arm.limits.upper
    beyond = np.maximum(lower - motion[0], motion[0] - upper).max(axis=1)
    yield largest_check(f"way of a joint out of its range {_BY}", times, beyond, _LIMIT, "rad or m")
    segment = np.clip(np.searchsorted(trajectory.t, times, side="right") - 1, 0, len(trajectory.t) - 2)
    h = np.diff(trajectory.t)
    # At a knot the shorter one of its segments.
    shorter = np.minimum(h, np.minimum(np.append(h[1:], np.inf), np.append(np.inf, h[:-1])))[segment, None]
    digits = _JERK_PER_POSITION * _ROUNDING_DIGITS * np.spacing(np.abs(motion[0]).max())
    for order, (name, units) in enumerate(_BOUNDED_RATES, start=1):
        at_knot = np.isin(times, trajectory.t)[:, None]
        rounding = digits / np.where(at_knot, shorter, h[segment, None]) ** order
        rate = np.maximum(np.abs(motion[order]) - rounding, 0.0)
        yield _joint_check(arm, f"{name} of {{}} {_BY}", times, rate, name, units)


def _joint_check(
    arm: DescribedArm, quantity: str, times: FloatArray, value: FloatArray, limit: str, units: tuple[str, str]
) -> Check:
    """The joint, of absolute values (N, n), that uses most of its limit; units if it turns or slides."""
    bound = getattr(arm.limits, limit)
    k, joint = np.unravel_index((value / bound).argmax(), value.shape)
    return Check(
        quantity=quantity.format(arm.joints[joint]),
        time=float(times[k]),
        value=float(value[k, joint]),
        bound=float(bound[joint] * (1 + _LIMIT)),
        unit=units[bool(arm.slides[joint])],
    )


def _clearance_checks(
    robot: Robot, obstacles: tuple[Obstacle, ...], margin: float, times: FloatArray, q: FloatArray
) -> Iterator[Check]:
    """What the package's clearances differ by, and those of coal against the margin."""
    theirs = Clearances(robot, obstacles).query(q).distance
    own, names = PointDistances(robot, obstacles).smallest(q)
    # Of shapes that overlap only that counts; without pairs both are infinite.
    agreed = ((own < 0) & (theirs < 0)) | (own == theirs)
    with np.errstate(invalid="ignore"):
        away = np.where(agreed, 0.0, np.abs(theirs - own))
    yield largest_check(f"difference of the clearance {_FROM}", times, away, _DISTANCES, "m")
    k = int(own.argmin())
    who = " of {} from {}".format(*names[k]) if any(names[k]) else ""
    yield Check(
        quantity=f"clearance{who} {_BY}",
        time=float(times[k]),
        value=float(own[k]),
        bound=margin - _MARGIN_TOLERANCE_M,
        unit="m",
        at_least=True,
    )


def _engine_checks(
    arm: DescribedArm, robot: Robot, times: FloatArray, motion: list[FloatArray], efforts: Efforts
) -> Iterator[Check]:
    """What kinematics, dynamics and the whole robot's wrench differ by from those of the second engine."""
    q, v, a, _ = motion
    found, (p, R) = engine_states(arm, (q, v, a), robot.tool_force), Kinematics(robot).tool_poses(q)
    bound = _POSES * max(1.0, float(np.abs(found.tool_point).max()))
    point, rotation = seen_from_part(robot, found.tool_point, found.tool_rotation)
    away = np.linalg.norm(p - point, axis=1)
    yield largest_check(f"difference of the tool point {_FROM}", times, away, bound, "m")
    turned = _angles(R, rotation)
    yield largest_check(f"difference of the tool's orientation {_FROM}", times, turned, _POSES, "rad")
    weight = robot.carrier_mass * np.array(robot.model.gravity.linear)
    for name, own, other, unit in (
        ("joint torque", found.joint_torque, efforts.joint_torque, _TORQUE[bool(arm.slides.all())]),
        ("guardrail force", found.base_force, efforts.guardrail_force + weight, "N"),
        ("guardrail torque", found.base_torque, efforts.guardrail_torque + robot.carrier_torque, "Nm"),
    ):
        if own is not None:
            bound = max(_EFFORTS * float(np.abs(own).max()), _MIN_EFFORT)
            quantity, away = f"difference of the {name} {_FROM}", np.abs(own - other).max(axis=1)
            yield largest_check(quantity, times, away, bound, unit)


def _stroke_checks(
    scene: Scene, number: int, robot: Robot, trajectory: QuinticTrajectory, sag: Sag | None, deviation: float
) -> Iterator[Check]:
    """What the timed path differs by, and whether the tool, bent where that is compensated, is on it."""
    X_WT = np.eye(4)
    start = Kinematics(robot).tool_poses(np.array(scene.posture)[None])
    X_WT[:3, 3], X_WT[:3, :3] = (pose[0] for pose in start)
    size = np.abs(X_WT).max()
    if not np.isfinite(size):
        # No path begins there.
        yield Check(quantity="place of the tool at the start", time=0.0, value=size, bound=0.0, unit="m")
        return
    if (fixed := scene.tool.fixed) is not None:
        off = np.abs(robot.fixed_tool.homogeneous - pose_of(fixed.xyz, np.radians(fixed.rpy_deg))).max()
        quantity = "difference of the fixed tool's pose from the scene's"
        yield Check(quantity=quantity, time=0.0, value=float(off), bound=_POSES, unit="m")
    strokes = scene.timed_strokes(X_WT)
    stroke, keep = strokes[number], strokes[number].file.keep
    times, motion = _states(trajectory)
    described = DescribedPath(scene, stroke, X_WT if number == 0 else strokes[number - 1].path.end_pose)
    yield from _path_checks(stroke, described, times)
    most = stroke.file.max_base_torque_nm
    if most is not None:
        torque = np.linalg.norm(Dynamics(robot).efforts(*motion[:3]).guardrail_torque, axis=1)
        yield largest_check(f"torque on the base {_BY}", times, torque, most * (1 + _LIMIT), "Nm")
    kinematics = Kinematics(robot)
    if isinstance(keep, AxisCone):
        # A trajectory is to end with its path: where it is longer, the path's end counts.
        z, timed = kinematics.tool_poses(motion[0])[1][:, :, 2], described.poses(times)[1]
        bound = np.radians(keep.axis_within_deg) * (1 + _LIMIT)
        yield largest_check(f"tool tilt {_BY}", times, _between(z, timed[:, :, 2]), bound, "rad")
    ends = trajectory.t[[0, -1]]
    via = np.concatenate([described.via_times, ends])
    q = _rates(trajectory, np.clip(via, *ends), 0)
    (p, R), (p_timed, R_timed) = kinematics.tool_poses(q), described.poses(via)
    bound = _VIA_POINT
    if sag is not None:
        bent, theirs = bent_tool_points(robot, sag.arm.base, q), sag.following(q)
        missed = _SAG * float(np.linalg.norm(bent - p, axis=1).max()) + _LEAST_SAG
        away = np.linalg.norm(bent - p - theirs, axis=1)
        yield largest_check(f"difference of the tool's sag {_FROM}", via, away, missed, "m")
        # What the certificate allows an expected place, which compensation comes near to in steps.
        p, bound = bent, deviation + missed
    away = np.linalg.norm(p - p_timed, axis=1)
    yield largest_check("distance of the tool from its timed via-point", via, away, bound, "m")
    if keep in ("pose", "axis"):
        turned = _angles(R, R_timed) if keep == "pose" else _between(R[:, :, 2], R_timed[:, :, 2])
        yield largest_check("turn of the tool at its via-point", via, turned, _VIA_POINT, "rad")
    if sag is None:
        yield from _speed_checks(scene, stroke, kinematics, times, motion)


def _path_checks(stroke: Stroke, described: DescribedPath, times: FloatArray) -> Iterator[Check]:
    """What the package's timed path differs by from what the file says."""
    path = stroke.path
    if described.is_plain:
        (p, R), poses = described.poses(times), path.poses(times)
        away, size = np.linalg.norm(poses.point - p, axis=1), max(1.0, float(np.abs(path.corners).max()))
        yield largest_check(f"difference of the timed tool path {_FROM}", times, away, _POSES * size, "m")
        turned = _angles(np.broadcast_to(poses.rotation, R.shape), R)
        yield largest_check(
            f"turn between the timed tool path and that {_FROM}", times, turned, _POSES, "rad"
        )
    elif len(away := described.misses(times)):
        quantity = f"distance of the timed tool path from what the file names {_BY}"
        yield largest_check(quantity, np.zeros(len(away)), away, _NAMED, "m")
    late = np.abs(stroke.via_times - described.via_times)
    quantity, bound = f"difference of the via-points' times {_FROM}", _SHARES * float(stroke.via_times[-1])
    yield largest_check(quantity, described.via_times, late, bound, "s")


def _speed_checks(
    scene: Scene, stroke: Stroke, kinematics: Kinematics, times: FloatArray, motion: list[FloatArray]
) -> Iterator[Check]:
    """The speed of the tool point against the scene's, with the tolerance that it has."""
    J = kinematics.tool_point_jacobians(motion[0])[1]
    speed = np.linalg.norm(np.einsum("kij,kj->ki", J, motion[1]), axis=1)
    if scene.tool.max_speed_m_s is not None:
        bound = scene.tool.max_speed_m_s * (1 + SPEED_TOLERANCE) * (1 + _LIMIT)
        yield largest_check(f"tool speed {_BY}", times, speed, bound, "m/s")
    tolerance, asked = stroke.file.speed_tolerance, stroke.path.process_speed(times)
    if tolerance is not None:
        on, given = asked > 0, stroke.file.speed_m_s
        missed = np.abs(speed / np.where(on, given or asked, 1.0) - 1.0) * on
        quantity = f"deviation of the process speed {_BY}"
        yield largest_check(quantity, times, missed, tolerance * (1 + _LIMIT), "of it")


def _angles(R: FloatArray, other: FloatArray) -> FloatArray:
    """Angles (N,), rad, between orientations (N, 3, 3) and others, by the chord: exact for small ones."""
    chord = np.linalg.norm(R - other, axis=(1, 2)) / np.sqrt(8)
    return np.asarray(2 * np.arcsin(np.minimum(chord, 1.0)))


def _between(z: FloatArray, other: FloatArray) -> FloatArray:
    """Angles (N,), rad, between unit vectors (N, 3) and another."""
    return np.asarray(2 * np.arcsin(np.minimum(np.linalg.norm(z - other, axis=1) / 2, 1.0)))
