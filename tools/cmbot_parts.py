"""Turned parts and plates: the solids that the robot's looks are put together from, and how they are written.

Every solid is closed on its own; `join` only puts solids into one mesh, they may run into each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray

Mesh = trimesh.Trimesh
Array = NDArray[np.float64]
Vector = tuple[float, float, float]

FACETS = 28
# Which of a part's coordinates (u, v, w) go to x, y, z, so that w lies along the axis named: proper turns.
TURNS = {"x": [2, 0, 1], "y": [1, 2, 0], "z": [0, 1, 2]}


def place(mesh: Mesh, axis: str, at: Sequence[float]) -> Mesh:
    """Turn a part's axis w onto `axis` and shift it."""
    return Mesh(mesh.vertices[:, TURNS[axis]] + np.asarray(at, dtype=float), mesh.faces, process=False)


def lathe(
    profile: Sequence[tuple[float, float]], axis: str = "z", at: Vector = (0, 0, 0), facets: int = FACETS
) -> Mesh:
    """Turn a profile of (radius, height), closed to the axis at both ends and rising, into a solid."""
    closed = [(0.0, profile[0][1]), *profile, (0.0, profile[-1][1])]
    return place(trimesh.creation.revolve(np.array(closed), sections=facets), axis, at)


def drum(
    radius: float, low: float, high: float, axis: str = "z", at: Vector = (0, 0, 0), chamfer: float = 0.004,
    facets: int = FACETS,
) -> Mesh:  # fmt: skip
    """Return a cylinder with chamfered rims."""
    inner = radius - chamfer
    return lathe(
        [(inner, low), (radius, low + chamfer), (radius, high - chamfer), (inner, high)], axis, at, facets
    )


def prism(outline: Array, low: float, high: float, axis: str = "z", at: Vector = (0, 0, 0)) -> Mesh:
    """Return the prism over a convex counter-clockwise outline."""
    count = len(outline)
    vertices = np.vstack([np.column_stack([outline, np.full(count, height)]) for height in (low, high)])
    after = np.roll(np.arange(count), -1)
    sides = [(i, after[i], after[i] + count) for i in range(count)]
    sides += [(i, after[i] + count, i + count) for i in range(count)]
    caps = [(0, i + 1, i) for i in range(1, count - 1)]
    caps += [(count, count + i, count + i + 1) for i in range(1, count - 1)]
    return place(Mesh(vertices, np.array(sides + caps), process=False), axis, at)


def bar(
    start: tuple[float, float], end: tuple[float, float], radius: float, low: float, high: float, axis: str,
    at: Vector = (0, 0, 0),
) -> Mesh:  # fmt: skip
    """Return a plate with round ends: from `start` to `end` in its plane, `low` to `high` across it."""
    p, q = np.array(start), np.array(end)
    heading = np.arctan2(q[1] - p[1], q[0] - p[0])
    turn = np.linspace(-np.pi / 2, np.pi / 2, 13)
    ends = [(centre, heading + side + turn) for centre, side in ((q, 0.0), (p, np.pi))]
    arcs = [centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]) for centre, angle in ends]
    return prism(np.vstack(arcs), low, high, axis, at)


def block(low: Vector, high: Vector, axis: str = "z", chamfer: float = 0.006) -> Mesh:
    """Return a box from corner to corner whose edges along `axis` are chamfered."""
    u, v, w = np.argsort(TURNS[axis])
    (u0, u1), (v0, v1) = (low[u], high[u]), (low[v], high[v])
    c = chamfer
    outline = [
        (u0 + c, v0),
        (u1 - c, v0),
        (u1, v0 + c),
        (u1, v1 - c),
        (u1 - c, v1),
        (u0 + c, v1),
        (u0, v1 - c),
    ]
    return prism(np.array([*outline, (u0, v0 + c)]), low[w], high[w], axis)


def bolts(circle: float, count: int, low: float, high: float, axis: str, at: Vector = (0, 0, 0)) -> Mesh:
    """Return a ring of hexagonal bolt heads."""
    corner = np.arange(6) * np.pi / 3
    head = 0.005 * np.column_stack([np.cos(corner), np.sin(corner)])
    angles = 2 * np.pi * (np.arange(count) + 0.5) / count
    centres = circle * np.column_stack([np.cos(angles), np.sin(angles)])
    return join(*(prism(head + centre, low, high, axis, at) for centre in centres))


def join(*parts: Mesh) -> Mesh:
    """Put parts into one mesh; they stay closed bodies of their own."""
    joined = trimesh.util.concatenate(parts)
    if not isinstance(joined, Mesh):
        raise TypeError(type(joined))
    return joined


def stl_bytes(mesh: Mesh) -> bytes:
    """Return binary STL, rounded to micrometres so that a machine's last bits do not reach the file."""
    corners = np.round(mesh.vertices[mesh.faces], 6) + 0.0
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.round(normals / np.linalg.norm(normals, axis=1, keepdims=True), 6) + 0.0
    record = np.zeros(
        len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    record["normal"], record["corners"] = normals, corners
    return b"cmbot".ljust(80, b"\0") + np.uint32(len(record)).tobytes() + record.tobytes()
