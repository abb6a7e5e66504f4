"""The motions of a job from the files of its plan directory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cmbot.archive.consistency import require_times
from cmbot.archive.motion_files import read_knots
from cmbot.archive.names import EARLIER_FORMAT, PLAN_FILE
from cmbot.archive.schema import PlanFile, SegmentFile
from cmbot.common.errors import ArchiveError
from cmbot.planning import QuinticTrajectory

__all__ = ["job_trajectories"]

# Tolerance of times and of knots that two files have, relative to the larger of 1 and their size.
_SAME = 1e-9


def job_trajectories(
    file: PlanFile, contents: Mapping[str, bytes], folder: Path, dof: int, duration: float
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
    duration : float, s
        Of the stroke, by the scene.

    Raises
    ------
    ArchiveError
        When a file is damaged, or its times are not those of the segments.
    """
    stroke = read_knots(contents["trajectory.npz"], str(folder / "trajectory.npz"), dof)
    require_times(stroke.t, duration, str(folder / "trajectory.npz"), "the scene")
    if file.format == EARLIER_FORMAT:
        return tuple(
            stroke if segment.kind == "stroke" else _earlier(segment, contents, folder, dof)
            for segment in file.segments
        )
    source = str(folder / "job.npz")
    whole = read_knots(contents["job.npz"], source, dof)
    require_times(whole.t, _seconds(file), source, PLAN_FILE)
    parts = [_part(whole, segment, source) for segment in file.segments]
    for k, segment in enumerate(file.segments):
        if segment.kind == "stroke":
            _require_same(parts[k], stroke, source)
            parts[k] = stroke
    return tuple(parts)


def _seconds(file: PlanFile) -> float:
    return file.segments[-1].begin + file.segments[-1].seconds


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
    ends = np.array([segment.begin, segment.begin + segment.seconds])
    first, last = (int(np.abs(whole.t - end).argmin()) for end in ends)
    if last <= first or (np.abs(whole.t[[first, last]] - ends) > _SAME * np.maximum(ends, 1.0)).any():
        got = "no knot where a segment begins or ends"
        raise ArchiveError(source, "t", got, f"knots at {ends[0]:g} and {ends[1]:g} s ({segment.name})")
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
