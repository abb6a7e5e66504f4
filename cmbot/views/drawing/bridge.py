"""The rest of the bridge, drawn for orientation: nothing keeps clear of it, so it is only where no arm goes.

A scene says what the arm must not hit and what it works on. Behind a guardrail the pages add what a railway
bridge has there: walkway and its brackets, two plate girders, sleepers and rails, and a bar that holds each
workpiece. Its dimensions are ours. A part that the motion comes nearer to than the safety margin is left
out, and so is one in the place of an obstacle.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from cmbot.collision import Box, Clearances, Obstacle
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.poses import pose, turned_pose
from cmbot.planning import Plan
from cmbot.robot import Robot
from cmbot.scene import Scene
from cmbot.views.drawing.camera import link_corners, link_poses
from cmbot.views.drawing.surfaces import Surface, merged, obstacle_surface

# Lengths in m; y and z are those of W, z from the lower side of the walkway, where the posts end.
_OVERHANG_M = 0.6  # of the last post
_WALKWAY_EDGE_M, _EDGE_BEAM, _WALKWAY = -0.12, (0.12, 0.16), (1.2, 0.12)
_GIRDERS, _WEB, _FLANGE = (-1.75, -3.75), (0.02, 1.5), (0.4, 0.04)
_STIFFENER = (0.02, 0.18)  # thickness, depth
_SLEEPER, _SPACING = (0.26, 2.5, 0.22), 0.6
_GAUGE, _RAIL_FOOT, _RAIL_WEB, _RAIL_HEAD = 1.435, (0.15, 0.03), (0.02, 0.11), (0.07, 0.04)
_BAR_M = 0.06
# How far beside what it holds a bar ends: where the arm is in the way of all straight ones, others are tried.
_BAR_END_OFFSETS_M = ((0.0,), (-0.4, 0.4, -0.8, 0.8))
# Knots of each part of the motion that are looked at, and points of a bar.
_KNOTS, _POINTS = 25, 24
_TOUCHING = 1e-3


def bridge_of(scene: Scene, motions: Iterable[tuple[Robot, FloatArray]], margin: float) -> list[Obstacle]:
    """Return parts of the bridge behind the guardrail as boxes; none where the base is named otherwise.

    Parameters
    ----------
    scene : Scene
    motions : iterable of (Robot, (N, n) array)
        Robots with the knots of their motions, rad.
    margin : float, m
        Parts to which these come nearer are left out.
    """
    if not scene.elastic_guardrail.post_positions or scene.base_name != "guardrail":
        return []
    some = [(robot, q[:: max(1, len(q) // _KNOTS)]) for robot, q in motions]
    solids = [_bounds(obstacle_surface(each)) for each in scene.all_obstacles if not each.workpiece]
    taken = np.array(solids).reshape(-1, 1, 2, 3)
    parts = list(_parts(scene))
    free = ~_overlap(_box_bounds(parts), taken).any(axis=0)
    shown = _clear(some, margin, [parts[k] for k in np.flatnonzero(free)])
    pieces = [obstacle_surface(each) for each in scene.all_obstacles if each.workpiece]
    for group in _touching(pieces):
        for beside in _BAR_END_OFFSETS_M:
            holders = _holders(scene, group, beside)
            free = ~_pierced(holders, taken).any(axis=0)
            if found := _clear(some, margin, [holders[k] for k in np.flatnonzero(free)]):
                shown.append(found[0])
                break
    return shown


def jobs_of(plans: Iterable[Plan]) -> Iterator[tuple[Robot, FloatArray]]:
    """Yield the motions of whole jobs, for `bridge_of`."""
    for plan in plans:
        for segment in plan.job.segments:
            yield plan.robot, segment.trajectory.q


def _parts(scene: Scene) -> Iterator[Obstacle]:
    posts, bottom = scene.elastic_guardrail.post_positions, scene.elastic_guardrail.post.bottom - 0.02
    low, high = min(posts) - _OVERHANG_M, max(posts) + _OVERHANG_M
    along, middle = high - low, (low + high) / 2

    def beam(name: str, y: float, z: float, size: tuple[float, float]) -> Obstacle:
        """A beam along x with its middle at y and its lower side at z."""
        return _box(name, (along, *size), (middle, y, bottom + z + size[1] / 2))

    width, height = _WALKWAY
    yield beam("walkway", _WALKWAY_EDGE_M - _EDGE_BEAM[0] / 2 - width / 2 - 0.02, 0.0, (width, height))
    yield beam("edge_beam", _WALKWAY_EDGE_M, -0.04, _EDGE_BEAM)
    depth = _WEB[1]
    for y in _GIRDERS:
        yield beam("web", y, -depth, _WEB)
        yield beam("flange", y, -depth - _FLANGE[1], _FLANGE)
        yield beam("flange", y, 0.0, _FLANGE)
        for x in np.arange(low + _SPACING, high, 2 * _SPACING):
            size = (_STIFFENER[0], _STIFFENER[1], depth)
            yield _box("stiffener", size, (x, y + _STIFFENER[1] / 2, bottom - depth / 2))
    for x in posts:
        # A bracket below the walkway: its upper flange and the strut under it.
        yield _bar("bracket", (x, _WALKWAY_EDGE_M, bottom - 0.04), (x, _GIRDERS[0], bottom - 0.04), 0.08)
        yield _bar(
            "bracket", (x, _WALKWAY_EDGE_M - 0.1, bottom - 0.08), (x, _GIRDERS[0], bottom - 0.6 * depth), 0.06
        )
    centre, top = sum(_GIRDERS) / 2, _FLANGE[1]
    for x in np.arange(low + _SPACING / 2, high, _SPACING):
        yield _box("sleeper", _SLEEPER, (x, centre, bottom + top + _SLEEPER[2] / 2))
    for y in (centre - _GAUGE / 2, centre + _GAUGE / 2):
        z = top + _SLEEPER[2]
        for section in (_RAIL_FOOT, _RAIL_WEB, _RAIL_HEAD):
            yield beam("track", y, z, section)
            z += section[1]


def _holders(scene: Scene, group: Sequence[Surface], beside: Sequence[float]) -> list[Obstacle]:
    """Return bars that may hold workpieces that touch, the shortest first; ending so far `beside` them, m."""
    bottom = scene.elastic_guardrail.post.bottom - 0.02
    low, high = _bounds(merged(group))
    x, y = (low[0] + high[0]) / 2, low[1]
    starts = [(x, y, z) for z in (high[2] - _BAR_M / 2, (low[2] + high[2]) / 2, low[2] + _BAR_M / 2)]
    heights = [float(np.clip(z, bottom - 0.9 * _WEB[1], bottom - 0.1)) for *_, z in starts]
    ends = [(_WALKWAY_EDGE_M, bottom - 0.04), *((_GIRDERS[0], z) for z in heights)]
    each = [(start, (x + by, *end)) for start, by, end in product(starts, beside, ends)]
    each.sort(key=lambda bar: float(np.linalg.norm(np.subtract(*bar))))
    return [_bar("holder", start, end, _BAR_M) for start, end in each]


def _touching(surfaces: Sequence[Surface]) -> list[list[Surface]]:
    """Surfaces in groups whose boxes overlap."""
    groups: list[list[Surface]] = []
    for surface in surfaces:
        near = [group for group in groups if _overlap(_bounds(merged(group)), _bounds(surface), _TOUCHING)]
        groups = [group for group in groups if group not in near]
        groups.append([surface, *(each for group in near for each in group)])
    return groups


def _clear(
    motions: Sequence[tuple[Robot, FloatArray]], margin: float, parts: Sequence[Obstacle]
) -> list[Obstacle]:
    """Return the parts to which motions keep the safety margin, m, as far as their knots tell."""
    parts = [replace(part, name=f"{part.name}_{number}") for number, part in enumerate(parts)]
    hit = set[str]()
    for robot, postures in _by_robot(motions):
        hit |= _hit(robot, postures, margin, [part for part in parts if part.name not in hit])
    return [part for part in parts if part.name not in hit]


def _by_robot(motions: Sequence[tuple[Robot, FloatArray]]) -> Iterator[tuple[Robot, FloatArray]]:
    """Yield each robot once, with the postures of all its motions."""
    robots = {id(robot): robot for robot, _ in motions}
    for key, robot in robots.items():
        yield robot, np.concatenate([q for each, q in motions if id(each) == key])


def _hit(robot: Robot, q: FloatArray, margin: float, parts: list[Obstacle]) -> set[str]:
    """Return the names of parts to which a robot comes nearer than the margin, m, in postures `q` (N, n)."""
    swept = link_corners(robot, link_poses(robot, q))
    about = np.stack([swept.min(axis=0), swept.max(axis=0)])
    near = [parts[k] for k in np.flatnonzero(_overlap(_box_bounds(parts), about, margin))]
    clearances = Clearances(robot, near)
    others = np.array([not pair.self_collision for pair in clearances.pairs], dtype=bool)
    posture, pair = np.nonzero((clearances.lower_bounds(q) < margin) & others)
    close = pair[clearances.distances(q, posture, pair) < margin]
    return {clearances.pairs[k].other for k in close}


def _box(name: str, size: Sequence[float], centre: Sequence[float]) -> Obstacle:
    return Obstacle(
        name=name, shape=Box(size=(float(size[0]), float(size[1]), float(size[2]))), X_WO=pose(centre)
    )


def _bar(name: str, start: Sequence[float], end: Sequence[float], width: float) -> Obstacle:
    """A bar with a square section from `start` to `end`."""
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    z = along / length
    # Its sides are level, as far as they can be.
    x = np.cross([0.0, 0.0, 1.0], z)
    x = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(x) < _TOUCHING else x / np.linalg.norm(x)
    X = turned_pose(np.add(start, end) / 2, np.stack([x, np.cross(z, x), z], axis=1))
    return Obstacle(name=name, shape=Box(size=(width, width, length)), X_WO=X)


def _bounds(surface: Surface) -> FloatArray:
    """Least and largest coordinates (2, 3) of a surface, m."""
    return np.stack([surface.vertices.min(axis=0), surface.vertices.max(axis=0)])


def _box_bounds(boxes: Sequence[Obstacle]) -> FloatArray:
    """The same (N, 2, 3) of boxes."""
    X = np.array([each.X_WO for each in boxes]).reshape(-1, 4, 4)
    half = 0.5 * np.einsum("nij,nj->ni", np.abs(X[:, :3, :3]), _sizes(boxes))
    return np.stack([X[:, :3, 3] - half, X[:, :3, 3] + half], axis=1)


def _sizes(boxes: Sequence[Obstacle]) -> FloatArray:
    """Edges (N, 3) of boxes, m."""
    return np.array([each.shape.size for each in boxes if isinstance(each.shape, Box)]).reshape(-1, 3)


def _overlap(a: FloatArray, b: FloatArray, room: float = -_TOUCHING) -> BoolArray:
    """Whether boxes with such bounds (..., 2, 3) overlap, or are not farther apart than `room`, m."""
    apart = np.maximum(a[..., 0, :] - b[..., 1, :], b[..., 0, :] - a[..., 1, :]).max(axis=-1, initial=-np.inf)
    return np.asarray(apart <= room)


def _pierced(bars: Sequence[Obstacle], bounds: FloatArray) -> BoolArray:
    """Whether the axes of bars (N,) pass through boxes (M, 1, 2, 3): (M, N)."""
    X = np.array([each.X_WO for each in bars]).reshape(-1, 1, 4, 4)
    along = np.linspace(-0.5, 0.5, _POINTS)[:, None] * _sizes(bars)[:, None, 2:] * X[..., :3, 2]
    points = X[..., :3, 3] + along
    low, high = bounds[:, :, :1], bounds[:, :, 1:]
    return np.asarray(((points > low) & (points < high)).all(axis=-1).any(axis=-1))
