"""The robot of a scene: what it is, what it stands on and how it starts, in the file and as data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, GetPydanticSchema, model_validator

from cmbot.common.representation import short_repr
from cmbot.common.validation import CheckedFields, FileModel, refusal, shown
from cmbot.scene.base.stance import Stance
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

__all__ = ["BaseFile", "Joints", "MountFile", "PostureFile", "RobotFile", "RobotSource"]

Joints = Literal["elastic", "rigid"]
"""Whether joints bend as the robot's elasticity file says."""

# A path is checked as the text that a file would hold.
_AS_TEXT = GetPydanticSchema(lambda _, handler: handler(Text))


class MountFile(FileModel):
    """A pose in W: of the robot's base frame, or of a workpiece."""

    xyz: Vector
    """Position, m."""
    rpy_deg: Angles
    """Roll, pitch, yaw as in URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""


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

    model: Text = "cmbot"
    """``cmbot``, a URDF's path relative to the scene file, or the name of a robot of example-robot-data."""
    base_frame: Text | None = None
    """Of another URDF: the frame that is mounted; left out: the only choice, as `cmbot.load_robot` says."""
    tool_frame: Text | None = None
    """Of another URDF: the frame that follows the tool path; left out: the only choice."""
    limits: Text | None = None
    """Of another URDF: path of its joint-limits file; left out: as beside the URDF, else assumed."""
    srdf: Text | None = None
    """Of another URDF: path of its SRDF, if there is one."""
    elasticity: Text | None = None
    """Of another URDF: path of its elasticity file; left out: as beside the URDF."""
    joints: Joints | None = None
    """Whether joints bend as the elasticity file says; left out: ``elastic``."""
    package_dirs: Annotated[tuple[Text, ...], Field(max_length=100)] | None = None
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


@dataclass(frozen=True, kw_only=True)
class RobotSource(CheckedFields):
    """The files, frames and mount of the robot.

    For the shipped model the fields that may be None are None, but for `tool_length`.

    Attributes
    ----------
    model : str or Path
        ``cmbot``, the name of a robot of example-robot-data, or the path of a URDF.
    base_frame, tool_frame : str or None
        Frames of the URDF: the mounted one, and the one that follows the tool path. None: the only choice.
    limits, srdf, elasticity : Path or None
        Joint limits, SRDF, elasticity file. None also where they lie beside the URDF.
    joints : str
        ``elastic``: they bend as the elasticity file says; or ``rigid``.
    package_dirs : tuple of Path or None
        Where ROS packages are sought first.
    mount_xyz, mount_rpy : tuple of float or None
        (3,) each, pose of the base frame in W, m and rad: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
    tool_length : float or None
        m; None: as in the model.
    payload : float
        Point mass at the tool, kg.
    stance : Stance or None
        Where the shipped robot stands; None: on the post at the origin of W.
    """

    model: Annotated[str | Path, _AS_TEXT]
    base_frame: Text | None
    tool_frame: Text | None
    limits: Annotated[Path, _AS_TEXT] | None
    srdf: Annotated[Path, _AS_TEXT] | None
    elasticity: Annotated[Path, _AS_TEXT] | None
    package_dirs: tuple[Annotated[Path, _AS_TEXT], ...] | None
    mount_xyz: Vector | None
    mount_rpy: Vector | None
    tool_length: Length | None
    payload: Mass
    joints: Joints = "elastic"
    stance: Stance | None = None

    __repr__ = short_repr

    @property
    def files(self) -> dict[str, Any]:
        """The model with its frames and files, as arguments of `cmbot.load_robot`."""
        names = ("base_frame", "tool_frame", "limits", "srdf", "elasticity")
        given = {name: getattr(self, name) for name in names}
        return {"model": self.model, **given, "package_dirs": self.package_dirs or ()}
