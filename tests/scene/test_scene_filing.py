"""A scene that Python changed is saved as what it is, and read back so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_scenes import short_scene

from cmbot.archive import load_plan, save
from cmbot.common.errors import SceneError
from cmbot.planning import plan
from cmbot.scene import Box, Obstacle, Scene, SceneFile, Sphere, filed, load_scene, shipped_scenes
from cmbot.scene.obstacles import pose

BLOCK = {
    "name": "block",
    "box": [0.1, 0.2, 0.3],
    "xyz": [5, 5, 5],
    "rpy_deg": [10, 20, 30],
    "workpiece": True,
}


def again(scene: Scene) -> Scene:
    """The scene that its file describes."""
    return load_scene(filed(scene).file.as_data())


@pytest.mark.parametrize("scene", [*shipped_scenes(), "short"])
def test_what_is_not_changed_stays_as_it_was_read(scene: str) -> None:
    read = short_scene(obstacles=[BLOCK]) if scene == "short" else load_scene(scene)
    same = filed(read)
    assert (same.file, same.content_hash, same.obstacles) == (read.file, read.content_hash, read.obstacles)
    # A change and back.
    assert filed(replace(replace(read, via_points=99), via_points=read.via_points)).file == read.file
    assert filed(replace(read, posture=read.posture.copy())).content_hash == read.content_hash


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
    assert filed(changed).content_hash == read.content_hash != scene.content_hash
    assert isinstance(filed(changed).file, SceneFile)


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
    assert read.scene.content_hash == filed(changed).content_hash != scene.content_hash


def test_what_no_file_says_is_not_saved(tmp_path: Path) -> None:
    scene = short_scene()
    bare = replace(scene, guardrail=short_scene(guardrail={"bays": 0}).guardrail)
    with pytest.raises(SceneError, match=r"^Scene: guardrail: got another guardrail than its file's"):
        filed(bare)
    without = replace(scene, obstacles=())
    with pytest.raises(
        SceneError, match=r"^Scene: obstacles: got a guardrail without .*post_1.*, or with others"
    ):
        save(plan(without), tmp_path / "plan")
    with pytest.raises(SceneError, match=r"^Scene: name: got 'no name', expected"):
        filed(replace(scene, name="no name"))
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
    assert filed(scene).file == scene.file
    turned = replace(scene, robot=replace(scene.robot, mount_rpy=(np.pi, 0.0, 0.5), tool_frame="tool"))
    read = again(turned).robot
    assert (read.tool_frame, read.model, read.limits) == ("tool", scene.robot.model, scene.robot.limits)
    assert read.mount_rpy == pytest.approx((np.pi, 0.0, 0.5), abs=1e-15)
