"""Whether the parts of a plan directory belong together."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cmbot.archive.folder import PLAN_FILE
from cmbot.archive.schema import PlanFile
from cmbot.arrays import FloatArray
from cmbot.errors import ArchiveError
from cmbot.planning import Approach, QuinticTrajectory

__all__ = ["require_fit", "require_times", "require_unchanged"]

# Times and shares agree to this relative tolerance, angles to this one in rad: degrees round.
_SAME, _SAME_ANGLE = 1e-9, 1e-9


def require_times(t: FloatArray, duration: float, source: str, whose: str) -> None:
    """Refuse times `t` (N,) of the file `source` that do not run from 0 to `duration`, s, as `whose` do."""
    if t[0] != 0.0 or abs(t[-1] - duration) > _SAME * duration:
        raise ArchiveError(source, "t", f"{t[0]:g} to {t[-1]:g} s", f"0 to {duration:g} s, as in {whose}")


def require_unchanged(folder: Path, file: PlanFile, contents: Mapping[str, bytes]) -> None:
    """Refuse files that were not saved together: the figures would be another motion's."""
    for name, content in contents.items():
        if file.files.get(name) != hashlib.sha256(content).hexdigest():
            expected = f"the file that was saved with {PLAN_FILE}"
            raise ArchiveError(str(folder / name), "", "other content", expected)
    if strange := sorted(file.files.keys() - contents.keys()):
        got = ", ".join(strange)
        raise ArchiveError(str(folder / PLAN_FILE), "files", got, "none but the files of this plan")


def require_fit(
    file: PlanFile,
    posture: FloatArray,
    work: QuinticTrajectory,
    approach: Approach | None,
    folder: Path,
) -> None:
    """Refuse a plan whose motions do not join, or whose figures of the global stage are not this plan's.

    Parameters
    ----------
    file : PlanFile
    posture : (n,), rad
        The scene's.
    work : QuinticTrajectory
    approach : Approach or None
    folder : Path
        The plan directory, for messages.

    Raises
    ------
    ArchiveError
        For the first thing that does not fit.
    """
    source = str(folder / PLAN_FILE)
    _require_start(file, work, source)
    sliding = file.options.knots == "sliding"
    _require_there(file.approach, sliding and file.start.moved_deg > 0, source, "approach")
    _require_there(file.floor, sliding, source, "floor")
    _require_there(file.choice, sliding, source, "choice")
    _require_floor(file, len(work.t), source)
    if approach is not None:
        _require_join(approach.trajectory, posture, work, str(folder / "approach.npz"))


def _require_start(file: PlanFile, work: QuinticTrajectory, source: str) -> None:
    start = file.start.start().posture
    if start.shape != work.q[0].shape:
        raise ArchiveError(source, "start.posture_deg", f"{len(start)} joints", f"{len(work.q[0])} joints")
    _require_angles(start, work.q[0], source, "start.posture_deg", "where trajectory.npz begins")


def _require_there(block: object, expected: bool, source: str, key: str) -> None:
    """Refuse a block that is missing, or there without a reason."""
    if (block is not None) == expected:
        return
    if expected:
        raise ArchiveError(source, key, "null", "a block: the knots slide, or the work starts elsewhere")
    raise ArchiveError(source, key, "a block", "null: the knots are fixed, or the work starts at once")


def _require_floor(file: PlanFile, via_points: int, source: str) -> None:
    """Refuse a floor that is not one of this plan's via-points, and figures that are not the floor's."""
    floor = file.floor
    if floor is None:
        _require_number(file.torque_floor, None, source, "torque_floor")
        _require_number(file.gap_to_floor, None, source, "gap_to_floor")
        return
    if len(floor.each) != via_points:
        raise ArchiveError(source, "floor.each", f"{len(floor.each)} numbers", f"{via_points} numbers")
    if floor.via_point >= via_points:
        raise ArchiveError(source, "floor.via_point", floor.via_point, f"less than {via_points}")
    _require_number(floor.torque, floor.each[floor.via_point], source, "floor.torque")
    _require_number(file.torque_floor, floor.torque, source, "torque_floor")
    gap = file.planned.peak_guardrail_torque / floor.torque - 1.0
    _require_number(file.gap_to_floor, gap, source, "gap_to_floor")


def _require_number(got: float | None, expected: float | None, source: str, key: str) -> None:
    if got is None or expected is None:
        same = got is expected
    else:
        same = abs(got - expected) <= _SAME * max(1.0, abs(expected))
    if not same:
        shown = "null" if expected is None else f"{expected:g}"
        raise ArchiveError(source, key, "null" if got is None else got, f"{shown}, by the other figures")


def _require_join(
    approach: QuinticTrajectory, posture: FloatArray, work: QuinticTrajectory, source: str
) -> None:
    """Refuse an approach that does not lead from the scene's posture to the work: the arm would jump."""
    _require_angles(approach.q[0], posture, source, "q", "the scene's posture at first")
    _require_angles(approach.q[-1], work.q[0], source, "q", "where the work starts at last")


def _require_angles(got: FloatArray, expected: FloatArray, source: str, key: str, what: str) -> None:
    if np.abs(got - expected).max() > _SAME_ANGLE:
        shown = ", ".join(f"{angle:.3f}" for angle in np.degrees(got))
        wanted = ", ".join(f"{angle:.3f}" for angle in np.degrees(expected))
        raise ArchiveError(source, key, f"({shown}) deg", f"{what}, ({wanted}) deg")
