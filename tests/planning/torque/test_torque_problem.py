"""The torque problem: its units and bounds, a mean square that is one, and problems of its segments."""

from pathlib import Path

import numpy as np
import pytest
from finite_differences import check_derivative
from quadrature import gauss_points
from small_scenes import problem_of, short_scene, torque_along, torque_problem
from urdf_arms import endless_scene

from cmbot.collision import RESOLUTION
from cmbot.common.arrays import FloatArray
from cmbot.elastic.modes import linearised
from cmbot.optimization.constraint_set import ConstraintSet
from cmbot.optimization.linearization import linearize
from cmbot.optimization.separation import find_violations
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.robot import Dynamics
from cmbot.trajectory.parametrization import Parametrization


@pytest.fixture(scope="module")
def fixed() -> TorqueProblem:
    return torque_problem("fixed")


@pytest.fixture(scope="module", params=["fixed", "free", "pinned"])
def problem(request: pytest.FixtureRequest) -> TorqueProblem:
    return torque_problem(request.param)


def wild(form: Parametrization, rng: np.random.Generator, size: float) -> Parametrization:
    """Splines that break every bound; via-points stay."""
    x = np.zeros(form.dimension)
    x[form.coefficient_index] = size * rng.normal(size=form.coefficients.shape)
    return form.step(x)


@pytest.mark.parametrize("kind", ["fixed", "free", "pinned"])
def test_units_and_the_lower_bound(kind: str) -> None:
    """What rests in a posture that stays cannot ask less; what is known of all postures counts, too."""
    problem = torque_problem(kind)
    form, robot = problem.parametrization, problem.request.cell.robot
    assert len(problem.grid) == 7 * problem.samples_per_segment + 1
    assert torque_along(problem, form.trajectory, problem.grid).max() == pytest.approx(1.0)
    at_rest = np.linalg.norm(Dynamics(robot).static_efforts(form.via_points).guardrail_torque, axis=1)
    np.testing.assert_allclose(problem.at_via_points, at_rest, rtol=1e-12)
    resting = {"fixed": [0, -1], "free": [], "pinned": [0]}[kind]
    least = max(at_rest[resting].max(initial=0.0), problem.request.negligible)
    assert problem.lower_bound == pytest.approx(least / problem.scale)
    known = 2 * problem.scale
    assert torque_problem(kind, known).lower_bound == pytest.approx(2.0)


@pytest.mark.parametrize(("size", "tolerance"), [(0.0, 1e-5), (0.5, 5e-3)])
def test_residuals_square_to_the_mean(
    problem: TorqueProblem, rng: np.random.Generator, size: float, tolerance: float
) -> None:
    """Three Gauss points a segment are enough for calm splines, and nearly so for wild ones."""
    form = problem.parametrization.step(size * rng.normal(size=problem.parametrization.dimension))
    residuals = problem.mean_residuals(form.trajectory)
    times, share = gauss_points(problem.space.t, 20)
    mean = share @ torque_along(problem, form.trajectory, times) ** 2
    assert sum(part.value @ part.value for part in residuals) == pytest.approx(mean, rel=tolerance)

    def value(y: FloatArray) -> float:
        moved = form.step(y).trajectory
        return sum(float(part.value @ part.value) for part in problem.mean_residuals(moved))

    rows = form.splines.rows(problem.mean_times)
    gradient = sum(2 * form.pullback(rows, part.value[:, None] * part.derivatives) for part in residuals)
    check_derivative(value, np.zeros(form.dimension), form.map.T @ gradient, rtol=1e-6, atol=1e-10)


def test_the_sway_of_a_quiet_stroke_counts_beside_the_torque(rng: np.random.Generator) -> None:
    """A two-hundredth of its mean square, in units of that of the guess; of other strokes nothing."""
    kinds = ("quiet", "jerk_limited")
    problem, other = (problem_of(short_scene(tool_path={"speed_profile": {"kind": kind}})) for kind in kinds)
    form, arm = problem.parametrization, problem.request.cell.arm
    assert arm is not None and len(other.mean_residuals(other.parametrization.trajectory)) == 3

    def mean_squares(moved: Parametrization) -> tuple[float, float]:
        parts = [part.value @ part.value for part in problem.mean_residuals(moved.trajectory)]
        return sum(parts[:3]), sum(parts[3:])

    assert mean_squares(form)[1] == pytest.approx(0.005)
    # Of the guess's postures, as only the accelerations count.
    moved = form.step(1e-3 * rng.normal(size=form.dimension))
    times, share = gauss_points(problem.space.t, 3)
    rows = linearised(arm, form.trajectory.evaluate(times)).yielding
    before, after = (
        share @ (np.einsum("kij,kj->ki", rows, each.trajectory.evaluate(times, 2)) ** 2).sum(axis=1)
        for each in (form, moved)
    )
    assert mean_squares(moved)[1] == pytest.approx(0.005 * after / before, rel=0.02)
    torque = share @ torque_along(problem, moved.trajectory, times) ** 2
    assert mean_squares(moved)[0] == pytest.approx(torque, rel=1e-9)


@pytest.mark.parametrize("order", range(4))
def test_bounds_of_the_joints(fixed: TorqueProblem, rng: np.random.Generator, order: int) -> None:
    """At its worst time a violated bound counts as its violation, as a share of the limit."""
    limits, bound, tolerance = fixed.request.cell.robot.limits, fixed.bounds[order], 1e-6
    trajectory = wild(fixed.parametrization, rng, 400.0).trajectory
    if order == 0:
        middle, half = 0.5 * (limits.lower + limits.upper), 0.5 * (limits.upper - limits.lower)
        share = np.abs(trajectory.extrema(0).value - middle[:, None]).max(axis=(0, 2)) / half
    else:
        limit = (limits.velocity, limits.acceleration, limits.jerk)[order - 1]
        share = trajectory.extrema(order).largest()[0] / limit
    assert share.max() > 1
    found = find_violations(fixed, trajectory, np.inf, tolerance, 1000)
    family = 1 + len(fixed.constraints) + order
    known = found.added_to(ConstraintSet(step=0.01))
    everything = linearize(fixed, known, trajectory).value
    values = everything[known.family == family]
    # The bound lies ten tolerances inside the limit.
    inside = 1 - 10 * fixed.request.cell.options.constraint_tolerance
    for joint in np.flatnonzero(share > 1):
        assert np.abs(values - (share[joint] - inside)).min() < 1e-9
    assert values.max() == pytest.approx(share.max() - inside, abs=1e-9)
    assert everything.max() <= found.worst.value + 1e-9
    assert (bound.order, bound.name) == (order, ("position", "velocity", "acceleration", "jerk")[order])


def test_endless_joints_have_no_ends(tmp_path: Path) -> None:
    problem = problem_of(endless_scene(tmp_path), knots="fixed")
    bound = problem.bounds[0]
    endless = ~np.isfinite(problem.request.cell.robot.limits.lower)
    assert 0 < endless.sum() < 7
    assert (bound.scale[endless] == 1.0).all()
    far = np.full((1, 7), 50.0)
    for value in (bound.above(far), bound.below(-far)):
        assert np.isneginf(value[0, endless]).all()
        assert (value[0, ~endless] > 0).all()


def test_sampled_constraints_are_kept_a_little_inside(fixed: TorqueProblem) -> None:
    """For what is not seen between samples, the less the more there are."""
    asked, options = fixed.request, fixed.request.cell.options
    torque, deviation, clearance, lag, held, rotation = fixed.constraints
    inside = 1 - 0.5 / options.samples_per_segment**2
    np.testing.assert_allclose(torque.bound, asked.cell.robot.limits.torque * inside, rtol=1e-14)
    np.testing.assert_allclose(held.bound, asked.cell.robot.holding_limits * inside, rtol=1e-14)
    assert deviation.bound == pytest.approx(options.max_tool_deviation_m * inside)
    assert lag.bound == pytest.approx(options.max_tool_lag_m * inside)
    assert rotation.bound == pytest.approx(np.deg2rad(options.max_tool_rotation_deg) * inside)
    # The clearance's bound falls short of the distance by up to its resolution.
    assert clearance.margin == pytest.approx(options.safety_margin_m + 1e-5 + RESOLUTION)
    assert [each.components for each in fixed.constraints] == [14, 1, None, 2, 4, 1]
    assert fixed.joints == asked.cell.robot.joints


@pytest.mark.parametrize("kind", ["fixed", "free", "pinned"])
def test_segments(kind: str) -> None:
    """At ends inside the path the arm rests and stays; what is known of the whole path is known of them."""
    problem = torque_problem(kind, 1.0)
    resting = {"fixed": {0, 7}, "free": set(), "pinned": {0}}[kind]
    for first, last in ((0, 4), (2, 6), (3, 7)):
        segment = problem.segment(first, last)
        part = slice(first, last + 1)
        np.testing.assert_array_equal(segment.space.t, problem.space.t[part])
        np.testing.assert_array_equal(segment.at_via_points, problem.at_via_points[part])
        assert segment.least == pytest.approx(problem.lower_bound * problem.scale)
        stays = [k for k in (first, last) if k in resting or 0 < k < 7]
        at_rest = problem.at_via_points[stays].max(initial=segment.least)
        assert segment.lower_bound * segment.scale == pytest.approx(at_rest)
