"""From a scene file to a scene: defaults, named files, shapes, guardrail, hash; and back to a file."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from minimal_scenes import MINIMAL, OTHER_ROBOT
from small_scenes import short_scene

from cmbot.archive import load_plan, save
from cmbot.common.errors import InputError, SceneError
from cmbot.common.installation import scene_folder
from cmbot.elastic import BarSection, elastic_base
from cmbot.planning import plan
from cmbot.scene import (
    AxisCone,
    Box,
    Capsule,
    Cylinder,
    Mesh,
    Obstacle,
    PlannerOptions,
    Scene,
    SceneFile,
    Sphere,
    Tool,
    load_scene,
    pose,
    shipped_scenes,
    update_file,
)


def test_defaults_are_filled_in():
    scene = load_scene(MINIMAL)
    assert (scene.robot.model, scene.robot.tool_length, scene.robot.payload) == ("cmbot", None, 0)
    assert (scene.keep, scene.via_points) == ("pose", 50)
    assert (scene.speed_profile.kind, scene.speed_profile.ramp) == ("jerk_limited", 0.25)
    assert scene.planner == PlannerOptions()
    assert [obstacle.name for obstacle in scene.obstacles[:3]] == ["top_rail", "bar_1", "bar_2"]
    np.testing.assert_allclose(scene.posture, [0, math.pi / 2])
    assert not scene.posture.flags.writeable


def test_what_the_robot_stands_on_has_a_name():
    assert load_scene(MINIMAL).base_name == "guardrail"
    scene = load_scene({**MINIMAL, "base": {"name": "walkway"}})
    assert scene.base_name == "walkway"
    assert update_file(scene).file.base.name == "walkway"
    assert load_scene(scene.file.as_data()).content_hash == scene.content_hash
    with pytest.raises(SceneError, match=r"base.name: got 'a b', expected 1 to 100 letters"):
        load_scene({**MINIMAL, "base": {"name": "a b"}})


def test_the_tool_block_and_scenes_without_it():
    assert load_scene(MINIMAL).tool == Tool(process_force_n=(0, 0, 0), max_speed_m_s=None)
    # So that the hashes of scenes without it stay.
    assert "tool" not in load_scene(MINIMAL).file.as_data()
    tool = {"process_force_n": [0, 0, -20], "max_speed_m_s": 0.15}
    scene = load_scene({**MINIMAL, "tool": tool})
    assert scene.tool == Tool(process_force_n=(0, 0, -20), max_speed_m_s=0.15)
    assert update_file(scene).content_hash == scene.content_hash
    assert load_scene(scene.file.as_data()).content_hash == scene.content_hash


def test_a_tool_from_python_is_in_the_file():
    first = load_scene(MINIMAL)
    file = update_file(replace(first, tool=Tool(process_force_n=(0, 5, 0)))).file
    assert file.tool.process_force_n == (0, 5, 0)
    assert update_file(replace(load_scene(file.as_data()), tool=Tool())).file.tool == Tool()
    with pytest.raises(InputError, match=r"Tool: max_speed_m_s: got -1, expected at least 0.0001"):
        Tool(max_speed_m_s=-1)
    with pytest.raises(InputError, match="Scene: tool: got dict, expected a Tool"):
        replace(first, tool={})


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
    assert (robot.model, robot.srdf) == (folder / "arm.urdf", folder / "arm.srdf")
    assert (robot.limits, robot.base_frame, robot.tool_frame) == (folder / "limits.yaml", "base", "flange")
    assert robot.elasticity == folder / "tubes.yaml"
    assert robot.mount_xyz == (0, 0, 1)
    np.testing.assert_allclose(robot.mount_rpy, [math.pi, 0, math.pi / 2])
    assert scene.obstacles[0].shape == Mesh(path=folder / "rock.stl")
    monkeypatch.chdir(folder)  # in a mapping they are relative to the current folder
    assert load_scene(scene.file.as_data()).obstacles[0].shape == Mesh(path=folder / "rock.stl")


def test_joints_bend_unless_they_are_rigid():
    plain = load_scene(MINIMAL)
    assert plain.robot.joints == "elastic"
    assert load_scene("triangle").robot.joints == "rigid"
    rigid = update_file(replace(plain, robot=replace(plain.robot, joints="rigid")))
    assert load_scene(rigid.file.as_data()).robot.joints == "rigid"
    assert update_file(plain).content_hash == plain.content_hash


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
    assert [obstacle.shape for obstacle in scene.obstacles] == [
        Box(size=(1, 2, 3)),
        Cylinder(radius=1, length=2),
        Capsule(radius=1, length=2),
        Sphere(radius=1),
    ]
    X = scene.obstacles[1].X_WO
    # Rz(90) Rx(90): x -> y, y -> z, z -> x.
    np.testing.assert_allclose(X, [[0, 0, 1, 1], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], atol=1e-15)
    assert not X.flags.writeable


def test_guardrail_of_ones_own():
    rail = {"name": "rail", "section": {"bar": 0.03}, "roll_deg": 90, "height_m": 0, "box_m": [0.1, 0.2]}
    guardrail = {"bays": 2, "post_spacing_m": 2, "rails": [rail], "foot": {"post": 1, "offset_m": 0.5}}
    scene = load_scene({**MINIMAL, "guardrail": guardrail})
    assert scene.guardrail.post_positions == (-0.5, 1.5, 3.5)
    assert scene.guardrail.rails[0].section == BarSection(diameter=0.03)
    assert scene.guardrail.rails[0].roll == pytest.approx(math.pi / 2)
    assert [obstacle.name for obstacle in scene.obstacles] == ["rail", "post_1", "post_2", "post_3"]
    assert scene.obstacles[0].shape == Box(size=(4, 0.1, 0.2))
    np.testing.assert_allclose(scene.obstacles[0].X_WO[:3, 3], [1.5, 0, 0])


def test_given_stiffness_without_a_frame():
    stiffness = np.diag([1e6, 2e6, 3e6, 1e3, 2e3, 3e3])
    stiffness[0, 4] = stiffness[4, 0] = 1e4
    guardrail = {"bays": 0, "stiffness": stiffness.tolist(), "mass": np.eye(6).tolist()}
    scene = load_scene({**MINIMAL, "guardrail": guardrail})
    assert scene.obstacles == ()
    np.testing.assert_array_equal(scene.guardrail.stiffness, stiffness)
    np.testing.assert_array_equal(scene.guardrail.mass, np.eye(6))
    assert not scene.guardrail.stiffness.flags.writeable


def test_stiffness_by_its_diagonal_and_by_a_factor():
    diagonal = [1e6, 2e6, 3e6, 1e3, 2e3, 3e3]
    scene = load_scene({**MINIMAL, "guardrail": {"stiffness": diagonal}})
    np.testing.assert_array_equal(scene.guardrail.stiffness, np.diag(diagonal))
    modelled, softer = (
        elastic_base(load_scene({**MINIMAL, "guardrail": guardrail}).guardrail)
        for guardrail in ({}, {"stiffness_factor": 0.7})
    )
    np.testing.assert_allclose(softer.stiffness, 0.7 * modelled.stiffness)
    np.testing.assert_allclose(softer.frequencies, np.sqrt(0.7) * modelled.frequencies)
    np.testing.assert_array_equal(softer.mass, modelled.mass)
    for guardrail in ({"stiffness": diagonal, "stiffness_factor": 0.7}, {"bays": 0, "stiffness_factor": 0.7}):
        with pytest.raises(SceneError, match="expected posts whose stiffness it is of"):
            load_scene({**MINIMAL, "guardrail": guardrail})


@pytest.mark.parametrize("data", [MINIMAL, *(load_scene(name).file.as_data() for name in shipped_scenes())])
def test_resolved_scene_loads_as_the_same_scene(data, monkeypatch):
    monkeypatch.chdir(scene_folder())  # where the files lie that a shipped scene names
    scene = load_scene(data)
    again = load_scene(json.loads(json.dumps(scene.file.as_data())))
    assert again.file == scene.file
    assert again.content_hash == scene.content_hash


def test_hash_sees_content_and_nothing_else(folder):
    path = folder / "scene.yaml"
    before = load_scene(path).content_hash
    path.write_text("# a comment\n" + path.read_text().replace('"seconds": 2', '"seconds": 2.0'))
    assert load_scene(path).content_hash == before
    (folder / "rock.stl").write_text("another rock")
    other_mesh = load_scene(path).content_hash
    path.write_text(path.read_text().replace('"seconds": 2.0', '"seconds": 2.5'))
    assert len({before, other_mesh, load_scene(path).content_hash}) == 3


BLOCK = {
    "name": "block",
    "box": [0.1, 0.2, 0.3],
    "xyz": [5, 5, 5],
    "rpy_deg": [10, 20, 30],
    "workpiece": True,
}


def again(scene: Scene) -> Scene:
    """The scene that its file describes."""
    return load_scene(update_file(scene).file.as_data())


@pytest.mark.parametrize("scene", [*shipped_scenes(), "short"])
def test_what_is_not_changed_stays_as_it_was_read(scene: str) -> None:
    read = short_scene(obstacles=[BLOCK]) if scene == "short" else load_scene(scene)
    same = update_file(read)
    assert (same.file, same.content_hash, same.obstacles) == (read.file, read.content_hash, read.obstacles)
    # A change and back.
    assert update_file(replace(replace(read, name="other"), name=read.name)).file == read.file
    assert update_file(replace(read, posture=read.posture.copy())).content_hash == read.content_hash


def test_every_change_is_in_the_file() -> None:
    scene = short_scene(obstacles=[BLOCK])
    block, *members = scene.obstacles
    ball = Obstacle(name="ball", shape=Sphere(radius=0.2), X_WO=pose((4.0, 4.0, 4.0), (0.1, 0.2, 0.3)))
    moved = replace(block, shape=Box(size=(0.3, 0.3, 0.3)), X_WO=pose((6.0, 5.0, 5.0), (0.3, -0.2, 1.0)))
    changed = replace(
        scene,
        name="other",
        posture=scene.posture + 0.1,
        keep="axis",
        legs=(replace(scene.legs[0], by=(0.0, -0.2, 0.1), seconds=np.float64(5.0)),),
        speed_profile=replace(scene.speed_profile, kind="jerk_limited", ramp=0.3),
        via_points=np.int64(9),
        obstacles=(moved, ball, *members),
        planner=replace(scene.planner, max_passes=17, axis_weights=(1.0, 0.5, 1.0)),
        robot=replace(scene.robot, payload=2.5, tool_length=0.25),
    )
    read = again(changed)
    assert (read.name, read.keep, read.via_points) == ("other", "axis", 9)
    leaning = again(replace(scene, keep=AxisCone(axis_within_deg=7.5)))
    assert str(leaning.keep) == "axis within 7.5 deg"
    assert (read.legs, read.speed_profile, read.planner) == (
        changed.legs,
        changed.speed_profile,
        changed.planner,
    )
    assert read.robot == changed.robot
    np.testing.assert_allclose(read.posture, changed.posture, rtol=0, atol=1e-15)
    for mine, theirs in zip(read.obstacles, changed.obstacles, strict=True):
        assert (mine.name, mine.shape, mine.workpiece) == (theirs.name, theirs.shape, theirs.workpiece)
        np.testing.assert_allclose(mine.X_WO, theirs.X_WO, rtol=0, atol=1e-14)
    assert update_file(changed).content_hash == read.content_hash != scene.content_hash
    assert isinstance(update_file(changed).file, SceneFile)


def test_a_plan_of_a_changed_scene_is_read_back(tmp_path: Path) -> None:
    scene = short_scene(obstacles=[BLOCK])
    legs = (replace(scene.legs[0], by=(0.0, -0.2, 0.0), seconds=3.0),)
    # Where the new one stands does not matter.
    ball = Obstacle(name="ball", shape=Sphere(radius=0.2), X_WO=pose((4.0, 4.0, 4.0)))
    changed = replace(scene, legs=legs, via_points=7, obstacles=(*scene.obstacles[1:], ball))
    made = plan(changed)
    save(made, tmp_path / "plan")
    read = load_plan(tmp_path / "plan", verify=True)
    assert (read.scene.legs, read.scene.via_points) == (legs, 7)
    assert [one.name for one in read.scene.obstacles] == ["ball", *(one.name for one in scene.obstacles[1:])]
    assert read.scene.content_hash == update_file(changed).content_hash != scene.content_hash


def test_what_no_file_says_is_not_saved(tmp_path: Path) -> None:
    scene = short_scene()
    bare = replace(scene, guardrail=short_scene(guardrail={"bays": 0}).guardrail)
    with pytest.raises(SceneError, match=r"^Scene: guardrail: got another guardrail than its file's"):
        update_file(bare)
    without = replace(scene, obstacles=())
    with pytest.raises(
        SceneError, match=r"^Scene: obstacles: got a guardrail without .*post_1.*, or with others"
    ):
        save(plan(without), tmp_path / "plan")
    with pytest.raises(SceneError, match=r"^Scene: name: got 'no name', expected"):
        update_file(replace(scene, name="no name"))
    assert list(tmp_path.iterdir()) == []


def test_frames_and_mount_of_a_urdf_are_kept_as_written(urdf_folder: Path) -> None:
    robot = {
        "model": str(urdf_folder / "cmbot.urdf"),
        "base_frame": "arm_base",
        "tool_frame": "tool0",
        "limits": str(urdf_folder / "joint_limits.yaml"),
        "mount": {"xyz": [0, 0.5, 0], "rpy_deg": [180, 0, 17]},
    }
    scene = short_scene(robot=robot)
    assert update_file(scene).file == scene.file
    turned = replace(scene, robot=replace(scene.robot, mount_rpy=(np.pi, 0.0, 0.5), tool_frame="tool"))
    read = again(turned).robot
    assert (read.tool_frame, read.model, read.limits) == ("tool", scene.robot.model, scene.robot.limits)
    assert read.mount_rpy == pytest.approx((np.pi, 0.0, 0.5), abs=1e-15)
