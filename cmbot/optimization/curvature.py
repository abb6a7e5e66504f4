"""Second derivatives of the torque problem's Lagrangian, and what a convex model takes from them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import linalg, sparse

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.optimization.program import StateFunction, StateSamples

# Sites whose multiplier is below this share of all do not bend anything.
_NEGLIGIBLE_MULTIPLIER_SHARE = 1e-5
# Step of the forward differences of exact first derivatives, for states in units of about 1.
_FORWARD_STEP = 1e-8
# What is coupled is at most so many blocks apart.
_BANDWIDTH = 3
# Least curvature of a convexified model.
_MIN_CURVATURE = 1e-9


def state_curvature(
    function: StateFunction,
    states: StateSamples,
    component: IntArray,
    multipliers: FloatArray,
    total: float,
) -> tuple[IntArray, FloatArray]:
    """Curvatures of ``multipliers_k f(state_k)`` by the N states, where they matter.

    `component` (N,) is the function's that counts at each state; multipliers (N,) are compared with `total`.
    Returns which of the states bend anything, (A,), and their curvatures by position, velocity and
    acceleration, (A, 3 d, 3 d).
    """
    active = np.flatnonzero(multipliers > _NEGLIGIBLE_MULTIPLIER_SHARE * total)
    states, component, multipliers = states[active], component[active], multipliers[active]
    N, d = states.q.shape
    M = np.zeros((N, 3 * d, 3 * d))
    here = _gradients(function, states, component)
    columns = np.flatnonzero(here.any(axis=0).reshape(3, d).any(axis=1).repeat(d))
    # Without sites, or where gradients vanish, nothing bends.
    if N and len(columns):
        x = np.hstack([states.q, states.v, states.a])
        ahead = np.repeat(x[None], len(columns), axis=0)
        ahead[np.arange(len(columns)), :, columns] += _FORWARD_STEP
        q, v, a = (ahead[:, :, part * d : (part + 1) * d].reshape(-1, d) for part in range(3))
        there = StateSamples(np.tile(states.t, len(columns)), q, v, a)
        gradients = _gradients(function, there, np.tile(component, len(columns)))
        M[:, columns] = ((gradients.reshape(len(columns), N, -1) - here) / _FORWARD_STEP).transpose(1, 0, 2)
        M = 0.5 * multipliers[:, None, None] * (M + M.transpose(0, 2, 1))
    return active, M


def _gradients(function: StateFunction, states: StateSamples, component: IntArray) -> FloatArray:
    at = function.linearize(states, component)
    return np.hstack([at.d_q, at.d_v, at.d_a])


def convexified(H: sparse.csr_array, ends: IntArray) -> sparse.csr_array:
    """Return a positive definite matrix near the symmetric `H` (n, n), equal to it if that is so already.

    Block by block along the path, as a Cholesky factorisation would go: what is left of a diagonal block once
    those before are eliminated has its negative eigenvalues turned positive. Entries couple blocks at most
    three apart; `ends` (b,) is where blocks of neighbouring unknowns end.
    """
    starts = np.concatenate([[0], ends])
    far = starts[np.minimum(np.arange(len(starts)) + _BANDWIDTH + 1, len(ends))]
    width = int((far - starts).max(initial=1))
    band = _banded(H, width)
    if linalg.lapack.dpbtrf(band.T, lower=1)[1] == 0:
        return H
    return sparse.csr_array(H + _corrections(band, starts))


def _banded(H: sparse.csr_array, width: int) -> FloatArray:
    """Rows (n, width) of the upper triangle of `H`: entry (i, k) couples i and i + k."""
    H.sum_duplicates()
    row = np.repeat(np.arange(H.shape[0]), np.diff(H.indptr))
    upper = row <= H.indices
    band = np.zeros((H.shape[0], width))
    band[row[upper], H.indices[upper] - row[upper]] = H.data[upper]
    return band


def _corrections(band: FloatArray, starts: IntArray) -> sparse.csr_array:
    n, width = band.shape
    padded = np.pad(band, ((0, width), (0, 0)))
    offset = np.arange(width)
    row, beyond = np.minimum.outer(offset, offset), np.abs(np.subtract.outer(offset, offset))
    rows, columns, values = [], [], []
    schur = np.zeros((width, width))
    for start, end in pairwise(starts):
        m = end - start
        A = padded[start + row, beyond] - schur
        L, failed = linalg.lapack.dpotrf(A[:m, :m], lower=1)
        if failed or L.diagonal().min() ** 2 < _MIN_CURVATURE:
            eigenvalues, V = np.linalg.eigh(A[:m, :m])
            wanted = np.maximum(np.abs(eigenvalues), _MIN_CURVATURE)
            index = np.arange(start, end)
            rows.append(np.repeat(index, m))
            columns.append(np.tile(index, m))
            values.append(((V * (wanted - eigenvalues)) @ V.T).ravel())
            X = (V / np.sqrt(wanted)).T @ A[:m, m:]
        else:
            X = linalg.lapack.dtrtrs(L, A[:m, m:], lower=1)[0]
        rest = schur[m:, m:] + X.T @ X
        schur = np.zeros((width, width))
        schur[: width - m, : width - m] = rest
    if not rows:
        return sparse.csr_array((n, n))
    return sparse.csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)
    )
