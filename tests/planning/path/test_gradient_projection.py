"""The joint path: the robust inverse and avoidance to the letter, the tool on its path, and what ends it.

And other starts: self-motion holds the tool, the nearest comes first, failures are told.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from small_scenes import parts, request_of, short_scene

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning import Plan, Progress, plan
from cmbot.planning.budget import Deadline
from cmbot.planning.path.gradient_projection import (
    JointPath,
    find_path,
    follow_path,
    robust_inverse,
    self_motion_postures,
)
from cmbot.planning.progress import ProgressReporter
from cmbot.planning.request import StrokeRequest
from cmbot.robot import Dynamics, Kinematics
from cmbot.scene import PlannerOptions, Scene, load_scene
from cmbot.toolpath import ToolPath

OPTIONS = PlannerOptions(knots="fixed")
# Beside the tool's way at first, then across it.
WALL = {"name": "wall", "box": [1, 0.02, 1], "xyz": [1.8, 0.45, -2.0]}
seeds = st.integers(0, 2**32 - 1)
Followed = tuple[StrokeRequest, JointPath]


def path_of(scene: Scene, **options: Any) -> Followed:
    asked = request_of(scene, **options)
    return asked, follow_path(asked)


@pytest.fixture(scope="module")
def triangle_path() -> Followed:
    triangle = load_scene("triangle").as_data()
    triangle["tool_path"]["speed_profile"] = {"kind": "trapezoidal", "ramp": 0.2}
    return path_of(load_scene(triangle), path_step_s=0.02)


def jacobian(seed: int, smallest: float) -> FloatArray:
    """Random 6 x 7 matrix with singular values down to `smallest`."""
    rng = np.random.default_rng(seed)
    U, V = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (6, 7))
    s = np.sort(np.append(rng.uniform(0.5, 2, 5), smallest))[::-1]
    return U @ (s[:, None] * V[:6])


@given(seed=seeds, s_6=st.floats(0.1, 0.5))
def test_away_from_singularities_and_undamped_the_inverse_is_the_pseudoinverse(seed: int, s_6: float) -> None:
    J = jacobian(seed, s_6 * (1 + 1e-9))
    np.testing.assert_allclose(robust_inverse(J, OPTIONS), np.linalg.pinv(J), rtol=0, atol=1e-11)
    J, undamped = jacobian(seed, 0.01), replace(OPTIONS, damping_max=0.0)
    np.testing.assert_allclose(robust_inverse(J, undamped), np.linalg.pinv(J), rtol=0, atol=1e-10)


@given(seed=seeds, s_6=st.floats(0, 0.3), s_h=st.floats(0.01, 0.3), damping=st.floats(0.01, 1))
def test_inverse_is_equations_20_and_21(seed: int, s_6: float, s_h: float, damping: float) -> None:
    J = jacobian(seed, s_6)
    s = np.linalg.svd(J, compute_uv=False)[-1]
    lam = damping * (1 - s / s_h) if s < s_h else 0.0
    if max(s, lam) < 1e-2:
        return  # the literal form itself loses its digits there
    expected = J.T @ np.linalg.inv(J @ J.T + lam**2 * np.eye(6))
    got = robust_inverse(J, replace(OPTIONS, damping_max=damping, damping_threshold=s_h))
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@given(seed=seeds, s_6=st.floats(0, 0.1))
def test_inverse_is_bounded_near_singularities(seed: int, s_6: float) -> None:
    """The gain s/(s^2 + lambda^2) is largest just below s_h, where it is hardly more than 1/s_h."""
    got = robust_inverse(jacobian(seed, s_6), OPTIONS)
    assert np.linalg.norm(got, 2) <= 1.05 / OPTIONS.damping_threshold


def test_the_tool_follows_the_triangle(triangle_path: Followed) -> None:
    asked, path = triangle_path
    task, kinematics = asked.task, Kinematics(asked.cell.robot)
    p_WT, R_WT = kinematics.tool_poses(path.q)
    np.testing.assert_allclose(
        path.drift, np.linalg.norm(p_WT - task.path.position(path.t), axis=1), atol=1e-12
    )
    # 0.05 mm and 0.01 degrees at a step of 20 ms, well within the promised millimetre.
    assert path.drift.max() < 5e-5
    assert task.rotation(R_WT, task.path.poses([0.0])).max() < np.deg2rad(0.01)
    np.testing.assert_allclose(path.t, np.linspace(0, 20, 1001), atol=1e-12)
    np.testing.assert_allclose(path.q[1:], path.q[:-1] + path.t[1] * path.v[:-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(path.clearance, asked.cell.clearances.query(path.q).distance, atol=1e-8)
    smallest = [np.linalg.svd(kinematics.tool_jacobian(q)[1], compute_uv=False)[-1] for q in path.q]
    np.testing.assert_allclose(path.singular_value, smallest, atol=1e-12)


def test_the_drift_falls_with_the_step() -> None:
    scene = short_scene()
    drift = [path_of(scene, path_step_s=step)[1].drift.max() for step in (0.04, 0.02, 0.01)]
    assert drift[0] < 1e-3
    assert drift[1] < 0.6 * drift[0]
    assert drift[2] < 0.6 * drift[1]


@pytest.mark.parametrize("keep", ["pose", "axis", "position"])
def test_what_is_kept_and_what_is_free(keep: str) -> None:
    scene = short_scene(tool_path={"keep": keep})
    asked, path = path_of(scene)
    task = asked.task
    p_WT, R_WT = Kinematics(asked.cell.robot).tool_poses(path.q)
    assert np.linalg.norm(p_WT - task.path.position(path.t), axis=1).max() < 1e-4
    axis = np.arccos(np.clip(R_WT[:, :, 2] @ task.path.orientation[:, 2], -1, 1))
    whole = np.linalg.norm(R_WT - task.path.orientation, axis=(1, 2))
    assert (axis.max() < 1e-3) == (keep != "position")
    assert (whole.max() < 1e-3) == (keep == "pose")


def test_path_ends_at_an_obstacle() -> None:
    scene = short_scene(obstacles=[WALL])
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
    with pytest.raises(
        PathNotFound, match=r"the tool is 0.0\d\d m behind its path, which gradient projection"
    ) as caught:
        path_of(scene)
    error = caught.value
    assert error.pair is None
    assert 0 < error.progress < 1
    assert error.smallest_singular_value < 0.1
    assert f"{error.progress:.0%} of the tool path" in str(error)


def test_carrying_on_whatever_happens() -> None:
    asked = request_of(short_scene(obstacles=[WALL]))
    path = follow_path(asked, stop_at_obstacles=False)
    assert path.clearance.min() < 0.02
    assert path.t[-1] == asked.task.path.duration


@pytest.fixture(scope="module")
def near_postures(triangle_path: Followed) -> FloatArray:
    asked, path = triangle_path
    q = path.q[::20] + np.random.default_rng(3).uniform(-0.1, 0.1, path.q[::20].shape)
    near = asked.cell.clearances.query(q, avoidable_only=True).distance
    return q[(near > 0.005) & (near < 0.14)]


def self_motion(asked: StrokeRequest, q: FloatArray, **options: Any) -> FloatArray:
    """Joint rates at `q` when the tool is to stay where it is."""
    X_WT = Kinematics(asked.cell.robot).tool_pose(q)
    # A leg of no length to speak of.
    corners = np.array([X_WT.translation, X_WT.translation + np.array([0, 0, 1e-12])])
    law = asked.task.path.segments[0].law
    path = ToolPath.straight(corners, np.array(X_WT.rotation), np.array([0.02]), law)
    still = replace(asked, task=replace(asked.task, path=path)).with_options(path_step_s=0.02, **options)
    return follow_path(still, q, stop_at_obstacles=False).v[0]


@pytest.mark.parametrize("avoidance", ["smooth", "switch"])
def test_self_motion_leaves_the_tool_alone(
    triangle_path: Followed, near_postures: FloatArray, avoidance: str
) -> None:
    asked, _ = triangle_path
    kinematics = Kinematics(asked.cell.robot)
    fastest = 0.0
    for q in near_postures:
        v = self_motion(asked, q, avoidance=avoidance)
        assert np.abs(kinematics.tool_jacobian(q)[1] @ v).max() < 1e-9
        fastest = max(fastest, np.abs(v).max())
    assert fastest > 0.1


def test_switch_is_equation_17_to_the_letter(triangle_path: Followed, near_postures: FloatArray) -> None:
    asked, path = triangle_path
    kinematics, clearances = Kinematics(asked.cell.robot), asked.cell.clearances
    avoidable = [k for k, pair in enumerate(clearances.pairs) if pair.avoidable]
    far = path.q[clearances.query(path.q, avoidable_only=True).distance > 0.16][:3]
    assert len(far) == 3
    assert len(near_postures) > 5
    for q in (*near_postures, *far):
        near = min((clearances.nearest(q, k) for k in avoidable), key=lambda found: found.distance)
        u = (near.point - near.other_point) / near.distance
        gradient = np.linalg.pinv(near.jacobian) @ u if near.distance <= 0.15 else np.zeros(7)
        J = kinematics.tool_jacobian(q)[1]
        expected = 2.0 * (np.eye(7) - np.linalg.pinv(J) @ J) @ gradient
        got = self_motion(asked, q, avoidance="switch")
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6)


def test_smooth_avoidance_of_one_pair_fades_in(triangle_path: Followed, near_postures: FloatArray) -> None:
    """With one near pair it is Eq. (17) times 1 - d/d_s."""
    asked, _ = triangle_path
    compared = 0
    for q in near_postures:
        # d_s just beyond the nearest pair, short of the next.
        distances = sorted(near.distance for near in asked.cell.clearances.within(q, 0.5))
        d_s = 0.5 * (distances[0] + distances[1])
        got, switched = (
            self_motion(asked, q, avoidance=kind, avoidance_distance_m=d_s) for kind in ("smooth", "switch")
        )
        np.testing.assert_allclose(got, (1 - distances[0] / d_s) * switched, rtol=0, atol=1e-9)
        compared += np.abs(got).max() > 1e-3
    assert compared > 3


def largest_jump(scene: Scene, step: float, avoidance: Any) -> float:
    _, path = path_of(scene, path_step_s=step, avoidance=avoidance)
    return float(np.abs(np.diff(path.v, axis=0)).max())


def test_smooth_rates_are_continuous_and_switched_ones_are_not() -> None:
    """Jumps from step to step shrink with the step, or do not."""
    scene = short_scene(
        tool_path={"legs": [{"by": [0, -0.6, 0], "seconds": 8}]},
        obstacles=[{"name": "slab", "box": [6, 1.2, 0.12], "xyz": [1, -0.8, -1.06]}],
    )
    smooth = [largest_jump(scene, step, "smooth") for step in (0.08, 0.04, 0.02)]
    assert smooth[1] < 0.65 * smooth[0]
    assert smooth[2] < 0.65 * smooth[1]
    switch = [largest_jump(scene, step, "switch") for step in (0.04, 0.02)]
    assert switch[1] > 0.8 * switch[0]
    assert switch[1] > 50 * smooth[2]


def with_options(followed: Followed, **options: Any) -> JointPath:
    """The triangle's path again, with other options, whatever is in the way."""
    asked, path = followed
    other = asked.with_options(**options)
    return follow_path(other, path.q[0], stop_at_obstacles=False)


def test_avoidance_gains_clearance(triangle_path: Followed) -> None:
    asked, path = triangle_path
    clearances = asked.cell.clearances
    without = with_options(triangle_path, avoidance_gain=0.0)
    assert path.clearance.min() > without.clearance.min() + 0.01
    ours, theirs = (clearances.query(x.q, avoidable_only=True).distance.min() for x in (path, without))
    assert ours > theirs + 0.01


def test_pulling_the_centre_of_gravity_lowers_the_torque(triangle_path: Followed) -> None:
    asked, path = triangle_path
    pulled = with_options(triangle_path, centre_of_gravity_weight=0.2)
    dynamics = Dynamics(asked.cell.robot)
    mean, mean_without = (
        np.linalg.norm(dynamics.static_efforts(x.q).guardrail_torque, axis=1).mean() for x in (pulled, path)
    )
    assert mean < 0.98 * mean_without
    assert pulled.drift.max() < 1e-3


@pytest.mark.parametrize("keep", ["pose", "axis", "position"])
def test_self_motion_holds_what_is_kept(keep: str) -> None:
    asked = request_of(short_scene(tool_path={"keep": keep}))
    robot, task, posture = asked.cell.robot, asked.task, asked.state.posture
    found = self_motion_postures(asked)
    assert len(found) > 20
    kinematics = Kinematics(robot)
    for q in found:
        assert np.abs(task.error(kinematics.tool_pose(q), task.path.poses([0.0]))).max() < 1e-9
        assert ((q >= robot.limits.lower) & (q <= robot.limits.upper)).all()
    distance = [np.linalg.norm(q - posture) for q in found]
    assert distance == sorted(distance)
    assert distance[0] < 0.25
    assert distance[-1] > 1.0


def test_self_motion_goes_both_ways() -> None:
    asked = request_of(short_scene())
    along = np.linalg.svd(Kinematics(asked.cell.robot).tool_jacobian(asked.state.posture)[1])[2][-1]
    side = [along @ (q - asked.state.posture) for q in self_motion_postures(asked)[:6]]
    assert min(side) < -0.05
    assert max(side) > 0.05


def test_no_start_beyond_the_first_range(cmbot_robot: Any) -> None:
    """The curve ends where a joint's range does; a narrow range leaves few postures."""
    asked, reach = request_of(short_scene()), np.deg2rad(15)
    posture = asked.state.posture
    narrow = replace(
        cmbot_robot, limits=replace(cmbot_robot.limits, lower=posture - reach, upper=posture + reach)
    )
    found = self_motion_postures(replace(asked, cell=replace(asked.cell, robot=narrow)))
    assert 0 < len(found) < 10
    assert all(np.abs(q - posture).max() <= reach for q in found)


def test_the_scenes_posture_is_kept_where_it_works() -> None:
    reports: list[Progress] = []
    asked = replace(request_of(short_scene()), reporter=ProgressReporter(reports.append))
    path, failures = find_path(asked)
    assert {report.failed_starts for report in reports} == {0}
    assert failures == ()
    np.testing.assert_array_equal(path.q[0], asked.state.posture)


def test_no_other_start_is_tried_when_the_time_is_over() -> None:
    ball = {"name": "ball", "sphere": 0.0666, "xyz": [0.95, 0.52, -1.0]}
    over = Deadline(-1.0, lambda: 2.0)
    asked = replace(request_of(short_scene(obstacles=[ball])), deadline=over)
    with pytest.raises(PathNotFound, match=r"link_3 comes within .* of ball") as caught:
        find_path(asked)
    assert "other starting" not in str(caught.value)


def test_the_line_starts_elsewhere(fixed_line_plan: Plan) -> None:
    """From the paper's posture link 5 meets link 2 before the end."""
    start = fixed_line_plan.start
    first = start.failures[0]
    assert first.pair == ("link_5", "link_2")
    assert first.progress == pytest.approx(0.94, abs=0.02)
    assert "link_5 comes within" in first.reason
    assert start.moved == pytest.approx(np.abs(start.posture - load_scene("line").posture).max())
    assert start.moved > 0.1
    np.testing.assert_allclose(fixed_line_plan.trajectory.q[0], start.posture, rtol=0, atol=1e-9)
    # The baseline is still the paper's: from its own posture, and into itself.
    np.testing.assert_array_equal(fixed_line_plan.baseline.samples.q[0], load_scene("line").posture)
    assert fixed_line_plan.baseline.figures.min_clearance < 0.02
    assert fixed_line_plan.figures.min_clearance >= 0.02


def test_only_the_scenes_posture() -> None:
    scene = load_scene("line")
    told: list[Progress] = []
    with pytest.raises(PathNotFound) as caught:
        plan(scene, options=replace(scene.planner, knots="fixed", other_starts=0), progress=told.append)
    assert caught.value.pair == ("link_5", "link_2")
    assert "other starting posture" not in str(caught.value)
    assert {(report.stage, report.failed_starts) for report in told} == {("path", 0)}


@pytest.mark.parametrize(
    ("tries", "words"), [(1, "1 other starting posture fails"), (3, "3 other starting postures fail")]
)
def test_a_hopeless_scene(tries: int, words: str) -> None:
    scene = short_scene(obstacles=[WALL], planner={"other_starts": tries, "path_step_s": 0.05})
    reports: list[Progress] = []
    asked = replace(request_of(scene), reporter=ProgressReporter(reports.append))
    with pytest.raises(PathNotFound, match=rf"; {words} as well \(the best") as caught:
        find_path(asked)
    begun = [report.failed_starts for report in reports if not report.step]
    assert begun == list(range(1, tries + 1))
    first = caught.value.__cause__
    assert isinstance(first, PathNotFound)
    assert caught.value.reason.startswith(first.reason)
    for name in ("time", "progress", "smallest_singular_value", "pair"):
        assert getattr(caught.value, name) == getattr(first, name)
