"""Splines in local unknowns: exact derivatives, exact C3, and the same trajectories as the dense family's."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from cmbot.optimization.iterate import NlpEvaluation
from cmbot.optimization.working_set import WorkingSet
from cmbot.planning.torque.families import FixedKnots, WhitenedSplines
from finite_differences import check_derivative
from numpy.typing import NDArray
from scipy import sparse
from small_scenes import parts, problem_of, short_scene

from cmbot.optimization.constraint_set import ConstraintSet
from cmbot.optimization.curvature import convexified, state_curvature
from cmbot.planning.torque.constraints import Linearisation, StateConstraint, StateSamples
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.planning.torque.task_manifold import TaskAtViaPoints
from cmbot.robot import Postures, Robot
from cmbot.trajectory.local_basis import SparseSplines
from cmbot.trajectory.parametrization import Parametrization
from cmbot.trajectory.spline_space import SplineSpace

FloatArray = NDArray[np.float64]
WEIGHT = 1e-3


@cache
def fixed_problem() -> TorqueProblem:
    return problem_of(short_scene())[0]


def family_of(kind: str) -> Parametrization:
    """A spline that is not that of least jerk, through the via-points of the short scene."""
    robot, task, _, _ = parts(short_scene())
    problem = fixed_problem()
    t, via_points = problem.space.t, problem.family.via_points
    splines = SparseSplines(SplineSpace(t), robot.limits)
    wild = 0.1 * splines.unit * np.random.default_rng(1).normal(size=splines.unit.shape)
    at = TaskAtViaPoints(postures=Postures(robot), task=task, points=task.path.position(t))
    return Parametrization(
        splines,
        via_points,
        splines.least_jerk(via_points) + wild,
        WEIGHT,
        task=None if kind == "fixed" else at,
        pinned=kind == "pinned",
    )


@pytest.fixture(scope="module", params=["fixed", "free", "pinned"])
def family(request: pytest.FixtureRequest) -> Parametrization:
    return family_of(request.param)


@cache
def problem_around(family: Parametrization) -> TorqueProblem:
    scene = short_scene()
    robot, task, _, clearances = parts(scene)
    return TorqueProblem(robot, task, family, clearances, scene.planner, resting=(0,))


def step(family: Parametrization, rng: np.random.Generator, size: float = 0.05) -> FloatArray:
    return np.asarray(size * rng.normal(size=family.dimension))


@pytest.mark.parametrize("n", [5, 6, 9, 30])
def test_local_splines_reach_every_spline_once(n: int, cmbot_robot: Robot, rng: np.random.Generator) -> None:
    space = SplineSpace(np.cumsum(rng.uniform(0.2, 0.6, n)))
    splines = SparseSplines(space, cmbot_robot.limits)
    q = rng.normal(size=(n, 7))
    least = space.least_jerk(q)
    z = splines.columns @ np.vstack([splines.least_jerk(q), q])
    np.testing.assert_allclose(z / space.unit[:, None], least / space.unit[:, None], rtol=0, atol=1e-10)
    u = np.vstack([rng.normal(size=(n - 4, 7)), q])
    trajectory = space.trajectory(splines.columns @ u)
    np.testing.assert_array_equal(trajectory.q, q)
    for order in range(4):
        scale = np.abs(trajectory.extrema(order).value).max()
        assert np.abs(trajectory.jumps(order)).max() < 1e-11 * scale
        if order > 0:
            assert np.abs(trajectory.evaluate(space.t[[0, -1]], order)).max() < 1e-11 * scale


def test_each_spline_lives_on_four_segments(cmbot_robot: Robot) -> None:
    splines = SparseSplines(SplineSpace(np.linspace(0, 5, 12)), cmbot_robot.limits)
    for column in splines.columns.toarray().T:
        knots = np.unique(np.flatnonzero(column) // 3)
        assert np.ptp(knots) <= 4


def test_rows_are_the_splines_and_their_derivatives(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    space = SplineSpace(np.cumsum(rng.uniform(0.2, 0.6, 9)))
    splines = SparseSplines(space, cmbot_robot.limits)
    times = np.append(rng.uniform(space.t[0], space.t[-1], 20), space.t)
    rows = splines.rows(times)
    for order in range(4):
        got = np.zeros((len(times), splines.columns.shape[1] + 1))
        # What fills up ends in the last column.
        np.add.at(got, (np.arange(len(times))[:, None], splines.living[rows.segment]), rows.weight[:, order])
        expected = (space.design(times, order) @ splines.columns).toarray()
        np.testing.assert_allclose(got[:, :-1], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
        assert not got[:, -1].any()


def test_a_unit_uses_up_a_bound(cmbot_robot: Robot) -> None:
    space = SplineSpace(np.linspace(0, 5, 12))
    splines, limits = SparseSplines(space, cmbot_robot.limits), cmbot_robot.limits
    for number in range(splines.count):
        u = np.zeros((splines.columns.shape[1], 7))
        u[number] = splines.unit[number]
        trajectory = space.trajectory(splines.columns @ u)
        bounds = (np.full(7, 0.02), limits.velocity, limits.acceleration, limits.jerk)
        shares = [trajectory.extrema(k).largest()[0] / bound for k, bound in enumerate(bounds)]
        assert np.max(shares, axis=0) == pytest.approx(np.ones(7), rel=0.05)


def test_the_dense_family_has_the_same_trajectories(rng: np.random.Generator) -> None:
    """With the same via-points, whatever the numbers: both span all splines through them."""
    family = family_of("fixed")
    whitened = WhitenedSplines(family.space, family.splines.limits)
    moved = family.rebuilt(step(family, rng), WEIGHT)
    z = moved.knots(moved.start)
    numbers = np.linalg.lstsq(whitened.basis, z - whitened.response @ moved.via_points, rcond=None)[0]
    dense = FixedKnots(whitened, moved.via_points, numbers, WEIGHT)
    np.testing.assert_allclose(dense.knots(dense.start), z, rtol=0, atol=1e-9)
    least = moved.splines.least_jerk(moved.via_points)
    still = Parametrization(moved.splines, moved.via_points, least, WEIGHT)
    got = moved.smoothing()[0] - still.smoothing()[0]
    assert got == pytest.approx(dense.smoothing(dense.start)[0], rel=1e-9)


def test_steps_keep_the_smoothness_and_the_task(family: Parametrization, rng: np.random.Generator) -> None:
    moved = family.rebuilt(step(family, rng, 0.3), WEIGHT)
    trajectory = family.space.trajectory(moved.knots(moved.start))
    for order in range(4):
        scale = np.abs(trajectory.extrema(order).value).max()
        assert np.abs(trajectory.jumps(order)).max() < 1e-11 * scale
    robot, task, _, _ = parts(short_scene())
    at = Postures(robot).at(moved.via_points)
    points = task.path.position(family.space.t)
    assert np.abs(task.errors(at.tool_point, at.tool_rotation, points)).max() < 1e-9
    still = np.abs(moved.via_points - family.via_points).max(axis=1) == 0
    np.testing.assert_array_equal(still[1:], not family.sliding)
    assert still[0] == (not family.sliding or family.slides < len(still))


def test_knots(family: Parametrization, rng: np.random.Generator) -> None:
    """The knots' derivatives by the unknowns, at the start of the family."""
    A = rng.normal(size=family.knots(family.start).shape)
    pull = (family.splines.columns.T @ A).ravel()
    check_derivative(
        lambda x: np.sum(A * family.knots(x)), family.start, family.map.T @ pull, step=1e-4, rtol=1e-6
    )


def test_jacobians(family: Parametrization, rng: np.random.Generator) -> None:
    times = rng.uniform(0, 4, 5)
    weights = rng.normal(size=(4, 5, 7))
    rows, space = family.rows(times), family.space
    for orders in (1, 3, 4):

        def combined(x: FloatArray, orders: int = orders) -> FloatArray:
            z = family.knots(x)
            return sum(
                np.sum(w * (space.design(times, k) @ z), axis=1) for k, w in enumerate(weights[:orders])
            )

        got = family.assembly.jacobian(rows, weights[:orders])
        check_derivative(combined, family.start, got.toarray(), step=1e-4, rtol=1e-6, atol=1e-5)
        pull = family.map.T @ family.pulled(rows, weights[:orders])
        np.testing.assert_allclose(got.sum(axis=0), pull, rtol=0, atol=1e-12 * np.abs(pull).max())


def test_rows_of_one_joint_have_entries_for_that_joint_alone(rng: np.random.Generator) -> None:
    family, times = family_of("fixed"), rng.uniform(0, 4, 7)
    by_state = np.zeros((4, 7, 7))
    by_state[2, np.arange(7), np.arange(7)] = 1.0
    J = family.assembly.jacobian(family.rows(times), by_state)
    row, column = J.tocoo().coords
    joint = np.nonzero(family.number_index == np.arange(family.dimension)[:, None, None])[2]
    np.testing.assert_array_equal(joint[column], row)


def test_no_rows_make_an_empty_jacobian_and_no_curvature(family: Parametrization) -> None:
    rows = family.rows(np.empty(0))
    assert family.assembly.jacobian(rows, np.empty((4, 0, 7))).shape == (0, family.dimension)
    assert family.assembly.hessian(rows, np.empty((0, 21, 21))).nnz == 0


def test_curvatures_are_what_jacobians_make_of_them(
    family: Parametrization, rng: np.random.Generator
) -> None:
    rows = family.rows(rng.uniform(0, 4, 3))
    M = rng.normal(size=(3, 21, 21))
    J = [
        family.assembly.jacobian(rows, by_state) for by_state in np.eye(21).reshape(21, 3, 1, 7).repeat(3, 2)
    ]
    states = np.stack([each.toarray() for each in J], axis=1)
    expected = (states.transpose(0, 2, 1) @ M @ states).sum(axis=0)
    got = family.assembly.hessian(rows, M).toarray()
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_unknowns_are_sorted_along_the_path(family: Parametrization) -> None:
    index = np.sort(np.concatenate([family.number_index.ravel(), family.slide_index.ravel()]))
    np.testing.assert_array_equal(index, np.arange(family.dimension))
    block = np.searchsorted(family.block_ends, np.arange(family.dimension), side="right")
    assert family.block_ends[-1] == family.dimension
    number = np.arange(len(family.number_index))[:, None]
    np.testing.assert_array_equal(
        block[family.number_index], np.broadcast_to(number, family.number_index.shape)
    )
    H = family.smoothing_curvature.tocoo()
    assert np.abs(block[H.coords[0]] - block[H.coords[1]]).max() <= 3


def along(function: Callable[[FloatArray], float], d: FloatArray, h: float) -> float:
    """Second derivative at zero along `d`, by differences of fourth order."""
    near, far = (function(k * h * d) + function(-k * h * d) - 2 * function(0 * d) for k in (1, 2))
    return (16 * near - far) / (12 * h**2)


def test_smoothing(family: Parametrization, rng: np.random.Generator) -> None:
    def smoothing(x: FloatArray) -> float:
        return family.rebuilt(x, WEIGHT).smoothing()[0]

    value, by_u = family.smoothing()
    check_derivative(smoothing, family.start, family.map.T @ by_u, step=1e-4, rtol=1e-6, atol=1e-9)
    H = family.smoothing_curvature + family.bend_curvature(by_u)
    for _ in range(3):
        d = step(family, rng, 1.0)
        assert d @ (H @ d) == pytest.approx(along(smoothing, d, 1e-3), rel=1e-4)
    jerk = family.space.trajectory(family.knots(family.start)).evaluate(_gauss(family)[0], 3)
    share = (jerk / family.splines.limits.jerk) ** 2
    assert value == pytest.approx(0.5 * WEIGHT * _gauss(family)[1] @ share.mean(axis=1))


def _gauss(family: Parametrization) -> tuple[FloatArray, FloatArray]:
    t = family.space.t
    nodes, weights = np.polynomial.legendre.leggauss(4)
    h = np.diff(t)[:, None]
    return (t[:-1, None] + 0.5 * h * (1 + nodes)).ravel(), (0.5 * h * weights).ravel() / (t[-1] - t[0])


@pytest.mark.parametrize("number", [0, 1, 2])
def test_curvature_of_the_state_functions(
    family: Parametrization, number: int, rng: np.random.Generator
) -> None:
    """Of the guardrail torque, a joint's torque and the tool's deviation, slides and all."""
    problem = problem_around(family)
    function: StateConstraint = (problem.torque, *problem.functions)[number]
    times, multipliers = np.array([0.3, 1.9, 3.3]), np.array([1.0, 2.0, 0.5])
    if number == 2:
        # A distance bends without bound where it is nearly zero.
        far = function.values(problem.states(family, family.start, problem.grid))[0][:, 0]
        times = problem.grid[np.argsort(-far)[[0, 5, 10]]]
    component = np.full(3, 1, dtype=np.intp) if number == 1 else np.zeros(3, dtype=np.intp)

    def value(x: FloatArray) -> float:
        states = problem.states(family, x, times)
        return float(multipliers @ function.linearise(states, component).value)

    states = problem.states(family, family.start, times)
    at = function.linearise(states, component)
    rows = family.rows(times)
    by_u = family.pulled(rows, multipliers[:, None] * np.stack([at.d_q, at.d_v, at.d_a]))
    active, curvature = state_curvature(function, states, component, multipliers, 1.0)
    np.testing.assert_array_equal(active, np.arange(3))
    H = family.assembly.hessian(rows, curvature) + family.bend_curvature(by_u)
    for _ in range(3):
        d = step(family, rng, 1.0)
        # The tool's deviation magnifies what Newton's method leaves of the task.
        expected = along(value, d, 4e-3 if number == 2 else 1e-3)
        assert d @ (H @ d) == pytest.approx(expected, rel=2e-3, abs=1e-6 * d @ d)


def test_what_no_state_changes_does_not_bend() -> None:
    """A tool exactly on its leg: its distance has no slope there."""

    class Flat:
        name, components = "flat", 1

        def values(self, states: StateSamples) -> tuple[FloatArray, NDArray[np.intp]]:
            raise NotImplementedError

        def linearise(self, states: StateSamples, component: NDArray[np.intp]) -> Linearisation:
            return Linearisation(np.zeros(len(states.t)), *3 * (np.zeros(states.q.shape),))

    states = StateSamples(np.zeros(2), *3 * (np.zeros((2, 7)),))
    active, curvature = state_curvature(Flat(), states, np.zeros(2, dtype=np.intp), np.ones(2), 1.0)
    assert len(active) == 2
    assert not curvature.any()


def test_the_place_knows_its_derivatives(family: Parametrization, rng: np.random.Generator) -> None:
    problem = problem_around(family)
    working = WorkingSet(problem)
    working.add_everywhere(np.array([0.4, 1.7, 3.1]))
    known = ConstraintSet(problem, working)

    def at(x: FloatArray) -> NlpEvaluation:
        return NlpEvaluation.on(known, family.rebuilt(x, family.weight), 0.9)

    place = NlpEvaluation.on(known, family, 0.9)
    first = place.first
    check_derivative(lambda x: at(x).values.objective, family.start, first.gradient, rtol=1e-5)
    check_derivative(
        lambda x: at(x).values.value, family.start, first.jacobian.toarray(), rtol=1e-5, atol=1e-6
    )
    assert np.linalg.eigvalsh(place.curvature(np.ones(len(first.value))).toarray()).min() > 0
    # What never exceeds the deviation does not, and is equal to it where the tool is off that way.
    faces = first.face_value.reshape(-1, 3)
    sizes = np.cumsum(working.sizes)
    deviation = first.value[sizes[1] : sizes[2]]
    assert (faces <= deviation + 1e-9).all()
    assert (first.face_kind == 2).all()
    assert (np.bincount(first.kind, minlength=len(working.sizes)) == working.sizes).all()


def test_a_step_adds_what_it_violates_and_multipliers_follow() -> None:
    problem = problem_around(family_of("free"))
    working = WorkingSet(problem)
    working.add_everywhere(np.array([0.4, 1.7, 3.1]))
    known = ConstraintSet(problem, working)
    family = problem.family
    assert isinstance(family, Parametrization)
    place = NlpEvaluation.on(known, family, None)
    multipliers = np.arange(1.0, len(working) + 1)
    before = np.split(multipliers, np.cumsum(working.sizes)[:-1])
    trial = place.moved(np.full(family.dimension, 0.5))
    assert len(trial.first.value) == len(working) > len(multipliers)
    # All that a full look finds is known already.
    assert known.look(trial.trajectory, trial.first.peak).value == pytest.approx(
        trial.first.violation, rel=1e-2
    )
    after = np.split(place.lifted(multipliers), np.cumsum(working.sizes)[:-1])
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(new[: len(old)], old)
        assert not new[len(old) :].any()
    assert place.renewed().first.merit(np.ones(len(before))) >= place.first.merit(np.ones(len(before)))


def test_thinning_keeps_multipliers_and_the_worst() -> None:
    problem = problem_around(family_of("free"))
    working = WorkingSet(problem)
    known = ConstraintSet(problem, working)
    dense = np.linspace(0.5, 3.5, 400)
    working.add_everywhere(dense)
    family = problem.family
    assert isinstance(family, Parametrization)
    place = NlpEvaluation.on(known, family, None)
    multipliers = np.zeros(len(working))
    multipliers[[7, 8, 430]] = [1.0, 2.0, 3.0]
    thinner, left = place.thinned(multipliers)
    assert len(left) == len(working) == len(thinner.first.value) < len(multipliers)
    assert sorted(left[left > 0]) == [1.0, 2.0, 3.0]
    assert thinner.first.peak == place.first.peak
    # Few are left alone.
    assert thinner.thinned(left)[0] is thinner


def test_directions_of_slides_stay_what_they_were_as_far_as_they_can() -> None:
    family = family_of("free")
    x = np.zeros(family.dimension)
    x[family.slide_index] = 0.1
    there = family.rebuilt(x, family.weight)
    assert (np.einsum("kai,kai->ka", family._null, there._null) > 0.9).all()


def test_convexified(rng: np.random.Generator) -> None:
    """Positive definite, of the same pattern of blocks, and unchanged where nothing has to be."""
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
