"""Robots of example-robot-data: by their names, with frames where need be, and with clear postures."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from oracle_arms import body_of
from small_scenes import SHORT
from urdf_arms import ROBOTS, only_collision

import cmbot.common.robot_library
from cmbot.collision import Clearances
from cmbot.common.errors import MissingExtra, ModelError, SceneError
from cmbot.common.robot_library import library_robots
from cmbot.robot import NEAR, Robot, load_robot, robot_files, sampled_postures, srdf_text
from cmbot.scene import load_scene


def load(name: str, folder: Path, base: str | None, tool: str | None, *links: str) -> Robot:
    share = ROBOTS.parent.parent
    return load_robot(
        only_collision(name, folder, links), base_frame=base, tool_frame=tool, package_dirs=[share]
    )


ARMS = [
    ("TwoDofs", None, None, 2),
    ("baxter", "torso", "left_gripper", 7),
    ("hextilt_flying_arm_5", None, None, 5),
    ("icub", "chest", "l_gripper", 7),
    ("panda", None, None, 7),
    ("pr2", "torso_lift_link", "r_gripper_tool_frame", 7),
    ("so100", "base", "wrist", 4),
    ("tiago_dual", "torso_lift_link", "arm_left_tool_link", 7),
    ("ur10_joint_limited_robot", None, None, 6),
    ("ur5_gripper", None, None, 6),
    ("xarm7", None, None, 7),
]


@pytest.mark.parametrize(("name", "base", "tool", "joints"), ARMS, ids=[arm[0] for arm in ARMS])
def test_arms_load(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    name: str,
    base: str | None,
    tool: str | None,
    joints: int,
) -> None:
    assert load(name, tmp_path, base, tool).dof == joints
    assert capfd.readouterr() == ("", "")


def test_a_copy_elsewhere_finds_the_librarys_meshes(tmp_path: Path) -> None:
    """As in a xacro of one's own around it: its package needs no folder to be named."""
    assert load_robot(only_collision("ur10", tmp_path, ())).dof == 6


G1 = ("torso", "left_shoulder", "left_elbow", "left_wrist", "left_rubber")
WITHOUT_SRDF = [
    ("ur3", None, None, 6),
    ("ur5", None, None, 6),
    ("ur10", None, None, 6),
    ("z1", None, "gripperStator", 6),
    ("talos", "torso_2_link", "gripper_left_base_link", 7, "torso", "arm_left", "wrist_left", "gripper_left"),
    ("tiago_no_hand", "torso_lift_link", "arm_tool_link", 7),
    ("g1", "torso_link", "left_rubber_hand", 7, *G1),
]


@pytest.mark.parametrize("arm", WITHOUT_SRDF, ids=[arm[0] for arm in WITHOUT_SRDF])
def test_arms_have_clear_postures_without_an_srdf(
    tmp_path: Path, arm: tuple[str, str | None, str | None, int]
) -> None:
    name, base, tool, joints, *links = arm
    robot = load(name, tmp_path, base, tool, *links)
    assert robot.dof == joints
    q = sampled_postures(np.maximum(robot.limits.lower, -3), np.minimum(robot.limits.upper, 3), 50)
    assert (Clearances(robot, []).query(q).distance > NEAR).any()
    assert any(remark.startswith("No SRDF says which links may touch") for remark in robot.remarks)


def test_the_second_reading_leaves_out_the_same_pairs(tmp_path: Path) -> None:
    robot = load("ur5", tmp_path, None, "tool0")
    names = [shape.name.rpartition("_")[0] for shape in robot.collision_model.geometryObjects]
    pairs = {frozenset((names[p.first], names[p.second])) for p in robot.collision_model.collisionPairs}
    scene = {**SHORT, "start": {"posture_deg": [0] * 6}}
    scene["robot"] = {
        "model": str(robot.urdf),
        "package_dirs": [str(ROBOTS.parent.parent)],
        "tool_frame": "tool0",
    }
    body = body_of(load_scene(scene))
    assert {frozenset((body.shapes[i].link, body.shapes[k].link)) for i, k in body.pairs} == pairs
    assert frozenset(("base_link", "upper_arm_link")) not in pairs
    assert frozenset(("base_link", "wrist_3_link")) in pairs
    np.testing.assert_allclose(body.bounds.jerk, robot.limits.jerk)


def test_an_srdf_says_why_links_are_not_checked(tmp_path: Path) -> None:
    file = only_collision("ur5", tmp_path)
    files = robot_files(file, package_dirs=[ROBOTS.parent.parent])
    text = srdf_text(files)
    reasons = {
        frozenset((pair.get("link1"), pair.get("link2"))): pair.get("reason")
        for pair in ElementTree.fromstring(text)
    }
    assert reasons[frozenset(("shoulder_link", "upper_arm_link"))] == "Adjacent"
    assert reasons[frozenset(("wrist_1_link", "wrist_3_link"))] == "Always"
    assert "Never" in reasons.values()
    assert frozenset(("base_link", "wrist_3_link")) not in reasons
    file.with_suffix(".srdf").write_text(text, encoding="utf-8")
    robot = load_robot(file, package_dirs=[ROBOTS.parent.parent])
    assert len(robot.collision_model.collisionPairs) == 28 - len(reasons)
    assert not any("SRDF" in remark for remark in robot.remarks)
    # Nothing that comes nearer than another pair is left out but what always is near.
    q = np.random.default_rng(5).uniform(robot.limits.lower, robot.limits.upper, (300, 6))
    file.with_suffix(".srdf").unlink()
    bare = load_robot(file, package_dirs=[ROBOTS.parent.parent])
    names = {frozenset((pair.link, pair.other)) for pair in Clearances(bare, []).pairs}
    assert {pair for pair, reason in reasons.items() if reason == "Never"} <= names
    assert (Clearances(robot, []).query(q).distance >= Clearances(bare, []).query(q).distance).all()


def test_names_stand_for_urdfs_with_their_srdf() -> None:
    robots = library_robots()
    assert robots is not None
    assert {"panda", "ur5", "ur10", "z1", "kinova", "talos", "g1", "tiago", "xarm7"} <= set(robots)
    srdfs = {name: srdf and srdf.name for name, srdf in ((name, robot_files(name).srdf) for name in robots)}
    assert (srdfs["panda_collision"], srdfs["ur5"], srdfs["talos"]) == (
        "panda.srdf",
        "ur5.srdf",
        "talos.srdf",
    )
    assert (srdfs["ur3"], srdfs["ur5_gripper"], srdfs["tiago"]) == (None, "ur5_gripper.srdf", None)
    files = robot_files("panda")
    assert (files.urdf, files.srdf) == (robots["panda"], robots["panda"].parents[1] / "srdf" / "panda.srdf")
    robot = load_scene({**SHORT, "robot": {"model": "panda"}}).robot
    assert (robot.model, robot.base_frame, robot.limits, robot.mount) == ("panda", None, None, None)


def test_a_folder_does_not_hide_a_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`cmbot plan` writes one that is named after the scene, and scenes are named after robots."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "panda").mkdir()
    assert robot_files("panda").urdf.is_file()
    assert load_scene({**SHORT, "robot": {"model": "panda"}}).robot.model == "panda"


def test_near_names_are_proposed() -> None:
    with pytest.raises(ModelError, match=r"pandas: no such file, expected .*; did you mean panda\?"):
        load_robot("pandas")
    with pytest.raises(SceneError, match=r"robot.model: got 'pandas', expected .*; did you mean panda\?"):
        load_scene({**SHORT, "robot": {"model": "pandas"}})


def test_without_the_library_its_command_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cmbot.common.robot_library, "_folder", lambda: None)
    command = r"example-robot-data is not installed; run: pip install .*\[robots\]"
    with pytest.raises(MissingExtra, match=rf"{command}.*; panda is no file"):
        load_robot("panda")
    with pytest.raises(MissingExtra, match=rf"{command}.*; robot.model: panda is no file"):
        load_scene({**SHORT, "robot": {"model": "panda"}})
    with pytest.raises(ModelError, match=r"cmbott: no such file.*did you mean cmbot\?"):
        load_robot("cmbott")
    with pytest.raises(ModelError, match=r"arm.urdf: no such file"):
        load_robot("arm.urdf")
