"""Normals for shading: smooth where a surface is, sharp at its edges."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.views.solids import Surface

__all__ = ["creased"]

# A triangle that is not this high, m, has no normal to speak of.
_FLAT = 1e-8
# Below this, what normals add up to is rounding.
_NOTHING = 1e-12


def creased(surface: Surface, angle: float) -> tuple[Surface, FloatArray]:
    """Take a surface apart at its edges.

    Parameters
    ----------
    surface : Surface
    angle : float, rad
        Two triangles that meet at less share the normals of their edge's ends.

    Returns
    -------
    surface : Surface
        Without triangles that are lines, its vertices there as often as they have normals.
    normals : (n, 3)
        Of the vertices: of the triangles around them the mean, weighted with the triangles' angles there
        (Thürrner and Wüthrich 1998).
    """
    surface = _with_height(surface)
    crosses, vertex = surface.crosses, surface.faces.ravel()
    flat = crosses / np.linalg.norm(crosses, axis=1, keepdims=True)
    first, second = _meeting(surface.faces)
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
    normals = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), _NOTHING)
    return Surface(surface.vertices[where], corner.reshape(-1, 3).astype(np.intp)), normals


def _meeting(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Return the pairs of edges that are one edge of two triangles; 3 k + i begins at corner i of triangle k.

    An edge of three triangles or more is none of theirs: it is sharp.
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
    return Surface(surface.vertices, surface.faces[high])
