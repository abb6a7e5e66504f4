"""Arms of six joints that are not ours: a UR5, a UR3 and a Z1."""

from itertools import pairwise
from pathlib import Path
from typing import Any

from urdf_arms import ROBOTS, limits_file

from cmbot.scene import Scene, load_scene

_UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
_UR_LINKS = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3", "ee")
_UR_NEAR = [
    *pairwise(_UR_LINKS),
    ("base", "upper_arm"),
    ("forearm", "wrist_2"),
    ("wrist_1", "wrist_3"),
    ("wrist_2", "ee"),
]
_Z1_NEAR = [
    ("link00", "link02"),
    ("link02", "link03"),
    ("link03", "link04"),
    ("link04", "link06"),
    ("link06", "gripperStator"),
    ("link06", "gripperMover"),
    ("gripperStator", "gripperMover"),
]


def ur_scene(
    folder: Path, arm: str, posture: list[float], tool_path: dict[str, Any], **planner: Any
) -> Scene:
    """A ``ur3`` or ``ur5`` that follows a path."""
    files = {
        "model": str(ROBOTS / "ur_description" / "urdf" / f"{arm}_robot.urdf"),
        "base_frame": "base_link",
        "tool_frame": "tool0",
    }
    joints = [f"{name}_joint" for name in _UR_JOINTS]
    near = [(f"{one}_link", f"{other}_link") for one, other in _UR_NEAR]
    return _scene(folder, files, joints, near, posture, tool_path, planner)


def z1_scene(folder: Path, posture: list[float], tool_path: dict[str, Any], **planner: Any) -> Scene:
    """A Z1 that follows a path."""
    files = {
        "model": str(ROBOTS / "z1_description" / "urdf" / "z1.urdf"),
        "base_frame": "link00",
        "tool_frame": "link06",
    }
    return _scene(folder, files, [f"joint{i}" for i in range(1, 7)], _Z1_NEAR, posture, tool_path, planner)


def _scene(
    folder: Path,
    files: dict[str, str],
    joints: list[str],
    near: list[tuple[str, str]],
    posture: list[float],
    tool_path: dict[str, Any],
    planner: dict[str, Any],
) -> Scene:
    srdf = folder / "near.srdf"
    pairs = "".join(f'<disable_collisions link1="{one}" link2="{other}"/>' for one, other in near)
    srdf.write_text(f'<robot name="near">{pairs}</robot>', encoding="utf-8")
    mount = {"xyz": [0, 0.7, 0.2], "rpy_deg": [0, 0, 0]}
    return load_scene(
        {
            "format": "cmbot-scene/1",
            "name": "six",
            "robot": {**files, "limits": str(limits_file(folder, joints)), "srdf": str(srdf), "mount": mount},
            "posture_deg": posture,
            "tool_path": tool_path,
            "planner": {"quiet_modes": 0, **planner},
        }
    )
