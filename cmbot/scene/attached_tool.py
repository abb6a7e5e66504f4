"""The tool on a robot's flange, as a scene file has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from cmbot.common.fields import Angles, FilePath, Length, Mass, Vector, exactly_one, given_of, one_of_schema
from cmbot.common.validation import FileModel, refusal

if TYPE_CHECKING:
    from cmbot.robot import AttachedTool, ToolShape

_TOOL_SHAPES = ("box", "cylinder", "capsule", "sphere", "mesh")
_ZERO_ROTATION = (0.0, 0.0, 0.0)
Scale = Annotated[float, Field(ge=1e-6, le=1e3)]


class ToolShapeFile(FileModel):
    """A shape of a tool: exactly one, placed in the flange's frame."""

    model_config = ConfigDict(json_schema_extra=one_of_schema(_TOOL_SHAPES))

    box: tuple[Length, Length, Length] | None = None
    """Edge lengths along its x, y, z, m."""
    cylinder: tuple[Length, Length] | None = None
    """[radius, length along z], m."""
    capsule: tuple[Length, Length] | None = None
    """[radius, length along z between the centres of its two half spheres], m."""
    sphere: Length | None = None
    """Radius, m."""
    mesh: FilePath | None = None
    """Path of a mesh file, relative to the scene file; it counts as its convex hull."""
    scale: Scale = 1.0
    """Of a mesh: what makes metres of its numbers, 0.001 where they are millimetres."""
    xyz: Vector = (0.0, 0.0, 0.0)
    """Centre (of a mesh: its origin), m."""
    rpy_deg: Angles = _ZERO_ROTATION
    """Roll, pitch, yaw as in URDF."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, _TOOL_SHAPES)
        return self

    @property
    def shape(self) -> ToolShape:
        """The shape, in SI."""
        from cmbot.robot import ToolShape

        (kind,) = given_of(self, _TOOL_SHAPES)
        numbers = (self.scale,) if kind == "mesh" else np.atleast_1d(getattr(self, kind)).tolist()
        roll, pitch, yaw = np.radians(self.rpy_deg).tolist()
        return ToolShape(
            kind=kind,  # type: ignore[arg-type]
            numbers=tuple(numbers),
            path=self.mesh,
            xyz=self.xyz,
            rpy=(roll, pitch, yaw),
        )


class AttachedToolFile(FileModel):
    """A tool that is fixed to the robot's tool frame, its flange; all in the flange's frame."""

    xyz: Vector
    """The tool point, m."""
    rpy_deg: Angles = _ZERO_ROTATION
    """How the tool's frame is turned, whose z axis is the tool's."""
    mass_kg: Mass = 0.0
    """Mass, kg."""
    com: Vector | None = None
    """Centre of mass, m; left out: that of its shapes, without shapes half way to the tool point."""
    shapes: Annotated[tuple[ToolShapeFile, ...], Field(max_length=100)] = ()
    """Its shapes: they keep the clearance, and are drawn."""
    mesh: FilePath | None = None
    """In place of shapes the path of a mesh file in the flange's frame, m, relative to the scene file."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.mesh is not None and self.shapes:
            raise refusal("shapes or a mesh, not both", got="both", key=("mesh",))
        return self

    @property
    def tool(self) -> AttachedTool:
        """The tool, in SI."""
        from cmbot.robot import AttachedTool

        shapes = self.shapes if self.mesh is None else (ToolShapeFile(mesh=self.mesh),)
        roll, pitch, yaw = np.radians(self.rpy_deg).tolist()
        return AttachedTool(
            xyz=self.xyz,
            rpy=(roll, pitch, yaw),
            mass=self.mass_kg,
            com=self.com,
            shapes=tuple(each.shape for each in shapes),
        )
