"""The joint path: the robust inverse to the letter, the tool on its path, and what ends it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenes import context_of, parts, short_scene

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.path.gradient_projection import JointPath, follow_path, robust_inverse
from cmbot.planning.task import ToolTask
from cmbot.robot import Kinematics, Robot
from cmbot.scene import PlannerOptions, Scene, load_scene

OPTIONS = PlannerOptions(knots="fixed")


def path_of(scene: Scene, **options: Any) -> tuple[Robot, ToolTask, Clearances, JointPath]:
    context = context_of(scene, **options)
    return context.robot, context.task, context.clearances, follow_path(context)


@pytest.fixture(scope="module")
def triangle() -> Scene:
    return load_scene("triangle")


@pytest.fixture(scope="module")
def triangle_path(triangle: Scene) -> tuple[Robot, ToolTask, Clearances, JointPath]:
    return path_of(triangle, path_step_s=0.02)


def jacobian(seed: int, smallest: float) -> FloatArray:
    """Random 6 x 7 matrix with singular values down to `smallest`."""
    rng = np.random.default_rng(seed)
    U, V = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (6, 7))
    s = np.sort(np.append(rng.uniform(0.5, 2, 5), smallest))[::-1]
    return U @ (s[:, None] * V[:6])


@given(seed=st.integers(0, 2**32 - 1), s_6=st.floats(0.1, 0.5))
def test_away_from_singularities_the_inverse_is_the_pseudoinverse(seed: int, s_6: float) -> None:
    J = jacobian(seed, s_6 * (1 + 1e-9))
    np.testing.assert_allclose(robust_inverse(J, OPTIONS), np.linalg.pinv(J), rtol=0, atol=1e-11)


@given(
    seed=st.integers(0, 2**32 - 1),
    s_6=st.floats(0, 0.3),
    s_h=st.floats(0.01, 0.3),
    damping=st.floats(0.01, 1),
)
def test_inverse_is_equations_20_and_21(seed: int, s_6: float, s_h: float, damping: float) -> None:
    J = jacobian(seed, s_6)
    s = np.linalg.svd(J, compute_uv=False)[-1]
    lam = damping * (1 - s / s_h) if s < s_h else 0.0
    if max(s, lam) < 1e-2:
        return  # the literal form itself loses its digits there
    expected = J.T @ np.linalg.inv(J @ J.T + lam**2 * np.eye(6))
    got = robust_inverse(J, replace(OPTIONS, damping_max=damping, damping_threshold=s_h))
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@given(seed=st.integers(0, 2**32 - 1), s_6=st.floats(0, 0.1))
def test_inverse_is_bounded_near_singularities(seed: int, s_6: float) -> None:
    """The gain s/(s^2 + lambda^2) is largest just below s_h, where it is hardly more than 1/s_h."""
    got = robust_inverse(jacobian(seed, s_6), OPTIONS)
    assert np.linalg.norm(got, 2) <= 1.05 / OPTIONS.damping_threshold


def test_damping_of_zero_is_the_plain_inverse() -> None:
    J = jacobian(1, 0.01)
    got = robust_inverse(J, replace(OPTIONS, damping_max=0.0))
    np.testing.assert_allclose(got, np.linalg.pinv(J), rtol=0, atol=1e-10)


def test_the_tool_follows_the_triangle(
    triangle_path: tuple[Robot, ToolTask, Clearances, JointPath],
) -> None:
    robot, task, clearances, path = triangle_path
    p_WT, R_WT = Kinematics(robot).tool_poses(path.q)
    np.testing.assert_allclose(
        path.drift, np.linalg.norm(p_WT - task.path.position(path.t), axis=1), atol=1e-12
    )
    # 0.05 mm and 0.01 degrees at a step of 20 ms, well within the promised millimetre.
    assert path.drift.max() < 5e-5
    assert task.rotation(R_WT).max() < np.deg2rad(0.01)
    np.testing.assert_allclose(path.t, np.linspace(0, 20, 1001), atol=1e-12)
    np.testing.assert_allclose(path.q[1:], path.q[:-1] + path.t[1] * path.v[:-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(path.clearance, clearances.smallest(path.q).distance, atol=1e-8)
    kinematics = Kinematics(robot)
    smallest = [np.linalg.svd(kinematics.tool_jacobian(q)[1], compute_uv=False)[-1] for q in path.q]
    np.testing.assert_allclose(path.singular_value, smallest, atol=1e-12)


def test_the_drift_falls_with_the_step() -> None:
    scene = short_scene()
    drift = [path_of(scene, path_step_s=step)[3].drift.max() for step in (0.04, 0.02, 0.01)]
    assert drift[0] < 1e-3
    assert drift[1] < 0.6 * drift[0]
    assert drift[2] < 0.6 * drift[1]


@pytest.mark.parametrize("keep", ["pose", "axis", "position"])
def test_what_is_kept_and_what_is_free(keep: str) -> None:
    scene = short_scene(tool_path={"keep": keep})
    robot, task, _, path = path_of(scene)
    p_WT, R_WT = Kinematics(robot).tool_poses(path.q)
    assert np.linalg.norm(p_WT - task.path.position(path.t), axis=1).max() < 1e-4
    axis = np.arccos(np.clip(R_WT[:, :, 2] @ task.path.orientation[:, 2], -1, 1))
    whole = np.linalg.norm(R_WT - task.path.orientation, axis=(1, 2))
    assert (axis.max() < 1e-3) == (keep != "position")
    assert (whole.max() < 1e-3) == (keep == "pose")


def test_path_ends_at_an_obstacle() -> None:
    wall = {"name": "wall", "box": [1, 0.02, 1], "xyz": [1.8, 0.45, -2.0]}
    scene = short_scene(obstacles=[wall])
    with pytest.raises(
        PathNotFound, match=r"comes within .* m of wall, the safety margin is 0.02 m"
    ) as caught:
        path_of(scene)
    error = caught.value
    assert error.pair[1] == "wall"
    assert 0 < error.time < 4
    assert 0.1 < error.progress < 0.95
    assert error.progress == pytest.approx(parts(scene)[1].path.progress(error.time))
    assert 0 < error.smallest_singular_value < 1


def test_path_ends_at_a_joint_range() -> None:
    scene = short_scene(tool_path={"legs": [{"by": [0, 0, 0.9], "seconds": 8}]}, guardrail={"bays": 0})
    with pytest.raises(PathNotFound, match=r"joint_\d leaves its range -?\d+ to \d+ deg \(") as caught:
        path_of(scene, avoidance_gain=0.0, safety_margin_m=0.0)
    assert caught.value.pair is None
    assert 0 < caught.value.progress < 1


def test_path_ends_out_of_reach() -> None:
    scene = short_scene(tool_path={"legs": [{"by": [2.5, 0, -2.5], "seconds": 30}]})
    with pytest.raises(PathNotFound, match=r"the tool is 0.0\d\d m behind its path: out of reach") as caught:
        path_of(scene)
    error = caught.value
    assert error.pair is None
    assert 0 < error.progress < 1
    assert error.smallest_singular_value < 0.1
    assert f"{error.progress:.0%} of the tool path" in str(error)


def test_carrying_on_whatever_happens() -> None:
    wall = {"name": "wall", "box": [1, 0.02, 1], "xyz": [1.8, 0.45, -2.0]}
    context = context_of(short_scene(obstacles=[wall]))
    path = follow_path(context, stop_at_obstacles=False)
    assert path.clearance.min() < 0.02
    assert path.t[-1] == context.task.path.duration
