"""The approach: certified ways to a better start, along the self-motion or around it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from cmbot.errors import PathNotFound
from cmbot.planning import Plan, plan
from cmbot.planning.approach import plan_approach
from cmbot.planning.joint_paths import FreeSpace, connect, shorten
from cmbot.planning.starts import self_motion_postures
from cmbot.robot import Dynamics
from tests.small_scenes import parts, short_scene


def test_the_triangles_approach_is_certified(triangle_plan: Plan) -> None:
    approach = triangle_plan.approach
    assert approach is not None
    assert approach.certificate.holds
    np.testing.assert_allclose(approach.trajectory.q[0], triangle_plan.scene.posture, atol=1e-12)
    np.testing.assert_allclose(approach.trajectory.q[-1], triangle_plan.trajectory.q[0], atol=1e-12)
    ends = approach.trajectory.t[[0, -1]]
    for order in (1, 2, 3):
        assert np.abs(approach.trajectory.evaluate(ends, order)).max() < 1e-9
    use = approach.certificate.figures.limit_use
    assert max(use.velocity, use.acceleration, use.jerk) == pytest.approx(0.95, rel=1e-6)


def test_a_near_start_is_reached_along_the_self_motion() -> None:
    """The tool then stays where it is, within a few millimetres."""
    scene = short_scene()
    robot, task, posture, clearances = parts(scene)
    postures = self_motion_postures(robot, task, posture)
    near = postures[2]
    approach = plan_approach(robot, task, posture, near, np.array(postures), clearances, scene.planner)
    assert approach.certificate.holds
    options = replace(scene.planner, chart_spacing=0.2)
    approach = plan_approach(robot, task, posture, near, np.array(postures), clearances, options)
    assert approach.along_self_motion
    assert approach.certificate.figures.max_tool_deviation < 0.02


def test_a_blocked_approach_is_refused() -> None:
    """The goal lies inside an obstacle: nothing leads there."""
    scene = short_scene()
    robot, task, posture, clearances = parts(scene)
    goal = posture.copy()
    goal[0] = np.radians(90)  # link_1 across the guardrail
    with pytest.raises(PathNotFound, match="no collision-free approach"):
        plan_approach(robot, task, posture, goal, posture[None], clearances, scene.planner)


def test_connected_postures_are_joined_by_free_lines(triangle_plan: Plan, rng: np.random.Generator) -> None:
    scene = triangle_plan.scene
    robot, _, posture, clearances = parts(scene)
    space = FreeSpace(robot, clearances, 0.02)
    goal = triangle_plan.start.posture
    path = connect(space, posture, goal)
    assert path is not None
    short = shorten(space, path)
    for way in (path, short):
        np.testing.assert_array_equal(way[[0, -1]], [posture, goal])
        for start, end in pairwise(way):
            between = start + rng.uniform(0, 1, (50, 1)) * (end - start)
            assert clearances.smallest(between).distance.min() >= 0.02
    length = [np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in (path, short)]
    assert length[1] <= length[0] + 1e-12


def test_pinned_keeps_the_posture_and_needs_no_approach() -> None:
    scene = short_scene(planner={"knots": "sliding", "start": "pinned"})
    planned = plan(scene)
    assert planned.approach is None
    assert planned.start.moved == 0.0
    np.testing.assert_allclose(planned.trajectory.q[0], scene.posture, atol=1e-12)


def test_a_pinned_start_that_asks_the_most_leaves_the_mean_to_be_lowered() -> None:
    scene = short_scene(planner={"knots": "sliding", "start": "pinned"})
    planned = plan(scene)
    torque = Dynamics(planned.robot).static_efforts(scene.posture[None]).guardrail_torque
    static = float(np.linalg.norm(torque))
    assert {report.stage for report in planned.passes} == {"mean square"}
    assert planned.figures.peak_guardrail_torque == pytest.approx(static, rel=1e-5)
    assert planned.figures.mean_guardrail_torque < planned.baseline_figures.mean_guardrail_torque
