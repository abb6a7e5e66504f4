"""What a scene file may hold, and that every refusal names its key."""

import copy
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from minimal_scenes import MINIMAL, OTHER_ROBOT

from cmbot.common.errors import SceneError
from cmbot.scene import load_scene

FULL = load_scene("triangle").file.as_data()
BALL = {"name": "ball", "sphere": 1, "xyz": [0, 0, 0]}
UNIT = np.eye(6).tolist()
SKEW = (np.eye(6) + 0.1 * np.eye(6, k=1)).tolist()
ANGLE = {"angle": [0.01, 0.02]}
LEG = MINIMAL["tool_path"]["legs"][0]


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
    ("format", "cmbot-scene/2", "'cmbot-scene/2'", "'cmbot-scene/1'"),
    ("name", "a/b", "'a/b'", "letters, digits, - and _"),
    ("name", "..", "'..'", "letters, digits, - and _"),
    ("name", "a\n", r"'a\n'", "letters, digits, - and _"),
    ("name", 5, "5", "text"),
    ("colour", 1, "an unknown key", "a known key"),
    ("a\nb", 1, "an unknown key", "a known key", r"'a\nb'"),
    ("posture_deg", [], "[]", "1 or more items"),
    ("posture_deg[2]", "90", "'90'", "a number"),
    ("posture_deg[2]", True, "True", "a number"),
    ("posture_deg[2]", math.nan, "nan", "a finite number"),
    ("posture_deg[2]", math.inf, "inf", "a finite number"),
    ("tool_path", [], "[]", "a mapping of keys to values"),
    ("tool_path.keep", "axes", "'axes'", "did you mean axis?"),
    ("tool_path.legs", [], "[]", "1 or more items"),
    ("tool_path.legs", [LEG] * 2001, "[{", "at most 2000 items"),
    ("tool_path.legs[1].by", [0, 1], "[0, 1]", "a list of 3 items"),
    ("tool_path.legs[1].by", [0] * 4, "[0, 0, 0, 0]", "a list of 3 items"),
    ("tool_path.legs[1].by", [0, 0, 0], "(0.0, 0.0, 0.0)", "a leg longer"),
    ("tool_path.legs[1].seconds", 0, "0", "more than 0"),
    ("tool_path.legs[1].second", 2, "an unknown key", "seconds?"),
    ("tool_path.via_points", 4, "4", "at least 5"),
    ("tool_path.via_points", 5.0, "5.0", "a whole number"),
    ("tool_path.legs", [LEG] * 50, "50", "more than the 50 legs", "tool_path.via_points"),
    ("tool_path.speed_profile.ramp", 0, "0", "more than 0"),
    ("tool_path.speed_profile.ramp", 0.6, "0.6", "at most 0.5"),
    ("tool_path.speed_profile.kind", "s", "'s'", "a known value"),
    ("robot.model", "", "''", "1 or more characters"),
    ("robot.model", "arm.urdf", "nothing", "a value, as model is 'arm.urdf'", "robot.base_frame"),
    ("robot.payload_kg", -1, "-1", "at least 0"),
    ("robot.tool_length_m", 0, "0", "more than 0"),
    ("obstacles[0].box", [1, 0, 1], "0", "more than 0", "obstacles[0].box[1]"),
    ("obstacles[0].box", [1, 2e4, 1], "20000.0", "at most 10000", "obstacles[0].box[1]"),
    ("obstacles[0].box", None, "none", "exactly one of these keys", "obstacles[0]"),
    ("obstacles[0].sphere", 1, "box and sphere", "exactly one of these keys", "obstacles[0]"),
    ("obstacles[0].workpiece", 1, "1", "true or false"),
    ("obstacles[1].name", "slab", "'slab'", "a name that no other"),
    ("obstacles[1].name", "post_5", "'post_5'", "a name that no other"),
    ("obstacles[1]", without(BALL, "xyz"), "nothing", "this key is required", "obstacles[1].xyz"),
    ("obstacles", [BALL] * 1001, "[{", "at most 1000 items"),
    ("guardrail", None, "None", "a mapping of keys to values"),
    ("guardrail.bays", -1, "-1", "at least 0"),
    ("guardrail.bays", 101, "101", "at most 100"),
    ("guardrail.post.clamp_m", -2, "-2", "from bottom_m up to below top_m"),
    ("guardrail.post.section", {}, "none", "exactly one"),
    ("guardrail.post.section", ANGLE, "(0.01, 0.02)", "below the leg", "guardrail.post.section.angle"),
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
    ("guardrail.stiffness", SKEW, "not symmetric", "symmetric positive definite"),
    ("guardrail.stiffness[0][1]", 1e308, "not positive definite", "symmetric", "guardrail.stiffness"),
    ("planner.solvr", "slsqp", "an unknown key", "did you mean solver?"),
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
    assert refused(changed(("tool_path", "keep"), "all")).choices == ("pose", "axis", "position")
    assert refused(changed(("robot", "modl"), "x")).choices[:2] == ("model", "base_frame")
    shapes = ("box", "cylinder", "capsule", "sphere", "mesh")
    assert refused(changed(("obstacles", 0, "box"), None)).choices == shapes


@pytest.mark.parametrize("key", ["format", "name", "posture_deg", "tool_path"])
def test_required_keys(key):
    error = refused(without(MINIMAL, key))
    assert (error.key, error.got) == (key, "nothing")


def test_misspelt_required_key_is_named_before_the_missing_one():
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


@pytest.mark.parametrize("key", ["base_frame", "tool_frame", "limits", "mount", "mount.xyz", "mount.rpy_deg"])
def test_other_robot_needs_frames_limits_and_mount(key):
    robot, (*_, last) = copy.deepcopy(OTHER_ROBOT), key.split(".")
    del (robot["mount"] if "." in key else robot)[last]
    assert refused({**MINIMAL, "robot": robot}).key == f"robot.{key}"


ENDLESS = []
ENDLESS.append(ENDLESS)
NOT_PLAIN = {"set": {1, 2}, "array": np.zeros(3), "huge": 10**5000, "endless": ENDLESS}


@pytest.mark.parametrize("value", NOT_PLAIN.values(), ids=NOT_PLAIN)
def test_mapping_with_values_that_no_file_can_hold(value):
    expected = "plain text, numbers, lists and mappings, not nested too deeply"
    assert refused({**MINIMAL, "posture_deg": value}).expected == expected


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
        assert load_scene(scene.file.as_data()).content_hash == scene.content_hash
