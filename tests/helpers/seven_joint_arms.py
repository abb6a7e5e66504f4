"""Arms of seven joints that are not ours: a Panda, and one with endless joints like a Kinova Gen3's."""

from pathlib import Path
from typing import Any

import numpy as np
from urdf_arms import PANDA, PANDA_JOINTS, limits_file

from cmbot.scene import Scene, load_scene

PANDA_POSTURE = [0, -30, 0, -110, 0, 90, 45]
ENDLESS_POSTURE = [10, 40, 20, 80, -15, 60, 0]
# Axis, range (deg; 0: endless), distance of the next joint along z (m) and mass (kg) of each joint's link.
_JOINTS = (
    ("0 0 1", 0, 0.13, 1.4),
    ("0 1 0", 128, 0.21, 1.2),
    ("0 0 1", 0, 0.21, 1.2),
    ("0 1 0", 147, 0.21, 0.9),
    ("0 0 1", 0, 0.11, 0.7),
    ("0 1 0", 120, 0.11, 0.7),
    ("0 0 1", 0, 0.06, 0.4),
)


def panda_scene(folder: Path, **tool_path: Any) -> Scene:
    """A Panda that follows a short leg."""
    files = {"model": str(PANDA), "base_frame": "panda_link0", "tool_frame": "panda_hand"}
    return _scene(folder, PANDA_JOINTS, files, PANDA_POSTURE, [0.0, 0.0, -0.1], tool_path)


def endless_scene(folder: Path, **tool_path: Any) -> Scene:
    """An arm with four endless joints that follows a short leg."""
    urdf = folder / "endless.urdf"
    urdf.write_text(_urdf(), encoding="utf-8")
    names = tuple(f"joint_{i}" for i in range(1, 8))
    files = {"model": str(urdf), "base_frame": "base", "tool_frame": "tool"}
    return _scene(folder, names, files, ENDLESS_POSTURE, [0.0, 0.1, 0.05], tool_path)


def _scene(
    folder: Path,
    joints: tuple[str, ...],
    files: dict[str, str],
    posture: list[int],
    by: list[float],
    tool_path: dict[str, Any],
) -> Scene:
    return load_scene(
        {
            "format": "cmbot-scene/1",
            "name": "other",
            "robot": {
                **files,
                "limits": str(limits_file(folder, joints)),
                "mount": {"xyz": [0, 0.3, 0.4], "rpy_deg": [0, 0, 90]},
            },
            "posture_deg": posture,
            "tool_path": {"legs": [{"by": by, "seconds": 4}], "via_points": 8, **tool_path},
        }
    )


def _urdf() -> str:
    parts = ['<robot name="endless">', _link("base", 0.1, 2.0)]
    parent, height = "base", 0.15
    for number, (axis, bound, length, mass) in enumerate(_JOINTS, start=1):
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
