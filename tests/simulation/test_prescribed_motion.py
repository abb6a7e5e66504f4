"""What prescribes the joints: exactly the trajectory, or the baseline's positions made smooth."""

from __future__ import annotations

import numpy as np
import pytest
from finite_differences import FloatArray

from cmbot.common.errors import InputError
from cmbot.planning import Plan, QuinticTrajectory
from cmbot.simulation import PrescribedMotion


@pytest.fixture
def trajectory(rng: np.random.Generator) -> QuinticTrajectory:
    t = np.array([0.0, 0.3, 1.1, 1.5, 2.7])
    q, v, a = rng.normal(size=(3, 5, 4))
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


def assert_consistent(motion: PrescribedMotion, times: FloatArray) -> None:
    """Rates and accelerations are the derivatives of the positions."""
    h = 1e-5
    q, v, a = motion.states(times)
    for low, high, value in (
        (motion.states(times - h)[0], motion.states(times + h)[0], v),
        (motion.states(times - h)[1], motion.states(times + h)[1], a),
    ):
        np.testing.assert_allclose((high - low) / (2 * h), value, atol=1e-6 * (1 + np.abs(value).max()))
    assert q.shape == v.shape == a.shape


def test_a_trajectory_is_followed_exactly(trajectory: QuinticTrajectory, rng: np.random.Generator) -> None:
    motion = PrescribedMotion.along(trajectory)
    assert motion.duration == trajectory.duration
    times = np.sort(rng.uniform(0, 2.7, 200))
    for left, right in zip(motion.states(times), trajectory.states(times), strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-12, atol=1e-11)
    assert_consistent(motion, times[(times > 0.01) & (times < 2.69)])
    outside, ends = motion.states([-1.0, 9.0]), motion.states([0.0, 2.7])
    np.testing.assert_array_equal(outside[0], ends[0])
    # One that starts late is driven from zero.
    late = QuinticTrajectory(t=trajectory.t + 5.0, q=trajectory.q, v=trajectory.v, a=trajectory.a)
    for left, right in zip(PrescribedMotion.along(late).states(times), motion.states(times), strict=True):
        np.testing.assert_allclose(left, right, atol=1e-10)


def test_samples_are_met_from_rest_to_rest(rng: np.random.Generator) -> None:
    t, q = np.linspace(0, 2, 41), rng.normal(size=(41, 3))
    motion = PrescribedMotion.through(t, q)
    met, v, _ = motion.states(t)
    np.testing.assert_allclose(met, q, atol=1e-13)
    np.testing.assert_allclose(v[[0, -1]], 0.0, atol=1e-12)
    assert_consistent(motion, rng.uniform(0.01, 1.99, 100))
    # Velocity and acceleration do not jump.
    before, after = motion.states(t[1:-1] - 1e-9), motion.states(t[1:-1] + 1e-9)
    np.testing.assert_allclose(before[1], after[1], atol=1e-4)
    np.testing.assert_allclose(before[2], after[2], rtol=1e-4, atol=1e-2)


def test_a_smooth_motion_comes_back_from_its_samples() -> None:
    t = np.linspace(0, 2, 201)
    motion = PrescribedMotion.through(t, np.sin(np.pi * t / 2)[:, None] ** 2)
    times = np.linspace(0, 2, 1777)
    q, v, a = (x[:, 0] for x in motion.states(times))
    np.testing.assert_allclose(q, np.sin(np.pi * times / 2) ** 2, atol=1e-8)
    np.testing.assert_allclose(v, np.pi / 2 * np.sin(np.pi * times), atol=1e-5)
    np.testing.assert_allclose(a, np.pi**2 / 2 * np.cos(np.pi * times), atol=1e-2)


def test_held_joints_do_not_move() -> None:
    q = np.array([0.3, -0.2])
    motion = PrescribedMotion.held(q, 1.5)
    assert motion.duration == 1.5
    positions, rates, accelerations = motion.states([0.0, 0.7, 1.5])
    np.testing.assert_array_equal(positions, [q, q, q])
    np.testing.assert_array_equal(rates, 0.0)
    np.testing.assert_array_equal(accelerations, 0.0)


def test_the_baseline_keeps_its_positions_and_hardly_needs_more_acceleration(triangle_plan: Plan) -> None:
    baseline = triangle_plan.baseline.samples
    motion = PrescribedMotion.through(baseline.t, baseline.q)
    q, v, a = motion.states(baseline.t)
    np.testing.assert_allclose(q, baseline.q, atol=1e-14)
    # The rates of the file are the means to the next sample.
    means = np.diff(baseline.q, axis=0) / np.diff(baseline.t)[:, None]
    np.testing.assert_allclose(means, baseline.v[:-1], atol=1e-9)
    assert np.abs(v - baseline.v).max() < 1.05 * np.abs(np.diff(baseline.v, axis=0)).max()
    assert np.abs(a).max() < 1.3 * np.abs(baseline.a).max()


@pytest.mark.parametrize(
    ("t", "q", "key"),
    [
        ([0.0], [[1.0]], "t"),
        ([0.0, 0.0], [[1.0], [1.0]], "t"),
        ([0.1, 0.2], [[1.0], [1.0]], "t"),
        ([0.0, np.nan], [[1.0], [1.0]], "t"),
        ([0.0, np.inf], [[1.0], [1.0]], "t"),
        ([0.0, 1.0], [[1.0]], "q"),
        ([0.0, 1.0], [1.0, 2.0], "q"),
        ([0.0, 1.0], [[1.0], [np.nan]], "q"),
    ],
)
def test_bad_samples_are_refused(t: list[float], q: list[object], key: str) -> None:
    with pytest.raises(InputError) as caught:
        PrescribedMotion.through(np.array(t), np.array(q))
    assert (caught.value.source, caught.value.key) == ("PrescribedMotion.through", key)
