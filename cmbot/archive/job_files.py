"""The motions of a job from the files of its plan directory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cmbot.archive.consistency import require_times
from cmbot.archive.motion_files import read_knots
from cmbot.archive.names import EARLIER_FORMAT, PLAN_FILE
from cmbot.archive.schema import PlanFile, SegmentFile
from cmbot.common.errors import ArchiveError
from cmbot.planning import QuinticTrajectory
from cmbot.scene import Stroke

__all__ = ["job_trajectories"]

# Tolerance of times and of knots that two files have, relative to the larger of 1 and their size.
_SAME = 1e-9


def job_trajectories(
    file: PlanFile, contents: Mapping[str, bytes], folder: Path, dof: int, strokes: Sequence[Stroke]
) -> tuple[QuinticTrajectory, ...]:
    """Return the trajectory of each segment, on its own clock.

    Parameters
    ----------
    file : PlanFile
        Its segments follow on each other.
    contents : mapping of str to bytes
        The files by their names.
    folder : Path
        The plan directory, for messages.
    dof : int
    strokes : sequence of Stroke
        By the scene.

    Raises
    ------
    ArchiveError
        When a file is damaged, or its times are not those of the segments.
    """
    work = read_knots(contents["trajectory.npz"], str(folder / "trajectory.npz"), dof)
    if len(strokes) == 1:
        duration = strokes[0].path.duration
        require_times(work.t, duration, str(folder / "trajectory.npz"), "the scene")
    if file.format == EARLIER_FORMAT:
        return tuple(
            work if segment.kind == "stroke" else _earlier(segment, contents, folder, dof)
            for segment in file.segments
        )
    source = str(folder / "job.npz")
    whole = read_knots(contents["job.npz"], source, dof)
    last = file.segments[-1]
    require_times(whole.t, last.begin + last.seconds, source, PLAN_FILE)
    parts = [_part(whole, segment, source) for segment in file.segments]
    along = [k for k, segment in enumerate(file.segments) if segment.kind == "stroke"]
    if len(strokes) == 1:
        _require_same(parts[along[0]], work, source)
        parts[along[0]] = work
        return tuple(parts)
    begin = file.segments[along[0]].begin
    end = file.segments[along[-1]].begin + file.segments[along[-1]].seconds
    _require_same(_between(whole, begin, end, source, "the strokes"), work, source)
    for k, stroke in zip(along, strokes, strict=True):
        require_times(parts[k].t, stroke.path.duration, source, "the scene")
        times = stroke.via_times
        if len(times) != len(parts[k].t) or not np.allclose(parts[k].t, times, rtol=_SAME, atol=_SAME):
            expected = f"knots at the via-points of {stroke.name}"
            raise ArchiveError(source, "t", "knots at other times", expected)
        # The sums on the job's clock are rounded.
        parts[k] = replace(parts[k], t=times)
    return tuple(parts)


def _earlier(
    segment: SegmentFile, contents: Mapping[str, bytes], folder: Path, dof: int
) -> QuinticTrajectory:
    """The trajectory of a free move that has files of its own."""
    source = str(folder / f"{segment.name}.npz")
    trajectory = read_knots(contents[f"{segment.name}.npz"], source, dof)
    require_times(trajectory.t, segment.seconds, source, PLAN_FILE)
    return trajectory


def _part(whole: QuinticTrajectory, segment: SegmentFile, source: str) -> QuinticTrajectory:
    """The knots of a segment, which has one at either end."""
    return _between(whole, segment.begin, segment.begin + segment.seconds, source, segment.name)


def _between(whole: QuinticTrajectory, begin: float, end: float, source: str, what: str) -> QuinticTrajectory:
    """The knots between two times, s, which have one at either end."""
    ends = np.array([begin, end])
    first, last = (int(np.abs(whole.t - each).argmin()) for each in ends)
    if last <= first or (np.abs(whole.t[[first, last]] - ends) > _SAME * np.maximum(ends, 1.0)).any():
        got = "no knot where a segment begins or ends"
        raise ArchiveError(source, "t", got, f"knots at {begin:g} and {end:g} s ({what})")
    part = slice(first, last + 1)
    return QuinticTrajectory(
        t=whole.t[part] - whole.t[first], q=whole.q[part], v=whole.v[part], a=whole.a[part]
    )


def _require_same(part: QuinticTrajectory, stroke: QuinticTrajectory, source: str) -> None:
    """Refuse a job whose work is another one than that of trajectory.npz."""
    for name in ("t", "q", "v", "a"):
        got, expected = getattr(part, name), getattr(stroke, name)
        if got.shape != expected.shape or not np.allclose(got, expected, rtol=_SAME, atol=_SAME):
            raise ArchiveError(source, name, "other knots of the work", "those of trajectory.npz")
