"""Charts of self-motion: on the task, apart from each other, and complete."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cmbot.planning.self_motion import ChartMaker
from cmbot.planning.task import ToolTask
from cmbot.robot import Kinematics, Postures, Robot
from cmbot.scene.speed_profile import SpeedProfile
from cmbot.scene.tool_path import ToolPath
from tests.oracles.inverse_kinematics import postures as closed_form

SPACING = 0.1
PITCHES = np.linspace(-np.pi, np.pi, 181)


def task_at(robot: Robot, q: np.ndarray, keep: str = "pose") -> ToolTask:
    X_WT = Kinematics(robot).tool_pose(q)
    path = ToolPath(
        corners=X_WT.translation + np.array([[0.0, 0, 0], [0, 0, 0.1]]),
        orientation=X_WT.rotation,
        seconds=np.ones(1),
        profile=SpeedProfile(),
    )
    return ToolTask(path, keep)


def maker_for(robot: Robot, task: ToolTask, spacing: float = SPACING, seeds: int = 300) -> ChartMaker:
    return ChartMaker(Postures(robot), task, robot.limits, spacing=spacing, seeds=seeds)


def distance_on_circle(q: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance of each of `others` from the nearest of `q`, angles modulo a turn."""
    turn = 2 * np.pi
    return cKDTree(q % turn, boxsize=turn).query(others % turn)[0]


def test_the_oracle_holds_the_pose(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    q = rng.uniform(cmbot_robot.limits.lower, cmbot_robot.limits.upper)
    kinematics = Kinematics(cmbot_robot)
    X_WT = kinematics.tool_pose(q)
    found = closed_form(X_WT.translation, X_WT.rotation, np.array([q[1:4].sum()]))
    assert np.abs(found - q).max(axis=1).min() < 1e-9
    for each in found:
        np.testing.assert_allclose(kinematics.tool_pose(each).homogeneous, X_WT.homogeneous, atol=1e-9)


def test_charts_are_complete_against_the_closed_form(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    """On 200 random tool poses every posture of the closed form has one of the chart beside it.

    Also those on stubs between two joint limits that are shorter than the spacing: there the chart's posture
    beside it lies beyond the range.
    """
    limits, spacing = cmbot_robot.limits, 0.2
    total = 0
    for q in rng.uniform(limits.lower, limits.upper, (200, 7)):
        task = task_at(cmbot_robot, q)
        start = task.path.corners[0]
        chart = maker_for(cmbot_robot, task, spacing, seeds=200).first(start, q[None])
        oracle = closed_form(start, task.path.orientation, PITCHES)
        oracle = oracle[((oracle >= limits.lower) & (oracle <= limits.upper)).all(axis=1)]
        if len(oracle):
            assert distance_on_circle(chart.q, oracle).max() < 1.5 * spacing
            total += len(oracle)
    assert total > 20_000


@pytest.mark.parametrize(("keep", "spacing"), [("pose", SPACING), ("axis", 0.5)])
def test_a_charts_postures_hold_the_task_apart_from_each_other(
    cmbot_robot: Robot, keep: str, spacing: float
) -> None:
    q = np.radians([-10, -90, 90, 0, 10, 50, 0])
    task = task_at(cmbot_robot, q, keep)
    chart = maker_for(cmbot_robot, task, spacing).first(task.path.corners[0], q[None])
    at = Postures(cmbot_robot).at(chart.q)
    assert np.abs(task.errors(at.tool_point, at.tool_rotation, task.path.corners[0])).max() < 1e-9
    np.testing.assert_allclose(chart.q[0], q, atol=1e-15)
    assert cKDTree(chart.q).query(chart.q, k=2)[0][:, 1].min() > 0.69 * spacing
    limits = cmbot_robot.limits
    within = ((chart.q >= limits.lower) & (chart.q <= limits.upper)).all(axis=1)
    np.testing.assert_array_equal(chart.within, within)
    np.testing.assert_allclose(chart.torque, np.linalg.norm(at.guardrail_torque, axis=1))


def test_a_chart_is_carried_to_the_next_point(cmbot_robot: Robot) -> None:
    q = np.radians([-10, -90, 90, 0, 10, 50, 0])
    task = task_at(cmbot_robot, q)
    maker = maker_for(cmbot_robot, task)
    chart = maker.first(task.path.corners[0], q[None])
    for height in (0.02, 0.04, 0.06, 0.08, 0.1):
        point = task.path.corners[0] + [0, 0, height]
        chart = maker.next(chart, point)
    anew = maker_for(cmbot_robot, task).first(point, chart.q[:1])
    assert distance_on_circle(chart.q, anew.q).max() < 1.5 * SPACING
