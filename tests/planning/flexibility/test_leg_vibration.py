"""The weights of the snaps against the motion itself: the implicit midpoint rule, run forwards."""

import numpy as np

from cmbot.planning.flexibility import leg_vibration

CARRIERS, JOINTS, MODES, STEPS = 4, 3, 2, 1203


def positive(rng: np.random.Generator, count: int, scale: float) -> np.ndarray:
    """Symmetric positive definite matrices."""
    A = rng.normal(size=(count, CARRIERS, CARRIERS))
    return scale * (A @ A.transpose(0, 2, 1) + CARRIERS * np.eye(CARRIERS))


def test_backwards_is_the_transpose_of_forwards(rng: np.random.Generator) -> None:
    """Over more steps than are worked out at a time, none of them equally long."""
    grid = np.linspace(0.0, 2.0, 9)
    M, K = positive(rng, 9, 1.0), positive(rng, 9, 900.0)
    KB = rng.normal(size=(9, CARRIERS, JOINTS))
    edges = np.sort(np.concatenate([[0.0, 2.0], rng.uniform(0.0, 2.0, STEPS - 1)]))
    times, steps = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    momenta, omega = rng.normal(size=(CARRIERS, MODES)), np.array([20.0, 35.0])
    weights = leg_vibration._weights(grid, M, K, KB, times, steps, momenta, omega)
    assert weights.shape == (STEPS, 2 * MODES, JOINTS)
    assert STEPS > 2 * leg_vibration._TOGETHER

    snap = rng.normal(size=(STEPS, JOINTS))
    z, one = np.zeros(2 * CARRIERS), np.eye(2 * CARRIERS)
    for t, h, s in zip(times, steps, snap, strict=True):
        at = int(np.searchsorted(grid, t)) - 1
        b = (t - grid[at]) / (grid[at + 1] - grid[at])
        M_t, K_t, KB_t = ((1 - b) * X[at] + b * X[at + 1] for X in (M, K, KB))
        G = np.linalg.solve(M_t, K_t)
        A = np.block([[np.zeros_like(G), np.eye(CARRIERS)], [-G, -2 * leg_vibration._DAMPING / omega[0] * G]])
        force = np.concatenate([np.zeros(CARRIERS), KB_t @ s])
        z = np.linalg.solve(one - h / 2 * A, (one + h / 2 * A) @ z + h * force)
    y, rate = np.split(z, 2)
    expected = np.concatenate([momenta.T @ y, momenta.T @ rate / omega])
    found = np.einsum("kcj,kj->c", weights, snap)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
