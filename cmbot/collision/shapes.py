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

from cmbot.collision.mesh_file import load_mesh
from cmbot.collision.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.robot import Robot, convex_hull, encloses_volume

if TYPE_CHECKING:
    import trimesh

# Meshes whose hulls are kept.
_CACHED_HULLS = 8
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
        tool_joint = frames[robot.tool_frame_id].parentJoint
        behind = dict[tuple[int, float], int | None]()
        for obstacle in obstacles:
            for k, (shape, X_OS) in enumerate(coal_shapes(obstacle.shape, obstacle.name)):
                X_WS = pin.SE3(np.array(obstacle.X_WO)) * X_OS
                name = f"obstacle {obstacle.name} {k}"
                second = self.geometry.addGeometryObject(pin.GeometryObject(name, 0, X_WS, shape))
                joints.append(0)
                for first, link in enumerate(links):
                    if joints[first] > 0:
                        at_work = obstacle.workpiece and joints[first] == tool_joint
                        names = ShapePair(link=link, other=obstacle.name, tool_at_work=at_work)
                        if at_work and obstacle.contact:
                            at = first, obstacle.contact
                            if at not in behind:
                                # Of those in `geometry` the memory moves as shapes are added.
                                whole = robot.collision_model.geometryObjects[first]
                                behind[at] = self._added(without_tip(robot, whole, obstacle.contact))
                            first = behind[at]
                        if first is not None:
                            self._add(first, second, names)

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


def without_tip(robot: Robot, shape: Any, length: float) -> Any | None:
    """Return the hull of a tool's shape without its tip, a pinocchio.GeometryObject; None: nothing is left.

    Parameters
    ----------
    robot : Robot
    shape : pinocchio.GeometryObject
        That the robot's last joint carries.
    length : float, m
        The tip is what lies beyond the plane that is so far behind the tool point, across the tool's z axis.
    """
    hull = _mesh_about(shape.geometry)
    if hull is None:
        return shape
    X_JS, X_JT = shape.placement, robot.model.frames[robot.tool_frame_id].placement
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


def coal_shapes(shape: Shape, name: str) -> list[tuple[Any, Any]]:
    """Return the convex coal shapes that cover `shape`, with their poses in its frame.

    A mesh becomes the convex hull of each of its connected parts, which need a volume; `name` is the
    obstacle's, for messages.
    """
    match shape:
        case Box(size=size):
            geometry = coal.Box(*size)
        case Cylinder(radius=radius, length=length):
            geometry = coal.Cylinder(radius, length)
        case Capsule(radius=radius, length=length):
            geometry = coal.Capsule(radius, length)
        case Sphere(radius=radius):
            geometry = coal.Sphere(radius)
        case Mesh(path=path, scale=scale):
            hulls = _hulls(load_mesh(path, name, scale=scale), path, name)
            return [(hull, pin.SE3.Identity()) for hull in hulls]
    return [(geometry, pin.SE3.Identity())]


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
        X_WO = pin.SE3(np.array(obstacle.X_WO))
        for shape, X_OS in coal_shapes(obstacle.shape, obstacle.name):
            X_WS = X_WO * X_OS
            there = coal.Transform3s(X_WS.rotation, X_WS.translation)
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
    for shape, X_OS in coal_shapes(obstacle.shape, obstacle.name):
        shape.computeLocalAABB()
        ends = np.array([shape.aabb_local.min_, shape.aabb_local.max_])
        X_WS = pin.SE3(np.array(obstacle.X_WO)) * X_OS
        corners += [X_WS.act(np.array(corner)) for corner in product(*ends.T)]
    return np.array([np.min(corners, axis=0), np.max(corners, axis=0)])


@lru_cache(maxsize=_CACHED_HULLS)
def _hulls(mesh: trimesh.Trimesh, path: Path, name: str) -> tuple[Any, ...]:
    """Convex hulls of the connected parts of a mesh, which clearances of every stroke and page ask for."""
    return tuple(_hull(part, path, name) for part in mesh.split(only_watertight=False))


def _hull(part: trimesh.Trimesh, path: Path, name: str) -> Any:
    vertices = np.asarray(part.vertices)
    if not encloses_volume(vertices):
        got = f"a connected part without volume near {np.round(vertices.mean(axis=0), 3).tolist()}"
        raise SceneError(str(path), f"obstacles[{name}].mesh", got, "parts with three dimensions each")
    return convex_hull(vertices)
