"""Where a path is described: the frames of its poses, and the surfaces of its rasters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.validation import shown
from cmbot.scene.mesh_file import load_mesh
from cmbot.scene.obstacles import Mesh, Obstacle
from cmbot.scene.path.path_file import PathFile
from cmbot.scene.raster.face_rows import FaceSurface
from cmbot.scene.raster.surface import PlainSurface, Surface


@dataclass(frozen=True, kw_only=True, eq=False)
class PathSource:
    """Where a path is described, and the frames in which its poses are.

    Attributes
    ----------
    source, key : str
        The scene's, and the path's in it, for messages.
    frames : mapping of str to (4, 4)
        Poses in W of the frames that the scene names.
    obstacles : sequence of Obstacle
        The scene's, of which rasters name meshes.
    max_speed : float or None
        Of the tool point, m/s: seconds that are to be found begin slower.
    """

    source: str
    key: str
    frames: Mapping[str, FloatArray]
    obstacles: Sequence[Obstacle] = ()
    max_speed: float | None = None

    def frame(self, name: str, key: str, X_WT: FloatArray) -> FloatArray:
        """Return the pose (4, 4) in W of the frame that `key` names; ``tool`` is `X_WT`.

        Raises
        ------
        SceneError
            When there is no such frame.
        """
        frames = {"world": np.eye(4), "tool": X_WT, **self.frames}
        if name not in frames:
            raise SceneError(self.source, f"{key}.frame", shown(name), "a frame of the scene", tuple(frames))
        return frames[name]


def surface_of(file: PathFile, place: PathSource, X_WT: FloatArray) -> Surface | None:
    """Return the surface that a path's raster is over; None where it has none.

    Parameters
    ----------
    file : PathFile
    place : PathSource
    X_WT : (4, 4)
        Pose of the tool before.

    Raises
    ------
    SceneError
        When the raster's frame or mesh is not known, or the mesh has no such faces.
    MissingExtra
        When it is over faces of a mesh, and shapely is not installed.
    """
    raster = file.raster
    if raster is None:
        return None
    key = f"{place.key}.raster"
    X_WF = place.frame(raster.frame, key, X_WT)
    if raster.faces is None:
        return PlainSurface(raster)
    each = place.obstacles
    meshes = {one.name: (one.shape, one.X_WO) for one in each if isinstance(one.shape, Mesh)}
    own = raster.mesh_file
    if own is None and raster.mesh not in meshes:
        expected = "the name of an obstacle that is a mesh, or the path of a mesh file"
        raise SceneError(place.source, f"{key}.mesh", shown(raster.mesh), expected, tuple(meshes))
    shape, X_WM = (Mesh(path=own), X_WF) if own is not None else meshes[str(raster.mesh)]

    def refusal(name: str, got: str, expected: str) -> SceneError:
        return SceneError(place.source, f"{key}.{name}", got, expected)

    named = "" if own is None else f"{key}.mesh"
    mesh = load_mesh(shape.path, str(raster.mesh), key=named, scale=shape.scale)
    return FaceSurface.of(raster, raster.faces, mesh, X_WM, X_WF, refusal)
