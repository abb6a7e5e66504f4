"""What a scene file says of the tool path: legs and poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, GetPydanticSchema, PlainSerializer, WrapValidator

from cmbot.common.errors import InputError
from cmbot.common.reading.fields import (
    Angle,
    Angles,
    LongVector,
    Slug,
    UnitVector,
    Vector,
    exactly_one,
    given_of,
    read_as,
)
from cmbot.common.reading.validation import CheckedFields

AUTO: Literal["auto"] = "auto"
"""Seconds that are to be found."""

Seconds = Annotated[float, Field(ge=1e-3, le=36_000)]
Speed = Annotated[float, Field(ge=1e-5, le=100)]


def _auto_or_number(value: Any, number: Any) -> Any:
    """The word, or what `number` makes of a number: one error, where a union would have two."""
    return value if value == AUTO else number(value)


def _number_or_auto(number: Any) -> GetPydanticSchema:
    checked = Annotated[number, WrapValidator(_auto_or_number), PlainSerializer(lambda value: value)]
    return read_as(checked, (AUTO,))


SecondsOrAuto = Annotated[float | Literal["auto"], _number_or_auto(Seconds)]
"""A duration, or ``auto``."""

ViaPoints = Annotated[int | Literal["auto"], _number_or_auto(Annotated[int, Field(ge=5, le=20000)])]
"""A number of via-points, or ``auto``."""


@dataclass(frozen=True, kw_only=True)
class Goal(CheckedFields):
    """A pose of the tool.

    Attributes
    ----------
    xyz : three floats
        Place of the tool point, m, in `frame`.
    rpy_deg : three floats or None
        Its orientation in `frame`: roll, pitch, yaw as in URDF. Left out, as `axis`: as before, at first
        as at the start.
    axis : three floats or None
        In place of `rpy_deg` the direction of the tool's z axis in `frame`, a unit vector; the tool turns to
        it on the shortest way.
    frame : str
        ``world``, ``tool`` (the tool's pose where the path begins) or one of `frames`.

    Raises
    ------
    InputError
        When a field is out of its bounds.
    """

    xyz: Vector
    rpy_deg: Angles | None = None
    axis: UnitVector | None = None
    frame: Slug = "world"

    def _check(self) -> None:
        _at_most_one(self, ("rpy_deg", "axis"))


@dataclass(frozen=True, kw_only=True)
class ArcTo(CheckedFields):
    """A circular arc, through two points or about an axis.

    Attributes
    ----------
    via, to : three floats or None
        Points of the arc, m, in `frame`; `to` is its end.
    centre, axis : three floats or None
        In place of `via` and `to` an axis in `frame`: a point of it, m, and its direction, a unit vector.
    angle_deg : float or None
        With `centre` and `axis`: the angle about that axis.
    turns : bool
        Whether the tool turns with the arc, as about a pipe; otherwise it keeps its orientation.
    frame : str
        As in other poses.

    Raises
    ------
    InputError
        When a field is out of its bounds, or the arc is not one of these two.
    """

    via: Vector | None = None
    to: Vector | None = None
    centre: Vector | None = None
    axis: UnitVector | None = None
    angle_deg: Angle | None = None
    turns: bool = False
    frame: Slug = "world"

    def _check(self) -> None:
        given = set(given_of(self, ("via", "to", "centre", "axis", "angle_deg")))
        if given not in ({"via", "to"}, {"centre", "axis", "angle_deg"}):
            got = ", ".join(sorted(given)) or "nothing"
            raise InputError("ArcTo", "", got, "via and to, or centre, axis and angle_deg")
        if self.angle_deg == 0:
            raise InputError("ArcTo", "angle_deg", "0", "an angle other than 0")


@dataclass(frozen=True, kw_only=True)
class Leg(CheckedFields):
    """A leg of the tool's path, from rest to rest.

    Attributes
    ----------
    by : three floats or None
        Displacement in W, m, along a straight line.
    to : Goal or None
        In place of `by` the pose at its end: a straight line, on which the tool turns in proportion.
    arc : ArcTo or None
        In place of `by` an arc.
    pause : float or None
        In place of `by` seconds in which the tool waits.
    seconds : float, "auto" or None
        Duration, s; ``auto``: the shortest within the limits.
    speed_m_s : float or None
        In place of `seconds` the speed at which the tool cruises, m/s; the ramps come on top.

    Raises
    ------
    InputError
        When a field is out of its bounds, or the leg shorter than a micrometre.
    """

    by: LongVector | None = None
    to: Goal | None = None
    arc: ArcTo | None = None
    pause: Seconds | None = None
    seconds: SecondsOrAuto | None = None
    speed_m_s: Speed | None = None

    def _check(self) -> None:
        exactly_one(self, ("by", "to", "arc", "pause"))
        if self.pause is None:
            # Without either it has the seconds of the path, which may be found.
            if self.seconds is not None or self.speed_m_s is not None:
                exactly_one(self, ("seconds", "speed_m_s"))
        elif self.seconds is not None or self.speed_m_s is not None:
            key = "seconds" if self.seconds is not None else "speed_m_s"
            raise InputError("Leg", key, "a value", "no such key beside pause, which says how long")

    @property
    def is_timed(self) -> bool:
        """Whether it has a time of its own."""
        return any(each is not None for each in (self.pause, self.seconds, self.speed_m_s))

    @property
    def has_parts(self) -> bool:
        """Whether the leg can be cut on its way: neither a pause nor an arc through two points."""
        return self.pause is None and (self.arc is None or self.arc.angle_deg is not None)

    @property
    def frame(self) -> str:
        """The frame that it is described in."""
        goal = self.to or self.arc
        return "world" if goal is None else goal.frame

    def part(self, begin: float, end: float, goal: Goal) -> Leg:
        """Return what is between two shares of the leg, the second of which is covered at a goal.

        In the third root of its share of the leg's seconds speeds and accelerations are smaller, and jerks no
        larger. At a given speed it cruises as fast.
        """
        share = end - begin
        if share == 1.0:
            return self
        changes: dict[str, Any] = {}
        if self.by is not None:
            changes["by"] = tuple(share * each for each in self.by)
        elif self.arc is not None and self.arc.angle_deg is not None:
            changes["arc"] = replace(self.arc, angle_deg=share * self.arc.angle_deg)
        elif end < 1.0:
            changes["to"] = goal
        if isinstance(self.seconds, float):
            changes["seconds"] = float(np.cbrt(share)) * self.seconds
        return replace(self, **changes)

    @property
    def given_seconds(self) -> float:
        """Seconds that are given, s: 0 where they follow from a speed, or are to be found."""
        return self.seconds if isinstance(self.seconds, float) else self.pause or 0.0


def _at_most_one(instance: object, names: Sequence[str]) -> None:
    given = given_of(instance, names)
    if len(given) > 1:
        got = " and ".join(given)
        raise InputError(type(instance).__name__, "", got, "at most one of these keys", tuple(names))
