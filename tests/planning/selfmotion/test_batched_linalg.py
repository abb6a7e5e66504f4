"""Small linear systems, many at once, against LAPACK, one at a time."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cmbot.planning.selfmotion.batched_linalg import gram, null_directions, solved

sizes = st.integers(1, 7)
seeds = st.integers(0, 2**32 - 1)


@given(seeds, sizes, st.integers(1, 3), st.integers(0, 20))
def test_solutions_are_those_of_lapack(seed: int, m: int, k: int, number: int) -> None:
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(m, m + 2, number)), rng.normal(size=(m, k, number))
    G = gram(A, 0.1)
    for i in range(number):
        np.testing.assert_allclose(G[..., i], A[..., i] @ A[..., i].T + 0.1 * np.eye(m), atol=1e-13)
    before = G.copy(), b.copy()
    x = solved(G, b)
    assert x.shape == b.shape
    for i in range(number):
        expected = np.linalg.solve(G[..., i], b[..., i])
        np.testing.assert_allclose(x[..., i], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_array_equal(G, before[0])
    np.testing.assert_array_equal(b, before[1])


@given(seeds, sizes, sizes, st.integers(0, 20))
def test_null_directions_are_orthonormal_and_all_there_are(seed: int, m: int, n: int, number: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(m, n, number))
    before = A.copy()
    N = null_directions(A)
    d = max(n - m, 0)
    assert N.shape == (d, n, number)
    for i in range(number):
        np.testing.assert_allclose(N[..., i] @ N[..., i].T, np.eye(d), atol=1e-12)
        np.testing.assert_allclose(A[..., i] @ N[..., i].T, 0.0, atol=1e-12)
    np.testing.assert_array_equal(A, before)


def test_null_directions_where_rows_depend_on_each_other_or_are_zero(rng: np.random.Generator) -> None:
    A = rng.normal(size=(5, 7, 3))
    A[4, :, 0] = A[3, :, 0]
    A[2, :, 1] = 0.0
    A[:, :, 2] = 0.0
    N = null_directions(A)
    for i in range(3):
        np.testing.assert_allclose(N[..., i] @ N[..., i].T, np.eye(2), atol=1e-12)
        np.testing.assert_allclose(A[..., i] @ N[..., i].T, 0.0, atol=1e-12)
