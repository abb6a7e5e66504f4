"""From a scene file to a scene: defaults, named files, shapes, guardrail, hash."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from minimal_scenes import MINIMAL, OTHER_ROBOT

from cmbot.collision import Box, Capsule, Cylinder, Mesh, Sphere
from cmbot.common.errors import InputError, SceneError
from cmbot.elastic import BarSection, elastic_base
from cmbot.scene import PlannerOptions, Tool, load_scene, shipped_scenes


def test_defaults_are_filled_in():
    scene = load_scene(MINIMAL)
    assert (scene.robot.model, scene.robot.tool_length_m, scene.robot.payload_kg) == ("cmbot", None, 0)
    (work,) = scene.strokes
    assert (work.name, work.keep, work.via_points, scene.order) == ("work", "pose", 50, None)
    assert (work.speed_profile.kind, work.speed_profile.ramp) == ("quiet", 0.3)
    assert scene.planner == PlannerOptions()
    assert [obstacle.name for obstacle in scene.all_obstacles[:3]] == ["top_rail", "bar_1", "bar_2"]
    np.testing.assert_allclose(scene.posture, [0, math.pi / 2])
    assert not scene.posture.flags.writeable


def test_what_the_robot_stands_on_has_a_name():
    assert load_scene(MINIMAL).base_name == "guardrail"
    scene = load_scene({**MINIMAL, "base": {"name": "walkway"}})
    assert scene.base_name == "walkway"
    assert scene.base.name == "walkway"
    assert load_scene(scene.as_data()).content_hash == scene.content_hash
    with pytest.raises(SceneError, match=r"base.name: got 'a b', expected 1 to 100 letters"):
        load_scene({**MINIMAL, "base": {"name": "a b"}})


def test_the_tool_block_and_scenes_without_it():
    assert load_scene(MINIMAL).tool == Tool(process_force_n=(0, 0, 0), max_speed_m_s=None)
    tool = {"process_force_n": [0, 0, -20], "max_speed_m_s": 0.15}
    scene = load_scene({**MINIMAL, "tool": tool})
    assert scene.tool == Tool(process_force_n=(0, 0, -20), max_speed_m_s=0.15)
    with pytest.raises(InputError, match=r"Tool: max_speed_m_s: got -1, expected at least 0.0001"):
        Tool(max_speed_m_s=-1)


@pytest.fixture
def folder(tmp_path):
    """A folder with a scene file for another robot and a mesh."""
    for name in ("arm.urdf", "arm.srdf", "tubes.yaml", "limits.yaml", "rock.stl"):
        (tmp_path / name).write_text(name)
    robot = {**OTHER_ROBOT, "srdf": "arm.srdf", "elasticity": "tubes.yaml"}
    rock = {"name": "rock", "mesh": "rock.stl", "xyz": [0, 0, 0]}
    # JSON is YAML 1.2.
    (tmp_path / "scene.yaml").write_text(json.dumps({**MINIMAL, "robot": robot, "obstacles": [rock]}))
    return tmp_path


def test_paths_are_relative_to_the_scene_file(folder, monkeypatch):
    scene = load_scene(folder / "scene.yaml")
    robot = scene.robot
    assert (robot.model, robot.srdf) == (str(folder / "arm.urdf"), str(folder / "arm.srdf"))
    assert (robot.limits, robot.base_frame, robot.tool_frame) == (
        str(folder / "limits.yaml"),
        "base",
        "flange",
    )
    assert robot.elasticity == str(folder / "tubes.yaml")
    # Rz(90) Rx(180)
    np.testing.assert_allclose(
        robot.mount.matrix, [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]], atol=1e-15
    )
    assert scene.all_obstacles[0].shape == Mesh(path=folder / "rock.stl")
    # The paths of a scene that was read lead there from anywhere; in a mapping they start where one is.
    assert load_scene(scene.as_data()) == scene
    data = json.loads((folder / "scene.yaml").read_text())
    monkeypatch.chdir(folder)
    assert load_scene(data) == scene


def test_joints_bend_unless_they_are_rigid():
    assert load_scene(MINIMAL).robot.joints == "elastic"
    assert load_scene("triangle").robot.joints == "rigid"


@pytest.mark.parametrize(
    ("file", "key"),
    [
        ("arm.urdf", "robot.model"),
        ("arm.srdf", "robot.srdf"),
        ("tubes.yaml", "robot.elasticity"),
        ("limits.yaml", "robot.limits"),
        ("rock.stl", "obstacles[0].mesh"),
    ],
)
def test_missing_file_is_named_by_its_key(folder, file, key):
    (folder / file).unlink()
    with pytest.raises(SceneError) as caught:
        load_scene(folder / "scene.yaml")
    assert (caught.value.source, caught.value.key) == (str(folder / "scene.yaml"), key)


@pytest.mark.parametrize("path", ["a\0b", "x" * 5000, "."])
def test_impossible_path(path):
    mesh = {"name": "rock", "mesh": path, "xyz": [0, 0, 0]}
    with pytest.raises(SceneError) as caught:
        load_scene({**MINIMAL, "obstacles": [mesh]})
    assert caught.value.key == "obstacles[0].mesh"
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("source", ["no_such_scene", "no/such.yaml", "a\0b", "x" * 5000])
def test_unknown_scene_lists_the_shipped_ones(source):
    with pytest.raises(SceneError) as caught:
        load_scene(source)
    assert (caught.value.got, caught.value.choices) == ("no such file", shipped_scenes())
    assert str(caught.value).isprintable()
    with pytest.raises(SceneError, match="got nothing, expected a scene file or the name of a shipped scene"):
        load_scene("")  # and not the current folder


def test_a_name_without_its_ending_finds_the_file_beside(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").touch()
    with pytest.raises(SceneError, match=r"mine: no such file.*; did you mean mine\.yaml\?"):
        load_scene("mine")


def test_shapes_and_poses():
    shapes = [{"box": [1, 2, 3]}, {"cylinder": [1, 2]}, {"capsule": [1, 2]}, {"sphere": 1}]
    obstacles = [
        {"name": f"o{n}", "xyz": [n, 0, 0], "rpy_deg": [90, 0, 90], **s} for n, s in enumerate(shapes)
    ]
    scene = load_scene({**MINIMAL, "obstacles": obstacles, "guardrail": {"bays": 0}})
    assert [obstacle.shape for obstacle in scene.all_obstacles] == [
        Box(size=(1, 2, 3)),
        Cylinder(radius=1, length=2),
        Capsule(radius=1, length=2),
        Sphere(radius=1),
    ]
    X = scene.all_obstacles[1].X_WO
    # Rz(90) Rx(90): x -> y, y -> z, z -> x.
    np.testing.assert_allclose(X, [[0, 0, 1, 1], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], atol=1e-15)
    assert not X.flags.writeable


def test_guardrail_of_ones_own():
    rail = {"name": "rail", "section": {"bar": 0.03}, "roll_deg": 90, "height_m": 0, "box_m": [0.1, 0.2]}
    guardrail = {"bays": 2, "post_spacing_m": 2, "rails": [rail], "foot": {"post": 1, "offset_m": 0.5}}
    scene = load_scene({**MINIMAL, "guardrail": guardrail})
    assert scene.elastic_guardrail.post_positions == (-0.5, 1.5, 3.5)
    assert scene.elastic_guardrail.rails[0].section == BarSection(diameter=0.03)
    assert scene.elastic_guardrail.rails[0].roll == pytest.approx(math.pi / 2)
    assert [obstacle.name for obstacle in scene.all_obstacles] == ["rail", "post_1", "post_2", "post_3"]
    assert scene.all_obstacles[0].shape == Box(size=(4, 0.1, 0.2))
    np.testing.assert_allclose(scene.all_obstacles[0].X_WO[:3, 3], [1.5, 0, 0])


def test_given_stiffness_without_a_frame():
    stiffness = np.diag([1e6, 2e6, 3e6, 1e3, 2e3, 3e3])
    stiffness[0, 4] = stiffness[4, 0] = 1e4
    guardrail = {"bays": 0, "stiffness": stiffness.tolist(), "mass": np.eye(6).tolist()}
    scene = load_scene({**MINIMAL, "guardrail": guardrail})
    assert scene.all_obstacles == ()
    np.testing.assert_array_equal(scene.elastic_guardrail.stiffness, stiffness)
    np.testing.assert_array_equal(scene.elastic_guardrail.mass, np.eye(6))
    assert not scene.elastic_guardrail.stiffness.flags.writeable


def test_stiffness_by_its_diagonal_and_by_a_factor():
    diagonal = [1e6, 2e6, 3e6, 1e3, 2e3, 3e3]
    scene = load_scene({**MINIMAL, "guardrail": {"stiffness": diagonal}})
    np.testing.assert_array_equal(scene.elastic_guardrail.stiffness, np.diag(diagonal))
    modelled, softer = (
        elastic_base(load_scene({**MINIMAL, "guardrail": guardrail}).elastic_guardrail)
        for guardrail in ({}, {"stiffness_factor": 0.7})
    )
    np.testing.assert_allclose(softer.stiffness, 0.7 * modelled.stiffness)
    np.testing.assert_allclose(softer.frequencies, np.sqrt(0.7) * modelled.frequencies)
    np.testing.assert_array_equal(softer.mass, modelled.mass)
    for guardrail in ({"stiffness": diagonal, "stiffness_factor": 0.7}, {"bays": 0, "stiffness_factor": 0.7}):
        with pytest.raises(SceneError, match="expected posts whose stiffness it is of"):
            load_scene({**MINIMAL, "guardrail": guardrail})


def test_hash_sees_content_and_nothing_else(folder):
    path = folder / "scene.yaml"
    before = load_scene(path).content_hash
    path.write_text("# a comment\n" + path.read_text().replace('"seconds": 2', '"seconds": 2.0'))
    assert load_scene(path).content_hash == before
    moved = folder / "elsewhere" / "rock.stl"
    moved.parent.mkdir()
    (folder / "rock.stl").rename(moved)
    path.write_text(path.read_text().replace("rock.stl", "elsewhere/rock.stl"))
    assert load_scene(path).content_hash == before  # where its files are does not count
    moved.write_text("another rock")
    other_mesh = load_scene(path).content_hash
    path.write_text(path.read_text().replace('"seconds": 2.0', '"seconds": 2.5'))
    assert len({before, other_mesh, load_scene(path).content_hash}) == 3
