"""Convex hulls of meshes, and what a body of even density in the shapes of a link weighs.

With this module imported hulls, and models that have some, can be pickled, which neither coal nor Pinocchio
does by itself: so can robots and plans.
"""

from __future__ import annotations

import copyreg
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from io import BytesIO
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ModelError
from cmbot.robot.description.mesh_file import read_vertices

# Smallest thickness of points relative to their extent. At about 3e-8 coal's hull crashes the process.
_MIN_THICKNESS_SHARE = 1e-5
# What a flat mesh gets, m.
_FLAT_MESH_THICKNESS_M = 1e-3


def encloses_volume(points: FloatArray) -> bool:
    """Return whether the hull of `points` (N, 3) has a volume, in any orientation."""
    if len(points) < 4 or not np.isfinite(points).all():
        return False
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[2] > _MIN_THICKNESS_SHARE * extents[0])


def convex_hull(points: FloatArray) -> coal.ConvexBase:
    """Return the convex hull of `points` (N, 3); they have to enclose a volume."""
    vertices = coal.StdVec_Vec3s()
    vertices.extend(np.asarray(points, dtype=float))
    return coal.Convex.convexHull(vertices, False, "Qt")


def solid_points(points: FloatArray) -> FloatArray:
    """Return finite points (M, 3) whose hull has a volume and all `points` (N, 3).

    Those that enclose none are moved by half a millimetre to either side, across the plane, the line or the
    point in which they lie.
    """
    if encloses_volume(points):
        return points
    middle = points.mean(axis=0)
    _, extents, axes = np.linalg.svd(np.vstack([points - middle, np.zeros((3, 3))]), full_matrices=False)
    for axis, extent in zip(axes, extents, strict=True):
        if extent <= _MIN_THICKNESS_SHARE * extents[0]:
            half = 0.5 * _FLAT_MESH_THICKNESS_M * axis
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
    # They take a while to come, and few robots need them.
    import trimesh
    from yourdfpy import URDF, filename_handler_null

    robot = ElementTree.Element("robot", name="body")
    robot.append(deepcopy(link))
    for shape in [*robot.findall("*/collision"), *robot.findall("*/visual")]:
        # What the loader cannot read is drawn as a box, and refused where it may collide.
        if any(not len(read_vertices(mesh)) for mesh in shape.iter("mesh")):
            robot[0].remove(shape)
    # As one mesh a link would have one hull.
    read = {"load_collision_meshes": True, "build_collision_scene_graph": True, "force_collision_mesh": False}
    file = BytesIO(ElementTree.tostring(robot))
    # The names of meshes are those of the files that the loader has found.
    try:
        described = URDF.load(file, filename_handler=filename_handler_null, **read)
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        got = f"a mesh that trimesh cannot read ({' '.join(str(error).split())})"
        raise ModelError(link.get("name", ""), "mesh", got, "a mesh file") from error
    for scene in (described.collision_scene, described.scene):
        solids = list(_solids(scene))
        solid: Any = trimesh.util.concatenate(solids) if solids else None
        if solids and solid.volume > 0:
            return Body(
                volume=float(solid.volume),
                centre=np.array(solid.center_mass),
                inertia=np.array(solid.moment_inertia),
            )
    return None


def _solids(scene: Any) -> Iterator[Any]:
    """Yield the shapes of a scene in its link's frame: solids as they are, meshes as their convex hulls."""
    import trimesh

    for node in scene.graph.nodes_geometry:
        X, name = scene.graph[node]
        shape = scene.geometry[name].copy()
        if not isinstance(shape, trimesh.primitives.Primitive):
            points = np.asarray(shape.vertices)
            if not (len(points) and np.isfinite(points).all()):
                continue
            shape = trimesh.convex.convex_hull(solid_points(points))
        yield trimesh.Trimesh(shape.vertices, shape.faces).apply_transform(X)


def _hull(points: FloatArray, radius: float) -> coal.ConvexBase:
    hull = convex_hull(points)
    hull.setSweptSphereRadius(radius)
    return hull


def _reduced_hull(hull: coal.ConvexBase) -> tuple[Any, ...]:
    return _hull, (np.array([hull.point(k) for k in range(hull.num_points)]), hull.getSweptSphereRadius())


def _model(shapes: list[tuple[Any, ...]], pairs: list[tuple[int, int]]) -> pin.GeometryModel:
    made = pin.GeometryModel()
    for *parts, disabled in shapes:
        shape = pin.GeometryObject(*parts)
        shape.disableCollision = disabled
        made.addGeometryObject(shape)
    for pair in pairs:
        made.addCollisionPair(pin.CollisionPair(*pair))
    return made


def _reduced_model(model: pin.GeometryModel) -> tuple[Any, ...]:
    shapes = [
        (
            each.name,
            each.parentJoint,
            each.parentFrame,
            each.placement,
            each.geometry,
            each.meshPath,
            each.meshScale,
            each.overrideMaterial,
            each.meshColor,
            each.disableCollision,
        )
        for each in model.geometryObjects
    ]
    return _model, (shapes, [(pair.first, pair.second) for pair in model.collisionPairs])


copyreg.pickle(coal.ConvexBase, _reduced_hull)
copyreg.pickle(pin.GeometryModel, _reduced_model)
