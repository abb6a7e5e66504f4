"""The robot of a scene: what it is, what it stands on and how it starts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.poses import pose
from cmbot.common.reading.fields import (
    IN_REACH,
    Angles,
    FilePath,
    FolderPath,
    Length,
    Mass,
    OneOf,
    Place,
    Posture,
    Sides,
    Slug,
    Text,
    Vector,
    mapping_of,
    si_fields,
    word_or,
)
from cmbot.common.reading.validation import FileModel, refusal, shown
from cmbot.scene.base.hold import LinkHoldFile
from cmbot.scene.base.tube import TubeFile
from cmbot.scene.excitation import ModesFile
from cmbot.scene.files import RobotModel

if TYPE_CHECKING:
    from cmbot.robot import AttachedTool, ToolShape


_ZERO_ROTATION = (0.0, 0.0, 0.0)
Scale = Annotated[float, Field(ge=1e-6, le=1e3)]


class ToolShapeFile(OneOf):
    """A shape of a tool: exactly one, placed in the flange's frame."""

    one_of = ("box", "cylinder", "capsule", "sphere", "mesh")

    box: Annotated[tuple[Length, Length, Length], IN_REACH] | None = None
    """Edge lengths along its x, y, z, m."""
    cylinder: Sides | None = None
    """[radius, length along z], m."""
    capsule: Sides | None = None
    """[radius, length along z between the centres of its two half spheres], m."""
    sphere: Annotated[Length, IN_REACH] | None = None
    """Radius, m."""
    mesh: FilePath | None = None
    """Path of a mesh file, relative to the scene file; it counts as its convex hull."""
    scale: Scale = 1.0
    """Of a mesh: what makes metres of its numbers, 0.001 where they are millimetres."""
    xyz: Place = (0.0, 0.0, 0.0)
    """Centre (of a mesh: its origin), m."""
    rpy_deg: Angles = _ZERO_ROTATION
    """Roll, pitch, yaw as in URDF."""

    def _check(self) -> None:
        super()._check()
        if self.mesh is None and self.scale != 1.0:
            expected = f"no such key beside {self.given}, whose numbers are metres"
            raise refusal(expected, got=self.scale, key=("scale",))

    @property
    def shape(self) -> ToolShape:
        """The shape, in SI."""
        from cmbot.robot import ToolShape

        kind = self.given
        numbers = (self.scale,) if kind == "mesh" else np.atleast_1d(getattr(self, kind)).tolist()
        placed: dict[str, Any] = {name: si_fields(self)[name] for name in ("xyz", "rpy")}
        return ToolShape(kind=kind, numbers=tuple(numbers), path=self.mesh, **placed)  # type: ignore[arg-type]


class AttachedToolFile(FileModel):
    """A tool that is fixed to the robot's tool frame, its flange; all in the flange's frame."""

    xyz: Place
    """The tool point, m."""
    rpy_deg: Angles = _ZERO_ROTATION
    """How the tool's frame is turned, whose z axis is the tool's."""
    mass_kg: Mass = 0.0
    """Mass, kg."""
    com: Place | None = None
    """Centre of mass, m; left out: that of its shapes, without shapes half way to the tool point."""
    shapes: Annotated[tuple[ToolShapeFile, ...], Field(max_length=100)] = ()
    """Its shapes: they keep the clearance, and are drawn."""
    mesh: FilePath | None = None
    """In place of shapes the path of a mesh file in the flange's frame, m, relative to the scene file."""

    def _check(self) -> None:
        if self.mesh is not None and self.shapes:
            raise refusal("shapes or a mesh, not both", got="both", key=("mesh",))

    @property
    def tool(self) -> AttachedTool:
        """The tool, in SI."""
        from cmbot.robot import AttachedTool

        shapes = self.shapes if self.mesh is None else (ToolShapeFile(mesh=self.mesh),)
        given = si_fields(self) | {"shapes": tuple(each.shape for each in shapes)}
        del given["mesh"]
        return AttachedTool(**given)


STOW = "stow"
"""The group state of an SRDF that has the stow posture."""
Joints = Literal["elastic", "rigid"]
"""Whether joints bend as the robot's elasticity file says."""


class MountFile(FileModel):
    """A pose in W."""

    xyz: Vector
    """Position, m."""
    rpy_deg: Angles
    """Roll, pitch, yaw as in URDF."""

    @property
    def matrix(self) -> FloatArray:
        """The pose (4, 4), m; read-only."""
        return pose(self.xyz, np.radians(self.rpy_deg))


class BaseFile(FileModel):
    """What the robot stands on or holds."""

    name: Slug
    """What messages and pages call it; left out with its block: guardrail for ``cmbot``, base for others. No
    bridge is drawn behind what has a name."""
    modes: ModesFile | None = None
    """How it bends, by its natural modes; left out: as the guardrail says."""
    tube: TubeFile | None = None
    """How it bends, as a round tube; left out: as the guardrail says."""
    hold: LinkHoldFile | None = None
    """How a robot that holds no guardrail is held; left out: nothing is said about holding."""


class NamedState(FileModel):
    """A group state of the arm's SRDF that sets all its joints."""

    state: Text
    """Its name."""

    def __str__(self) -> str:
        return self.state


ReturnTo = Annotated[
    Literal["stow", "start", "none"] | NamedState,
    word_or(("stow", "start", "none"), NamedState, "{state: NAME}"),
]
"""Where an arm goes after the work."""


class PostureFile(OneOf):
    """Where the arm is at the start: a state of its SRDF, or one posture, from the base to the tool."""

    one_of = ("posture_deg", "posture", "stow", "state")

    posture_deg: Posture | None = None
    """Joint angles, for arms whose joints all turn."""
    posture: Posture | None = None
    """Joint positions in rad and, of joints that slide, m."""
    stow: Literal[True] | None = None
    """In the group state ``stow`` of the arm's SRDF."""
    state: Text | None = None
    """In that group state of the arm's SRDF."""


_Position = Annotated[float, Field(ge=-1000, le=1000)]
_URDF_KEYS = (
    *("base_frame", "tool_frame", "limits", "package_dirs", "mount", "srdf", "elasticity"),
    *("tool", "xacro", "locked", "total_mass_kg", "carried_from"),
)


class RobotFile(FileModel):
    """Which robot: the shipped ``cmbot``, or any URDF; frames, files, mount and tool are for another one."""

    model: RobotModel = "cmbot"
    """``cmbot``, a URDF's path relative to the scene file, or the name of a robot of example-robot-data."""
    base_frame: Text | None = None
    """The frame that is mounted; left out: the only choice, as `cmbot.load_robot` says."""
    tool_frame: Text | None = None
    """The frame that follows the tool path; left out: the only choice."""
    limits: FilePath | None = None
    """Path of its joint-limits file; left out: as beside the URDF, else assumed."""
    srdf: FilePath | None = None
    """Path of its SRDF."""
    elasticity: FilePath | None = None
    """Path of its elasticity file; left out: as beside the URDF."""
    joints: Joints = "elastic"
    """Whether joints bend as the elasticity file says."""
    package_dirs: Annotated[tuple[FolderPath, ...], Field(max_length=100)] | None = None
    """Folders in which ``package://`` is sought first, relative to the scene file."""
    mount: MountFile | None = None
    """Where its base frame is held; left out: its root link is at the origin of W."""
    tool_length_m: Annotated[Length, IN_REACH] | None = None
    """Length of the tool, m; left out: as in the model."""
    tool: AttachedToolFile | None = None
    """In place of `tool_length_m`: the tool that is fixed to the tool frame."""
    payload_kg: Mass = 0.0
    """Point mass at the tool, kg."""
    range_margin_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    """By how much joints that turn keep from both ends of their ranges, deg."""
    range_margin_m: Annotated[float, Field(ge=0, le=10)] = 0.0
    """By how much joints that slide do."""
    xacro: Annotated[tuple[tuple[str, str], ...], mapping_of(Text, Text)] | None = None
    """Values of its xacro arguments, by name."""
    locked: Annotated[tuple[tuple[str, float], ...], mapping_of(Text, _Position)] | None = None
    """Where other joints than the arm's are, rad or m, such as a lift; left out: as in the SRDF, else 0."""
    carried_from: Text | None = None
    """First link on what bends, such as a lift's carriage: links that it does not lead to stand on the floor,
    no load; left out: the root link."""
    total_mass_kg: Annotated[float, Field(gt=0, le=1e5)] | None = None
    """Mass of the whole robot, kg, which is spread over the links without one by the volumes of their shapes:
    every torque is then an estimate."""

    def _check(self) -> None:
        if self.tool is not None and self.tool_length_m is not None:
            raise refusal("tool or tool_length_m, not both", got="both", key=("tool_length_m",))
        for name in _URDF_KEYS:
            if self.model == "cmbot" and getattr(self, name) is not None:
                got = shown(self.model_dump(mode="json")[name])
                expected = "no such key beside model: cmbot: it goes with a URDF of one's own as robot.model"
                raise refusal(expected, got=got, key=(name,))

    @property
    def files(self) -> dict[str, Any]:
        """The model with its frames and files, as arguments of `cmbot.load_robot`."""
        names = ("model", "base_frame", "tool_frame", "limits", "srdf", "elasticity", "carried_from")
        return {name: getattr(self, name) for name in names} | {
            "package_dirs": self.package_dirs or (),
            "xacro": dict(self.xacro or ()),
            "total_mass": self.total_mass_kg,
            "tool": None if self.tool is None else self.tool.tool,
        }


def named_posture(file: RobotFile, name: str, source: str, key: str, *, given: bool) -> FloatArray:
    """Return a posture (n,), rad and m, of a robot by the name of a group state, such as that of the stow.

    Parameters
    ----------
    file : RobotFile
    name : str
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
    state = robot.group_states.get(name)
    if state is not None:
        return state
    lacks = f"the arm {robot.name}, whose SRDF has no group state {name} of all its joints"
    raise SceneError(
        source,
        key,
        lacks if given else f"nothing, and {lacks}",
        "start: {posture_deg: [...]}, or an SRDF with that group state (robot.srdf)",
        tuple(robot.group_states),
    )
