"""The smallest change that moves some linear quantities by given amounts, others by no more than they may.

Unknowns are few, quantities may be many: equations are eliminated, and what is left is a least-distance
problem, which non-negative least squares solve in a bounded number of steps, and which tells when there is no
solution (Lawson and Hanson 1974, Solving Least Squares Problems, Section 23.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize

from cmbot.common.arrays import FloatArray

__all__ = ["LeastChange", "least_distance"]

# Share of their own size that is added to the equations' covariance: those that are nearly the same share
# their multiplier.
_ALIKE = 1e-5
# A quantity whose derivative is smaller than this share of the largest is changed by no unknown.
_NOTHING = 1e-12
# Equations count as met when so much of their amounts is missing; else what is missing of all of them alike
# costs this much more than the change, and much less than what is missing of each.
_MET, _WEIGHT = 0.1, 1e3
# A change this much larger than without inequalities is none; steps for each unknown until one is found.
_FAR, _STEPS = 1e4, 10


@dataclass(frozen=True)
class LeastChange:
    """A change x (n,), and the share of the equations' amounts that it brings."""

    x: FloatArray
    share: float


def least_distance(E: FloatArray, amounts: FloatArray, C: FloatArray, room: FloatArray) -> LeastChange | None:
    """Minimise ``|x|`` with ``E x = amounts`` and ``C x <= room``.

    Where that is impossible, the largest share of the amounts that is possible is taken instead.

    Parameters
    ----------
    E : (k, n)
        Rows that are nearly the same are met as far as one change meets them all.
    amounts : (k,)
    C : (m, n)
        Rows that vanish are left out.
    room : (m,)

    Returns
    -------
    LeastChange or None
        None where no share of the amounts is possible, or none was found in a bounded number of steps.
    """
    (k, n), size = E.shape, np.linalg.norm(E, axis=1)
    if size.min() <= _NOTHING * size.max():
        return None
    A, b = np.hstack([E / size[:, None], np.sqrt(_ALIKE) * np.eye(k)]), amounts / size
    width = np.linalg.norm(C, axis=1)
    there = width > _NOTHING * width.max(initial=0.0)
    D, c = C[there] / width[there, None], room[there] / width[there]
    # Without inequalities the change has length 1.
    scale = float(np.linalg.norm(linalg.lstsq(A, b)[0])) or 1.0
    b, c = b / scale, c / scale
    x = _least_distance(A, b, np.pad(D, ((0, 0), (0, k))), c)
    if x is not None and np.linalg.norm(A[:, :n] @ x[:n] - b) <= _MET * np.linalg.norm(b):
        return LeastChange(scale * x[:n], 1.0)
    if not b.any():
        return None
    # One more unknown: the share that is missing, times the root of its weight.
    A = np.column_stack([A, b * np.sqrt(1 / _WEIGHT)])
    x = _least_distance(A, b, np.pad(D, ((0, 0), (0, k + 1))), c)
    share = 0.0 if x is None else float(b @ (A[:, :n] @ x[:n]) / (b @ b))
    return None if x is None or share <= 0 else LeastChange(scale * x[:n], min(share, 1.0))


def _least_distance(A: FloatArray, b: FloatArray, D: FloatArray, c: FloatArray) -> FloatArray | None:
    """Smallest x (n,) with ``A x = b`` and ``D x <= c``; A has full row rank."""
    k = len(b)
    Q, R = linalg.qr(A.T)
    x = Q[:, :k] @ linalg.solve_triangular(R[:k], b, trans="T")
    Z, left = Q[:, k:], D @ x - c
    if left.max(initial=0.0) <= 0:
        return np.asarray(x)
    try:
        u = optimize.nnls(
            np.vstack([-(D @ Z).T, left]), np.eye(1, Z.shape[1] + 1, Z.shape[1])[0], maxiter=_STEPS * len(Q)
        )[0]
    except RuntimeError:
        return None
    # That is the squared distance to what is possible in the cone of the rows: 1 / (1 + |y|^2).
    used = 1.0 - float(left @ u)
    y = -Z.T @ (D.T @ u)
    if used * _FAR**2 < 1.0:
        return None
    return np.asarray(x + Z @ (y / used))
