"""The guardrail of a scene: the ``guardrail:`` block of the file, as data, and as obstacles.

Every default is an assumption of ours, see docs/assumptions.md: the paper gives no dimension of the bridge.
All coordinates are in W, whose origin is where the foot holds: x along the guardrail, y outward, z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, cast

import numpy as np
from pydantic import Field

from cmbot.collision import Box, Obstacle
from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.poses import pose
from cmbot.common.reading.fields import (
    LONGEST_TUBE_M,
    MILLIMETRES,
    Angle,
    Coordinate,
    Length,
    Modulus,
    OneOf,
    Slug,
    Thickness,
    no_thousands,
    si_fields,
)
from cmbot.common.reading.validation import FileModel, refusal, shown
from cmbot.elastic import (
    AngleSection,
    BarSection,
    FlatSection,
    Guardrail,
    GuardrailMaterial,
    Post,
    Rail,
    Section,
    shares,
)
from cmbot.hold import MAGNET_PRESSURE, Foot
from cmbot.scene.base.hold import Face, HoldFile, Holds, face_of, foot_on, held_member
from cmbot.scene.base.identified import IdentifiedBase
from cmbot.scene.base.matrices import Mass6, Matrix6, Stiffness6
from cmbot.scene.base.stance import StanceFile, axis_point, foothold_face, foothold_pose


class SectionFile(OneOf):
    """Cross-section of a member: exactly one of angle, bar and flat."""

    one_of = ("angle", "bar", "flat")

    angle: tuple[Thickness, Thickness] | None = None
    """Equal-leg angle steel: [leg, thickness], m."""
    bar: Thickness | None = None
    """Round bar: diameter, m."""
    flat: tuple[Thickness, Thickness] | None = None
    """Flat bar: [width, thickness], m; at roll 0 the width of a rail is along y."""

    def _check(self) -> None:
        super()._check()
        for key, sides in (("angle", self.angle), ("flat", self.flat)):
            if sides is not None and sides[1] >= sides[0]:
                whole = "leg" if key == "angle" else "width"
                raise refusal(f"a thickness below the {whole}", got=sides, key=(key,))

    def section(self) -> Section:
        """Return the section as data."""
        if self.angle is not None:
            return AngleSection(leg=self.angle[0], thickness=self.angle[1])
        if self.flat is not None:
            return FlatSection(width=self.flat[0], thickness=self.flat[1])
        return BarSection(diameter=cast("float", self.bar))  # `_check` lets exactly one through


class PostFile(FileModel):
    """Every post; its axis runs along z."""

    section: SectionFile = SectionFile(angle=(0.075, 0.008))
    roll_deg: Angle = 180.0
    """Turn of the section about z; at 0 the legs of an angle point along +x and +y, at 180 its closed sides
    are the outer and the right one."""
    bottom_m: Coordinate = -1.10
    """z of the lower end."""
    clamp_m: Coordinate = -1.05
    """z up to which the post is held rigidly."""
    top_m: Coordinate = 0.05
    """z of the upper end."""
    box_m: tuple[Length, Length] = (0.075, 0.075)
    """Collision box along x and y, m."""

    def _check(self) -> None:
        if not self.bottom_m <= self.clamp_m < self.top_m:
            expected = "a height from bottom_m up to below top_m"
            raise refusal(expected, got=self.clamp_m, key=("clamp_m",))


class RailFile(FileModel):
    """A member along x, from the first post to the last."""

    name: Slug
    section: SectionFile
    roll_deg: Angle = 0.0
    """Turn of the section about x; at 0 the legs of an angle point along +y and +z."""
    height_m: Coordinate
    """z of the member."""
    box_m: tuple[Length, Length]
    """Collision box along y and z, m."""
    workpiece: bool = False
    """The tool works on it, up to the safety margin."""


class FootFile(FileModel):
    """Where the foot holds; that point is the origin of W."""

    post: Annotated[int, Field(ge=1, le=101)] | None = None
    """The post that the foot holds, counted from 1 along x; left out: the middle one."""
    offset_m: Coordinate = 0.0
    """How far along x from that post the foot holds, m; other than 0, it holds the rail at height 0."""


class MaterialFile(FileModel):
    """Material of all members; steel by default."""

    young_pa: Modulus = 206e9
    """Young's modulus, Pa."""
    shear_pa: Modulus = 79e9
    """Shear modulus, Pa."""
    density_kg_m3: Annotated[float, Field(ge=0, le=1e5)] = 7850.0
    """Density, kg/m3."""


_RAIL_MEMBERS = (
    RailFile(
        name="top_rail",
        section=SectionFile(angle=(0.063, 0.006)),
        roll_deg=180.0,
        height_m=0.0,
        box_m=(0.06, 0.06),
    ),
    RailFile(name="bar_1", section=SectionFile(bar=0.020), height_m=-0.45, box_m=(0.04, 0.04)),
    RailFile(name="bar_2", section=SectionFile(bar=0.020), height_m=-0.80, box_m=(0.04, 0.04)),
)


class GuardrailFile(FileModel):
    """The guardrail that the robot holds, as an obstacle and as an elastic base.

    Left out, or ``{}``: the guardrail of docs/assumptions.md. ``{bays: 0}``: no obstacle, and a rigid base
    unless `stiffness` is given.
    """

    bays: Annotated[int, Field(ge=0, le=100)] = 4
    """Fields between posts; 0: no guardrail."""
    post_spacing_m: Annotated[Length, no_thousands(LONGEST_TUBE_M, MILLIMETRES)] = 1.75
    """Distance from post to post, m."""
    post: PostFile = PostFile()
    rails: Annotated[tuple[RailFile, ...], Field(max_length=100)] = _RAIL_MEMBERS
    foot: FootFile = FootFile()
    hold: Holds | None = None
    """How the feet hold; left out: welded."""
    stance: StanceFile | None = None
    """Where the feet hold, in place of `foot`, which then says where W is: at that post. With
    ``model: cmbot``."""
    material: MaterialFile = MaterialFile()
    stiffness: Stiffness6 | None = None
    """6 x 6 stiffness at the origin of W, linear then angular (N/m, N/rad, Nm/rad), or the 6 numbers of its
    diagonal; left out: the frame's. Beside it `stance.foot_2` has to be free."""
    stiffness_factor: Annotated[float, Field(ge=1e-3, le=1e3)] | None = None
    """Factor on the frame's stiffness; left out: 1."""
    mass: Mass6 | None = None
    """6 x 6 mass that moves with the foot, beside `stiffness`; left out: none."""

    @property
    def foot_post(self) -> int:
        """The post that the foot holds, counted from 1."""
        return self.foot.post if self.foot.post is not None else self.bays // 2 + 1

    @property
    def member_names(self) -> tuple[str, ...]:
        """Names of the rails, then of the posts ``post_1``, …; none without bays."""
        if self.bays == 0:
            return ()
        posts = (f"post_{number}" for number in range(1, self.bays + 2))
        return (*(rail.name for rail in self.rails), *posts)

    def _check(self) -> None:
        if self.bays > 0:
            self._check_rails()
            self._check_foot()
        if self.stance is not None:
            self._check_stance(self.stance)
        self._check_hold()
        if self.stiffness_factor is not None and (self.stiffness is not None or not self.bays):
            got = "a factor beside it" if self.stiffness is not None else "a factor"
            raise refusal("posts whose stiffness it is of", got=got, key=("stiffness_factor",))

    def _check_rails(self) -> None:
        names = self.member_names
        for index, rail in enumerate(self.rails):
            if names.count(rail.name) > 1:
                expected = "a name that no other rail or post has"
                raise refusal(expected, got=rail.name, key=("rails", index, "name"))
            if not self.post.clamp_m < rail.height_m <= self.post.top_m:
                expected = "a height above the post's clamp_m, up to its top_m"
                raise refusal(expected, got=rail.height_m, key=("rails", index, "height_m"))

    def _check_foot(self) -> None:
        foot = self.foot_post
        if foot > self.bays + 1:
            raise refusal(f"one of the {self.bays + 1} posts", got=foot, key=("foot", "post"))
        offset = self.foot.offset_m
        along = (foot - 1) * self.post_spacing_m + offset
        if not 0 <= along <= self.bays * self.post_spacing_m:
            raise refusal("a place on the guardrail", got=offset, key=("foot", "offset_m"))
        if self.stiffness is not None:
            return
        if not self.post.clamp_m < 0 <= self.post.top_m:
            expected = "posts that pass height 0, where the foot holds"
            raise refusal(expected, got=f"{self.post.clamp_m} to {self.post.top_m}", key=("post",))
        if offset != 0 and all(rail.height_m != 0 for rail in self.rails):
            expected = "0, as there is no rail at height 0 to hold"
            raise refusal(expected, got=offset, key=("foot", "offset_m"))

    def _check_stance(self, stance: StanceFile) -> None:
        each = [("foot_1", stance.foot_1), ("foot_2", stance.foot_2)]
        for name, place in each:
            if place is None:
                continue
            if place.member not in self.member_names:
                choices = self.member_names
                key = ("stance", name, "member")
                raise refusal("a rail or post", got=shown(place.member), key=key, choices=choices)
            face = face_of(_without_feet(self), place.member, place.face)
            if place.along_m > face.ends[1] - face.ends[0]:
                expected = f"at most the member's length, {face.ends[1] - face.ends[0]:g}"
                raise refusal(expected, got=place.along_m, key=("stance", name, "along_m"))
            clamped = face.axes[0, 2] and face.ends[0] + place.along_m <= self.post.clamp_m
            if clamped and self.stiffness is None:
                expected = f"above clamp_m, {self.post.clamp_m - face.ends[0]:g} along the post"
                raise refusal(expected, got=place.along_m, key=("stance", name, "along_m"))
        if stance.foot_2 is not None and self.stiffness is not None:
            raise refusal("free, beside a given stiffness", got="a place", key=("stance", "foot_2"))

    def hold_of(self, foot: int) -> HoldFile:
        """Return how a foot holds, 0 or 1: two feet that are described once are alike."""
        holds = self.hold or (HoldFile(kind="welded"),)
        return holds[min(foot, len(holds) - 1)]

    def _check_hold(self) -> None:
        places = _held_faces(self)
        if self.hold is not None and len(self.hold) > max(len(places), 1):
            raise refusal("one foot", got="a list of two", key=("hold",))
        for hold, held in zip(self.hold or (), [*places, None], strict=False):
            if hold.kind != "welded" and held is None:
                expected = "welded, as there is no member to hold"
                raise refusal(expected, got=hold.kind, key=("hold", "kind"))
            if hold.kind == "magnet" and held is not None:
                self._check_magnet(hold, *held)

    def _check_magnet(self, hold: HoldFile, face: Face, at: FloatArray) -> None:
        if alone := face.held_by_clamps_alone:
            expected = f"clamp or welded, as the foot holds {alone} (another face or roll_deg?)"
            raise refusal(expected, got=hold.kind, key=("hold", "kind"))
        contact = foot_on(face, at, hold, np.zeros(3), np.eye(6)).contact
        if contact is not None and hold.adhesion_n is not None:
            most = MAGNET_PRESSURE * contact.area
            if hold.adhesion_n > most:
                expected = f"at most {most:.0f} N, 1.6 MPa on the contact of {1e4 * contact.area:.0f} cm2"
                raise refusal(expected, got=f"{hold.adhesion_n:g} N", key=("hold", "adhesion_n"))


def _held_faces(file: GuardrailFile) -> list[tuple[Face, FloatArray]]:
    """The face of each foot, and where on the member's axis it holds, (3,), m, in W."""
    guardrail = _without_feet(file)
    if file.stance is None:
        member = held_member(guardrail)
        return [] if member is None else [(face_of(guardrail, member, "outer"), np.zeros(3))]
    held = file.stance.held
    return [(foothold_face(guardrail, place), axis_point(guardrail, place)) for place in held]


def feet_of(file: GuardrailFile) -> tuple[Foot, ...]:
    """Return the feet of a robot that holds a guardrail; none where there is no member."""
    guardrail, faces = elastic_guardrail(file), _held_faces(file)
    return _feet(file, faces, np.array(guardrail.foot_point), shares(guardrail)) if faces else ()


def feet_at(
    file: GuardrailFile, stance: StanceFile, guardrail: Guardrail, each: Sequence[FloatArray]
) -> tuple[Foot, ...]:
    """Return the feet in another stance than that of the file, with their shares (6, 6) of the wrench."""
    faces = [(foothold_face(guardrail, place), axis_point(guardrail, place)) for place in stance.held]
    return _feet(file, faces, foothold_pose(guardrail, stance.foot_1)[:3, 3], each)


def _feet(
    file: GuardrailFile,
    faces: Sequence[tuple[Face, FloatArray]],
    foot_point: FloatArray,
    each: Sequence[FloatArray],
) -> tuple[Foot, ...]:
    return tuple(
        foot_on(face, point, file.hold_of(k), foot_point, each[k]) for k, (face, point) in enumerate(faces)
    )


@lru_cache(maxsize=256)
def elastic_guardrail(file: GuardrailFile, identified: IdentifiedBase | None = None) -> Guardrail:
    """Return the guardrail that a scene file describes, in SI units and radians.

    Parameters
    ----------
    file : GuardrailFile
    identified : IdentifiedBase, optional
        Its stiffness and mass take the place of the file's.
    """
    guardrail = _without_feet(file)
    if identified is not None:
        guardrail = replace(
            guardrail,
            stiffness=_matrix(identified.stiffness),
            mass=_matrix(identified.mass),
            stiffness_factor=1.0,
        )
    if file.stance is None:
        return guardrail
    foot_1 = foothold_pose(guardrail, file.stance.foot_1)[:3, 3]
    footholds = (tuple(point.tolist()) for _, point in _held_faces(file))
    return replace(guardrail, foot_point=tuple(foot_1.tolist()), footholds=tuple(footholds))


def _without_feet(file: GuardrailFile) -> Guardrail:
    """The guardrail, held at the origin of W."""
    first = -(file.foot_post - 1) * file.post_spacing_m - file.foot.offset_m
    count = file.bays + 1 if file.bays else 0
    return Guardrail(
        post_positions=tuple(first + index * file.post_spacing_m for index in range(count)),
        post=Post(**si_fields(file.post) | {"section": file.post.section.section()}),
        rails=tuple(
            Rail(**si_fields(rail) | {"section": rail.section.section()})
            for rail in (file.rails if count else ())
        ),
        material=GuardrailMaterial(**si_fields(file.material)),
        stiffness=_matrix(file.stiffness),
        mass=_matrix(file.mass),
        stiffness_factor=file.stiffness_factor or 1.0,
    )


@lru_cache(maxsize=256)
def guardrail_obstacles(guardrail: Guardrail) -> tuple[Obstacle, ...]:
    """Return the boxes of the rails, by their names, and of the posts ``post_1``, ``post_2``, … along x."""
    positions, post = guardrail.post_positions, guardrail.post
    if not positions:
        return ()
    middle, length = (positions[0] + positions[-1]) / 2, positions[-1] - positions[0]
    rails = (
        Obstacle(
            name=rail.name,
            shape=Box(size=(length, *rail.box)),
            X_WO=pose((middle, 0.0, rail.height)),
            workpiece=rail.workpiece,
        )
        for rail in guardrail.rails
    )
    size, height = (*post.box, post.top - post.bottom), (post.top + post.bottom) / 2
    posts = (
        Obstacle(name=f"post_{number}", shape=Box(size=size), X_WO=pose((x, 0.0, height)))
        for number, x in enumerate(positions, start=1)
    )
    return (*rails, *posts)


def _matrix(rows: Matrix6 | None) -> FloatArray | None:
    return None if rows is None else read_only(np.array(rows))
