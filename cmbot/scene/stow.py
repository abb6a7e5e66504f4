"""The stow posture: where a scene's arm is put away, by its SRDF."""

from __future__ import annotations

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.scene.scene import RobotSource, SceneFile

__all__ = ["STOW", "start_posture"]

STOW = "stow"
"""The group state of an SRDF that has the stow posture."""


def start_posture(file: SceneFile, robot: RobotSource, source: str) -> FloatArray:
    """Return the posture (n,), rad and m, in which the arm is at the start.

    Parameters
    ----------
    file : SceneFile
    robot : RobotSource
        Its robot is loaded where the arm is stowed at the start.
    source : str
        The scene's, for messages.

    Raises
    ------
    SceneError
        When it is to be stowed, and its SRDF has no such group state.
    ModelError
        When the robot's files cannot be used.
    """
    if file.posture is not None:
        return file.posture
    # Imported here: scenes whose start is a posture need no robot.
    from cmbot.robot import load_robot

    loaded = load_robot(**robot.files)
    stow = loaded.group_states.get(STOW)
    if stow is not None:
        return stow
    given = file.start is not None
    lacks = f"the arm {loaded.name}, whose SRDF has no group state {STOW} of all its joints"
    raise SceneError(
        source,
        file.posture_key,
        lacks if given else f"nothing, and {lacks}",
        "start: {posture_deg: [...]}, or an SRDF with that group state (robot.srdf)",
    )
