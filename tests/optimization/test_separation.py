"""Looking for violations: cheaper than looking everywhere, and finding the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cmbot.optimization.working_set import _Sites
from cmbot.planning.torque.clearance_samples import ClearanceLooks
from hypothesis import given, settings
from hypothesis import strategies as st
from small_scenes import short_scene

from cmbot.collision import Clearances
from cmbot.optimization import separation as violations
from cmbot.optimization.separation import broken_bound, values_of
from cmbot.planning.context import PlanningContext, build_context
from cmbot.planning.solvers import family_through
from cmbot.planning.torque import feasibility
from cmbot.planning.torque.constraints import ClearanceMargin, StateSamples
from cmbot.planning.torque.problem import KinematicBound, TorqueProblem
from cmbot.trajectory import quintic as trajectory
from cmbot.trajectory.quintic import QuinticTrajectory


@pytest.fixture(scope="module")
def context() -> PlanningContext:
    scene = short_scene()
    return build_context(scene, replace(scene.planner, knots="sliding"))


def smooth(seed: int, knots: int = 8, joints: int = 7) -> QuinticTrajectory:
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0 * (knots - 1), knots)
    q, v, a = rng.normal(size=(3, knots, joints)) * np.array([0.3, 0.3, 0.5])[:, None, None]
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


@given(st.integers(0, 2**32 - 1), st.integers(1, 700))
def test_blocks_of_times_change_nothing(seed: int, number: int) -> None:
    some = smooth(seed)
    times = np.sort(np.random.default_rng(seed).uniform(some.t[0], some.t[-1], number))
    whole = some.states(times)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory, "_BLOCK", 7)
        for here, there in zip(whole, some.states(times), strict=True):
            np.testing.assert_array_equal(here, there)
    for order, here in enumerate(whole):
        np.testing.assert_array_equal(here, some.evaluate(times, order))


def test_blocks_of_states_change_nothing(context: PlanningContext, monkeypatch: pytest.MonkeyPatch) -> None:
    some = smooth(1)
    times = np.linspace(some.t[0], some.t[-1], 50)
    states = StateSamples(times, *some.states(times))
    clearance = ClearanceMargin(context.clearances, 0.1)
    whole = clearance.values(states)
    monkeypatch.setattr(violations, "_BLOCK", 9)
    for blocks in values_of([clearance, clearance], states):
        for here, there in zip(whole, blocks, strict=True):
            np.testing.assert_allclose(here, there, atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_hulls_hold_what_the_polynomials_do(seed: int, order: int) -> None:
    some = smooth(seed)
    low, high = some.hull(order)
    extrema = some.extrema(order).value
    slack = 1e-12 * np.abs(extrema).max()
    assert (low - slack <= extrema.min(axis=2)).all()
    assert (extrema.max(axis=2) <= high + slack).all()


@settings(max_examples=30)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 4),
    st.floats(0.01, 2.0),
    st.sampled_from([1e-5, 0.3]),
)
def test_broken_bounds_are_those_of_all_extrema(seed: int, order: int, size: float, tolerance: float) -> None:
    some = smooth(seed)
    rng = np.random.default_rng(seed)
    extrema = some.extrema(order)
    scale = size * np.abs(extrema.value).max(axis=(0, 2)) * rng.uniform(0.5, 1.0, 7)
    bound = KinematicBound(order, -0.9 * scale, scale, scale, "bound")
    over = (extrema.value - bound.high[:, None]) / scale[:, None]
    under = (bound.low[:, None] - extrema.value) / scale[:, None]
    value = np.stack([over, under], axis=2)
    found = broken_bound(some, bound, tolerance)
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


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.6))
def test_clearances_are_measured_wherever_they_matter(seed: int, margin: float) -> None:
    """Along trajectories that come nearer to each other, coarsely first, as an optimisation looks at them."""
    scene = short_scene()
    context = build_context(scene, scene.planner)
    clearance = ClearanceMargin(Clearances(context.robot, scene.obstacles), margin)
    here, there = (context.posture + 0.5 * smooth(seed + k).evaluate(np.linspace(0, 7, 300)) for k in (0, 1))
    looks, t = ClearanceLooks(clearance, 300, 7), np.linspace(0, 7, 300)
    matters = -0.02
    for share, stride in ((0.0, 10), (0.0, 1), (0.5, 1), (0.6, 10), (0.61, 1), (0.611, 1)):
        q = ((1 - share) * here + share * there)[::stride]
        states = StateSamples(t[::stride], q, np.zeros_like(q), np.zeros_like(q))
        exact = clearance.values(states)[0][:, 0]
        value, pair = (each[:, 0] for each in looks.values(states, stride, matters))
        known = np.isfinite(value)
        np.testing.assert_allclose(value[known], exact[known], atol=1e-6)
        assert (pair[known] >= 0).all()
        above = exact > matters
        near = above | np.append(above[1:], False) | np.append(False, above[:-1])
        assert known[near].all()


def test_clearances_that_hardly_change_are_not_measured_again(context: PlanningContext) -> None:
    measured: list[int] = []

    class Counted(Clearances):
        def smallest(self, q, *, avoidable_only=False):  # type: ignore[no-untyped-def]
            measured.append(len(q))
            return super().smallest(q, avoidable_only=avoidable_only)

    clearance = ClearanceMargin(Counted(context.robot, ()), 0.0)
    q = np.repeat(context.posture[None], 4000, axis=0) + 0.05 * np.sin(np.linspace(0, 9, 4000))[:, None]
    looks, t = ClearanceLooks(clearance, 4000, 7), np.linspace(0, 9, 4000)
    for shift in (0.0, 1e-4, 2e-4):
        looks.values(StateSamples(t, q + shift, q, q), 1, -0.02)
        if shift == 0.0:
            assert 0 < sum(measured) <= 4000 / 16 + 1
            measured.clear()
    assert sum(measured) == 0


@given(st.integers(0, 2**32 - 1), st.integers(0, 60), st.integers(0, 60))
def test_known_sites_are_found(seed: int, known: int, more: int) -> None:
    rng = np.random.default_rng(seed)
    sites = _Sites(times=rng.uniform(0, 1, known), component=rng.integers(0, 4, known))
    times, component = rng.uniform(0, 1, more), rng.integers(0, 4, more)
    close = (np.abs(sites.times - times[:, None]) < 0.02) & (sites.component == component[:, None])
    np.testing.assert_array_equal(sites._there(times, component, 0.02), close.any(axis=1))


@given(st.lists(st.booleans(), min_size=1, max_size=80))
def test_stretches_hold_what_is_broken_and_its_surroundings(broken: list[bool]) -> None:
    near = np.zeros(len(broken), dtype=np.bool_)
    for k in np.flatnonzero(broken):
        near[max(k - feasibility._AROUND, 0) : k + feasibility._AROUND + 1] = True
    found = np.zeros(len(broken), dtype=int)
    for first, last in feasibility._stretches(np.array(broken)):
        found[first : last + 1] += 1
    np.testing.assert_array_equal(found, near)


def test_a_jump_in_a_long_path_is_found_without_looking_at_all_of_it() -> None:
    scene = short_scene(tool_path={"legs": [{"by": [0, -0.3, 0], "seconds": 60}], "via_points": 120})
    context = build_context(scene, replace(scene.planner, knots="fixed", solver="slsqp"))
    via_points = np.repeat(context.posture[None], 120, axis=0)
    via_points[60:, 2] += 1.0
    family = family_through(context, via_points, sliding=False)
    arguments = (context.robot, context.task, family, context.clearances, context.options)
    problem = TorqueProblem(*arguments, resting=())
    least_jerk = problem.trajectory(family, family.start)
    bounds = [bound for bound in problem.bounds if bound.order > 0]
    stretches = feasibility._stretches(feasibility._broken_segments(least_jerk, bounds)[:, 2])
    assert len(stretches) == 1
    assert stretches[0][1] - stretches[0][0] < 60
    wider = stretches[0][0] - 12, stretches[0][1] + 12
    shares = [
        feasibility._least_share(problem, least_jerk, bounds, 2, *part) for part in (stretches[0], wider)
    ]
    # What is far away does nothing for it.
    assert shares[0] == pytest.approx(shares[1], rel=1e-6)
    assert shares[0] > 1.0
