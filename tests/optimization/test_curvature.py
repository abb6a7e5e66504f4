"""Curvatures of functions of the state, and convex matrices near others."""

import numpy as np
from scipy import sparse

from cmbot.common.arrays import IntArray
from cmbot.optimization.curvature import convexified, state_curvature
from cmbot.optimization.program import Linearization, StateSamples


class Known:
    """Component c: c + 1 times the sum of sin(q) v, and a^2 of the first joint."""

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        q, v, a = states.q, states.v, states.a
        d_a = np.zeros_like(a)
        d_a[:, 0] = 2 * a[:, 0]
        value = (np.sin(q) * v).sum(axis=1) + a[:, 0] ** 2
        return Linearization(value, np.cos(q) * v, np.sin(q), d_a).scaled(1.0 + component)


class Flat(Known):
    """A tool exactly on its leg: its distance has no slope there."""

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        return Linearization(np.zeros(len(states.t)), *3 * (np.zeros(states.q.shape),))


def test_curvature_by_the_state(rng: np.random.Generator) -> None:
    """Where multipliers count, against the second derivatives on paper."""
    q, v, a = rng.normal(size=(3, 4, 2))
    states = StateSamples(np.arange(4.0), q, v, a)
    component, multipliers = np.array([0, 1, 1, 0]), np.array([2.0, 1e-7, 3.0, 0.0])
    active, curvature = state_curvature(Known(), states, component, multipliers, 5.0)
    np.testing.assert_array_equal(active, [0, 2])
    for k, M in zip(active, curvature, strict=True):
        expected = np.zeros((6, 6))
        expected[:2, :2] = np.diag(-np.sin(q[k]) * v[k])
        expected[:2, 2:4] = expected[2:4, :2] = np.diag(np.cos(q[k]))
        expected[4, 4] = 2.0
        weight = multipliers[k] * (1 + component[k])
        np.testing.assert_allclose(M, weight * expected, rtol=0, atol=1e-6 * weight)


def test_what_no_state_changes_does_not_bend() -> None:
    states = StateSamples(np.zeros(2), *3 * (np.zeros((2, 7)),))
    active, curvature = state_curvature(Flat(), states, np.zeros(2, dtype=np.intp), np.ones(2), 1.0)
    assert len(active) == 2
    assert not curvature.any()


def test_convexified(rng: np.random.Generator) -> None:
    sizes = rng.integers(2, 8, 12)
    blocks, ends = np.repeat(np.arange(12), sizes), np.cumsum(sizes)
    near = np.abs(blocks[:, None] - blocks) <= 3
    R = np.where(near, rng.normal(size=near.shape), 0.0)
    H = R + R.T
    got = convexified(sparse.csr_array(H), ends).toarray()
    assert np.linalg.eigvalsh(got).min() > 0
    np.testing.assert_allclose(got, got.T, rtol=0, atol=1e-12 * np.abs(got).max())
    changed = np.abs(got - H) > 1e-12
    assert (blocks[:, None] == blocks)[changed].all()
    definite = sparse.csr_array(H + 2 * np.abs(np.linalg.eigvalsh(H)).max() * np.eye(len(H)))
    assert convexified(definite, ends) is definite
