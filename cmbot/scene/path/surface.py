"""The surfaces that rasters of a scene are over."""

from __future__ import annotations

from collections.abc import Sequence

from cmbot.collision import Mesh, Obstacle, load_mesh
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.reading.validation import shown
from cmbot.toolpath import FaceSurface, PathSource, PlainSurface, Raster, Surface


def surface_of(
    raster: Raster | None, place: PathSource, obstacles: Sequence[Obstacle], X_WT: FloatArray
) -> Surface | None:
    """Return the surface that a path's raster is over; None where it has none.

    Parameters
    ----------
    raster : Raster or None
    place : PathSource
    obstacles : sequence of Obstacle
        The scene's, of which rasters name meshes.
    X_WT : (4, 4)
        Pose of the tool before.

    Raises
    ------
    SceneError
        When the raster's frame or mesh is not known, or the mesh has no such faces.
    MissingExtra
        When it is over faces of a mesh, and shapely is not installed.
    """
    if raster is None:
        return None
    key = f"{place.key}.raster"
    X_WF = place.frame(raster.frame, key, X_WT)
    if raster.mesh is None:
        return PlainSurface(raster)
    meshes = {
        obstacle.name: (obstacle.shape, obstacle.X_WO)
        for obstacle in obstacles
        if isinstance(obstacle.shape, Mesh)
    }
    mesh_file = raster.mesh_file
    if mesh_file is None and raster.mesh not in meshes:
        expected = "the path of a mesh file"
        if not place.on_part:
            expected = f"the name of an obstacle that is a mesh, or {expected}"
        raise SceneError(place.source, f"{key}.mesh", shown(raster.mesh), expected, tuple(meshes))
    shape, X_WM = (Mesh(path=mesh_file), X_WF) if mesh_file is not None else meshes[str(raster.mesh)]

    def refusal(name: str, got: str, expected: str) -> SceneError:
        return SceneError(place.source, f"{key}.{name}", got, expected)

    named = "" if mesh_file is None else f"{key}.mesh"
    mesh = load_mesh(shape.path, str(raster.mesh), key=named, scale=shape.scale)
    return FaceSurface.of(raster, mesh, X_WM, X_WF, refusal)
