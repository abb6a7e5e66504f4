"""The return: a certified motion from the end of the work to the stow or the start posture."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forgeries import changed_scene, put_job
from plan_folders import edit, refused, same_arrays
from small_scenes import request_of, short_scene

from cmbot.archive import load_plan, save
from cmbot.common.errors import LimitViolation, PathNotFound
from cmbot.planning import Plan, QuinticTrajectory, plan, remarks
from cmbot.planning.free_motion.return_move import plan_return
from cmbot.planning.free_motion.straight_move import quickest_straight
from cmbot.robot import Robot
from cmbot.trajectory import SplineSpace

NEWER = {"planner": {"knots": "sliding"}}


@pytest.fixture(scope="module")
def saved(returning_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(returning_plan, tmp_path_factory.mktemp("return") / "plan")


@pytest.fixture
def folder(saved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(saved, tmp_path / "plan"))


def test_the_segments_join_at_rest_and_end_where_the_arm_is_stowed(returning_plan: Plan) -> None:
    job = returning_plan.job
    assert [segment.name for segment in job.segments] == ["approach", "work", "return"]
    for before, after in zip(job.segments, job.segments[1:], strict=False):
        assert after.begin == before.end
        np.testing.assert_allclose(before.trajectory.q[-1], after.trajectory.q[0], rtol=0, atol=1e-9)
    end = job.trajectory.q[-1]
    np.testing.assert_allclose(end, returning_plan.robot.group_states["stow"], rtol=0, atol=1e-9)
    x = job.trajectory
    assert x.t[-1] == pytest.approx(job.duration)
    joins = [segment.begin for segment in job.segments] + [job.duration]
    for order in (1, 2, 3):
        assert np.abs(x.evaluate(joins, order)).max() < 1e-8
    assert job.certificate.holds
    assert len(job.certificate.checks) == sum(len(each.certificate.checks) for each in job.segments)
    peaks = [each.figures.peak_guardrail_torque for each in job.segments]
    assert job.figures.peak_guardrail_torque == max(peaks)
    (said,) = (remark for remark in remarks(returning_plan) if remark.startswith("Return: "))
    assert said.endswith("to its stow posture.")
    rows = {row[0]: row[-1] for row in returning_plan.rows()}
    assert rows["time of the return, s"] == f"{job.segments[-1].duration:.1f}"


def test_the_return_asks_no_more_than_the_rest(returning_plan: Plan) -> None:
    back, others = returning_plan.job.segments[-1], returning_plan.job.segments[:-1]
    most = max(segment.figures.peak_guardrail_torque for segment in others)
    assert back.figures.peak_guardrail_torque <= 1.002 * most


def test_a_plan_with_a_return_is_read_back(returning_plan: Plan, saved: Path) -> None:
    read = load_plan(saved, verify=True)
    for got, expected in zip(read.job.segments, returning_plan.job.segments, strict=True):
        same_arrays(got.trajectory, expected.trajectory)
        assert (got.begin, got.figures) == (expected.begin, expected.figures)
    rows = (saved / "job.csv").read_text().splitlines()
    assert rows[-1].endswith(",return")
    assert float(rows[-1].partition(",")[0]) == returning_plan.job.duration


def test_the_baseline_returns_straight_and_quickly(returning_plan: Plan) -> None:
    back = returning_plan.baseline.segment("return").samples
    assert back is not None
    np.testing.assert_allclose(back.q[0], returning_plan.baseline.samples.q[-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(back.q[-1], returning_plan.robot.group_states["stow"], rtol=0, atol=1e-12)
    assert back.t[-1] < returning_plan.job.segments[-1].duration
    figures = returning_plan.baseline.job_figures
    assert figures.peak_guardrail_torque >= returning_plan.baseline.figures.peak_guardrail_torque
    seconds = returning_plan.baseline.samples.t[-1] + back.t[-1]
    total = sum(
        np.trapezoid(np.linalg.norm(each.guardrail_torque, axis=1), each.t)
        for each in (returning_plan.baseline.samples, back)
    )
    assert figures.mean_guardrail_torque == pytest.approx(total / seconds)


@pytest.mark.parametrize("scale", [1e-3, 0.05, 3.0])
def test_the_quickest_straight_motion_is_at_a_bound_and_consistent(cmbot_robot: Robot, scale: float) -> None:
    """Short ways never reach the largest velocity, long ones do; it is the integral of its jerk."""
    limits, way = cmbot_robot.limits, scale * np.array([1.0, 0.2, 0, 0, -0.5, 0, 0])
    t, (q, v, a, j) = quickest_straight(limits, np.zeros(7), way, 1e-4)
    np.testing.assert_allclose(q[-1], way, rtol=1e-12)
    np.testing.assert_allclose(v[[0, -1]], 0, atol=1e-12)
    shares = [np.abs(x / bound).max() for x, bound in ((v, limits.velocity), (a, limits.acceleration))]
    shares.append(float(np.abs(j / limits.jerk).max()))
    assert max(shares) == pytest.approx(1.0, abs=1e-9)
    assert (shares[0] > 0.999) == (scale == 3.0)
    for lower, upper in ((q, v), (v, a)):
        change = np.diff(lower, axis=0) / np.diff(t)[:, None]
        middle = 0.5 * (upper[1:] + upper[:-1])
        np.testing.assert_allclose(change, middle, atol=2e-3 * np.abs(upper).max())


def test_an_arm_without_a_stow_posture_goes_back_to_where_it_started(urdf_folder: Path) -> None:
    srdf = urdf_folder / "cmbot.srdf"
    srdf.write_text(srdf.read_text().replace('name="stow"', 'name="folded"'), encoding="utf-8")
    robot = {"model": str(urdf_folder / "cmbot.urdf"), "base_frame": "arm_base", "tool_frame": "tool0"}
    made = plan(short_scene(robot=robot, **{"return": "stow"}))
    np.testing.assert_allclose(made.job.trajectory.q[-1], made.scene.posture, rtol=0, atol=1e-9)
    (said,) = (remark for remark in remarks(made) if remark.startswith("Return: "))
    assert "to where it started (its SRDF has no group state stow)" in said


def test_a_blocked_return_is_refused(returning_plan: Plan) -> None:
    """A ball about the stowed arm's tool."""
    tool = returning_plan.segment_samples["return"].tool_point[-1].tolist()
    ball = {"name": "ball", "sphere": 0.1, "xyz": tool}
    words = "no collision-free return: in the stow posture .*; with return: none the job is planned"
    scene = {**NEWER, "obstacles": [ball]}
    with pytest.raises(PathNotFound, match=words):
        plan(short_scene(**scene, **{"return": "stow"}))
    # As it says.
    assert plan(short_scene(**scene, **{"return": "none"})).job.certificate.holds


def wrong_end(x: QuinticTrajectory) -> QuinticTrajectory:
    """To another posture than the scene asks for."""
    space = SplineSpace(x.t)
    return space.trajectory(space.least_jerk(x.q + 0.01 * (x.t / x.t[-1])[:, None]))


def test_a_return_to_another_posture_is_refused(returning_plan: Plan, folder: Path) -> None:
    back = returning_plan.job.segments[-1].trajectory
    put_job(folder, returning_plan.job.changed("return", trajectory=wrong_end(back)))
    assert "where the job is to end at last" in refused(folder, "job.npz", "q").expected


def test_where_feet_are_too_weak_for_the_return_it_says_so() -> None:
    """From the stow posture to that of the start, which asks a third more than the clamp bears."""
    clamp = {"kind": "clamp", "force_n": [9000] * 3, "moment_nm": [9000, 9000, 310], "safety": 1}
    scene = short_scene(**{"return": "stow"}, guardrail={"hold": clamp})
    asked = request_of(scene)
    heavy = replace(asked, end_posture=asked.state.posture)
    words = r"\(in the start posture a foot uses 134% of its hold \(moment_nm\[2\]\)\); with return: none"
    with pytest.raises(PathNotFound, match=words):
        plan_return(heavy, asked.end_posture, begin=4.0, allowed=0.0)


def test_no_move_leads_to_where_the_arm_is() -> None:
    asked = request_of(short_scene())
    assert plan_return(asked, asked.state.posture, begin=4.0, allowed=0.0) is None
    there = replace(asked, end_posture=asked.state.posture)
    assert plan_return(there, asked.state.posture.copy(), begin=4.0, allowed=0.0) is None


def test_a_return_that_hurries_breaks_a_promise(returning_plan: Plan, folder: Path) -> None:
    back = returning_plan.job.segments[-1].trajectory
    v = back.v.copy()
    v[3] += 0.5
    put_job(folder, returning_plan.job.changed("return", trajectory=replace(back, v=v)))
    with pytest.raises(LimitViolation, match="of joint_"):
        load_plan(folder, verify=True)


def test_another_return_than_the_scenes_is_refused(folder: Path) -> None:
    def start(data: dict[str, Any]) -> None:
        changed_scene(data, lambda scene: scene.update({"return": "start"}), folder)

    def none(data: dict[str, Any]) -> None:
        changed_scene(data, lambda scene: scene.pop("return"), folder)

    edit(folder, start)
    assert "where the job is to end" in refused(folder, "job.npz", "q").expected
    edit(folder, none)
    refused(folder, "plan.json", "segments")
