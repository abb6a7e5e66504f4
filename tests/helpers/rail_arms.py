"""Arms with joints that slide: one on a rail, with a link that is drawn out; the shipped one on a rail."""

from pathlib import Path
from typing import Any

from robot_files import replace
from urdf_arms import path_of

from cmbot.robot import Robot, load_robot
from cmbot.scene import Scene, load_scene

# Of the arm on a rail: name, kind, place in the link before (m), axis, range (rad, m), velocity (1/s), effort
# (Nm, N), length of the link along x (m) and mass (kg).
_JOINTS = (
    ("rail", "prismatic", "0.1 0 0.1", "0 1 0", (-0.5, 0.7), 0.4, 900, 0.05, 6.0),
    ("pan", "revolute", "0 0 0.15", "0 0 1", (-2.9, 2.9), 1.2, 200, 0.1, 4.0),
    ("tilt", "revolute", "0 0 0.2", "0 1 0", (-1.5, 1.5), 1.0, 200, 0.35, 3.0),
    # Drawn out along an axis that is none of its frame's.
    ("draw", "prismatic", "0.3 0 0", "3 0 0.6", (0.0, 0.35), 0.3, 400, 0.3, 1.5),
    ("roll", "revolute", "0.28 0 0", "1 0 0", (-2.9, 2.9), 1.5, 60, 0.12, 1.0),
    ("bend", "revolute", "0.12 0 0", "0 1 0", (-1.9, 1.9), 1.5, 60, 0.1, 0.7),
    ("twist", "continuous", "0.1 0 0", "1 0 0", None, 1.5, 30, 0.08, 0.4),
)
RAIL_JOINTS = tuple(joint[0] for joint in _JOINTS)
# In rad and m.
POSTURE = (0.1, 0.2, 0.25, 0.1, 0.3, 0.8, -0.2)


def rail_urdf() -> str:
    """The URDF of an arm of seven joints, of which two slide."""
    parts = ['<robot name="rail">', _link("base", 0.3, 5.0)]
    parent = "base"
    for name, kind, xyz, axis, ends, velocity, effort, length, mass in _JOINTS:
        limit = "" if ends is None else f'lower="{ends[0]}" upper="{ends[1]}" '
        parts.append(_link(f"{name}_link", length, mass))
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>'
            f'<limit {limit}velocity="{velocity}" effort="{effort}"/></joint>'
        )
        parent = f"{name}_link"
    # The tool's axis is its z axis, along the last link.
    parts.append(
        '<link name="tool"/><joint name="flange" type="fixed"><parent link="twist_link"/>'
        '<child link="tool"/><origin xyz="0.1 0 0" rpy="0 1.5707963267948966 0"/></joint></robot>'
    )
    return "\n".join(parts)


def rail_data(folder: Path, posture: dict[str, Any] | None = None, **planner: Any) -> dict[str, Any]:
    """The content of a scene in which that arm follows a short path beside a post."""
    (folder / "rail.urdf").write_text(rail_urdf(), encoding="utf-8")
    limits = "format: cmbot-joint-limits/1\nall: {acceleration_deg: 200, jerk_deg: 1000, jerk_m_s3: 8}\n"
    (folder / "limits.yaml").write_text(
        f"{limits}joints: {{draw: {{acceleration_m_s2: 0.5, jerk_m_s3: 5}}}}\n", encoding="utf-8"
    )
    mount = {"xyz": [0, 0.3, 0.4], "rpy_deg": [0, 0, 90]}
    return {
        "format": "cmbot-scene/2",
        "name": "rail",
        "robot": {
            "model": str(folder / "rail.urdf"),
            "base_frame": "base",
            "tool_frame": "tool",
            "limits": str(folder / "limits.yaml"),
            "mount": mount,
        },
        **({"start": {"posture": list(POSTURE)}} if posture is None else posture),
        "tool_path": path_of("pose", 8, ([0.1, 0.0, -0.06], 4.0)),
        "obstacles": [{"name": "post", "box": [0.1, 0.1, 1.0], "xyz": [0.55, 0.75, 0.5]}],
        "planner": {"compensate": False, **planner},
    }


def rail_scene(folder: Path, **planner: Any) -> Scene:
    """That scene."""
    return load_scene(rail_data(folder, **planner))


def shipped_arm_on_rail(folder: Path) -> Robot:
    """The shipped arm, whose base slides along x of W: of the copy of its files in a folder."""
    fixed = '<joint name="arm_base_joint" type="fixed">'
    limit = '<axis xyz="1 0 0"/><limit lower="-1" upper="2" velocity="0.5" effort="2000"/>'
    replace(folder / "cmbot.urdf", fixed, f"{fixed.replace('fixed', 'prismatic')}{limit}")
    return load_robot(folder / "cmbot.urdf", base_frame="leg_1", tool_frame="tool0")


def _link(name: str, length: float, mass: float) -> str:
    across = mass * (3 * 0.04**2 + length**2) / 12
    return (
        f'<link name="{name}"><inertial><origin xyz="{length / 2} 0 0"/><mass value="{mass}"/>'
        f'<inertia ixx="{mass * 0.04**2 / 2}" iyy="{across}" izz="{across}" ixy="0" ixz="0" iyz="0"/>'
        "</inertial>"
        f'<collision><origin xyz="{length / 2} 0 0"/>'
        f'<geometry><box size="{length} 0.06 0.06"/></geometry></collision></link>'
    )
