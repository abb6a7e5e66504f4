"""From an obstacle's shape to coal's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import trimesh

from cmbot.errors import SceneError
from cmbot.scene.obstacles import Box, Capsule, Cylinder, Mesh, Shape, Sphere

__all__ = ["coal_shapes", "load_mesh"]


def coal_shapes(shape: Shape, name: str) -> list[tuple[Any, Any]]:
    """Return the convex coal shapes that cover `shape`, with their poses in its frame.

    Parameters
    ----------
    shape : Box, Cylinder, Capsule, Sphere or Mesh
        A mesh becomes the convex hull of each of its connected parts.
    name : str
        The obstacle's, to name in an error.

    Returns
    -------
    list of (coal shape, pinocchio.SE3)

    Raises
    ------
    SceneError
        When a mesh cannot be read or has no volume.
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
        case Mesh(path=path):
            return [(_hull(part), pin.SE3.Identity()) for part in load_mesh(path, name).split(only_watertight=False)]
    return [(geometry, pin.SE3.Identity())]


def load_mesh(path: Path, name: str) -> trimesh.Trimesh:
    """Load an obstacle's mesh file (any format that trimesh reads), in metres.

    Raises
    ------
    SceneError
        When it cannot be read or has no volume.
    """
    try:
        mesh = trimesh.load_mesh(path)
    except (OSError, ValueError, KeyError, IndexError, TypeError, NotImplementedError) as error:
        raise SceneError(str(path), f"obstacles[{name}].mesh", f"unreadable ({error})", "a mesh file") from error
    extents = getattr(mesh, "extents", None)
    if extents is None or not np.isfinite(extents).all() or np.min(extents) <= 0:
        raise SceneError(str(path), f"obstacles[{name}].mesh", "no volume", "a mesh with three dimensions")
    return mesh


def _hull(mesh: trimesh.Trimesh) -> Any:
    points = coal.StdVec_Vec3s()
    for vertex in mesh.convex_hull.vertices:
        points.append(np.array(vertex, dtype=float))
    return coal.Convex.convexHull(points, True, "Qt")
