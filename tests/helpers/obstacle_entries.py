"""Scenes with obstacles that are given in SI units: as entries of their files."""

from collections.abc import Iterable
from typing import Any

from scipy.spatial.transform import Rotation

from cmbot.collision import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere
from cmbot.scene import Scene


def entry_of(obstacle: Obstacle) -> dict[str, Any]:
    """What a scene file has of an obstacle."""
    X, shape = obstacle.X_WO, obstacle.shape
    match shape:
        case Box(size=size):
            of_shape: dict[str, Any] = {"box": size}
        case Cylinder(radius=radius, length=length):
            of_shape = {"cylinder": (radius, length)}
        case Capsule(radius=radius, length=length):
            of_shape = {"capsule": (radius, length)}
        case Sphere(radius=radius):
            of_shape = {"sphere": radius}
        case Mesh(path=path):
            of_shape = {"mesh": str(path)}
    rpy_deg = Rotation.from_matrix(X[:3, :3]).as_euler("xyz", degrees=True)
    place = {"xyz": X[:3, 3], "rpy_deg": rpy_deg, "workpiece": obstacle.workpiece}
    return {"name": obstacle.name, **of_shape, **place}


def with_obstacles(scene: Scene, *obstacles: Obstacle) -> Scene:
    """The scene with more obstacles."""
    return scene.changed(obstacles=(*scene.obstacles, *map(entry_of, obstacles)))


def renamed(scene: Scene, name: str, obstacle: Iterable[str] = ()) -> Scene:
    """The scene with names that no file may have, put past its checks: pages are safe whatever they are."""
    other = scene.with_source(scene.source)
    named = zip(scene.obstacles, obstacle, strict=False)
    entries = []
    for entry, text in named:
        entries.append(entry.changed())
        entries[-1].__dict__["name"] = text
    other.__dict__.update(name=name, obstacles=tuple(entries))
    return other
