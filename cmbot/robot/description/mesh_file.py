"""Mesh files of a URDF: where they lie, and what is checked before another library reads them."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np

from cmbot.common.errors import ModelError
from cmbot.common.input_files import LARGEST_MESH, read_input, require_input
from cmbot.common.validation import shown
from cmbot.robot.description.packages import find_resource

__all__ = ["FARTHEST", "load_near_meshes", "locate_meshes"]

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


def load_near_meshes(root: ElementTree.Element, tag: str, source: str) -> Any:
    """Return the loader that holds the meshes of a URDF's shapes `tag`, ``collision`` or ``visual``.

    They are located before. Meshes that coal cannot read or whose vertices are too far away are refused.
    The loader builds boxes along the axes: building coal's usual bounding volumes crashes the process with
    such vertices.
    """
    loader = coal.CachedMeshLoader(coal.NODE_TYPE.BV_AABB)  # a file is often that of several shapes
    for link in root.findall("link"):
        for mesh in (mesh for shape in link.findall(tag) for mesh in shape.iter("mesh")):
            path, scale = mesh.get("filename", ""), mesh.get("scale", "1 1 1")
            key, name = f"link[{link.get('name')}].mesh.filename", shown(Path(path).name)
            try:
                shape = loader.load(path, np.array(scale.split(), dtype=float))
            except (ValueError, RuntimeError, IndexError) as error:
                got = f"{name}, which coal cannot read ({' '.join(str(error).split())})"
                raise ModelError(source, key, got, "a mesh file") from error
            shape.computeLocalAABB()
            corners = np.array([shape.aabb_local.min_, shape.aabb_local.max_])
            if not (np.abs(corners) <= FARTHEST).all():
                got = f"{name}, which is larger or not finite"
                raise ModelError(source, key, got, f"a mesh of vertices within {FARTHEST:g} m")
    return loader


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
