"""The process speed: planned, certified for all times, and read back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_scenes import short_scene

from cmbot.archive import load_plan, save
from cmbot.collision import Clearances
from cmbot.common.errors import LimitViolation
from cmbot.optimization import StateSamples
from cmbot.planning import Plan, QuinticTrajectory, certify, plan
from cmbot.planning.torque.constraints import ProcessSpeed
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Kinematics, Postures

TOLERANCE = 0.03
QUANTITY = "deviation of the process speed"


@pytest.fixture(scope="module")
def steady_plan() -> Plan:
    path = {
        "legs": [{"to": {"frame": "tool", "xyz": [0.1, 0.2, 0], "rpy_deg": [0, 15, 0]}, "speed_m_s": 0.1}],
        "speed_tolerance": TOLERANCE,
        "lead_in_m": 0.03,
        "lead_out_m": 0.04,
        "via_points": 14,
    }
    path = {"speed_profile": {"kind": "jerk_limited", "ramp": 0.25}, **path}
    return plan(short_scene(planner={"knots": "sliding"}, tool_path=path))


def test_the_speed_is_kept_at_all_times(steady_plan: Plan) -> None:
    (stroke,) = steady_plan.job.strokes
    x, path = stroke.trajectory, stroke.task.path
    t = np.linspace(0, x.duration, 20_001)
    # The tool is often slowest or quickest where a lead ends: there is the largest deviation, or beside it.
    k = np.flatnonzero(np.diff(path.process_speed(t) > 0))
    t = np.sort(np.append(t, np.linspace(t[k], t[k + 1], 1_001)))
    q, v, _ = x.states(t)
    J = Kinematics(steady_plan.robot).tool_point_jacobians(q)[1]
    asked = path.process_speed(t)
    on = asked > 0
    missed = np.abs(np.linalg.norm(np.einsum("kij,kj->ki", J, v), axis=1)[on] / 0.1 - 1).max()
    (check,) = (check for check in stroke.certificate.checks if check.quantity == QUANTITY)
    assert missed <= check.value <= TOLERANCE == check.bound
    assert missed == pytest.approx(check.value, rel=1e-3)
    # 0.2236 m at 0.1 m/s between two leads.
    assert np.diff(t)[on[1:]].sum() == pytest.approx(np.hypot(0.1, 0.2) / 0.1, rel=1e-3)
    told = {row[0]: row[-1] for row in steady_plan.rows()}
    assert told["process speed, m/s"] == "0.1"
    assert told["process speed kept within, %"] == f"{100 * check.value:.2f}"


def test_another_speed_breaks_the_certificate(steady_plan: Plan) -> None:
    (stroke,) = steady_plan.job.strokes
    scene, robot = steady_plan.scene, steady_plan.robot
    task = replace(stroke.task, speed_tolerance=1e-4)
    clearances = Clearances(robot, scene.all_obstacles)
    found = certify(
        robot,
        task,
        stroke.trajectory,
        clearances,
        steady_plan.options,
        via_points=scene.strokes[0].via_points,
    )
    with pytest.raises(LimitViolation, match=QUANTITY):
        found.require()
    broken = second_opinion(
        scene.with_path(speed_tolerance=1e-4), steady_plan.options, stroke.trajectory, robot=robot, stroke=0
    )
    assert [check.quantity for check in broken if not check.holds] == [f"{QUANTITY} by a second computation"]


def test_a_motion_that_ends_in_the_lead_in(steady_plan: Plan) -> None:
    """There no speed is asked for, so none is missed: what is wrong is its time."""
    (stroke,) = steady_plan.job.strokes
    x = stroke.trajectory
    t = np.linspace(0, 0.9 * stroke.task.path.process_parts[0][0], 3)
    q, v, a = x.states(t)
    short = QuinticTrajectory(t=t, q=q, v=v, a=a)
    robot, scene = steady_plan.robot, steady_plan.scene
    clearances = Clearances(robot, scene.all_obstacles)
    found = certify(robot, stroke.task, short, clearances, steady_plan.options, via_points=0)
    checks = {check.quantity: check for check in found.checks}
    assert (checks[QUANTITY].value, checks[QUANTITY].holds) == (0.0, True)
    assert not checks["difference of the trajectory's times from the tool path's"].holds


def test_it_is_read_back(steady_plan: Plan, tmp_path: Path) -> None:
    again = load_plan(save(steady_plan, tmp_path / "plan"), verify=True)
    (work,) = again.scene.strokes
    assert (work.speed_tolerance, work.lead_in_m, work.lead_out_m) == (
        TOLERANCE,
        0.03,
        0.04,
    )


def test_the_constraint_is_linearized(steady_plan: Plan) -> None:
    (stroke,) = steady_plan.job.strokes
    function = ProcessSpeed(Postures(steady_plan.robot), stroke.task, TOLERANCE)
    begin, end, _ = stroke.task.path.process_parts[0]
    t = np.concatenate([[0.3 * begin], np.linspace(begin, end, 5)])
    q, v, a = stroke.trajectory.states(t)
    v = v * np.linspace(0.5, 1.5, len(t))[:, None]
    step = 1e-6
    for component in (0, 1):
        each = np.full(len(t), component)
        rows = function.linearize(StateSamples(t, q, v, a), each)
        assert rows.value[0] == -1.0
        for joint in range(q.shape[1]):
            d = step * np.eye(q.shape[1])[joint]
            for by, states in ((rows.d_q, (d, 0 * d)), (rows.d_v, (0 * d, d))):
                ends = [
                    function.sample(StateSamples(t, q + s * states[0], v + s * states[1], a))[0][:, component]
                    for s in (1, -1)
                ]
                np.testing.assert_allclose(by[:, joint], (ends[0] - ends[1]) / (2 * step), atol=1e-4)
