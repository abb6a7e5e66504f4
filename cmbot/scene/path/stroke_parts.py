"""Rasters, and paths through legs or waypoints, in several parts: strokes of their own."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.poses import rpy_deg
from cmbot.scene.path.path_file import StrokeFile
from cmbot.toolpath import Goal, Raster, RowPiece, ToolPath

# Via-points of a part: at least so many for each row and step, and for its ends.
_PER_LEG, _ENDS = 3, 12
# Largest ramp, as a share of a leg's time.
_MAX_RAMP_SHARE = 0.5


def raster_parts(
    file: StrokeFile,
    cells: Sequence[Sequence[RowPiece]],
    whole: Sequence[RowPiece],
    taken: Collection[str] = (),
) -> list[StrokeFile]:
    """Return the strokes that cover cells of a raster, with shares of its seconds and via-points.

    Parameters
    ----------
    file : StrokeFile
        Of the raster.
    cells : sequence of sequences of RowPiece
        What each stroke covers.
    whole : sequence of RowPiece
        All rows of the raster, which its seconds and via-points are for.
    taken : collection of str
        Names of other strokes.
    """
    raster = file.raster
    if raster is None:
        return [file]
    parts = list[StrokeFile]()
    for k, cell in enumerate(cells, start=1):
        share, legs = _length(raster, cell) / _length(raster, whole), 2 * len(cell) - 1
        changes: dict[str, Any] = {"raster": replace(raster, pieces=tuple(cell))}
        if file.given_time is not None:
            changes["seconds"] = max(share * file.given_time, 1e-3)
        if isinstance(file.via_points, int) and share < 1:
            fewest = (_PER_LEG * legs + _ENDS) * (file.passes or 1)
            changes["via_points"] = max(round(share * file.via_points), min(fewest, file.via_points), 5)
        # Ramps of shorter legs are as long as before, in seconds, where there is time for that.
        ramp = min(file.speed_profile.ramp * _stretch(file, raster, cell, whole), _MAX_RAMP_SHARE)
        changes["speed_profile"] = replace(file.speed_profile, ramp=ramp)
        if len(cells) > 1:
            changes |= {"name": _name(str(file.name), k, taken), "part_of": file.name}
        parts.append(file.changed(**changes))
    # The way back begins with the last part.
    return parts[::-1] if file.backwards else parts


def path_parts(
    file: StrokeFile, path: ToolPath, ends: Sequence[float], taken: Collection[str] = ()
) -> list[StrokeFile]:
    """Return the strokes of a path that is cut, with shares of its seconds and via-points.

    Parameters
    ----------
    file : StrokeFile
        Through waypoints or legs.
    path : ToolPath
        That of the file, timed.
    ends : sequence of float
        Where a part ends and the next one begins, ascending: how many waypoints, or legs, are behind it; 2.5
        is in the middle of the third leg.
    taken : collection of str
        Names of other strokes.
    """
    parts = list[StrokeFile]()
    for k, (begin, end) in enumerate(pairwise((0.0, *ends, file.steps)), start=1):
        share, changes = _part(file, path, begin, end)
        if isinstance(file.via_points, int):
            changes["via_points"] = max(round(share * file.via_points), min(_ENDS, file.via_points))
        changes |= {"name": _name(str(file.name), k, taken), "part_of": file.name, "begins_at": begin}
        parts.append(file.changed(**changes))
    return parts


def allowed_cuts(file: StrokeFile, strokes: Sequence[StrokeFile]) -> tuple[float, ...]:
    """Return where strokes that are parts of a path cut it, see `path_parts`; empty where it may not be."""
    ends = tuple(stroke.begins_at for stroke in strokes if stroke.part_of == file.name and stroke.begins_at)
    most = len(ends) if file.reconfigurations is None else file.reconfigurations
    may_be = len(ends) <= most and all(file.can_be_cut(end) for end in ends)
    return ends if may_be and list(ends) == sorted(set(ends)) else ()


def _part(file: StrokeFile, path: ToolPath, begin: float, end: float) -> tuple[float, dict[str, Any]]:
    """The share of a path that is between two places, and what of its file is another there."""
    if file.waypoints is not None:
        shares = waypoint_shares(file)[[int(begin), int(end)]]
        changes: dict[str, Any] = {"waypoints": file.waypoints[int(begin) : int(end) + 1]}
        share = float(shares[1] - shares[0])
        if file.given_time is not None:
            changes["seconds"] = share * file.given_time
        return share, changes
    legs = np.minimum(np.floor([begin, end]), file.steps - 1)
    times = path.times_at(legs, np.array([begin, end]) - legs)
    poses = zip(path.position(times), np.broadcast_to(path.rotation(times), (2, 3, 3)), strict=True)
    goals = [Goal(xyz=tuple(point.tolist()), rpy_deg=rpy_deg(R)) for point, R in poses]
    changes = {
        "legs": tuple(
            file.legs[k].part(max(begin - k, 0.0), min(end - k, 1.0), goals[1])
            for k in range(int(begin), math.ceil(end))
        )
    }
    if begin:
        changes["start_pose"] = goals[0]
    return (times[1] - times[0]) / path.duration, changes


def waypoint_shares(file: StrokeFile) -> FloatArray:
    """Return which shares (N,) of the way through a file's waypoints are behind each of them."""
    steps = np.linalg.norm(np.diff(np.array(file.waypoints)[:, :3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)]) / max(float(steps.sum()), 1e-12)


def rows_alone(file: StrokeFile, raster: Raster) -> StrokeFile:
    """Return the stroke along rows of a raster and the steps between them: no leads, no rounded corners.

    Parameters
    ----------
    file : StrokeFile
    raster : Raster
        In place of its own.
    """
    left_out = (
        "part_of",
        "begins_at",
        "blend_radius_m",
        "lead_in_m",
        "lead_out_m",
        "speed_tolerance",
        "passes",
        "time_laws",
    )
    return file.changed(name="rows", raster=raster, backwards=False, **dict.fromkeys(left_out))


def require_apart(
    files: Sequence[StrokeFile], number: int, source: str, key_of: Callable[[int], str]
) -> None:
    """Refuse a raster in parts where poses of strokes depend on its end.

    Parameters
    ----------
    files : sequence of StrokeFile
    number : int
        Of the raster's stroke.
    source : str
        The scene's, for messages.
    key_of : callable
        From the number of a stroke to its key.

    Raises
    ------
    SceneError
        When it is in the frame of the tool, or the stroke behind it begins where it ends.
    """
    raster, expected = files[number].raster, "for a raster that is in parts"
    if raster is not None and raster.frame == "tool":
        raise SceneError(source, f"{key_of(number)}.raster.frame", "tool", f"another frame, {expected}")
    if number + 1 < len(files) and not files[number + 1].has_own_start:
        raise SceneError(source, f"{key_of(number + 1)}.from", "nothing", f"a pose, behind {expected[4:]}")


def _length(raster: Raster, pieces: Sequence[RowPiece]) -> float:
    """About the length of the way over pieces of rows, m."""
    rows = sum(piece.length + 2 * raster.overscan_m for piece in pieces)
    return rows + (len(pieces) - 1) * raster.spacing_m


def _stretch(file: StrokeFile, raster: Raster, cell: Sequence[RowPiece], whole: Sequence[RowPiece]) -> float:
    """How much shorter the shortest leg of a part may be than the longest one of the raster was."""
    if file.blend_radius_m is not None:
        return max(_length(raster, whole) / _length(raster, cell), 1.0)
    over = 2 * raster.overscan_m
    longest, shortest = max(each.length for each in whole), min(each.length for each in cell)
    return (longest + over) / (shortest + over)


def _name(name: str, number: int, taken: Collection[str]) -> str:
    """The name of a part that no other stroke has."""
    part = f"{name}_{number}"
    while part in taken:
        part = f"{name}_part_{number}" if part == f"{name}_{number}" else f"{part}_"
    return part
