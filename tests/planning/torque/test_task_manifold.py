"""Via-points that hold the tool task while they move along the self-motion."""

from dataclasses import replace

import numpy as np
import pytest
from finite_differences import check_derivative
from small_scenes import goals_at, off_task, problem_of, short_scene

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed
from cmbot.planning.request import StrokeRequest
from cmbot.planning.torque.problem import TaskManifold, parametrization_through


@pytest.fixture(scope="module", params=["pose", "axis"])
def given(request: pytest.FixtureRequest) -> tuple[StrokeRequest, TaskManifold, FloatArray]:
    problem = problem_of(short_scene(tool_path={"keep": request.param}))
    asked = problem.request
    manifold = TaskManifold(asked.cell.postures, asked.task, asked.goals, asked.times)
    return asked, manifold, problem.parametrization.via_points


Given = tuple[StrokeRequest, TaskManifold, FloatArray]


def test_tangents_are_orthonormal_and_keep_the_task(given: Given) -> None:
    asked, manifold, q = given
    tangents = manifold.tangents(q)
    identity = np.broadcast_to(np.eye(tangents.shape[1]), (len(q), *2 * (tangents.shape[1],)))
    np.testing.assert_allclose(tangents @ tangents.transpose(0, 2, 1), identity, rtol=0, atol=1e-12)
    for tangent in tangents.transpose(1, 0, 2):
        # Errors grow with the square of the step.
        assert off_task(asked.cell.robot, asked.task, q + 1e-4 * tangent, asked.goals) < 1e-7


def test_retracted_via_points(given: Given, rng: np.random.Generator) -> None:
    asked, manifold, q = given
    tangents = manifold.tangents(q)
    u = 0.2 * rng.normal(size=tangents.shape[:2])
    moved, slope = manifold.retract(q, tangents, u, np.arange(len(q)))
    assert off_task(asked.cell.robot, asked.task, moved, asked.goals) < 1e-10
    np.testing.assert_allclose(np.einsum("kai,ki->ka", tangents, moved - q), u, rtol=0, atol=1e-10)
    some = np.array([1, 4, 6])
    apart, slopes = manifold.retract(q, tangents[some], u[some], some)
    np.testing.assert_allclose(apart, moved[some], rtol=0, atol=1e-12)
    np.testing.assert_allclose(slopes, slope[some], rtol=0, atol=1e-12)
    part = manifold.part(2, 6).retract(q[2:7], tangents[2:7], u[2:7], np.arange(5))[0]
    np.testing.assert_allclose(part, moved[2:7], rtol=0, atol=1e-12)
    for k in some:
        check_derivative(
            lambda y, k=k: manifold.retract(q, tangents[[k]], y[None], np.array([k]))[0][0],
            u[k],
            slope[k].T,
            step=3e-3,
            rtol=1e-6,
        )


def test_where_the_task_cannot_be_held(given: Given) -> None:
    _, manifold, q = given
    away = replace(manifold, goals=goals_at(manifold.task, 9.0 + manifold.goals.point))
    with pytest.raises(OptimisationFailed, match="where the tool task cannot be held") as caught:
        away.retract(q, manifold.tangents(q), np.zeros((len(q), 1)), np.arange(len(q)))
    assert caught.value.constraint == "tool task at a via-point"
    assert caught.value.violation > 1.0


@pytest.mark.parametrize(("sliding", "pinned"), [(False, False), (True, False), (True, True)])
def test_steps_of_the_parametrization(
    given: Given, sliding: bool, pinned: bool, rng: np.random.Generator
) -> None:
    asked, manifold, q = given
    form = parametrization_through(asked, q, sliding=sliding, pinned=pinned)
    expected = form.space.trajectory(form.space.least_jerk(q))
    for name in "qva":
        np.testing.assert_allclose(
            getattr(form.trajectory, name), getattr(expected, name), rtol=0, atol=1e-10
        )
    limits = asked.cell.robot.limits
    np.testing.assert_array_equal(form.splines.bounds, [limits.velocity, limits.acceleration, limits.jerk])
    a = manifold.tangents(q).shape[1]
    assert form.dimension == 7 * (len(q) - 4) + (a * (len(q) - pinned) if sliding else 0)
    moved = form.step(0.3 * rng.normal(size=form.dimension))
    assert off_task(asked.cell.robot, asked.task, moved.via_points, asked.goals) < 1e-10
    change = np.abs(moved.via_points - q).max(axis=1)
    assert (change[1:] > 1e-3).all() == sliding
    assert (change[0] == 0.0) == (pinned or not sliding)
    for order in range(4):
        scale = np.abs(moved.trajectory.extrema(order).value).max()
        assert np.abs(moved.trajectory.jumps(order)).max() < 1e-11 * scale
