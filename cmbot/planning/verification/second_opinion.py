"""A second opinion on a trajectory, from the scene and the robot's files by another route.

Optimiser and certificate share the dynamics, the kinematics, the distances, the timed tool path and the joint
limits of the package: a mistake there would fool both. Here these are computed again at some hundred states,
without them: the equations of motion body by body, distances as minimum-norm points, the path from its
formulas, limits from the files. What both say is compared, and what a plan promises is judged a second time.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.elastic.sag import Sag
from cmbot.planning.certification.check import Check
from cmbot.planning.verification.convex_distance import ConvexShape, Proven, hull, smallest_distances
from cmbot.planning.verification.foothold import hold_checks
from cmbot.planning.verification.multibody import Multibody, PlacedShape
from cmbot.planning.verification.robot_files import mesh_parts, read_multibody
from cmbot.planning.verification.scene_path import ScenePath
from cmbot.robot import Dynamics, Kinematics, Robot
from cmbot.scene import (
    SPEED_TOLERANCE,
    AxisCone,
    Box,
    Capsule,
    Cylinder,
    Keep,
    Mesh,
    PlannerOptions,
    Scene,
    Shape,
    Sphere,
    Stroke,
)
from cmbot.trajectory import QuinticTrajectory

__all__ = ["second_opinion"]

# States at which torques and distances are computed again, and how many of them at most are knots.
_STATES, _KNOTS = 300, 100
# What two computations of the same may differ by: torques and forces as a share of the largest, tool points
# and angles in m and rad, limits and times as a share, distances in m.
_EFFORTS, _POSES, _SHARES, _DISTANCES = 1e-6, 1e-9, 1e-9, 1e-5
_LEAST_EFFORT = 1e-9
# By what share a limit, by how much (m) a margin, by how much (m, rad) a via-point may be missed.
_LIMIT, _MARGIN, _VIA_POINT = 1e-9, 1e-6, 1e-6
# A position that is off by x is off by up to 60 x / h^3 in the jerk of a segment of duration h; so many last
# digits of a position are left to rounding.
_QUINTIC, _DIGITS = 60, 4
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
    What lies between those states is not looked at, and neither is the elastic model.

    Parameters
    ----------
    scene : Scene
    options : PlannerOptions
        The safety margin that was promised.
    trajectory : QuinticTrajectory
    robot : Robot
        What the package made of the scene's robot.
    stroke : int or None
        Number of the stroke, from 0. None with the tool off: it may be anywhere, and no process force acts on
        it.
    sag : Sag, optional
        Where it is compensated. Then the commanded tool is not on the path, and its place is not judged.

    Raises
    ------
    ModelError
        When the robot's files cannot be read as they were for `robot`.
    """
    body = read_multibody(scene.robot)
    robot = robot.tool_off if stroke is None else robot
    tool_force = (0.0, 0.0, 0.0) if stroke is None else scene.tool.process_force_n
    known = _joints_check(body, robot, trajectory)
    if not known.holds:
        return (known,)
    times = _state_times(trajectory.t)
    motion = _motion(trajectory, times)
    tau, force, torque = body.efforts(motion[0], motion[1], motion[2], tool_force)
    stance = scene.robot.stance
    if stance is not None:
        torque = torque - np.cross(stance.foot, force)
    efforts = tau, force, torque
    checks = [
        known,
        *_effort_checks(
            body,
            robot,
            times,
            motion,
            efforts,
            None if stroke is None else scene.each_stroke[stroke].max_base_torque_nm,
        ),
        *hold_checks(scene, body, robot, times, efforts),
        *_pose_checks(body, robot, times, motion[0]),
        _limits_check(body, robot, times),
        *_bound_checks(body, trajectory, times, motion),
        *_clearance_checks(scene, options, body, robot, times, motion[0]),
    ]
    if stroke is not None:
        X_WT = np.eye(4)
        X_WT[:3, 3], X_WT[:3, :3] = (pose[0] for pose in body.tool_poses(scene.posture[None]))
        path = ScenePath(scene, X_WT[:3, 3], X_WT[:3, :3], stroke)
        checks += _path_checks(scene.timed_strokes(X_WT)[stroke], path, times)
        keep = scene.each_stroke[stroke].keep
        if isinstance(keep, AxisCone):
            checks.append(_tilt_check(keep, path, body, times, motion[0]))
        if sag is None:
            checks += _via_point_checks(keep, path, body, trajectory)
            checks += _speed_checks(scene, stroke, path, body, times, motion)
    return tuple(checks)


def _state_times(knots: FloatArray) -> FloatArray:
    """Times (N,), s: evenly spread ones, and knots."""
    some = knots[np.linspace(0, len(knots) - 1, min(len(knots), _KNOTS)).round().astype(np.intp)]
    return np.union1d(some, np.linspace(knots[0], knots[-1], _STATES - len(some)))


def _motion(trajectory: QuinticTrajectory, times: FloatArray) -> list[FloatArray]:
    """Position, velocity, acceleration and jerk, four (N, n), from the knots' first three.

    The quintic between two knots, in the share of the time between them, by its six conditions.
    """
    powers = np.arange(6)
    each = [np.polynomial.polynomial.polyder(np.eye(6), order) for order in range(4)]
    ends = np.array([each[order].T @ end ** powers[: 6 - order] for end in (0.0, 1.0) for order in range(3)])
    segment = _segments(trajectory, times)
    h = np.diff(trajectory.t)[segment, None]
    # Positions are counted from the segment's beginning, which keeps their digits.
    start = trajectory.q[segment]
    given = [
        (x[segment + end] - (start if order == 0 else 0.0)) * h**order
        for end in (0, 1)
        for order, x in enumerate((trajectory.q, trajectory.v, trajectory.a))
    ]
    coefficients = np.einsum("cg,gkj->ckj", np.linalg.inv(ends), np.stack(given))
    u = (times - trajectory.t[segment]) / h[:, 0]
    rates = [
        np.einsum("pc,pk,ckj->kj", each[order], u ** powers[: 6 - order, None], coefficients) / h**order
        for order in range(4)
    ]
    return [start + rates[0], *rates[1:]]


def _segments(trajectory: QuinticTrajectory, times: FloatArray) -> IntArray:
    """Number (N,) of the segment that each of `times` (N,) is in."""
    return np.clip(np.searchsorted(trajectory.t, times, side="right") - 1, 0, len(trajectory.t) - 2)


def _joints_check(body: Multibody, robot: Robot, trajectory: QuinticTrajectory) -> Check:
    """Joints of the files that the package does not have in their place; without them nothing compares."""
    wrong = sum(mine != other for mine, other in zip_longest(body.joints, robot.joints))
    quantity = "joints that are not those of the robot's files"
    return Check(quantity=quantity, time=float(trajectory.t[0]), value=float(wrong), bound=0.0, unit="joints")


def _effort_checks(
    body: Multibody,
    robot: Robot,
    times: FloatArray,
    motion: list[FloatArray],
    efforts: tuple[FloatArray, FloatArray, FloatArray],
    most_on_base: float | None,
) -> Iterator[Check]:
    """What the package's dynamics differ by, and the torques against their bounds."""
    q, v, a, _ = motion
    theirs = Dynamics(robot).efforts(q, v, a)
    tau, force, torque = efforts
    for name, own, other, unit in (
        ("joint torque", tau, theirs.joint_torque, "N" if body.slides.all() else "Nm"),
        ("guardrail force", force, theirs.guardrail_force, "N"),
        ("guardrail torque", torque, theirs.guardrail_torque, "Nm"),
    ):
        quantity = f"difference of the {name} {_FROM}"
        bound = max(_EFFORTS * float(np.abs(own).max()), _LEAST_EFFORT)
        yield _worst(quantity, times, np.abs(own - other).max(axis=1), bound, unit)
    if most_on_base is not None:
        size, bound = np.linalg.norm(torque, axis=1), most_on_base * (1 + _LIMIT)
        yield _worst(f"torque on the base {_BY}", times, size, bound, "Nm")
    quantity = f"torque of {{}} {_BY}"
    yield _joint_check(body, quantity, times, np.abs(tau), body.bounds.torque, ("Nm", "N"))


def _pose_checks(body: Multibody, robot: Robot, times: FloatArray, q: FloatArray) -> Iterator[Check]:
    """What the package's kinematics differ by."""
    (p, R), (p_own, R_own) = Kinematics(robot).tool_poses(q), body.tool_poses(q)
    bound = _POSES * max(1.0, float(np.abs(p_own).max()))
    away = np.linalg.norm(p - p_own, axis=1)
    yield _worst(f"difference of the tool point {_FROM}", times, away, bound, "m")
    yield _worst(f"difference of the tool's orientation {_FROM}", times, _angles(R, R_own), _POSES, "rad")


def _limits_check(body: Multibody, robot: Robot, times: FloatArray) -> Check:
    """The limit that the package has read most differently, as a share of it."""
    worst = 0.0
    for name, own in vars(body.bounds).items():
        other = getattr(robot.limits, name)
        same = own == other
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(same, 0.0, np.abs(other - own) / np.abs(own))
        worst = float(np.maximum(worst, share.max()))
    quantity = "difference of a joint limit from the robot's files"
    return Check(quantity=quantity, time=float(times[0]), value=worst, bound=_SHARES, unit="of the limit")


def _bound_checks(
    body: Multibody, trajectory: QuinticTrajectory, times: FloatArray, motion: list[FloatArray]
) -> Iterator[Check]:
    """Position, velocity, acceleration and jerk, less their rounding, against the limits in the files."""
    bounds = body.bounds
    endless = np.isinf(bounds.upper)
    half = np.where(endless, np.inf, 0.5 * (bounds.upper - bounds.lower))
    middle = np.where(endless, 0.0, bounds.lower) + np.where(endless, 0.0, half)
    away = np.abs(motion[0] - middle)
    quantity = f"distance of {{}} from the middle of its range {_BY}"
    yield _joint_check(body, quantity, times, away, half, ("rad", "m"))
    h = np.diff(trajectory.t)[_segments(trajectory, times), None]
    digits = _QUINTIC * _DIGITS * np.spacing(np.abs(motion[0]).max())
    rates = (
        ("velocity", bounds.velocity, ("rad/s", "m/s")),
        ("acceleration", bounds.acceleration, ("rad/s2", "m/s2")),
        ("jerk", bounds.jerk, ("rad/s3", "m/s3")),
    )
    for order, (name, bound, units) in enumerate(rates, start=1):
        rate = np.maximum(np.abs(motion[order]) - digits / h**order, 0.0)
        yield _joint_check(body, f"{name} of {{}} {_BY}", times, rate, bound, units)


def _clearance_checks(
    scene: Scene,
    options: PlannerOptions,
    body: Multibody,
    robot: Robot,
    times: FloatArray,
    q: FloatArray,
) -> Iterator[Check]:
    """What the package's clearances differ by, and the proven ones against the margin."""
    theirs = Clearances(robot, scene.obstacles).smallest(q).distance
    own, names = _proven_clearance(scene, body, q)
    nearest = np.clip(theirs, own.lower, own.upper)
    with np.errstate(invalid="ignore"):
        # Of shapes that overlap only that counts; without pairs both are infinite.
        agreed = ((own.upper < 0) & (theirs < 0)) | (nearest == theirs)
        away = np.where(agreed, 0.0, np.abs(theirs - nearest))
    yield _worst(f"difference of the clearance {_FROM}", times, away, _DISTANCES, "m")
    k = int(own.lower.argmin())
    who = " of {} from {}".format(*names[own.pair[k]]) if names else ""
    yield Check(
        quantity=f"clearance{who} {_BY}",
        time=float(times[k]),
        value=float(own.lower[k]),
        bound=options.safety_margin_m - _MARGIN,
        unit="m",
        at_least=True,
    )


def _proven_clearance(scene: Scene, body: Multibody, q: FloatArray) -> tuple[Proven, list[tuple[str, str]]]:
    """Bounds of the smallest distance to obstacles, and of the arm to the robot's other shapes.

    Also what the pairs of shapes are called.
    """
    shapes, pairs = _shapes_and_pairs(scene, body)
    R_WJ, p_WJ = body.frames(q)
    R, p = np.empty((len(shapes), len(q), 3, 3)), np.empty((len(shapes), len(q), 3))
    for k, one in enumerate(shapes):
        R[k] = R_WJ[one.joint] @ one.X_JS[:3, :3]
        p[k] = p_WJ[one.joint] + R_WJ[one.joint] @ one.X_JS[:3, 3]
    proven = smallest_distances([one.shape for one in shapes], R, p, pairs)
    return proven, [(shapes[first].link, shapes[second].link) for first, second in pairs]


def _shapes_and_pairs(scene: Scene, body: Multibody) -> tuple[list[PlacedShape], list[tuple[int, int]]]:
    """Shapes of the robot and of the obstacles, and the pairs of them whose distances count."""
    shapes, pairs = list(body.shapes), list(body.pairs)
    moving = [k for k, one in enumerate(shapes) if one.joint > 0]
    for obstacle in scene.obstacles:
        for X_OS, shape in _obstacle_shapes(obstacle.shape):
            pairs += [(k, len(shapes)) for k in moving]
            X_WS = np.asarray(obstacle.X_WO) @ X_OS
            shapes.append(PlacedShape(link=obstacle.name, joint=0, X_JS=X_WS, shape=shape))
    return shapes, pairs


def _obstacle_shapes(shape: Shape) -> Iterator[tuple[FloatArray, ConvexShape]]:
    """Convex shapes of an obstacle with their poses in it: of a mesh the hulls of its connected parts."""
    match shape:
        case Box(size=size):
            yield np.eye(4), ConvexShape(half=0.5 * np.array(size))
        case Cylinder(radius=radius, length=length):
            yield np.eye(4), ConvexShape(half=np.array([0.0, 0.0, 0.5 * length]), disc=radius)
        case Capsule(radius=radius, length=length):
            yield np.eye(4), ConvexShape(half=np.array([0.0, 0.0, 0.5 * length]), radius=radius)
        case Sphere(radius=radius):
            yield np.eye(4), ConvexShape(radius=radius)
        case Mesh(path=path, scale=scale):
            for points in mesh_parts(path, scale):
                X = np.eye(4)
                X[:3, 3], convex = hull(points)
                yield X, convex


def _path_checks(stroke: Stroke, own: ScenePath, times: FloatArray) -> Iterator[Check]:
    """What the package's timed path differs by."""
    path = stroke.path
    poses, (p, R) = path.poses(times), own.poses(times)
    away = np.linalg.norm(poses.point - p, axis=1)
    bound = _POSES * max(1.0, float(np.abs(path.corners).max()))
    yield _worst(f"difference of the timed tool path {_FROM}", times, away, bound, "m")
    turned = _angles(np.broadcast_to(poses.rotation, R.shape), R)
    yield _worst(f"turn between the timed tool path and that {_FROM}", times, turned, _POSES, "rad")
    via_times = own.via_times()
    late = np.abs(stroke.via_times - via_times)
    bound = _SHARES * float(via_times[-1])
    yield _worst(f"difference of the via-points' times {_FROM}", via_times, late, bound, "s")


def _via_point_checks(
    keep: Keep, path: ScenePath, body: Multibody, trajectory: QuinticTrajectory
) -> Iterator[Check]:
    """Whether the tool is at its timed pose at the via-points."""
    ends = trajectory.t[[0, -1]]
    # A trajectory is to end with its path: where it is shorter or longer, it is held at its ends.
    times = np.concatenate([path.via_times(), ends])
    p, R = body.tool_poses(_motion(trajectory, np.clip(times, *ends))[0])
    p_timed, R_timed = path.poses(times)
    away = np.linalg.norm(p - p_timed, axis=1)
    yield _worst("distance of the tool from its timed via-point", times, away, _VIA_POINT, "m")
    if keep not in ("pose", "axis"):
        return
    turned = _angles(R, R_timed) if keep == "pose" else _between(R[:, :, 2], R_timed[:, :, 2])
    yield _worst("turn of the tool at its via-point", times, turned, _VIA_POINT, "rad")


def _tilt_check(cone: AxisCone, path: ScenePath, body: Multibody, times: FloatArray, q: FloatArray) -> Check:
    """The angle between the tool's axis and that of the path against the scene's."""
    # A trajectory is to end with its path: where it is longer, the path's end counts.
    z, z_timed = (R[:, :, 2] for R in (body.tool_poses(q)[1], path.poses(times)[1]))
    bound = np.radians(cone.axis_within_deg) * (1 + _LIMIT)
    return _worst(f"tool tilt {_BY}", times, _between(z, z_timed), bound, "rad")


def _speed_checks(
    scene: Scene, stroke: int, path: ScenePath, body: Multibody, times: FloatArray, motion: list[FloatArray]
) -> Iterator[Check]:
    """The speed of the tool point against the scene's, with the tolerance that it has."""
    speed = np.linalg.norm(body.tool_velocities(motion[0], motion[1]), axis=1)
    if scene.tool.max_speed_m_s is not None:
        bound = scene.tool.max_speed_m_s * (1 + SPEED_TOLERANCE) * (1 + _LIMIT)
        yield _worst(f"tool speed {_BY}", times, speed, bound, "m/s")
    tolerance, asked = scene.each_stroke[stroke].speed_tolerance, path.process_speeds(times)
    if tolerance is not None:
        missed = np.where(asked > 0, np.abs(speed / np.where(asked > 0, asked, 1.0) - 1.0), 0.0)
        yield _worst(
            f"deviation of the process speed {_BY}", times, missed, tolerance * (1 + _LIMIT), "of it"
        )


def _angles(R: FloatArray, other: FloatArray) -> FloatArray:
    """Angles (N,), rad, between orientations (N, 3, 3) and others, by the chord: exact for small ones."""
    chord = np.linalg.norm(R - other, axis=(1, 2)) / np.sqrt(8)
    return np.asarray(2 * np.arcsin(np.minimum(chord, 1.0)))


def _between(z: FloatArray, other: FloatArray) -> FloatArray:
    """Angles (N,), rad, between unit vectors (N, 3) and another."""
    return np.asarray(2 * np.arcsin(np.minimum(np.linalg.norm(z - other, axis=1) / 2, 1.0)))


def _worst(quantity: str, times: FloatArray, value: FloatArray, bound: float, unit: str) -> Check:
    k = int(value.argmax())
    return Check(quantity=quantity, time=float(times[k]), value=float(value[k]), bound=bound, unit=unit)


def _joint_check(
    body: Multibody,
    quantity: str,
    times: FloatArray,
    value: FloatArray,
    bound: FloatArray,
    units: tuple[str, str],
) -> Check:
    """The joint, of absolute values (N, n), that uses most of its bound (n,); units if it turns or slides."""
    k, joint = np.unravel_index((value / bound).argmax(), value.shape)
    return Check(
        quantity=quantity.format(body.joints[joint]),
        time=float(times[k]),
        value=float(value[k, joint]),
        bound=float(bound[joint] * (1 + _LIMIT)),
        unit=units[bool(body.slides[joint])],
    )
