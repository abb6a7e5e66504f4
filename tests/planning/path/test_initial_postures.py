"""Other starts: self-motion holds the tool, the nearest comes first, failures are told."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_scenes import context_of, short_scene

from cmbot.common.errors import PathNotFound
from cmbot.planning import Plan, Progress, plan
from cmbot.planning.path.gradient_projection import find_path, self_motion_postures
from cmbot.planning.progress import ProgressReporter
from cmbot.robot import Kinematics
from cmbot.scene import load_scene

# Beside the tool's way at first, then across it.
WALL = {"name": "wall", "box": [1, 0.02, 1], "xyz": [1.8, 0.45, -2.0]}


@pytest.mark.parametrize("keep", ["pose", "axis", "position"])
def test_self_motion_holds_what_is_kept(keep: str) -> None:
    context = context_of(short_scene(tool_path={"keep": keep}))
    robot, task, posture = context.robot, context.task, context.posture
    found = self_motion_postures(context)
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
    context = context_of(short_scene())
    along = np.linalg.svd(Kinematics(context.robot).tool_jacobian(context.posture)[1])[2][-1]
    side = [along @ (q - context.posture) for q in self_motion_postures(context)[:6]]
    assert min(side) < -0.05
    assert max(side) > 0.05


def test_no_start_beyond_the_first_range(cmbot_robot: Any) -> None:
    """The curve ends where a joint's range does; a narrow range leaves few postures."""
    context, reach = context_of(short_scene()), np.deg2rad(15)
    posture = context.posture
    narrow = replace(
        cmbot_robot, limits=replace(cmbot_robot.limits, lower=posture - reach, upper=posture + reach)
    )
    found = self_motion_postures(replace(context, robot=narrow))
    assert 0 < len(found) < 10
    assert all(np.abs(q - posture).max() <= reach for q in found)


def test_the_scenes_posture_is_kept_where_it_works() -> None:
    reports: list[Progress] = []
    context = replace(context_of(short_scene()), reporter=ProgressReporter(reports.append))
    path, failures = find_path(context)
    assert {report.failed_starts for report in reports} == {0}
    assert failures == ()
    np.testing.assert_array_equal(path.q[0], context.posture)


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
    scene = short_scene(obstacles=[WALL], planner={"other_starts": tries, "path_step_s": 0.05})
    reports: list[Progress] = []
    context = replace(context_of(scene), reporter=ProgressReporter(reports.append))
    with pytest.raises(PathNotFound, match=rf"; {words} as well \(the best") as caught:
        find_path(context)
    begun = [report.failed_starts for report in reports if not report.step]
    assert begun == list(range(1, tries + 1))
    first = caught.value.__cause__
    assert isinstance(first, PathNotFound)
    assert caught.value.reason.startswith(first.reason)
    for name in ("time", "progress", "smallest_singular_value", "pair"):
        assert getattr(caught.value, name) == getattr(first, name)
