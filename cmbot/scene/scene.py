"""The scene: the planning problem and its surroundings as data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import GetPydanticSchema

from cmbot.common.arrays import FloatArray
from cmbot.common.validation import CheckedFields, check_fields, require_type
from cmbot.elastic import Guardrail
from cmbot.scene.fields import Length, Mass, Posture, Text, Vector
from cmbot.scene.obstacles import Obstacle
from cmbot.scene.options import PlannerOptions
from cmbot.scene.schema import SceneFile, ToolPathFile
from cmbot.scene.tool_path import Leg, SpeedProfile

__all__ = ["RobotSource", "Scene"]

# A path is checked as the text that a file would hold.
_AS_TEXT = GetPydanticSchema(lambda _, handler: handler(Text))


@dataclass(frozen=True, kw_only=True)
class RobotSource(CheckedFields):
    """The files, frames and mount of the robot.

    For the shipped model the fields that may be None are None, but for `tool_length`.

    Attributes
    ----------
    model : str or Path
        ``cmbot``, or the path of a URDF.
    base_frame, tool_frame : str or None
        Frames of the URDF: the mounted one, and the one that follows the tool path.
    limits : Path or None
        Joint-limits file.
    srdf, elasticity : Path or None
        None also where there is none, or the elasticity file is the one beside the URDF.
    mount_xyz, mount_rpy : tuple of float or None
        (3,) each, pose of the base frame in W, m and rad: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
    tool_length : float or None
        m; None: as in the model.
    payload : float
        Point mass at the tool, kg.
    """

    model: Annotated[str | Path, _AS_TEXT]
    base_frame: Text | None
    tool_frame: Text | None
    limits: Annotated[Path, _AS_TEXT] | None
    srdf: Annotated[Path, _AS_TEXT] | None
    elasticity: Annotated[Path, _AS_TEXT] | None
    mount_xyz: Vector | None
    mount_rpy: Vector | None
    tool_length: Length | None
    payload: Mass


class _SceneFields(ToolPathFile):
    """The bounds of a `Scene`'s fields that hold text and numbers: those of the scene file."""

    posture: Posture
    planner: PlannerOptions


_TYPES: dict[str, tuple[type, str]] = {
    "name": (str, "text"),
    "source": (str, "text"),
    "robot": (RobotSource, "a RobotSource"),
    "posture": (np.ndarray, "an array (n,), rad"),
    "speed_profile": (SpeedProfile, "a SpeedProfile"),
    "guardrail": (Guardrail, "a Guardrail"),
    "planner": (PlannerOptions, "PlannerOptions"),
    "file": (SceneFile, "a SceneFile"),
    "content_hash": (str, "text"),
}
_ITEM_TYPES: dict[str, tuple[type, str]] = {"legs": (Leg, "a Leg"), "obstacles": (Obstacle, "an Obstacle")}


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A planning problem and its surroundings. Equal `content_hash` means the same scene.

    Attributes
    ----------
    name : str
        Usable as a folder's name.
    source : str
        Where it came from, for messages.
    robot : RobotSource
    posture : array
        (n,), joint angles at the start, rad; read-only.
    keep : str
        What the tool path prescribes of the tool: its ``pose``, ``axis`` or ``position``.
    legs : tuple of Leg
        From the pose of the tool at `posture`.
    speed_profile : SpeedProfile
    via_points : int
        In all, with the ends of the legs.
    obstacles : tuple of Obstacle
        The scene's own, then the members of the guardrail.
    guardrail : Guardrail
    planner : PlannerOptions
    file : SceneFile
        The file's content as it was read, with every default filled in; paths as written there. What Python
        changes in the other fields is in the file that `cmbot.save` writes.
    content_hash : str
        SHA-256 (hexadecimal) of that content and of the mesh files' bytes.

    Raises
    ------
    InputError
        When a field is of another type or out of the bounds of the scene file, as in
        ``dataclasses.replace(scene, via_points=30.5)``.
    """

    name: str
    source: str
    robot: RobotSource
    posture: FloatArray
    keep: Literal["pose", "axis", "position"]
    legs: tuple[Leg, ...]
    speed_profile: SpeedProfile
    via_points: int
    obstacles: tuple[Obstacle, ...]
    guardrail: Guardrail
    planner: PlannerOptions
    file: SceneFile
    content_hash: str

    def __post_init__(self) -> None:
        for name, (kind, expected) in _TYPES.items():
            require_type(getattr(self, name), kind, "Scene", name, expected)
        for name, (kind, expected) in _ITEM_TYPES.items():
            require_type(getattr(self, name), (tuple, list), "Scene", name, f"a tuple, {expected} each")
            for k, item in enumerate(getattr(self, name)):
                require_type(item, kind, "Scene", f"{name}[{k}]", expected)
        check_fields(self, _SceneFields)
