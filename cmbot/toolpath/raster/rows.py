"""Where rows over rectangles and cylinders begin and end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.poses import turned_pose
from cmbot.toolpath.raster.raster import CylinderPatch, Raster, RowPiece

# Cosine of 10 degrees: the angle to the z axis below which a cylinder's angles count from the x axis.
_UPRIGHT_COSINE = 0.98480775


def rectangle_axes(raster: Raster, X_WF: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return unit vectors in W along a row, to the next one, and against the tool's z axis; frame (4, 4)."""
    _, *edges = map(np.array, raster.rectangle or ())
    u, v = (X_WF[:3, :3] @ edge / np.linalg.norm(edge) for edge in edges)
    return u, v, raster.away(u, v, np.cross(u, v))


def rectangle_corners(raster: Raster, pieces: Sequence[RowPiece], X_WF: FloatArray) -> FloatArray:
    """Return the tool points (2 P, 3), m, in W at which pieces of rows begin and end, to and fro."""
    u, v, away = rectangle_axes(raster, X_WF)
    corner = X_WF[:3, :3] @ np.array(raster.origin) + X_WF[:3, 3] + raster.stand_off_m * away
    ends = _ends(pieces, raster.overscan_m)
    places = np.repeat([piece.row for piece in pieces], 2) * raster.sides[1] / raster.steps
    return np.asarray(corner + ends[:, None] * u + places[:, None] * v)


def tool_cylinder(
    raster: Raster, pipe: CylinderPatch, X_WF: FloatArray
) -> tuple[FloatArray, float, FloatArray]:
    """Return the cylinder that tool points are on: its pose (4, 4) in W, its radius, m, and a direction (3,).

    Its z is along the axis, and the tool at its x where the angle is zero, its z axis against the direction.
    """
    axis = np.array(pipe.axis) / np.linalg.norm(pipe.axis)
    zero = np.eye(3)[0 if abs(axis[2]) > _UPRIGHT_COSINE else 2]
    zero = zero - (zero @ axis) * axis
    zero /= np.linalg.norm(zero)
    X_FC = turned_pose(pipe.centre, np.stack([zero, np.cross(axis, zero), axis], axis=1))
    x, y, z = np.eye(3)
    y = np.sign(pipe.angle) * y
    away = raster.away(z, y, x) if pipe.rows == "along" else raster.away(y, z, x)
    tool = pipe.radius * x + raster.stand_off_m * away
    radius, X_CT = float(np.hypot(tool[0], tool[1])), np.eye(4)
    X_CT[:2, 0] = tool[:2] / radius
    X_CT[:3, 1], X_CT[2, 3] = np.cross(z, X_CT[:3, 0]), tool[2]
    return np.asarray(X_WF @ X_FC @ X_CT), radius, X_CT[:3, :3].T @ away


def cylinder_corners(
    raster: Raster, pipe: CylinderPatch, pieces: Sequence[RowPiece], radius: float
) -> FloatArray:
    """Return the ends (2 P, 3) of rows on a cylinder of a radius unrolled: x around, y along it, m."""
    begin, way = np.radians(pipe.from_deg), pipe.angle
    rows = np.repeat([piece.row for piece in pieces], 2)
    ends, corners = _ends(pieces, raster.overscan_m), np.zeros((2 * len(pieces), 3))
    if pipe.rows == "along":
        corners[:, 0] = begin + way / raster.steps * rows
        corners[:, 1] = ends - 0.5 * pipe.length
    else:
        corners[:, 0] = begin + np.sign(way) * ends / pipe.radius
        corners[:, 1] = pipe.length * (rows / raster.steps - 0.5)
    corners[:, 0] *= radius
    return corners


def _ends(pieces: Sequence[RowPiece], beyond: float) -> FloatArray:
    """Where pieces begin and end (2 P,), m along their rows, every second one the other way round."""
    ends = np.array([[piece.begin_m - beyond, piece.end_m + beyond] for piece in pieces])
    ends[1::2] = ends[1::2, ::-1]
    return ends.ravel()
