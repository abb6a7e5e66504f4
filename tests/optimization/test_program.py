"""States, linearizations and bounds: the data that a program is made of."""

import numpy as np
import pytest

from cmbot.optimization.program import KinematicBound, Linearization, StateSamples
from cmbot.trajectory.quintic import QuinticTrajectory


@pytest.fixture
def states(rng: np.random.Generator) -> StateSamples:
    return StateSamples(np.arange(6.0), *rng.normal(size=(3, 6, 2)))


def test_states_can_be_picked(states: StateSamples) -> None:
    picked = states[np.array([4, 1])]
    for name in ("t", "q", "v", "a"):
        np.testing.assert_array_equal(getattr(picked, name), getattr(states, name)[[4, 1]])
    np.testing.assert_array_equal(states[1:3].q, states.q[1:3])


def test_what_functions_share_is_computed_once(states: StateSamples) -> None:
    asked: list[StateSamples] = []

    def mean(of: StateSamples) -> float:
        asked.append(of)
        return float(of.q.mean())

    assert (
        states.computed("mean", lambda: mean(states))
        == states.computed("mean", lambda: mean(states))
        == states.q.mean()
    )
    assert states.computed("another", lambda: 2 * mean(states)) == 2 * states.q.mean()
    # What is picked of them is something else.
    assert states[:2].computed("mean", lambda: mean(states[:2])) == states.q[:2].mean()
    assert [len(each.t) for each in asked] == [6, 6, 2]


def test_states_along_a_trajectory_and_at_rest(states: StateSamples) -> None:
    trajectory = QuinticTrajectory(t=states.t, q=states.q, v=states.v, a=states.a)
    along = StateSamples.along(trajectory, np.array([0.5, 3.0]))
    for order, name in enumerate("qva"):
        np.testing.assert_allclose(getattr(along, name), trajectory.evaluate(along.t, order), atol=1e-12)
    still = StateSamples.at_rest(states.t, states.q)
    np.testing.assert_array_equal(still.q, states.q)
    assert not (still.v.any() or still.a.any())


@pytest.mark.parametrize("factor", [3.0, np.arange(4.0)])
def test_scaled(factor: float | np.ndarray, rng: np.random.Generator) -> None:
    at = Linearization(rng.normal(size=4), *rng.normal(size=(3, 4, 2)))
    scaled, each = at.scaled(factor), np.broadcast_to(factor, 4)
    for k in range(4):
        assert scaled.value[k] == each[k] * at.value[k]
        np.testing.assert_array_equal(scaled.derivatives[:, k], each[k] * at.derivatives[:, k])


def test_kinematic_bounds() -> None:
    """Shares of the scale; even components are upper bounds, odd ones lower."""
    scale = np.array([2.0, 4.0])
    bound = KinematicBound(1, np.array([-1.0, -3.0]), np.array([2.0, 5.0]), scale, "velocity")
    v = np.array([[3.0, 0.0], [0.0, -5.0], [-2.0, 6.0]])
    np.testing.assert_allclose(bound.above(v), (v - [2, 5]) / scale)
    np.testing.assert_allclose(bound.below(v), ([-1, -3] - v) / scale)
    value, slope = bound.values(v, np.array([0, 3, 1]))
    np.testing.assert_allclose(value, [0.5, 0.5, 0.5])
    np.testing.assert_allclose(slope, [[0.5, 0], [0, -0.25], [-0.5, 0]])
