"""The shipped robot as it climbs: one foot holds, the climbing joints move, the arm is locked."""

from __future__ import annotations

from typing import Literal

from cmbot.common.arrays import FloatArray
from cmbot.common.installation import model_folder
from cmbot.robot.loading import load_robot
from cmbot.robot.robot import Robot

__all__ = ["ARM_JOINTS", "Side", "load_climbing_robot"]

ARM_JOINTS = tuple(f"joint_{number}" for number in range(1, 8))
Side = Literal[1, 2]
"""Number of a foot."""


def load_climbing_robot(
    foot: Side, root: FloatArray, arm: FloatArray, *, tool_length: float | None = None, payload: float = 0.0
) -> Robot:
    """Load the shipped robot on one foot, with its five climbing joints as the joints that move.

    Parameters
    ----------
    foot : int
        The foot that holds. On foot 2 the joints are in the other order, ``climb_5`` first.
    root : (4, 4)
        Pose of that foot in W.
    arm : (7,), rad
        Posture in which the arm is locked.
    tool_length, payload : float, optional
        As in `load_robot`; both are the arm's. The tool of this robot is the other foot.
    """
    folder = model_folder() / "urdf"
    urdf, swings = ("cmbot.urdf", "foot_2") if foot == 1 else ("cmbot_on_foot_2.urdf", "foot_1_place")
    return load_robot(
        folder / urdf,
        base_frame=f"foot_{foot}",
        tool_frame=swings,
        limits=folder / "joint_limits.yaml",
        srdf=folder / "climbing.srdf",
        elasticity=folder / "climbing.elasticity.yaml",
        root=root,
        locked=dict(zip(ARM_JOINTS, arm.tolist(), strict=True)),
        tool_length=tool_length,
        payload=payload,
        carrier="tool0",
    )
