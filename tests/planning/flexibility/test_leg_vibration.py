"""The weights of the snaps against the motion itself: the implicit midpoint rule, run forwards."""

import numpy as np

from cmbot.planning.flexibility import leg_vibration

CARRIERS, JOINTS, MODES = 4, 3, 2


def positive(rng: np.random.Generator, count: int, scale: float) -> np.ndarray:
    """Symmetric positive definite matrices."""
    A = rng.normal(size=(count, CARRIERS, CARRIERS))
    return scale * (A @ A.transpose(0, 2, 1) + CARRIERS * np.eye(CARRIERS))


def test_backwards_is_the_transpose_of_forwards(rng: np.random.Generator) -> None:
    """In blocks of steps, none of them equally long; the second of two cases is another system."""
    counts = np.array([40, 1, 25, 300])
    steps = rng.uniform(1e-3, 5e-3, 4)
    M, K = positive(rng, 4, 1.0), positive(rng, 4, 900.0)
    KB = rng.normal(size=(4, CARRIERS, JOINTS))
    momenta, omega = rng.normal(size=(CARRIERS, MODES)), np.array([20.0, 35.0])
    M, K, KB, momenta, omega = (np.stack([x, 1.5 * x]) for x in (M, K, KB, momenta, omega))
    weights = leg_vibration._weights(M, K, KB, steps, counts, momenta, omega)
    assert weights.shape == (2, counts.sum(), 2 * MODES, JOINTS)

    snap = rng.normal(size=(counts.sum(), JOINTS))
    for case in range(2):
        z, one = np.zeros(2 * CARRIERS), np.eye(2 * CARRIERS)
        for s, block in zip(snap, np.repeat(np.arange(4), counts), strict=True):
            h, G = steps[block], np.linalg.solve(M[case, block], K[case, block])
            damped = -2 * leg_vibration._DAMPING / omega[case, 0] * G
            A = np.block([[np.zeros_like(G), np.eye(CARRIERS)], [-G, damped]])
            force = np.concatenate([np.zeros(CARRIERS), KB[case, block] @ s])
            z = np.linalg.solve(one - h / 2 * A, (one + h / 2 * A) @ z + h * force)
        y, rate = np.split(z, 2)
        expected = np.concatenate([momenta[case].T @ y, momenta[case].T @ rate / omega[case]])
        found = np.einsum("kcj,kj->c", weights[case], snap)
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_blocks_end_at_every_knot() -> None:
    np.testing.assert_allclose(leg_vibration._refined(np.array([0.0, 0.2, 0.25]), 0.1), [0, 0.1, 0.2, 0.25])


def test_amplitudes_of_modes_that_coincide() -> None:
    vibration = np.array([3.0, 0.0, 4.0, 1.0, 0.0, 2.0, 0.0, 0.0])
    np.testing.assert_allclose(leg_vibration.tool_amplitudes(vibration, 2), [6.0, 2.0])
