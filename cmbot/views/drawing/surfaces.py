"""Everything that is drawn, as triangles with normals.

trimesh has solids and normals too, but its import takes longer than writing a page.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from cmbot.collision import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere, load_mesh
from cmbot.common.arrays import FloatArray, IntArray, cross
from cmbot.common.errors import ModelError
from cmbot.robot import faces_of, is_mesh, vertices_of

SECTIONS, RINGS = 32, 16  # of a round solid: about its axis, and of a ball from pole to pole
TUBE_SECTIONS = 12  # about the axis of a tube
_MAX_BOX_PIECES = 400  # of a box that is cut
# Edges of cells whose vertices are joined, as shares of a surface's size; and how readily edges are
# collapsed: with more, small parts vanish.
_CELLS, _CAREFUL = (0.0, 0.002, 0.008), 3.0
_MIN_TRIANGLES = 64  # triangles, of a surface that is simplified
_VERTEX_TOLERANCE_M = 1e-7  # between vertices at a cut, m
_MISSING_SIDE_SHARE = 0.001  # may be missing at a side, as a share of its size

# A triangle of less height, m, has no meaningful normal; a shorter sum of normals is rounding.
_FLAT, _ROUNDED_LENGTH = 1e-8, 1e-12
# Corners of the unit box, and its sides counter-clockwise as seen from outside.
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles: `vertices` (n, 3), m, and `faces` (m, 3), counter-clockwise as seen from outside."""

    vertices: FloatArray
    faces: IntArray

    def moved(self, X: FloatArray) -> Surface:
        """Return it under the affine map `X` (4, 4)."""
        return Surface(self.vertices @ X[:3, :3].T + X[:3, 3], self.faces)

    @cached_property
    def crosses(self) -> FloatArray:
        """Normals (m, 3) of the triangles, as long as twice their areas, m2."""
        a, b, c = (self.vertices[corner] for corner in self.faces.T)
        return cross(b - a, c - a)

    @cached_property
    def size(self) -> float:
        """The diagonal of the box about it, m."""
        return float(np.linalg.norm(np.ptp(self.vertices[self.faces].reshape(-1, 3), axis=0)))

    @property
    def area(self) -> float:
        """Of all triangles, m2."""
        return float(0.5 * np.linalg.norm(self.crosses, axis=1).sum())


def visual_surface(shape: Any, source: str) -> Surface:
    """Return a visual shape, a pinocchio.GeometryObject of the URDF `source`, in its joint's frame."""
    geometry = shape.geometry
    match geometry:
        case _ if is_mesh(geometry):
            surface = _whole(Surface(vertices_of(geometry), faces_of(geometry)), shape)
        case coal.ConvexBase():
            surface = hull(np.array([geometry.point(i) for i in range(geometry.num_points)]))
        case coal.Box():
            surface = box(2 * geometry.halfSide)
        case coal.Cylinder():
            surface = cylinder(geometry.radius, 2 * geometry.halfLength)
        case coal.Capsule():
            surface = capsule(geometry.radius, 2 * geometry.halfLength)
        case coal.Cone():
            surface = cone(geometry.radius, 2 * geometry.halfLength)
        case coal.Sphere():
            surface = ball(geometry.radius)
        case coal.Ellipsoid():
            surface = ball(1.0).moved(np.diag([*geometry.radii, 1.0]))
        case _:
            expected = "a mesh, box, cylinder, capsule, cone, sphere or ellipsoid"
            raise ModelError(source, f"visual {shape.name}", type(geometry).__name__, expected)
    return surface.moved(shape.placement.homogeneous)


def obstacle_surface(obstacle: Obstacle, piece: float = np.inf) -> Surface:
    """Return an obstacle in W. Bars have a cross-section every `piece`, m."""
    match obstacle.shape:
        case Box(size=size):
            surface = bar(size, piece)
        case Cylinder(radius=radius, length=length):
            surface = cylinder(radius, length, piece)
        case Capsule(radius=radius, length=length):
            surface = capsule(radius, length, piece)
        case Sphere(radius=radius):
            surface = ball(radius)
        case Mesh(path=path, scale=scale):
            mesh = load_mesh(path, obstacle.name, scale=scale)
            surface = Surface(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.intp))
    return surface.moved(obstacle.X_WO)


def box(size: ArrayLike) -> Surface:
    """Return a box about the origin with the edges `size` (3,), m."""
    return Surface(_CORNERS * np.asarray(size), _SIDES[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))


def bar(size: ArrayLike, piece: float) -> Surface:
    """Return a box with cross-sections along its longest edge, at most `piece`, m, apart."""
    edges = np.asarray(size, dtype=float)
    along = int(edges.argmax())
    count = _pieces(edges[along], piece)
    y, z = (along + 1) % 3, (along + 2) % 3
    corners = np.zeros((4, 3))
    corners[:, y], corners[:, z] = (
        0.5 * edges[y] * np.array([-1, 1, 1, -1]),
        0.5 * edges[z] * np.array([-1, -1, 1, 1]),
    )
    vertices = np.repeat(corners[None], count + 1, axis=0)
    vertices[..., along] = np.linspace(-0.5, 0.5, count + 1)[:, None] * edges[along]
    index = np.arange(4 * (count + 1)).reshape(count + 1, 4)
    low, beside = index[:-1], np.roll(index, -1, axis=1)[:-1]
    above, across = index[1:], np.roll(index, -1, axis=1)[1:]
    sides = [(low, beside, across), (low, across, above)]
    ends = [index[0, [0, 3, 2]], index[0, [0, 2, 1]], index[-1, [0, 1, 2]], index[-1, [0, 2, 3]]]
    faces = [np.stack(three, axis=-1).reshape(-1, 3) for three in sides]
    return Surface(vertices.reshape(-1, 3), np.concatenate([*faces, np.array(ends)]).astype(np.intp))


def _pieces(length: float, piece: float) -> int:
    return int(np.clip(np.ceil(length / piece), 1, _MAX_BOX_PIECES))


def cylinder(radius: float, length: float, piece: float = np.inf, *, sections: int = SECTIONS) -> Surface:
    """Return a cylinder about the origin, its axis along z, with rings at most `piece`, m, apart."""
    rings = np.linspace(-0.5, 0.5, _pieces(length, piece) + 1) * length
    radii = np.full(len(rings) + 2, radius)
    radii[[0, -1]] = 0.0
    return _revolved(radii, np.concatenate([rings[:1], rings, rings[-1:]]), sections)


def cone(radius: float, length: float) -> Surface:
    """Return a cone about z with its base at z = -length / 2 and its tip at z = length / 2."""
    half = 0.5 * length
    return _revolved([0.0, radius, 0.0], [-half, -half, half], SECTIONS)


def ball(radius: float, *, sections: int = SECTIONS, rings: int = RINGS) -> Surface:
    """Return a ball about the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    return _revolved(radius * np.cos(angle), radius * np.sin(angle), sections)


def capsule(radius: float, length: float, piece: float = np.inf) -> Surface:
    """Return a capsule about the origin, its axis along z; `length` lies between the centres of its ends.

    Between them it has rings at most `piece`, m, apart.
    """
    # The equator of a ball is there at either end of the cylinder, and between them.
    count = _pieces(length, piece)
    angle = np.linspace(-np.pi / 2, np.pi / 2, RINGS + 1)
    angle = np.insert(angle, RINGS // 2, np.zeros(count))
    end = np.concatenate(
        [np.full(RINGS // 2, -0.5), np.linspace(-0.5, 0.5, count + 1), np.full(RINGS // 2, 0.5)]
    )
    return _revolved(radius * np.cos(angle), radius * np.sin(angle) + end * length, SECTIONS)


def hull(points: FloatArray) -> Surface:
    """Return the convex hull of `points` (n, 3), which enclose a volume."""
    # Only for robots that are drawn as hulls.
    from scipy.spatial import ConvexHull

    found = ConvexHull(points)
    surface = Surface(points, found.simplices)
    inside_out = np.einsum("ki,ki->k", surface.crosses, found.equations[:, :3]) < 0
    faces = np.where(inside_out[:, None], found.simplices[:, ::-1], found.simplices)
    used, faces = np.unique(faces, return_inverse=True)
    return Surface(points[used], faces.reshape(-1, 3))


def tube(points: FloatArray, radius: float, *, sections: int = TUBE_SECTIONS) -> Surface:
    """Return a tube through `points` (N, 3), m, with a ball at each."""
    pieces = []
    for start, end in pairwise(points):
        turned = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start)
        X = pin.SE3(turned, 0.5 * (start + end)).homogeneous
        length = float(np.linalg.norm(end - start))
        pieces.append(cylinder(radius, length, sections=sections).moved(X))
    joint = ball(1.6 * radius, sections=sections, rings=sections)
    return merged([*pieces, *(Surface(joint.vertices + point, joint.faces) for point in points)])


def merged(surfaces: Sequence[Surface]) -> Surface:
    """Return several surfaces as one, without joining vertices."""
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces[:-1])])
    return Surface(
        np.concatenate([surface.vertices for surface in surfaces]),
        np.concatenate([surface.faces + start for surface, start in zip(surfaces, starts, strict=True)]),
    )


def simplified(surfaces: Sequence[Surface], most_faces: int) -> list[Surface]:
    """Return the surfaces with at most `most_faces` triangles in all; unchanged when they have no more.

    Edges are collapsed where that moves the surface least (Garland and Heckbert 1997), in surfaces of more
    triangles than all can have. Loose parts and edges of three triangles stop that: then vertices are joined
    first, of cells up to 0.8 % of the surface's size (Rossignac and Borrel 1993). A surface that has too many
    triangles even so keeps them: no part of it is left out.
    """
    counts = [len(surface.faces) for surface in surfaces]
    if sum(counts) <= most_faces:
        return list(surfaces)
    most = max(_most_of_each(counts, most_faces), _MIN_TRIANGLES)
    return [each if len(each.faces) <= most else _collapsed(each, most) for each in surfaces]


def sliced(surface: Surface, along: FloatArray, piece: float) -> Surface:
    """Return a surface that is cut by planes across the direction `along` (3,), at most `piece`, m, apart."""
    # Only for masts that are meshes, which it has read.
    from trimesh import intersections

    slice_faces: Any = intersections.slice_faces_plane
    height = surface.vertices @ along
    low, high = height.min(), height.max()
    planes = np.linspace(low, high, _pieces(high - low, piece) + 1)
    planes[[0, -1]] = low - piece, high + piece
    parts = []
    for below, above in pairwise(planes):
        vertices, faces, _ = slice_faces(surface.vertices, surface.faces, along, below * along)
        vertices, faces, _ = slice_faces(vertices, faces, -along, above * along)
        parts.append(Surface(vertices, np.asarray(faces, dtype=np.intp)))
    return _joined(merged(parts), _VERTEX_TOLERANCE_M)


def creased(surface: Surface, angle: float) -> tuple[Surface, FloatArray]:
    """Split the vertices at sharp edges, and return normals (n, 3) of the vertices for shading.

    Two triangles that meet at less than `angle`, rad, share the normals of their edge's ends. A normal is the
    mean of the triangles' normals around the vertex, weighted with the triangles' angles there (Thürrner and
    Wüthrich 1998). Degenerate triangles are left out.
    """
    surface = _with_height(surface)
    crosses, vertex = surface.crosses, surface.faces.ravel()
    flat = crosses / np.linalg.norm(crosses, axis=1, keepdims=True)
    first, second = _shared_edges(surface.faces)
    smooth = np.einsum("ki,ki->k", flat[first // 3], flat[second // 3]) > np.cos(angle)
    first, second = first[smooth], second[smooth]
    # Two triangles run along their edge in opposite directions, unless inside and outside are mixed up.
    opposite = vertex[first] != vertex[second]
    one = np.concatenate([first, _next(first)])
    other = np.where(opposite, [_next(second), second], [second, _next(second)]).ravel()
    graph = sparse.coo_array((np.ones(len(one)), (one, other)), shape=(len(vertex), len(vertex)))
    count, corner = connected_components(graph, directed=False)
    where = np.empty(count, dtype=vertex.dtype)
    where[corner] = vertex
    weighted = _angles(surface)[:, :, None] * flat[:, None, :]
    sums = np.zeros((count, 3))
    np.add.at(sums, corner, weighted.reshape(-1, 3))
    normals = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), _ROUNDED_LENGTH)
    return Surface(surface.vertices[where], corner.reshape(-1, 3).astype(np.intp)), normals


def _whole(surface: Surface, shape: Any) -> Surface:
    """Return the surface of a mesh file as trimesh reads it, where coal leaves out vertices.

    coal 3.0 counts the corners of a second mesh of a node, such as one of another material, from those of the
    first. Where the two do not read the same box, in other units, coal's surface is kept.
    """
    if len(np.unique(surface.faces)) == len(surface.vertices):
        return surface
    # Only for files of several meshes.
    import trimesh

    path, scale = Path(shape.meshPath), np.asarray(shape.meshScale)
    with suppress(Exception):  # what its readers raise has no common type
        mesh: Any = trimesh.load_mesh(BytesIO(path.read_bytes()), file_type=path.suffix[1:].lower())
        again = Surface(scale * np.array(mesh.vertices), np.array(mesh.faces, dtype=np.intp))
        ends, others = ([x.vertices.min(axis=0), x.vertices.max(axis=0)] for x in (surface, again))
        if np.allclose(ends, others, rtol=0.0, atol=_MISSING_SIDE_SHARE * again.size):
            return again
    return surface


def _revolved(radii: ArrayLike, heights: ArrayLike, sections: int) -> Surface:
    """Return the surface of a line turned about z; the line leads upwards from one point on z to another."""
    radii, heights = np.asarray(radii), np.asarray(heights)
    angle = np.linspace(0.0, 2 * np.pi, sections, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = len(radii) - 2
    vertices = np.zeros((rings * sections + 2, 3))
    around = vertices[1:-1].reshape(rings, sections, 3)
    around[..., :2] = radii[1:-1, None, None] * circle
    around[..., 2] = heights[1:-1, None]
    vertices[[0, -1], 2] = heights[0], heights[-1]
    index = 1 + np.arange(rings * sections).reshape(rings, sections)
    beside = np.roll(index, -1, axis=1)
    bottom, top = np.zeros(sections, dtype=index.dtype), np.full(sections, len(vertices) - 1)
    corners = (
        (bottom, beside[0], index[0]),
        (index[:-1], beside[:-1], beside[1:]),
        (index[:-1], beside[1:], index[1:]),
        (index[-1], beside[-1], top),
    )
    return Surface(vertices, np.concatenate([np.stack(three, axis=-1).reshape(-1, 3) for three in corners]))


def _most_of_each(counts: Sequence[int], most: int) -> int:
    """The number to which larger `counts` have to be lowered to be `most` in all."""
    left = most
    for number, count in enumerate(sorted(counts)):
        share = left // (len(counts) - number)
        if count > share:
            return share
        left -= count
    return max(counts)


def _collapsed(surface: Surface, most: int) -> Surface:
    # Only for robots and obstacles of very many triangles.
    from fast_simplification import simplify

    best = surface = _with_height(surface)
    corners = surface.vertices[surface.faces].reshape(-1, 3)
    low, high = corners.min(axis=0, initial=np.inf), corners.max(axis=0, initial=-np.inf)
    for cell in _CELLS:
        if len(best.faces) <= most:
            break
        joined = _joined(surface, cell * surface.size)
        count = most - 6  # `_as_far` adds as many
        if len(joined.faces) > count:
            faces = joined.faces.astype(np.int32)
            points, triangles = simplify(joined.vertices, faces, target_count=count, agg=_CAREFUL)
            # Where a surface is nearly flat, an edge's best point may be far away.
            joined = Surface(np.clip(points, low, high), np.asarray(triangles, dtype=np.intp))
        joined = _as_far(joined, surface)
        if len(joined.faces) < len(best.faces):
            best = joined
    return best


def _joined(surface: Surface, cell: float) -> Surface:
    """Join vertices within cubes with the edge `cell`, m; 0: of those that a file repeats.

    What becomes a line or a point is left out, unless nothing else would be left there.
    """
    low = surface.vertices.min(axis=0)
    places = np.round((surface.vertices - low) / cell) if cell > 0 else surface.vertices
    _, first, index = np.unique(places, axis=0, return_index=True, return_inverse=True)
    faces = index.ravel()[surface.faces]
    there = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    _, different = np.unique(np.sort(faces[there], axis=1), axis=0, return_index=True)
    kept = faces[there][np.sort(different)]
    # Of the triangles within a cell that nothing else touches, one keeps its own vertices.
    lost = np.flatnonzero(~there)
    lost = lost[~np.isin(faces[lost], kept).any(axis=1)]
    alone = surface.faces[lost[np.unique(faces[lost].min(axis=1), return_index=True)[1]]]
    own = np.arange(alone.size).reshape(-1, 3) + len(first)
    vertices = np.concatenate([surface.vertices[first], surface.vertices[alone.ravel()]])
    return Surface(vertices, np.concatenate([kept, own]).astype(np.intp))


def _as_far(surface: Surface, original: Surface) -> Surface:
    """Add the triangles of the original that reach farthest along x, y and z, where the surface does not."""
    corners, reached = original.vertices[original.faces], surface.vertices[surface.faces].reshape(-1, 3)
    added = []
    for axis in range(3):
        for sign in (-1, 1):
            farthest = (sign * corners[..., axis]).max(axis=1)
            short = farthest.max() - (sign * reached[:, axis]).max(initial=-np.inf)
            if short > _MISSING_SIDE_SHARE * original.size:
                added.append(Surface(corners[farthest.argmax()], np.arange(3).reshape(1, 3)))
    return merged([surface, *added]) if added else surface


def _shared_edges(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Return the pairs of edges that are one edge of two triangles; 3 k + i begins at corner i of triangle k.

    An edge of three triangles or more is left out: it is sharp.
    """
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    key = ends.min(axis=1) * (faces.max(initial=0) + 1) + ends.max(axis=1)
    order = np.argsort(key, kind="stable")
    same = np.concatenate([[False], np.diff(key[order]) == 0, [False]])
    at = np.flatnonzero(same[1:-1] & ~same[:-2] & ~same[2:])
    return order[at], order[at + 1]


def _next(corner: IntArray) -> IntArray:
    """Return the corners 3 k + i that follow in their triangles."""
    return np.where(corner % 3 == 2, corner - 2, corner + 1)


def _angles(surface: Surface) -> FloatArray:
    """Angles (m, 3) of the triangles at their corners, rad."""
    points = surface.vertices[surface.faces]
    ahead, back = np.roll(points, -1, axis=1) - points, np.roll(points, 1, axis=1) - points
    doubled = np.linalg.norm(surface.crosses, axis=1)[:, None]
    return np.asarray(np.arctan2(doubled, np.einsum("kci,kci->kc", ahead, back)))


def _with_height(surface: Surface) -> Surface:
    """Leave out the triangles that are lines or points."""
    points = surface.vertices[surface.faces]
    longest = np.linalg.norm(points - np.roll(points, 1, axis=1), axis=2).max(axis=1)
    high = np.linalg.norm(surface.crosses, axis=1) > _FLAT * longest
    return surface if high.all() else Surface(surface.vertices, surface.faces[high])
