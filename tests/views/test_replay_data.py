"""The data of the replay: the approach, nearest points, and the tool of the elastic arm."""

import dataclasses
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from page_data import floats, without_shapes
from plan_folders import changed, with_baseline

from cmbot.collision import Clearances
from cmbot.common.errors import InputError
from cmbot.planning import Plan
from cmbot.robot import Dynamics, Robot
from cmbot.simulation import Tracking
from cmbot.views.charts import charts
from cmbot.views.drawing.surfaces import obstacle_surface
from cmbot.views.replay_data import MOST_POSES, Frames, replay_data


@pytest.fixture(scope="module")
def data(triangle_plan: Plan) -> dict[str, Any]:
    return replay_data(triangle_plan)


def work_times(data: dict[str, Any]) -> np.ndarray:
    """Times of the frames of the work, from its beginning."""
    return np.linspace(0, data["workEnd"] - data["workStart"], len(floats(data["planned"]["clearance"])))


def placements(robot: Robot, q: np.ndarray) -> np.ndarray:
    working = robot.model.createData()
    pin.forwardKinematics(robot.model, working, q)
    return np.array([X.homogeneous for X in working.oMi[1:]])


def shown(motion: dict[str, Any], frame: int) -> np.ndarray:
    poses = floats(motion["poses"], 7, 7)[frame]
    return np.array([pin.XYZQUATToSE3(pose).homogeneous for pose in poses])


def test_links_and_numbers_are_those_of_the_samples(data: dict[str, Any], triangle_plan: Plan) -> None:
    assert data["links"] == [f"link_{number}" for number in range(1, 8)]
    assert (data["workStart"], data["workEnd"]) == (triangle_plan.approach.duration, data["segments"][-1][2])
    times = np.linspace(0, 20.0, 1001)
    for name, samples in (("planned", triangle_plan.samples), ("baseline", triangle_plan.baseline.samples)):
        assert len(floats(data[name]["poses"], 7, 7)) == len(times)
        for k in range(0, len(times), 100):
            q = samples.q[np.argmin(np.abs(samples.t - times[k]))]
            np.testing.assert_allclose(shown(data[name], k), placements(triangle_plan.robot, q), atol=1e-5)
        torque = floats(data[name]["torque"], 3)
        np.testing.assert_allclose(torque, samples.guardrail_torque[::2], rtol=1e-6, atol=1e-3)
        np.testing.assert_allclose(floats(data[name]["clearance"]), samples.clearance[::2], rtol=1e-6)
    assert data["planned"]["peakTorque"] == triangle_plan.figures.peak_guardrail_torque
    assert data["baseline"]["minClearance"] == triangle_plan.baseline.figures.min_clearance


def test_free_moves_between_strokes_count_for_the_largest_values(strokes_plan: Plan) -> None:
    data = replay_data(without_shapes(strokes_plan))
    assert data["moves"]
    jobs = (strokes_plan.job.figures, strokes_plan.baseline.job_figures)
    for name, job in zip(("planned", "baseline"), jobs, strict=True):
        phases = [each[name] for each in (data["approach"], data, data["return"]) if each is not None]
        assert max(each["peakTorque"] for each in phases) == pytest.approx(job.peak_guardrail_torque)
        assert min(each["minClearance"] for each in phases) == pytest.approx(job.min_clearance)
        # No value that the page shows is beyond its largest one.
        torque = np.linalg.norm(floats(data[name]["torque"], 3), axis=1)
        assert torque.max() <= data[name]["peakTorque"] * 1.001
        assert floats(data[name]["clearance"]).min() >= data[name]["minClearance"] - 1e-3


def test_the_approach_leads_to_the_work_as_certified(data: dict[str, Any], triangle_plan: Plan) -> None:
    robot, approach, planned = triangle_plan.robot, triangle_plan.approach, data["approach"]["planned"]
    torque, clearance = floats(planned["torque"], 3), floats(planned["clearance"])
    assert (data["start"], data["workStart"]) == (0.0, approach.trajectory.duration)
    np.testing.assert_allclose(shown(planned, 0), placements(robot, triangle_plan.scene.posture), atol=1e-5)
    np.testing.assert_allclose(shown(planned, -1), shown(data["planned"], 0), atol=1e-5)
    times = np.linspace(0.0, approach.trajectory.duration, len(clearance))
    assert times[1] == pytest.approx(0.02, rel=0.01)
    for k in range(0, len(times), 100):
        q = approach.trajectory.evaluate(times[[k]], 0)[0]
        np.testing.assert_allclose(shown(planned, k), placements(robot, q), atol=1e-5)
    figures = approach.certificate.figures
    assert planned["peakTorque"] == figures.peak_guardrail_torque
    assert planned["minClearance"] == figures.min_clearance
    assert np.linalg.norm(torque, axis=1).max() == pytest.approx(figures.peak_guardrail_torque, rel=1e-3)
    assert clearance.min() == pytest.approx(figures.min_clearance, abs=1e-3)
    ends = approach.trajectory.q[[0, -1]]
    static = Dynamics(triangle_plan.robot).static_efforts(ends).guardrail_torque
    np.testing.assert_allclose(torque[[0, -1]], static, atol=0.01)
    # The baseline rests meanwhile.
    rest, first = data["approach"]["baseline"], triangle_plan.baseline.samples.q[:1]
    for frame in (0, -1):
        np.testing.assert_allclose(shown(rest, frame), shown(data["baseline"], 0), atol=1e-6)
    static = Dynamics(robot).static_efforts(first).guardrail_torque
    np.testing.assert_allclose(floats(rest["torque"], 3), np.repeat(static, 2, axis=0), rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(
        floats(rest["clearance"]), triangle_plan.baseline.samples.clearance[0], rtol=1e-5
    )
    assert rest["peakTorque"] == pytest.approx(float(np.linalg.norm(static)))


def test_a_slow_approach_has_no_more_frames(triangle_plan: Plan) -> None:
    trajectory = triangle_plan.approach.trajectory
    slow = dataclasses.replace(trajectory, t=4 * trajectory.t, v=trajectory.v / 4, a=trajectory.a / 16)
    slower = changed(triangle_plan, "approach", trajectory=slow)
    data = replay_data(changed(slower, "work", begin=slow.duration))
    assert data["approach"]["label"] == "approach, tool off"
    frames = [len(floats(part["planned"]["clearance"])) for part in (data["approach"], data)]
    assert 0.95 * MOST_POSES < 7 * sum(frames) <= MOST_POSES + 4 * 7


def test_the_floor_is_the_plans(data: dict[str, Any], triangle_plan: Plan, short_plan: Plan) -> None:
    assert data["floor"] == triangle_plan.lower_bound.value == triangle_plan.torque_floor
    without = replay_data(short_plan)
    assert (without["start"], without["approach"], without["floor"]) == (0.0, None, None)
    assert not np.signbit(without["start"])


def test_the_view_shows_workpieces_beside_the_path(
    data: dict[str, Any], triangle_plan: Plan, rng: np.random.Generator
) -> None:
    points = np.array(data["focus"]["points"])
    vertices = [
        obstacle_surface(each).vertices for each in triangle_plan.scene.all_obstacles if each.workpiece
    ]
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    # The points are those that are outermost along 200 directions: nearly all of what they enclose.
    shown, wanted = (points @ directions.T).max(axis=0), (np.vstack(vertices) @ directions.T).max(axis=0)
    assert len(vertices) == 3
    assert (shown > wanted - 0.03).all()


def test_nearest_points_are_those_of_what_can_come_nearer(
    triangle_plan: Plan, triangle_tracking: Tracking
) -> None:
    """The foremost link is always as near to a leg: obstacles are shown instead, where they are near."""
    data = replay_data(triangle_plan, triangle_tracking)
    clearances = Clearances(triangle_plan.robot, triangle_plan.scene.all_obstacles)
    always = next(
        k for k, pair in enumerate(clearances.pairs) if {pair.link, pair.other} == {"link_1", "leg_2"}
    )
    near_by = triangle_plan.options.avoidance_distance_m
    seen = set()
    for motion in (data["planned"], data["baseline"], data["approach"]["planned"], data["rest"]["planned"]):
        near, pair, q = floats(motion["near"], 7), floats(motion["pair"]), floats(motion["q"], 7)
        distance = np.array(
            [
                clearances.distances(q, np.arange(len(q)), np.full(len(q), k))
                for k in range(len(clearances.pairs))
            ]
        )
        np.testing.assert_allclose(distance.min(axis=0), floats(motion["clearance"]), atol=2e-4)
        assert np.ptp(distance[always]) < 1e-6
        obstacles = distance[[pair.avoidable for pair in clearances.pairs]].min(axis=0)
        instead = (distance.argmin(axis=0) == always) & (obstacles < near_by)
        expected = np.where(instead, obstacles, distance.min(axis=0))
        shown = pair >= 0
        far = np.linalg.norm(near[:, :3] - near[:, 3:6], axis=1)
        # The label's distance is that of the pair that it names.
        for told in (far, near[:, 6]):
            np.testing.assert_allclose(told[shown], expected[shown], atol=2e-4)
        assert (expected[~shown] >= near_by - 2e-4).all()
        seen |= {data["pairs"][int(k)] for k in pair[shown]}
    assert {"link_5 – slab"} < seen
    assert seen == set(data["pairs"])


def test_the_error_is_that_of_the_simulation_from_where_the_tool_is_expected(
    triangle_plan: Plan, triangle_tracking: Tracking, compensated_short: tuple[Plan, Tracking]
) -> None:
    data = replay_data(triangle_plan, triangle_tracking)
    assert data["end"] == pytest.approx(data["workStart"] + triangle_tracking.planned.t[-1])
    times = work_times(data)
    for name, motion in (("planned", triangle_tracking.planned), ("baseline", triangle_tracking.baseline)):
        expected = np.stack([np.interp(times, motion.t, e) for e in motion.error.T], axis=1)
        np.testing.assert_allclose(floats(data[name]["error"], 3), expected, atol=1e-8)
        rest = data["rest"][name]
        assert np.ptp(floats(rest["tool"], 3), axis=0).max() == 0
        assert np.ptp(floats(rest["error"], 3), axis=0).max() > 0
    assert data["approach"]["planned"]["error"] is None
    assert replay_data(triangle_plan)["rest"] is None
    samples = compensated_short[0].samples
    shown = floats(replay_data(*compensated_short)["planned"]["tool"], 3)
    np.testing.assert_allclose(shown[[0, -1]], samples.expected_tool_point[[0, -1]], atol=1e-6)
    assert np.linalg.norm(shown[0] - samples.tool_point[0]) > 1e-3


def test_works_of_several_strokes_may_differ_in_duration(
    strokes_plan: Plan, strokes_tracking: Tracking
) -> None:
    data = replay_data(strokes_plan, strokes_tracking)
    times = work_times(data)
    for name, motion in strokes_tracking.motions:
        expected = np.stack([np.interp(times, motion.t, e) for e in motion.error.T], axis=1)
        np.testing.assert_allclose(floats(data[name]["error"], 3), expected, atol=1e-8)
    baseline = strokes_tracking.baseline
    assert baseline.stop < strokes_tracking.planned.stop - 0.01
    exchanged = dataclasses.replace(strokes_tracking, planned=baseline)
    with pytest.raises(InputError, match=r"planned\.stop: got .* s, expected .* s, the plan's duration"):
        replay_data(strokes_plan, exchanged)


def test_the_return_comes_after_the_work(returning_plan: Plan) -> None:
    data, back = replay_data(returning_plan), returning_plan.job.segments[-1]
    assert data["end"] == pytest.approx(data["workEnd"] + back.duration)
    assert data["rest"] is None
    robot, phase = returning_plan.robot, data["return"]
    last = floats(phase["planned"]["poses"]).reshape(-1, robot.dof, 7)[-1]
    pin.forwardKinematics(robot.model, (made := robot.model.createData()), robot.group_states["stow"])
    np.testing.assert_allclose(last[-1], pin.SE3ToXYZQUAT(made.oMi[robot.dof]), atol=1e-6)
    # The baseline is there sooner, and rests.
    poses = floats(phase["baseline"]["poses"]).reshape(-1, robot.dof, 7)
    np.testing.assert_allclose(poses[-1], last, atol=1e-6)
    np.testing.assert_allclose(poses[-2], poses[-1], atol=1e-6)
    assert phase["planned"]["peakTorque"] == back.figures.peak_guardrail_torque
    (torque,) = (chart for chart in charts(returning_plan, None) if chart.key == "torque")
    ends = [data["workEnd"] + returning_plan.baseline.segment("return").samples.t[-1], data["end"]]
    assert [curve.t[-1] for curve in torque.curves] == pytest.approx(ends)
    assert torque.work == (data["workStart"], data["workEnd"])


def test_the_baseline_approaches_too_and_both_begin_to_work_at_once(strokes_plan: Plan) -> None:
    other = dataclasses.replace(strokes_plan.baseline.segments[1], name="approach", begin=0.0)
    longer = (strokes_plan.job.strokes[0].begin + 2.0) / other.duration
    slow = dataclasses.replace(other, samples=dataclasses.replace(other.samples, t=longer * other.samples.t))
    for approach in (other, slow):
        work = [
            dataclasses.replace(each, begin=each.begin + approach.duration)
            for each in strokes_plan.baseline.segments
        ]
        plan = with_baseline(strokes_plan, segments=(approach, *work))
        data = replay_data(plan)
        begins = plan.job.strokes[0].begin
        assert data["start"] == pytest.approx(min(0.0, begins - approach.duration))
        poses = floats(data["approach"]["baseline"]["poses"], 7, 7)
        assert np.abs(poses[0] - poses[-1]).max() > 0.01
        torque = next(chart for chart in charts(plan, None) if chart.key == "torque")
        first, planned = (curve.t[0] for curve in torque.curves)
        assert (first, planned) == pytest.approx((begins - approach.duration, 0.0))


def test_the_share_of_what_holds_is_shown_where_it_is_known(short_plan: Plan) -> None:
    robot, times = short_plan.robot, short_plan.samples.t[::50]
    feet = tuple(dataclasses.replace(foot, adhesion=60e3, safety=2.0) for foot in robot.feet)
    held = dataclasses.replace(short_plan, robot=dataclasses.replace(robot, feet=feet))
    shares = [Frames(plan).motion(plan.samples, plan.figures, times)["hold"] for plan in (short_plan, held)]
    assert shares[0] is None  # welded is assumed
    needed = short_plan.samples.adhesion_needed[::50].max(axis=1)
    np.testing.assert_allclose(floats(shares[1]), 2.0 * needed / 60e3, rtol=1e-5)
