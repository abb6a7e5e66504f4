"""What to plan, and where: the scene as data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from cmbot.common.arguments import require_fields, require_type
from cmbot.common.arrays import FloatArray
from cmbot.elastic import Guardrail
from cmbot.scene.obstacles import Obstacle
from cmbot.scene.options import PlannerOptions
from cmbot.scene.scene_fields import RobotFields, SceneFields
from cmbot.scene.schema import LegFile, SceneFile
from cmbot.scene.speed_profile import SpeedProfile

__all__ = ["Leg", "RobotSource", "Scene"]


@dataclass(frozen=True, kw_only=True)
class RobotSource:
    """Where the robot comes from; the fields that may be None are None exactly for the shipped model.

    Attributes
    ----------
    model : str or Path
        ``cmbot``, or the path of a URDF.
    base_frame, tool_frame : str or None
        Frames of another URDF: what is mounted, and what follows the tool path.
    limits : Path or None
        Joint-limits file of another URDF.
    srdf : Path or None
        SRDF of another URDF; None also where it has none.
    elasticity : Path or None
        Elasticity file of another URDF; None also where it is the one beside the URDF, or none.
    mount_xyz : tuple of float or None
        (3,), position of the base frame of another URDF in W, m.
    mount_rpy : tuple of float or None
        (3,), its roll, pitch, yaw, rad: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
    tool_length : float or None
        m; None: as in the model.
    payload : float
        Point mass at the tool, kg.
    """

    model: str | Path
    base_frame: str | None
    tool_frame: str | None
    limits: Path | None
    srdf: Path | None
    elasticity: Path | None
    mount_xyz: tuple[float, float, float] | None
    mount_rpy: tuple[float, float, float] | None
    tool_length: float | None
    payload: float

    def __post_init__(self) -> None:
        require_fields(self, RobotFields)


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A straight leg of the tool's path.

    Attributes
    ----------
    by : tuple of float
        (3,), displacement in W, m.
    seconds : float
        Duration, s.
    """

    by: tuple[float, float, float]
    seconds: float

    def __post_init__(self) -> None:
        require_fields(self, LegFile)


_KINDS: tuple[tuple[str, type, str], ...] = (
    ("name", str, "text"),
    ("source", str, "text"),
    ("robot", RobotSource, "a RobotSource"),
    ("posture", np.ndarray, "an array (n,), rad"),
    ("speed_profile", SpeedProfile, "a SpeedProfile"),
    ("guardrail", Guardrail, "a Guardrail"),
    ("planner", PlannerOptions, "PlannerOptions"),
    ("file", SceneFile, "a SceneFile"),
)
_KINDS_OF_EACH: tuple[tuple[str, type, str], ...] = (
    ("legs", Leg, "a Leg"),
    ("obstacles", Obstacle, "an Obstacle"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What to plan, and where. Equal `content_hash` means the same scene.

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
        What of the tool is prescribed: ``pose``, ``axis`` or ``position``.
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
        for name, kind, expected in _KINDS:
            require_type(getattr(self, name), kind, "Scene", name, expected)
        for name, kind, expected in _KINDS_OF_EACH:
            require_type(getattr(self, name), (tuple, list), "Scene", name, f"a tuple, {expected} each")
            for k, item in enumerate(getattr(self, name)):
                require_type(item, kind, "Scene", f"{name}[{k}]", expected)
        require_fields(self, SceneFields)
