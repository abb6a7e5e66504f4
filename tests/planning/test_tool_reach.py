"""Legs that the stretched arm cannot reach are named, by `cmbot check` and by the planner alike."""

import numpy as np
import pytest
from small_scenes import parts, short_scene

from cmbot.common.errors import PathNotFound
from cmbot.planning import plan, precheck_scene
from cmbot.planning.context import strokes_of
from cmbot.planning.precheck import beyond_reach
from cmbot.planning.progress import Progress
from cmbot.robot import Robot
from cmbot.scene import Scene, Stroke

# The second leg ends 3 m further down, the third comes back.
FAR = {
    "legs": [
        {"by": [0, -0.1, 0], "seconds": 4},
        {"by": [0, 0, -3.0], "seconds": 8},
        {"by": [0, 0, 3.0], "seconds": 8},
    ],
    "via_points": 41,
}


def stroke_of(scene: Scene, robot: Robot) -> Stroke:
    (stroke,) = strokes_of(scene, robot)
    return stroke


def test_ends_out_of_reach_are_found_by_the_length_of_the_arm() -> None:
    scene, near = short_scene(tool_path=FAR), short_scene()
    robot, task, _, _ = parts(scene)
    ((key, distance),) = beyond_reach(stroke_of(scene, robot), robot)
    assert key == "tool_path.legs[1]"
    assert distance == pytest.approx(np.linalg.norm(task.path.corners[2] - robot.base_point))
    # Table 2 of the paper, and a tool of 0.30 m.
    assert robot.reach == pytest.approx(3.78, abs=5e-3)
    assert not list(beyond_reach(stroke_of(near, robot), robot))


@pytest.mark.parametrize("knots", ["sliding", "fixed"])
def test_the_planner_names_the_leg_before_it_searches(knots: str) -> None:
    scene = short_scene(tool_path=FAR, planner={"knots": knots})
    robot, task, _, _ = parts(scene)
    told: list[Progress] = []
    with pytest.raises(PathNotFound) as caught:
        plan(scene, progress=told.append)
    assert not any("postures" in progress.step for progress in told)
    (warning,) = (w for w in precheck_scene(scene).warnings if w.key.startswith("tool_path"))
    ((_, distance),) = beyond_reach(stroke_of(scene, robot), robot)
    assert caught.value.reason.startswith(f"{warning.key} ends {distance:.3f} m from the arm's")
    assert f"{distance - robot.reach:.3f} m out of reach" in caught.value.reason
    assert f"{distance:.3f} m" in warning.got
    # The first via-point out of reach is on that leg.
    at, before = task.path.position([caught.value.time, caught.value.time - 0.5])
    assert np.linalg.norm(at - robot.base_point) > robot.reach > np.linalg.norm(before - robot.base_point)
    assert caught.value.progress == pytest.approx(task.path.progress(caught.value.time))


def test_what_is_just_within_reach_is_not_refused() -> None:
    robot, task, _, _ = parts(short_scene())
    outwards = task.path.corners[0] - robot.base_point
    length = float(np.linalg.norm(outwards))
    for share, beyond in ((1 - 1e-7, 0), (1 + 1e-7, 1)):
        step = (share * robot.reach / length - 1) * outwards
        path = {"legs": [{"by": step.tolist(), "seconds": 4}]}
        scene = short_scene(tool_path=path)
        assert len(list(beyond_reach(stroke_of(scene, robot), robot))) == beyond
