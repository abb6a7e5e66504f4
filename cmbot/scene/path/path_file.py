"""A path of the tool as a scene file describes it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, ConfigDict, Field, PlainSerializer

from cmbot.common.reading.fields import Slug, read_as, word_or
from cmbot.common.reading.validation import FileModel, counted, refusal
from cmbot.scene.path.waypoints import Waypoint
from cmbot.toolpath import (
    AUTO,
    SAME_PLACE,
    Goal,
    Leg,
    LegLaw,
    Raster,
    SecondsOrAuto,
    Speed,
    SpeedProfile,
    ViaPoints,
    distinct,
    merged,
    waypoint_poses,
)

LONGEST = 36_000
"""Duration of all strokes, s: motions are sampled every 0.01 s."""
QUIET = SpeedProfile(kind="quiet", ramp=0.3)
"""Speed profile of new scenes that have none of their own."""
MOST_ORDERED = 12
"""Strokes whose best order is sought, at most."""
WORK = "work"
"""Name of the stroke of a tool path without strokes."""
RESERVED = ("approach", WORK, "return")
"""Names of parts of a job that no stroke can have."""
FREE_MOVE = re.compile(r"free_\d+")
"""Names of the free moves between strokes."""

BOUNDS = ("max_base_torque_nm", "max_sway_mm")
"""What is bounded beside the shortest time."""

_TIMING_KEYS = ("seconds", "speed_m_s")
_KEPT_TASKS = ("pose", "axis", "position")


class AxisCone(FileModel):
    """The tool point, and a cone about the path's axis that the tool's axis stays in."""

    axis_within_deg: Annotated[float, Field(ge=0.1, le=90)]
    """Largest angle between the tool's axis and that of the path."""

    @property
    def angle(self) -> float:
        """That angle, rad."""
        return math.radians(self.axis_within_deg)

    def __str__(self) -> str:
        return f"axis within {self.axis_within_deg:g} deg"


Order = Literal["given", "best"]
"""In which order strokes are taken."""
Keep = Annotated[
    Literal["pose", "axis", "position"] | AxisCone, word_or(_KEPT_TASKS, AxisCone, "{axis_within_deg: 10}")
]
"""What a tool path prescribes of the tool: its pose, its axis, its position, or a cone for its axis."""


class PathFile(FileModel):
    """A path of the tool."""

    model_config = ConfigDict(serialize_by_alias=True)

    keep: Keep = "pose"
    """What the path prescribes of the tool: its pose, its point and axis, its point alone, or with
    ``{axis_within_deg: 10}`` its point and a cone for its axis."""
    start_pose: Annotated[Goal | None, Field(alias="from")] = None
    """Where the path begins, in place of the tool's pose in the start posture."""
    legs: Annotated[tuple[Leg, ...], Field(max_length=2000)] = ()
    """Legs from where the path begins, each from rest to rest."""
    waypoints: Annotated[tuple[Waypoint, ...] | None, Field(min_length=2, max_length=2000)] = None
    """In place of `legs`, points in m and unit quaternions of the tool in W (x, y, z, qw, qx, qy, qz). In a
    scene file also the path of a table, or its `file` with units and pose. The tool rests at corners and
    where it turns in place. Neighbours less than 0.1 mm apart are one, and dense ones are missed by up to a
    quarter of the tolerance."""
    corner_deg: Annotated[float, Field(ge=1, le=180)] = 15.0
    """Waypoints at which the path bends by more, and twice as much as beside, are corners; by 60 degrees
    always, with ``seconds: auto`` also within 15 mm. Where no spline keeps dense ones a third will do."""
    reconfigurations: Annotated[int, Field(ge=0, le=100)] | None = None
    """How often a path may be cut, where no posture leads on."""
    raster: Raster | None = None
    """In place of `legs`, rows over a surface, with `blend_radius_m` without a stop."""
    seconds: SecondsOrAuto | None = None
    """Duration of the path through `waypoints` or of `raster`, s. ``auto``: the shortest within the limits of
    joints and tool; also for legs without a time of their own, and beside `strokes` for all strokes."""
    max_base_torque_nm: Annotated[float, Field(gt=0, le=1e6)] | None = None
    """With ``seconds: auto``: the largest torque on the base, Nm, with the tool on; left out: any."""
    max_sway_mm: Annotated[float, Field(gt=0, le=1e4)] | None = None
    """With ``seconds: auto``: the largest sway at work, and the largest swing after it, mm; left out: any."""
    time_laws: Annotated[tuple[LegLaw, ...], Field(max_length=2000)] | None = None
    """How legs with ``seconds: auto``, or of a ``quiet`` path, are covered, as planning found it: in the
    scenes of plans. Left out: it is searched."""
    speed_m_s: Speed | None = None
    """In place of `seconds` the speed at which the tool cruises along `waypoints` or `raster`, m/s."""
    speed_tolerance: Annotated[float, Field(ge=1e-4, le=0.5)] | None = None
    """By what share the tool's speed may miss the process speed, on a path without a stop. It is certified at
    all times between `lead_in_m` and `lead_out_m`; on each row of a raster that is not blended, `overscan_m`
    is the lead. The process speed is `speed_m_s`, or that at which the path is covered in its seconds. Left
    out: any speed."""
    lead_in_m: Annotated[float, Field(ge=1e-4, le=100)] | None = None
    """Length, m, of a straight way before the path, along its tangent, on which the tool speeds up and turns
    as at the path's start; its time comes on top. The tool is on there, too. Left out: it speeds up on the
    path."""
    lead_out_m: Annotated[float, Field(ge=1e-4, le=100)] | None = None
    """Length, m, of such a way after the path, on which the tool slows down."""
    blend_radius_m: Annotated[float | None, Field(ge=1e-4, le=100)] = None
    """Radius by which corners between straight legs, and between the rows of a raster, are rounded, m; left
    out, and where the way turns by more than 150 degrees, the tool rests there."""
    speed_profile: SpeedProfile = QUIET
    """Left out: quiet with a ramp of 0.3, in place of which planning chooses ramps and input shapers."""
    passes: Annotated[int, Field(ge=1, le=100)] | None = None
    """How often the path is followed, to and fro, without leaving it; left out: once."""
    via_points: ViaPoints = 50
    """Via-points in all; the ends of the legs are among them. ``auto``: a number that follows from the
    path's length, turns, bends, ramps, time and tolerances; beside `strokes` for all
    strokes without a number."""

    def _check(self) -> None:
        self._check_path()
        self._check_times()

    def _check_times(self, at: tuple[str | int, ...] = ()) -> None:
        """Every leg, or the whole path, has one time; ``seconds: auto`` is that of legs that have none."""
        if not self.legs:
            if (self.seconds is None) == (self.speed_m_s is None):
                got = "none" if self.seconds is None else "seconds and speed_m_s"
                raise refusal("exactly one of these keys", got=got, key=at, choices=_TIMING_KEYS)
        else:
            for name in _TIMING_KEYS:
                if getattr(self, name) not in (None, AUTO):
                    expected = f"no such key beside legs, which have their own: legs[0].{name}"
                    raise refusal(expected, got="a value", key=(*at, name))
            for k, leg in enumerate(self.legs):
                if not leg.is_timed and self.seconds != AUTO:
                    where = (*at, "legs", k)
                    raise refusal("exactly one of these keys", got="none", key=where, choices=_TIMING_KEYS)
        if self.seconds == AUTO and self.legs:
            legs = (leg if leg.is_timed else replace(leg, seconds=AUTO) for leg in self.legs)
            object.__setattr__(self, "legs", tuple(legs))
            object.__setattr__(self, "seconds", None)
        for name in () if self.is_open else BOUNDS:
            if getattr(self, name) is not None:
                raise refusal("no such key without seconds: auto", got="a value", key=(*at, name))
        if not self.is_open and self.speed_profile.kind == "shortest":
            expected = "another kind without seconds: auto"
            raise refusal(expected, got="shortest", key=(*at, "speed_profile", "kind"))
        if not (self.is_open or self.speed_profile.kind == "quiet") and self.time_laws is not None:
            expected = "no such key without seconds: auto or speed_profile: {kind: quiet}"
            raise refusal(expected, got="a value", key=(*at, "time_laws"))
        for name in ("speed_tolerance", "lead_in_m", "lead_out_m"):
            if self.is_open and getattr(self, name) is not None:
                expected = "no such key beside seconds: auto, which has no constant speed"
                raise refusal(expected, got="a value", key=(*at, name))

    @property
    def given_time(self) -> float | None:
        """Its seconds; None where they are to be found, or follow from a speed or from legs."""
        return self.seconds if isinstance(self.seconds, float) else None

    @property
    def is_open(self) -> bool:
        """Whether seconds of it are to be found."""
        return self.seconds == AUTO or any(leg.seconds == AUTO for leg in self.legs)

    def _check_path(self) -> None:
        given = [name for name in ("legs", "waypoints", "raster") if getattr(self, name)]
        if len(given) != 1:
            got = " and ".join(given) or "neither"
            raise refusal("either legs, waypoints or a raster", got=got, key=("legs",))
        if not self.legs and self.start_pose is not None:
            expected = "no such key beside waypoints or a raster, where the path begins"
            raise refusal(expected, got="a pose", key=("from",))
        self._check_waypoints()
        self._check_leads()
        passes = self.passes or 1
        leads = sum(lead is not None for lead in (self.lead_in_m, self.lead_out_m))
        legs = (len(self.legs) + leads) * passes
        if isinstance(self.via_points, int) and self.via_points <= legs:
            expected = f"more than the {legs} legs"
            expected += (
                (" and leads" if leads else "") + (" of all passes" if passes > 1 else "") + ", or auto"
            )
            raise refusal(expected, got=self.via_points, key=("via_points",))
        if self.given_seconds > LONGEST:
            expected = f"legs of at most {LONGEST:,} s in all (10 h)"
            raise refusal(expected, got=f"{self.given_seconds:g} s", key=("legs",))

    def _check_waypoints(self) -> None:
        if self.waypoints is None:
            return
        points = waypoint_poses(self.waypoints)[0]
        if len(distinct(points)) == 1 and self.merged == len(points) - 1:
            got = f"{counted(len(points), 'waypoint')} at one place"
            expected = f"places {1e3 * SAME_PLACE:g} mm apart or more, or a turn of what is kept"
            raise refusal(expected, got=got, key=("waypoints",))

    @property
    def kept(self) -> str:
        """What of the tool's orientation counts: ``pose``, ``axis`` or ``position``."""
        return self.keep if isinstance(self.keep, str) else "axis"

    @property
    def merged(self) -> int:
        """How many waypoints are at the place of the one before, and turned as that is."""
        return merged(*waypoint_poses(self.waypoints), self.kept) if self.waypoints else 0

    def _check_leads(self) -> None:
        rests = self.raster is not None and self.blend_radius_m is None
        for name in ("lead_in_m", "lead_out_m"):
            if rests and getattr(self, name) is not None:
                expected = "no such key: overscan_m is the lead of rows at whose ends the tool rests"
                raise refusal(f"{expected}, blend_radius_m joins them", got="a value", key=(name,))
        if self.speed_tolerance is None:
            return
        if rests and self.raster is not None and not self.raster.overscan_m:
            expected = "an overscan, on which the tool speeds up and slows down, beside speed_tolerance"
            raise refusal(expected, got="nothing", key=("raster", "overscan_m"))
        for name in () if rests else ("lead_in_m", "lead_out_m"):
            if getattr(self, name) is None:
                raise refusal("a length beside speed_tolerance", got="nothing", key=(name,))

    @property
    def given_seconds(self) -> float:
        """Duration of the legs that have one, in all passes, s."""
        return (self.passes or 1) * sum(leg.given_seconds for leg in self.legs)

    @property
    def has_own_start(self) -> bool:
        """Whether it says itself where it begins."""
        return any(each is not None for each in (self.start_pose, self.waypoints, self.raster))

    @property
    def has_start(self) -> bool:
        """Whether it begins elsewhere than where the tool was before."""
        return self.has_own_start or self.lead_in_m is not None

    @property
    def in_words(self) -> str:
        """What it is made of."""
        if self.raster is not None and self.raster.mesh is not None:
            return f"a raster over faces of {Path(self.raster.mesh).name}"
        if self.raster is not None:
            rows, area = counted(self.raster.rows, "row"), f"{self.raster.area:.3g} m2"
            return f"a raster of {rows} over {area}{'' if self.raster.cylinder is None else ' of a cylinder'}"
        if self.waypoints is not None:
            merged = f" ({self.merged} more at the place of the one before)" if self.merged else ""
            return f"a path through {counted(len(self.waypoints) - self.merged, 'waypoint')}{merged}"
        return counted(len(self.legs), "leg")


class StrokeFile(PathFile):
    """A path with the tool on: all keys of ``tool_path`` but ``strokes``, and its name."""

    name: Slug | None = None
    """Left out: ``stroke_1`` for the first one, and so on."""
    backwards: bool = False
    """Whether the path is followed from its end to its start."""
    part_of: Slug | None = None
    """In the scenes of plans the name of the stroke of which it is a part."""
    begins_at: Annotated[float | None, Field(ge=0, le=2000)] = None
    """How many legs or waypoints are behind it."""

    def _check(self) -> None:
        # Its time may be that of all strokes.
        self._check_path()

    @property
    def has_start(self) -> bool:
        """Whether it begins elsewhere than where the tool was before."""
        return self.backwards or super().has_start

    @property
    def steps(self) -> int:
        """How many legs it has, or steps between waypoints."""
        return len(self.legs or self.waypoints or ()) - (not self.legs)

    def can_be_cut(self, behind: float) -> bool:
        """Whether it can go on from another posture with so many legs, or steps between waypoints, behind.

        Leads, passes, blends and the way back are those of a whole path, as what begins in the tool's frame.
        """
        is_whole = self.passes or self.lead_in_m or self.lead_out_m or self.blend_radius_m or self.time_laws
        if self.raster is not None or self.backwards or is_whole or not 0 < behind < self.steps:
            return False
        if any(leg.frame == "tool" for leg in self.legs):
            return False
        return behind.is_integer() or (bool(self.legs) and self.legs[int(behind)].has_parts)

    def in_shortest_time(self) -> Self | None:
        """Return the stroke in the shortest time within the limits; None where a process has a speed."""
        if self.speed_tolerance is not None or self.lead_in_m or self.lead_out_m:
            return None
        legs = tuple(
            leg if leg.pause is not None else replace(leg, seconds=AUTO, speed_m_s=None) for leg in self.legs
        )
        profile, seconds = replace(self.speed_profile, kind="shortest"), None if legs else AUTO
        return self.changed(legs=legs, seconds=seconds, speed_m_s=None, time_laws=None, speed_profile=profile)


@dataclass(frozen=True, kw_only=True)
class JobStrokes:
    """The strokes of a job.

    Attributes
    ----------
    strokes : tuple of StrokeFile
        One or more; the one of a path without strokes is called `WORK`.
    order : str or None
        In which they are taken, ``given`` or ``best``; None: as given.
    """

    strokes: tuple[StrokeFile, ...]
    order: Order | None = None

    def as_data(self) -> dict[str, Any]:
        """Return what the file has in ``tool_path``: a path without strokes where there is but the work."""
        strokes = [stroke.model_dump(mode="json", exclude_none=True) for stroke in self.strokes]
        if [stroke.name for stroke in self.strokes] == [WORK]:
            of_strokes = StrokeFile.model_fields.keys() - PathFile.model_fields.keys()
            return {key: value for key, value in strokes[0].items() if key not in of_strokes}
        return {"strokes": strokes} | ({} if self.order is None else {"order": self.order})


class ToolPathFile(PathFile):
    """The path of the tool from its pose in the start posture: one stroke, or several in their order."""

    strokes: Annotated[tuple[StrokeFile, ...] | None, Field(min_length=1, max_length=200)] = None
    """In place of all other keys: the tool is on along each, and off on the free moves from one to the next.
    A stroke without a start of its own begins where the path of the one before it ends."""
    order: Order | None = None
    """Of the strokes; left out: as given. ``best`` takes that order and those directions in which the tool
    travels least between them, if the peak of the torque does not rise by that; each needs a start of its
    own. Where rasters are in so many parts that there are more than 12 strokes: as given."""

    def _check(self) -> None:
        if self.strokes is None:
            self._check_path()
            self._check_times()
            if self.order is not None:
                raise refusal("no such key without strokes", got=self.order, key=("order",))
            return
        for name, field in PathFile.model_fields.items():
            if self.seconds == AUTO and name in ("seconds", *BOUNDS):
                continue
            if self.via_points == AUTO and name == "via_points":
                continue
            if getattr(self, name) != field.default:
                expected = "no such key beside strokes, which have their own"
                raise refusal(expected, got="a value", key=(field.alias or name,))
        named = tuple(self._completed(stroke, k) for k, stroke in enumerate(self.strokes, start=1))
        for name in ("seconds", *BOUNDS, "via_points"):
            object.__setattr__(self, name, type(self).model_fields[name].default)
        for k, stroke in enumerate(named):
            stroke._check_times(("strokes", k))
        taken = dict[str, int]()
        for k, stroke in enumerate(named):
            name = str(stroke.name)
            if name in RESERVED or FREE_MOVE.fullmatch(name):
                expected = (
                    f"a name of its own: {', '.join(RESERVED)}, free_1, free_2, … are other parts of a job"
                )
                raise refusal(expected, got=name, key=("strokes", k, "name"))
            if name in taken:
                expected = f"another name: it is that of strokes[{taken[name]}]"
                raise refusal(expected, got=name, key=("strokes", k, "name"))
            taken[name] = k
        if (seconds := sum(stroke.given_seconds for stroke in named)) > LONGEST:
            expected = f"strokes of at most {LONGEST:,} s in all (10 h)"
            raise refusal(expected, got=f"{seconds:g} s", key=("strokes",))
        object.__setattr__(self, "strokes", named)
        if self.order == "best":
            self._check_order(named)

    def _completed(self, stroke: StrokeFile, number: int) -> StrokeFile:
        """A stroke with a name, so that messages, pages and files call it the same, and what is for all."""
        changes: dict[str, Any] = {} if stroke.name else {"name": f"stroke_{number}"}
        if self.via_points == AUTO and "via_points" not in stroke.model_fields_set:
            changes["via_points"] = AUTO
        timed = stroke.speed_m_s is not None or isinstance(stroke.seconds, float)
        timed |= bool(stroke.legs) and all(leg.is_timed and leg.seconds != AUTO for leg in stroke.legs)
        if self.seconds == AUTO and not timed:
            changes |= {name: getattr(stroke, name) or getattr(self, name) for name in BOUNDS}
            changes["seconds"] = AUTO
        return stroke.changed(**changes) if changes else stroke

    def _check_order(self, strokes: Sequence[StrokeFile]) -> None:
        if len(strokes) > MOST_ORDERED:
            expected = f"given for more than {MOST_ORDERED} strokes"
            raise refusal(expected, got=f"best for {len(strokes)} strokes", key=("order",))
        for k, stroke in enumerate(strokes):
            if not stroke.has_own_start:
                expected = "a pose: with order: best a stroke may follow on any other one"
                raise refusal(expected, got="nothing", key=("strokes", k, "from"))

    @property
    def job(self) -> JobStrokes:
        """Its strokes: without any it is one itself."""
        if self.strokes is not None:
            return JobStrokes(strokes=self.strokes, order=self.order)
        path = {field.alias or name: getattr(self, name) for name, field in PathFile.model_fields.items()}
        return JobStrokes(strokes=(StrokeFile.model_validate({"name": WORK, **path}),))


ToolPathEntry = Annotated[
    JobStrokes,
    read_as(
        Annotated[
            ToolPathFile,
            AfterValidator(lambda path: path.job),
            PlainSerializer(lambda job: job.as_data()),
        ]
    ),
]
"""The strokes of a job, as ``tool_path`` of a scene file."""
