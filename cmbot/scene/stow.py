"""The stow posture: where a scene's arm is put away, by its SRDF."""

from __future__ import annotations

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.scene.robot_entry import RobotFile

__all__ = ["STOW", "stow_posture"]

STOW = "stow"
"""The group state of an SRDF that has the stow posture."""


def stow_posture(file: RobotFile, source: str, key: str, *, given: bool) -> FloatArray:
    """Return the stow posture (n,), rad and m, of a robot.

    Parameters
    ----------
    file : RobotFile
    source, key : str
        Of the scene, and where it asks for that posture, for messages.
    given : bool
        Whether it says so.

    Raises
    ------
    SceneError
        When the robot's SRDF has no such group state.
    ModelError
        When the robot's files cannot be used.
    """
    # Imported here: scenes whose start is a posture need no robot.
    from cmbot.robot import load_robot

    robot = load_robot(**file.files)
    stow = robot.group_states.get(STOW)
    if stow is not None:
        return stow
    lacks = f"the arm {robot.name}, whose SRDF has no group state {STOW} of all its joints"
    raise SceneError(
        source,
        key,
        lacks if given else f"nothing, and {lacks}",
        "start: {posture_deg: [...]}, or an SRDF with that group state (robot.srdf)",
    )
