"""The shipped robot is the paper's; requests that cannot be met are refused."""

import dataclasses
import itertools
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from robot_files import load_copy, pose, replace

from cmbot.collision import Clearances
from cmbot.common.errors import InputError, ModelError
from cmbot.common.installation import model_folder
from cmbot.robot import Dynamics, JointLimits, Robot, load_robot
from cmbot.scene import load_scene

VELOCITY_DEG = (20, 20, 20, 30, 30, 30, 30)  # Chang 2021, Table 3
RANGE_DEG = (170, 170, 150, 170, 170, 130, 170)


def test_masses_and_limits(cmbot_robot: Robot) -> None:
    assert cmbot_robot.arm_mass == pytest.approx(37.62, abs=1e-12)
    assert cmbot_robot.carrier_mass == pytest.approx(30.38, abs=1e-12)
    assert cmbot_robot.mass == pytest.approx(68.0, abs=1e-12)
    carrier = cmbot_robot.model.inertias[0]  # in the working stance
    np.testing.assert_allclose(carrier.lever, [0, 0.25, 0], atol=1e-10)
    np.testing.assert_allclose(carrier.inertia, 0.6 * np.eye(3), atol=1e-10)
    expected = np.cross([0, 0.25, 0], [0, 0, -30.38 * 9.81])
    np.testing.assert_allclose(cmbot_robot.carrier_torque, expected, atol=1e-8)
    limits = cmbot_robot.limits
    for name, factor in (("velocity", 1), ("acceleration", 3), ("jerk", 8)):
        expected = np.deg2rad(factor * np.array(VELOCITY_DEG))
        np.testing.assert_allclose(getattr(limits, name), expected, rtol=1e-15)
    np.testing.assert_array_equal(limits.torque, [240, 240, 240, 160, 160, 160, 160])
    np.testing.assert_allclose(limits.upper, np.deg2rad(RANGE_DEG), rtol=1e-15)
    np.testing.assert_array_equal(limits.lower, -limits.upper)


def test_joints_and_frames(cmbot_robot: Robot) -> None:
    assert cmbot_robot.name == "cmbot"
    assert cmbot_robot.joints == tuple(f"joint_{i}" for i in range(1, 8))
    assert cmbot_robot.dof == 7
    assert cmbot_robot.model.frames[cmbot_robot.tool_frame_id].name == "tool0"
    X_WB = cmbot_robot.model.frames[cmbot_robot.model.getFrameId("arm_base")].placement
    expected = pose((np.pi, 0, 0), (0, 0.5, 0))
    np.testing.assert_allclose(X_WB.homogeneous, expected.homogeneous, rtol=0, atol=1e-12)


def test_the_stow_posture_is_clear_and_asks_little(cmbot_robot: Robot) -> None:
    stow = cmbot_robot.group_states["stow"]
    assert list(cmbot_robot.group_states) == ["stow"]  # the working stance is the climber's
    ends = cmbot_robot.limits.upper - np.abs(stow)
    assert np.rad2deg(ends).min() >= 10 - 1e-9
    for scene in ("triangle", "line"):
        clearances = Clearances(cmbot_robot, load_scene(scene).all_obstacles)
        assert clearances.query(stow[None]).distance[0] > 0.045
    efforts = Dynamics(cmbot_robot).static_efforts(stow[None])
    assert np.linalg.norm(efforts.guardrail_torque) < 170
    assert (np.abs(efforts.joint_torque[0]) < 0.85 * cmbot_robot.limits.torque).all()


def test_group_states_of_a_part_of_the_arm_are_no_postures(urdf_folder: Path) -> None:
    replace(urdf_folder / "cmbot.srdf", '<joint name="joint_7" value="-0.5235987755982988" />', "")
    assert load_copy(urdf_folder).group_states == {}


def test_without_srdf_neighbours_and_near_links_are_disabled_and_joints_locked_at_zero(
    urdf_folder: Path,
) -> None:
    (urdf_folder / "cmbot.srdf").unlink()
    robot = load_copy(urdf_folder)
    shapes = robot.collision_model
    joints = [shape.parentJoint for shape in shapes.geometryObjects]
    pairs = {(pair.first, pair.second) for pair in shapes.collisionPairs}
    expected_pairs = {
        (i, k)
        for i, k in itertools.combinations(range(len(joints)), 2)
        if joints[i] != joints[k]
        and robot.model.parents[max(joints[i], joints[k])] != min(joints[i], joints[k])
    }
    names = [shape.name for shape in shapes.geometryObjects]
    near = {tuple(sorted((names[i][:6], names[k][:6]))) for i, k in expected_pairs - pairs}
    # The wrist's joints are nearer to each other than its links are thick.
    assert near == {("link_3", "link_5"), ("link_5", "tool_0")}
    assert pairs < expected_pairs
    assert len(pairs) == len(shapes.collisionPairs)
    expected = pose((0, 0, 0), (0.16, 0.13, 0.075)) * pose((np.pi, np.pi / 2, 0), (-0.16, 0.37, -0.075))
    X_WB = robot.model.frames[robot.model.getFrameId("arm_base")].placement
    np.testing.assert_allclose(X_WB.homogeneous, expected.homogeneous, atol=1e-12)


def test_a_robot_cannot_be_changed(cmbot_robot: Robot) -> None:
    for owner, name in ((cmbot_robot, "payload"), (cmbot_robot, "model"), (cmbot_robot.limits, "upper")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(owner, name, 0.0)
    for field in dataclasses.fields(JointLimits):
        with pytest.raises(ValueError, match="read-only"):
            getattr(cmbot_robot.limits, field.name)[0] = 1.0


def test_limits_are_copied_and_checked() -> None:
    one = np.ones(2)
    values = {"lower": -one, "upper": one, "velocity": one, "acceleration": one, "jerk": one, "torque": one}
    limits = JointLimits(**values)
    for bad in (np.ones(3), np.array([1.0, np.nan])):
        with pytest.raises(InputError, match="jerk"):
            JointLimits(**(values | {"jerk": bad}))
    one[0] = 7.0
    assert limits.upper[0] == 1.0


def test_loading_is_silent(capfd: pytest.CaptureFixture[str]) -> None:
    load_robot("cmbot", tool_length=0.4, payload=1.0)
    assert capfd.readouterr() == ("", "")


def test_content_hash_depends_on_every_file(urdf_folder: Path) -> None:
    before = load_copy(urdf_folder).content_hash
    assert re.fullmatch("[0-9a-f]{64}", before)
    assert load_copy(shutil.copytree(urdf_folder, urdf_folder / "copy")).content_hash == before
    elasticity = shutil.copy(model_folder() / "urdf" / "cmbot.elasticity.yaml", urdf_folder)
    hashes = {before, load_copy(urdf_folder).content_hash}
    for name, old, new in (
        ("cmbot.urdf", 'value="7.8"', 'value="7.9"'),
        ("cmbot.srdf", 'reason="Adjacent"', 'reason="adjacent"'),
        ("joint_limits.yaml", "jerk_deg: 160", "jerk_deg: 161"),
        (elasticity, "wall_m: 0.003", "wall_m: 0.002"),
    ):
        replace(urdf_folder / name, old, new)
        hashes.add(load_copy(urdf_folder).content_hash)
    assert len(hashes) == 6


def test_other_encodings_are_read(urdf_folder: Path) -> None:
    file = urdf_folder / "cmbot.urdf"
    text = file.read_text(encoding="utf-8").replace("?>", ' encoding="latin-1"?>', 1)
    file.write_bytes(text.replace("guardrail", "Geländer").encode("latin-1"))
    assert load_copy(urdf_folder).mass == pytest.approx(68.0)


@pytest.mark.parametrize("key", ["base_frame", "tool_frame"])
@pytest.mark.parametrize("name", ["nowhere", "joint_1", "universe", ""])
def test_unknown_frame_lists_the_links(urdf_folder: Path, key: str, name: str) -> None:
    with pytest.raises(ModelError) as caught:
        load_copy(urdf_folder, **{key: name})
    assert caught.value.key == key
    assert {"foot_1", "arm_base", "link_7", "tool0"} <= set(caught.value.choices)


NO_ARMS = ("tool0 arm_base", "tool0 tool0", "link_7 tool0", "foot_2 tool0", "link_3 foot_2")


@pytest.mark.parametrize("frames", NO_ARMS)
def test_no_arm_between_the_frames(urdf_folder: Path, frames: str) -> None:
    base, tool = frames.split()
    with pytest.raises(ModelError, match=r"tool_frame: .* joints move below"):
        load_copy(urdf_folder, base_frame=base, tool_frame=tool)


@pytest.mark.parametrize("link", ["tool0", "arm_base", "link_4", "foot_2"])
def test_fixed_joint_may_share_its_name_with_a_link(urdf_folder: Path, cmbot_robot: Robot, link: str) -> None:
    """URDF allows it, and the Z1's has such a joint; pinocchio finds no frame then."""
    replace(urdf_folder / "cmbot.urdf", 'joint name="tool_tip_joint"', f'joint name="{link}"')
    robot = load_copy(urdf_folder)
    assert robot.joints == cmbot_robot.joints
    assert robot.mass == cmbot_robot.mass
    frames = [one.model.frames[one.tool_frame_id].placement for one in (robot, cmbot_robot)]
    assert frames[0] == frames[1]


def test_a_shorter_arm(urdf_folder: Path) -> None:
    robot = load_copy(urdf_folder, base_frame="link_2", tool_frame="link_6")
    assert robot.joints == ("joint_3", "joint_4", "joint_5", "joint_6")
    # The locked joint 7 lets link 7 move with link 6.
    assert robot.arm_mass == pytest.approx(7.7 + 4.9 + 3.7 + 2.5 + 3.62)
    assert robot.mass == pytest.approx(68.0)


JOINT_4 = '<joint name="joint_4" type="revolute">'


def test_sliding_joint_beside_the_arm_is_locked(urdf_folder: Path) -> None:
    climb_5 = '<joint name="climb_5" type="revolute">'
    replace(urdf_folder / "cmbot.urdf", climb_5, climb_5.replace("revolute", "prismatic"))
    assert load_copy(urdf_folder).dof == 7


def test_limits_of_a_continuous_joint_without_them_are_assumed(urdf_folder: Path) -> None:
    file = urdf_folder / "cmbot.urdf"
    text = file.read_text(encoding="utf-8").replace(JOINT_4, JOINT_4.replace("revolute", "continuous"))
    start = text.index("<limit", text.index('"joint_4"'))
    file.write_text(text[:start] + text[text.index("/>", start) + 2 :], encoding="utf-8")
    robot = load_copy(urdf_folder)
    assert robot.limits.velocity[3] == 1.0
    assert robot.limits.assumed_velocity.tolist() == robot.limits.assumed_torque.tolist()
    assert np.flatnonzero(robot.limits.assumed_torque).tolist() == [3]
    assert next(each for each in robot.remarks if "1 joint of 7" in each).startswith(
        "Velocity limits of 1 joint"
    )


SRDF, LIMITS = "cmbot.srdf", "joint_limits.yaml"


@pytest.mark.parametrize(
    ("name", "old", "new", "word"),
    [
        (LIMITS, "jerk_deg: 160", "jerk_deg: 0", r"joints.joint_1.jerk_deg: got 0, expected at least 1e-06"),
        (LIMITS, "jerk_deg: 160", "jerk_deg: .nan", "jerk_deg"),
        (LIMITS, "jerk_deg: 160", "jerk_deg: '160'", "jerk_deg"),
        (LIMITS, "jerk_deg: 160", "jerk: 160", "jerk"),
        (LIMITS, "cmbot-joint-limits/1", "cmbot-joint-limits/2", "format"),
        (LIMITS, "joints:", "joints: [", "joint_limits.yaml"),
        (SRDF, "</robot>", "", "not well-formed XML"),
        (SRDF, "robot", "sdf", "<sdf>"),
        (SRDF, 'value="0.0"', 'value="flat"', "group_state.climb_2: got 'flat'"),
        (SRDF, 'value="0.0"', 'value="nan"', "group_state.climb_2: got 'nan'"),
        (SRDF, 'value="0.0"', "", "group_state.climb_2: got ''"),
        (SRDF, 'link2="link_1"', "", "disable_collisions: .* link1 and link2"),
    ],
)
def test_bad_joint_limits_and_srdf(
    urdf_folder: Path, capfd: pytest.CaptureFixture[str], name: str, old: str, new: str, word: str
) -> None:
    replace(urdf_folder / name, old, new)
    with pytest.raises(ModelError, match=word) as caught:
        load_copy(urdf_folder)
    assert caught.value.source == str(urdf_folder / name)
    assert capfd.readouterr() == ("", "")


def test_missing_files(urdf_folder: Path) -> None:
    with pytest.raises(ModelError, match=r"other.srdf"):
        load_copy(urdf_folder, srdf=urdf_folder / "other.srdf")
    (urdf_folder / LIMITS).rename(urdf_folder / "other.yaml")
    with pytest.raises(ModelError, match=r"none.yaml"):
        load_copy(urdf_folder, limits=urdf_folder / "none.yaml")
    assert load_copy(urdf_folder, limits=urdf_folder / "other.yaml").dof == 7


def test_postures_are_finite_and_within_the_ranges(cmbot_robot: Robot) -> None:
    for bad in (np.zeros(6), np.zeros((1, 7)), np.full(7, np.nan), np.full(7, np.inf)):
        with pytest.raises(InputError, match="7 finite joint angles"):
            cmbot_robot.posture(bad)
    edge = np.deg2rad(RANGE_DEG)
    np.testing.assert_array_equal(cmbot_robot.posture(list(edge)), edge)
    edge[2] += 1e-9
    with pytest.raises(InputError, match=r"posture_deg\[2\]: got 150 deg, expected joint_3 within") as caught:
        cmbot_robot.posture(edge, source="scene.yaml", key="posture_deg")
    assert caught.value.source == "scene.yaml"
