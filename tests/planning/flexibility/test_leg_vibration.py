"""The weights of the snaps against the motion itself: the implicit midpoint rule, run forwards."""

from dataclasses import fields

import numpy as np

from cmbot.planning.flexibility import leg_vibration

CARRIERS, JOINTS, MODES = 4, 3, 2


def positive(rng: np.random.Generator, count: int, scale: float) -> np.ndarray:
    """Symmetric positive definite matrices."""
    A = rng.normal(size=(count, CARRIERS, CARRIERS))
    return scale * (A @ A.transpose(0, 2, 1) + CARRIERS * np.eye(CARRIERS))


def carried(rng: np.random.Generator, blocks: int) -> leg_vibration._Carried:
    """Two cases of a system, the second of them another one, with forces by the rates of no symmetry."""
    n = blocks + 1
    found = leg_vibration._Carried(
        mass=positive(rng, n, 1.0),
        damping=rng.normal(size=(n, CARRIERS, CARRIERS)),
        stiffness=positive(rng, n, 900.0),
        response=rng.normal(size=(n, CARRIERS, JOINTS)),
        momenta=rng.normal(size=(CARRIERS, MODES)),
        omega=np.array([20.0, 35.0]),
        to_tool=rng.uniform(size=MODES),
    )
    both = {each.name: getattr(found, each.name) for each in fields(found)}
    return leg_vibration._Carried(**{name: np.stack([x, 1.5 * x]) for name, x in both.items()})


def test_backwards_is_the_transpose_of_forwards(rng: np.random.Generator) -> None:
    """In blocks of steps, none of them equally long."""
    doublings = np.array([5, 0, 3, 8])
    counts = 2**doublings
    steps = rng.uniform(1e-3, 5e-3, 4)
    system = carried(rng, 4)
    blocks = leg_vibration._blocks(system, steps, doublings)
    weights = leg_vibration._weights(system, blocks)
    assert weights.shape == (2 * len(counts), 2, 2 * MODES, JOINTS)

    # Linear in each block; of a single step both ends are one.
    ends = rng.normal(size=(len(counts), 2, JOINTS))
    ends[counts == 1, 1] = ends[counts == 1, 0]
    snap = np.concatenate([np.linspace(*both, count) for both, count in zip(ends, counts, strict=True)])
    for case in range(2):
        z, one = np.zeros(2 * CARRIERS), np.eye(2 * CARRIERS)
        for s, block in zip(snap, np.repeat(np.arange(4), counts), strict=True):
            M, D, K = (x[case, block] for x in (system.mass, system.damping, system.stiffness))
            h, G = steps[block], np.linalg.solve(M, K)
            A = np.block([[np.zeros_like(G), np.eye(CARRIERS)], [-G, -np.linalg.solve(M, D)]])
            force = np.concatenate([np.zeros(CARRIERS), system.response[case, block] @ s])
            z = np.linalg.solve(one - h / 2 * A, (one + h / 2 * A) @ z + h * force)
        y, rate = np.split(z, 2)
        momenta = system.momenta[case]
        both = np.stack([momenta.T @ y, momenta.T @ rate / system.omega[case]])
        expected = (both * system.to_tool[case]).ravel()
        found = np.einsum("kcj,kj->c", weights[:, case], ends.reshape(-1, JOINTS))
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_blocks_end_at_every_knot() -> None:
    np.testing.assert_allclose(leg_vibration._refined(np.array([0.0, 0.2, 0.25]), 0.1), [0, 0.1, 0.2, 0.25])


def test_amplitudes_of_modes_that_coincide() -> None:
    vibration = np.array([3.0, 0.0, 4.0, 1.0, 0.0, 2.0, 0.0, 0.0])
    np.testing.assert_allclose(leg_vibration.tool_amplitudes(vibration, 2), [6.0, 2.0])
