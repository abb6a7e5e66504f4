"""From an obstacle's shape to coal's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import pinocchio as pin

from cmbot.common.errors import SceneError
from cmbot.robot.hulls import convex_hull, encloses_volume
from cmbot.scene import Box, Capsule, Cylinder, Mesh, Shape, Sphere

if TYPE_CHECKING:
    import trimesh

__all__ = ["coal_shapes", "load_mesh"]

# What trimesh reads without further packages.
_FORMATS = ("glb", "obj", "off", "ply", "stl")
# What its readers let through when a file is damaged.
_DAMAGED = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    NameError,
    ArithmeticError,
    NotImplementedError,
)


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
        When a mesh cannot be read, or a connected part of it has no volume.
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
            parts = load_mesh(path, name).split(only_watertight=False)
            return [(_hull(part, path, name), pin.SE3.Identity()) for part in parts]
    return [(geometry, pin.SE3.Identity())]


def load_mesh(path: Path, name: str) -> trimesh.Trimesh:
    """Load an obstacle's mesh file (GLB, OBJ, OFF, PLY or STL), in metres, without its colours.

    Vertices that only differ in colour or normal become one: they would take the mesh apart.

    Raises
    ------
    SceneError
        When it cannot be read or has no volume.
    """
    key = f"obstacles[{name}].mesh"
    if path.suffix.lower().removeprefix(".") not in _FORMATS:
        raise SceneError(str(path), key, f"the format {path.suffix!r}", "a mesh file", _FORMATS)
    # It takes a while to come, and few scenes have a mesh.
    import trimesh

    try:
        mesh = trimesh.load_mesh(path)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
    except _DAMAGED as error:
        raise SceneError(str(path), key, f"unreadable ({error})", "a mesh file") from error
    if len(mesh.faces) == 0 or not encloses_volume(np.asarray(mesh.vertices)):
        raise SceneError(str(path), key, "no volume", "a mesh with three dimensions")
    return mesh


def _hull(part: trimesh.Trimesh, path: Path, name: str) -> Any:
    vertices = np.asarray(part.vertices)
    if not encloses_volume(vertices):
        got = f"a connected part without volume near {np.round(vertices.mean(axis=0), 3).tolist()}"
        raise SceneError(str(path), f"obstacles[{name}].mesh", got, "parts with three dimensions each")
    return convex_hull(vertices)
