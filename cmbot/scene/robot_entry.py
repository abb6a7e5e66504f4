"""The robot of a scene: what it is, what it stands on and how it starts."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    GetPydanticSchema,
    SerializerFunctionWrapHandler,
    WrapSerializer,
    model_validator,
)

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.fields import (
    Angles,
    FilePath,
    FolderPath,
    Length,
    Mass,
    Posture,
    Slug,
    Text,
    Vector,
    exactly_one,
    one_of_schema,
    word_or,
)
from cmbot.common.poses import pose
from cmbot.common.validation import FileModel, refusal, shown
from cmbot.scene.attached_tool import AttachedToolFile
from cmbot.scene.base.hold import LinkHoldFile
from cmbot.scene.excitation import ModesFile
from cmbot.scene.files import RobotModel

STOW = "stow"
"""The group state of an SRDF that has the stow posture."""
Joints = Literal["elastic", "rigid"]
"""Whether joints bend as the robot's elasticity file says."""


class MountFile(FileModel):
    """A pose in W: of the robot's base frame, or of a workpiece."""

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
    """What messages and pages call it; left out with its block: guardrail for ``cmbot``, base for others."""
    modes: ModesFile | None = None
    """How it bends, by its natural modes; left out: as the guardrail says."""
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
_POSTURE_KEYS = ("posture_deg", "posture", "stow", "state")


class PostureFile(FileModel):
    """Where the arm is at the start: a state of its SRDF, or one posture, from the base to the tool."""

    model_config = ConfigDict(json_schema_extra=one_of_schema(_POSTURE_KEYS))

    posture_deg: Posture | None = None
    """Joint angles, for arms whose joints all turn."""
    posture: Posture | None = None
    """Joint positions in rad and, of joints that slide, m."""
    stow: Literal[True] | None = None
    """In the group state ``stow`` of the arm's SRDF."""
    state: Text | None = None
    """In the group state of that name of the arm's SRDF."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, _POSTURE_KEYS)
        return self


def _pairs(arguments: dict[str, str]) -> Any:
    return tuple(sorted(arguments.items()))


def _by_name(pairs: tuple[tuple[str, str], ...], handler: SerializerFunctionWrapHandler) -> Any:
    return handler(dict(pairs))


_Arguments = Annotated[
    tuple[tuple[str, str], ...],
    GetPydanticSchema(
        lambda _, handler: handler(
            Annotated[
                dict[Text, Text], Field(max_length=100), AfterValidator(_pairs), WrapSerializer(_by_name)
            ]
        )
    ),
]
_URDF_KEYS = (
    *("base_frame", "tool_frame", "limits", "package_dirs", "mount", "srdf", "elasticity"),
    *("tool", "xacro", "total_mass_kg"),
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
    """Path of its SRDF, if there is one."""
    elasticity: FilePath | None = None
    """Path of its elasticity file; left out: as beside the URDF."""
    joints: Joints = "elastic"
    """Whether joints bend as the elasticity file says."""
    package_dirs: Annotated[tuple[FolderPath, ...], Field(max_length=100)] | None = None
    """Folders in which ``package://`` is sought first, relative to the scene file."""
    mount: MountFile | None = None
    """Where its base frame is held; left out: its root link is at the origin of W."""
    tool_length_m: Length | None = None
    """Length of the tool, m; left out: as in the model."""
    tool: AttachedToolFile | None = None
    """In place of `tool_length_m`: the tool that is fixed to the tool frame."""
    payload_kg: Mass = 0.0
    """Point mass at the tool, kg."""
    xacro: _Arguments | None = None
    """Of a URDF in xacro: values of its arguments, by their names."""
    total_mass_kg: Annotated[float, Field(gt=0, le=1e5)] | None = None
    """Of a URDF without masses: that of the whole robot, kg, which is spread over the links without one
    by the volumes of their shapes. Every torque is then an estimate."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.tool is not None and self.tool_length_m is not None:
            raise refusal("tool or tool_length_m, not both", got="both", key=("tool_length_m",))
        for name in _URDF_KEYS:
            if self.model == "cmbot" and getattr(self, name) is not None:
                got = shown(self.model_dump(mode="json")[name])
                expected = "no such key beside model: cmbot: it goes with a URDF of one's own as robot.model"
                raise refusal(expected, got=got, key=(name,))
        return self

    @property
    def files(self) -> dict[str, Any]:
        """The model with its frames and files, as arguments of `cmbot.load_robot`."""
        names = ("model", "base_frame", "tool_frame", "limits", "srdf", "elasticity")
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
