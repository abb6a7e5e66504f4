"""The scene file as pydantic models, in its own units: metres, kilograms, seconds, degrees."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from cmbot.common.validation import FileModel, hint, refusal, shown
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
from cmbot.scene.guardrail import GuardrailFile
from cmbot.scene.options import PlannerOptions
from cmbot.scene.tool_path import Leg, SpeedProfile

__all__ = ["FORMAT", "MountFile", "ObstacleFile", "RobotFile", "SceneFile", "ToolPathFile"]

FORMAT = "cmbot-scene/1"
SHAPES = ("box", "cylinder", "capsule", "sphere", "mesh")


class MountFile(FileModel):
    """Pose of the robot's base frame in W."""

    xyz: Vector
    """m."""
    rpy_deg: Angles
    """Roll, pitch, yaw as in URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""


class RobotFile(FileModel):
    """Which robot: the shipped ``cmbot``, or any URDF with its frames, limits and mount."""

    model: Text = "cmbot"
    """``cmbot``, or a URDF's path relative to the scene file."""
    base_frame: Text | None = None
    """Of another URDF: the frame that is mounted."""
    tool_frame: Text | None = None
    """Of another URDF: the frame that follows the tool path."""
    limits: Text | None = None
    """Of another URDF: path of its joint-limits file."""
    srdf: Text | None = None
    """Of another URDF: path of its SRDF, if there is one."""
    elasticity: Text | None = None
    """Of another URDF: path of the file that says which of its links bend; left out: as beside the URDF."""
    mount: MountFile | None = None
    """Of another URDF: where its base frame is held."""
    tool_length_m: Length | None = None
    """Length of the tool, m; left out: as in the model."""
    payload_kg: Mass = 0.0
    """Point mass at the tool, kg."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in ("base_frame", "tool_frame", "limits", "mount", "srdf", "elasticity"):
            given = getattr(self, name) is not None
            if self.model == "cmbot" and given:
                got = shown(self.model_dump(mode="json")[name])
                expected = "no such key beside model: cmbot: it goes with a URDF of one's own as robot.model"
                raise refusal(expected, got=got, key=(name,))
            if self.model != "cmbot" and not given and name not in ("srdf", "elasticity"):
                expected = f"a value, as model is {shown(self.model)}{hint(self.model, ('cmbot',))}"
                raise refusal(expected, got="nothing", key=(name,))
        return self


class ToolPathFile(FileModel):
    """The path of the tool from its pose in the start posture."""

    keep: Literal["pose", "axis", "position"] = "pose"
    """What the path prescribes of the tool."""
    legs: Annotated[tuple[Leg, ...], Field(min_length=1, max_length=2000)]
    speed_profile: SpeedProfile = SpeedProfile()
    via_points: Annotated[int, Field(ge=5, le=20000)] = 50
    """Via-points in all; the ends of the legs are among them."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.via_points <= len(self.legs):
            expected = f"more than the {len(self.legs)} legs"
            raise refusal(expected, got=self.via_points, key=("via_points",))
        return self


class ObstacleFile(FileModel):
    """Something that must not be hit: exactly one shape, placed in W."""

    model_config = ConfigDict(json_schema_extra=one_of_schema(SHAPES))

    name: Slug
    box: tuple[Length, Length, Length] | None = None
    """Edge lengths along its x, y, z, m."""
    cylinder: tuple[Length, Length] | None = None
    """[radius, length along z], m."""
    capsule: tuple[Length, Length] | None = None
    """[radius, length along z between the centres of its two half spheres], m."""
    sphere: Length | None = None
    """Radius, m."""
    mesh: Text | None = None
    """Path of a mesh file in metres, relative to the scene file."""
    xyz: Vector
    """Centre (of a mesh: its origin) in W, m."""
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw as in URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    workpiece: bool = False
    """The tool works on it, so it may come close."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, SHAPES)
        return self


class SceneFile(FileModel):
    """The robot, its start posture, the tool path and the surroundings; in m, s, kg and degrees."""

    format: Literal["cmbot-scene/1"]
    name: Slug
    """Also the name of the folder that a plan is written to."""
    robot: RobotFile = RobotFile()
    posture_deg: Posture
    """Joint angles at the start, from the base to the tool."""
    tool_path: ToolPathFile
    obstacles: Annotated[tuple[ObstacleFile, ...], Field(max_length=1000)] = ()
    guardrail: GuardrailFile = GuardrailFile()
    planner: PlannerOptions = PlannerOptions()

    @model_validator(mode="after")
    def _check(self) -> Self:
        taken = set(self.guardrail.member_names)
        for index, obstacle in enumerate(self.obstacles):
            if obstacle.name in taken:
                expected = "a name that no other obstacle or guardrail member has"
                raise refusal(expected, got=shown(obstacle.name), key=("obstacles", index, "name"))
            taken.add(obstacle.name)
        return self

    def as_data(self) -> dict[str, Any]:
        """Return the file's content, every default filled in, as `cmbot.load_scene` takes it back."""
        return self.model_dump(mode="json", exclude_none=True)

    def canonical_json(self) -> str:
        """Return the content as the one JSON text that equal scenes share."""
        return json.dumps(self.as_data(), sort_keys=True, separators=(",", ":"), allow_nan=False)
