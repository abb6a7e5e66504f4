"""Collision shapes: an obstacle's as coal's, and the pairs of shapes whose distances count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, KDTree

from cmbot.collision.mesh_file import load_mesh
from cmbot.collision.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.robot import Robot, box_about, convex_hull, encloses_volume, solid_points

if TYPE_CHECKING:
    import trimesh

# Meshes whose hulls are kept.
_CACHED_HULLS = 8
# How far hulls of a sheet's patches may be from it, as a share of its size, and how many there are at most.
_SHEET_TOLERANCE_SHARE, _MOST_PATCHES = 0.01, 160
# That distance is sought at points of a hull's longest facets, so many steps along their edges, among the
# nearest faces.
_MOST_FACETS, _FACET_STEPS, _NEAREST_FACES = 60, 4, 24
# Cosine of 80 degrees: the angle by which faces of a sheet may be turned from their mean.
_MIN_SHEET_COSINE = 0.17365
# Of meshes about round shapes.
_SECTIONS = 24


@dataclass(frozen=True, kw_only=True)
class ShapePair:
    """Two shapes whose distance counts.

    Attributes
    ----------
    link : str
        Link of the arm.
    other : str
        Obstacle, or second link of the robot.
    self_collision : bool
        Both belong to the robot.
    tool_at_work : bool
        The tool (all that the last joint carries) and a workpiece, which are expected to be near each other.
    """

    link: str
    other: str
    self_collision: bool = False
    tool_at_work: bool = False

    @property
    def avoidable(self) -> bool:
        """Whether obstacle avoidance (Chang 2021, Eq. (17)) pushes the link away from the other shape."""
        return not (self.self_collision or self.tool_at_work)

    def describe(self, distance: float, margin: float) -> str:
        """Return the sentence that a distance, m, is below the safety margin, m."""
        how = f"reaches {-distance:.4f} m into" if distance < 0 else f"comes within {distance:.4f} m of"
        return f"{self.link} {how} {self.other}{self.touching}, the safety margin is {margin:g} m"

    @property
    def touching(self) -> str:
        """What lets the tool touch a workpiece, in words after its name; empty for other pairs."""
        return " (tool.contact_mm lets the tip touch it)" if self.tool_at_work else ""


class PairedShapes:
    """A robot's collision shapes and the obstacles', paired.

    Parameters
    ----------
    robot : Robot
        Its own shapes stay as they are.
    obstacles : sequence of Obstacle

    Attributes
    ----------
    geometry : pinocchio.GeometryModel
        All shapes, with P collision pairs.
    pairs : list of ShapePair
    shapes : list of two int
        Indices of each pair's shapes: the second is carried by an earlier joint than the first, or by none.
    joints : list of int
        What carries each shape; 0: nothing.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Obstacle]) -> None:
        self.geometry: Any = pin.GeometryModel(robot.collision_model)
        self.pairs: list[ShapePair] = []
        self.shapes: list[tuple[int, int]] = []
        own, frames = list(self.geometry.geometryObjects), robot.model.frames
        self.joints = joints = [int(shape.parentJoint) for shape in own]
        links = [str(frames[shape.parentFrame].name) for shape in own]
        own_pairs = [(pair.first, pair.second) for pair in self.geometry.collisionPairs]
        self.geometry.removeAllCollisionPairs()
        for pair in own_pairs:
            # The link further out is the one that moves.
            second, first = sorted(pair, key=joints.__getitem__)
            if joints[first] != joints[second]:
                names = ShapePair(link=links[first], other=links[second], self_collision=True)
                self._add(first, second, names)
        tool, fixed_tool = frames[robot.tool_frame_id], robot.fixed_tool
        behind = dict[tuple[int, float], int | None]()
        for obstacle in obstacles:
            X_WO = pin.SE3(np.array(obstacle.X_WO))
            for k, shape in enumerate(coal_shapes(obstacle.shape, obstacle.name)):
                whole = pin.GeometryObject(f"obstacle {obstacle.name} {k}", 0, X_WO, shape)
                second = at_tip = self._added(whole)
                if obstacle.contact and fixed_tool is not None:
                    at_tip = self._added(without_tip(whole, fixed_tool, obstacle.contact))
                for first, link in enumerate(links):
                    if joints[first] > 0:
                        at_work = obstacle.workpiece and joints[first] == tool.parentJoint
                        names = ShapePair(link=link, other=obstacle.name, tool_at_work=at_work)
                        if at_work and obstacle.contact and fixed_tool is None:
                            at = first, obstacle.contact
                            if at not in behind:
                                # Of those in `geometry` the memory moves as shapes are added.
                                whole = robot.collision_model.geometryObjects[first]
                                behind[at] = self._added(without_tip(whole, tool.placement, obstacle.contact))
                            first = behind[at]
                        other = at_tip if at_work else second
                        if first is not None and other is not None:
                            self._add(first, other, names)

    def _added(self, shape: Any) -> int | None:
        """The index of one more shape; None where there is none."""
        if shape is None:
            return None
        self.joints.append(int(shape.parentJoint))
        return int(self.geometry.addGeometryObject(shape))

    def _add(self, first: int, second: int, names: ShapePair) -> None:
        self.geometry.addCollisionPair(pin.CollisionPair(first, second))
        self.shapes.append((first, second))
        self.pairs.append(names)


def without_tip(shape: Any, X_JT: Any, length: float) -> Any | None:
    """Return the hull of a tool's shape without its tip, a pinocchio.GeometryObject; None: nothing is left.

    Parameters
    ----------
    shape : pinocchio.GeometryObject
    X_JT : pinocchio.SE3
        The tool in the frame of what carries the shape: the robot's last joint, or W.
    length : float, m
        The tip is what lies beyond the plane that is so far behind the tool point, across the tool's z axis.
    """
    hull = _mesh_about(shape.geometry)
    if hull is None:
        return shape
    X_JS = shape.placement
    at = X_JS.actInv(X_JT.act(np.array([0.0, 0.0, -length])))
    left = hull.slice_plane(at, -X_JS.rotation.T @ X_JT.rotation[:, 2])
    if not encloses_volume(np.asarray(left.vertices)):
        return None
    name = f"{shape.name} without its last {length:g} m"
    rest = convex_hull(np.asarray(left.vertices))
    return pin.GeometryObject(name, shape.parentJoint, shape.parentFrame, X_JS, rest)


def _mesh_about(geometry: Any) -> Any:
    """A convex trimesh.Trimesh about a shape, by 2 % of its radius at most; None of kinds that are rare."""
    from trimesh import Trimesh, creation

    if isinstance(geometry, coal.ConvexBase):
        return Trimesh([geometry.point(i) for i in range(geometry.num_points)]).convex_hull
    if isinstance(geometry, coal.Box):
        return creation.box(2 * geometry.halfSide)
    if not isinstance(geometry, coal.Sphere | coal.Capsule | coal.Cylinder):
        return None
    # Chords are that much nearer to the axis than the circle.
    radius = geometry.radius / np.cos(np.pi / _SECTIONS) ** 2
    if isinstance(geometry, coal.Cylinder):
        return creation.cylinder(radius, 2 * geometry.halfLength, sections=_SECTIONS)
    long = 2 * geometry.halfLength if isinstance(geometry, coal.Capsule) else 0.0
    return creation.capsule(long, radius, count=[_SECTIONS, _SECTIONS]).convex_hull


def coal_shapes(shape: Shape, name: str) -> Sequence[Any]:
    """Return the convex coal shapes that cover `shape`, in its frame.

    A mesh becomes the convex hull of each of its connected parts, which need a volume. A part that is a sheet
    becomes the hulls of patches of its faces: bends and holes that are larger than 1 % of its size stay
    open. `name` is the obstacle's, for messages.
    """
    match shape:
        case Box(size=size):
            return [coal.Box(*size)]
        case Cylinder(radius=radius, length=length):
            return [coal.Cylinder(radius, length)]
        case Capsule(radius=radius, length=length):
            return [coal.Capsule(radius, length)]
        case Sphere(radius=radius):
            return [coal.Sphere(radius)]
        case Mesh(path=path, scale=scale):
            return _hulls(load_mesh(path, name, scale=scale), path, name)


def touched_by(box: Box, X_WB: FloatArray, obstacles: Sequence[Obstacle]) -> str | None:
    """Return the name of the first obstacle that a box touches; None where it touches none.

    Parameters
    ----------
    box : Box
    X_WB : (4, 4)
        Its pose in W.
    obstacles : sequence of Obstacle
    """
    own, place = coal.Box(*box.size), coal.Transform3s(X_WB[:3, :3], X_WB[:3, 3])
    for obstacle in obstacles:
        there = coal.Transform3s(obstacle.X_WO[:3, :3], obstacle.X_WO[:3, 3])
        for shape in coal_shapes(obstacle.shape, obstacle.name):
            if coal.collide(own, place, shape, there, coal.CollisionRequest(), coal.CollisionResult()):
                return obstacle.name
    return None


def extent_of(obstacle: Obstacle) -> FloatArray:
    """Return the smallest and the largest coordinates of an obstacle in W, at most, (2, 3), m.

    Parameters
    ----------
    obstacle : Obstacle
    """
    corners = list[FloatArray]()
    for shape in coal_shapes(obstacle.shape, obstacle.name):
        corners += map(np.array, product(*box_about(shape).T))
    placed = np.array(corners) @ obstacle.X_WO[:3, :3].T + obstacle.X_WO[:3, 3]
    return np.array([placed.min(axis=0), placed.max(axis=0)])


@lru_cache(maxsize=_CACHED_HULLS)
def _hulls(mesh: trimesh.Trimesh, path: Path, name: str) -> tuple[Any, ...]:
    """Convex hulls about a mesh, which clearances of every stroke and page ask for."""
    found = list[Any]()
    for part in mesh.split(only_watertight=False):
        vertices = np.asarray(part.vertices)
        if not encloses_volume(vertices):
            got = f"a connected part without volume near {np.round(vertices.mean(axis=0), 3).tolist()}"
            raise SceneError(str(path), f"obstacles[{name}].mesh", got, "parts with three dimensions each")
        found += _patches(part) if _is_sheet(part) else [vertices]
    return tuple(convex_hull(points) for points in found)


def _is_sheet(part: trimesh.Trimesh) -> bool:
    """Whether a part has no inside: all of it is seen from one side."""
    mean = np.asarray(part.area_faces @ part.face_normals) / part.area
    least = _MIN_SHEET_COSINE * max(float(np.linalg.norm(mean)), _MIN_SHEET_COSINE)
    return bool((part.face_normals @ mean >= least).all())


def _patches(sheet: trimesh.Trimesh) -> list[FloatArray]:
    """Corners of a sheet's faces in patches, each with a volume; halved until their hulls are near it."""
    corners = np.asarray(sheet.triangles)
    middles = KDTree(corners.mean(axis=1))
    tolerance = _SHEET_TOLERANCE_SHARE * float(np.linalg.norm(sheet.extents))
    waiting, done = [np.arange(len(corners))], list[FloatArray]()
    while waiting:
        patch = waiting.pop(0)
        points = solid_points(np.asarray(sheet.vertices)[np.unique(sheet.faces[patch])])
        is_last = len(patch) == 1 or len(done) + len(waiting) >= _MOST_PATCHES
        if is_last or _hull_distance(points, corners, middles) <= tolerance:
            done.append(points)
        else:
            # Across where it is longest; triangles with the same middle are shared out.
            offset = middles.data[patch] - middles.data[patch].mean(axis=0)
            place = offset @ np.linalg.eigh(offset.T @ offset)[1][:, -1]
            first = place < 0.5 * (place.min() + place.max())
            first = first if first.any() else np.arange(len(patch)) % 2 == 0
            waiting += [patch[first], patch[~first]]
    return done


def _hull_distance(points: FloatArray, corners: FloatArray, middles: KDTree) -> float:
    """How far the hull of points (M, 3) is from triangles (N, 3, 3) with these middles, m, as sampled."""
    from trimesh.triangles import closest_point

    facets = points[ConvexHull(points).simplices]
    longest = np.linalg.norm(np.diff(facets, axis=1, append=facets[:, :1]), axis=2).max(axis=1).argsort()
    steps = range(_FACET_STEPS + 1)
    shares = [(a, b, _FACET_STEPS - a - b) for a in steps for b in steps if a + b <= _FACET_STEPS]
    sampled = (np.array(shares) / _FACET_STEPS @ facets[longest[-_MOST_FACETS:]]).reshape(-1, 3)
    near = middles.query(sampled, min(_NEAREST_FACES, len(corners)))[1].reshape(len(sampled), -1)
    sampled = np.repeat(sampled, near.shape[1], axis=0)
    nearest = closest_point(corners[near].reshape(-1, 3, 3), sampled)  # type: ignore[no-untyped-call]
    return float(np.linalg.norm(nearest - sampled, axis=1).reshape(near.shape).min(axis=1).max())
