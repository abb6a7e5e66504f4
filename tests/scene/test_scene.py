"""Scene files and what Python puts into a scene, or hands to a verb: every refusal names its key or field."""

import copy
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from minimal_scenes import MINIMAL, OTHER_ROBOT
from small_scenes import short_scene

import cmbot
from cmbot.collision import Box, Capsule, Cylinder, Mesh, Sphere
from cmbot.common.errors import InputError, SceneError
from cmbot.planning import Plan
from cmbot.scene import Scene, load_scene

A_PLAN = "a Plan, as cmbot.plan and cmbot.load_plan return it"


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda s: s.with_path(via_points=30.5), "via_points: got 30.5, expected a whole number"),
        (lambda s: s.with_path(via_points=True), "via_points: got True, expected a whole number"),
        (lambda s: s.with_path(via_points="30"), "via_points: got '30', expected a whole number"),
        (lambda s: s.with_path(via_points=4), "via_points: got 4, expected at least 5"),
        (lambda s: s.with_path(legs=()), "legs: got neither, expected either legs, waypoints or a raster"),
        (lambda s: s.with_path(legs=((0, 0, 1),)), r"legs\[0\]: got .*, expected a mapping"),
        (lambda s: s.with_path(keep="poes"), "keep: got 'poes', expected a known value; did you mean pose?"),
        (lambda s: s.with_path(speed_profile=3), "speed_profile: got 3, expected a mapping"),
        (lambda s: s.with_path(keep={1, 2}), "keep: got {1, 2}, expected text, a number or a list of them"),
        (lambda s: s.with_posture(np.array([[1.0]])), r"start.posture\[0\]: got .*, expected a number"),
        (lambda s: s.with_posture([1.0, np.nan]), r"start.posture\[1\]: got nan, expected a finite number"),
        (lambda s: s.changed(robot="cmbot"), "robot: got 'cmbot', expected a mapping"),
        (lambda s: s.changed(obstacles=("wall",)), r"obstacles\[0\]: got 'wall', expected a mapping"),
        (lambda s: s.with_options(3), "Scene: planner: got 3, expected PlannerOptions"),
        (lambda s: s.changed(name=3), "name: got 3, expected text"),
        (lambda s: s.changed(colour=3), "colour: got an unknown key"),
        (lambda s: s.with_payload("5 kg"), "payload_kg: got '5 kg', expected a number"),
        (lambda s: s.robot.changed(tool_length_m=-0.3), "tool_length_m: got -0.3, expected at least 1e-06"),
    ],
)
def test_an_ill_typed_field_of_a_scene_is_named(edit: Callable[[Scene], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        edit(short_scene())


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("knots", 3, "knots: got 3, expected a known value"),
        ("max_passes", 2.5, "max_passes: got 2.5, expected a whole number"),
        ("min_gain", "small", "min_gain: got 'small', expected a number"),
        ("axis_weights", None, "axis_weights: got None, expected a list"),
        ("safety_margin_m", np.nan, "safety_margin_m: got nan, expected a finite number"),
        ("avoidance_gain", object(), "avoidance_gain: got <object"),
    ],
)
def test_an_ill_typed_option_is_named(option: str, value: Any, message: str) -> None:
    with pytest.raises(InputError, match=f"^PlannerOptions: {message}"):
        replace(short_scene().planner, **{option: value})
    with pytest.raises(InputError, match=f"^PlannerOptions: {message}"):
        cmbot.PlannerOptions(**{option: value})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda s: replace(s.strokes[0].legs[0], seconds="4"), "Leg: seconds: got '4', expected a number"),
        (
            lambda s: replace(s.strokes[0].legs[0], seconds=-4.0),
            "Leg: seconds: got -4.0, expected at least 0.001",
        ),
        (
            lambda s: replace(s.strokes[0].legs[0], by=(0.0, 1.0)),
            r"Leg: by: got .*, expected a list of 3 items",
        ),
        (
            lambda s: replace(s.strokes[0].legs[0], by=None),
            "Leg: got none, expected exactly one of these keys",
        ),
        (
            lambda s: replace(s.strokes[0].speed_profile, ramp="0.2"),
            "SpeedProfile: ramp: got '0.2', expected a number",
        ),
        (lambda _: Box(size=3), "Box: size: got 3, expected a list"),  # type: ignore[arg-type]
        (lambda _: Sphere(radius=np.inf), "Sphere: radius: got inf, expected a finite number"),
        (lambda _: Cylinder(radius=0.1, length=0.0), "Cylinder: length: got 0.0, expected at least 1e-06"),
        (lambda _: Capsule(radius=-0.1, length=1.0), "Capsule: radius: got -0.1, expected at least 1e-06"),
        (lambda _: Mesh(path="a.stl"), "Mesh: path: got 'a.stl', expected a path"),  # type: ignore[arg-type]
        (lambda s: replace(s.all_obstacles[0], X_WO=np.eye(3)), "Obstacle: X_WO: got .*expected a pose"),
        (lambda s: replace(s.all_obstacles[0], X_WO=np.full((4, 4), np.nan)), "Obstacle: X_WO: got .*nan"),
        (lambda s: replace(s.all_obstacles[0], X_WO=None), "Obstacle: X_WO: got None, expected a pose"),
        (lambda s: replace(s.all_obstacles[0], shape="box"), "Obstacle: shape: got 'box', expected a Box"),
        (
            lambda s: replace(s.all_obstacles[0], workpiece=1),
            "Obstacle: workpiece: got 1, expected true or false",
        ),
    ],
)
def test_an_ill_typed_part_of_a_scene_is_named(make: Callable[[Any], object], message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}"):
        make(short_scene())


def test_numbers_of_numpy_and_lists_are_taken() -> None:
    scene = short_scene()
    leg = replace(scene.strokes[0].legs[0], by=np.array([0.0, -0.3, 0.0]), seconds=np.float64(4))
    assert scene.with_path(via_points=np.int64(8), legs=[leg]) == scene.with_path(via_points=8)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: cmbot.load_scene(3), "load_scene: source: got 3, expected the path of a scene file"),
        (lambda p: cmbot.load_robot(3), "load_robot: model: got 3, expected cmbot, a robot's name, or"),
        (lambda p: cmbot.load_robot(base_frame=3), "got 3, expected a link of the URDF"),
        (lambda p: cmbot.load_robot(limits=3), "load_robot: limits: got 3, expected the path of a file"),
        (lambda p: cmbot.load_robot(srdf=3), "load_robot: srdf: got 3, expected the path of a file"),
        (lambda p: cmbot.load_robot(payload="5 kg"), "load_robot: payload: got 5 kg, expected a mass in kg"),
        (lambda p: cmbot.load_robot(tool_length="long"), "tool_length: got long, expected a positive length"),
        (lambda p: cmbot.load_plan(None), "cmbot.load_plan: directory: got NoneType, expected the path"),
        (lambda p: cmbot.plan(p.scene, options={"knots": "fixed"}), "PlannerOptions: got dict, expected an"),
        (lambda p: cmbot.plan(p.scene, objective=3), "cmbot.plan: objective: got int, expected something to"),
        (lambda p: cmbot.plan(p.scene, progress=3), "cmbot.plan: progress: got int, expected something to"),
        (lambda p: cmbot.save("out", p), f"cmbot.save: plan: got 'out', expected {A_PLAN}"),
        (lambda p: cmbot.save(p, 3), "cmbot.save: directory: got 3, expected the path of a new folder"),
        (lambda p: cmbot.simulate("out"), f"cmbot.simulate: plan: got 'out', expected {A_PLAN}"),
        (lambda p: cmbot.simulate(p, {"step_s": 1}), "SimulationOptions: got dict, expected an instance"),
        (lambda p: cmbot.replay("out", "a.html"), f"cmbot.replay: plan: got 'out', expected {A_PLAN}"),
        (lambda p: cmbot.replay(p, 3), "cmbot.replay: html: got 3, expected the path of a file"),
        (lambda p: cmbot.replay(p, serve=True, port="all"), "replay: port: got all, expected a free port"),
        (
            lambda p: cmbot.report(p, "a.html", tracking=p),
            "tracking: got Plan, expected a Tracking, as cmbot",
        ),
        (lambda p: cmbot.report("out", "a.html"), f"cmbot.report: plan: got 'out', expected {A_PLAN}"),
        (lambda p: cmbot.report(p, None), "cmbot.report: html: got NoneType, expected the path of a file"),
        (
            lambda p: cmbot.save_tracking(p, "out"),
            "cmbot.save_tracking: tracking: got Plan, expected a Tracking",
        ),
        (
            lambda p: cmbot.load_tracking("out", "out"),
            f"cmbot.load_tracking: plan: got 'out', expected {A_PLAN}",
        ),
    ],
)
def test_what_a_verb_cannot_take_is_named(
    call: Callable[[Plan], object],
    message: str,
    short_plan: Plan,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        call(short_plan)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("call", "meant"),
    [
        (lambda: cmbot.load_scene("triangel"), "triangle"),
        (lambda: cmbot.load_scene("lines.yaml"), "line"),
        (lambda: cmbot.load_robot("cmbott"), "cmbot"),
        (lambda: short_scene(robot={"model": "cmbto"}), "cmbot"),
    ],
)
def test_a_slip_in_the_name_of_what_is_shipped_is_seen(call: Callable[[], object], meant: str) -> None:
    with pytest.raises(InputError, match=rf"; did you mean {meant}\?"):
        call()
    with pytest.raises(InputError) as caught:
        cmbot.load_scene("polishing")  # no slip
    assert "did you mean" not in str(caught.value)


FULL = load_scene("triangle").as_data()
BALL = {"name": "ball", "sphere": 1, "xyz": [0, 0, 0]}
UNIT = np.eye(6).tolist()
SKEW = (np.eye(6) + 0.1 * np.eye(6, k=1)).tolist()
ANGLE = {"angle": [0.01, 0.02]}
LEG = MINIMAL["tool_path"]["legs"][0]
CONE = "tool_path.keep.axis_within_deg"


def changed(path, value, base=FULL):
    """A copy of `base` in which the value at `path` is another, or new."""
    data = copy.deepcopy(base)
    parent = data
    for step in path[:-1]:
        parent = parent[step]
    parent[path[-1]] = value
    return data


def without(data, key):
    return {name: value for name, value in data.items() if name != key}


def refused(data):
    with pytest.raises(SceneError) as caught:
        load_scene(data)
    assert caught.value.source == "scene"
    assert "\n" not in str(caught.value)
    return caught.value


WRONG = [
    # key, value, part of got, part of expected; then the key in the error, where it is another one
    ("format", "cmbot-scene/3", "'cmbot-scene/3'", "'cmbot-scene/2'"),
    ("format", "cmbot-scene/1", "'cmbot-scene/1'", "tools/scene_2.py rewrites it"),
    ("tool", {"process_ramp_s": 0.5}, "0.5", "0 without tool.process_force_n", "tool.process_ramp_s"),
    ("tool", {"process_force_n": [0, 0]}, "[0, 0]", "a list of 3 items", "tool.process_force_n"),
    ("tool", {"process_force_n": [0, 0, 2e4]}, "20000.0", "at most 10000", "tool.process_force_n[2]"),
    ("tool", {"max_speed_m_s": 0}, "0", "at least 0.0001", "tool.max_speed_m_s"),
    ("name", "a/b", "'a/b'", "letters, digits, - and _"),
    ("name", "..", "'..'", "letters, digits, - and _"),
    ("name", "a\n", r"'a\n'", "letters, digits, - and _"),
    ("name", 5, "5", "text"),
    ("colour", 1, "an unknown key", "a known key"),
    ("a\nb", 1, "an unknown key", "a known key", r"'a\nb'"),
    ("start.posture_deg", [], "[]", "1 or more items"),
    ("start.posture_deg[2]", "90", "'90'", "a number"),
    ("start.posture_deg[2]", True, "True", "a number"),
    ("start.posture_deg[2]", math.nan, "nan", "a finite number"),
    ("start.posture_deg[2]", math.inf, "inf", "a finite number"),
    ("tool_path", [], "[]", "a mapping of keys to values"),
    ("tool_path.legs", 3, "3", "a list of mappings, with keys such as by, to, arc"),
    ("tool_path.legs[0]", 3, "3", "a mapping of keys to values, with keys such as by, to, arc"),
    ("tool_path.keep", "axes", "'axes'", "did you mean axis?"),
    ("tool_path.keep", ["axis"], "['axis']", "a known value"),
    ("tool_path.keep", {}, "nothing", "this key is required", CONE),
    ("tool_path.keep", {"axis_within_deg": 0}, "0", "at least 0.1", CONE),
    ("tool_path.keep", {"axis_within_deg": 91}, "91", "at most 90", CONE),
    ("tool_path.keep", {"axis_within_deg": "10"}, "'10'", "a number", CONE),
    (
        "tool_path.keep",
        {"axis_within": 10},
        "an unknown key",
        "axis_within_deg?",
        "tool_path.keep.axis_within",
    ),
    ("tool_path.legs", [], "neither", "either legs, waypoints or a raster"),
    ("tool_path.legs", [LEG] * 2001, "2001 items", "at most 2000 items"),
    ("tool_path.legs[1].by", [0, 1], "[0, 1]", "a list of 3 items"),
    ("tool_path.legs[1].by", [0] * 4, "[0, 0, 0, 0]", "a list of 3 items"),
    ("tool_path.legs[1].by", [0, 0, 0], "(0.0, 0.0, 0.0)", "a leg longer"),
    ("tool_path.legs[1].seconds", 0, "0", "at least 0.001"),
    ("tool_path.legs[1].second", 2, "an unknown key", "seconds?"),
    ("tool_path.via_points", 4, "4", "at least 5"),
    ("tool_path.via_points", 5.0, "5.0", "a whole number"),
    ("tool_path.legs", [LEG] * 50, "50", "more than the 50 legs, or auto", "tool_path.via_points"),
    ("tool_path.speed_profile.ramp", 0, "0", "at least 0.001"),
    ("tool_path.speed_profile.ramp", 0.6, "0.6", "at most 0.5"),
    ("tool_path.speed_profile.kind", "s", "'s'", "a known value"),
    ("robot.model", "", "''", "1 or more characters"),
    ("robot.model", "arm.urdf", "'arm.urdf'", "a file that exists", "robot.model"),
    ("robot.payload_kg", -1, "-1", "at least 0"),
    ("robot.tool_length_m", 0, "0", "at least 1e-06"),
    ("obstacles[0].box", [1, 0, 1], "0", "at least 1e-06", "obstacles[0].box[1]"),
    ("obstacles[0].box", [1, 2e4, 1], "20000.0", "at most 10000", "obstacles[0].box[1]"),
    ("obstacles[0].box", None, "none", "exactly one of these keys", "obstacles[0]"),
    ("obstacles[0].sphere", 1, "box and sphere", "exactly one of these keys", "obstacles[0]"),
    ("obstacles[0].workpiece", 1, "1", "true or false"),
    ("obstacles[1].name", "slab", "'slab'", "a name that no other"),
    ("obstacles[1].name", "post_5", "'post_5'", "a name that no other"),
    ("obstacles[1]", without(BALL, "xyz"), "nothing", "this key is required", "obstacles[1].xyz"),
    ("obstacles", [BALL] * 1001, "1001 items", "at most 1000 items"),
    ("guardrail", None, "None", "a mapping of keys to values"),
    ("guardrail.bays", -1, "-1", "at least 0"),
    ("guardrail.bays", 101, "101", "at most 100"),
    ("guardrail.post.clamp_m", -2, "-2", "from bottom_m up to below top_m"),
    ("guardrail.post.section", {}, "none", "exactly one"),
    ("guardrail.post.section", ANGLE, "(0.01, 0.02)", "below the leg", "guardrail.post.section.angle"),
    ("guardrail.post.section", {"flat": [0.1, 0.1]}, "0.1", "below the width", "guardrail.post.section.flat"),
    ("guardrail.post.section", {"bar": 20}, "20", "millimetres? then 0.02", "guardrail.post.section.bar"),
    ("guardrail.rails[1].name", "post_1", "post_1", "no other rail"),
    ("guardrail.rails[1].name", "top_rail", "top_rail", "no other rail", "guardrail.rails[0].name"),
    ("guardrail.rails[1].height_m", 0.1, "0.1", "up to its top_m"),
    ("guardrail.foot.post", 6, "6", "one of the 5 posts"),
    ("guardrail.foot.offset_m", 4, "4", "a place on the guardrail"),
    ("guardrail.rails", [], "0.5", "no rail at height 0", "guardrail.foot.offset_m"),
    ("guardrail.post", {"top_m": -0.5}, "-1.05 to -0.5", "pass height 0"),
    ("guardrail.mass", UNIT, "a mass alone", "no mass where no stiffness is given"),
    ("guardrail.stiffness", UNIT[:5], "[[1.0", "6 rows of 6 numbers"),
    ("guardrail.stiffness", -1, "-1", "linear then angular (N/m, N/rad, Nm/rad)"),
    ("guardrail.stiffness", [[1] * 6] * 5 + [[1]], "[[1, 1", "6 rows of 6 numbers"),
    ("guardrail.mass", [1] * 6, "[1, 1", "6 rows of 6 numbers, linear then angular (kg"),
    ("guardrail.stiffness", [[0] * 6] * 6, "the diagonal", "positive definite"),
    ("guardrail.stiffness", [[1] * 6] * 6, "not positive definite", "symmetric"),
    ("guardrail.stiffness", SKEW, "not symmetric: [0][1] is 0.1, [1][0] 0", "symmetric positive definite"),
    ("guardrail.stiffness[0][1]", 1e15, "not positive definite", "symmetric", "guardrail.stiffness"),
    ("planner.solvr", "slsqp", "an unknown key", "did you mean solver?"),
    ("tool.process_ramp_s", 800, "800.0", "at most 60 s: ms? then 0.8"),
    ("robot.urdf", "arm.urdf", "an unknown key", "did you mean model?"),
    ("planner.avoidance", "on", "'on'", "a known value"),
    ("planner.path_step_s", 0.2, "0.2", "at most 0.1"),
    ("planner.max_passes", 1.5, "1.5", "a whole number"),
    ("name", "\ud800", "text that cannot be read", "valid text", ""),
]
PREPARED = {
    "no rail at height 0": changed(("guardrail", "foot", "offset_m"), 0.5),
    "pass height 0": changed(("guardrail", "rails"), []),
}


@pytest.mark.parametrize(("where", "value", "got", "expected", "key"), [(*w, w[0])[:5] for w in WRONG])
def test_wrong_value_is_refused_with_its_key(where, value, got, expected, key):
    path = [int(step) if step.isdigit() else step for step in re.findall(r"[^.\[\]]+", where)]
    base = PREPARED.get(expected, FULL)
    if where.startswith("guardrail.stiffness["):
        base = changed(path[:2], UNIT, base)
    error = refused(changed(path, value, base))
    assert error.key == key
    assert got in str(error.got)
    assert expected in error.expected


def test_choices_are_listed():
    kept = ("pose", "axis", "position", "{axis_within_deg: 10}")
    assert refused(changed(("tool_path", "keep"), "all")).choices == kept
    assert refused(changed(("robot", "modl"), "x")).choices[:2] == ("model", "base_frame")
    shapes = ("box", "cylinder", "capsule", "sphere", "mesh")
    assert refused(changed(("obstacles", 0, "box"), None)).choices == shapes


@pytest.mark.parametrize("key", ["format", "name", "tool_path"])
def test_required_keys(key):
    error = refused(without(MINIMAL, key))
    assert (error.key, error.got) == (key, "nothing")
    # A misspelt key is named before the missing one.
    error = refused({**without(MINIMAL, "tool_path"), "toolpath": {}})
    assert error.key == "toolpath"
    assert "did you mean tool_path?" in error.expected


@pytest.mark.parametrize("key", ["base_frame", "tool_frame", "limits", "srdf", "elasticity", "mount"])
def test_shipped_robot_takes_no_frames_limits_or_mount(key):
    value = OTHER_ROBOT.get(key, "arm.srdf")
    error = refused({**MINIMAL, "robot": {key: value}})
    assert error.key == f"robot.{key}"
    assert str(error.got).startswith("{'xyz': [" if key == "mount" else repr(value))
    assert error.expected.startswith("no such key beside model: cmbot: it goes with a URDF of one's own as")


@pytest.mark.parametrize("key", ["mount.xyz", "mount.rpy_deg"])
def test_mount_of_another_robot_is_whole(urdf_folder, key):
    robot, (*_, last) = copy.deepcopy(OTHER_ROBOT), key.split(".")
    robot |= {"model": str(urdf_folder / "cmbot.urdf"), "limits": str(urdf_folder / "joint_limits.yaml")}
    del robot["mount"][last]
    assert refused({**MINIMAL, "robot": robot}).key == f"robot.{key}"


ENDLESS = []
ENDLESS.append(ENDLESS)
NOT_PLAIN = {"set": {1, 2}, "array": np.zeros(3), "huge": 10**5000, "endless": ENDLESS}


@pytest.mark.parametrize("value", NOT_PLAIN.values(), ids=NOT_PLAIN)
def test_mapping_with_values_that_no_file_can_hold(value):
    expected = "plain text, numbers, lists and mappings, not nested too deeply"
    assert refused({**MINIMAL, "start": {"posture_deg": value}}).expected == expected


def places(node, path=()):
    """Every path into nested data."""
    for step, child in node.items() if isinstance(node, dict) else enumerate(node):
        yield (*path, step)
        if isinstance(child, dict | list):
            yield from places(child, (*path, step))


def nested(depth):
    return [nested(depth - 1)] if depth else []


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
STRANGE = st.sampled_from([math.nan, 1e308, -1e308, 5e-324, 10**400, nested(300), {"": {}}, "\ud800", b"x"])


@settings(deadline=None)
@given(
    path=st.sampled_from(list(places(FULL))),
    value=ANYTHING | STRANGE,
    action=st.sampled_from(["replace", "delete", "add"]),
    key=st.text(max_size=5),
)
def test_any_mutation_is_a_scene_or_a_scene_error(path, value, action, key):
    data = changed(path, value)
    parent = data
    for step in path[:-1]:
        parent = parent[step]
    if action == "delete":
        del parent[path[-1]]
    elif action == "add" and isinstance(parent, dict):
        parent[key] = value
    try:
        scene = load_scene(data)
    except SceneError as error:
        assert "\n" not in str(error)
    else:
        assert load_scene(scene.as_data()).content_hash == scene.content_hash


def test_an_obstacle_moves_with_its_workpiece() -> None:
    """It is where the frame of the workpiece puts it; a frame that is not there is refused."""
    box = {"name": "plate", "box": [0.2, 0.1, 0.02], "xyz": [0.1, 0, 0], "rpy_deg": [0, 0, 30]}
    frame = {"xyz": [1.5, 0.5, -2], "rpy_deg": [0, 90, 0]}
    placed = short_scene(frames={"part": frame}, obstacles=[box | {"frame": "part"}])
    X_FO = placed.changed(obstacles=[box]).all_obstacles[0].X_WO
    np.testing.assert_allclose(placed.all_obstacles[0].X_WO, placed.frame_poses["part"] @ X_FO, atol=1e-15)
    for frames, expected in (({"part": frame}, "one of part"), ({}, "the scene has no frames")):
        with pytest.raises(SceneError, match=f"obstacles\\[0\\].frame: got 'other'.*{expected}"):
            short_scene(frames=frames, obstacles=[box | {"frame": "other"}])
