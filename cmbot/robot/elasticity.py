"""Links and joints that bend: tubes and springs, from a file beside the URDF.

URDF does not describe elasticity, so an arm that bends has an elasticity file::

    format: cmbot-elasticity/2
    links:
      link_1: {start_m: [0, 0, 0], end_m: [0.83, 0, 0], outer_diameter_m: 0.1, wall_m: 0.004,
               young_pa: 70.0e+9, shear_pa: 26.0e+9}
    joints:
      joint_1: {stiffness_nm_rad: 1.0e+5, damping_nms_rad: 20, tilting_nm_rad: 5.0e+5}

What is not named is rigid, and so is all of a robot without the file. ``cmbot-elasticity/1`` has links only.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import pinocchio as pin
from pydantic import ConfigDict, Field, model_validator

from cmbot.common.errors import ModelError
from cmbot.common.reading.fields import Modulus, Thickness, require_tube
from cmbot.common.reading.validation import FileModel, refusal, validated
from cmbot.common.reading.yaml_reader import lines_named, read_yaml
from cmbot.common.representation import ShortRepr

# The bounds keep every power of a length finite, and catch lengths in millimetres and moduli in gigapascals.
Coordinate = Annotated[float, Field(ge=-1e4, le=1e4)]
Point = tuple[Coordinate, Coordinate, Coordinate]
TurningStiffness = Annotated[float, Field(ge=1e-3, le=1e13)]

_MIN_LENGTH_M = 1e-3  # m


@dataclass(frozen=True, kw_only=True)
class LinkTube(ShortRepr):
    """The round tube that models the bending of a link; a file's values are bounded.

    Attributes
    ----------
    start, end : tuple of float
        (3,), ends of the tube's axis in the link's frame, m; the start is nearer to the base.
    outer_diameter, wall : float
        m; a wall of half the diameter is a solid bar.
    young, shear : float
        Moduli, Pa.
    """

    __pydantic_config__: ClassVar[ConfigDict] = FileModel.model_config

    start: Annotated[Point, Field(alias="start_m")]
    end: Annotated[Point, Field(alias="end_m")]
    outer_diameter: Annotated[Thickness, Field(alias="outer_diameter_m")]
    wall: Annotated[Thickness, Field(alias="wall_m")]
    young: Annotated[Modulus, Field(alias="young_pa")]
    shear: Annotated[Modulus, Field(alias="shear_pa")]

    @property
    def length(self) -> float:
        """Length, m."""
        return math.dist(self.start, self.end)

    @property
    def second_moment(self) -> float:
        """Second moment of the cross-section's area about a diameter, m4; the polar one is twice that."""
        inner_diameter = self.outer_diameter - 2 * self.wall
        return math.pi / 64 * (self.outer_diameter**4 - inner_diameter**4)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if math.dist(self.start, self.end) < _MIN_LENGTH_M:
            raise refusal("ends a millimetre apart", got=f"start_m {self.start} and end_m {self.end}")
        require_tube(self.start, self.end, self.outer_diameter, self.wall)
        return self


@dataclass(frozen=True, kw_only=True)
class JointElasticity(ShortRepr):
    """What gives way in series with the drive of a joint that turns; a file's values are bounded.

    Attributes
    ----------
    stiffness : float
        Of the gear and the drive about the joint's axis, Nm/rad.
    damping : float
        Beside that stiffness, Nm s/rad.
    tilting : float or None
        Of the bearing about every axis across the joint's, Nm/rad; None: the bearing is rigid.
    """

    __pydantic_config__: ClassVar[ConfigDict] = FileModel.model_config

    stiffness: Annotated[TurningStiffness, Field(alias="stiffness_nm_rad")]
    damping: Annotated[float, Field(alias="damping_nms_rad", ge=0, le=1e9)] = 0.0
    tilting: Annotated[TurningStiffness | None, Field(alias="tilting_nm_rad")] = None


class _ElasticityFile(FileModel):
    format: Literal["cmbot-elasticity/1", "cmbot-elasticity/2"]
    links: dict[str, LinkTube] = Field(default_factory=dict)
    joints: dict[str, JointElasticity] | None = None

    def _check(self) -> None:
        if self.format == "cmbot-elasticity/1" and self.joints is not None:
            expected = "no such key in cmbot-elasticity/1: it goes with cmbot-elasticity/2"
            raise refusal(expected, got="joints", key=("joints",))


class Elasticity(NamedTuple):
    """What bends: tubes of links and springs of joints, by name, in the joints' order; springs of others."""

    tubes: dict[str, LinkTube]
    springs: dict[str, JointElasticity]
    locked: dict[str, JointElasticity]


def read_elasticity(
    path: Path, model: Any, slides: Collection[str], paired: Collection[str] = ()
) -> Elasticity:
    """Read what bends of an arm and of the joints that are locked beside it.

    `slides` are those that slide, `paired` those that follow another or are followed: neither give way.

    What belongs to a link that does not move with the arm is checked and left out.
    """
    with lines_named(path):
        data = validated(_ElasticityFile, read_yaml(path, ModelError), str(path), ModelError)
        springs, given = _joints(data, path, model, slides, paired), data.joints or {}
        locked = {name: given[name] for name in given if name not in springs}
        return Elasticity(_tubes(data, path, model), springs, locked)


def require_joints(names: Iterable[str], model: Any, path: Path | None) -> None:
    """Refuse the names in a file's ``joints`` that are no joints of the URDF, which move or are fixed."""
    kinds = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    known = tuple(frame.name for frame in model.frames if frame.type in kinds and frame.name != "universe")
    for name in names:
        if name not in known:
            raise ModelError(str(path), "joints", repr(name), "a joint of the URDF", known)


def _joints(
    data: _ElasticityFile, path: Path, model: Any, slides: Collection[str], paired: Collection[str]
) -> dict[str, JointElasticity]:
    given, moving = data.joints or {}, list(model.names)[1:]
    require_joints(given, model, path)
    for name in given:
        if name in slides:
            expected = "one that turns: below a lift base.tube or guardrail.stiffness of a scene gives way"
            raise ModelError(str(path), f"joints.{name}", "a joint that slides", expected)
        if name in paired:
            expected = "one that neither follows another nor is followed: leave it out, its linkage is rigid"
            raise ModelError(str(path), f"joints.{name}", "a joint of a linkage (mimic)", expected)
    return {name: given[name] for name in moving if name in given}


def _tubes(data: _ElasticityFile, path: Path, model: Any) -> dict[str, LinkTube]:
    links = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY}
    by_joint: dict[int, str] = {}
    for name in data.links:
        if name not in links:
            raise ModelError(str(path), "links", repr(name), "a link of the URDF", tuple(links))
        joint = links[name].parentJoint
        if joint in by_joint:
            expected = f"one tube for the body that {model.names[joint]} moves"
            got = f"a tube beside that of {by_joint[joint]}"
            raise ModelError(str(path), f"links.{name}", got, expected)
        if joint > 0:
            by_joint[joint] = name
    return {name: data.links[name] for _, name in sorted(by_joint.items())}
