"""The first view of a plan: from where path, arm and foot are seen, and the points that have to be in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.collision import Obstacle
from cmbot.common.arrays import FloatArray, interpolated
from cmbot.planning import Plan
from cmbot.robot import Chain, Kinematics, Robot, box_about
from cmbot.views.drawing.meshcat_scene import reach, surroundings
from cmbot.views.drawing.support import pole_of
from cmbot.views.drawing.surfaces import obstacle_surface

ARROW = 0.32  # of the largest torque, as a share of the reach
RISE = 0.24  # of a camera, upwards in a length of 1 across
# How far beside the tool path workpieces are shown, and a pole from the foot, as shares of the reach.
_BESIDE, _POLE = 0.1, 1.5
# Directions all around, (200, 3), on a spiral over the sphere.
_ANGLES = np.pi * (1 + 5**0.5) * np.arange(200)
_HEIGHTS = np.linspace(-1, 1, 200)
_WIDTHS = np.sqrt(1 - _HEIGHTS**2)
_DIRECTIONS = np.stack([_WIDTHS * np.cos(_ANGLES), _WIDTHS * np.sin(_ANGLES), _HEIGHTS], axis=1)
# Views that are tried: about z from the usual one, deg, and rises of the camera with what each loses.
_CAMERA_TURNS = np.radians([0, -30, 30, -60, 60, -90, 90, -120, 120, -150, 150, 180])
_CAMERA_RISES = {RISE: 0.0, 0.6: 0.05, -0.2: 0.15}
# What a view loses with half a turn; how far its camera is, in radii of what is shown.
_TURN_COST, _FAR = 0.3, 3.2
# What it counts, beside that they are seen, that path and arm are seen from the side and not from an end; the
# shares of their sizes that are enough for it.
_WIDE, _WIDE_ENOUGH, _LONG_ENOUGH = 0.5, 0.5, 0.7
# By which triangles overlap, as a share of their sizes: no ray passes between two of them.
_SEAM = 1e-9
# A path that is narrower than this share of its length is a line.
_LINE_WIDTH_SHARE = 0.05
# What of the path is looked at, and how far in front of a point nothing hides it, as a share of the reach.
_PLACES, _CLOSE = 24, 0.01


def focus_of(
    plan: Plan, plans: Sequence[Plan], bent: Sequence[FloatArray], around: Sequence[Obstacle] = ()
) -> dict[str, Any]:
    """Return points that the view shows, a ball about them, and the direction to the camera.

    The points are those of the arm, rigid and with the poses (K, n, 7) of `bent` links, the pole on which it
    stands, the path, the workpieces beside it and the torque's arrow, in W, m; of them those that enclose the
    others along many directions. What is `around` is drawn, too, and may hide them.
    """
    others = [] if plan.baseline is None else [plan.baseline.samples]
    motions = [(plan.robot, samples.q) for samples in others]
    motions += [(each.robot, segment.trajectory.q) for each in plans for segment in each.job.segments]
    shown = [*others, *(each.job_samples[0] for each in plans)]
    torques = [samples.guardrail_torque for samples in shown]
    torque = np.concatenate(torques)
    largest = max(float(np.linalg.norm(torque, axis=1).max()), 1e-9)
    feet = np.array([each.robot.foot_point for each in plans])
    points = [feet, feet[:1] + ARROW * reach(plan.robot) * torque / largest]
    kinematics, moved = Kinematics(plan.robot), (*others, *(each.samples for each in plans))
    points += [kinematics.in_world(samples.q, samples.tool_point) for samples in moved]
    if (pole := pole_of(plan.scene)) is not None:
        away = pole.beams.reshape(-1, 3) - feet[0]
        length = np.linalg.norm(away, axis=1, keepdims=True)
        points.append(feet[0] + away * np.minimum(1.0, _POLE * reach(plan.robot) / np.maximum(length, 1e-9)))
    outlines = [outline for each in plans for outline in each.outlines]
    beside = _BESIDE * reach(plan.robot)
    points += [*outlines, *workpieces(plan.scene.all_obstacles, np.concatenate(outlines), beside)]
    poses = [link_poses(robot, q[:: max(1, len(q) // 50)]) for robot, q in motions]
    points += [link_corners(plan.robot, each) for each in (*poses, *bent)]
    cloud = np.concatenate(points)
    return focus_on(cloud, *_direction(plan, outlines, cloud, around))


def focus_on(cloud: FloatArray, azimuth: float, rise: float = RISE) -> dict[str, Any]:
    """Return what `focus_of` does for points (K, 3) in W."""
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    # Those that are outermost along some direction decide what is seen.
    outermost = cloud[(_DIRECTIONS @ cloud.T).argmax(axis=1)]
    return {
        "centre": ((low + high) / 2).tolist(),
        "radius": max(float(np.linalg.norm(high - low)) / 2, 1e-3),
        "points": np.unique(outermost, axis=0).tolist(),
        "azimuth": azimuth,
        "rise": rise,
    }


def link_poses(robot: Robot, q: FloatArray) -> FloatArray:
    """Return poses (N, m, 7) of the frames of all joints in W at postures `q` (N, n)."""
    every = robot.coupling.positions(q)
    poses, fixed = np.empty((*every.shape, 7)), [np.eye(3)] * every.shape[1]
    for joint, (origin, _, axes) in enumerate(Chain(robot.model, fixed).walk(every.T)):
        poses[:, joint, :3] = origin.T
        poses[:, joint, 3:] = Rotation.from_matrix(axes.transpose(2, 1, 0)).as_quat(canonical=True)
    return poses


def seen(points: FloatArray, eye: FloatArray, corners: FloatArray, near: float = 0.0) -> FloatArray:
    """Return of which points (K, 3) triangles with the `corners` (m, 3, 3) hide nothing from an `eye` (3,).

    What is nearer to a point than `near` does not hide it. By Möller and Trumbore 1997.
    """
    ray = eye - points
    length = np.linalg.norm(ray, axis=1)
    a, first, second = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(ray[:, None], second)
    determinant = np.einsum("kmi,mi->km", across, first)
    offset = points[:, None] - a
    turned = np.cross(offset, first)
    with np.errstate(all="ignore"):  # a ray beside a triangle's plane meets it nowhere
        u = np.einsum("kmi,kmi->km", offset, across) / determinant
        v = np.einsum("kmi,ki->km", turned, ray) / determinant
        at = np.einsum("kmi,mi->km", turned, second) / determinant
        hit = (u >= -_SEAM) & (v >= -_SEAM) & (u + v <= 1 + _SEAM) & (at * length[:, None] > near) & (at < 1)
    return np.asarray(~hit.any(axis=1))


def width_of(path: FloatArray, way: FloatArray) -> float:
    """Return the share of a path (K, 3), of its area or, if it is a line, of its length, seen along `way`."""
    points = path - path.mean(axis=0)
    across = points - points @ np.outer(way, way)
    (long, wide, _), (seen_long, seen_wide, _) = (
        np.linalg.svd(each, compute_uv=False) for each in (points, across)
    )
    if wide < _LINE_WIDTH_SHARE * long:
        return float(seen_long / max(long, 1e-9))
    return float(seen_long * seen_wide / (long * wide))


def _direction(
    plan: Plan, outlines: Sequence[FloatArray], cloud: FloatArray, beside: Sequence[Obstacle]
) -> tuple[float, float]:
    """Return azimuth about z of W and rise of the camera from which path, arm and foot are seen best.

    Nothing hides them there, and neither path nor arm is seen from its end. Of views that show as much it is
    that nearest to the usual one: outside the guardrail, at 45 deg to the stretched arm, as the torque of a
    weight is perpendicular to the arm, so both are visible.
    """
    tool = Kinematics(plan.robot).in_world(plan.samples.q, plan.samples.tool_point)
    x, y, _ = tool.mean(axis=0) - np.array(plan.robot.foot_point)
    arm = np.arctan2(y, x)
    usual = float(min((arm - np.pi / 4, arm + np.pi / 4), key=lambda angle: abs(angle - np.pi / 2)))
    surfaces = [surface for _, surface in surroundings(plan.scene)]
    surfaces += [obstacle_surface(each) for each in beside]
    corners = np.concatenate([np.zeros((0, 3, 3)), *(each.vertices[each.faces] for each in surfaces)])
    path = np.concatenate([_spread(outline) for outline in outlines])
    path = path[np.unique(np.linspace(0, len(path) - 1, _PLACES).astype(int))]
    middle = plan.samples.q[len(plan.samples.q) // 2]
    arm_points = np.vstack([plan.robot.foot_point, link_poses(plan.robot, middle[None])[0, :, :3]])
    centre, radius = (cloud.min(axis=0) + cloud.max(axis=0)) / 2, np.linalg.norm(np.ptp(cloud, axis=0)) / 2
    near = _CLOSE * reach(plan.robot)
    best, value = (usual, RISE), -np.inf
    for rise, turn in product(_CAMERA_RISES, _CAMERA_TURNS):
        cost = _TURN_COST * abs(turn) / np.pi + _CAMERA_RISES[rise]
        way = np.array([np.cos(usual + turn), np.sin(usual + turn), rise]) / np.hypot(1, rise)
        wide = min(width_of(path, way) / _WIDE_ENOUGH, 1)
        long = min(abs(np.sin(usual + turn - arm)) / _LONG_ENOUGH, 1)
        gain = _WIDE * (wide + long) - cost
        if 2 + gain <= value:
            continue
        eye = centre + _FAR * radius * way
        shown = seen(path, eye, corners, near).mean() + seen(arm_points, eye, corners, near).mean() + gain
        if shown > value:
            best, value = (usual + float(turn), rise), float(shown)
    return best


def _spread(outline: FloatArray) -> FloatArray:
    """Places along an outline (N, 3), as many as are looked at of all."""
    along = np.append(0.0, np.linalg.norm(np.diff(outline, axis=0), axis=1).cumsum())
    at = np.linspace(0.0, along[-1], _PLACES)
    return interpolated(at, along, outline)


def link_corners(robot: Robot, poses: FloatArray) -> FloatArray:
    """Origins of frames with `poses` (N, n, 7), and corners of boxes about the links' shapes, in W (K, 3)."""
    found = [poses[..., :3].reshape(-1, 3)]
    for shape in robot.collision_model.geometryObjects:
        corners = np.array(list(product(*box_about(shape.geometry).T)))
        corners = corners @ shape.placement.rotation.T + shape.placement.translation
        if shape.parentJoint:
            pose = poses[:, shape.parentJoint - 1]
            turned = Rotation.from_quat(pose[:, 3:]).as_matrix() @ corners.T
            corners = (turned.transpose(0, 2, 1) + pose[:, None, :3]).reshape(-1, 3)
        found.append(corners)
    return np.concatenate(found)


def workpieces(obstacles: Sequence[Obstacle], near: FloatArray, room: float) -> Iterator[FloatArray]:
    """Yield corners (8, 3) in W of boxes about workpieces, as far as they are beside points (K, 3), m."""
    for obstacle in obstacles:
        if not obstacle.workpiece:
            continue
        vertices = obstacle_surface(obstacle).vertices
        low = np.maximum(vertices.min(axis=0), near.min(axis=0) - room)
        high = np.minimum(vertices.max(axis=0), near.max(axis=0) + room)
        if (low <= high).all():
            yield np.array(list(product(*zip(low, high, strict=True))))
