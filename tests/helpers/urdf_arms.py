"""Arms that are not ours: their URDFs, their limits, and scenes in which they follow a short path."""

import sysconfig
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cmbot.common.robot_library import library_robots
from cmbot.scene import Scene, load_scene

ROBOTS = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share", "example-robot-data", "robots")
PANDA = ROBOTS / "panda_description" / "urdf" / "panda.urdf"
KINOVA = ROBOTS / "kinova_description" / "robots" / "kinova.urdf"
PANDA_JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
KINOVA_JOINTS = tuple(f"j2s6s200_joint_{i}" for i in range(1, 7))
_UR_JOINTS = tuple(
    f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
_UR = ROBOTS / "ur_description" / "urdf"
# URDF, base, tool and joints.
_ARMS = {
    "kinova": (KINOVA, "base", "j2s6s200_end_effector", KINOVA_JOINTS),
    "panda": (PANDA, "panda_link0", "panda_hand", PANDA_JOINTS),
    "ur3": (_UR / "ur3_robot.urdf", "base_link", "tool0", _UR_JOINTS),
    "ur5": (_UR / "ur5_robot.urdf", "base_link", "tool0", _UR_JOINTS),
    "z1": (
        ROBOTS / "z1_description" / "urdf" / "z1.urdf",
        "link00",
        "link06",
        tuple(f"joint{i}" for i in range(1, 7)),
    ),
}
# Links that may touch each other.
_UR_LINKS = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3", "ee")
_UR_NEAR = [
    (f"{one}_link", f"{other}_link")
    for one, other in (
        *pairwise(_UR_LINKS),
        ("base", "upper_arm"),
        ("forearm", "wrist_2"),
        ("wrist_1", "wrist_3"),
        ("wrist_2", "ee"),
    )
]
_NEAR = {
    "ur3": _UR_NEAR,
    "ur5": _UR_NEAR,
    "z1": [
        *pairwise(("link00", "link02", "link03", "link04", "link06", "gripperStator", "gripperMover")),
        ("link06", "gripperMover"),
    ],
}
_UPRIGHT = {"xyz": [0, 0.7, 0.2], "rpy_deg": [0, 0, 0]}
_TURNED = {"xyz": [0, 0.3, 0.4], "rpy_deg": [0, 0, 90]}
# Of the arm with endless joints, like a Kinova Gen3's: axis, range (deg; 0: endless), distance of the next
# joint along z (m) and mass (kg) of each joint's link.
_ENDLESS = (
    ("0 0 1", 0, 0.13, 1.4),
    ("0 1 0", 128, 0.21, 1.2),
    ("0 0 1", 0, 0.21, 1.2),
    ("0 1 0", 147, 0.21, 0.9),
    ("0 0 1", 0, 0.11, 0.7),
    ("0 1 0", 120, 0.11, 0.7),
    ("0 0 1", 0, 0.06, 0.4),
)


def only_collision(name: str, folder: Path, links: tuple[str, ...] = ()) -> Path:
    """A copy of a robot's URDF that loads sooner: the collision shapes alone, of all links or of some."""
    urdf = (library_robots() or {})[name]
    root = ElementTree.parse(urdf).getroot()
    for link in root.findall("link"):
        left_out = bool(links) and not link.get("name", "").startswith(links)
        for part in (*link.findall("visual"), *(link.findall("collision") if left_out else ())):
            link.remove(part)
    file = folder / f"{name}.urdf"
    ElementTree.ElementTree(root).write(file)
    return file


def limits_file(folder: Path, joints: Iterable[str]) -> Path:
    """A joint-limits file with one acceleration and jerk for all joints."""
    file = folder / "limits.yaml"
    entries = "".join(f"  {name}: {{acceleration_deg: 200, jerk_deg: 1000}}\n" for name in joints)
    file.write_text(f"format: cmbot-joint-limits/1\njoints:\n{entries}", encoding="utf-8")
    return file


def scene_data(
    folder: Path,
    arm: str,
    posture: list[float],
    tool_path: dict[str, Any],
    mount: dict[str, Any] = _UPRIGHT,
    **planner: Any,
) -> dict[str, Any]:
    """The content of a scene in which an arm follows a path."""
    if arm == "endless":
        urdf, base, tool = folder / "endless.urdf", "base", "tool"
        joints = tuple(f"joint_{i}" for i in range(1, 8))
        urdf.write_text(_endless_urdf(), encoding="utf-8")
    else:
        urdf, base, tool, joints = _ARMS[arm]
    robot = {"model": str(urdf), "base_frame": base, "tool_frame": tool, "mount": mount}
    robot["limits"] = str(limits_file(folder, joints))
    if arm in _NEAR:
        pairs = "".join(f'<disable_collisions link1="{one}" link2="{other}"/>' for one, other in _NEAR[arm])
        (folder / "near.srdf").write_text(f'<robot name="near">{pairs}</robot>', encoding="utf-8")
        robot["srdf"] = str(folder / "near.srdf")
    return {
        "format": "cmbot-scene/2",
        "name": arm,
        "robot": robot,
        "start": {"posture_deg": posture},
        "tool_path": tool_path,
        "planner": {"compensate": False, **planner},
    }


def path_of(keep: str, via_points: int, *legs: tuple[list[float], float]) -> dict[str, Any]:
    """A tool path of legs, m, with their seconds."""
    each = [{"by": by, "seconds": seconds} for by, seconds in legs]
    return {
        "legs": each,
        "speed_profile": {"kind": "trapezoidal"},
        "via_points": via_points,
        "keep": keep,
    }


def six_joint_scene(
    folder: Path, arm: str, posture: list[float], tool_path: dict[str, Any], **planner: Any
) -> Scene:
    """A ``ur3``, ``ur5`` or ``z1`` that follows a path."""
    return load_scene(scene_data(folder, arm, posture, tool_path, **planner))


def arm_scene(folder: Path, arm: str, keep: str = "pose", knots: str = "sliding", **planner: Any) -> Scene:
    """A ``kinova`` or ``panda`` that follows a short leg."""
    posture = {"kinova": [-85, 167, 57, -119, 82, 75], "panda": [10, -30, 5, -120, 10, 90, 20]}[arm]
    path = path_of(keep, 8, ([0.02, 0.05, -0.06], 4.0))
    return load_scene(scene_data(folder, arm, posture, path, **{"knots": knots, **planner}))


def panda_scene(folder: Path, **tool_path: Any) -> Scene:
    """A Panda that follows a short leg downwards."""
    path = path_of("pose", 8, ([0.0, 0.0, -0.1], 4.0)) | tool_path
    return load_scene(scene_data(folder, "panda", [0, -30, 0, -110, 0, 90, 45], path, _TURNED))


def endless_scene(folder: Path, **tool_path: Any) -> Scene:
    """An arm with four endless joints that follows a short leg."""
    path = path_of("pose", 8, ([0.0, 0.1, 0.05], 4.0)) | tool_path
    return load_scene(scene_data(folder, "endless", [10, 40, 20, 80, -15, 60, 0], path, _TURNED))


def _endless_urdf() -> str:
    parts = ['<robot name="endless">', _link("base", 0.1, 2.0)]
    parent, height = "base", 0.15
    for number, (axis, bound, length, mass) in enumerate(_ENDLESS, start=1):
        kind = "revolute" if bound else "continuous"
        limit = f'lower="{-np.radians(bound)}" upper="{np.radians(bound)}"' if bound else ""
        parts.append(_link(f"link_{number}", length, mass))
        parts.append(
            f'<joint name="joint_{number}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="link_{number}"/><origin xyz="0 0 {height}"/><axis xyz="{axis}"/>'
            f'<limit {limit} velocity="1.2" effort="60"/></joint>'
        )
        parent, height = f"link_{number}", length
    parts.append(
        f'<link name="tool"/><joint name="flange" type="fixed"><parent link="{parent}"/>'
        f'<child link="tool"/><origin xyz="0 0 {height}"/></joint></robot>'
    )
    return "\n".join(parts)


def _link(name: str, length: float, mass: float) -> str:
    across = mass * (3 * 0.04**2 + length**2) / 12
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {length / 2}"/><mass value="{mass}"/>'
        f'<inertia ixx="{across}" iyy="{across}" izz="{mass * 0.04**2 / 2}" ixy="0" ixz="0" iyz="0"/>'
        "</inertial>"
        f'<collision><origin xyz="0 0 {length / 2}"/>'
        f'<geometry><cylinder radius="0.04" length="{length}"/></geometry></collision></link>'
    )
