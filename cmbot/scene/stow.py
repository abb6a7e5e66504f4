"""Named states of an arm, such as the stow posture: where it starts and is put away, by its SRDF."""

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
        When it is to be stowed or in another state, and its SRDF has no such group state.
    ModelError
        When the robot's files cannot be used.
    """
    if file.posture is not None:
        return file.posture
    # Imported here: scenes whose start is a posture need no robot.
    from cmbot.robot import load_robot

    loaded = load_robot(**robot.files)
    given = file.start is not None
    name = (file.start.state if file.start is not None else None) or STOW
    if (state := loaded.group_states.get(name)) is not None:
        return state
    lacks = f"the arm {loaded.name}, whose SRDF has no group state {name} of all its joints"
    raise SceneError(
        source,
        file.posture_key,
        lacks if given else f"nothing, and {lacks}",
        "start: {posture_deg: [...]}, or an SRDF with that group state (robot.srdf)",
        tuple(loaded.group_states),
    )
