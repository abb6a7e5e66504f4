"""Places out of reach are named, by `cmbot check` and by the planner alike, before anything is planned.

By the length of the stretched arm, and by its joint ranges and obstacles.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run, write_scene
from hypothesis import given, settings, strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from small_scenes import parts, path_through, request_of, short_scene, strokes_scene

from cmbot import load_robot
from cmbot.common.errors import PathNotFound, PlanningError, SceneError
from cmbot.common.reading.yaml_reader import read_yaml
from cmbot.planning import plan, precheck_scene
from cmbot.planning.attempts import stroke
from cmbot.planning.path.nearest_miss import places_along
from cmbot.planning.path.place_search import worst_missed
from cmbot.planning.progress import Progress
from cmbot.planning.reach import beyond_reach
from cmbot.planning.request import strokes_of
from cmbot.planning.task import ToolTask
from cmbot.robot import Kinematics, Postures, Robot
from cmbot.scene import Keep, Scene, Stroke, load_scene

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
    ((key, place, distance),) = beyond_reach(stroke_of(scene, robot), robot)
    assert key == "tool_path.legs[1]"
    np.testing.assert_array_equal(place, task.path.corners[2])
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
    ((_, place, distance),) = beyond_reach(stroke_of(scene, robot), robot)
    where = ", ".join(f"{x:.3f}" for x in place)
    assert caught.value.reason.startswith(
        f"{warning.key} ends at ({where}) m, {distance:.3f} m from the arm's"
    )
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


KEEPS: tuple[Keep, ...] = ("pose", "axis", "position")


def tool_poses(robot: Robot, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    at = Postures(robot).tool_at(q)
    return list(zip(at.tool_point, at.tool_rotation, strict=True))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**9), keep=st.sampled_from(KEEPS), name=st.sampled_from(["cmbot", "ur5"]))
def test_what_a_posture_within_the_ranges_reaches_is_found(seed: int, keep: Keep, name: str) -> None:
    """Also at the ends of the ranges: beyond them by a fifth is clipped to them."""
    robot = load_robot(name)
    limits, rng = robot.limits, np.random.default_rng(seed)
    away = np.clip(rng.uniform(-1.2, 1.2, robot.dof), -1.0, 1.0) * limits.sampled_half
    ((point, rotation),) = tool_poses(robot, (limits.range_middle + away)[None])
    task = ToolTask.of(path_through(np.array([point, point]), rotation), keep)
    assert worst_missed(robot, task, task.goals([0.0]), limits.range_middle) is None


@pytest.mark.parametrize("keep", KEEPS)
def test_how_far_a_place_is_out_of_reach(cmbot_robot: Robot, keep: Keep) -> None:
    """No start of SciPy's bounded least squares comes nearer; the posture told is as near as is said."""
    robot, limits = cmbot_robot, cmbot_robot.limits
    rotation = Rotation.from_euler("xyz", [2.0, 0.4, -1.0]).as_matrix()
    point = robot.base_point + np.array([2.2, 2.4, -2.4])
    task = ToolTask.of(path_through(np.array([point, point]), rotation), keep)
    goals = task.goals([0.0])
    missed = worst_missed(robot, task, goals, limits.range_middle)
    assert missed is not None and not missed.is_held
    assert limits.contain(missed.best[None]).all()
    assert missed.attempts > 1000
    at = Kinematics(robot).tool_pose(missed.best)
    assert missed.distance == pytest.approx(np.linalg.norm(at.translation - point), abs=1e-9)

    def error(q: np.ndarray) -> np.ndarray:
        return np.asarray(task.error(Kinematics(robot).tool_pose(q), goals))

    rng = np.random.default_rng(0)
    starts = rng.uniform(limits.lower, limits.upper, (10, robot.dof))
    each = [least_squares(error, q, bounds=(limits.lower, limits.upper)) for q in (missed.best, *starts)]
    least = np.sqrt(2 * min(one.cost for one in each))
    assert np.linalg.norm(error(missed.best)) == pytest.approx(least, rel=1e-3)


def test_in_a_cone_the_axis_may_lean(cmbot_robot: Robot) -> None:
    """With its axis turned away the tool does not come out as far as where it may lean back."""
    robot = cmbot_robot
    q = np.radians([-10, -90, 90, 0, 10, 50, 0])
    ((point, rotation),) = tool_poses(robot, q[None])
    out = point + 0.2 * (point - robot.base_point)
    turned = rotation @ Rotation.from_euler("x", 1.5).as_matrix()
    places = path_through(np.array([point, out]), turned)
    found = [
        worst_missed(robot, task, task.goals([0.0, 1.0]), q)
        for task in (ToolTask(places, "axis"), ToolTask(places, "position", cone=1.6))
    ]
    assert found[0] is not None and found[0].found.tolist() == [True, False]
    assert found[1] is None


def blocked(begin: dict[str, Any], **more: Any) -> Scene:
    """Two strokes, the second of them from a pose of its own."""
    scene = strokes_scene()
    there, back = scene.strokes
    (other,) = short_scene(tool_path={"from": begin}).strokes
    return scene.with_strokes((there, back.changed(start_pose=other.start_pose)), **more)


def test_a_stroke_out_of_the_joint_ranges_is_refused_before_any_is_planned() -> None:
    scene = blocked({"xyz": [1.8, 2.6, -2.0], "rpy_deg": [90, 0, 0]})
    robot = parts(scene)[0]
    strokes = strokes_of(scene, robot)
    assert not [*beyond_reach(strokes[1], robot)]
    told: list[Progress] = []
    where = r"strokes\[1\].* is out of reach at \(1.800, 2.700, -2.000\) m: "
    with pytest.raises(PathNotFound, match=where) as caught:
        plan(scene, progress=told.append)
    assert not any(progress.stroke for progress in told)
    assert " mm and " in str(caught.value) and " deg off" in str(caught.value)
    (warning,) = (w for w in precheck_scene(scene).warnings if w.key.startswith("tool_path"))
    assert warning.key.startswith("tool_path.strokes[1]")
    assert "attempts, the nearest is" in warning.got


def test_a_stroke_in_an_obstacle_is_refused_before_any_is_planned() -> None:
    scene = strokes_scene()
    box = {"name": "crate", "box": [0.05, 0.05, 0.05], "xyz": [1.8154, 0.78, -1.9628]}
    crate, *_ = short_scene(obstacles=[box]).obstacles
    scene = scene.changed(obstacles=(*scene.obstacles, crate))
    told: list[Progress] = []
    with pytest.raises(
        PathNotFound, match=r"strokes\[1\].* is blocked at .* into crate, the safety margin"
    ) as caught:
        plan(scene, progress=told.append)
    assert not any(progress.stroke for progress in told)
    assert caught.value.progress < 1.0
    warning = precheck_scene(scene).warnings[-1]
    assert "crate" in warning.got and warning.key.startswith("tool_path.strokes[1]")


def beside_a_web(keep: Any, **raster: Any) -> Scene:
    """Two rows on the flange of a girder below the guardrail; its web is 59 mm beside the first one."""
    rows = {"origin": [1.7, -0.335, -2.1], "u": [0.6, 0, 0], "v": [0, 0.05, 0], "spacing_m": 0.05}
    rows |= {"stand_off_m": 0.0, "cover": "all", **raster}
    return load_scene(
        {
            "format": "cmbot-scene/2",
            "name": "flange",
            "start": {"stow": True},
            "tool": {"process_force_n": [0, 0, -20], "contact_mm": 60},
            "tool_path": {"keep": keep, "raster": rows, "speed_m_s": 0.05, "via_points": "auto"},
            "obstacles": [
                {"name": "web", "box": [9, 0.012, 0.96], "xyz": [0, -0.4, -1.62]},
                {"name": "flange", "box": [9, 0.3, 0.02], "xyz": [0, -0.4, -2.11], "workpiece": True},
            ],
        }
    )


def test_a_lean_is_advised_where_a_web_is_in_the_way() -> None:
    square, advised = beside_a_web("axis"), r"tool_path\.raster\.lean_deg \[0, 15\] every place has a posture"
    (warning,) = precheck_scene(square).warnings
    assert re.search(r"blocked at .* comes within .* of web", warning.got)
    assert re.search(advised, warning.expected)
    with pytest.raises(PathNotFound, match=f"of web, .*{advised}"):
        plan(square, progress=False)
    assert not precheck_scene(beside_a_web("axis", lean_deg=[0, 15])).warnings
    # To the other side the web is.
    (warning,) = precheck_scene(beside_a_web("axis", lean_deg=[0, -15])).warnings
    assert "blocked" in warning.got and "lean_deg" not in warning.expected


def test_what_a_cone_leans_away_from_is_told_when_the_time_is_over() -> None:
    scene = beside_a_web({"axis_within_deg": 15})
    assert not precheck_scene(scene).warnings
    why = r"was over .*; not leaning, at \(.*\) m .* of web, .*lean_deg \[0, 15\] and keep axis every place"
    with pytest.raises(PlanningError, match=why):
        plan(scene.with_options(time_limit_s=1e-3), progress=False)


def test_places_are_tried_by_length_whatever_the_via_points_are() -> None:
    """Half of a way of 2 m that takes 1 s is out of reach, and so are half of the places, not two of nine."""
    legs = [{"by": [0, 0.01, 0], "seconds": 60}, {"by": [0, 2.0, 0], "seconds": 1}]
    told = set()
    for via_points in (8, 60, "auto"):
        way = {"legs": legs, "via_points": via_points}
        scene = short_scene(tool_path=way)
        robot = parts(scene)[0]
        assert not [*beyond_reach(stroke_of(scene, robot), robot)]
        (warning,) = (w for w in precheck_scene(scene).warnings if w.key.startswith("tool_path.legs"))
        told.add(warning)
    (warning,) = told
    counted = re.search(r"(\d+) of (\d+) places are like it", warning.got)
    assert counted is not None
    missed, tried = map(int, counted.groups())
    assert tried >= 30
    assert 0.2 <= missed / tried <= 0.8


def ur5_scene(folder: Path, by: list[float], **more: Any) -> Scene:
    """What `cmbot new` writes, with one long leg whose via-points are far apart."""
    at = ("--tool-at", "0.55", "0.1", "0.3", "--rpy-deg", "180", "0", "0")
    assert run("new", "--from", "ur5", *at, "-o", str(folder / "ur5.yaml")).status == 0
    data = read_yaml(folder / "ur5.yaml", SceneError)
    data["tool_path"] |= {"legs": [{"by": by, "seconds": 8}], "via_points": 6}
    write_scene(folder / "ur5.yaml", data | more)
    return load_scene(folder / "ur5.yaml")


def test_no_seconds_are_advised_where_a_place_between_via_points_is_out_of_reach(tmp_path: Path) -> None:
    """The wrist cannot come so near to the base's axis; each via-point has a posture."""
    scene = ur5_scene(tmp_path, [-1.1, 0, 0])
    robot = parts(scene)[0]
    (stroke,) = strokes_of(scene, robot)
    task = ToolTask.of(stroke.path, "pose")
    assert worst_missed(robot, task, task.goals(stroke.via_times), scene.posture) is None
    with pytest.raises(PathNotFound, match=r"out of reach at \(-?0\.0\d\d, 0\.100, 0\.300\) m: ") as caught:
        plan(scene, progress=False)
    assert "seconds" not in str(caught.value)
    # It is tried what less to keep would do, and told what does.
    moved, kept = caught.value.hints[0].split(", or ")
    assert kept == "with tool_path.keep position, by which the tool may turn, every place has a posture"
    by = np.array(
        re.fullmatch(r"moved by \((.*)\) m the path is within reach, .*", moved)[1].split(","), float
    )
    places = task.goals(places_along(request_of(scene)))
    assert worst_missed(robot, task, replace(places, point=places.point + by), scene.posture) is None
    task = ToolTask.of(stroke.path, "position")
    assert worst_missed(robot, task, task.goals(places_along(request_of(scene))), scene.posture) is None
    # The line of the file is that which cmbot check names.
    assert str(caught.value).startswith("line 1: no path beyond t = ")
    assert any(
        "1 of " in warning.got and "out of reach" in warning.got for warning in precheck_scene(scene).warnings
    )


def test_no_seconds_are_advised_where_a_place_between_via_points_is_blocked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What else is tried takes a while.
    monkeypatch.setattr(stroke, "LESS_KEPT_RUNS", 1)
    post = {"name": "post", "cylinder": [0.005, 0.05], "xyz": [0.05, 0.35, 0.3]}
    scene = ur5_scene(tmp_path, [-1.0, 0.5, 0], obstacles=[post])
    with pytest.raises(PathNotFound, match=r"blocked at .*, at best .*post, the safety margin") as caught:
        plan(scene, progress=False)
    assert "seconds" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"tool": {"process_force_n": [0, 0, -2000]}}, "tool.process_force_n"),
        ({"robot": {"model": "cmbot", "payload_kg": 90.0}}, "robot.payload_kg"),
    ],
)
def test_a_load_that_joints_do_not_bear_is_named_with_one_that_they_do(
    changes: dict[str, Any], key: str
) -> None:
    """By the check and by the plan; at rest the advised load has a posture for every place."""
    scene = short_scene(**changes)
    (found,) = (each for each in precheck_scene(scene).warnings if each.key.startswith("tool_path"))
    assert re.search(r"(joint|climb)_\d uses \d+% of its torque", str(found.got))
    remedy = re.search(rf"^joints that bear it: {key} (.*) instead of .* would do at rest", found.expected)
    assert remedy is not None
    lighter = scene.with_values({key: json.loads(remedy[1])})
    assert not any(each.key.startswith(("tool_path", "start")) for each in precheck_scene(lighter).warnings)
    with pytest.raises(PlanningError, match=re.escape(f"{key} {remedy[1]} instead of ")):
        plan(scene, options=replace(scene.planner, time_limit_s=5.0))


def test_a_circle_below_reach_is_told_how_far_to_move_it() -> None:
    """By more than what its worst place misses: others miss in other directions."""
    data = load_scene("mast_inspection").as_data()
    turn = {"arc": {"centre": [0.6, 0, 0.5], "axis": [1, 0, 0], "angle_deg": 360}, "seconds": 9}
    begin = {"xyz": [0.6, 0.1, 0.5], "axis": [1, 0, 0]}
    data |= {"tool_path": {"keep": "axis", "from": begin, "legs": [turn]}, "obstacles": []}
    (found,) = (each for each in precheck_scene(load_scene(data)).warnings if "out of reach" in str(each.got))
    told = re.search(r"moved by \((.*?)\) m the path is within reach, obstacles aside", found.expected)
    assert told is not None
    by = np.array([float(part) for part in told[1].split(",")])
    miss = float(re.search(r"the nearest is ([\d.]+) mm", str(found.got))[1])
    assert 1e3 * np.linalg.norm(by) > 1.2 * miss
    begin["xyz"] = (begin["xyz"] + by).tolist()
    turn["arc"]["centre"] = (turn["arc"]["centre"] + by).tolist()
    assert not any("out of reach" in str(each.got) for each in precheck_scene(load_scene(data)).warnings)
