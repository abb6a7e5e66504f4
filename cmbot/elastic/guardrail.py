"""The guardrail as data: posts, rails, sections, material."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.representation import short_repr


@dataclass(frozen=True, kw_only=True)
class AngleSection:
    """Equal-leg angle steel: `leg` and `thickness`, m."""

    leg: float
    thickness: float


@dataclass(frozen=True, kw_only=True)
class BarSection:
    """A round bar: `diameter`, m."""

    diameter: float


@dataclass(frozen=True, kw_only=True)
class FlatSection:
    """A flat bar, such as a girder's flange: `width` along its first axis, `thickness`, m."""

    width: float
    thickness: float


Section = AngleSection | BarSection | FlatSection


@dataclass(frozen=True, kw_only=True)
class Post:
    """All posts are alike; the axis of a post runs along z at y = 0.

    Attributes
    ----------
    section : AngleSection, BarSection or FlatSection
    roll : float
        Rotation of the section about z, rad; at 0 the legs of an angle point along +x and +y.
    bottom, clamp, top : float
        z of the lower end, of the end of the rigid hold, of the upper end, m.
    box : tuple of float
        (2,), collision box along x and y, m.
    """

    section: Section
    roll: float
    bottom: float
    clamp: float
    top: float
    box: tuple[float, float]

    __repr__ = short_repr


@dataclass(frozen=True, kw_only=True)
class Rail:
    """A member along x at y = 0, from the first post to the last.

    Attributes
    ----------
    name : str
    section : AngleSection, BarSection or FlatSection
    roll : float
        Rotation of the section about x, rad; at 0 the legs of an angle point along +y and +z.
    height : float
        z, m.
    box : tuple of float
        (2,), collision box along y and z, m.
    workpiece : bool
        The tool works on it, so it may come close.
    """

    name: str
    section: Section
    roll: float
    height: float
    box: tuple[float, float]
    workpiece: bool = False

    __repr__ = short_repr


@dataclass(frozen=True, kw_only=True)
class GuardrailMaterial:
    """Material of all members: `young` and `shear` modulus, Pa; `density`, kg/m3."""

    young: float
    shear: float
    density: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Guardrail:
    """A row of posts with rails, and where the feet hold it.

    Attributes
    ----------
    post_positions : tuple of float
        (bays + 1,), x of each post in W, m; empty: there is no guardrail to collide with.
    post : Post
    rails : tuple of Rail
    material : GuardrailMaterial
    stiffness : array or None
        (6, 6), at O0, in W, linear then angular (N/m, N/rad, Nm/rad), in place of the frame's
        own; read-only. None: the frame's, and without posts the hold is rigid.
    mass : array or None
        (6, 6), moves with the foot beside a given `stiffness`; read-only. None: no such mass.
    damping : array or None
        (6, 6), of the foot's rates beside a given `stiffness`; read-only. None: no damping of its own.
    stiffness_factor : float
        On the frame's own stiffness.
    foot_point : three floats, m
        O0 in W, the origin of foot 1.
    footholds : tuple of three floats, m
        Points in W on the axes of the members that the feet hold, foot 1 first.
    leg_compliance : array or None
        (k, 6, 6), of the robot's legs between each foot and the arm's base, about O0; None: they are rigid.
    """

    post_positions: tuple[float, ...]
    post: Post
    rails: tuple[Rail, ...]
    material: GuardrailMaterial
    stiffness: FloatArray | None
    mass: FloatArray | None
    foot_point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    footholds: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)
    stiffness_factor: float = 1.0
    damping: FloatArray | None = None
    leg_compliance: FloatArray | None = None

    __repr__ = short_repr

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Guardrail) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @property
    def _content(self) -> tuple[object, ...]:
        each = (getattr(self, field.name) for field in fields(self))
        return tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in each)
