"""The oracle's reading of a scene's robot and obstacles; which files are meant the loader says."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from oracles.convex_distance import ConvexShape, hull
from oracles.multibody import Multibody, PlacedShape
from oracles.urdf_reader import Near, mesh_parts, read_multibody

from cmbot.collision import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cmbot.planning import robot_of
from cmbot.robot import MOST_FAR, NEAR, locate_meshes, parse_urdf, robot_files, sampled_postures
from cmbot.scene import Scene

FloatArray = NDArray[np.float64]


def body_of(scene: Scene) -> Multibody:
    """The bodies of a scene's robot."""
    robot = robot_of(scene)
    files = robot_files(
        **{name: value for name, value in scene.robot.files.items() if not name.endswith(("_frame", "_from"))}
    )
    urdf = parse_urdf(files.urdf, package_dirs=files.package_dirs)
    locate_meshes(files.urdf, urdf, files.package_dirs)
    near = Near(sampled_postures, NEAR, MOST_FAR)
    return read_multibody(scene, urdf, files.srdf, files.limits, robot.base_frame, robot.tool_frame, near)


def shapes_and_pairs(scene: Scene, body: Multibody) -> tuple[list[PlacedShape], list[tuple[int, int]]]:
    """Shapes of the robot and of the obstacles, and the pairs of them whose distances count."""
    shapes, pairs = list(body.shapes), list(body.pairs)
    moving = [k for k, one in enumerate(shapes) if one.joint > 0]
    for obstacle in scene.all_obstacles:
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
        case Mesh(path=path):
            for points in mesh_parts(path):
                X = np.eye(4)
                X[:3, 3], convex = hull(points)
                yield X, convex
