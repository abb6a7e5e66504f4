"""Links that bend: tubes, from a file beside the URDF.

URDF does not describe elasticity, so an arm whose links bend has an elasticity file::

    format: cmbot-elasticity/1
    links:
      link_1: {start_m: [0, 0, 0], end_m: [0.83, 0, 0], outer_diameter_m: 0.1, wall_m: 0.004,
               young_pa: 70.0e+9, shear_pa: 26.0e+9}

A link that is not named is rigid, and so are all links of a robot without the file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import pinocchio as pin
from pydantic import ConfigDict, Field, model_validator

from cmbot.common.errors import ModelError
from cmbot.common.validation import FileModel, refusal, validated
from cmbot.common.yaml_reader import lines_named, read_yaml

__all__ = ["LinkTube", "read_elasticity"]

# The bounds keep every power of a length finite, and catch lengths in millimetres and moduli in gigapascals.
Coordinate = Annotated[float, Field(ge=-1e4, le=1e4)]
Length = Annotated[float, Field(ge=1e-5, le=1e4)]
Modulus = Annotated[float, Field(ge=1e3, le=1e13)]
Point = tuple[Coordinate, Coordinate, Coordinate]

_SHORTEST = 1e-3  # m


@dataclass(frozen=True, kw_only=True)
class LinkTube:
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
    outer_diameter: Annotated[Length, Field(alias="outer_diameter_m")]
    wall: Annotated[Length, Field(alias="wall_m")]
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
        if math.dist(self.start, self.end) < _SHORTEST:
            raise refusal("an end a millimetre or more apart from start_m", got=self.end, key=("end_m",))
        if 2 * self.wall > self.outer_diameter:
            raise refusal("at most half of outer_diameter_m", got=self.wall, key=("wall_m",))
        return self


class _ElasticityFile(FileModel):
    format: Literal["cmbot-elasticity/1"]
    links: dict[str, LinkTube]


def read_elasticity(path: Path, model: Any) -> dict[str, LinkTube]:
    """Read the tubes of the links that move with the arm, by the links' names, in the order of its joints.

    A tube of a link that the arm's joints do not move is checked and left out.
    """
    with lines_named(path):
        return _tubes(
            validated(_ElasticityFile, read_yaml(path, ModelError), str(path), ModelError), path, model
        )


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
