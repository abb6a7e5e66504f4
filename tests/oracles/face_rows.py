"""Rows over faces of a mesh by another route: each point by the triangle that is under it."""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray

__all__ = ["face_rows", "tool_direction"]

# As the package documents them: height of faces that count as a plane, m, and points of other rows.
_FLAT, _LEAST_NODES = 1e-4, 5
_WHOLE, _NO_LENGTH, _NO_AREA = 1e-6, 1e-9, 1e-12


def face_rows(
    raster: Any, mesh: Any, X_WM: FloatArray, p_frame: FloatArray, R_frame: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Return tool points (K, 3), m, and the tool's z axes (K, 3) of each row.

    Parameters
    ----------
    raster : Raster of cmbot.scene
        With faces of a mesh.
    mesh : Mesh of cmbot.scene
        Its path and scale.
    X_WM : (4, 4)
        Pose of the mesh in W.
    p_frame, R_frame : (3,), m, and (3, 3)
        Pose of the raster's frame in W.
    """
    vertices, faces = _chosen(raster, mesh, X_WM, p_frame, R_frame)
    across = _across(vertices[faces])
    sizes = np.linalg.norm(across, axis=1)
    z = across.sum(axis=0) / np.linalg.norm(across.sum(axis=0))
    x = np.cross(z, np.cross(R_frame @ np.array(raster.along), z))
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z], axis=1)
    local, smooth = vertices @ axes, _vertex_normals(vertices, faces) @ axes
    corners = local[faces]
    level = float(corners[:, :, 2].mean(axis=1) @ sizes / sizes.sum())
    is_flat = np.abs(corners[:, :, 2] - level).max() <= _FLAT
    low, high = corners[:, :, 1].min(), corners[:, :, 1].max()
    count = max(int(np.ceil((high - low) / raster.spacing_m - _WHOLE)), 1)
    left, rows = float(corners[:, :, 0].min()), []
    pieces = [(one.row, left + one.begin_m, left + one.end_m) for one in raster.pieces or ()]
    for k, (row, *ends) in enumerate(pieces or [(row,) for row in range(count)]):
        y = low + (row + 0.5) * (high - low) / count
        begin, end = ends or _reach(corners, y)
        number = int(np.ceil((end - begin) / (raster.spacing_m / 2) - _WHOLE)) + 1
        places = begin + (end - begin) * np.linspace(0, 1, max(number, _LEAST_NODES))
        if is_flat:
            surface, normals = (
                np.array([[s, y, level] for s in places]),
                np.tile([0.0, 0.0, 1.0], (len(places), 1)),
            )
        else:
            found = [_under(local, smooth, faces, corners, s, y) for s in places]
            surface, normals = (np.array(each) for each in zip(*found, strict=True))
        across = np.cross(normals, [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        back = tool_direction(raster, np.cross(across, normals), across, normals)
        tool = surface + raster.stand_off_m * back
        if raster.overscan_m > 0:
            ahead = [np.cross(normal, np.cross([1, 0, 0], normal)) for normal in normals[[0, -1]]]
            before, behind = (raster.overscan_m * way / np.linalg.norm(way) for way in ahead)
            tool = np.vstack([tool[0] - before, tool, tool[-1] + behind])
            back = back[[0, *range(len(back)), -1]]
        if is_flat:
            tool, back = tool[[0, -1]], back[[0, -1]]
        order = slice(None) if k % 2 == 0 else slice(None, None, -1)
        rows.append(((tool @ axes.T)[order], (-back @ axes.T)[order]))
    return rows


def tool_direction(raster: Any, along: FloatArray, across: FloatArray, normal: FloatArray) -> FloatArray:
    """Return unit vectors (..., 3) out of the surface, where two planes meet that lean from the normal."""
    ahead, aside = np.radians(raster.lean_deg or (0.0, 0.0))
    first = np.cos(ahead) * along - np.sin(ahead) * normal
    second = np.cos(aside) * across - np.sin(aside) * normal
    both = np.cross(first, second)
    both *= np.sign((both * normal).sum(axis=-1, keepdims=True))
    return np.asarray(both / np.linalg.norm(both, axis=-1, keepdims=True))


def _chosen(
    raster: Any, mesh: Any, X_WM: FloatArray, p_frame: FloatArray, R_frame: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Vertices in W and faces of the chosen part, with one vertex for corners at the same place."""
    # It takes a while to come, and few scenes have a mesh.
    import trimesh

    soup = mesh.scale * np.asarray(trimesh.load_mesh(mesh.path, process=False).triangles)
    corners = soup @ X_WM[:3, :3].T + X_WM[:3, 3]
    across = _across(corners)
    sizes = np.linalg.norm(across, axis=1)
    picked = np.zeros(len(soup), dtype=np.bool_)
    if raster.faces is not None:
        normal = R_frame @ np.array(raster.faces.normal) / np.linalg.norm(raster.faces.normal)
        steep = np.cos(np.radians(raster.faces.within_deg)) - _NO_LENGTH
        picked = (sizes > 2 * _NO_AREA) & (across @ normal >= steep * sizes)
        if raster.faces.box is not None:
            lower, upper = np.array(raster.faces.box)
            there = (corners - p_frame) @ R_frame
            outside = (there < lower - _NO_LENGTH) | (there > upper + _NO_LENGTH)
            picked &= ~outside.reshape(len(soup), -1).any(axis=1)
    places, which = np.unique(soup[picked].reshape(-1, 3), axis=0, return_inverse=True)
    return places @ X_WM[:3, :3].T + X_WM[:3, 3], np.asarray(which).reshape(-1, 3)


def _across(corners: FloatArray) -> FloatArray:
    """Normals (F, 3) of triangles, as long as twice their area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals (V, 3): means of the faces', weighted by their angles at the vertex."""
    corners = vertices[faces]
    unit = _across(corners)
    unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    total = np.zeros_like(vertices)
    for k in range(3):
        a, b = (corners[:, (k + j) % 3] - corners[:, k] for j in (1, 2))
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("fd,fd->f", a, b))
        np.add.at(total, faces[:, k], angle[:, None] * unit)
    return np.asarray(total / np.linalg.norm(total, axis=1, keepdims=True))


def _reach(corners: FloatArray, y: float) -> tuple[float, float]:
    """Where the line at y begins and ends on triangles (F, 3, 3), by their edges."""
    start, end = corners, np.roll(corners, -1, axis=1)
    rise = end[:, :, 1] - start[:, :, 1]
    crossing = (np.minimum(start, end)[:, :, 1] <= y) & (y <= np.maximum(start, end)[:, :, 1]) & (rise != 0)
    share = (y - start[crossing][:, 1]) / rise[crossing]
    x = start[crossing][:, 0] + share * (end - start)[crossing][:, 0]
    return float(x.min()), float(x.max())


def _under(
    local: FloatArray, smooth: FloatArray, faces: IntArray, corners: FloatArray, x: float, y: float
) -> tuple[FloatArray, FloatArray]:
    """Point and smoothed unit normal of the triangle at a place; beside all of them that of the nearest."""
    to = np.array([x, y]) - corners[:, 0, :2]
    a, b = (corners[:, k, :2] - corners[:, 0, :2] for k in (1, 2))
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    second = (to[:, 0] * b[:, 1] - to[:, 1] * b[:, 0]) / area
    third = (a[:, 0] * to[:, 1] - a[:, 1] * to[:, 0]) / area
    shares = np.stack([1 - second - third, second, third], axis=1)
    face = int(shares.min(axis=1).argmax())
    normal = shares[face] @ smooth[faces[face]]
    return shares[face] @ local[faces[face]], normal / np.linalg.norm(normal)
