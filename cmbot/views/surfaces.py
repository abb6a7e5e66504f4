"""Every shape that is drawn, as a triangle mesh."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import coal
import numpy as np
import trimesh
from numpy.typing import NDArray

from cmbot.errors import ModelError
from cmbot.scene import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere
from cmbot.scene.shapes import load_mesh

__all__ = ["merged", "obstacle_surface", "simplified", "tube", "visual_surface"]

FloatArray = NDArray[np.float64]

CAPSULE_RINGS = (12, 24)
SPHERE_SUBDIVISIONS = 3
SMALLEST_CELL = 1e-4
"""Share of the largest extent, in `simplified`."""


def visual_surface(shape: Any, source: str) -> trimesh.Trimesh:
    """Return a robot's visual shape in the frame of the joint that carries it.

    Parameters
    ----------
    shape : pinocchio.GeometryObject
    source : str
        The URDF, to name in an error.

    Raises
    ------
    ModelError
        When it is no mesh, box, cylinder, capsule, cone, sphere or ellipsoid.
    """
    mesh = _coal_surface(shape, source)
    mesh.apply_transform(shape.placement.homogeneous)
    return mesh


def obstacle_surface(obstacle: Obstacle) -> trimesh.Trimesh:
    """Return an obstacle in W.

    Raises
    ------
    SceneError
        When its mesh file has become unreadable since the scene was read.
    """
    mesh = trimesh.Trimesh()
    match obstacle.shape:
        case Box(size=size):
            mesh = trimesh.creation.box(size)
        case Cylinder(radius=radius, length=length):
            mesh = trimesh.creation.cylinder(radius, length)
        case Capsule(radius=radius, length=length):
            mesh = trimesh.creation.capsule(height=length, radius=radius, count=CAPSULE_RINGS)
        case Sphere(radius=radius):
            mesh = trimesh.creation.icosphere(SPHERE_SUBDIVISIONS, radius)
        case Mesh(path=path):
            mesh = load_mesh(path, obstacle.name)
    mesh.apply_transform(obstacle.X_WO)
    return mesh


def tube(points: FloatArray, radius: float) -> trimesh.Trimesh:
    """Return a tube through `points` (N, 3), m, with a ball at each."""
    pieces = [trimesh.creation.cylinder(radius, segment=segment, sections=12) for segment in pairwise(points)]
    for point in points:
        ball = trimesh.creation.icosphere(2, 1.6 * radius)
        ball.apply_translation(point)
        pieces.append(ball)
    return merged(pieces)


def merged(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Return several meshes as one, none of their vertices joined."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return trimesh.Trimesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
        process=False,
    )


def simplified(meshes: Sequence[trimesh.Trimesh], most_faces: int) -> list[trimesh.Trimesh]:
    """Return the meshes with at most `most_faces` triangles in all; unchanged when they have no more.

    Vertices in one cell of a grid become one (Rossignac and Borrel 1993); the cell grows until it suffices.
    """
    coarse = list(meshes)
    if sum(len(mesh.faces) for mesh in meshes) <= most_faces:
        return coarse
    # A cell of this size keeps about two triangles.
    cell = np.sqrt(sum(mesh.area for mesh in meshes) / most_faces)
    cell = max(cell, SMALLEST_CELL * max(mesh.extents.max() for mesh in meshes if len(mesh.faces)))
    while sum(len(mesh.faces) for mesh in coarse) > most_faces:
        coarse = [_clustered(mesh, cell) for mesh in meshes]
        cell *= 1.2
    return coarse


def _clustered(mesh: trimesh.Trimesh, cell: float) -> trimesh.Trimesh:
    _, cluster = np.unique(np.floor(mesh.vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    cluster = cluster.ravel()
    members = np.bincount(cluster)
    centres = np.stack([np.bincount(cluster, axis) / members for axis in mesh.vertices.T], axis=1)
    faces = cluster[mesh.faces]
    collapsed = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    _, first = np.unique(np.sort(faces[~collapsed], axis=1), axis=0, return_index=True)
    return trimesh.Trimesh(centres, faces[~collapsed][np.sort(first)])


def _coal_surface(shape: Any, source: str) -> trimesh.Trimesh:
    geometry, mesh = shape.geometry, trimesh.Trimesh()
    match geometry:
        case coal.BVHModelBase():
            mesh = _mesh_surface(shape)
        case coal.ConvexBase():
            mesh = trimesh.Trimesh([geometry.point(i) for i in range(geometry.num_points)]).convex_hull
        case coal.Box():
            mesh = trimesh.creation.box(2 * geometry.halfSide)
        case coal.Cylinder():
            mesh = trimesh.creation.cylinder(geometry.radius, 2 * geometry.halfLength)
        case coal.Capsule():
            length = 2 * geometry.halfLength
            mesh = trimesh.creation.capsule(height=length, radius=geometry.radius, count=CAPSULE_RINGS)
        case coal.Cone():
            mesh = trimesh.creation.cone(geometry.radius, 2 * geometry.halfLength)
            mesh.apply_translation([0.0, 0.0, -geometry.halfLength])
        case coal.Sphere():
            mesh = trimesh.creation.icosphere(SPHERE_SUBDIVISIONS, geometry.radius)
        case coal.Ellipsoid():
            mesh = trimesh.creation.icosphere(SPHERE_SUBDIVISIONS)
            mesh.apply_scale(geometry.radii)
        case _:
            expected = "a mesh, box, cylinder, capsule, cone, sphere or ellipsoid"
            raise ModelError(source, f"visual {shape.name}", type(geometry).__name__, expected)
    return mesh


def _mesh_surface(shape: Any) -> trimesh.Trimesh:
    """Read the mesh at its present scale: another tool length leaves the one in memory as it was."""
    try:
        mesh = coal.MeshLoader().load(shape.meshPath, shape.meshScale)
    except (ValueError, RuntimeError):
        mesh = shape.geometry  # the file is gone; what was first read from it is still good to see
    triangles = (mesh.tri_indices(i) for i in range(mesh.num_tris))
    return trimesh.Trimesh(mesh.vertices(), [(t[0], t[1], t[2]) for t in triangles])
