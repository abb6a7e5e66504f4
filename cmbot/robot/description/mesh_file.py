"""Mesh files of a URDF: where they lie, and what is checked before another library reads them."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import ModelError
from cmbot.common.input_files import LARGEST_MESH, read_input, require_input
from cmbot.common.validation import shown
from cmbot.robot.description.packages import find_resource

__all__ = [
    "FARTHEST",
    "faces_of",
    "is_mesh",
    "is_near",
    "locate_meshes",
    "mesh_loader",
    "require_near_meshes",
    "vertices_of",
]

FARTHEST = 1e4
"""Largest distance, m, of a point or a frame from the origin that it is given in."""

# Files that a mesh of this format names are opened with it, so they are checked, too.
_LIBRARIES = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]+)", re.MULTILINE)
# It names further files of any kind.
_REFUSED_FORMATS = (".gltf",)


def locate_meshes(urdf: Path, root: ElementTree.Element, package_dirs: Sequence[Path] = ()) -> None:
    """Give every mesh of a URDF the absolute path of its file, in place.

    A path is relative to the URDF; ``package://`` to a package in one of `package_dirs`, beside the URDF or
    above it, or one that ROS knows.

    Raises
    ------
    ModelError
        When a file is missing, no regular file, empty or too large.
    """
    folder, checked = urdf.resolve().parent, dict[str, str]()
    for link in root.findall("link"):
        for mesh in link.iter("mesh"):
            name = mesh.get("filename", "")
            if name not in checked:
                path = _located(name, folder, package_dirs)
                try:
                    _require_mesh(path)
                except ModelError as error:
                    key = f"link[{link.get('name')}].mesh.filename"
                    sought = (
                        path if path.is_absolute() else "any package beside or above it or in package_dirs"
                    )
                    got = f"{shown(name)}, {error.got} ({sought})"
                    raise ModelError(str(urdf), key, got, error.expected) from error
                checked[name] = str(path)
            mesh.set("filename", checked[name])


def mesh_loader(root: ElementTree.Element | None = None) -> Any:
    """Return a loader of meshes that builds boxes along the axes.

    Building coal's usual bounding volumes takes longer than reading, and crashes the process with vertices
    that are far away. For the content of a URDF, whose meshes are located, it is the same one each time,
    which keeps what it has read, until one of these files changes.
    """
    if root is None:
        return coal.CachedMeshLoader(coal.NODE_TYPE.BV_AABB)
    return _kept(tuple(_stamp(mesh.get("filename", "")) for mesh in root.iter("mesh")))


# A campaign's process loads one robot again and again.
@lru_cache(maxsize=2)
def _kept(stamps: tuple[tuple[str, int, int], ...]) -> Any:
    del stamps
    return mesh_loader()


def _stamp(name: str) -> tuple[str, int, int]:
    """What changes with a file."""
    with suppress(OSError):  # gone since it was located: the loader says so
        found = os.stat(name)  # noqa: PTH116  Path takes as long as all else here
        return name, found.st_mtime_ns, found.st_size
    return name, 0, 0


def is_mesh(geometry: Any) -> bool:
    """Return whether a shape is a mesh; Python knows those of `mesh_loader` as some shape only."""
    return bool(geometry.getObjectType() == coal.OT_BVH)


def vertices_of(mesh: Any) -> FloatArray:
    """Return the vertices (n, 3) of a mesh, m."""
    return np.array(coal.BVHModelBase.vertices(mesh))


def faces_of(mesh: Any) -> IntArray:
    """Return the triangles (m, 3) of a mesh."""
    count, corners = coal.BVHModelBase.num_tris.__get__(mesh), coal.BVHModelBase.tri_indices
    triangles = (corners(mesh, k) for k in range(count))
    return np.array([(t[0], t[1], t[2]) for t in triangles], dtype=np.intp).reshape(-1, 3)


def is_near(shape: Any) -> bool:
    """Return whether a shape is finite and lies within `FARTHEST` of its origin."""
    shape.computeLocalAABB()
    corners = np.array([shape.aabb_local.min_, shape.aabb_local.max_])
    return bool((np.abs(corners) <= FARTHEST).all())


def require_near_meshes(root: ElementTree.Element, tag: str, source: str) -> None:
    """Refuse the meshes of a URDF's shapes `tag`, ``collision`` or ``visual``, that cannot be used.

    They are located before. Those are refused that coal cannot read, or whose vertices are too far away.
    """
    loader = mesh_loader()
    for link in root.findall("link"):
        for mesh in (mesh for shape in link.findall(tag) for mesh in shape.iter("mesh")):
            path, scale = mesh.get("filename", ""), mesh.get("scale", "1 1 1")
            key, name = f"link[{link.get('name')}].mesh.filename", shown(Path(path).name)
            try:
                shape = loader.load(path, np.array(scale.split(), dtype=float))
            except (ValueError, RuntimeError, IndexError) as error:
                got = f"{name}, which coal cannot read ({' '.join(str(error).split())})"
                raise ModelError(source, key, got, "a mesh file") from error
            if not is_near(shape):
                got = f"{name}, which is larger or not finite"
                raise ModelError(source, key, got, f"a mesh of vertices within {FARTHEST:g} m")


def _located(name: str, folder: Path, package_dirs: Sequence[Path]) -> Path:
    scheme, found, rest = name.partition("://")
    if not found:
        return (folder / name).resolve()
    if scheme == "file":
        return Path(rest)
    if scheme in ("package", "model"):
        return find_resource(rest, folder, package_dirs) or Path(name)
    return Path(name)


def _require_mesh(path: Path) -> None:
    suffix = path.suffix.lower()
    if suffix in _REFUSED_FORMATS:
        raise ModelError(str(path), "", f"a {suffix} file", "a mesh in a file of its own, such as STL")
    require_input(path, ModelError, kind="a mesh file", largest=LARGEST_MESH)
    if suffix == ".obj":
        for match in _LIBRARIES.finditer(read_input(path, ModelError, largest=LARGEST_MESH)):
            library = path.parent / os.fsdecode(match[1].strip())
            if os.path.exists(library):  # noqa: PTH110  as above
                read_input(library, ModelError, kind="a file of materials")
