"""The tool task: its error leads to the goal, its Jacobian belongs to it, its angles are right."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import check_derivative, finite_difference
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation
from small_scenes import goals_at, path_through

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.planning.task import ToolTask
from cmbot.scene import AxisCone
from cmbot.toolpath import ToolPoses

SIZES = {"pose": 6, "axis": 5, "position": 3}
every_kind = pytest.mark.parametrize("keep", SIZES)
seeds = st.integers(0, 2**32 - 1)


def task_of(keep: Any, R_goal: FloatArray) -> ToolTask:
    return ToolTask(path_through(np.eye(3)[:2], R_goal), keep)


def missed(task: ToolTask, R_WT: FloatArray) -> FloatArray:
    return task.rotation(R_WT, task.path.poses([0.0]))


def random_rotation(rng: np.random.Generator) -> FloatArray:
    return Rotation.random(rng=rng).as_matrix()


def unit_vector(rng: np.random.Generator) -> FloatArray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def turn(axis: FloatArray, angle: float) -> FloatArray:
    return Rotation.from_rotvec(angle * axis).as_matrix()


def moved(X_WT: Any, twist: FloatArray) -> Any:
    """Move a pose along a twist: linear of the tool point, angular, both in W."""
    return pin.SE3(Rotation.from_rotvec(twist[3:]).as_matrix() @ X_WT.rotation, X_WT.translation + twist[:3])


@settings(max_examples=30)
@given(seed=seeds, tilt=st.floats(0, 3.1), roll=st.floats(-3, 3))
def test_a_cone_leaves_the_point_and_measures_the_axis(seed: int, tilt: float, roll: float) -> None:
    rng = np.random.default_rng(seed)
    R = random_rotation(rng)
    task = ToolTask.of(task_of("pose", R).path, AxisCone(axis_within_deg=10), 0.2)
    assert (task.keep, task.max_speed, task.dimension) == ("position", 0.2, 3)
    assert task.cone == pytest.approx(np.radians(10))
    assert task.error(pin.SE3(R, np.ones(3)), goals_at(task, np.zeros(3))).shape == (3,)
    leaning = turn(R @ [np.cos(roll), np.sin(roll), 0], tilt) @ R @ turn(np.eye(3)[2], roll)
    assert missed(task, leaning[None])[0] == pytest.approx(tilt, abs=1e-7)
    assert (task.kept, task.on_axis.kept) == ("axis within 10 deg", "axis")
    axis = task.on_axis
    assert (axis.keep, axis.cone, axis.dimension, axis.path) == ("axis", None, 5, task.path)
    assert axis.on_axis is axis
    # An axis that leans is held where that takes it.
    held = task.leaning(turn(np.array([0.0, 1.0, 0.0]), tilt))
    assert missed(axis, held.goals([0.0]).rotation)[0] == pytest.approx(tilt, abs=1e-7)
    assert task.held_at_start().cone == task.cone


def test_only_a_free_axis_has_a_cone() -> None:
    with pytest.raises(InputError, match=r"^ToolTask: cone: got 0.1, expected None, or keep: position$"):
        ToolTask(task_of("axis", np.eye(3)).path, "axis", cone=0.1)


@every_kind
@settings(max_examples=30)
@given(seed=seeds)
def test_error_is_zero_at_the_goal_and_only_there(keep: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, point = random_rotation(rng), rng.normal(size=3)
    task = task_of(keep, R)
    at_goal = task.error(pin.SE3(R, point), goals_at(task, point))
    assert at_goal.shape == (SIZES[keep],)
    np.testing.assert_allclose(at_goal, 0.0, rtol=0, atol=1e-14)
    away = task.error(pin.SE3(R, point + np.array([0.0, 1e-9, 0.0])), goals_at(task, point))
    np.testing.assert_allclose(away[:3], [0.0, -1e-9, 0.0], rtol=0, atol=1e-15)
    if keep != "position":
        tilted = task.error(pin.SE3(turn(R[:, 0], 1e-9) @ R, point), goals_at(task, point))
        assert np.linalg.norm(tilted) == pytest.approx(1e-9, rel=1e-5)


@every_kind
@settings(max_examples=30)
@given(seed=seeds)
def test_jacobian_is_minus_the_derivative_of_the_error_at_the_goal(keep: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    task = task_of(keep, random_rotation(rng))
    point, J = rng.normal(size=3), rng.normal(size=(6, 7))
    X_WT = pin.SE3(task.path.orientation, point)
    got = task.jacobian(X_WT.rotation, J)
    assert got.shape == (SIZES[keep], 7)
    check_derivative(
        lambda x: -task.error(moved(X_WT, J @ x), goals_at(task, point)), np.zeros(7), got, rtol=0, atol=1e-8
    )


@every_kind
@settings(max_examples=30)
@given(seed=seeds)
def test_near_the_goal_the_jacobian_is_wrong_by_no_more_than_the_tilt(keep: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tilt = 1e-3
    task = task_of(keep, random_rotation(rng))
    point, J = rng.normal(size=3), rng.normal(size=(6, 7))
    X_WT = pin.SE3(turn(unit_vector(rng), tilt) @ task.path.orientation, rng.normal(size=3))
    dq = rng.normal(size=7)
    slope = finite_difference(
        lambda s: task.error(moved(X_WT, s * (J @ dq)), goals_at(task, point)), np.zeros(1)
    )[:, 0]
    wrong = slope + task.jacobian(X_WT.rotation, J) @ dq
    np.testing.assert_allclose(wrong[:3], 0.0, rtol=0, atol=1e-8)
    assert np.linalg.norm(wrong) <= 2 * tilt * np.linalg.norm(J[3:] @ dq) + 1e-8


@given(seeds)
def test_turning_by_the_error_reaches_the_goal_from_anywhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, R_goal, point = random_rotation(rng), random_rotation(rng), rng.normal(size=3)
    X_WT = pin.SE3(R, rng.normal(size=3))
    pose_task, axis_task = task_of("pose", R_goal), task_of("axis", R_goal)
    goal = goals_at(pose_task, point)
    pose = pose_task.error(X_WT, goal)
    reached = moved(X_WT, pose)
    np.testing.assert_allclose(reached.translation, point, rtol=0, atol=1e-14)
    np.testing.assert_allclose(reached.rotation, R_goal, rtol=0, atol=1e-7)
    axis = axis_task.error(X_WT, goal)
    reached = moved(X_WT, np.concatenate([axis[:3], R[:, :2] @ axis[3:]]))
    np.testing.assert_allclose(reached.rotation[:, 2], R_goal[:, 2], rtol=0, atol=1e-12)
    # And on the shortest way.
    angle = np.arccos(np.clip(R[:, 2] @ R_goal[:, 2], -1, 1))
    assert np.linalg.norm(axis[3:]) == pytest.approx(angle, abs=1e-7)


@given(seeds, st.floats(-np.pi, np.pi))
def test_axis_does_not_care_for_a_turn_about_the_tools_own_z(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    R = random_rotation(rng)
    task = task_of("axis", R)
    turned = R @ turn(np.array([0.0, 0.0, 1.0]), angle)
    at_goal = task.error(pin.SE3(turned, np.zeros(3)), goals_at(task, np.zeros(3)))
    np.testing.assert_allclose(at_goal, 0.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(missed(task, turned[None]), 0.0, rtol=0, atol=1e-14)
    # The pose does care.
    np.testing.assert_allclose(missed(task_of("pose", R), turned[None]), abs(angle), rtol=0, atol=1e-7)
    # Away from the goal the missing angle does not depend on that turn either.
    tilted = turn(R[:, 0], 0.3) @ np.array([R, turned])
    np.testing.assert_allclose(missed(task, tilted), 0.3, rtol=0, atol=1e-13)
    spin = np.array([0.0, 0.0, 0.0, *turned[:, 2]])[:, None]
    np.testing.assert_allclose(task.jacobian(turned, spin), 0.0, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    "angle", [0.0, 1e-9, 1e-6, 1e-3, 0.5, np.pi / 2, 3.0, np.pi - 1e-4, np.pi - 1e-9, np.pi]
)
def test_rotation_angles(angle: float) -> None:
    rng = np.random.default_rng(11)
    R_goal = random_rotation(rng)
    pose, axis = task_of("pose", R_goal), task_of("axis", R_goal)
    turned = np.array([turn(unit_vector(rng), angle) @ R_goal for _ in range(20)])
    # A small angle keeps its figures; next to half a turn the chord flattens out, and half of them are left.
    tolerance = 1e-15 + 1e-14 * angle if angle < 3 else 1e-7
    np.testing.assert_allclose(missed(pose, turned), angle, rtol=0, atol=2 * tolerance)
    across = [R_goal[:, :2] @ unit_vector(rng)[:2] for _ in range(20)]
    tilted = np.array([turn(x / np.linalg.norm(x), angle) @ R_goal for x in across])
    np.testing.assert_allclose(missed(axis, tilted), angle, rtol=0, atol=2e-15 + 1e-14 * angle)
    assert not missed(task_of("position", R_goal), turned).any()


@given(seeds)
def test_rotation_is_the_length_of_the_rotational_error(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R_goal, R = random_rotation(rng), np.array([random_rotation(rng) for _ in range(5)])
    for keep in ("pose", "axis"):
        task = task_of(keep, R_goal)
        goal = goals_at(task, np.zeros(3))
        lengths = [np.linalg.norm(task.error(pin.SE3(x, np.zeros(3)), goal)[3:]) for x in R]
        np.testing.assert_allclose(missed(task, R), lengths, rtol=0, atol=1e-7)
    assert missed(task_of("position", R_goal), R).shape == (5,)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("slip", [0.0, 1e-14, 1e-13, 1e-10])
def test_an_opposite_axis_is_half_a_turn_away(axis: int, slip: float) -> None:
    # Every column of the identity in turn is the tool's z.
    R_goal = np.roll(np.eye(3), axis, axis=1)
    task = task_of("axis", R_goal)
    R = turn(R_goal[:, 0], np.pi - slip) @ R_goal
    error = task.error(pin.SE3(R, np.zeros(3)), goals_at(task, np.zeros(3)))
    assert np.linalg.norm(error[3:]) == pytest.approx(np.pi, abs=1e-9)
    reached = moved(pin.SE3(R, np.zeros(3)), np.concatenate([np.zeros(3), R[:, :2] @ error[3:]]))
    np.testing.assert_allclose(reached.rotation[:, 2], R_goal[:, 2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(missed(task, R[None]), np.pi, rtol=0, atol=1e-9)


@given(seeds)
def test_a_pose_half_a_turn_away_has_an_error_of_that_length(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R_goal = random_rotation(rng)
    R = turn(unit_vector(rng), np.pi) @ R_goal
    task = task_of("pose", R_goal)
    error = task.error(pin.SE3(R, np.zeros(3)), goals_at(task, np.zeros(3)))
    assert np.linalg.norm(error[3:]) == pytest.approx(np.pi, abs=1e-7)


@pytest.mark.parametrize("keep", ["orientation", "", "Pose", None])
def test_an_unknown_kind_is_refused_and_the_known_ones_named(keep: Any) -> None:
    with pytest.raises(InputError, match="one of: pose, axis, position") as caught:
        task_of(keep, np.eye(3))
    assert (caught.value.source, caught.value.key) == ("ToolTask", "keep")


def test_the_whole_pose_is_kept_unless_told_otherwise() -> None:
    assert ToolTask(task_of("axis", np.eye(3)).path).keep == "pose"


@every_kind
@given(seeds)
def test_goals_of_each_are_those_of_one_at_a_time(keep: str, seed: int) -> None:
    """Also where a turn is nearly half a one."""
    rng = np.random.default_rng(seed)
    task, R = task_of(keep, np.eye(3)), Rotation.random(6, rng=rng).as_matrix()
    turns = rng.choice([1e-9, 0.3, 2.9, np.pi - 1e-6], 6)[:, None] * np.array([unit_vector(rng) for _ in R])
    goals = ToolPoses(point=rng.normal(size=(6, 3)), rotation=Rotation.from_rotvec(turns).as_matrix() @ R)
    p = rng.normal(size=(6, 3))
    together = task.errors(p, R, goals)
    for k, goal in enumerate(goals):
        alone = task.errors(p[k : k + 1], R[k : k + 1], goal)[0]
        np.testing.assert_allclose(together[k], alone, rtol=0, atol=1e-8)
        np.testing.assert_allclose(
            task.rotation(R, goals)[k], task.rotation(R[k : k + 1], goal)[0], rtol=0, atol=1e-12
        )
    if keep == "pose":
        np.testing.assert_allclose(task.rotation(R, goals), np.linalg.norm(turns, axis=1), rtol=0, atol=1e-7)
