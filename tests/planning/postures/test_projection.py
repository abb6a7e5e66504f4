"""Projection onto the tool task, null spaces, and the small linear systems below them, against LAPACK."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from small_scenes import goals_at, off_task, task_at

from cmbot.planning.postures.projection import (
    gram,
    null_directions,
    null_space,
    project_onto_task,
    solve_batch,
)
from cmbot.robot import Kinematics, Postures, Robot

sizes = st.integers(1, 7)
seeds = st.integers(0, 2**32 - 1)
every_kind = pytest.mark.parametrize("keep", ["pose", "axis", "position"])


@given(seeds, sizes, st.integers(1, 3), st.integers(0, 20))
def test_solutions_are_those_of_lapack(seed: int, m: int, k: int, number: int) -> None:
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(m, m + 2, number)), rng.normal(size=(m, k, number))
    G = gram(A, 0.1)
    for i in range(number):
        np.testing.assert_allclose(G[..., i], A[..., i] @ A[..., i].T + 0.1 * np.eye(m), atol=1e-13)
    before = G.copy(), b.copy()
    x = solve_batch(G, b)
    assert x.shape == b.shape
    for i in range(number):
        expected = np.linalg.solve(G[..., i], b[..., i])
        np.testing.assert_allclose(x[..., i], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_array_equal(G, before[0])
    np.testing.assert_array_equal(b, before[1])


@given(seeds, sizes, sizes, st.integers(0, 20))
def test_null_directions_are_orthonormal_and_all_there_are(seed: int, m: int, n: int, number: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(m, n, number))
    before = A.copy()
    N = null_directions(A)
    d = max(n - m, 0)
    assert N.shape == (d, n, number)
    for i in range(number):
        np.testing.assert_allclose(N[..., i] @ N[..., i].T, np.eye(d), atol=1e-12)
        np.testing.assert_allclose(A[..., i] @ N[..., i].T, 0.0, atol=1e-12)
    np.testing.assert_array_equal(A, before)


def test_null_directions_where_rows_depend_on_each_other_or_are_zero(rng: np.random.Generator) -> None:
    A = rng.normal(size=(5, 7, 3))
    A[4, :, 0] = A[3, :, 0]
    A[2, :, 1] = 0.0
    A[:, :, 2] = 0.0
    N = null_directions(A)
    for i in range(3):
        np.testing.assert_allclose(N[..., i] @ N[..., i].T, np.eye(2), atol=1e-12)
        np.testing.assert_allclose(A[..., i] @ N[..., i].T, 0.0, atol=1e-12)


@every_kind
def test_null_spaces_leave_the_task_alone(cmbot_robot: Robot, keep: str, rng: np.random.Generator) -> None:
    limits, postures = cmbot_robot.limits, Postures(cmbot_robot)
    q = rng.uniform(limits.lower, limits.upper, (20, 7))
    task = task_at(cmbot_robot, q[0], keep)
    N, at = null_space(postures, task, q), postures.at(q)
    J = task.jacobian(at.tool_rotation, at.jacobian)
    d = 7 - task.dimension
    assert N.shape == (20, d, 7)
    np.testing.assert_allclose(J @ N.transpose(0, 2, 1), 0.0, atol=1e-12)
    np.testing.assert_allclose(N @ N.transpose(0, 2, 1), np.broadcast_to(np.eye(d), (20, d, d)), atol=1e-12)


@every_kind
def test_what_is_put_onto_the_task_lies_on_it(any_arm: Robot, keep: str, rng: np.random.Generator) -> None:
    """Also where the last step was so short that its error was not computed."""
    postures = Postures(any_arm)
    q = rng.uniform(-2.0, 2.0, (400, any_arm.dof))
    task = task_at(any_arm, q[0], keep)
    goal = task.path.poses([0.0])
    placed = q[0] + rng.normal(size=q.shape) * 10.0 ** rng.uniform(-9, -1, (400, 1))
    placed, reached = project_onto_task(postures, task, placed, goal)
    assert reached.sum() > 350
    assert off_task(any_arm, task, placed[reached], goal) < 1e-10


@every_kind
def test_steps_bend_no_more_than_postures_say(any_arm: Robot, keep: str, rng: np.random.Generator) -> None:
    postures = Postures(any_arm)
    q = rng.uniform(-2.0, 2.0, (300, any_arm.dof))
    moves = rng.normal(size=q.shape) * (rng.uniform(size=q.shape) < 0.5)
    moves[np.arange(300), rng.integers(0, any_arm.dof, 300)] = 1.0
    moves *= 1e-3 / np.abs(moves).sum(axis=1, keepdims=True)
    for q_k, move in zip(q, moves, strict=True):
        task = task_at(any_arm, q_k, keep)
        at = postures.at(np.stack([q_k, q_k - move]))
        error = task.errors(at.tool_point, at.tool_rotation, task.path.poses([0.0]))
        J = task.jacobian(at.tool_rotation, at.jacobian)[1]
        left = np.abs(error[1] - J @ move).max()
        assert left <= postures.bend * np.abs(move).sum() ** 2


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), keep=st.sampled_from(["pose", "axis", "position"]))
def test_placing_on_the_task(cmbot_robot: Robot, seed: int, keep: Any) -> None:
    rng = np.random.default_rng(seed)
    q = np.deg2rad([-10, -90, 90, 0, 10, 50, 0]) + rng.uniform(-0.3, 0.3, 7)
    task, kinematics = task_at(cmbot_robot, q, keep), Kinematics(cmbot_robot)
    off = rng.uniform(-0.01, 0.01, 7)
    X_WT, J = kinematics.tool_jacobian(q)
    goal = task.path.poses([0.0])
    placed, reached = project_onto_task(Postures(cmbot_robot), task, (q + off)[None], goal, tolerance=1e-12)
    assert reached.all()
    assert np.abs(task.error(kinematics.tool_pose(placed[0]), goal)).max() < 1e-9
    # To first order the part of `off` in the task's null space stays.
    J = task.jacobian(X_WT.rotation, J)
    null = np.eye(7) - np.linalg.pinv(J) @ J
    np.testing.assert_allclose(placed[0] - q, null @ off, rtol=0, atol=20 * off @ off)


@every_kind
def test_held_directions_keep_their_place(cmbot_robot: Robot, keep: str, rng: np.random.Generator) -> None:
    postures, q = Postures(cmbot_robot), rng.uniform(-2.0, 2.0, 7)
    task = task_at(cmbot_robot, q, keep)
    null = null_space(postures, task, q[None])
    u = rng.uniform(-0.05, 0.05, (20, 7 - task.dimension))
    placed, reached = project_onto_task(
        postures, task, q + u @ null[0], task.path.poses([0.0]), steps=12, held=np.repeat(null, 20, axis=0)
    )
    assert reached.all()
    np.testing.assert_allclose((placed - q) @ null[0].T, u, rtol=0, atol=1e-9)


def test_what_is_out_of_reach_cannot_be_placed(cmbot_robot: Robot) -> None:
    q = np.deg2rad([-10, -90, 90, 0, 10, 50, 0])
    task = task_at(cmbot_robot, q)
    far = goals_at(task, np.array([9.0, 0, 0]))
    _, reached = project_onto_task(Postures(cmbot_robot), task, q[None], far, steps=50)
    assert not reached.any()
