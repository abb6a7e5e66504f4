"""Convex hulls of meshes, and what a body of even density in the shapes of a link weighs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.robot.description.mesh_file import read_vertices

# Smallest thickness of points relative to their extent. At about 3e-8 coal's hull crashes the process.
_FLAT = 1e-5
# What a flat mesh gets, m.
_THICKNESS = 1e-3


def encloses_volume(points: FloatArray) -> bool:
    """Return whether the hull of `points` (N, 3) has a volume, in any orientation."""
    if len(points) < 4 or not np.isfinite(points).all():
        return False
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[2] > _FLAT * extents[0])


def convex_hull(points: FloatArray) -> coal.ConvexBase:
    """Return the convex hull of `points` (N, 3); they have to enclose a volume."""
    vertices = coal.StdVec_Vec3s()
    vertices.extend(np.asarray(points, dtype=float))
    return coal.Convex.convexHull(vertices, False, "Qt")


def thickened(points: FloatArray) -> FloatArray:
    """Return finite `points` (N, 3) that enclose no volume, moved by half a millimetre to either side.

    They are moved across the plane, the line or the point in which they lie, so that their hull has all of
    them and a volume (M, 3).
    """
    middle = points.mean(axis=0)
    _, extents, axes = np.linalg.svd(np.vstack([points - middle, np.zeros((3, 3))]), full_matrices=False)
    for axis, extent in zip(axes, extents, strict=True):
        if extent <= _FLAT * extents[0]:
            half = 0.5 * _THICKNESS * axis
            points = np.concatenate([points - half, points + half])
    return points


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """A body of even density: its volume, its centre (3,), and its inertia about that (3, 3), of 1 kg/m3."""

    volume: float
    centre: FloatArray
    inertia: FloatArray


def body_of(link: ElementTree.Element) -> Body | None:
    """Return the body in the collision shapes of a link, else in its visual ones; None where it has none.

    Meshes, which have to be located before, count as their convex hulls, and what shapes share counts twice.
    """
    # It takes a while to come, and few robots need it.
    import trimesh

    for tag in ("collision", "visual"):
        solids = list(_solids(link.findall(tag)))
        solid: Any = trimesh.util.concatenate(solids) if solids else None
        if solids and solid.volume > 0:
            return Body(
                volume=float(solid.volume),
                centre=np.array(solid.center_mass),
                inertia=np.array(solid.moment_inertia),
            )
    return None


def _solids(shapes: list[ElementTree.Element]) -> Iterator[Any]:
    """Yield shapes of a link in its frame, as closed triangle meshes; without those that cannot be read."""
    import trimesh

    for shape in shapes:
        for part in shape.findall("geometry/*"):
            size, radius, length = (_numbers(part.get(name, "0")) for name in ("size", "radius", "length"))
            match part.tag:
                case "box":
                    solid = trimesh.creation.box(extents=size)
                case "cylinder":
                    solid = trimesh.creation.cylinder(radius=radius[0], height=length[0])
                case "sphere":
                    solid = trimesh.creation.icosphere(radius=radius[0])
                case _:
                    points = read_vertices(part)
                    if not (len(points) and np.isfinite(points).all()):
                        continue
                    points = points if encloses_volume(points) else thickened(points)
                    solid = trimesh.convex.convex_hull(points)
            origin = shape.find("origin")
            at = {} if origin is None else origin.attrib
            xyz, rpy = (_numbers(at.get(name, "0 0 0")) for name in ("xyz", "rpy"))
            X = np.eye(4)
            X[:3, :3], X[:3, 3] = pin.rpy.rpyToMatrix(rpy), xyz
            yield solid.apply_transform(X)


def _numbers(text: str) -> FloatArray:
    return np.array(text.split(), dtype=float)
