"""URDFs as they are in the world: what is odd about one is said, and keeps no arm from being planned."""

from __future__ import annotations

import importlib
import os
import re
import sys
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest
from command_line import refusal, run
from robot_files import replace
from urdf_arms import limits_file

from cmbot.common.errors import MissingExtra, ModelError, SceneError
from cmbot.robot import Dynamics, Robot, inspect_urdf, load_robot, parse_urdf, robot_files
from cmbot.robot.description.limits_file import JointEntry
from cmbot.scene import load_scene

INERTIA = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
BOX = '<box size="0.02 0.02 0.02"/>'
LIMIT = '<axis xyz="0 1 0"/><limit lower="-1" upper="2" velocity="1.5" effort="9"/>'
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


def link(name: str, parts: str = "", shape: str = BOX) -> str:
    body = f"<collision><geometry>{shape}</geometry></collision>"
    return f'<link name="{name}">{INERTIA}{body}{parts}</link>'


def joint(name: str, kind: str, parent: str, child: str, parts: str = LIMIT, x: float = 0.1) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x} 0 0.1"/>{parts}</joint>'
    )


ARM = [
    link("base"),
    *(link(f"link_{k}") for k in (1, 2, 3)),
    joint("joint_1", "revolute", "base", "link_1"),
    joint("joint_2", "revolute", "link_1", "link_2"),
    joint("joint_3", "revolute", "link_2", "link_3"),
]
GRIPPER = [
    *(link(name) for name in ("hand", "finger_1", "finger_2")),
    joint("hand_joint", "fixed", "link_3", "hand", ""),
    joint("finger_joint_1", "prismatic", "hand", "finger_1"),
    joint("finger_joint_2", "prismatic", "hand", "finger_2", f'{LIMIT}<mimic joint="finger_joint_1"/>', -0.1),
]


def write(folder: Path, *parts: str, name: str = "arm.urdf") -> Path:
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f'<robot name="arm">{"".join(parts)}</robot>', encoding="utf-8")
    return file


def warned(file: Path) -> dict[str, str]:
    findings = inspect_urdf(parse_urdf(file))
    assert {finding.severity for finding in findings} <= {"warning"}
    return {finding.key: finding.got for finding in findings}


def test_materials_are_no_reason_to_refuse_a_robot(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    looks = (
        '<material name=""><color rgba="1 0 0 1"/></material>',
        '<material name="nowhere"/>',
        '<material name="wood"><texture filename="package://none/wood.png"/></material>',
        '<material name="pale"><texture/></material>',
        "<material/>",
    )
    shared = '<material name="a"/><material/>' + 2 * '<material name="b"><color rgba="0 1 0 1"/></material>'
    seen = [f"<visual><geometry>{BOX}</geometry>{look}</visual>" for look in looks]
    file = write(
        tmp_path, shared, link("extra", "".join(seen)), joint("to", "fixed", "base", "extra", ""), *ARM
    )
    assert warned(file) == {
        "material[a]": "neither colour nor texture",
        "material['?']": "no name",
        "material[b]": "another one of that name",
        "link[extra].material": "no name",
        "link[extra].texture": "no file",
    }
    robot = load_robot(file, base_frame="base", tool_frame="link_3")
    colours = [shape.meshColor for shape in robot.visual_model.geometryObjects if shape.overrideMaterial]
    np.testing.assert_allclose(colours, [[1, 0, 0, 1]])
    assert capfd.readouterr() == ("", "")


def test_grippers_and_what_else_is_not_the_arms_are_locked(tmp_path: Path) -> None:
    odd = [
        link("wheel"),
        link("cup"),
        # Published tables are rounded: a milligram's moments of inertia may come out negative.
        link("antenna").replace('ixx="1" iyy="1" izz="1"', 'ixx="-1e-8" iyy="1e-8" izz="2e-8"'),
        joint("wheel", "continuous", "base", "wheel", ""),
        joint("cup_joint", "floating", "hand", "cup", ""),
        joint("antenna_joint", "fixed", "base", "antenna", ""),
    ]
    file = write(tmp_path, *ARM, *GRIPPER, *odd)
    assert set(warned(file)) == {"joint[wheel]", "joint[cup_joint].type", "link[antenna].inertial.inertia"}
    robot = load_robot(file)
    assert (robot.base_frame, robot.joints) == ("base", ("joint_1", "joint_2", "joint_3"))
    # The hand, two fingers and the cup move with the last link.
    assert robot.arm_mass == pytest.approx(7.0)
    with pytest.raises(ModelError, match=r"joint\[cup_joint\].type: got floating, expected an arm of"):
        load_robot(file, base_frame="base", tool_frame="cup")
    # A finger that follows one which does not move the tool does not move either.
    finger = load_robot(file, base_frame="base", tool_frame="finger_2", locked={"finger_joint_1": 0.3})
    assert finger.joints == ("joint_1", "joint_2", "joint_3")
    assert any(each.startswith("finger_joint_2 follows finger_joint_1, which") for each in finger.remarks)
    shut = load_robot(file, base_frame="base", tool_frame="finger_2")
    frames = [each.model.frames[each.tool_frame_id].placement.translation for each in (finger, shut)]
    np.testing.assert_allclose(frames[0] - frames[1], [0, 0.3, 0], atol=1e-12)
    with pytest.raises(ModelError, match=r"joint\[wheel\]: got the name of a link"):
        load_robot(file, base_frame="base", tool_frame="wheel")


def test_impossible_inertias_count_in_the_arm_alone(tmp_path: Path) -> None:
    negative = link("end").replace('ixx="1" iyy="1" izz="1"', 'ixx="-1" iyy="1" izz="2"')
    file = write(tmp_path, *ARM, negative, joint("to_end", "fixed", "base", "end", ""))
    assert load_robot(file, base_frame="base", tool_frame="link_3").dof == 3
    file = write(tmp_path, *ARM, negative, joint("to_end", "fixed", "link_3", "end", ""))
    with pytest.raises(ModelError, match=r"link\[end\].inertial.inertia: got principal moments -1, 1, 2"):
        load_robot(file, base_frame="base", tool_frame="end")


def test_group_states_of_absent_joints_are_remarked(tmp_path: Path) -> None:
    file = write(tmp_path, *ARM)
    states = '<group_state><joint name="elbow" value="x"/><joint name="joint_3" value="0.5"/></group_state>'
    pairs = '<disable_collisions link1="base" link2="nowhere"/>'
    (tmp_path / "arm.srdf").write_text(f'<robot name="arm">{states}{pairs}</robot>', encoding="utf-8")
    robot = load_robot(file, base_frame="base", tool_frame="link_2")
    assert robot.dof == 2
    (remark,) = (remark for remark in robot.remarks if "group states" in remark)
    assert remark == "The SRDF's group states name 'elbow': no movable joint of the URDF, not used."


def mesh_arm(folder: Path, mesh: str) -> Path:
    return write(
        folder, *ARM, link("end", shape=f'<mesh filename="{mesh}"/>'), joint("e", "fixed", "link_3", "end")
    )


def put(file: Path, text: str = TETRAHEDRON) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")


@pytest.mark.parametrize(
    ("place", "given", "variable"),
    [
        ("ws/src/arm_meshes/part.obj", None, None),  # above
        ("ws/src/arm/urdf/arm_meshes/part.obj", None, None),  # beside
        ("ws/src/arm/part.obj", None, None),  # a copy of the package that has another name
        ("else/arm_meshes/part.obj", "else", None),
        ("else/arm_meshes/part.obj", "else/arm_meshes", None),
        ("else/part.obj", "else", None),
        ("else/arm_meshes/part.obj", None, "ROS_PACKAGE_PATH"),
        ("else/share/arm_meshes/part.obj", None, "AMENT_PREFIX_PATH"),
    ],
)
def test_packages_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, given: str | None, variable: str | None
) -> None:
    put(tmp_path / place)
    file = mesh_arm(tmp_path / "ws" / "src" / "arm" / "urdf", "package://arm_meshes/part.obj")
    if variable is not None:
        monkeypatch.setenv(variable, f"/nowhere:{tmp_path / 'else'}")
    options: dict[str, Any] = {} if given is None else {"package_dirs": [tmp_path / given]}
    robot = load_robot(file, **options)
    (mesh,) = (shape for shape in robot.collision_model.geometryObjects if shape.meshPath.endswith(".obj"))
    assert mesh.meshPath == str(tmp_path / place)


def test_a_package_is_known_by_its_manifest_and_missed_by_its_name(tmp_path: Path) -> None:
    file = mesh_arm(tmp_path / "checkout" / "urdf", "package://arm_meshes/meshes/part.obj")
    with pytest.raises(
        ModelError, match=r"link\[end\].mesh.filename: got 'package://arm_meshes/meshes/part.obj'"
    ):
        load_robot(file)
    put(tmp_path / "checkout" / "package.xml", "<package><name> arm_meshes </name></package>")
    put(tmp_path / "checkout" / "meshes" / "part.obj")
    assert load_robot(file).dof == 3
    put(tmp_path / "checkout" / "package.xml", "<package>")
    assert load_robot(file).dof == 3


def test_check_takes_folders_of_packages(tmp_path: Path) -> None:
    put(tmp_path / "else" / "arm_meshes" / "part.obj")
    file = mesh_arm(tmp_path / "urdf", "package://arm_meshes/part.obj")
    assert run("check", file).status == 2
    assert run("check", file, "--package-dir", tmp_path / "else").status == 0
    line = refusal("check", file, "--package-dir", tmp_path / "nowhere")
    assert line == f"error: --package-dir: got {tmp_path / 'nowhere'}, expected a folder that exists"
    line = refusal("check", "triangle", "--package-dir", tmp_path)
    assert line.endswith("got a scene to check, expected robot.package_dirs in the scene, or a URDF to check")


def test_a_scene_names_folders_of_packages(tmp_path: Path) -> None:
    put(tmp_path / "else" / "arm_meshes" / "part.obj")
    mesh_arm(tmp_path / "urdf", "package://arm_meshes/part.obj")
    (tmp_path / "s.yaml").write_text(
        "format: cmbot-scene/2\nname: s\nrobot: {model: urdf/arm.urdf, package_dirs: [else]}\n"
        "start: {posture_deg: [0, 0, 0]}\ntool_path: {legs: [{by: [0, 0, 1], seconds: 1}]}\n",
        encoding="utf-8",
    )
    scene = load_scene(tmp_path / "s.yaml")
    assert scene.robot.package_dirs == (str(tmp_path / "else"),)
    replace(tmp_path / "s.yaml", "[else]", "[urdf/arm.urdf]")
    with pytest.raises(
        SceneError, match=r"s.yaml:3: robot.package_dirs\[0\]: .* expected a folder that exists"
    ):
        load_scene(tmp_path / "s.yaml")


XACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="arm">
<xacro:include filename="$(find arm_parts)/parts.xacro"/><xacro:include filename="more.xacro"/>
<xacro:property name="length" value="${0.1 * 2}"/>
<xacro:arm reach="${length}"/></robot>"""


def write_xacro(folder: Path) -> Path:
    macro = "".join(ARM).replace('xyz="0.1 0 0.1"', 'xyz="${reach} 0 0.1"')
    root = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">'
    put(
        folder / "else" / "arm_parts" / "parts.xacro",
        f'{root}<xacro:macro name="arm" params="reach">{macro}</xacro:macro></robot>',
    )
    put(
        folder / "urdf" / "more.xacro",
        f"{root}{link('lamp')}{joint('lamp_joint', 'fixed', 'base', 'lamp', '')}</robot>",
    )
    put(folder / "urdf" / "arm.urdf.xacro", XACRO)
    return folder / "urdf" / "arm.urdf.xacro"


def test_xacro_is_expanded_without_ros(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("xacrodoc")
    file = write_xacro(tmp_path)
    robot = load_robot(file, package_dirs=[tmp_path / "else"])
    assert (robot.name, robot.dof, robot.carrier_mass) == ("arm", 3, 2.0)
    assert robot.model.jointPlacements[2].translation[0] == pytest.approx(0.2)
    with pytest.raises(ModelError, match=r"arm.urdf.xacro: \$\(find arm_parts\): no such package"):
        load_robot(file)
    far = "/".join([str(tmp_path), *["folder"] * 40, "macros.xacro"])
    file.with_name("far.urdf.xacro").write_text(
        f'<robot xmlns:xacro="http://ros.org/wiki/xacro" name="far"><xacro:include filename="{far}"/></robot>'
    )
    with pytest.raises(ModelError, match=r"folder/macros.xacro'"):  # of a long path its end
        load_robot(file.with_name("far.urdf.xacro"))
    replace(file, "${length}", "${breadth}")
    with pytest.raises(ModelError, match=r"got xacro that does not expand \(.*breadth"):
        load_robot(file, package_dirs=[tmp_path / "else"])
    # The namespace alone is no xacro.
    plain = write(tmp_path, *ARM)
    replace(plain, "<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    replace(plain, "</robot>", "<!-- <xacro:arm/> --></robot>")
    assert load_robot(plain).dof == 3
    assert capfd.readouterr() == ("", "")


NESTED = "<xacro:if value='1'>" + "<a>" * 3000 + "</a>" * 3000 + "</xacro:if>"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('<xacro:include filename="arm.xacro"/>', "in which arm.xacro includes itself"),
        ('<xacro:include filename="other.xacro"/>', "in which arm.xacro includes itself"),
        ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "a macro that calls itself"),
        (NESTED, "nested too deep"),
        ("<xacro:include/>", "missing attribute 'filename'"),
        (
            '<xacro:property name="p" value="1" scope="parent"/><xacro:property name="p" remove="1"/>',
            "expand",
        ),
        ("<a><xacro:attribute name='&lt;' value='3'/></a>", "not well-formed"),
        ("""<l n="${'\\ud800'}"/><xacro:if value="1"/>""", "codec can"),
    ],
)
def test_xacro_that_has_no_end_or_makes_no_xml(tmp_path: Path, content: str, said: str) -> None:
    pytest.importorskip("xacrodoc")
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="arm">'
    put(tmp_path / "other.xacro", f'{head}<xacro:include filename="arm.xacro"/></robot>')
    file = tmp_path / "arm.xacro"
    put(file, f"{head}{content}</robot>")
    with pytest.raises(ModelError, match=rf"^{file}: got xacro .*{said}"):
        load_robot(file)
    # What was wrong with it is forgotten.
    good = write_xacro(tmp_path)
    assert load_robot(good, package_dirs=[tmp_path / "else"]).dof == 3


@pytest.mark.parametrize("upper", [0.0, 1.0])
def test_a_joint_of_an_empty_range(tmp_path: Path, upper: float) -> None:
    still = LIMIT.replace('lower="-1" upper="2"', f'lower="{upper}" upper="{upper}"')
    parts = [
        joint("joint_2", "revolute", "link_1", "link_2", still) if "joint_2" in part else part for part in ARM
    ]
    said = rf"joint\[joint_2\].limit: got the range {upper:g} to {upper:g}, expected lower < upper"
    with pytest.raises(ModelError, match=said):
        load_robot(write(tmp_path, *parts))


HEAD = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="arm">'
PLAIN = '<xacro:property name="y" value="1"/>'
LOAD = """<xacro:property name="x" value="${xacro.load_yaml('%s')}"/><link name="${x}"/></robot>"""


@pytest.mark.parametrize(
    ("content", "said"),
    [
        # 5 GB of a name, and without end.
        (PLAIN + "<link name=\"${'x' * 10**9}\"/></robot>", "that takes more than (1 GB|20 MB)"),
        (PLAIN + "<link name=\"${'x' * 30 * 10**6}\"/></robot>", "that takes more than 20 MB of text"),
        (PLAIN + '<link name="${9**9**9}"/></robot>', "that takes more than 1 s"),
        (LOAD % "/etc/passwd", "a file outside of the folder"),
        (LOAD % "$(find etc)/passwd", "no such package"),
        (LOAD % "$(find ..)/secret.yaml", "no such package"),
        (LOAD % "../secret.yaml", "a file outside of the folder"),
        (LOAD % "link.yaml", "a file outside of the folder"),
        (LOAD % "pipe", "a file that is not regular"),
        ('<xacro:include filename="pipe"/></robot>', "a file that is not regular"),
        ('<xacro:include filename="../secret.yaml"/></robot>', "a file outside of the folder"),
    ],
)
def test_xacro_of_a_stranger(
    tmp_path: Path, content: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time, memory and files are bounded, and what they hold is not told."""
    pytest.importorskip("xacrodoc")
    if "1 s" in said:
        monkeypatch.setattr(importlib.import_module("cmbot.robot.description.xacro"), "_CPU_SECONDS", 1)
    put(tmp_path / "secret.yaml", "password: 12345")
    folder = tmp_path / "model"
    folder.mkdir()
    os.mkfifo(folder / "pipe")
    (folder / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    put(folder / "arm.xacro", HEAD + content)
    with pytest.raises(ModelError, match=said) as caught:
        load_robot(folder / "arm.xacro")
    assert str(caught.value).startswith(str(folder))
    assert len(str(caught.value)) <= 400
    assert not re.search("root:|12345", str(caught.value))


@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("import nowhere", "does not expand (No module named 'nowhere')"),
        ("raise SystemExit(3)", "does not expand (its process ended with status 3)"),
    ],
)
def test_a_process_of_xacro_that_fails_is_no_slow_one(
    tmp_path: Path, does: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacrodoc")
    program = tmp_path / "python"
    program.write_text(f"#!{sys.executable}\n{does}\n", encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    put(tmp_path / "arm.xacro", f'{HEAD}{PLAIN}<link name="a"/></robot>')
    with pytest.raises(ModelError, match=re.escape(said)):
        load_robot(tmp_path / "arm.xacro")


def test_xacro_reads_files_of_its_own_and_no_variables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacrodoc")
    monkeypatch.setenv("CMBOT_SECRET", "12345")
    put(tmp_path / "names.yaml", "link: arm")
    text = """<link name="${xacro.load_yaml('names.yaml')['link']}"/>"""
    text += '<link name="$(optenv CMBOT_SECRET none)"/>'
    put(tmp_path / "arm.xacro", f"{HEAD}{PLAIN}{text}</robot>")
    expanded = parse_urdf(tmp_path / "arm.xacro")
    assert [link.get("name") for link in expanded.iter("link")] == ["arm", "none"]


def test_xacro_is_named_as_what_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    with pytest.raises(
        MissingExtra, match=r"xacrodoc is not installed; run: pip install .*xacro.*not yet a URDF"
    ):
        load_robot(write_xacro(tmp_path))


def limited(folder: Path, text: str) -> Robot:
    (folder / "joint_limits.yaml").write_text(f"format: cmbot-joint-limits/1\n{text}", encoding="utf-8")
    return load_robot(write(folder, *ARM))


def test_limits_that_no_file_gives_are_assumed(tmp_path: Path) -> None:
    robot = load_robot(write(tmp_path, *ARM))
    np.testing.assert_allclose(robot.limits.acceleration, 2 * 1.5)
    np.testing.assert_allclose(robot.limits.jerk, 10 * 2 * 1.5)
    assert robot.remarks[:2] == (
        "Acceleration limits of the joints are assumed, 2 /s times the velocity limit: no joint-limits file "
        "gives them.",
        "Jerk limits of the joints are assumed, 10 /s times the acceleration limit: no joint-limits file "
        "gives them.",
    )
    robot = limited(tmp_path, "joints: {joint_2: {acceleration_deg: 90}}")
    np.testing.assert_allclose(robot.limits.acceleration, [3, np.pi / 2, 3])
    np.testing.assert_allclose(robot.limits.jerk, 10 * robot.limits.acceleration)
    assert "of 2 joints of 3 are assumed" in robot.remarks[0]
    np.testing.assert_array_equal(robot.limits.assumed_acceleration, [True, False, True])
    assert robot.limits.assumed_jerk.all()
    robot = limited(
        tmp_path,
        "all: {acceleration_deg: 180, jerk_deg: 360}\njoints: {joint_1: {acceleration_deg: 90, jerk_deg: 9}}",
    )
    np.testing.assert_allclose(np.rad2deg(robot.limits.acceleration), [90, 180, 180])
    np.testing.assert_allclose(np.rad2deg(robot.limits.jerk), [9, 360, 360])
    assert not any("assumed" in remark for remark in robot.remarks)
    assert not (robot.limits.assumed_acceleration | robot.limits.assumed_jerk).any()
    with pytest.raises(ModelError, match=r"joint_limits.yaml:2: all.jerk_deg: got 0, expected at least"):
        limited(tmp_path, "all: {acceleration_deg: 180, jerk_deg: 0}")


FOREIGN_LIMITS = {
    "Franka": (
        "joint1:\n  limit: {lower: -2.7, upper: 2.7, velocity: 2.1, effort: 87.0}\n",
        "joint1: got an unknown key",
    ),
    "parameters of ROS 2": (
        "/**:\n  ros__parameters:\n    robot_description_planning:\n      format: x\n",
        "'/**': got an unknown key",
    ),
    "with anchors": (
        "joint_limits:\n  joint_1: &all {max_velocity: 1}\n  joint_2: *all\n",
        "the anchor &all",
    ),
    "with tags": ("joint_limits:\n  joint_1: {max_velocity: !degrees 90}\n", "the tag '!degrees'"),
    "of another program": ("format: 2\nlimits: []\n", "format: got 2"),
    "damaged": (
        "joint_limits:\n  joint_1: {max_velocity: fast}\n",
        "joint_limits.joint_1.max_velocity: got 'fast'",
    ),
}


@pytest.mark.parametrize(("text", "why"), FOREIGN_LIMITS.values(), ids=FOREIGN_LIMITS)
def test_limits_of_another_kind_are_left_alone(tmp_path: Path, text: str, why: str) -> None:
    urdf, beside = write(tmp_path, *ARM), tmp_path / "joint_limits.yaml"
    alone = load_robot(urdf)
    beside.write_text(text, encoding="utf-8")
    robot = load_robot(urdf)
    (remark,) = (each for each in robot.remarks if each not in alone.remarks)
    assert remark.startswith(f"{beside} is left alone: it is no joint-limits file of cmbot's or MoveIt's (")
    assert why in remark
    left_alone = robot_files(urdf).left_alone
    assert left_alone is not None
    assert (robot_files(urdf).limits, left_alone[0]) == (None, beside)
    np.testing.assert_array_equal(robot.limits.acceleration, alone.limits.acceleration)
    assert robot.content_hash == alone.content_hash
    # Who names such a file is told that it is none, and who names another has no remark.
    with pytest.raises(ModelError, match=r"joint_limits\.yaml"):
        load_robot(urdf, limits=beside)
    named = limits_file(tmp_path, ["joint_1"])
    assert not any("left alone" in each for each in load_robot(urdf, limits=named).remarks)


MOVEIT = """default_velocity_scaling_factor: 0.1
default_acceleration_scaling_factor: 1
joint_limits:
  joint_1:
    has_velocity_limits: true
    max_velocity: 1.25
    has_acceleration_limits: true
    max_acceleration: 3.75
    has_jerk_limits: true
    max_jerk: 25
  joint_2:
    has_velocity_limits: true
    max_velocity: 2
    has_acceleration_limits: false
    max_acceleration: 7
    has_position_limits: true
    min_position: 0.0
    max_position: 9
    has_effort_limits: true
    max_effort: 5
  of_another_arm: {has_velocity_limits: true, max_velocity: 1, angle_wraparound: false}
"""


@pytest.mark.parametrize(
    "place", ["urdf/joint_limits.yaml", "config/joint_limits.yaml", "urdf/config/joint_limits.yaml"]
)
@pytest.mark.parametrize("nested", [False, True])
def test_limits_of_moveit_are_read(tmp_path: Path, place: str, nested: bool) -> None:
    """The lower of its limit and the URDF's holds; what it switches off does not."""
    urdf, file = write(tmp_path / "urdf", *ARM), tmp_path / place
    text = MOVEIT
    if nested:
        text = "/**:\n  ros__parameters:\n    robot_description_planning:\n" + "".join(
            f"      {line}\n" for line in MOVEIT.splitlines()
        )
    put(file, text)
    robot = load_robot(urdf)
    assert robot_files(urdf).limits == file
    limits = robot.limits
    np.testing.assert_allclose(limits.velocity, [1.25, 1.5, 1.5])
    np.testing.assert_allclose(limits.acceleration, [3.75, 3.0, 3.0])
    np.testing.assert_allclose(limits.jerk, [25, 30, 30])
    np.testing.assert_allclose((limits.lower, limits.upper), [[-1, 0, -1], [2, 2, 2]])
    np.testing.assert_allclose(limits.torque, [9, 5, 9])
    assert limits.assumed_acceleration.tolist() == [False, True, True]
    assert robot.remarks[0] == (
        f"{file} is MoveIt's; of the arm's 3 joints it limits velocity of 2, acceleration of 1, jerk of 1: "
        "the lower limit holds, its or the URDF's. Its default_velocity_scaling_factor 0.1: what MoveIt asks "
        "for by default, no limits, and not used."
    )
    assert robot.content_hash != load_robot(urdf, limits=limits_file(tmp_path, ["joint_1"])).content_hash


def test_limits_of_ours_take_the_place_of_the_urdfs(tmp_path: Path) -> None:
    robot = limited(tmp_path, "joints: {joint_1: {velocity_deg: 180, effort: 20}}")
    np.testing.assert_allclose(robot.limits.velocity, [np.pi, 1.5, 1.5])
    np.testing.assert_allclose(robot.limits.torque, [20, 9, 9])
    for velocity, number in ((2, 1), (20, 0)):
        slow = limited(tmp_path, f"all: {{velocity_deg: {velocity}}}").remarks
        assert sum("look like rad/s" in remark for remark in slow) == number
    with pytest.raises(
        ModelError, match=r"joints.joint_1.velocity_m_s: got that key, expected velocity_deg: this"
    ):
        limited(tmp_path, "joints: {joint_1: {velocity_m_s: 1}}")
    with pytest.raises(ModelError, match=r"joints: got 'joint1', expected a joint of the URDF \(one of: "):
        limited(tmp_path, "joints: {joint1: {velocity_deg: 1}}")


def test_what_an_arm_without_limits_is_assumed_to_do(tmp_path: Path) -> None:
    """An assumed effort holds the arm in any posture twice, also after a joint that slides."""
    blind = LIMIT.replace('"1.5"', '"0"').replace('"9"', '"0"')
    parts = [part.replace(LIMIT, blind) for part in ARM]
    parts[5] = parts[5].replace("revolute", "prismatic")
    robot = load_robot(write(tmp_path, *parts))
    np.testing.assert_allclose(robot.limits.velocity, [1, 0.1, 1])
    assert [remark.partition(" are assumed")[0] for remark in robot.remarks[:4]] == [
        f"{limit} limits of the joints" for limit in ("Velocity", "Acceleration", "Jerk", "Effort")
    ]
    q = np.random.default_rng(3).uniform(robot.limits.lower, robot.limits.upper, (2000, 3))
    held = np.abs(Dynamics(robot).static_efforts(q).joint_torque)
    assert (2 * held <= robot.limits.torque + 1e-9).all()
    assert robot.limits.torque[1] == pytest.approx(2 * 9.81 * 2)
    # All turn: links of 1 kg, sqrt(2) / 10 m apart.
    robot = load_robot(write(tmp_path, *(part.replace(LIMIT, blind) for part in ARM)))
    step = 2 * 9.81 * 0.1 * np.sqrt(2)
    np.testing.assert_allclose(robot.limits.torque, [3 * step, step, 0.01 * 3 * step])


def test_ranges_in_degrees_are_told(tmp_path: Path) -> None:
    degrees = [part.replace('lower="-1" upper="2"', 'lower="-170" upper="170"') for part in ARM]
    with pytest.raises(
        ModelError, match=r"joint\[joint_1\].limit.lower: got -170 rad, expected radians \(degrees"
    ):
        load_robot(write(tmp_path, *degrees))
    turns = [part.replace('lower="-1" upper="2"', 'lower="-18.85" upper="18.85"') for part in ARM]
    assert load_robot(write(tmp_path, *turns)).dof == 3


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("joints: {joint_1: {acceleration_deg: 60}}", "format"),
        ("all: {jerk_m_s3: 2}", "format"),
        ("format: cmbot-joint-limits/2", "format"),
        ('{"format": "cmbot-joint-limits/1", "joint": {}}', "joint"),
        ("\ufeffformat: 'cmbot-scene/1'", "format"),
        ("format: cmbot-joint-limits/1\njoints: [", ""),
    ],
)
def test_limits_of_ours_with_a_mistake_are_refused(tmp_path: Path, text: str, key: str) -> None:
    (tmp_path / "joint_limits.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ModelError) as caught:
        load_robot(write(tmp_path, *ARM))
    assert caught.value.source == str(tmp_path / "joint_limits.yaml")
    assert caught.value.key == key


# Of Franka's there is an effort, too.
@pytest.mark.parametrize("name", sorted(JointEntry.model_fields.keys() - {"effort"}))
def test_every_limit_of_ours_tells_a_file_that_lacks_its_format(tmp_path: Path, name: str) -> None:
    (tmp_path / "joint_limits.yaml").write_text(f"joint_1: {{{name}: 1}}", encoding="utf-8")
    assert robot_files(write(tmp_path, *ARM)).limits is not None


@pytest.mark.parametrize(
    ("place", "robot", "is_it"),
    [
        ("urdf/arm.srdf", "other", True),
        ("srdf/arm.srdf", "other", True),
        ("config/arm.srdf", "other", True),
        ("config/panda_arm.srdf", "arm", True),
        ("config/panda_arm.srdf", "other", False),
        ("elsewhere/arm.srdf", "arm", False),
    ],
)
def test_an_srdf_is_found_where_ros_packages_have_it(
    tmp_path: Path, place: str, robot: str, is_it: bool
) -> None:
    urdf = write(tmp_path / "urdf", *ARM)
    put(tmp_path / place, f'<robot name="{robot}"><disable_collisions link1="base" link2="link_3"/></robot>')
    assert robot_files(urdf).srdf == (tmp_path / place if is_it else None)
    assert load_robot(urdf).dof == 3


MISSING = '<visual><origin xyz="9 9 9"/><geometry><mesh filename="package://nowhere/sticker.dae"/></geometry>'
MISSING += "</visual>"
TURNED = '<origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 1.2"/>'


@pytest.mark.parametrize(
    "shape",
    [
        '<box size="0.1 0.2 0.3"/>',
        '<cylinder radius="0.1" length="0.5"/>',
        '<sphere radius="0.2"/>',
        '<mesh filename="part.obj" scale="0.1 0.2 0.3"/>',
    ],
)
def test_a_missing_visual_mesh_is_a_box_about_the_link(tmp_path: Path, shape: str) -> None:
    """All of the link's collision shape is in it, and it is at most twice as wide."""
    (tmp_path / "part.obj").write_text(TETRAHEDRON, encoding="utf-8")
    body = f"<collision>{TURNED}<geometry>{shape}</geometry></collision>"
    robot = load_robot(
        write(tmp_path, *ARM[:3], f'<link name="link_3">{INERTIA}{body}{MISSING}</link>', *ARM[4:])
    )
    (remark,) = (each for each in robot.remarks if "sticker.dae" in each)
    assert "drawn as boxes: link[link_3].mesh.filename" in remark
    (drawn,) = robot.visual_model.geometryObjects
    (solid,) = (each for each in robot.collision_model.geometryObjects if each.name.startswith("link_3"))
    directions = np.random.default_rng(1).normal(size=(500, 3))
    directions = np.concatenate([directions, np.eye(3), -np.eye(3)])
    X = drawn.placement.inverse() * solid.placement
    reached = np.array([support(solid.geometry, X.rotation.T @ u) + X.translation @ u for u in directions])
    held = np.abs(directions) @ drawn.geometry.halfSide
    assert (reached <= held + 1e-9).all()
    widths = [each[-6:-3] + each[-3:] for each in (held, reached)]
    assert (widths[0] <= 2 * widths[1]).all()


def support(geometry: Any, u: np.ndarray) -> float:
    """How far a shape about its origin reaches along u."""
    if isinstance(geometry, coal.ConvexBase):
        return max(float(geometry.point(i) @ u) for i in range(geometry.num_points))
    if isinstance(geometry, coal.Box):
        return float(np.abs(u) @ geometry.halfSide)
    if isinstance(geometry, coal.Sphere):
        return float(geometry.radius * np.linalg.norm(u))
    across = np.hypot(u[0], u[1]) if isinstance(geometry, coal.Cylinder) else np.linalg.norm(u)
    return float(geometry.halfLength * abs(u[2]) + geometry.radius * across)


def test_a_sticker_that_is_missing_hides_no_other_shape(tmp_path: Path) -> None:
    seen = f"<visual><geometry>{BOX}</geometry></visual>"
    parts = [link("link_3", MISSING + seen), link("bare", MISSING, "")]
    parts[1] = parts[1].replace("<collision><geometry></geometry></collision>", "")
    held = joint("held", "fixed", "link_3", "bare", "")
    robot = load_robot(write(tmp_path, *ARM[:3], *parts, *ARM[4:], held))
    shapes = list(robot.visual_model.geometryObjects)
    # Where a link has neither, there is a small box where the mesh would be.
    np.testing.assert_allclose([2 * each.geometry.halfSide for each in shapes], [[0.02] * 3, [0.05] * 3])
    assert "and 1 other." in " ".join(robot.remarks)


SRDF_CASES = {
    # Its fingers slide.
    "": ("base", "hand"),
    '<group name="g"><chain base_link="link_1" tip_link="link_3"/></group>': ("link_1", "link_3"),
    '<group name="g"><chain base_link="nowhere" tip_link="link_3"/></group>': ("base", "hand"),
    '<end_effector name="e" parent_link="link_2" group="g"/>': ("base", "link_2"),
    # A finger's joint is not the arm's.
    '<group name="g"><joint name="joint_1"/><joint name="joint_2"/><joint name="joint_3"/></group>'
    '<end_effector name="e" parent_link="finger_1" group="g"/>': ("base", "hand"),
    '<group name="g"><chain base_link="link_1" tip_link="link_3"/></group>'
    '<group name="h"><chain base_link="base" tip_link="link_2"/></group>': ("base", "link_2"),
}


@pytest.mark.parametrize("semantics", SRDF_CASES)
def test_frames_are_chosen_where_there_is_one_choice(tmp_path: Path, semantics: str) -> None:
    file = write(tmp_path, *ARM, *GRIPPER)
    (tmp_path / "arm.srdf").write_text(f'<robot name="arm">{semantics}</robot>', encoding="utf-8")
    robot = load_robot(file)
    assert (robot.base_frame, robot.tool_frame) == SRDF_CASES[semantics]
    assert load_robot(file, base_frame="link_1", tool_frame="link_2").joints == ("joint_2",)


def test_several_ends_have_to_be_chosen_from(tmp_path: Path) -> None:
    tools = [
        link("flange"),
        link("camera"),
        joint("f", "fixed", "link_3", "flange", ""),
        joint("c", "fixed", "link_3", "camera", ""),
    ]
    file = write(tmp_path, *ARM, *tools)
    with pytest.raises(
        ModelError, match=r"tool_frame: got nothing, expected the last link of the arm"
    ) as caught:
        load_robot(file)
    assert caught.value.choices == ("flange", "camera")
    replace(file, "flange", "tool0")
    assert load_robot(file).tool_frame == "tool0"
    fork = [link("left"), joint("left_joint", "revolute", "link_2", "left")]
    with pytest.raises(ModelError) as caught:
        load_robot(write(tmp_path, *ARM, *fork))
    assert caught.value.choices == ("link_3", "left")
    sliding = joint("joint_2", "prismatic", "link_1", "link_2")
    robot = load_robot(write(tmp_path, *ARM[:5], sliding, ARM[6]))
    assert (robot.tool_frame, robot.limits.prismatic.tolist()) == ("link_3", [False, True, False])
    # A lift before the arm is told to be locked.
    lifted = load_robot(write(tmp_path, *ARM[:5], sliding, ARM[6]), base_frame="link_2", tool_frame="link_3")
    locked = "joint_2, which slides from -1 to 2 m, is locked at 0 m; robot.locked of a scene says where"
    assert any(remark.startswith(locked) for remark in lifted.remarks)
    assert not any(remark.startswith("joint_2, which slides") for remark in robot.remarks)
    # What slides at the end of a row is a gripper.
    at_the_end = joint("joint_3", "prismatic", "link_2", "link_3")
    assert load_robot(write(tmp_path, *ARM[:6], at_the_end)).tool_frame == "link_2"
