"""The robot of a plan as a ROS 2 description package for RViz and MoveIt: URDF, meshes, SRDF, limits."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cmbot.archive.folder import drafted, refusals
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.common.reading.validation import given_path
from cmbot.planning import Plan, require_plan
from cmbot.robot import Robot, RobotFiles, locate_meshes, parse_urdf, robot_files, srdf_text
from cmbot.scene import STOW

_CMAKE = """cmake_minimum_required(VERSION 3.8)
project({name})
find_package(ament_cmake REQUIRED)
install(DIRECTORY urdf meshes config DESTINATION share/${{PROJECT_NAME}})
ament_package()
"""
_ASSUMED = "; some limits are assumed, see config/joint_limits.yaml"
_MANIFEST = """<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.1.0</version>
  <description>Description of the robot {robot}, written by cmbot{assumed}</description>
  <maintainer email="nobody@example.org">nobody</maintainer>
  <license>as of the robot's files</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <exec_depend>robot_state_publisher</exec_depend>
  <exec_depend>xacro</exec_depend>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""


def export_ros_package(plan: Plan, folder: str | Path) -> Path:
    """Write the robot of a plan as a ROS 2 description package, the whole folder or nothing.

    ``urdf/`` has its URDF with meshes by ``package://``, which are in ``meshes/``; ``config/`` its SRDF with
    the group of the arm, the tool as ``end_effector`` and the state ``stow``, and the joint limits that were
    planned with, as MoveIt reads them; those that are assumed are marked.

    Parameters
    ----------
    plan : Plan
    folder : str or Path
        A new folder, such as ``cmbot_description``: its name is that of the package.

    Returns
    -------
    Path
        Of the folder.

    Raises
    ------
    InputError
        When `plan` is none.
    ModelError
        When a file of the robot cannot be read.
    ArchiveError
        When the folder is there already, its name is none of a package, or the system refuses.
    """
    require_plan(plan, "cmbot.export_ros_package")
    target = given_path(folder, "cmbot.export_ros_package", "folder", "the path of a new folder").resolve()
    if not re.fullmatch(r"[a-z][a-z0-9_]+", target.name):
        expected = "a package's name: small letters, digits and _, such as cmbot_description"
        raise ArchiveError(str(target), "", "another name of a folder", expected)
    if target.exists():
        raise ArchiveError(str(target), "", "something that is already there", "the path of a new folder")
    source, robot = plan.scene.robot, plan.robot
    given = source.files
    described = robot_files(**{key: given[key] for key in ("model", "srdf", "package_dirs", "xacro")})
    name, urdf = target.name, described.read()[1]
    if robot.description:
        urdf = ElementTree.fromstring(robot.description)
    locate_meshes(described.urdf, urdf, described.package_dirs)
    meshes = _moved_meshes(urdf, name)
    texts = {
        "package.xml": _MANIFEST.format(
            name=name, robot=re.sub(r"[<&>]", "_", robot.name), assumed=_ASSUMED if _assumes(robot) else ""
        ),
        "CMakeLists.txt": _CMAKE.format(name=name),
        "urdf/robot.urdf": _text(urdf),
        "config/robot.srdf": _text(_semantics(plan, described)),
        "config/joint_limits.yaml": _limits(robot),
    }
    with refusals(target), drafted(target) as draft:
        for part in ("urdf", "meshes", "config"):
            (draft / part).mkdir()
        for file, text in texts.items():
            (draft / file).write_text(text, encoding="utf-8")
        for path, file in meshes.items():
            shutil.copyfile(path, draft / "meshes" / file)
    return target


def _moved_meshes(urdf: ElementTree.Element, package: str) -> dict[str, str]:
    """Name the meshes of a URDF by the package, in place; where they are now and their files there."""
    moved: dict[str, str] = {}
    for mesh in urdf.iter("mesh"):
        path = mesh.get("filename", "")
        if path not in moved:
            stem, suffix, taken = Path(path).stem, Path(path).suffix, moved.values()
            # Another file may have that name.
            numbers = ("", *(f"_{number}" for number in range(2, len(moved) + 2)))
            names = (f"{stem}{number}{suffix}" for number in numbers)
            moved[path] = next(name for name in names if name not in taken)
        mesh.set("filename", f"package://{package}/meshes/{moved[path]}")
    return moved


def _semantics(plan: Plan, files: RobotFiles) -> ElementTree.Element:
    """Return the robot's SRDF with its arm, the tool, and the posture in which it is put away."""
    robot = plan.robot
    if files.srdf is None:
        srdf = ElementTree.fromstring(srdf_text(files))
    else:
        srdf = parse_urdf(files.srdf, "an SRDF", files.package_dirs)
    arms = [
        group.get("name", "")
        for group in srdf.findall("group")
        for chain in group.findall("chain")
        if chain.get("tip_link") == robot.tool_frame
    ]
    arm = arms[0] if arms else "cmbot_arm"
    if not arms:
        group = ElementTree.SubElement(srdf, "group", name=arm)
        ElementTree.SubElement(group, "chain", base_link=robot.base_frame, tip_link=robot.tool_frame)
    if not srdf.findall("end_effector"):
        group = ElementTree.SubElement(srdf, "group", name="cmbot_tool")
        ElementTree.SubElement(group, "link", name=robot.tool_frame)
        tool = {"name": "tool", "parent_link": robot.tool_frame, "group": "cmbot_tool", "parent_group": arm}
        ElementTree.SubElement(srdf, "end_effector", tool)
    if all(state.get("name") != STOW for state in srdf.findall("group_state")):
        away = robot.group_states.get(STOW, plan.scene.posture)
        state = ElementTree.SubElement(srdf, "group_state", name=STOW, group=arm)
        for joint, value in zip(robot.joints, away, strict=True):
            ElementTree.SubElement(state, "joint", name=joint, value=repr(float(value)))
    return srdf


def _assumes(robot: Robot) -> bool:
    limits = robot.limits
    assumed = (limits.assumed_velocity, limits.assumed_acceleration, limits.assumed_jerk)
    return bool(np.any(assumed))


def _limits(robot: Robot) -> str:
    """Return the joints' limits, SI, as MoveIt reads them; comments say which are assumed."""
    limits = robot.limits
    lines = ["# What the motion was planned with, rad and s, of joints that slide m and s."]
    if _assumes(robot):
        lines.append("# assumed: no data of the robot's maker; its joint-limits file lacks it, or says so.")
    lines.append("joint_limits:")
    bounds: Mapping[str, tuple[FloatArray, BoolArray]] = {
        "velocity": (limits.velocity, limits.assumed_velocity),
        "acceleration": (limits.acceleration, limits.assumed_acceleration),
        "jerk": (limits.jerk, limits.assumed_jerk),
    }
    for i, joint in enumerate(robot.joints):
        lines.append(f"  {joint}:")
        for kind, (values, assumed) in bounds.items():
            lines.append(f"    has_{kind}_limits: true")
            lines.append(f"    max_{kind}: {_number(values[i])}{'  # assumed' if assumed[i] else ''}")
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """A number with six significant digits and a point, which ROS and YAML 1.1 need to read it as one."""
    return np.format_float_positional(value, precision=6, fractional=False, trim="0")


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
