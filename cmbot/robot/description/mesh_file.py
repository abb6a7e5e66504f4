"""Mesh files of a URDF: where they lie, and what is checked before another library reads them.

Collision meshes that cannot be used are refused. Visual ones only matter to who looks: a box is drawn.

Convex hulls of meshes, and what a body of even density in the shapes of a link weighs.

With this module imported hulls, and models that have some, can be pickled, which neither coal nor Pinocchio
does by itself: so can robots and plans.
"""

from __future__ import annotations

import copyreg
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache, partial
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import ModelError
from cmbot.common.reading.input_files import LARGEST_MESH, is_file, read_input, require_input
from cmbot.common.reading.validation import shown
from cmbot.robot.description.packages import find_copy, find_resource

FARTHEST = 1e4
"""Largest distance, m, of a point or a frame from the origin that it is given in."""

# Files that a mesh of this format names are opened with it, so they are checked, too.
_MATERIAL_LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]+)", re.MULTILINE)
_LFS_POINTER = b"version https://git-lfs"
# It names further files of any kind.
_REFUSED_FORMATS = (".gltf",)
# Edges, m, of a box in place of a visual mesh: at least, and where the link has no collision shape either.
_THINNEST, _BOX_EDGE_M = 1e-3, 0.05
# Smallest thickness of points relative to their extent. At about 3e-8 coal's hull crashes the process.
_MIN_THICKNESS_SHARE = 1e-5
# What a flat mesh gets, m.
_FLAT_MESH_THICKNESS_M = 1e-3


def locate_meshes(
    urdf: Path, root: ElementTree.Element, package_dirs: Sequence[Path] = ()
) -> tuple[tuple[str, str], ...]:
    """Give every mesh of a URDF the absolute path of its file, in place.

    A path is relative to the URDF; ``package://`` to a package in one of `package_dirs`, beside the URDF or
    above it, or one that ROS knows. A visual mesh whose file is missing, no regular file, empty or too large
    becomes a box, as `replace_unreadable` has it.

    Returns
    -------
    tuple of (str, str)
        Key of each visual mesh that became a box, and what is the matter with it.

    Raises
    ------
    ModelError
        When a collision mesh's file is missing, no regular file, empty or too large.
    """
    folder, located = urdf.resolve().parent, dict[str, str]()

    def locate(link: ElementTree.Element, mesh: ElementTree.Element) -> None:
        name = mesh.get("filename", "")
        if name not in located:
            path = _located(name, folder, package_dirs)
            try:
                _require_mesh(path)
            except ModelError as error:
                sought = path if path.is_absolute() else "any package beside or above it or in package_dirs"
                got = f"{shown(name)}, {error.got} ({sought})"
                expected = error.expected
                if not path.is_absolute():
                    told = "package_dirs (--package-dir) has the folder of its package, or the one with that"
                    expected = f"{expected}: {told}"
                raise ModelError(str(urdf), _key(link), got, expected) from error
            located[name] = str(path)
        mesh.set("filename", located[name])

    for link, _, mesh in _meshes(root, "collision"):
        locate(link, mesh)
    return _refused_as_boxes(root, locate)


def _refused_as_boxes(
    root: ElementTree.Element, require: Callable[[ElementTree.Element, ElementTree.Element], None]
) -> tuple[tuple[str, str], ...]:
    """Replace visual meshes that `require` refuses by boxes: their keys, and what is the matter."""
    told = []
    for link, visual, mesh in list(_meshes(root, "visual")):
        try:
            require(link, mesh)
        except ModelError as error:
            told.append((error.key, str(error.got)))
            _replace_by_box(link, visual)
    return tuple(told)


def _meshes(
    root: ElementTree.Element, tag: str
) -> Iterator[tuple[ElementTree.Element, ElementTree.Element, ElementTree.Element]]:
    """Yield the meshes of a URDF's shapes `tag`, each after its link and its shape."""
    for link in root.findall("link"):
        for shape in link.findall(tag):
            for mesh in shape.iter("mesh"):
                yield link, shape, mesh


def _key(link: ElementTree.Element) -> str:
    return f"link[{link.get('name')}].mesh.filename"


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


def read_vertices(mesh: ElementTree.Element) -> FloatArray:
    """Return the vertices (n, 3), m, of a URDF's mesh that is located; none of one that coal cannot read."""
    with suppress(ValueError, RuntimeError, IndexError):
        return vertices_of(_loaded(mesh, mesh_loader()))
    return np.empty((0, 3))


def faces_of(mesh: Any) -> IntArray:
    """Return the triangles (m, 3) of a mesh."""
    count, corners = coal.BVHModelBase.num_tris.__get__(mesh), coal.BVHModelBase.tri_indices
    triangles = (corners(mesh, k) for k in range(count))
    return np.array([(t[0], t[1], t[2]) for t in triangles], dtype=np.intp).reshape(-1, 3)


def box_about(shape: Any) -> FloatArray:
    """Return the smallest and the largest coordinates of a shape in its own frame, (2, 3), m."""
    shape.computeLocalAABB()
    return np.array([shape.aabb_local.min_, shape.aabb_local.max_])


def is_near(shape: Any) -> bool:
    """Return whether a shape is finite and lies within `FARTHEST` of its origin."""
    return bool((np.abs(box_about(shape)) <= FARTHEST).all())


def require_near_meshes(root: ElementTree.Element, tag: str, source: str) -> None:
    """Refuse the meshes of a URDF's shapes `tag`, ``collision`` or ``visual``, that cannot be used.

    They are located before. Those are refused that coal cannot read, or whose vertices are too far away.
    """
    loader = mesh_loader()
    for link, _, mesh in _meshes(root, tag):
        _require_near(link, mesh, loader, source)


def replace_unreadable(root: ElementTree.Element, source: str) -> tuple[tuple[str, str], ...]:
    """Replace the visual meshes that `require_near_meshes` refuses by boxes, in place; as `locate_meshes`.

    A box is that about the link's collision shapes. A link with other visual shapes does without one.
    """
    return _refused_as_boxes(root, partial(_require_near, loader=mesh_loader(), source=source))


def _require_near(link: ElementTree.Element, mesh: ElementTree.Element, loader: Any, source: str) -> None:
    name = shown(Path(mesh.get("filename", "")).name)
    try:
        shape = _loaded(mesh, loader)
    except (ValueError, RuntimeError, IndexError) as error:
        got = f"{name}, which coal cannot read ({' '.join(str(error).split())})"
        raise ModelError(source, _key(link), got, "a mesh file") from error
    if not is_near(shape):
        got = f"{name}, which is larger or not finite"
        raise ModelError(source, _key(link), got, f"a mesh of vertices within {FARTHEST:g} m")


def _loaded(mesh: ElementTree.Element, loader: Any) -> Any:
    return loader.load(mesh.get("filename", ""), _numbers(mesh.get("scale", "1 1 1")))


def _numbers(text: str) -> FloatArray:
    return np.array(text.split(), dtype=float)


def _replace_by_box(link: ElementTree.Element, visual: ElementTree.Element) -> None:
    """Draw the box about a link's collision shapes in place of a visual one, unless it has another one."""
    if len(link.findall("visual")) > 1:
        link.remove(visual)
        return
    corners = np.concatenate([np.empty((0, 3)), *map(_corners, link.findall("collision"))])
    for part in (*visual.findall("geometry"), *(visual.findall("origin") if len(corners) else ())):
        visual.remove(part)
    edges = np.full(3, _BOX_EDGE_M)
    if len(corners):
        edges = np.maximum(np.ptp(corners, axis=0), _THINNEST)
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        ElementTree.SubElement(visual, "origin", xyz=" ".join(map(str, middle.tolist())), rpy="0 0 0")
    geometry = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(geometry, "box", size=" ".join(map(str, edges.tolist())))


def _corners(collision: ElementTree.Element) -> FloatArray:
    """Corners (8, 3), m, in the link's frame, of the box about a collision shape; none of an unusable one."""
    shape = None
    for part in collision.findall("geometry/*"):
        size, radius, length = (_numbers(part.get(name, "0")) for name in ("size", "radius", "length"))
        match part.tag:
            case "box":
                shape = coal.Box(*size)
            case "cylinder":
                shape = coal.Cylinder(*radius, *length)
            case "sphere":
                shape = coal.Sphere(*radius)
            case "mesh":
                # Planning refuses one that cannot be read.
                with suppress(ValueError, RuntimeError, IndexError):
                    shape = _loaded(part, mesh_loader())
    if shape is None or not is_near(shape):
        return np.empty((0, 3))
    corners = np.array(list(product(*box_about(shape).T)))
    origin = collision.find("origin")
    xyz, rpy = (np.zeros(3) if origin is None else _numbers(origin.get(k, "0 0 0")) for k in ("xyz", "rpy"))
    return np.asarray(corners @ pin.rpy.rpyToMatrix(rpy).T + xyz)


def _located(name: str, folder: Path, package_dirs: Sequence[Path]) -> Path:
    scheme, found, rest = name.partition("://")
    if not found or scheme == "file":
        path = (folder / (rest if found else name)).resolve()
        # Of another machine it has the end of its path in common: at least the file with its folder.
        ends = ["/".join(path.parts[k:]) for k in range(2, len(path.parts) - 1)]
        place = None if not Path(rest or name).is_absolute() or is_file(path) else _with_end(ends, folder)
        return path if place is None else place
    if scheme in ("package", "model"):
        return find_resource(rest, folder, package_dirs) or Path(name)
    return Path(name)


def _with_end(ends: Sequence[str], folder: Path) -> Path | None:
    """The file with the longest end of a path below a folder or one above it; None without one."""
    places = ((find_copy([end], folder), end) for end in ends)
    return next((place / end for place, end in places if place is not None), None)


def _require_mesh(path: Path) -> None:
    suffix = path.suffix.lower()
    if suffix in _REFUSED_FORMATS:
        raise ModelError(str(path), "", f"a {suffix} file", "a mesh in a file of its own, such as STL")
    require_input(path, ModelError, kind="a mesh file", largest=LARGEST_MESH)
    with path.open("rb") as file:
        if file.read(len(_LFS_POINTER)) == _LFS_POINTER:
            raise ModelError(str(path), "", "a pointer of Git LFS in its place", "a mesh file: git lfs pull")
    if suffix == ".obj":
        for match in _MATERIAL_LIBRARY.finditer(read_input(path, ModelError, largest=LARGEST_MESH)):
            library = path.parent / os.fsdecode(match[1].strip())
            if os.path.exists(library):  # noqa: PTH110  as above
                read_input(library, ModelError, kind="a file of materials")


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
