"""Other starts: self-motion holds the tool, the nearest comes first, failures are told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_scenes import parts, short_scene

from cmbot.common.errors import PathNotFound
from cmbot.planning import Plan, Progress, plan
from cmbot.planning.path.initial_postures import find_path, self_motion_postures
from cmbot.robot import Kinematics
from cmbot.scene import load_scene

# Beside the tool's way at first, then across it.
WALL = {"name": "wall", "box": [1, 0.02, 1], "xyz": [1.8, 0.45, -2.0]}


@pytest.mark.parametrize("keep", ["pose", "axis", "position"])
def test_self_motion_holds_what_is_kept(keep: str) -> None:
    robot, task, posture, _ = parts(short_scene(tool_path={"keep": keep}))
    found = self_motion_postures(robot, task, posture)
    assert len(found) > 20
    kinematics = Kinematics(robot)
    for q in found:
        assert np.abs(task.error(kinematics.tool_pose(q), task.path.corners[0])).max() < 1e-9
        assert (q >= robot.limits.lower).all()
        assert (q <= robot.limits.upper).all()
    distance = [np.linalg.norm(q - posture) for q in found]
    assert distance == sorted(distance)
    assert distance[0] < 0.25
    assert distance[-1] > 1.0


def test_self_motion_goes_both_ways() -> None:
    robot, task, posture, _ = parts(short_scene())
    along = np.linalg.svd(Kinematics(robot).tool_jacobian(posture)[1])[2][-1]
    side = [along @ (q - posture) for q in self_motion_postures(robot, task, posture)[:6]]
    assert min(side) < -0.05
    assert max(side) > 0.05


def test_no_start_beyond_the_first_range(cmbot_robot: Any) -> None:
    """The curve ends where a joint's range does; a narrow range leaves few postures."""
    _, task, posture, _ = parts(short_scene())
    reach = np.deg2rad(15)
    narrow = replace(
        cmbot_robot, limits=replace(cmbot_robot.limits, lower=posture - reach, upper=posture + reach)
    )
    found = self_motion_postures(narrow, task, posture)
    assert 0 < len(found) < 10
    assert all(np.abs(q - posture).max() <= reach for q in found)


def test_the_scenes_posture_is_kept_where_it_works() -> None:
    scene = short_scene()
    robot, task, posture, clearances = parts(scene)
    told: list[int] = []
    path, failures = find_path(robot, task, posture, clearances, scene.planner, told.append)
    assert told == []
    assert failures == ()
    np.testing.assert_array_equal(path.q[0], posture)


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
    np.testing.assert_array_equal(fixed_line_plan.baseline.q[0], load_scene("line").posture)
    assert fixed_line_plan.baseline_figures.min_clearance < 0.02
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
    """A wall across the tool's way stops every start; the error is the first one's, and counts the others."""
    scene = short_scene(obstacles=[WALL], planner={"other_starts": tries, "path_step_s": 0.05})
    robot, task, posture, clearances = parts(scene)
    told: list[int] = []
    with pytest.raises(PathNotFound, match=rf"; {words} as well \(the best") as caught:
        find_path(robot, task, posture, clearances, scene.planner, told.append)
    assert told == list(range(1, tries + 1))
    first = caught.value.__cause__
    assert isinstance(first, PathNotFound)
    assert caught.value.reason.startswith(first.reason)
    for name in ("time", "progress", "smallest_singular_value", "pair"):
        assert getattr(caught.value, name) == getattr(first, name)
