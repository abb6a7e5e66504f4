"""Charts of self-motion: on the task, apart from each other, and complete."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from oracles.inverse_kinematics import postures as closed_form
from scipy.spatial import cKDTree
from small_scenes import goals_at, off_task, task_at
from urdf_arms import endless_scene, panda_scene

from cmbot.planning import robot_of, strokes_of, task_of
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.request import JobState, StrokeRequest
from cmbot.planning.selfmotion.charts import Chart, charts_of
from cmbot.planning.selfmotion.dynamic_programming import nearest_turn
from cmbot.planning.selfmotion.poisson_disk import PoissonDiskSets, without_neighbours
from cmbot.planning.selfmotion.sampler import SelfMotionSampler
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.workcell import Workcell
from cmbot.robot import Kinematics, PostureMetric, Postures, Robot
from cmbot.scene import PlannerOptions, Scene, load_scene
from cmbot.toolpath import ToolPoses

SPACING = 0.1
PITCHES = np.linspace(-np.pi, np.pi, 181)


def request_for(robot: Robot, task: ToolTask, spacing: float = SPACING, seeds: int = 300) -> StrokeRequest:
    cell = Workcell.of(robot, (), PlannerOptions(chart_spacing=spacing, chart_seeds=seeds))
    q = np.zeros(robot.dof)
    state = JobState(posture=q)
    return StrokeRequest(cell=cell, state=state, strokes=(), number=0, task=task, times=np.zeros(1), first=q)


def first_chart(asked: StrokeRequest, q: np.ndarray) -> Chart:
    return charts_of(asked.cell, [SelfMotionSampler(asked).first(asked.task.path.poses([0.0]), q)])[0]


def charts_along(asked: StrokeRequest, goals: ToolPoses, q: np.ndarray) -> list[Chart]:
    return charts_of(asked.cell, SelfMotionSampler(asked).along(goals, q))


def within(robot: Robot, q: np.ndarray) -> np.ndarray:
    return ((q >= robot.limits.lower) & (q <= robot.limits.upper)).all(axis=1)


def check_chart(robot: Robot, task: ToolTask, chart: Chart, goal: ToolPoses, spacing: float) -> None:
    """Its postures hold the task apart from each other, and what is known of them is right."""
    at = Postures(robot).at(chart.q)
    assert off_task(robot, task, chart.q, goal) < 1e-9
    assert cKDTree(chart.q).query(chart.q, k=2)[0][:, 1].min() > 0.69 * spacing
    np.testing.assert_array_equal(chart.within, within(robot, chart.q))
    np.testing.assert_allclose(chart.value, np.linalg.norm(at.guardrail_torque, axis=1))
    held = robot.holding_torque(np.hstack([at.guardrail_force, at.guardrail_torque]))
    torque = np.hstack([at.joint_torque, held])
    bounds = np.hstack([robot.limits.torque, [joint.limit for joint in robot.holding_joints]])
    np.testing.assert_allclose(chart.joint_use, (np.abs(torque) / bounds).max(axis=1))


def all_postures(robot: Robot, task: ToolTask, goal: ToolPoses) -> np.ndarray:
    """The closed form's, within the joint ranges."""
    q = closed_form(goal.point[0], task.path.orientation, PITCHES)
    return q[within(robot, q)]


def distance_on_circle(q: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance of each of `others` from the nearest of `q`, angles modulo a turn."""
    turn = 2 * np.pi
    # A tiny negative angle rounds up to a whole turn.
    q, others = (np.where(each % turn < turn, each % turn, 0.0) for each in (q, others))
    return cKDTree(q, boxsize=turn).query(others)[0]


def test_the_oracle_holds_the_pose(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    q = rng.uniform(cmbot_robot.limits.lower, cmbot_robot.limits.upper)
    kinematics = Kinematics(cmbot_robot)
    X_WT = kinematics.tool_pose(q)
    found = closed_form(X_WT.translation, X_WT.rotation, np.array([q[1:4].sum()]))
    assert np.abs(found - q).max(axis=1).min() < 1e-9
    for each in found:
        np.testing.assert_allclose(kinematics.tool_pose(each).homogeneous, X_WT.homogeneous, atol=1e-9)


def test_charts_are_complete_against_the_closed_form(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    """On 80 random tool poses every posture of the closed form has one of the chart beside it.

    Also those on stubs between two joint limits that are shorter than the spacing: there the chart's posture
    beside it lies beyond the range.
    """
    limits, spacing = cmbot_robot.limits, 0.2
    total = 0
    for q in rng.uniform(limits.lower, limits.upper, (80, 7)):
        task = task_at(cmbot_robot, q)
        start = task.path.poses([0.0])
        chart = first_chart(request_for(cmbot_robot, task, spacing, seeds=200), q[None])
        oracle = all_postures(cmbot_robot, task, start)
        if len(oracle):
            assert distance_on_circle(chart.q, oracle).max() < 1.5 * spacing
            total += len(oracle)
    assert total > 8_000


@pytest.mark.parametrize(("keep", "spacing"), [("pose", SPACING), ("axis", 0.5)])
def test_a_charts_postures_hold_the_task_apart_from_each_other(
    cmbot_robot: Robot, keep: str, spacing: float
) -> None:
    q = np.radians([-10, -90, 90, 0, 10, 50, 0])
    task = task_at(cmbot_robot, q, keep)
    chart = first_chart(request_for(cmbot_robot, task, spacing), q[None])
    np.testing.assert_allclose(chart.q[0], q, atol=1e-15)
    check_chart(cmbot_robot, task, chart, task.path.poses([0.0]), spacing)


def test_charts_along_a_path_are_complete(cmbot_robot: Robot) -> None:
    scene = load_scene("triangle")
    task = task_of(strokes_of(scene, cmbot_robot)[0], scene)
    goals = task.path.poses(task.path.via_times(50))
    charts = charts_along(request_for(cmbot_robot, task, 0.2), goals, scene.posture[None])
    assert len(charts) == len(goals)
    for goal, chart in zip(goals, charts, strict=True):
        check_chart(cmbot_robot, task, chart, goal, 0.2)
        oracle = all_postures(cmbot_robot, task, goal)
        assert len(oracle) > 100
        assert distance_on_circle(chart.q, oracle).max() < 1.5 * 0.2


@pytest.mark.parametrize("make", [panda_scene, endless_scene])
@pytest.mark.parametrize("keep", ["pose", "axis", "position"])
def test_other_arms_charts_are_complete(
    make: Callable[..., Scene], keep: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    """No posture that random restarts find lies farther than the spacing from the chart."""
    scene = make(tmp_path, keep=keep)
    robot = robot_of(scene)
    task, limits = task_of(strokes_of(scene, robot)[0], scene), robot.limits
    sampler = SelfMotionSampler(request_for(robot, task, 0.15, seeds=200))
    chart = sampler.first(task.path.poses([0.0]), scene.posture[None])
    lower, upper = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    q, reached = project_onto_task(
        Postures(robot), task, rng.uniform(lower, upper, (3000, 7)), task.path.poses([0.0]), steps=40
    )
    endless = np.isinf(limits.lower)
    q[:, endless] = (q[:, endless] + np.pi) % (2 * np.pi) - np.pi
    q = q[reached & ((q >= lower) & (q <= upper)).all(axis=1)]
    assert len(q) > 300
    assert distance_on_circle(chart, q).max() < 1.1 * sampler.spacing


@pytest.mark.parametrize("count", [1, 2, 6, 7, 8, 14])
def test_charts_along_any_number_of_points(cmbot_robot: Robot, count: int) -> None:
    q = np.radians([-10, -90, 90, 0, 10, 50, 0])
    task = task_at(cmbot_robot, q)
    goals = goals_at(task, task.path.corners[0] + np.linspace(0, 0.1, count)[:, None] * [0, 0, 1])
    charts = charts_along(request_for(cmbot_robot, task), goals, q[None])
    assert len(charts) == count
    for goal, chart in zip(goals, charts, strict=True):
        assert off_task(cmbot_robot, task, chart.q, goal) < 1e-9
    anew = SelfMotionSampler(request_for(cmbot_robot, task)).first(goals[-1], charts[-1].q[:1])
    assert distance_on_circle(charts[-1].q, anew).max() < 1.5 * SPACING


@given(
    st.integers(1, 30).flatmap(
        lambda n: st.tuples(st.just(n), st.lists(st.tuples(*[st.integers(0, n - 1)] * 2)))
    )
)
def test_thinning_goes_from_the_first_to_the_last(case: tuple[int, list[tuple[int, int]]]) -> None:
    number, drawn = case
    pairs = [(min(pair), max(pair)) for pair in drawn if pair[0] != pair[1]]
    keep = np.ones(number, dtype=bool)
    for first, second in sorted(pairs):
        if keep[first]:
            keep[second] = False
    got = without_neighbours(number, np.array(pairs, dtype=np.intp).reshape(-1, 2))
    np.testing.assert_array_equal(got, keep)


METRIC = PostureMetric(prismatic=np.zeros(2, dtype=np.bool_), length=1.0)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 4))
def test_poisson_disk_sets_take_postures_that_are_apart(seed: int, number: int, rounds: int) -> None:
    rng = np.random.default_rng(seed)
    sets = PoissonDiskSets([np.empty((0, 2))] * number, METRIC, rng.uniform(-4, 4, 2))
    taken: list[list[np.ndarray]] = [[] for _ in range(number)]

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.linalg.norm(nearest_turn(a - b)))

    def is_far(q: np.ndarray, of: int, apart: float) -> bool:
        return all(distance(q, other) >= apart for other in taken[of])

    for _ in range(rounds):
        of = np.sort(rng.integers(0, number, 12))
        q, apart = rng.uniform(-4, 4, (12, 2)), rng.uniform(0.4, rng.choice([1.2, 5.0]), 12)
        far = [is_far(*each) for each in zip(q, of, apart, strict=True)]
        np.testing.assert_array_equal(sets.far(q, of, apart), far)
        np.testing.assert_array_equal(
            sets.far(q, of, 0.8), [is_far(*each, 0.8) for each in zip(q, of, strict=True)]
        )
        expected = []
        for each, k, least in zip(q, of, apart, strict=True):
            expected.append(is_far(each, k, least))
            if expected[-1]:
                taken[k].append(each)
        np.testing.assert_array_equal(sets.take(q, of, apart), expected)
    assert sets.sizes.tolist() == [len(each) for each in taken]
    for postures, each in zip(sets.postures, taken, strict=True):
        np.testing.assert_array_equal(postures, np.reshape(each, (-1, 2)))


def test_a_branch_that_the_charts_miss_is_found_by_random_postures(cmbot_robot: Robot) -> None:
    """As where one opens later on the path: here most of each chart but the first has been taken out."""
    q = np.radians([-10, -90, 90, 0, 10, 50, 0])
    task = task_at(cmbot_robot, q)
    goals = goals_at(task, task.path.corners[0] + np.linspace(0, 0.1, 4)[:, None] * [0, 0, 1])
    sampler = SelfMotionSampler(request_for(cmbot_robot, task, 0.2))
    whole = sampler.along(goals, q[None])
    assert sampler.coverage.missed == 0
    assert sampler.coverage.share == pytest.approx(1 - 0.05 ** (1 / sampler.coverage.held))
    near = [each[np.abs(each - q).max(axis=1) < 1.0] for each in whole]
    assert all(0 < len(few) < 0.3 * len(each) for few, each in zip(near, whole, strict=True))
    again = sampler.complete(near, goals, [2], 300)
    for few, each in zip(again, whole, strict=True):
        assert distance_on_circle(few, each).max() < 1.5 * 0.2
