"""Separation: cheaper than evaluating everywhere, and finding the same."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from small_scenes import problem_of, short_scene

from cmbot.optimization import separation
from cmbot.optimization.constraint_set import OBJECTIVE, ConstraintSet
from cmbot.optimization.program import KinematicBound, StateSamples
from cmbot.optimization.separation import find_violations, violated_bound
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.trajectory import quintic as trajectory
from cmbot.trajectory.quintic import QuinticTrajectory

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def problem() -> TorqueProblem:
    return problem_of(short_scene())


def smooth(seed: int, knots: int = 8, joints: int = 7) -> QuinticTrajectory:
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0 * (knots - 1), knots)
    q, v, a = rng.normal(size=(3, knots, joints)) * np.array([0.3, 0.3, 0.5])[:, None, None]
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


@given(seeds, st.integers(1, 700))
def test_blocks_of_times_change_nothing(seed: int, number: int) -> None:
    some = smooth(seed)
    times = np.sort(np.random.default_rng(seed).uniform(some.t[0], some.t[-1], number))
    whole = some.states(times)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory, "_TIMES_PER_BLOCK", 7)
        for here, there in zip(whole, some.states(times), strict=True):
            np.testing.assert_array_equal(here, there)
    for order, here in enumerate(whole):
        np.testing.assert_array_equal(here, some.evaluate(times, order))


@given(seeds, st.integers(0, 4))
def test_hulls_hold_what_the_polynomials_do(seed: int, order: int) -> None:
    some = smooth(seed)
    low, high = some.hull(order)
    extrema = some.extrema(order).value
    slack = 1e-12 * np.abs(extrema).max()
    assert (low - slack <= extrema.min(axis=2)).all()
    assert (extrema.max(axis=2) <= high + slack).all()


@settings(max_examples=30)
@given(seeds, st.integers(0, 4), st.floats(0.01, 2.0), st.sampled_from([1e-5, 0.3]))
def test_violated_bounds_are_those_of_all_extrema(
    seed: int, order: int, size: float, tolerance: float
) -> None:
    some = smooth(seed)
    rng = np.random.default_rng(seed)
    extrema = some.extrema(order)
    scale = size * np.abs(extrema.value).max(axis=(0, 2)) * rng.uniform(0.5, 1.0, 7)
    bound = KinematicBound(order, -0.9 * scale, scale, scale, "bound")
    over = (extrema.value - bound.high[:, None]) / scale[:, None]
    under = (bound.low[:, None] - extrema.value) / scale[:, None]
    value = np.stack([over, under], axis=2)
    found = violated_bound(some, bound, tolerance)
    if value.max() > tolerance:
        assert found.largest == pytest.approx(value.max(), abs=1e-12)
        assert found.joint == np.unravel_index(value.argmax(), value.shape)[1]
    else:
        # Where nothing can be broken, extrema between the knots are not looked for.
        there = some.evaluate(some.t, order)
        at_knots = np.maximum(bound.above(there), bound.below(there))
        assert at_knots.max() - 1e-12 <= found.largest <= value[:, found.joint].max() + 1e-12
    segment, joint, side = np.nonzero(value.max(axis=3) > tolerance)
    worst = value[segment, joint, side]
    expected = extrema.time[segment, joint, worst.argmax(axis=1)]
    order_ = np.argsort(-worst.max(axis=1))
    np.testing.assert_allclose(found.times, expected[order_], atol=1e-12)
    np.testing.assert_array_equal(found.component, (2 * joint + side)[order_])


def wild(problem: TorqueProblem, size: float = 40.0) -> QuinticTrajectory:
    form = problem.parametrization
    x = np.random.default_rng(3).normal(size=form.dimension)
    return form.step(0.05 * size * x).trajectory


def test_blocks_of_states_change_nothing(problem: TorqueProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    some = wild(problem, 1.0)
    whole = find_violations(problem, some, 0.5, 1e-6, 1000)
    monkeypatch.setattr(separation, "_STATES_PER_BLOCK", 9)
    blocks = find_violations(problem, some, 0.5, 1e-6, 1000)
    np.testing.assert_array_equal(whole.family, blocks.family)
    np.testing.assert_allclose(whole.time, blocks.time, rtol=0, atol=1e-9)


@pytest.mark.parametrize("size", [0.2, 2.0, 40.0])
def test_the_worst_constraint_is_told_with_its_time(problem: TorqueProblem, size: float) -> None:
    """Dense samples of all constraints are largest there."""
    some = wild(problem, size)
    worst = find_violations(problem, some, np.inf, 1e-6, 1000).worst
    assert worst.time is not None
    times = np.union1d(np.linspace(some.t[0], some.t[-1], 20001), [*some.t - 1e-9, *some.t + 1e-9])[1:-1]
    dense = {
        each.name: each.sample(StateSamples.along(some, times))[0].max(axis=1) for each in problem.constraints
    }
    for each in problem.bounds:
        values = some.evaluate(times, each.order)
        for joint, over in zip(
            problem.joints, np.maximum(each.above(values), each.below(values)).T, strict=True
        ):
            dense[f"{each.name} of {joint}"] = over
    name = max(dense, key=lambda each: dense[each].max())
    assert worst.name == name
    assert worst.value == pytest.approx(dense[name].max(), rel=1e-4)
    assert worst.time == pytest.approx(times[dense[name].argmax()], abs=1e-3)


def test_nothing_is_found_twice(problem: TorqueProblem) -> None:
    some = wild(problem)
    known = find_violations(problem, some, 0.5, 1e-6, 1000).added_to(ConstraintSet(step=0.01))
    assert len(known) > 0
    assert find_violations(problem, some, 0.5, 1e-6, 1000).added_to(known) is known


def test_the_peak_is_found_between_the_samples(problem: TorqueProblem) -> None:
    some = wild(problem, 2.0)
    found = find_violations(problem, some, 0.0, 1e-6, 1000)
    fine = StateSamples.along(some, np.linspace(some.t[0], some.t[-1], 20001))
    dense = problem.objective.sample(fine)[0].max()
    on_grid = problem.objective.sample(StateSamples.along(some, problem.grid))[0].max()
    assert on_grid <= found.peak <= dense * (1 + 1e-9)
    assert found.peak == pytest.approx(dense, rel=1e-4)
    times = found.time[found.family == OBJECTIVE]
    assert len(times) > 0
    assert (np.abs(times - fine.t[:, None]).min(axis=0) < 1e-3).all()
