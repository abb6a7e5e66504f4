"""The robot as a ROS package: other code reads it, and it is the robot that was planned with."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from command_line import output, refusal
from ruamel.yaml import YAML

from cmbot.archive import export_ros_package
from cmbot.common.errors import ArchiveError
from cmbot.common.installation import model_folder
from cmbot.planning import Plan, robot_of
from cmbot.robot import load_robot
from cmbot.scene import load_scene


@pytest.fixture(scope="module")
def package(short_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_ros_package(short_plan, tmp_path_factory.mktemp("ros") / "cmbot_description")


def test_the_urdf_finds_its_meshes_by_the_package(package: Path, short_plan: Plan) -> None:
    urdf = package / "urdf" / "robot.urdf"
    names = [mesh.get("filename") for mesh in ElementTree.parse(urdf).iter("mesh")]
    assert names
    for name in names:
        scheme, _, rest = name.partition("://")
        assert scheme == "package" and (package.parent / rest).is_file()
    described = ElementTree.parse(short_plan.robot.urdf)
    wanted = [short_plan.robot.urdf.parent / str(mesh.get("filename")) for mesh in described.iter("mesh")]
    for name, file in zip(names, wanted, strict=True):
        assert (package.parent / name.partition("://")[2]).read_bytes() == file.read_bytes()
    # Each file is there once.
    assert len(list((package / "meshes").iterdir())) == len(set(wanted))
    # pinocchio resolves them as RViz does, from the folder above the package.
    drawn = pin.buildGeomFromUrdf(
        pin.buildModelFromUrdf(str(urdf)), str(urdf), pin.VISUAL, package_dirs=str(package.parent)
    )
    assert drawn.ngeoms >= len(names)
    robot = load_robot(
        urdf, srdf=package / "config" / "robot.srdf", base_frame="arm_base", tool_frame="tool0"
    )
    assert robot.joints == short_plan.robot.joints


def test_the_srdf_names_arm_tool_and_stow(package: Path, short_plan: Plan) -> None:
    srdf = ElementTree.parse(package / "config" / "robot.srdf").getroot()
    (tool,) = srdf.findall("end_effector")
    groups = {group.get("name") for group in srdf.findall("group")}
    assert {tool.get("group"), tool.get("parent_group")} <= groups
    assert (tool.get("parent_link"), tool.get("parent_group")) == ("tool0", "arm")
    (stow,) = (state for state in srdf.findall("group_state") if state.get("name") == "stow")
    values = [float(joint.get("value")) for joint in stow]
    np.testing.assert_allclose(values, short_plan.robot.group_states["stow"])


def test_meshes_of_the_same_name_and_an_arm_without_an_srdf(
    short_plan: Plan, tmp_path: Path, bare_urdf: str
) -> None:
    """Two links share a mesh, a third has another one of the same name; the SRDF is made from the arm."""
    text, size = bare_urdf, (model_folder() / "meshes").rglob("*")
    mesh = next(path for path in size if path.suffix in (".stl", ".obj", ".dae"))
    for place in ("one", "two"):
        (tmp_path / place).mkdir()
        (tmp_path / place / f"part{mesh.suffix}").write_bytes(mesh.read_bytes())
    for place in ("one", "one", "two"):
        drawn = f'<visual><geometry><mesh filename="{place}/part{mesh.suffix}"/></geometry></visual>'
        text = re.sub(r"(<link name=\"[a-z_0-9]+\">)(?!<visual>)", rf"\1{drawn}", text, count=1)
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    source = short_plan.scene.robot.changed(model=tmp_path / "arm.urdf")
    plan = replace(short_plan, scene=short_plan.scene.changed(robot=source))
    package = export_ros_package(plan, tmp_path / "arm_description")
    assert {path.name for path in (package / "meshes").iterdir()} == {
        f"part{mesh.suffix}",
        f"part_2{mesh.suffix}",
    }
    srdf = ElementTree.parse(package / "config" / "robot.srdf").getroot()
    (group,) = (each for each in srdf.findall("group") if each.find("chain") is not None)
    chain = group.find("chain")
    assert chain is not None
    assert (chain.get("base_link"), chain.get("tip_link")) == ("arm_base", "tool0")
    assert [pair.get("reason") for pair in srdf.findall("disable_collisions")]


def test_a_tool_that_is_added_is_in_the_package(short_plan: Plan, urdf_folder: Path, tmp_path: Path) -> None:
    """The SRDF has an end effector already, which stays the only one."""
    srdf = urdf_folder / "cmbot.srdf"
    gun = '<end_effector name="gun" parent_link="tool0" group="climber"/></robot>'
    srdf.write_text(srdf.read_text(encoding="utf-8").replace("</robot>", gun), encoding="utf-8")
    frames = {"base_frame": "arm_base", "tool_frame": "tool0", "limits": urdf_folder / "joint_limits.yaml"}
    tool = {"xyz": [0, 0, 0.2], "mass_kg": 0.5}
    data = short_plan.scene.as_data()
    data["robot"] = {"model": str(urdf_folder / "cmbot.urdf"), "srdf": str(srdf), "tool": tool}
    data["robot"] |= {name: str(value) for name, value in frames.items()}
    scene = load_scene(data)
    robot = robot_of(scene)
    package = export_ros_package(replace(short_plan, scene=scene, robot=robot), tmp_path / "gun_description")
    urdf, semantics = package / "urdf" / "robot.urdf", package / "config" / "robot.srdf"
    (effector,) = ElementTree.parse(semantics).getroot().findall("end_effector")
    assert effector.get("name") == "gun"
    model = pin.buildModelFromUrdf(str(urdf))
    assert pin.computeTotalMass(model) == pytest.approx(
        0.5 + pin.computeTotalMass(pin.buildModelFromUrdf(str(urdf_folder / "cmbot.urdf")))
    )
    tip = model.frames[model.getFrameId(robot.tool_frame)].placement
    flange = model.frames[model.getFrameId("tool0")].placement
    np.testing.assert_allclose((flange.inverse() * tip).translation, tool["xyz"], atol=1e-12)


def test_it_says_which_limits_are_assumed(package: Path, short_plan: Plan, tmp_path: Path) -> None:
    known = (package / "config" / "joint_limits.yaml").read_text(encoding="utf-8")
    assert "assumed" not in known + (package / "package.xml").read_text(encoding="utf-8")
    limits = short_plan.robot.limits
    some = np.arange(7) % 2 == 1
    robot = replace(short_plan.robot, limits=replace(limits, assumed_jerk=some))
    other = export_ros_package(replace(short_plan, robot=robot), tmp_path / "assumed_description")
    lines = (other / "config" / "joint_limits.yaml").read_text(encoding="utf-8").splitlines()
    jerks = [line for line in lines if "max_jerk" in line]
    assert [line.endswith("  # assumed") for line in jerks] == some.tolist()
    assert not any("assumed" in line for line in lines if "max_acceleration" in line)
    for line in lines:
        if "max_" in line:
            digits = line.split("#")[0].split(":")[1].strip()
            assert "." in digits and len(digits.replace(".", "").strip("0")) <= 6
    assert "limits are assumed" in (other / "package.xml").read_text(encoding="utf-8")


def test_limits_and_manifest(package: Path, short_plan: Plan) -> None:
    limits = YAML(typ="safe").load(package / "config" / "joint_limits.yaml")["joint_limits"]
    assert list(limits) == list(short_plan.robot.joints)
    found = [limits[joint]["max_acceleration"] for joint in limits]
    np.testing.assert_allclose(found, short_plan.robot.limits.acceleration, rtol=1e-5)
    manifest = ElementTree.parse(package / "package.xml").getroot()
    assert manifest.findtext("name") == package.name
    assert "project(cmbot_description)" in (package / "CMakeLists.txt").read_text(encoding="utf-8")


def test_what_is_refused(package: Path, short_plan: Plan, saved_short: Path, tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match="already there"):
        export_ros_package(short_plan, package)
    assert "a package's name" in refusal("export", saved_short, "--ros-package", tmp_path / "My-Robot")
    assert "expected --csv, --ros, --mcap or --ros-package" in refusal("export", saved_short)
    folder = tmp_path / "arm_description"
    assert output("export", saved_short, "--ros-package", folder) == f"Written to {folder}.\n"
    assert [path.name for path in tmp_path.iterdir()] == ["arm_description"]
