"""What may stand in the data classes of a scene, where Python puts it there: the rules of the scene file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cmbot.common.validation import FileModel
from cmbot.scene.fields import Coordinate, Length, Vector
from cmbot.scene.options import PlannerOptions
from cmbot.scene.schema import SpeedProfileFile, Text, ToolPathFile

__all__ = ["RobotFields", "SceneFields"]


class RobotFields(FileModel):
    """Of a `RobotSource`."""

    model: Text
    base_frame: Text | None
    tool_frame: Text | None
    limits: Text | None
    srdf: Text | None
    elasticity: Text | None
    mount_xyz: Vector | None
    mount_rpy: Vector | None
    tool_length: Length | None
    payload: Annotated[float, Field(ge=0, le=1e4)]


class SceneFields(ToolPathFile):
    """Of a `Scene`, but for what is no text and no number."""

    speed_profile: SpeedProfileFile
    posture: Annotated[tuple[Coordinate, ...], Field(min_length=1, max_length=100)]
    planner: PlannerOptions
    content_hash: str
