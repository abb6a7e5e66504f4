"""Where the feet hold: the ``guardrail.stance:`` block, and the climber's posture that follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PlainSerializer, WrapValidator

from cmbot.collision import Box
from cmbot.common.arrays import FloatArray, cross
from cmbot.common.poses import turned_pose
from cmbot.common.reading.fields import Angle, Coordinate, Slug, Vector, read_as
from cmbot.common.reading.validation import CheckedFields, FileModel, refusal, shown
from cmbot.elastic import Guardrail
from cmbot.scene.base.hold import FACES, Face, face_of

# From the foot's frame to its plate, m: the frame lies on the centre line of the post that is held.
PLATE_OFFSET_M = 0.0375
LIFT_M = 0.06
"""How far a foot is lifted off along the normal of the face before it swings, m."""

# The foot in its frame, as the URDF has it, m: sides, and its centre above the member's axis.
_FOOT_M, _FOOT_CENTRE_M = (0.13, 0.05, 0.15), 0.065
_QUARTER_TURNS_DEG = (0.0, 90.0, 180.0, 270.0, -90.0, -180.0, -270.0)
# How far a given climber may miss the place of foot 2, m and rad.
_REACHED = 1e-4
Joint = Annotated[float, Field(ge=-360, le=360)]


class FootholdFile(FileModel):
    """Where a foot holds."""

    member: Slug
    """A rail by its name, or a post: ``post_1``, …"""
    along_m: Annotated[Coordinate, Field(ge=0)]
    """How far along the member, from its lower end or from the first post, m."""
    face: Literal["outer", "inner", "left", "right", "top", "bottom"] = "outer"
    """Side of the member; left and right are those of posts, top and bottom those of rails."""
    turn_deg: Angle = 0.0
    """By which the foot is turned about the face's normal, a multiple of 90; at 0 its z axis is along the
    member."""

    def _check(self) -> None:
        if self.turn_deg not in _QUARTER_TURNS_DEG:
            raise refusal("a multiple of 90 within a turn", got=self.turn_deg, key=("turn_deg",))
        kind = "post" if self.member.startswith("post_") else "rail"
        if self.face not in FACES[kind]:
            choices = tuple(FACES[kind])
            raise refusal(f"a face of a {kind}", got=shown(self.face), key=("face",), choices=choices)

    @property
    def in_words(self) -> str:
        """Where it is."""
        return f"{self.member} at {self.along_m:.2f} m ({self.face})"


def _place_or_free(value: Any, place: Any) -> Any:
    """Nothing for ``free``, or what `place` makes of a mapping: one error, not those of a union."""
    if value == "free" or value is None:
        return None
    if isinstance(value, dict | FootholdFile):
        return place(value)
    raise refusal("where the foot holds, or free", got=shown(value))


PlaceOrFree = Annotated[
    FootholdFile | None,
    read_as(
        Annotated[
            FootholdFile,
            WrapValidator(_place_or_free),
            PlainSerializer(lambda place: "free" if place is None else place.model_dump()),
        ],
        ("free",),
    ),
]


class StanceFile(FileModel):
    """Where the feet hold the guardrail; the arm's base goes with the climbing joints."""

    foot_1: FootholdFile
    """O0 is where this foot holds."""
    foot_2: PlaceOrFree = None
    """``free``: it holds nothing."""
    climber_deg: tuple[Joint, Joint, Joint, Joint, Joint] | None = None
    """Angles of the climbing joints, foot 1 to foot 2. Left out: with foot 2 free the working stance, turned
    so that the base hangs; else that of the postures with foot 2 in place in which it hangs most nearly."""

    @property
    def places(self) -> tuple[FootholdFile, FootholdFile | None]:
        """Where foot 1 and foot 2 hold; None: that is free."""
        return self.foot_1, self.foot_2

    @property
    def held(self) -> tuple[FootholdFile, ...]:
        """The places that feet hold, that of foot 1 first."""
        return tuple(place for place in self.places if place is not None)


@dataclass(frozen=True, kw_only=True)
class Stance(CheckedFields):
    """Where the robot stands.

    Attributes
    ----------
    foot : three floats, m
        O0, the origin of foot 1 in W.
    rotation : three times three floats
        Rows of the rotation of foot 1 in W; its y axis points out of the steel.
    climber : five floats, rad
        Angles of the climbing joints.
    """

    foot: Vector
    rotation: tuple[Vector, Vector, Vector]
    climber: tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate]

    @classmethod
    def of(cls, X: FloatArray, angles: FloatArray) -> Stance:
        """Return it from the pose (4, 4) of foot 1 and the angles (5,), rad."""
        rows: Any = tuple(tuple(row) for row in X[:3, :3].tolist())
        return cls(foot=tuple(X[:3, 3].tolist()), rotation=rows, climber=tuple(angles.tolist()))

    @property
    def root(self) -> FloatArray:
        """Pose (4, 4) of foot 1 in W."""
        return turned_pose(self.foot, self.rotation)

    @property
    def locked(self) -> dict[str, float]:
        """The climbing joints' angles, rad, by their names."""
        return {f"climb_{number}": angle for number, angle in enumerate(self.climber, start=1)}


def foothold_face(guardrail: Guardrail, place: FootholdFile) -> Face:
    """Return the face that a foot holds."""
    return face_of(guardrail, place.member, place.face)


def axis_point(guardrail: Guardrail, place: FootholdFile) -> FloatArray:
    """Return where on its axis a foot holds a member, (3,), m, in W."""
    face = foothold_face(guardrail, place)
    point = (face.ends[0] + place.along_m) * face.axes[0]
    if face.axes[0, 2]:
        point[0] = guardrail.post_positions[int(place.member.removeprefix("post_")) - 1]
    else:
        (point[2],) = (rail.height for rail in guardrail.rails if rail.name == place.member)
    return np.asarray(point)


def foothold_pose(guardrail: Guardrail, place: FootholdFile) -> FloatArray:
    """Return the pose (4, 4) in W of a foot that holds there."""
    face = foothold_face(guardrail, place)
    along, _, out = face.axes
    turn = np.radians(place.turn_deg)
    z = np.round(np.cos(turn)) * along + np.round(np.sin(turn)) * cross(out, along)
    point = axis_point(guardrail, place) + (face.depth - PLATE_OFFSET_M) * out
    return turned_pose(point, np.column_stack([cross(out, z), out, z]))


def swept_foot(guardrail: Guardrail, place: FootholdFile) -> tuple[Box, FloatArray]:
    """Return the box that a foot takes where it holds and as it is lifted, and its pose (4, 4) in W."""
    X = foothold_pose(guardrail, place)
    X[:3, 3] += (_FOOT_CENTRE_M + LIFT_M / 2) * X[:3, 1]
    return Box(size=(_FOOT_M[0], _FOOT_M[1] + LIFT_M, _FOOT_M[2])), X


@lru_cache(maxsize=256)
def resolved_stance(file: StanceFile, guardrail: Guardrail) -> Stance:
    """Return where the robot stands: both feet, and the climber's posture.

    Raises
    ------
    PydanticCustomError
        When the climber reaches no such stance.
    """
    # Not above: scenes without a stance are read without pinocchio.
    from cmbot.robot import Climber

    climber, X = Climber(), foothold_pose(guardrail, file.foot_1)
    goal = None if file.foot_2 is None else np.linalg.inv(X) @ foothold_pose(guardrail, file.foot_2)
    key = ("guardrail", "stance")
    if file.climber_deg is not None:
        angles = np.radians(file.climber_deg)
        for k in np.flatnonzero((angles < climber.lower) | (angles > climber.upper))[:1].tolist():
            low, high = (np.degrees(bound[k]) for bound in (climber.lower, climber.upper))
            expected = f"an angle from {low:.1f} to {high:.1f} deg"
            raise refusal(expected, got=f"{file.climber_deg[k]}", key=(*key, "climber_deg", k))
        if goal is not None and (off := float(np.abs(climber.poses(angles)[0] - goal).max())) > _REACHED:
            got, expected = f"a posture that misses foot_2 by {off:.3g} m or rad", "one that reaches it"
            raise refusal(expected, got=got, key=(*key, "climber_deg"))
    elif goal is None:
        hanging = climber.hanging(X[:3, :3])
        if hanging is None:
            expected = "a foot on which the arm's base can hang (another turn_deg), or climber_deg"
            if abs(X[2, 1]) > _REACHED:
                expected = (
                    "a place for foot_2, too, or climber_deg: from a top or bottom no base hangs by itself"
                )
            raise refusal(expected, got=shown(file.foot_1.model_dump()), key=(*key, "foot_1"))
        angles = hanging
    else:
        found = climber.reaching(goal)
        if not found:
            expected = "a place that the climber reaches from foot_1, on a face with the same normal"
            raise refusal(expected, got=shown(file.foot_2 and file.foot_2.member), key=(*key, "foot_2"))
        angles = min(found, key=lambda each: _uprightness(X @ climber.poses(each)[1], X[:3, 1]))
    return Stance.of(X, angles)


def _uprightness(X_WB: FloatArray, out: FloatArray) -> float:
    """Least where the base, its z axis down, hangs on the outer side of the feet."""
    return float(X_WB[2, 2]) + (0.0 if X_WB[:3, 3] @ out > 0 else 10.0)
