"""Mesh files of a URDF: where they lie, and what is checked before another library reads them."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np

from cmbot.common.errors import ModelError
from cmbot.common.input_files import LARGEST_MESH, read_input, require_input
from cmbot.common.validation import shown

__all__ = ["FARTHEST", "locate_meshes", "require_near"]

FARTHEST = 1e4
"""Largest distance, m, of a point or a frame from the origin that it is given in."""

# Files that a mesh of this format names are opened with it, so they are checked, too.
_LIBRARIES = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]+)", re.MULTILINE)
# It names further files of any kind.
_REFUSED_FORMATS = (".gltf",)


def locate_meshes(urdf: Path, root: ElementTree.Element) -> None:
    """Give every mesh of a URDF the absolute path of its file, in place.

    A path is relative to the URDF; ``package://`` to a folder above it, or one that ROS knows.

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
                path = _located(name, folder)
                try:
                    _require_mesh(path)
                except ModelError as error:
                    key = f"link[{link.get('name')}].mesh.filename"
                    raise ModelError(str(urdf), key, f"{shown(name)}, {error.got}", error.expected) from error
                checked[name] = str(path)
            mesh.set("filename", checked[name])


def require_near(root: ElementTree.Element, source: str) -> None:
    """Refuse meshes of a URDF, located before, whose vertices are not finite or too far away.

    Building the bounding volumes that pinocchio asks coal for crashes the process with such vertices; that of
    boxes along the axes does not.
    """
    loader = coal.CachedMeshLoader(coal.NODE_TYPE.BV_AABB)
    for link in root.findall("link"):
        for mesh in link.iter("mesh"):
            path, scale = mesh.get("filename", ""), mesh.get("scale", "1 1 1")
            try:
                shape = loader.load(path, np.ones(3))
            except (ValueError, RuntimeError, IndexError):  # pinocchio says why
                continue
            shape.computeLocalAABB()
            corners = np.array([shape.aabb_local.min_, shape.aabb_local.max_])
            if not (np.abs(corners * np.array(scale.split(), dtype=float)) <= FARTHEST).all():
                key = f"link[{link.get('name')}].mesh.filename"
                got = f"{shown(Path(path).name)}, which is larger or not finite"
                raise ModelError(source, key, got, f"a mesh of vertices within {FARTHEST:g} m")


def _located(name: str, folder: Path) -> Path:
    scheme, found, rest = name.partition("://")
    if not found:
        return (folder / name).resolve()
    if scheme == "file":
        return Path(rest)
    if scheme in ("package", "model"):
        for above in _packages(folder):
            path = above / rest.lstrip("/")
            if os.path.exists(path):  # noqa: PTH110  Path.exists raises for names that no file can have
                return path
    return Path(name)


def _packages(folder: Path) -> Iterator[Path]:
    """Folders of packages: those above the URDF's, then ROS's."""
    yield from folder.parents
    for variable, below in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for place in os.environ.get(variable, "").split(os.pathsep):
            if place:
                yield Path(place) / below


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
