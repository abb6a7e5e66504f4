"""The torque problem: whitened unknowns, exact derivatives, a mean square that is one."""

from __future__ import annotations

import numpy as np
import pytest
from cmbot.optimization.working_set import WorkingSet
from cmbot.planning.torque.families import FixedKnots, SlidingKnots
from finite_differences import check_derivative
from numpy.typing import NDArray
from small_scenes import problem_of, short_scene

from cmbot.planning.torque.problem import TorqueProblem
from cmbot.robot import Dynamics, Postures

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module")
def fixed() -> TorqueProblem:
    return problem_of(short_scene(planner={"solver": "slsqp"}))[0]


@pytest.fixture(scope="module", params=["fixed", "sliding", "sliding but the first"])
def problem(request: pytest.FixtureRequest) -> TorqueProblem:
    scene = short_scene(planner={"solver": "slsqp"})
    fixed, task, clearances = problem_of(scene)
    if request.param == "fixed":
        return fixed
    family = SlidingKnots(
        fixed.family.splines,
        fixed.family.via_points,
        fixed.family.numbers(fixed.family.start),
        scene.planner.smoothing_weight,
        postures=Postures(fixed.robot),
        task=task,
        points=task.path.position(fixed.space.t),
        pinned=request.param != "sliding",
    )
    return TorqueProblem(fixed.robot, task, family, clearances, scene.planner, resting=(0,))


def unknowns(problem: TorqueProblem, rng: np.random.Generator) -> FloatArray:
    return 0.05 * rng.normal(size=problem.family.dimension)


def dense(problem: TorqueProblem) -> tuple[FloatArray, FloatArray]:
    """Gauss points and weights (sum 1) so many that nothing is left to integrate better."""
    t = problem.space.t
    nodes, weights = np.polynomial.legendre.leggauss(20)
    h = np.diff(t)[:, None]
    times = (t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
    return times, (0.5 * h * weights).ravel() / (t[-1] - t[0])


def test_dimension(fixed: TorqueProblem) -> None:
    assert fixed.family.dimension == 7 * (8 - 4)


def test_the_search_starts_at_the_least_jerk_spline(problem: TorqueProblem) -> None:
    knots = problem.trajectory(problem.family, problem.family.start)
    expected = problem.space.trajectory(problem.space.least_jerk(problem.family.via_points))
    for name in "qva":
        np.testing.assert_allclose(getattr(knots, name), getattr(expected, name), rtol=0, atol=1e-11)


def test_unknowns_keep_the_smoothness(problem: TorqueProblem, rng: np.random.Generator) -> None:
    x = unknowns(problem, rng)
    trajectory = problem.trajectory(problem.family, x)
    start = problem.trajectory(problem.family, problem.family.start)
    np.testing.assert_allclose(trajectory.q, problem.family.via_points_at(x), rtol=0, atol=1e-12)
    assert (np.abs(trajectory.q - start.q).max() > 1e-4) == problem.family.sliding
    assert np.abs(trajectory.v - start.v).max() > 1e-3
    for order in range(4):
        scale = np.abs(trajectory.extrema(order).value).max()
        assert np.abs(trajectory.jumps(order)).max() < 1e-11 * scale
        if order > 0:
            ends = trajectory.evaluate(trajectory.t[[0, -1]], order)
            assert np.abs(ends).max() < 1e-11 * scale


@pytest.mark.parametrize("weight", [1e-4, 1e-2])
def test_smoothing_is_the_mean_squared_jerk(
    problem: TorqueProblem, weight: float, rng: np.random.Generator
) -> None:
    """weight/2 times the mean over joints and time of (jerk/J_C)^2, but for what fixed via-points add."""
    family = problem.family.rebuilt(problem.family.start, weight)
    x = 10 * unknowns(problem, rng)
    times, weights = dense(problem)

    def expected(at: FloatArray) -> float:
        jerk = problem.trajectory(family, at).evaluate(times, 3) / problem.robot.limits.jerk
        return 0.5 * weight * float(weights @ (jerk**2).mean(axis=1))

    got = family.smoothing(x)[0] - family.smoothing(family.start)[0]
    assert got == pytest.approx(expected(x) - expected(family.start), rel=1e-8)
    check_derivative(lambda y: family.smoothing(y)[0], x, family.smoothing(x)[1], rtol=1e-6)
    if not family.sliding:
        assert family.smoothing(x)[0] == pytest.approx(0.5 * float(x @ x))
        np.testing.assert_array_equal(family.smoothing_curvature(), np.eye(family.dimension))


def test_rebuilding_changes_nothing_but_the_unknowns(
    problem: TorqueProblem, rng: np.random.Generator
) -> None:
    x = unknowns(problem, rng)
    rebuilt = problem.family.rebuilt(x, 0.1)
    before, after = problem.trajectory(problem.family, x), problem.trajectory(rebuilt, rebuilt.start)
    for name in "qva":
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=0, atol=1e-10)


def test_chain(problem: TorqueProblem, rng: np.random.Generator) -> None:
    """From derivatives by the states to derivatives by the unknowns, on a function made up for it."""
    times = rng.uniform(0, 4, 5)
    A, B, C = rng.normal(size=(3, 5, 7))
    x = unknowns(problem, rng)

    def value(y: FloatArray) -> FloatArray:
        states = problem.states(problem.family, y, times)
        return np.asarray(np.sum(A * np.sin(states.q) + B * states.v**2 + C * states.a, axis=1))

    at = problem.states(problem.family, x, times)
    got = problem.family.chain(x, problem.family.rows(times), A * np.cos(at.q), 2 * B * at.v, C)
    check_derivative(value, x, got, rtol=1e-6, atol=1e-9)


def test_working_set(problem: TorqueProblem, rng: np.random.Generator) -> None:
    """Values against their definitions, the Jacobian against differences: torque, limits, tool, clearance."""
    family, x = problem.family, unknowns(problem, rng)
    working = WorkingSet(problem)
    times = np.array([0.21, 1.13, 2.9])
    working.add_everywhere(times)
    # Wild enough that every kind of bound is violated somewhere.
    working.add_violated(problem.trajectory(family, 60 * x), 0.1, 1e-6, 3, 6)
    values, jacobian, torques = working.values(family, x)
    assert values.shape == (len(working),)
    assert jacobian.shape == (len(working), family.dimension)
    assert len(working) > 40
    states = problem.states(family, x, times)
    torque = Dynamics(problem.robot).efforts(states.q, states.v, states.a).guardrail_torque
    np.testing.assert_allclose(values[:3], np.linalg.norm(torque, axis=1) / problem.scale, rtol=1e-10)
    assert torques >= 3
    # Torques and polynomials are smooth; the clearance's rounding bounds the rest.
    check_derivative(lambda y: working.values(family, y)[0], x, jacobian, step=1e-4, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("stride", [1, 4, 7, 10])
def test_samples_are_the_states_at_every_so_manieth_time(fixed: TorqueProblem, stride: int) -> None:
    trajectory = fixed.trajectory(fixed.family, fixed.family.start)
    got = fixed.sampled(trajectory, stride)
    np.testing.assert_array_equal(got.t, fixed.grid[::stride])
    for ours, states in zip((got.q, got.v, got.a), trajectory.states(got.t), strict=True):
        np.testing.assert_allclose(ours, states, rtol=0, atol=1e-11 * np.abs(states).max())


@pytest.mark.parametrize("order", range(4))
def test_bounds_of_the_joints(fixed: TorqueProblem, rng: np.random.Generator, order: int) -> None:
    """At its worst time a violated bound counts as its violation, as a share of the bound."""
    limits, family, bound = fixed.robot.limits, fixed.family, fixed.bounds[order]
    wild = 40 * unknowns(fixed, rng)
    trajectory = fixed.trajectory(family, wild)
    if order == 0:
        middle, half = 0.5 * (limits.lower + limits.upper), 0.5 * (limits.upper - limits.lower)
        share = np.abs(trajectory.extrema(0).value - middle[:, None]).max(axis=(0, 2)) / half
    else:
        limit = (limits.velocity, limits.acceleration, limits.jerk)[order - 1]
        share = trajectory.extrema(order).largest()[0] / limit
    assert share.max() > 1
    working = WorkingSet(fixed)
    _, worst, _ = working.add_violated(trajectory, np.inf, 1e-6, 1, 1000)
    values = working.values(family, wild)[0]
    # The bound lies ten tolerances inside the limit.
    inside = 1 - 10 * fixed.options.constraint_tolerance
    for joint in np.flatnonzero(share > 1):
        assert np.abs(values - (share[joint] - inside)).min() < 1e-9
    assert values.max() <= worst.value + 1e-9
    assert (bound.order, bound.name) == (order, ("position", "velocity", "acceleration", "jerk")[order])


def test_nothing_is_added_twice(fixed: TorqueProblem, rng: np.random.Generator) -> None:
    wild = fixed.trajectory(fixed.family, 40 * unknowns(fixed, rng))
    working = WorkingSet(fixed)
    assert working.add_violated(wild, 0.5, 1e-6, 1, 1000)[0] == len(working) > 0
    assert working.add_violated(wild, 0.5, 1e-6, 1, 1000)[0] == 0


def test_an_empty_working_set(fixed: TorqueProblem) -> None:
    values, jacobian, torques = WorkingSet(fixed).values(fixed.family, fixed.family.start)
    assert (values.shape, jacobian.shape, torques) == ((0,), (0, fixed.family.dimension), 0)


@pytest.mark.parametrize(("size", "tolerance"), [(0.0, 1e-5), (0.1, 5e-3)])
def test_mean_square(problem: TorqueProblem, rng: np.random.Generator, size: float, tolerance: float) -> None:
    """Three Gauss points a segment are enough for calm splines, and nearly so for wild ones."""
    family, x = problem.family, size * unknowns(problem, rng)
    value, gradient = problem.mean_square(family, x)
    times, weights = dense(problem)
    states = problem.states(family, x, times)
    torque = Dynamics(problem.robot).efforts(states.q, states.v, states.a).guardrail_torque / problem.scale
    assert value == pytest.approx(0.5 * weights @ (torque**2).sum(axis=1), rel=tolerance)
    check_derivative(lambda y: problem.mean_square(family, y)[0], x, gradient, rtol=1e-6, atol=1e-11)


def test_mean_square_curvature(fixed: TorqueProblem, rng: np.random.Generator) -> None:
    family, x = fixed.family, 0.1 * unknowns(fixed, rng)
    H = fixed.mean_square_curvature(family, x)
    np.testing.assert_allclose(H, H.T, rtol=0, atol=1e-14)
    assert np.linalg.eigvalsh(H).min() > -1e-12
    assert np.linalg.eigvalsh(H + family.smoothing_curvature()).min() >= 1 - 1e-12

    # With the smoothing it is the gradient's derivative, but for what Gauss and Newton leave out.
    def gradient(y: FloatArray) -> FloatArray:
        return fixed.mean_square(family, y)[1] + family.smoothing(y)[1]

    d = x / np.linalg.norm(x)
    along = (gradient(x + 1e-4 * d) - gradient(x - 1e-4 * d)) / 2e-4
    got = (H + family.smoothing_curvature()) @ d
    np.testing.assert_allclose(got, along, rtol=0, atol=0.05 * np.linalg.norm(along))


def test_scale_and_peak_at_rest(fixed: TorqueProblem) -> None:
    dynamics, family = Dynamics(fixed.robot), fixed.family
    states = fixed.states(family, family.start, fixed.grid)
    torque = np.linalg.norm(dynamics.efforts(states.q, states.v, states.a).guardrail_torque, axis=1)
    assert fixed.scale == pytest.approx(torque.max())
    ends = np.linalg.norm(dynamics.static_efforts(family.via_points[[0, -1]]).guardrail_torque, axis=1)
    assert fixed.peak_at_rest == pytest.approx(ends.max())
    assert len(fixed.grid) == 7 * fixed.options.samples_per_segment + 1


def test_family_is_one_of_two(problem: TorqueProblem) -> None:
    assert isinstance(problem.family, FixedKnots)
    assert isinstance(problem.family, SlidingKnots) == problem.family.sliding
