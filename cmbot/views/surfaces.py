"""Every shape that is drawn, as triangles."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import coal
import numpy as np

from cmbot.collision.shapes import load_mesh
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import ModelError
from cmbot.scene import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere
from cmbot.views.solids import Surface, ball, box, capsule, cone, cylinder, hull

__all__ = ["merged", "obstacle_surface", "simplified", "tube", "visual_surface"]

TUBE_SECTIONS = 12
"""About the axis of a tube, thin as it is."""

SMALLEST_CELL = 1e-4
"""Share of the largest extent, in `simplified`."""


def visual_surface(shape: Any, source: str) -> Surface:
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
    return _coal_surface(shape, source).moved(shape.placement.homogeneous)


def obstacle_surface(obstacle: Obstacle) -> Surface:
    """Return an obstacle in W.

    Raises
    ------
    SceneError
        When its mesh file has become unreadable since the scene was read.
    """
    match obstacle.shape:
        case Box(size=size):
            surface = box(np.asarray(size))
        case Cylinder(radius=radius, length=length):
            surface = cylinder(radius, length)
        case Capsule(radius=radius, length=length):
            surface = capsule(radius, length)
        case Sphere(radius=radius):
            surface = ball(radius)
        case Mesh(path=path):
            mesh = load_mesh(path, obstacle.name)
            surface = Surface(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.intp))
    return surface.moved(obstacle.X_WO)


def tube(points: FloatArray, radius: float) -> Surface:
    """Return a tube through `points` (N, 3), m, with a ball at each."""
    pieces = []
    for start, end in pairwise(points):
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = _turned_to(end - start), 0.5 * (start + end)
        length = float(np.linalg.norm(end - start))
        pieces.append(cylinder(radius, length, sections=TUBE_SECTIONS).moved(X))
    joint = ball(1.6 * radius, sections=TUBE_SECTIONS, rings=TUBE_SECTIONS)
    return merged([*pieces, *(Surface(joint.vertices + point, joint.faces) for point in points)])


def merged(surfaces: Sequence[Surface]) -> Surface:
    """Return several surfaces as one, none of their vertices joined."""
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces[:-1])])
    return Surface(
        np.concatenate([surface.vertices for surface in surfaces]),
        np.concatenate([surface.faces + start for surface, start in zip(surfaces, starts, strict=True)]),
    )


def simplified(surfaces: Sequence[Surface], most_faces: int) -> list[Surface]:
    """Return the surfaces with at most `most_faces` triangles in all; unchanged when they have no more.

    Vertices in one cell of a grid become one (Rossignac and Borrel 1993); the cell grows until it suffices.
    """
    coarse = list(surfaces)
    if sum(len(surface.faces) for surface in surfaces) <= most_faces:
        return coarse
    # A cell of this size keeps about two triangles.
    cell = np.sqrt(sum(surface.area for surface in surfaces) / most_faces)
    extents = [np.ptp(surface.vertices, axis=0).max() for surface in surfaces if len(surface.faces)]
    cell = max(cell, SMALLEST_CELL * max(extents))
    while sum(len(surface.faces) for surface in coarse) > most_faces:
        coarse = [_clustered(surface, cell) for surface in surfaces]
        cell *= 1.2
    return coarse


def _clustered(surface: Surface, cell: float) -> Surface:
    _, cluster = np.unique(np.floor(surface.vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    cluster = cluster.ravel()
    members = np.bincount(cluster)
    centres = np.stack([np.bincount(cluster, axis) / members for axis in surface.vertices.T], axis=1)
    faces = cluster[surface.faces]
    collapsed = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    _, first = np.unique(np.sort(faces[~collapsed], axis=1), axis=0, return_index=True)
    return Surface(centres, faces[~collapsed][np.sort(first)])


def _turned_to(direction: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that takes z along `direction` (3,)."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _coal_surface(shape: Any, source: str) -> Surface:
    geometry = shape.geometry
    match geometry:
        case coal.BVHModelBase():
            return Surface(geometry.vertices(), _triangles(geometry))
        case coal.ConvexBase():
            return hull(np.array([geometry.point(i) for i in range(geometry.num_points)]))
        case coal.Box():
            return box(2 * geometry.halfSide)
        case coal.Cylinder():
            return cylinder(geometry.radius, 2 * geometry.halfLength)
        case coal.Capsule():
            return capsule(geometry.radius, 2 * geometry.halfLength)
        case coal.Cone():
            return cone(geometry.radius, 2 * geometry.halfLength)
        case coal.Sphere():
            return ball(geometry.radius)
        case coal.Ellipsoid():
            unit = ball(1.0)
            return Surface(unit.vertices * geometry.radii, unit.faces)
    expected = "a mesh, box, cylinder, capsule, cone, sphere or ellipsoid"
    raise ModelError(source, f"visual {shape.name}", type(geometry).__name__, expected)


def _triangles(mesh: Any) -> IntArray:
    triangles = (mesh.tri_indices(i) for i in range(mesh.num_tris))
    return np.array([(t[0], t[1], t[2]) for t in triangles], dtype=np.intp).reshape(-1, 3)
