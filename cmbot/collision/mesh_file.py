"""The mesh file of an obstacle, or of a surface."""

from __future__ import annotations

import io
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cmbot.common.errors import SceneError
from cmbot.common.reading.fields import MESH_FORMATS
from cmbot.common.reading.input_files import LARGEST_MESH, read_input
from cmbot.common.reading.validation import shown

if TYPE_CHECKING:
    import trimesh

_MAX_COORDINATE_M = 1e4  # m, as of any coordinate in a scene
# Files that were read last and are kept: planning and pages ask for the same ones several times.
_CACHED_FILES = 8
# The errors that its readers raise when a file is damaged.
_READER_ERRORS = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    NameError,
    ArithmeticError,
    NotImplementedError,
)


def load_mesh(path: Path, name: str = "", *, key: str = "", scale: float = 1.0) -> trimesh.Trimesh:
    """Load an obstacle's mesh file (GLB, OBJ, OFF, PLY or STL) without its colours; in metres by `scale`.

    Errors name the obstacle of that `name`, or a `key` in its place. Vertices that only differ in colour or
    normal become one: they would take the mesh apart. Files of the same content give the same mesh, which is
    not to be changed.

    Raises
    ------
    SceneError
        When it cannot be read or has no volume.
    """
    key = key or f"obstacles[{name}].mesh"
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in MESH_FORMATS:
        raise SceneError(str(path), key, f"the format {path.suffix!r}", "a mesh file", MESH_FORMATS)
    content = read_input(path, SceneError, kind="a mesh file", key=key, largest=LARGEST_MESH)
    try:
        mesh = _parsed(content, suffix, scale)
        vertices = np.asarray(mesh.vertices, dtype=float)
    except _READER_ERRORS as error:
        raise SceneError(str(path), key, f"unreadable ({shown(str(error))})", "a mesh file") from error
    if vertices.shape[1:] != (3,):
        raise SceneError(str(path), key, f"vertices of shape {vertices.shape}", "three coordinates each")
    if not (np.abs(vertices) <= _MAX_COORDINATE_M).all():
        got, expected = "a mesh that is larger or not finite", f"vertices within {_MAX_COORDINATE_M:g} m"
        raise SceneError(str(path), key, got, expected)
    # It takes a while to come, and few scenes have a mesh.
    from cmbot.robot import encloses_volume

    if len(mesh.faces) == 0 or not encloses_volume(vertices):
        raise SceneError(str(path), key, "no volume", "a mesh with three dimensions")
    return mesh


@lru_cache(maxsize=_CACHED_FILES)
def _parsed(content: bytes, suffix: str, scale: float) -> trimesh.Trimesh:
    # It takes a while to come, too.
    import trimesh

    # As a stream: a file's reader would also open what it names, such as materials.
    with np.errstate(invalid="ignore"):  # vertices that are too far away are refused
        mesh = trimesh.load_mesh(io.BytesIO(content), file_type=suffix)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        if scale != 1.0:
            mesh.vertices *= scale
    return mesh
