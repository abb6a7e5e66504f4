"""A timed path with the tool on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError, remedy_for
from cmbot.common.representation import short_repr
from cmbot.scene.path.builder import timed_path
from cmbot.scene.path.path_file import StrokeFile
from cmbot.scene.path.path_source import PathSource
from cmbot.scene.path.tool_path import ToolPath
from cmbot.scene.path.via_point_count import automatic_via_points
from cmbot.scene.raster.pieces import RowPiece, without
from cmbot.scene.raster.surface import Coverage, Surface

__all__ = ["Stroke", "coverage_of", "pieces_left_out", "timed_stroke"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Stroke:
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

    __repr__ = short_repr

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

    @property
    def more_time(self) -> str:
        """What gives the joints more time along it, by the keys that it has in the scene."""
        if not self.file.legs:
            return (
                f"more {self.key}.seconds" if self.file.speed_m_s is None else f"a lower {self.key}.speed_m_s"
            )
        moving = [leg for leg in self.file.legs if leg.pause is None]
        fast = sum(leg.speed_m_s is not None for leg in moving)
        more = {0: "more seconds", len(moving): "lower speeds"}.get(fast, "more seconds or lower speeds")
        return f"{more} in {self.key}.legs"

    def remedy_for(self, constraint: str, violation: float = 0.0) -> str:
        """Return what most often helps where a constraint cannot be kept, by the keys of the scene.

        The violation is a share of its bound.
        """
        is_smooth = self.file.speed_profile.kind == "jerk_limited"
        smoother = "" if is_smooth else f", or {self.key}.speed_profile.kind jerk_limited,"
        return remedy_for(constraint, violation, path=self.key, more_time=self.more_time, smoother=smoother)

    def _in_file(self, leg: int) -> int:
        """The number in the file of a leg of the timed path, which may go back and in passes."""
        legs = len(self.file.legs)
        number, at = divmod(leg, legs)
        return legs - 1 - at if (number % 2 == 1) != self.file.backwards else at


def timed_stroke(
    file: StrokeFile, place: PathSource, X_WT: FloatArray, *, begins_elsewhere: bool, deviation: float
) -> Stroke:
    """Return the stroke that a file describes.

    Parameters
    ----------
    file : StrokeFile
    place : PathSource
    X_WT : (4, 4)
        Pose of the tool before.
    begins_elsewhere : bool
        Whether the arm has to be brought to its start.
    deviation : float
        Of the tool from the path at most, m.

    Raises
    ------
    SceneError
        When its path is none, its via-points are too few, or its time laws are those of others.
    """
    path, surface = timed_path(file, place, X_WT)
    path = path.reversed() if file.backwards else path
    path = path.repeated(file.passes or 1)
    if file.time_laws is not None:
        found = sorted(law.leg for law in file.time_laws)
        if found != sorted(path.open_legs):
            expected = f"one for each leg with seconds: auto: {sorted(path.open_legs)}"
            raise SceneError(place.source, f"{place.key}.time_laws", f"laws of legs {found}", expected)
        path = path.timed(file.time_laws)
    number = file.via_points
    if not isinstance(number, int):
        number = automatic_via_points(path, deviation, file.speed_tolerance)
    needed = len(path.section_times)
    if number < needed:
        expected = f"at least {needed}, one for each end of a leg, row or lead, or auto"
        raise SceneError(place.source, f"{place.key}.via_points", number, expected)
    return Stroke(
        name=str(file.name),
        key=place.key,
        file=file,
        path=path,
        via_points=number,
        begins_elsewhere=begins_elsewhere,
        surface=surface,
    )


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
