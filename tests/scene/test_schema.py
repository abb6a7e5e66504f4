"""What a scene file may hold, and that every refusal names its key."""

import copy
import math

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
STIFFNESS = "guardrail.stiffness"
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
    # path, value, key in the error, part of got, part of expected
    (("format",), "cmbot-scene/2", "format", "'cmbot-scene/2'", "'cmbot-scene/1'"),
    (("name",), "a/b", "name", "'a/b'", "letters, digits, - and _"),
    (("name",), "..", "name", "'..'", "letters, digits, - and _"),
    (("name",), "a\n", "name", r"'a\n'", "letters, digits, - and _"),
    (("name",), 5, "name", "5", "text"),
    (("colour",), 1, "colour", "an unknown key", "a known key"),
    (("a\nb",), 1, r"'a\nb'", "an unknown key", "a known key"),
    (("posture_deg",), [], "posture_deg", "[]", "1 or more items"),
    (("posture_deg", 2), "90", "posture_deg[2]", "'90'", "a number"),
    (("posture_deg", 2), True, "posture_deg[2]", "True", "a number"),
    (("posture_deg", 2), math.nan, "posture_deg[2]", "nan", "a finite number"),
    (("posture_deg", 2), math.inf, "posture_deg[2]", "inf", "a finite number"),
    (("tool_path",), [], "tool_path", "[]", "a mapping of keys to values"),
    (("tool_path", "keep"), "axes", "tool_path.keep", "'axes'", "did you mean axis?"),
    (("tool_path", "legs"), [], "tool_path.legs", "[]", "1 or more items"),
    (("tool_path", "legs"), [LEG] * 2001, "tool_path.legs", "[{", "at most 2000 items"),
    (("tool_path", "legs", 1, "by"), [0, 1], "tool_path.legs[1].by", "[0, 1]", "a list of 3 items"),
    (("tool_path", "legs", 1, "by"), [0] * 4, "tool_path.legs[1].by", "[0, 0, 0, 0]", "a list of 3 items"),
    (("tool_path", "legs", 1, "by"), [0, 0, 0], "tool_path.legs[1].by", "(0.0, 0.0, 0.0)", "a leg longer"),
    (("tool_path", "legs", 1, "seconds"), 0, "tool_path.legs[1].seconds", "0", "more than 0"),
    (("tool_path", "legs", 1, "second"), 2, "tool_path.legs[1].second", "an unknown key", "seconds?"),
    (("tool_path", "via_points"), 4, "tool_path.via_points", "4", "at least 5"),
    (("tool_path", "via_points"), 5.0, "tool_path.via_points", "5.0", "a whole number"),
    (("tool_path", "legs"), [LEG] * 50, "tool_path.via_points", "50", "more than the 50 legs"),
    (("tool_path", "speed_profile", "ramp"), 0, "tool_path.speed_profile.ramp", "0", "more than 0"),
    (("tool_path", "speed_profile", "ramp"), 0.6, "tool_path.speed_profile.ramp", "0.6", "at most 0.5"),
    (("tool_path", "speed_profile", "kind"), "s", "tool_path.speed_profile.kind", "'s'", "a known value"),
    (("robot", "model"), "", "robot.model", "''", "1 or more characters"),
    (("robot", "model"), "arm.urdf", "robot.base_frame", "nothing", "a value, as model is 'arm.urdf'"),
    (("robot", "payload_kg"), -1, "robot.payload_kg", "-1", "at least 0"),
    (("robot", "tool_length_m"), 0, "robot.tool_length_m", "0", "more than 0"),
    (("obstacles", 0, "box"), [1, 0, 1], "obstacles[0].box[1]", "0", "more than 0"),
    (("obstacles", 0, "box"), [1, 2e4, 1], "obstacles[0].box[1]", "20000.0", "at most 10000"),
    (("obstacles", 0, "box"), None, "obstacles[0]", "none", "exactly one of these keys"),
    (("obstacles", 0, "sphere"), 1, "obstacles[0]", "box and sphere", "exactly one of these keys"),
    (("obstacles", 0, "workpiece"), 1, "obstacles[0].workpiece", "1", "true or false"),
    (("obstacles", 1, "name"), "slab", "obstacles[1].name", "'slab'", "a name that no other"),
    (("obstacles", 1, "name"), "post_5", "obstacles[1].name", "'post_5'", "a name that no other"),
    (("obstacles", 1), without(BALL, "xyz"), "obstacles[1].xyz", "nothing", "this key is required"),
    (("obstacles",), [BALL] * 1001, "obstacles", "[{", "at most 1000 items"),
    (("guardrail",), None, "guardrail", "None", "a mapping of keys to values"),
    (("guardrail", "bays"), -1, "guardrail.bays", "-1", "at least 0"),
    (("guardrail", "bays"), 101, "guardrail.bays", "101", "at most 100"),
    (("guardrail", "post", "clamp_m"), -2, "guardrail.post.clamp_m", "-2", "from bottom_m up to below top_m"),
    (("guardrail", "post", "section"), {}, "guardrail.post.section", "none", "exactly one"),
    (
        ("guardrail", "post", "section"),
        ANGLE,
        "guardrail.post.section.angle",
        "(0.01, 0.02)",
        "below the leg",
    ),
    (("guardrail", "rails", 1, "name"), "post_1", "guardrail.rails[1].name", "post_1", "no other rail"),
    (("guardrail", "rails", 1, "name"), "top_rail", "guardrail.rails[0].name", "top_rail", "no other rail"),
    (("guardrail", "rails", 1, "height_m"), 0.1, "guardrail.rails[1].height_m", "0.1", "up to its top_m"),
    (("guardrail", "foot", "post"), 6, "guardrail.foot.post", "6", "one of the 5 posts"),
    (("guardrail", "foot", "offset_m"), 4, "guardrail.foot.offset_m", "4", "a place on the guardrail"),
    (("guardrail", "rails"), [], "guardrail.foot.offset_m", "0.5", "no rail at height 0"),
    (("guardrail", "post"), {"top_m": -0.5}, "guardrail.post", "-1.05 to -0.5", "pass height 0"),
    (("guardrail", "mass"), UNIT, "guardrail.mass", "a mass alone", "no mass where no stiffness is given"),
    (("guardrail", "stiffness"), UNIT[:5], "guardrail.stiffness", "[[1.0", "6 rows of 6 numbers"),
    (("guardrail", "stiffness"), -1, "guardrail.stiffness", "-1", "linear then angular (N/m, N/rad, Nm/rad)"),
    (("guardrail", "stiffness"), [[1] * 6] * 5 + [[1]], STIFFNESS, "[[1, 1", "6 rows of 6 numbers"),
    (
        ("guardrail", "mass"),
        [1] * 6,
        "guardrail.mass",
        "[1, 1",
        "6 rows of 6 numbers, linear then angular (kg",
    ),
    (("guardrail", "stiffness"), [[0] * 6] * 6, "guardrail.stiffness", "the diagonal", "positive definite"),
    (("guardrail", "stiffness"), [[1] * 6] * 6, "guardrail.stiffness", "not positive definite", "symmetric"),
    (("guardrail", "stiffness"), SKEW, STIFFNESS, "not symmetric", "symmetric positive definite"),
    (("guardrail", "stiffness", 0, 1), 1e308, "guardrail.stiffness", "not positive definite", "symmetric"),
    (("planner", "solvr"), "slsqp", "planner.solvr", "an unknown key", "did you mean solver?"),
    (("planner", "avoidance"), "on", "planner.avoidance", "'on'", "a known value"),
    (("planner", "path_step_s"), 0.2, "planner.path_step_s", "0.2", "at most 0.1"),
    (("planner", "max_passes"), 1.5, "planner.max_passes", "1.5", "a whole number"),
    (("name",), "\ud800", "", "text that cannot be read", "valid text"),
]
PREPARED = {
    "no rail at height 0": changed(("guardrail", "foot", "offset_m"), 0.5),
    "pass height 0": changed(("guardrail", "rails"), []),
}


@pytest.mark.parametrize(("path", "value", "key", "got", "expected"), WRONG)
def test_wrong_value_is_refused_with_its_key(path, value, key, got, expected):
    base = PREPARED.get(expected, FULL)
    if path[:2] == ("guardrail", "stiffness") and len(path) == 4:
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


@pytest.mark.parametrize(
    "value", [{1, 2}, np.zeros(3), 10**5000, ENDLESS], ids=["set", "array", "huge", "endless"]
)
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
