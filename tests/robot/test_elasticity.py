"""The file that says which links bend: its reader, where it is found, the shipped one."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from robot_files import load_copy, replace

from cmbot.common.errors import ModelError
from cmbot.common.installation import model_folder
from cmbot.robot import JointElasticity, LinkTube, Robot

SHIPPED = model_folder() / "urdf" / "cmbot.elasticity.yaml"


@pytest.fixture
def bending_folder(urdf_folder: Path) -> Path:
    """The copy of the shipped robot with its elasticity file."""
    shutil.copy(SHIPPED, urdf_folder / SHIPPED.name)
    return urdf_folder


def test_the_shipped_tubes_lead_from_joint_to_joint(cmbot_robot: Robot) -> None:
    assert list(cmbot_robot.elasticity) == ["link_1", "link_2", "link_3", "link_5"]
    model, tubes = cmbot_robot.model, cmbot_robot.elasticity.values()
    np.testing.assert_allclose([tube.length for tube in tubes], [0.83, 1.0, 0.78, 0.87], rtol=1e-12)
    assert {(tube.young, tube.shear) for tube in tubes} == {(70e9, 26e9)}
    assert [(tube.outer_diameter, tube.wall) for tube in tubes] == [*[(0.1, 0.004)] * 3, (0.08, 0.003)]
    joints = [model.frames[model.getFrameId(link)].parentJoint for link in cmbot_robot.elasticity]
    assert joints == [1, 2, 3, 5]
    # Link 4 has no length: the tube of link 5 begins at its joint, seen from joint 5 at zero.
    X = model.jointPlacements
    starts = [np.zeros(3)] * 3 + [X[5].inverse().translation]
    np.testing.assert_allclose([tube.start for tube in tubes], starts, atol=1e-12)
    ends = [X[joint + 1].translation for joint in joints]
    np.testing.assert_allclose([tube.end for tube in tubes], ends, atol=1e-12)


def test_the_cross_section() -> None:
    tube = LinkTube(start=(0, 0, 0), end=(1, 2, 2), outer_diameter=0.2, wall=0.05, young=1.0, shear=1.0)
    assert tube.length == 3.0
    angle = np.linspace(0, 2 * np.pi, 721)[:-1]
    radius = 0.05 + (np.arange(2000) + 0.5) * 0.05 / 2000
    # The integral of y^2 over the ring.
    integral = np.mean(np.sin(angle) ** 2) * 2 * np.pi * np.sum(radius**3) * 0.05 / 2000
    assert tube.second_moment == pytest.approx(integral, rel=1e-6)


def test_the_file_beside_the_urdf_is_found(urdf_folder: Path, cmbot_robot: Robot) -> None:
    assert load_copy(urdf_folder).elasticity == {}
    shutil.copy(SHIPPED, urdf_folder)
    found = load_copy(urdf_folder).elasticity
    assert list(found.items()) == list(cmbot_robot.elasticity.items())


def test_the_shipped_joints_give_way_as_assumed(cmbot_robot: Robot) -> None:
    springs = cmbot_robot.joint_elasticity
    assert tuple(springs) == cmbot_robot.joints
    assert [spring.stiffness for spring in springs.values()] == [1e5, 1e5, 1e5, 5e4, 5e4, 2e4, 2e4]
    assert {(spring.damping, spring.tilting) for spring in springs.values()} == {(0.0, None)}
    assert cmbot_robot.with_rigid_joints.joint_elasticity == {}


def test_springs_of_a_file(bending_folder: Path) -> None:
    file = bending_folder / SHIPPED.name
    replace(
        file, "joint_3: {stiffness_nm_rad: 100000.0}", "joint_3: {stiffness_nm_rad: 3e+4, damping_nms_rad: 2}"
    )
    replace(
        file,
        "joint_1: {stiffness_nm_rad: 100000.0}",
        "joint_1: {stiffness_nm_rad: 1e+5, tilting_nm_rad: 9e+5}",
    )
    replace(file, "  joint_2: {stiffness_nm_rad: 100000.0}\n", "")
    springs = load_copy(bending_folder).joint_elasticity
    assert list(springs) == ["joint_1", "joint_3", "joint_4", "joint_5", "joint_6", "joint_7"]
    assert springs["joint_1"] == JointElasticity(stiffness=1e5, tilting=9e5)
    assert springs["joint_3"] == JointElasticity(stiffness=3e4, damping=2.0)
    assert list(load_copy(bending_folder, base_frame="link_4").joint_elasticity) == [
        "joint_5", "joint_6", "joint_7"
    ]  # fmt: skip
    links_only = file.read_text(encoding="utf-8").partition("joints:\n")[0]
    file.write_text(links_only.replace("elasticity/2", "elasticity/1"), encoding="utf-8")
    assert load_copy(bending_folder).joint_elasticity == {}
    assert list(load_copy(bending_folder).elasticity) == ["link_1", "link_2", "link_3", "link_5"]


def test_a_file_elsewhere_comes_first_and_has_to_be_there(bending_folder: Path) -> None:
    other = bending_folder / "other.yaml"
    with pytest.raises(ModelError, match=r"other.yaml: .*no such file"):
        load_copy(bending_folder, elasticity=other)
    shutil.copy(SHIPPED, other)
    replace(other, "wall_m: 0.003", "wall_m: 0.002")
    assert load_copy(bending_folder, elasticity=other).elasticity["link_5"].wall == 0.002
    assert load_copy(bending_folder).elasticity["link_5"].wall == 0.003


def test_links_that_do_not_move_are_rigid(bending_folder: Path) -> None:
    robot = load_copy(bending_folder, base_frame="link_2")
    assert list(robot.elasticity) == ["link_3", "link_5"]
    replace(bending_folder / SHIPPED.name, "link_1:", "leg_1:")
    assert list(load_copy(bending_folder).elasticity) == ["link_2", "link_3", "link_5"]


@pytest.mark.parametrize(
    ("old", "new", "key", "word"),
    [
        ("link_5:", "link_9:", "links", "a link of the URDF"),
        ("link_5:", "joint_5:", "links", "a link of the URDF"),
        ("elasticity/2", "elasticity/3", "format", "cmbot-elasticity/2"),
        ("elasticity/2", "elasticity/1", "joints", "it goes with cmbot-elasticity/2"),
        ("joint_7:", "joint_8:", "joints", "a joint of the URDF"),
        (
            "stiffness_nm_rad: 20000.0",
            "stiffness_nm_rad: 0",
            "joints.joint_6.stiffness_nm_rad",
            "at least 0.001",
        ),
        ("stiffness_nm_rad: 20000.0", "damping_nms_rad: 1", "joints.joint_6.stiffness_nm_rad", "a value"),
        ("stiffness_nm_rad: 50000.0", "stiffness: 1", "joints.joint_4.stiffness", "known key"),
        ("wall_m: 0.003", "wall_m: 0.041", "links.link_5.wall_m", "half of outer_diameter_m"),
        ("wall_m: 0.003", "wall_m: 0", "links.link_5.wall_m", "at least 1e-05"),
        ("    wall_m: 0.003\n", "", "links.link_5.wall_m", "a value"),
        ("wall_m: 0.003", "wall: 0.003", "links.link_5.wall", "known key"),
        ("diameter_m: 0.08", "diameter_m: '0.08'", "links.link_5.outer_diameter_m", "a number"),
        ("-0.87]\n    end_m: [0.0, 0.0, 0.0]", "0]\n    end_m: [0, 0, 1e-4]", "links.link_5", "apart"),
        ("[0.0, 0.0, -0.87]", "[0.0, -0.87]", "links.link_5.start_m", "a list of 3 items"),
        ("young_pa: 70000000000.0", "young_pa: 70.0", "links.link_1.young_pa", "GPa? then 70e+9"),
        ("young_pa: 70000000000.0", "young_pa: 70000", "links.link_1.young_pa", "N/mm2? then 70000e+6"),
        (
            "outer_diameter_m: 0.08",
            "outer_diameter_m: 80",
            "links.link_5.outer_diameter_m",
            "millimetres? then 0.08",
        ),
        ("[0.0, 0.0, -0.87]", "[0.0, 0.0, -870]", "links.link_5.start_m", "then [0, 0, -0.87]"),
        ("shear_pa: 26000000000.0", "shear_pa: .nan", "links.link_1.shear_pa", "finite"),
        ("links:", "links: [", "", "valid YAML"),
    ],
)
def test_errors_name_the_key(bending_folder: Path, old: str, new: str, key: str, word: str) -> None:
    file = bending_folder / SHIPPED.name
    replace(file, old, new, 1)
    with pytest.raises(ModelError) as caught:
        load_copy(bending_folder)
    assert (caught.value.source, caught.value.key) == (str(file), key)
    assert word in caught.value.expected


def test_a_joint_that_slides_is_no_spring(bending_folder: Path) -> None:
    urdf = next(bending_folder.glob("*.urdf"))
    replace(urdf, 'joint name="joint_7" type="revolute"', 'joint name="joint_7" type="prismatic"')
    limits = bending_folder / "joint_limits.yaml"
    replace(
        limits,
        "joint_7: {acceleration_deg: 90, jerk_deg: 240}",
        "joint_7: {acceleration_m_s2: 1, jerk_m_s3: 9}",
    )
    with pytest.raises(ModelError) as caught:
        load_copy(bending_folder)
    assert caught.value.key == "joints.joint_7"
    assert "guardrail.stiffness of a scene" in caught.value.expected


def test_one_body_bends_like_one_tube(bending_folder: Path) -> None:
    # The tool is fixed to link 7: both move as one.
    file = bending_folder / SHIPPED.name
    replace(file, "link_1:", "link_7:")
    replace(file, "link_2:", "tool:")
    with pytest.raises(ModelError, match=r"links.tool: got a tube beside that of link_7, expected one tube"):
        load_copy(bending_folder)
