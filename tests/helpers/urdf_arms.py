"""Arms of example-robot-data: where their URDFs are, their limits, and a scene for a Kinova and a Panda."""

import sysconfig
from collections.abc import Iterable
from pathlib import Path

from cmbot.scene import Scene, load_scene

ROBOTS = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share", "example-robot-data", "robots")
PANDA = ROBOTS / "panda_description" / "urdf" / "panda.urdf"
KINOVA = ROBOTS / "kinova_description" / "robots" / "kinova.urdf"
PANDA_JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
KINOVA_JOINTS = tuple(f"j2s6s200_joint_{i}" for i in range(1, 7))
# URDF, joints, base, tool and posture (deg).
_ARMS = {
    "kinova": (KINOVA, KINOVA_JOINTS, "base", "j2s6s200_end_effector", [-85, 167, 57, -119, 82, 75]),
    "panda": (PANDA, PANDA_JOINTS, "panda_link0", "panda_hand", [10, -30, 5, -120, 10, 90, 20]),
}


def limits_file(folder: Path, joints: Iterable[str]) -> Path:
    """A joint-limits file with one acceleration and jerk for all joints."""
    file = folder / "limits.yaml"
    entries = "".join(f"  {name}: {{acceleration_deg: 200, jerk_deg: 1000}}\n" for name in joints)
    file.write_text(f"format: cmbot-joint-limits/1\njoints:\n{entries}", encoding="utf-8")
    return file


def arm_scene(folder: Path, arm: str, keep: str = "pose", knots: str = "sliding", **planner: object) -> Scene:
    """A ``kinova`` or ``panda`` that follows a short leg."""
    urdf, joints, base, tool, posture = _ARMS[arm]
    robot = {
        "model": str(urdf),
        "base_frame": base,
        "tool_frame": tool,
        "limits": str(limits_file(folder, joints)),
        "mount": {"xyz": [0, 0.7, 0.2], "rpy_deg": [0, 0, 0]},
    }
    return load_scene(
        {
            "format": "cmbot-scene/1",
            "name": arm,
            "robot": robot,
            "posture_deg": posture,
            "tool_path": {"legs": [{"by": [0.02, 0.05, -0.06], "seconds": 4}], "via_points": 8, "keep": keep},
            "planner": {"knots": knots, "quiet_modes": 0, **planner},
        }
    )
