"""Surfaces of triangles, and those of plain solids.

trimesh has them too, but to import it takes longer than to write a page.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray

__all__ = ["Surface", "ball", "box", "capsule", "cone", "cylinder", "hull"]

SECTIONS = 32
"""Of what is round, about its axis."""
RINGS = 16
"""Of a ball, from pole to pole."""

# Corners of the unit box, and its sides: each corner of one is followed against the clock, seen from outside.
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles.

    Attributes
    ----------
    vertices : (n, 3), m
    faces : (m, 3)
        Indices of vertices, against the clock as seen from outside.
    """

    vertices: FloatArray
    faces: IntArray

    def moved(self, X: FloatArray) -> Surface:
        """Return it at the pose `X` (4, 4)."""
        return Surface(self.vertices @ X[:3, :3].T + X[:3, 3], self.faces)

    @property
    def crosses(self) -> FloatArray:
        """Cross products (m, 3) of two edges of every triangle, m2: twice its area, along its normal."""
        a, b, c = (self.vertices[corner] for corner in self.faces.T)
        return np.cross(b - a, c - a)

    @property
    def area(self) -> float:
        """Of all triangles, m2."""
        return float(0.5 * np.linalg.norm(self.crosses, axis=1).sum())


def box(size: FloatArray) -> Surface:
    """Return a box about the origin with the edges `size` (3,), m."""
    return Surface(_CORNERS * size, _SIDES[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))


def cylinder(radius: float, length: float, *, sections: int = SECTIONS) -> Surface:
    """Return a cylinder about the origin, its axis along z."""
    half = 0.5 * length
    return _revolved([0.0, radius, radius, 0.0], [-half, -half, half, half], sections)


def cone(radius: float, length: float) -> Surface:
    """Return a cone whose base is below the origin and whose tip above it, by half its length each."""
    half = 0.5 * length
    return _revolved([0.0, radius, 0.0], [-half, -half, half])


def ball(radius: float, *, sections: int = SECTIONS, rings: int = RINGS) -> Surface:
    """Return a ball about the origin."""
    return capsule(radius, 0.0, sections=sections, rings=rings)


def capsule(radius: float, length: float, *, sections: int = SECTIONS, rings: int = RINGS) -> Surface:
    """Return a capsule about the origin, its axis along z; `length` lies between the centres of its ends."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    radii, heights = radius * np.cos(angle), radius * np.sin(angle)
    radii[[0, -1]] = 0.0
    if length == 0.0:
        return _revolved(radii, heights, sections)
    # The equator is there twice, at either end of the cylinder.
    middle = rings // 2
    radii = np.insert(radii, middle, radii[middle])
    heights = np.insert(heights, middle, heights[middle])
    heights += np.where(np.arange(rings + 2) <= middle, -0.5, 0.5) * length
    return _revolved(radii, heights, sections)


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


def _revolved(
    radii: FloatArray | list[float], heights: FloatArray | list[float], sections: int = SECTIONS
) -> Surface:
    """Return what a line turned about z sweeps; it leads upwards from a point on z to another one."""
    angle = np.linspace(0.0, 2 * np.pi, sections, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = len(radii) - 2
    vertices = np.zeros((rings * sections + 2, 3))
    around = vertices[1:-1].reshape(rings, sections, 3)
    around[..., :2] = np.asarray(radii)[1:-1, None, None] * circle
    around[..., 2] = np.asarray(heights)[1:-1, None]
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
