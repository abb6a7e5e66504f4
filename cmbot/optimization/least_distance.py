"""The point nearest to a given one, in a metric of one's own, that linear inequalities allow.

Unknowns are few, inequalities may be many: non-negative least squares solve this least-distance problem in a
bounded number of steps, and tell when there is no solution (Lawson and Hanson 1974, Solving Least Squares
Problems, Section 23.4).
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from cmbot.common.arrays import FloatArray

# A row that is smaller than this share of the largest bounds no unknown; a slope that is smaller is none.
_ZERO_ROW_SHARE = 1e-12
# A distance this much larger than the given point's own length is none, and neither is a point that is beyond
# an inequality by so much of that length: where they contradict each other narrowly, round-off decides.
_MAX_DISTANCE_RATIO, _BEYOND = 1e4, 1e-6


def nearest(point: FloatArray, factor: FloatArray, C: FloatArray, room: FloatArray) -> FloatArray | None:
    """Minimise ``|factor.T (x - point)|`` with ``C x <= room``.

    Parameters
    ----------
    point : (n,)
    factor : (n, n)
        Lower triangular.
    C : (m, n)
        Rows that vanish are left out.
    room : (m,)

    Returns
    -------
    array or None
        (n,); None where there is none, or none was found.
    """
    # Importing it takes longer than all of these in a plan, and not every command plans.
    from scipy.optimize import nnls

    width = np.linalg.norm(C, axis=1)
    there = width > _ZERO_ROW_SHARE * width.max(initial=0.0)
    D, left = C[there] / width[there, None], (C[there] @ point - room[there]) / width[there]
    if left.max(initial=0.0) <= 0:
        return point
    # In z = factor' (x - point), in units of the given point's own length: D z <= -left.
    scale = float(np.linalg.norm(factor.T @ point)) or 1.0
    D, left = linalg.solve_triangular(factor, D.T, lower=True).T, left / scale
    n = D.shape[1]
    try:
        u, _ = nnls(np.vstack([-D.T, left]), np.eye(1, n + 1, n)[0])
    except RuntimeError:  # it ended at its iteration limit
        return None
    # That is the squared distance to what is possible in the cone of the rows: 1 / (1 + |z|^2).
    used = 1.0 - float(left @ u)
    z = -D.T @ u
    if used * _MAX_DISTANCE_RATIO**2 < 1.0 or (D @ z + used * left).max() > _BEYOND * used:
        return None
    return np.asarray(point + linalg.solve_triangular(factor, scale * z / used, lower=True, trans="T"))
