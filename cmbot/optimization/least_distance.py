"""The point nearest to a given one, in a metric of one's own, that linear inequalities allow.

Unknowns are few, inequalities may be many: non-negative least squares solve this least-distance problem in a
bounded number of steps, and tell when there is no solution (Lawson and Hanson 1974, Solving Least Squares
Problems, Section 23.4).
"""

from __future__ import annotations

import numpy as np
from scipy import linalg
from scipy.linalg.lapack import dgels

from cmbot.common.arrays import FloatArray

__all__ = ["nearest"]

# A row that is smaller than this share of the largest bounds no unknown; a slope that is smaller is none.
_NOTHING = 1e-12
# A distance this much larger than the given point's own length is none; steps for each unknown until one is
# found.
_FAR, _STEPS = 1e4, 10


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
        (n,); None where there is none, or none was found in a bounded number of steps.
    """
    width = np.linalg.norm(C, axis=1)
    there = width > _NOTHING * width.max(initial=0.0)
    D, left = C[there] / width[there, None], (C[there] @ point - room[there]) / width[there]
    if left.max(initial=0.0) <= 0:
        return point
    # In z = factor' (x - point), in units of the given point's own length: D z <= -left.
    scale = float(np.linalg.norm(factor.T @ point)) or 1.0
    D, left = linalg.solve_triangular(factor, D.T, lower=True).T, left / scale
    n = D.shape[1]
    u = _nonnegative_least_squares(np.vstack([-D.T, left]), np.eye(1, n + 1, n)[0])
    if u is None:
        return None
    # That is the squared distance to what is possible in the cone of the rows: 1 / (1 + |z|^2).
    used = 1.0 - float(left @ u)
    z = -D.T @ u
    if used * _FAR**2 < 1.0:
        return None
    return np.asarray(point + linalg.solve_triangular(factor, scale * z / used, lower=True, trans="T"))


def _nonnegative_least_squares(A: FloatArray, b: FloatArray) -> FloatArray | None:
    """Minimise ``|A u - b|`` with ``u >= 0``: Algorithm NNLS of Lawson and Hanson, Section 23.3.

    SciPy has it, too, but importing `scipy.optimize` takes longer than all of these in a plan.
    """
    # A rotation leaves no more rows than columns, and one.
    R: FloatArray = np.asarray(np.linalg.qr(np.column_stack([A, b]), mode="r"))
    A, b = R[:, :-1], R[:, -1]
    u, free = np.zeros(A.shape[1]), np.zeros(A.shape[1], dtype=np.bool_)
    level = _NOTHING * np.abs(A).sum(axis=0).max() * np.linalg.norm(b)
    for _ in range(_STEPS * len(R)):
        slope = np.where(free, -np.inf, A.T @ (b - A @ u))
        if slope.max(initial=-np.inf) <= level:
            return u
        free[slope.argmax()] = True
        while True:
            best = np.zeros_like(u)
            best[free] = _least_squares(A[:, free], b)
            low = free & (best <= 0)
            if not low.any():
                break
            # As far towards the best as all stay positive; those that vanish there are no longer free.
            share = u[low] / (u[low] - best[low])
            u += share.min() * (best - u)
            free[np.flatnonzero(low)[share <= share.min()]] = False
            u[~free] = 0.0
        u = best
    return None


def _least_squares(A: FloatArray, b: FloatArray) -> FloatArray:
    """Minimise ``|A x - b|``; by QR factorisation, which is quicker, where columns are independent."""
    _, x, dependent = dgels(A, b)
    return np.asarray(np.linalg.lstsq(A, b)[0] if dependent else x[: A.shape[1]])
