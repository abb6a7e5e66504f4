"""How the feet hold: the ``guardrail.hold:`` block, and the steel of members on which plates sit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, Literal, cast

import numpy as np
import shapely
from pydantic import Field, GetPydanticSchema, PlainSerializer, WrapValidator
from shapely.affinity import rotate, translate

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.poses import pose
from cmbot.common.reading.fields import (
    IN_REACH,
    Angle,
    Angles,
    Coordinate,
    Length,
    OneOf,
    Place,
    Sides,
    Text,
)
from cmbot.common.reading.validation import FileModel, refusal, shown
from cmbot.elastic import AngleSection, BarSection, FlatSection, Guardrail, Section, yield_moments
from cmbot.hold import MAGNET_PRESSURE, Contact, Foot, Gap

Load = Annotated[float, Field(ge=1e-3, le=1e9)]
FACES = {
    "post": {"outer": (0, 1, 0), "inner": (0, -1, 0), "right": (1, 0, 0), "left": (-1, 0, 0)},
    "rail": {"outer": (0, 1, 0), "inner": (0, -1, 0), "top": (0, 0, 1), "bottom": (0, 0, -1)},
}
"""Faces of a member by their normals."""

# Members closer than this to the foot are those that it holds, m.
_FOOT_MEMBER_DISTANCE_M = 1e-3
# A side of a section is flat where corners are less than this below its highest one, m.
_FLATNESS_M = 1e-6
# Yield stress of S235, Pa: members are of plain structural steel.
_YIELD_STRESS = 235e6
_Millimetres = Annotated[float, Field(ge=0, le=1e4)]
Derated = Annotated[tuple[_Millimetres, Annotated[float, Field(gt=0, le=1)]], Field(strict=False)]


class PadFile(OneOf):
    """A part of a foot's contact, in the frame of its plate."""

    one_of = ("rectangle_m", "disc_m")

    rectangle_m: Sides | None = None
    """Sides along and across, m."""
    disc_m: Annotated[Length, IN_REACH] | None = None
    """Diameter, m."""
    at_m: Annotated[tuple[Coordinate, Coordinate], IN_REACH] = (0.0, 0.0)
    """Its centre along and across, m."""
    turn_deg: Angle = 0.0
    """By which it is turned about its centre."""

    @property
    def region(self) -> shapely.Geometry:
        """Its outline; that of a disc has 24 sides and lies within it, 1.1 % of the area less."""
        if self.disc_m is not None:
            return shapely.Point(*self.at_m).buffer(self.disc_m / 2, quad_segs=6)
        along, across = (side / 2 for side in cast("tuple[float, float]", self.rectangle_m))
        turned = rotate(shapely.box(-along, -across, along, across), self.turn_deg, origin=(0, 0))
        return translate(turned, *self.at_m)


class HoldFile(FileModel):
    """How a foot holds; what is left out of its bounds is not checked."""

    kind: Literal["magnet", "clamp", "welded"]
    """``welded`` says nothing about whether it holds."""
    plate_m: Sides = (0.15, 0.13)
    """Sides of the plate along the member and across it, m."""
    pads: Annotated[tuple[PadFile, ...], Field(min_length=1, max_length=50)] | None = None
    """What is in contact, such as the three toes of a foot, in place of one plate."""
    friction: Annotated[float, Field(ge=1e-3, le=10)] = 0.4
    """Between plate and steel."""
    safety: Annotated[float, Field(ge=1, le=100)] = 2.0
    """Safety factor on the load of the foot, or on the adhesion that it needs."""
    adhesion_n: Load | None = None
    """Of each magnet: the pull that takes it off, N, with this paint, on thick steel or, without `derating`,
    on this one; see docs/hold.md."""
    gap: Gap = "allowed"
    """Whether a plate may lift at one side, until it tips, or no gap may open, as a magnet may need it."""
    derating: Annotated[tuple[Derated, ...], Field(min_length=1, max_length=100)] | None = None
    """Of a magnet: what share of `adhesion_n` is left on steel so many millimetres thick, ascending, from
    its data sheet; between two, in proportion."""
    air_gap_mm: _Millimetres | None = None
    """Of a magnet: paint, rust and scale under it."""
    air_gap_derating: Annotated[tuple[Derated, ...], Field(min_length=1, max_length=100)] | None = None
    """As `derating`, over `air_gap_mm`."""
    force_n: tuple[Load, Load, Load] | None = None
    """Of a clamp: the forces that it bears along the member, across it and out of the steel, N."""
    moment_nm: tuple[Load, Load, Load] | None = None
    """Of a clamp: the moments that it bears about these axes, Nm; a member that yields before bears less."""

    def _check(self) -> None:
        curves = ("derating", "air_gap_derating")
        magnet = ("adhesion_n", "air_gap_mm", *curves)
        of = dict.fromkeys(magnet, "magnet") | {"force_n": "clamp", "moment_nm": "clamp"}
        for name, kind in of.items():
            if getattr(self, name) is not None and self.kind != kind:
                raise refusal(f"no such key beside kind: {self.kind}", got=name, key=(name,))
        if (self.force_n is None) != (self.moment_nm is None):
            missing = "force_n" if self.force_n is None else "moment_nm"
            raise refusal("three numbers beside the other bound", got="nothing", key=(missing,))
        for name in curves:
            millimetres = [at for at, _ in getattr(self, name) or ()]
            if any(after <= before for before, after in pairwise(millimetres)):
                raise refusal("ascending millimetres", got=shown(millimetres), key=(name,))
            if millimetres and self.adhesion_n is None:
                raise refusal("the adhesion that it is a share of", got="nothing", key=("adhesion_n",))
        if (self.air_gap_mm is None) != (self.air_gap_derating is None):
            missing = "air_gap_mm" if self.air_gap_mm is None else "air_gap_derating"
            raise refusal("a value, as the other one is given", got="nothing", key=(missing,))

    @property
    def plate(self) -> shapely.Geometry:
        """What is in contact where there is steel all over."""
        if self.pads is not None:
            return shapely.union_all([pad.region for pad in self.pads])
        return shapely.box(*(-side / 2 for side in self.plate_m), *(side / 2 for side in self.plate_m))

    def adhesion_on(self, steel: float | None) -> float | None:
        """Return the adhesion, N, on steel so thick, m; None: not known how thick."""
        adhesion = self.adhesion_n
        curves = (
            (None if steel is None else 1e3 * steel, self.derating),
            (self.air_gap_mm, self.air_gap_derating),
        )
        for at, curve in curves:
            if adhesion is not None and at is not None and curve is not None:
                adhesion *= float(np.interp(at, *np.array(curve).T))
        return adhesion


def _one_or_more(value: Any, one: Any) -> tuple[HoldFile, ...]:
    """What `one` makes of a mapping, or of those of a list: one error, where a union would have several."""
    if isinstance(value, HoldFile | dict):
        return (one(_with_tuples(value)),)
    if not isinstance(value, list | tuple) or not 1 <= len(value) <= 2:
        raise refusal("how a foot holds, or a list of that for two feet", got=shown(value))
    return tuple(one(_with_tuples(item)) for item in value)


def _with_tuples(value: Any) -> Any:
    """What has tuples for lists: past a validator pydantic no longer knows that it came from JSON."""
    if isinstance(value, dict):
        return {key: _with_tuples(item) for key, item in value.items()}
    return tuple(map(_with_tuples, value)) if isinstance(value, list) else value


def _as_data(holds: Any) -> Any:
    data = [hold.model_dump(mode="json", exclude_none=True) for hold in holds]
    return data[0] if len(data) == 1 else data


def _json_schema(schema: Any, handler: Any) -> dict[str, Any]:
    one = handler(schema)
    # The mapping first: messages name its keys.
    return {"anyOf": [one, {"type": "array", "items": one, "minItems": 1, "maxItems": 2}]}


Holds = Annotated[
    tuple[HoldFile, ...],
    GetPydanticSchema(
        lambda _, handler: handler(
            Annotated[HoldFile, WrapValidator(_one_or_more), PlainSerializer(_as_data)]
        ),
        _json_schema,
    ),
]
"""How each foot holds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Face:
    """A side of a member.

    Attributes
    ----------
    axes : (3, 3)
        Rows in W: along the member, across it, out of the steel.
    depth : float, m
        From the member's axis to the face.
    steel : tuple of two floats, m
        Where across the member there is steel on that face, from its axis: from and to; none on a round bar
        and on a corner.
    thickness : float or None, m
        Of the steel below; None without a flat face.
    ends : two floats, m
        Along the member, as its coordinate in W.
    section : Section
        Of the member.
    """

    axes: FloatArray
    depth: float
    steel: tuple[tuple[float, float], ...]
    thickness: float | None
    ends: tuple[float, float]
    section: Section

    @property
    def edge(self) -> bool:
        """Whether the steel is no wider than it is thick: the edge of a leg."""
        width = max((high - low for low, high in self.steel), default=0.0)
        return self.thickness is not None and width <= self.thickness + _FLATNESS_M

    @property
    def held_by_clamps_alone(self) -> str:
        """What of it takes clamps only, as words; empty where a magnet has a face."""
        if self.edge:
            return f"the edge of a leg, {1e3 * (self.thickness or 0.0):g} mm wide"
        return "" if self.steel else "a round bar or a corner"


def face_of(guardrail: Guardrail, member: str, face: str) -> Face:
    """Return a face of a member, by the member's name and that of the face in `FACES`.

    Parameters
    ----------
    guardrail : Guardrail
        That has the member.
    member, face : str
    """
    posts = {f"post_{number}": x for number, x in enumerate(guardrail.post_positions, start=1)}
    if member in posts:
        section, roll, along = guardrail.post.section, guardrail.post.roll, (0, 0, 1)
        ends = (guardrail.post.bottom, guardrail.post.top)
    else:
        ((section, roll),) = ((each.section, each.roll) for each in guardrail.rails if each.name == member)
        along, ends = (1, 0, 0), (guardrail.post_positions[0], guardrail.post_positions[-1])
    normal = FACES["post" if member in posts else "rail"][face]
    axes = _axes(along, normal)
    steel: tuple[tuple[float, float], ...] = ()
    if isinstance(section, BarSection):
        depth, thickness = section.diameter / 2, None
    else:
        # A section lies in the plane of x and y of a post, of y and z of a rail.
        plane = np.array([[1, 0, 0], [0, 1, 0]] if member in posts else [[0, 1, 0], [0, 0, 1]])
        depth, steel = _flat_side(section, roll, tuple(plane @ axes[1]), tuple(plane @ axes[2]))
        thickness = section.thickness if steel else None
    return Face(axes=axes, depth=depth, steel=steel, thickness=thickness, ends=ends, section=section)


def section_outline(section: AngleSection | FlatSection) -> shapely.Polygon:
    """Return the outline of an angle, its legs along both axes, or of a flat bar, about its box's middle."""
    if isinstance(section, FlatSection):
        b, t = section.width / 2, section.thickness / 2
        return shapely.Polygon([(-b, -t), (b, -t), (b, t), (-b, t)])
    low, high, inner = -section.leg / 2, section.leg / 2, -section.leg / 2 + section.thickness
    return shapely.Polygon(
        [(low, low), (high, low), (high, inner), (inner, inner), (inner, high), (low, high)]
    )


@cache
def _flat_side(
    section: AngleSection | FlatSection, roll: float, across: tuple[float, float], out: tuple[float, float]
) -> tuple[float, tuple[tuple[float, float], ...]]:
    """How far a turned section reaches `out`, m, and from where to where, `across`, it is flat there."""
    c, s = np.cos(roll), np.sin(roll)
    corners = np.array(section_outline(section).exterior.coords) @ np.array([[c, s], [-s, c]])
    height, place = corners @ out, corners @ across
    on = height >= height.max() - _FLATNESS_M
    sides = sorted(tuple(sorted(place[[k, k + 1]].tolist())) for k in np.flatnonzero(on[:-1] & on[1:]))
    return float(height.max()), tuple((low, high) for low, high in sides if high - low > _FLATNESS_M)


@cache
def _axes(along: tuple[int, int, int], normal: tuple[int, int, int]) -> FloatArray:
    return read_only(np.array([along, np.cross(normal, along), normal], dtype=float))


def foot_on(face: Face, at: FloatArray, hold: HoldFile, foot_point: FloatArray, share: FloatArray) -> Foot:
    """Return the foot whose plate is centred on a face; its contact is the steel that lies under the plate.

    A clamp bears no more than the moments at which the member yields.

    Parameters
    ----------
    face : Face
    at : (3,), m
        On the member's axis, in W.
    hold : HoldFile
    foot_point : (3,), m
        O0 in W.
    share : (6, 6)
        Of the whole wrench about O0.
    """
    along, _, out = face.axes
    place = float(along @ at)
    low, high = (end - place for end in face.ends)
    strips = [shapely.box(low, first, high, last) for first, last in face.steel]
    region = shapely.intersection(hold.plate, shapely.union_all(strips))
    foot = _foot(hold, region, face.axes, at - foot_point + face.depth * out, share, face.thickness)
    if foot.moment is None:
        return foot
    # A moment divides among the member's two sides.
    twist, bend = (2 * moment for moment in yield_moments(face.section, _YIELD_STRESS))
    about_along, about_across, about_out = foot.moment
    return replace(foot, moment=(min(about_along, twist), min(about_across, bend), min(about_out, bend)))


def _foot(
    hold: HoldFile,
    region: shapely.Geometry,
    axes: FloatArray,
    origin: FloatArray,
    share: FloatArray,
    steel: float | None,
) -> Foot:
    """The foot whose contact is a region about an origin (3,), m, from O0; `axes` are those of `Foot`."""
    contact, centre = (None, np.zeros(2)) if region.is_empty else Contact.of(region)
    return Foot(
        kind=hold.kind,
        centre=read_only(origin + centre @ axes[:2]),
        axes=axes,
        contact=contact,
        friction=hold.friction,
        safety=hold.safety,
        gap=hold.gap,
        adhesion=hold.adhesion_on(steel),
        steel=steel,
        force=hold.force_n,
        moment=hold.moment_nm,
        share=read_only(share),
    )


class LinkHoldFile(HoldFile):
    """How a link of a robot that holds no guardrail is held: a flat contact with what it stands on."""

    link: Text | None = None
    """The link, which the arm's joints do not move; left out: the arm's base frame."""
    xyz: Place = (0.0, 0.0, 0.0)
    """Centre of the plate in the link's frame, m."""
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    """Its turn in the link's frame: x along, y across, z away from what the plate holds."""
    steel_mm: Annotated[float, Field(ge=0.01, le=1e4)] | None = None
    """Thickness of the steel that a magnet holds, for `derating` and what two poles pull; left out: thick."""

    def _check(self) -> None:
        super()._check()
        most = MAGNET_PRESSURE * self.plate.area
        if self.adhesion_n is not None and self.adhesion_n > most:
            expected = f"at most {most:.0f} N, 1.6 MPa on the contact of {1e4 * self.plate.area:.0f} cm2"
            raise refusal(expected, got=f"{self.adhesion_n:g} N", key=("adhesion_n",))

    def foot(self, X_WL: FloatArray, foot_point: FloatArray) -> Foot:
        """Return the foot.

        Parameters
        ----------
        X_WL : (4, 4)
            Pose of the link in W.
        foot_point : (3,), m
            O0 in W.
        """
        X = X_WL @ pose(self.xyz, np.radians(self.rpy_deg))
        steel = None if self.steel_mm is None else 1e-3 * self.steel_mm
        return _foot(self, self.plate, read_only(X[:3, :3].T.copy()), X[:3, 3] - foot_point, np.eye(6), steel)


def held_member(guardrail: Guardrail) -> str | None:
    """Return the member that the foot holds at the origin of W; None without one."""
    for number, x in enumerate(guardrail.post_positions, start=1):
        if abs(x) <= _FOOT_MEMBER_DISTANCE_M:
            return f"post_{number}"
    if not guardrail.post_positions:
        return None
    return next((rail.name for rail in guardrail.rails if abs(rail.height) <= _FOOT_MEMBER_DISTANCE_M), None)
