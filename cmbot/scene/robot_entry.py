"""The robot of a scene: what it is, what it stands on and how it starts."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.validation import FileModel, refusal, shown
from cmbot.scene.excitation import ModesFile
from cmbot.scene.fields import (
    Angles,
    Length,
    Mass,
    Posture,
    Slug,
    Text,
    Vector,
    exactly_one,
    one_of_schema,
)
from cmbot.scene.files import FilePath, FolderPath, RobotModel
from cmbot.scene.obstacles import pose

__all__ = ["STOW", "BaseFile", "Joints", "MountFile", "PostureFile", "RobotFile", "stow_posture"]

STOW = "stow"
"""The group state of an SRDF that has the stow posture."""
Joints = Literal["elastic", "rigid"]
"""Whether joints bend as the robot's elasticity file says."""


class MountFile(FileModel):
    """A pose in W: of the robot's base frame, or of a workpiece."""

    xyz: Vector
    """Position, m."""
    rpy_deg: Angles
    """Roll, pitch, yaw as in URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""

    @property
    def matrix(self) -> FloatArray:
        """The pose (4, 4), m; read-only."""
        return pose(self.xyz, np.radians(self.rpy_deg))


class BaseFile(FileModel):
    """What the robot stands on or holds."""

    name: Slug
    """What messages and pages call it; left out with its block: guardrail for ``cmbot``, base for others."""
    modes: ModesFile | None = None
    """How it bends, by its natural modes; left out: as the guardrail says."""


class PostureFile(FileModel):
    """Where the arm is at the start: stowed, or one posture, from the base to the tool, in either unit."""

    model_config = ConfigDict(json_schema_extra=one_of_schema(("posture_deg", "posture", "stow")))

    posture_deg: Posture | None = None
    """Joint angles, for arms whose joints all turn."""
    posture: Posture | None = None
    """Joint positions in rad and, of joints that slide, m."""
    stow: Literal[True] | None = None
    """In the group state ``stow`` of the arm's SRDF."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, ("posture_deg", "posture", "stow"))
        return self


class RobotFile(FileModel):
    """Which robot: the shipped ``cmbot``, or any URDF with its frames, limits and mount."""

    model: RobotModel = "cmbot"
    """``cmbot``, a URDF's path relative to the scene file, or the name of a robot of example-robot-data."""
    base_frame: Text | None = None
    """Of another URDF: the frame that is mounted; left out: the only choice, as `cmbot.load_robot` says."""
    tool_frame: Text | None = None
    """Of another URDF: the frame that follows the tool path; left out: the only choice."""
    limits: FilePath | None = None
    """Of another URDF: path of its joint-limits file; left out: as beside the URDF, else assumed."""
    srdf: FilePath | None = None
    """Of another URDF: path of its SRDF, if there is one."""
    elasticity: FilePath | None = None
    """Of another URDF: path of its elasticity file; left out: as beside the URDF."""
    joints: Joints = "elastic"
    """Whether joints bend as the elasticity file says."""
    package_dirs: Annotated[tuple[FolderPath, ...], Field(max_length=100)] | None = None
    """Of another URDF: folders in which ``package://`` is sought first, relative to the scene file."""
    mount: MountFile | None = None
    """Of another URDF: where its base frame is held; left out: its root link is at the origin of W."""
    tool_length_m: Length | None = None
    """Length of the tool, m; left out: as in the model."""
    payload_kg: Mass = 0.0
    """Point mass at the tool, kg."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in ("base_frame", "tool_frame", "limits", "package_dirs", "mount", "srdf", "elasticity"):
            if self.model == "cmbot" and getattr(self, name) is not None:
                got = shown(self.model_dump(mode="json")[name])
                expected = "no such key beside model: cmbot: it goes with a URDF of one's own as robot.model"
                raise refusal(expected, got=got, key=(name,))
        return self

    @property
    def files(self) -> dict[str, Any]:
        """The model with its frames and files, as arguments of `cmbot.load_robot`."""
        names = ("model", "base_frame", "tool_frame", "limits", "srdf", "elasticity")
        return {name: getattr(self, name) for name in names} | {"package_dirs": self.package_dirs or ()}


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
