"""Beam theory by other means: sections as polygons, a cantilever in closed form and vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def angle_outline(leg: float, thickness: float) -> FloatArray:
    """Corners (6, 2) of an angle whose legs point along the first and the second axis, counter-clockwise."""
    a, t = leg, thickness
    return np.array([(0, 0), (a, 0), (a, t), (t, t), (t, a), (0, a)], dtype=float)


def polygon(corners: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Area, centroid (2,) and second moments ∫ r r^T dA (2, 2) about the centroid, by Green's theorem."""
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]
    area = cross.sum() / 2
    centroid = np.einsum("k,ki->i", cross, corners + following) / (6 * area)
    both = corners + following
    moments = np.einsum("k,ki,kj->ij", cross, corners, corners)
    moments += np.einsum("k,ki,kj->ij", cross, following, following)
    moments += np.einsum("k,ki,kj->ij", cross, both, both)
    return float(area), centroid, moments / 24 - area * np.outer(centroid, centroid)


def cantilever(
    *, along: ArrayLike, moments: FloatArray, young: float, axial: float, torsional: float
) -> FloatArray:
    """Compliance (6, 6) of a cantilever's tip in W, linear then angular.

    `along` (3,) leads from the clamp to the tip; `moments` (3, 3) is ∫ r r^T dA of the section in W, m4;
    `axial` and `torsional` are E A, N, and G J, N m2.
    """
    along = np.asarray(along, dtype=float)
    L = float(np.linalg.norm(along))
    e = along / L
    # A load bends the axis u by u'' = S (f (L - s) + m x e) / E, and the rotation is e x u'.
    S = np.linalg.pinv(moments, rcond=1e-9) / young
    across = np.cross(np.eye(3), e).T  # m -> m x e
    turn = np.cross(e, np.eye(3)).T  # u' -> e x u'
    C = np.zeros((6, 6))
    C[:3, :3] = S * L**3 / 3 + np.outer(e, e) * L / axial
    C[:3, 3:] = S @ across * L**2 / 2
    C[3:, :3] = turn @ S * L**2 / 2
    C[3:, 3:] = turn @ S @ across * L + np.outer(e, e) * L / torsional
    return C


def angle_cantilever(
    along: ArrayLike, leg: float, thickness: float, axes: ArrayLike, young: float = 206e9, shear: float = 79e9
) -> FloatArray:
    """The same for an angle whose legs point along the rows of `axes` (2, 3); torsion of two thin walls."""
    area, _, moments = polygon(angle_outline(leg, thickness))
    return cantilever(
        along=along,
        moments=np.transpose(axes) @ moments @ np.asarray(axes),
        young=young,
        axial=young * area,
        torsional=shear * area * thickness**2 / 3,
    )
