"""Piecewise quintics: the paper's coefficients, SciPy's Bernstein polynomials as oracle, exact extrema."""

from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest
from finite_differences import FloatArray
from hypothesis import given, settings, strategies as st
from scipy.interpolate import BPoly

from cmbot.common.errors import InputError
from cmbot.trajectory.quintic import QuinticTrajectory, hermite_coefficients


def random_trajectory(seed: int, m: int = 4, n: int = 3, ratio: float = 20.0) -> QuinticTrajectory:
    """Arbitrary knot values; neighbouring segments differ in length by up to `ratio`."""
    rng = np.random.default_rng(seed)
    h = ratio ** rng.uniform(-1, 0, size=m)
    t = rng.uniform(-3, 3) + np.concatenate([[0.0], np.cumsum(h)])
    q, v, a = rng.normal(size=(3, m + 1, n))
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


def oracle(x: QuinticTrajectory) -> BPoly:
    return BPoly.from_derivatives(x.t, np.stack([x.q, x.v, x.a], axis=1))


def magnitude(x: QuinticTrajectory, order: int) -> float:
    """Size of the terms that derivative `order` is summed from: what rounding is relative to."""
    h = np.diff(x.t)[:, None, None]
    return float((np.abs(x.coefficients) / h**order).max() * 120)


trajectories = st.builds(random_trajectory, st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 3))


def test_coefficients_are_the_papers() -> None:
    rng = np.random.default_rng(0)
    durations = 10 ** rng.uniform(-2, 1, size=5)
    start, end = rng.normal(size=(2, 3, 5, 2))
    got = hermite_coefficients(durations, tuple(start), tuple(end))
    assert got.shape == (5, 2, 6)
    for j, i in np.ndindex(5, 2):
        h = durations[j]
        theta, v_0, a_0 = (x[j, i] for x in start)
        theta_next, v_1, a_1 = (x[j, i] for x in end)
        D = theta_next - theta
        paper = [
            theta,
            v_0,
            a_0 / 2,
            (20 * D - (8 * v_1 + 12 * v_0) * h - (3 * a_0 - a_1) * h**2) / (2 * h**3),
            (-30 * D + (14 * v_1 + 16 * v_0) * h + (3 * a_0 - 2 * a_1) * h**2) / (2 * h**4),
            (12 * D - 6 * (v_1 + v_0) * h - (a_0 - a_1) * h**2) / (2 * h**5),
        ]
        # The package counts time in units of the segment, the paper in seconds.
        np.testing.assert_allclose(got[j, i], np.array(paper) * h ** np.arange(6), rtol=1e-12, atol=1e-12)


@given(trajectories, st.integers(0, 5))
def test_evaluate_agrees_with_bernstein_polynomials(x: QuinticTrajectory, order: int) -> None:
    inside = (x.t[:-1, None] + np.diff(x.t)[:, None] * np.linspace(0.01, 0.99, 9)).ravel()
    expected = oracle(x).derivative(order)(inside) if order else oracle(x)(inside)
    got = x.evaluate(inside, order)
    assert got.shape == (len(inside), x.q.shape[1])
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-11 * magnitude(x, order))


@given(trajectories, st.integers(1, 7))
def test_even_samples_are_the_states_there(x: QuinticTrajectory, samples: int) -> None:
    times = np.linspace(x.t[:-1], x.t[1:], samples, endpoint=False, axis=1).ravel()
    expected = x.states(np.append(times, x.t[-1]))
    for order, (got, states) in enumerate(zip(x.sampled(samples), expected, strict=True)):
        np.testing.assert_allclose(got, states, rtol=0, atol=1e-12 * magnitude(x, order))


@given(trajectories, st.integers(0, 2**32 - 1))
def test_a_motion_moved_to_a_posture_begins_there_exactly(x: QuinticTrajectory, seed: int) -> None:
    q = np.random.default_rng(seed).uniform(-3.0, 3.0, x.q.shape[1])
    moved = x.begun_at(q)
    np.testing.assert_array_equal(moved.q[0], q)
    np.testing.assert_allclose(moved.q - x.q, np.tile(q - x.q[0], (len(x.t), 1)), rtol=0, atol=1e-12)
    np.testing.assert_array_equal([moved.v, moved.a], [x.v, x.a])


@given(trajectories)
def test_the_knots_are_reproduced(x: QuinticTrajectory) -> None:
    for order, (got, knots) in enumerate(zip(x.states(x.t), (x.q, x.v, x.a), strict=True)):
        np.testing.assert_allclose(got, knots, rtol=0, atol=1e-13 * magnitude(x, order))
        np.testing.assert_array_equal(got, x.evaluate(x.t, order))


@given(trajectories)
def test_twice_differentiable_whatever_the_knots(x: QuinticTrajectory) -> None:
    for order in range(3):
        assert np.abs(x.jumps(order)).max(initial=0) < 1e-13 * magnitude(x, order)
        left = np.nextafter(x.t[1:-1], -np.inf)
        near = magnitude(x, order) * 1e-13 + magnitude(x, order + 1) * np.spacing(np.abs(x.t).max())
        np.testing.assert_allclose(x.evaluate(left, order), x.evaluate(x.t[1:-1], order), rtol=0, atol=near)


@given(trajectories, st.integers(0, 5))
def test_jumps_agree_with_bernstein_polynomials(x: QuinticTrajectory, order: int) -> None:
    c = oracle(x).derivative(order).c if order else oracle(x).c
    # The first and last Bernstein coefficients are the values at a segment's ends.
    expected = c[0, 1:] - c[-1, :-1]
    assert x.jumps(order).shape == (len(x.t) - 2, x.q.shape[1])
    np.testing.assert_allclose(x.jumps(order), expected, rtol=0, atol=1e-11 * magnitude(x, order))


def test_at_an_inner_knot_a_jumping_derivative_has_the_later_value() -> None:
    x = random_trajectory(5)
    c = oracle(x).derivative(3).c
    np.testing.assert_allclose(x.evaluate(x.t[:-1], 3), c[0], rtol=1e-9)
    assert np.abs(x.jumps(3)).min() > 1e-6


@settings(max_examples=60)
@given(trajectories, st.integers(0, 4))
def test_extrema_bound_every_time_are_attained_and_have_a_largest(x: QuinticTrajectory, order: int) -> None:
    extrema = x.extrema(order)
    tiny = 1e-12 * magnitude(x, order)
    for j in range(len(x.t) - 1):
        segment = QuinticTrajectory(t=x.t[j : j + 2], q=x.q[j : j + 2], v=x.v[j : j + 2], a=x.a[j : j + 2])
        dense = segment.evaluate(np.linspace(*segment.t, 400), order)
        assert np.all(dense <= extrema.value[j].max(axis=1) + tiny)
        assert np.all(dense >= extrema.value[j].min(axis=1) - tiny)
        for i in range(x.q.shape[1]):
            time = extrema.time[j, i]
            assert np.all(np.diff(time) >= 0)
            # The ends are among them, up to the rounding of t + 1 * h.
            np.testing.assert_allclose(time[[0, -1]], segment.t, rtol=0, atol=1e-14 * np.abs(x.t).max())
            slip = magnitude(x, order + 1) * 1e-14 * np.abs(x.t).max()
            attained = segment.evaluate(time, order)[:, i]
            np.testing.assert_allclose(extrema.value[j, i], attained, rtol=0, atol=tiny + slip)
    value, time = extrema.largest()
    np.testing.assert_array_equal(value, np.abs(extrema.value).max(axis=(0, 2)))
    for i in range(x.q.shape[1]):
        assert time[i] in extrema.time[:, i][np.abs(extrema.value[:, i]) == value[i]]


def test_extrema_of_a_known_motion() -> None:
    # The rest-to-rest quintic 10 u^3 - 15 u^4 + 6 u^5 over T seconds.
    T = 4.0
    x = QuinticTrajectory(t=[0, T], q=[[0.0], [1.0]], v=np.zeros((2, 1)), a=np.zeros((2, 1)))
    expected = [1.0, 15 / 8 / T, 10 / np.sqrt(3) / T**2, 60 / T**3]
    for order, peak in enumerate(expected):
        np.testing.assert_allclose(x.extrema(order).largest()[0], peak, rtol=1e-14)
    np.testing.assert_allclose(x.extrema(1).largest()[1], T / 2)
    # Acceleration and deceleration are equal: either may be named.
    np.testing.assert_allclose(abs(x.extrema(2).largest()[1] - T / 2), T * np.sqrt(3) / 6)


def test_extrema_of_a_trajectory_at_rest_are_zero() -> None:
    x = QuinticTrajectory(t=[0, 1, 3], q=np.full((3, 2), 0.7), v=np.zeros((3, 2)), a=np.zeros((3, 2)))
    np.testing.assert_array_equal(x.extrema(0).largest()[0], [0.7, 0.7])
    for order in range(1, 5):
        assert not x.extrema(order).value.any()


@pytest.mark.parametrize("order", range(6))
def test_times_that_miss_the_ends_by_rounding_count_as_the_ends(order: int) -> None:
    x = random_trajectory(7)
    rounding = 1e-10 * x.duration
    got = x.evaluate([x.t[0] - rounding, x.t[-1] + rounding], order)
    np.testing.assert_array_equal(got, x.evaluate(x.t[[0, -1]], order))


@pytest.mark.parametrize("order", range(6))
@pytest.mark.parametrize("miss", [-np.inf, -5.0, -1e-8, 1e-8, 5.0, np.inf, np.nan])
def test_times_outside_are_refused(order: int, miss: float) -> None:
    x = random_trajectory(7)
    end = x.t[0] if miss < 0 else x.t[-1]
    with pytest.raises(InputError, match=r"QuinticTrajectory: times: got .* s, expected times from "):
        x.evaluate([x.t[0], end + miss * x.duration], order)


@pytest.mark.parametrize("times", ["soon", ["0.1", "later"], [[0.1], [0.2, 0.3]], [object()]])
def test_times_that_are_no_numbers_are_refused(times: Any) -> None:
    with pytest.raises(InputError, match=r"times: got .*expected a row of numbers, s"):
        random_trajectory(0).evaluate(times)
    with pytest.raises(InputError, match=r"times: got 0.01, expected a row of numbers, s: \[0.01\]"):
        random_trajectory(0).evaluate(0.01)


def test_duration_no_times_and_derivatives_beyond_the_fifth() -> None:
    x = random_trajectory(2)
    assert x.duration == x.t[-1] - x.t[0]
    assert x.evaluate([]).shape == (0, 3)
    assert not x.evaluate(x.t, 6).any()


GOOD = {"t": [0.0, 1.0, 3.0], "q": np.zeros((3, 2)), "v": np.zeros((3, 2)), "a": np.zeros((3, 2))}
WRONG_SHAPES: list[tuple[int, ...]] = [(), (3,), (4, 2), (3, 3), (3, 2, 1)]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("t", [[0.0, 1.0, 3.0]], "finite, increasing times"),
        ("t", 0.0, "finite, increasing times"),
        ("t", [0.0], "finite, increasing times"),
        ("t", [], "finite, increasing times"),
        ("t", [0.0, 1.0, 1.0], "finite, increasing times"),
        ("t", [0.0, 2.0, 1.0], "finite, increasing times"),
        ("t", [0.0, 1e-12, 1.0], "1e-09 s or more apart"),
        ("t", [0.0, np.nan, 1.0], "finite, increasing times"),
        ("t", [0.0, 1.0, np.inf], "finite, increasing times"),
        ("t", [-np.inf, 1.0, 2.0], "finite, increasing times"),
        ("t", [0.0, 1.0], "one row per knot"),
        *((key, np.zeros(shape), "one row per knot") for key in "qva" for shape in WRONG_SHAPES),
        *((key, [[0, 0], [0, bad], [0, 0]], "finite") for key in "qva" for bad in (np.nan, np.inf, 1e300)),
    ],
)
def test_wrong_knots_are_refused(key: str, value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        QuinticTrajectory(**{**GOOD, key: value})
    assert caught.value.source == "QuinticTrajectory"
    # The number of joints is q's, so a q of another width shows at v.
    assert caught.value.key in {key, "v" if key == "q" else "q" if key == "t" else key}


def test_the_knots_cannot_be_changed() -> None:
    given_arrays = {key: np.array(value, dtype=float) for key, value in GOOD.items()}
    x = QuinticTrajectory(**given_arrays)
    for key, array in given_arrays.items():
        kept = getattr(x, key)
        assert not np.shares_memory(kept, array)
        assert array.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            kept[0] = 1.0
        with pytest.raises(FrozenInstanceError):
            setattr(x, key, array)


def test_lists_and_whole_numbers_are_taken_as_floats() -> None:
    x = QuinticTrajectory(t=[0, 1], q=[[0], [1]], v=[[0], [0]], a=[[0], [0]])
    assert all(getattr(x, key).dtype == float for key in GOOD)
    np.testing.assert_allclose(x.evaluate([0.5]), [[0.5]])


def assert_consistent(motion: QuinticTrajectory, times: FloatArray) -> None:
    """Rates and accelerations are the derivatives of the positions."""
    h = 1e-5
    q, v, a = motion.states(times)
    for low, high, value in (
        (motion.states(times - h)[0], motion.states(times + h)[0], v),
        (motion.states(times - h)[1], motion.states(times + h)[1], a),
    ):
        np.testing.assert_allclose((high - low) / (2 * h), value, atol=1e-6 * (1 + np.abs(value).max()))
    assert q.shape == v.shape == a.shape


def test_samples_are_met_from_rest_to_rest(rng: np.random.Generator) -> None:
    t, q = np.linspace(0, 2, 41), rng.normal(size=(41, 3))
    motion = QuinticTrajectory.through(t, q)
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
    motion = QuinticTrajectory.through(t, np.sin(np.pi * t / 2)[:, None] ** 2)
    times = np.linspace(0, 2, 1777)
    q, v, a = (x[:, 0] for x in motion.states(times))
    np.testing.assert_allclose(q, np.sin(np.pi * times / 2) ** 2, atol=1e-8)
    np.testing.assert_allclose(v, np.pi / 2 * np.sin(np.pi * times), atol=1e-5)
    np.testing.assert_allclose(a, np.pi**2 / 2 * np.cos(np.pi * times), atol=1e-2)


def test_held_joints_do_not_move() -> None:
    q = np.array([0.3, -0.2])
    motion = QuinticTrajectory.held(q, 1.5)
    assert motion.duration == 1.5
    positions, rates, accelerations = motion.states([0.0, 0.7, 1.5])
    np.testing.assert_array_equal(positions, [q, q, q])
    np.testing.assert_array_equal(rates, 0.0)
    np.testing.assert_array_equal(accelerations, 0.0)


@pytest.mark.parametrize(
    ("t", "q", "key"),
    [
        ([0.0], [[1.0]], "t"),
        ([0.0, 0.0], [[1.0], [1.0]], "t"),
        ([0.0, np.nan], [[1.0], [1.0]], "t"),
        ([0.0, np.inf], [[1.0], [1.0]], "t"),
        ([0.0, 1.0], [[1.0]], "q"),
        ([0.0, 1.0], [1.0, 2.0], "q"),
        ([0.0, 1.0], [[1.0], [np.nan]], "q"),
    ],
)
def test_bad_samples_are_refused(t: list[float], q: list[object], key: str) -> None:
    with pytest.raises(InputError) as caught:
        QuinticTrajectory.through(np.array(t), np.array(q))
    assert (caught.value.source, caught.value.key) == ("QuinticTrajectory", key)
