"""The arms of the suite: where their URDFs lie, and what bounds each."""

from __future__ import annotations

import sysconfig
from dataclasses import dataclass
from pathlib import Path

from cmbot.common.installation import model_folder

__all__ = ["ARMS", "Arm", "arm_named"]

_SHARE = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share").resolve()
_ROBOTS = "example-robot-data/robots"


@dataclass(frozen=True, kw_only=True)
class Arm:
    """An arm of revolute joints.

    Attributes
    ----------
    name : str
    urdf : Path
    base, tool : str
        Links that bound it.
    joints : int
    """

    name: str
    urdf: Path
    base: str
    tool: str
    joints: int

    @property
    def packages(self) -> Path:
        """Folder below which ``package://`` paths of its meshes lie."""
        return _SHARE


def _arm(name: str, urdf: str, base: str, tool: str, joints: int) -> Arm:
    return Arm(name=name, urdf=_SHARE / _ROBOTS / urdf, base=base, tool=tool, joints=joints)


ARMS = (
    Arm(
        name="cmbot",
        urdf=model_folder() / "urdf" / "cmbot.urdf",
        base="arm_base",
        tool="tool0",
        joints=7,
    ),
    _arm("panda", "panda_description/urdf/panda.urdf", "panda_link0", "panda_hand_tcp", 7),
    _arm("ur3", "ur_description/urdf/ur3_robot.urdf", "base_link", "tool0", 6),
    _arm("xarm7", "xarm_description/urdf/xarm7.urdf", "link_base", "link_eef", 7),
    _arm("kinova", "kinova_description/robots/kinova.urdf", "base", "j2s6s200_end_effector", 6),
    _arm("tiago", "tiago_description/robots/tiago_no_hand.urdf", "torso_lift_link", "arm_tool_link", 7),
    _arm("z1", "z1_description/urdf/z1.urdf", "link00", "link06", 6),
    _arm("baxter", "baxter_description/urdf/baxter.urdf", "left_arm_mount", "left_gripper", 7),
    _arm("ur5", "ur_description/urdf/ur5_robot.urdf", "base_link", "tool0", 6),
    _arm("talos", "talos_data/robots/talos_reduced.urdf", "torso_2_link", "gripper_left_base_link", 7),
    _arm("pr2", "pr2_description/urdf/pr2.urdf", "torso_lift_link", "l_gripper_tool_frame", 7),
    _arm("ur10", "ur_description/urdf/ur10_robot.urdf", "base_link", "tool0", 6),
    _arm(
        "tiago_pro",
        "tiago_pro_description/robots/tiago_pro.urdf",
        "torso_lift_link",
        "arm_left_tool_link",
        7,
    ),
    _arm("romeo", "romeo_description/urdf/romeo.urdf", "torso", "l_wrist", 7),
    _arm("g1", "g1_description/urdf/g1_29dof_rev_1_0.urdf", "torso_link", "left_rubber_hand", 7),
    _arm("alex", "alex_description/urdf/alex_nub_hands.urdf", "Torso", "leftNub", 7),
    _arm("icub", "icub_description/robots/icub.urdf", "chest", "l_gripper", 7),
    _arm("so101", "so_arm_description/urdf/so101.urdf", "base_link", "gripper_frame_link", 5),
)
"""In an order in which the first few already differ in make and joints."""


def arm_named(name: str) -> Arm:
    """Return the arm of a name."""
    return next(arm for arm in ARMS if arm.name == name)
