"""Small linear systems, thousands at once.

Components lead and systems trail, so that every operation runs along systems. For a few unknowns each that is
several times as quick as LAPACK, called for one system after the other.
"""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray

__all__ = ["gram", "null_directions", "solved"]

# In place of a length of zero, by which nothing is divided then.
_TINY = 1e-300


def gram(A: FloatArray, more: float = 0.0) -> FloatArray:
    """Return the matrices (m, m, N) ``A A^T + more I`` of `A` (m, n, N)."""
    G = np.einsum("ikn,jkn->ijn", A, A)
    G[np.diag_indices(len(A))] += more
    return np.asarray(G)


def solved(G: FloatArray, b: FloatArray) -> FloatArray:
    """Return what symmetric, positive definite `G` (m, m, N) take to `b` (m, k, N), of the same shape."""
    G, x = G.copy(), b.copy()
    # Gauss's elimination, which needs no pivots here (Golub and Van Loan, Matrix Computations, Section 4.1).
    for i in range(len(G)):
        share = G[i + 1 :, i] / G[i, i]
        G[i + 1 :, i + 1 :] -= share[:, None] * G[i, i + 1 :]
        x[i + 1 :] -= share[:, None] * x[i]
    for i in reversed(range(len(G))):
        x[i] /= G[i, i]
        x[:i] -= G[:i, i, None] * x[i]
    return x


def null_directions(A: FloatArray) -> FloatArray:
    """Return orthonormal bases (n - m, n, N) of what matrices `A` (m, n, N) take to nothing.

    They are the last columns of the orthogonal factor of ``A^T``, a product of Householder's reflections
    (Golub and Van Loan, Section 5.2).
    """
    A = A.copy()
    m, n, number = A.shape
    reflections = []
    for i in range(min(m, n)):
        v = A[i, i:]
        norm = np.sqrt((v * v).sum(axis=0))
        share = 1.0 / np.maximum(norm * (norm + np.abs(v[0])), _TINY)
        v[0] += np.copysign(norm, v[0])
        _reflect(A[i + 1 :, i:], v, share)
        reflections.append((v, share))
    N = np.zeros((max(n - m, 0), n, number))
    for k, direction in enumerate(N):
        direction[m + k] = 1.0
    for i in reversed(range(len(reflections))):
        _reflect(N[:, i:], *reflections[i])
    return N


def _reflect(vectors: FloatArray, v: FloatArray, share: FloatArray) -> None:
    """Take ``share v v^T`` off `vectors` (k, n, N), in place; `v` is (n, N), `share` (N,)."""
    vectors -= (share * np.einsum("kjn,jn->kn", vectors, v))[:, None] * v
