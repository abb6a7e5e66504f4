"""Strokes: timed paths with the tool on, and how many via-points they have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.representation import ShortRepr
from cmbot.scene.path.path_file import StrokeFile
from cmbot.toolpath import (
    Coverage,
    PathSource,
    RowPiece,
    Surface,
    TimeLaw,
    ToolPath,
    timed_path,
    without,
)

# What splines follow between two via-points to a millimetre: way of the tool, m, turn of the tool and of the
# path, rad, and seconds; and how many segments a ramp has.
_WAY, _TURN, _BEND, _SECONDS, _PER_RAMP = 0.05, np.radians(15), np.radians(36), 1.0, 3
# Splines miss a smooth path by the fourth power of their segments' length; a speed is missed by the second.
_DEVIATION, _SPEED_TOLERANCE_SHARE = 1e-3, 0.2
# Segments of a leg at least and at most, and of one whose shortest time is sought at least: legs share these.
_MIN_LEG_SEGMENTS, _MAX_LEG_SEGMENTS, _FEWEST_OPEN, _OPEN_IN_ALL = 4, 600, (8, 30), 90
_POSE_VALUES = 12
# Durations that differ by less are the same, as a share.
_DURATION_TOLERANCE = 1e-6
# By what share a speed at a sample may exceed another one.
_SPEED_TOLERANCE = 1e-3
# Ramps with a shaper of up to 0.4 of the time: shares of the largest speed, and for which share of the time a
# tool may be slower at an end; how far from half of the way it may be in the middle. Of what planning chooses
# 0.11, 0.17 and 0.08 are the most.
_MOST_IDLE, _MOST_LOPSIDED = ((0.01, 0.14), (0.05, 0.19)), 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Stroke(ShortRepr):
    """A path with the tool on.

    Attributes
    ----------
    name : str
    key : str
        Of its description in the scene file.
    file : StrokeFile
        Its description.
    path : ToolPath
    via_points : int
        In all, with the ends of the legs.
    begins_elsewhere : bool
        Whether the arm has to be brought to its start: not the first one from the tool's pose in the scene's
        posture.
    surface : Surface or None
        Of a raster.
    """

    name: str
    key: str
    file: StrokeFile
    path: ToolPath
    via_points: int
    begins_elsewhere: bool
    surface: Surface | None = None

    @cached_property
    def via_times(self) -> FloatArray:
        """Times of its via-points (k,), s."""
        return self.path.via_times(self.via_points)

    def leg_key(self, leg: int) -> str:
        """Return the key of a leg of the timed path, as far as it has one of its own."""
        if not self.file.legs:
            return f"{self.key}.waypoints" if self.file.raster is None else f"{self.key}.raster"
        return f"{self.key}.legs" if self.file.blend_radius_m else f"{self.key}.legs[{self._in_file(leg)}]"

    def asked_speed(self, leg: int) -> float | None:
        """Return the speed, m/s, that the scene asks for on a leg of the timed path; None: seconds."""
        if not self.file.legs:
            return self.file.speed_m_s
        # What is blended has one time law for several legs.
        return None if self.file.blend_radius_m else self.file.legs[self._in_file(leg)].speed_m_s

    def _in_file(self, leg: int) -> int:
        """The number in the file of a leg of the timed path, which may go back and in passes."""
        legs = len(self.file.legs)
        number, at = divmod(leg, legs)
        return legs - 1 - at if (number % 2 == 1) != self.file.backwards else at


def timed_stroke(
    file: StrokeFile,
    place: PathSource,
    X_WT: FloatArray,
    surface: Surface | None,
    *,
    begins_elsewhere: bool,
) -> Stroke:
    """Return the stroke that a file describes.

    Parameters
    ----------
    file : StrokeFile
    place : PathSource
    X_WT : (4, 4)
        Pose of the tool before.
    surface : Surface or None
        Of its raster.
    begins_elsewhere : bool
        Whether the arm has to be brought to its start.

    Raises
    ------
    SceneError
        When its path is none, its via-points are too few, or its time laws are those of others.
    """
    path = timed_path(file, place, X_WT, surface)
    path = path.reversed() if file.backwards else path
    path = plain = path.repeated(file.passes or 1)
    if file.time_laws is not None:
        _check_laws(file, path, place)
        path = path.timed(file.time_laws)
    number = file.via_points
    if not isinstance(number, int):
        number = _automatic_via_points(path, place.deviation, file)
    needed = len(path.section_times)
    if number < needed:
        expected = f"at least {needed}, one for each end of a leg, row or lead, or auto"
        raise SceneError(place.source, f"{place.key}.via_points", number, expected)
    stroke = Stroke(
        name=str(file.name),
        key=place.key,
        file=file,
        path=path,
        via_points=number,
        begins_elsewhere=begins_elsewhere,
        surface=surface,
    )
    _check_speeds(stroke, plain, place)
    return stroke


def _check_laws(file: StrokeFile, path: ToolPath, place: PathSource) -> None:
    """Refuse laws of other legs than those whose laws are to be found, or in other seconds than are given."""
    laws = file.time_laws or ()
    legs, key = sorted(law.leg for law in laws), f"{place.key}.time_laws"
    free = set(range(len(path.segments))) if file.speed_profile.kind == "quiet" else path.open_legs
    if len(set(legs)) < len(legs) or not path.open_legs <= set(legs) <= free:
        expected = f"one for each leg with seconds: auto: {sorted(path.open_legs)}"
        raise SceneError(place.source, key, f"laws of legs {legs}", expected)
    for law in laws:
        seconds = path.segments[law.leg].seconds
        if law.leg not in path.open_legs and abs(law.duration - seconds) > _DURATION_TOLERANCE * seconds:
            got = f"{law.duration:g} s on leg {law.leg}"
            raise SceneError(place.source, key, got, f"the {seconds:g} s of that leg")
        if law.leg not in path.open_legs and not _is_ramped(law.law):
            got = f"a law of leg {law.leg} that waits, or slows down in between"
            raise SceneError(place.source, key, got, "one speed between two ramps, with or without a shaper")


def _is_ramped(law: TimeLaw) -> bool:
    """Whether a law could be of ramps and a shaper: its speed rises, then falls, about the middle."""
    u = np.linspace(0.0, 1.0, 1001)
    speed = law.rate(u)
    rises, falls = np.maximum.accumulate(speed), np.maximum.accumulate(speed[::-1])[::-1]
    moves = [(u[speed >= share * speed.max()], most) for share, most in _MOST_IDLE]
    goes = all(max(at[0], 1 - at[-1]) <= most for at, most in moves)
    lopsided = abs(float(law.share(np.array([0.5]))[0]) - 0.5)
    is_even = (np.minimum(rises, falls) - speed).max() <= _SPEED_TOLERANCE * speed.max()
    return bool(is_even and goes and lopsided <= _MOST_LOPSIDED)


def _check_speeds(stroke: Stroke, plain: ToolPath, place: PathSource) -> None:
    """Refuse laws that are quicker than the law of the path as its file times it, where that has a speed."""
    u = np.linspace(0.0, 1.0, 1001)
    for law in stroke.file.time_laws or ():
        speed = None if law.leg in plain.open_legs else stroke.asked_speed(law.leg)
        if speed is None:
            continue
        own, given = (float(each.rate(u).max()) for each in (law.law, plain.segments[law.leg].law))
        if own > given * (1 + _SPEED_TOLERANCE):
            got = f"a law of leg {law.leg} with up to {speed * own / given:.4g} m/s"
            raise SceneError(place.source, f"{place.key}.time_laws", got, f"its speed_m_s, {speed:g}")


def _automatic_via_points(path: ToolPath, deviation: float, file: StrokeFile) -> int:
    """Return how many via-points a path asks for: ``via_points: auto``.

    Parameters
    ----------
    path : ToolPath
    deviation : float
        Of the tool from the path at most, m.
    file : StrokeFile
        By what share the tool's speed may miss that of the process, and how long its ramps are.

    Notes
    -----
    Each leg asks for a segment for every 50 mm, 15 degrees of the tool's turn, 36 degrees of the path's bend
    where it is sharpest, and second; for three a ramp; and where its shortest time is sought for its share of
    ninety, 8 to 30. The way and the angles shrink with the fourth root of the deviation, from 1 mm on, and
    with the square root of the speed's tolerance below 20 %. A leg has 4 to 600 segments, a path 12 at least.
    """
    finer = min((deviation / _DEVIATION) ** 0.25, 1.0)
    if file.speed_tolerance is not None:
        finer *= min(math.sqrt(file.speed_tolerance / _SPEED_TOLERANCE_SHARE), 1.0)
    timed = {law.leg for law in file.time_laws or ()} if file.is_open else set[int]()
    open_legs = len(timed | path.open_legs)
    few = int(np.clip(math.ceil(_OPEN_IN_ALL / max(open_legs, 1)), *_FEWEST_OPEN))
    count = 0
    for leg, segment in enumerate(path.segments):
        length = segment.curve.length
        # As many more as there are for its bends: `ToolPath.via_times`.
        more = 1.0 + float(segment.curve.bend_share(np.ones(1))[0])
        bend = float(segment.curve.turned(np.ones(1))[0])
        asked = [length / (_WAY * finer), _turned(path, leg) / (_TURN * finer), bend / (_BEND * finer)]
        moves = max(asked) > 0
        if moves and (segment.is_open or leg in timed):
            asked.append(few)
        elif moves and segment.process is not None:
            asked.append(_FEWEST_OPEN[1])
        elif moves:
            asked += [segment.seconds / _SECONDS, _PER_RAMP / file.speed_profile.ramp]
        count += int(
            np.clip(math.ceil(more * max(asked)), _MIN_LEG_SEGMENTS if moves else 1, _MAX_LEG_SEGMENTS)
        )
    return max(count, _POSE_VALUES, len(path.section_times) - 1) + 1


def _turned(path: ToolPath, leg: int) -> float:
    """Angle by which the tool turns along a leg, rad."""
    if not path.turns:
        return 0.0
    begin, end = path.leg_times[leg : leg + 2]
    R = path.rotation(np.linspace(begin, end, 41))
    steps: FloatArray = np.linalg.norm(np.diff(R, axis=0), axis=(1, 2)) / math.sqrt(8)
    return float(2 * np.arcsin(np.minimum(steps, 1.0)).sum())


def coverage_of(strokes: Sequence[Stroke]) -> dict[str, Coverage]:
    """Return what strokes cover of the surfaces of their rasters, by the rasters' names.

    Strokes that are parts of one raster cover its surface together.

    Parameters
    ----------
    strokes : sequence of Stroke
    """
    return {name: Coverage.of(surface, pieces) for name, (_, surface, pieces) in _by_raster(strokes).items()}


def pieces_left_out(strokes: Sequence[Stroke]) -> list[tuple[StrokeFile, RowPiece]]:
    """Return the pieces of rows that strokes do not cover, each with a stroke over its raster.

    Parameters
    ----------
    strokes : sequence of Stroke
    """
    found = list[tuple[StrokeFile, RowPiece]]()
    for file, surface, pieces in _by_raster(strokes).values():
        for row, spans in enumerate(surface.spans):
            own = [(one.begin_m, one.end_m) for one in pieces if one.row == row]
            left = without(spans, own)
            found += [(file, RowPiece(row=row, begin_m=begin, end_m=end)) for begin, end in left]
    return found


def _by_raster(strokes: Sequence[Stroke]) -> dict[str, tuple[StrokeFile, Surface, list[RowPiece]]]:
    """Of each raster, by its name: the first of its strokes, the surface, and what all of them cover."""
    found = dict[str, tuple[StrokeFile, Surface, list[RowPiece]]]()
    for stroke in strokes:
        raster, name = stroke.file.raster, stroke.file.part_of or stroke.name
        if raster is not None and stroke.surface is not None:
            found.setdefault(name, (stroke.file, stroke.surface, []))
            found[name][2].extend(raster.pieces or stroke.surface.pieces)
    return found
