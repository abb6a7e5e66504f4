"""Convex hulls, which coal must not be asked to make of what is flat."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from cmbot.common.arrays import FloatArray

__all__ = ["convex_hull", "encloses_volume"]

# Thickness of points as a share of their extent. At about 3e-8 coal's hull crashes the process.
_FLAT = 1e-5


def encloses_volume(points: FloatArray) -> bool:
    """Return whether the hull of `points` (N, 3) has a volume to speak of, whichever way it is turned."""
    if len(points) < 4 or not np.isfinite(points).all():
        return False
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[2] > _FLAT * extents[0])


def convex_hull(points: FloatArray) -> Any:
    """Return the convex hull of `points` (N, 3), a `coal.ConvexBase`; they have to enclose a volume."""
    vertices = coal.StdVec_Vec3s()
    for point in points:
        vertices.append(np.array(point, dtype=float))
    return coal.Convex.convexHull(vertices, False, "Qt")
