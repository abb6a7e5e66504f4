"""From the tracking errors in a plan directory back to a Tracking."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.archive.folder import PLAN_FILE, read_file
from cmbot.archive.strict_json import read_json
from cmbot.archive.tables import read_rows
from cmbot.archive.tracking import COLUMNS, FORMAT, TRACKING_FILES
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.common.validation import counted, given_path, shown, validated
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan, require_plan
from cmbot.simulation import (
    MotionTracking,
    PrescribedMotion,
    SimulationOptions,
    Tracking,
    expected_tool,
    motion_tracking,
)

__all__ = ["load_tracking"]

_PLANNED, _BASELINE, _FIGURES = TRACKING_FILES


def load_tracking(plan: Plan, directory: str | Path) -> Tracking | None:
    """Read the tracking errors beside a plan; their figures are computed again.

    Parameters
    ----------
    plan : Plan
        From that directory.
    directory : str or Path

    Returns
    -------
    Tracking or None
        None where the plan has not been simulated.

    Raises
    ------
    InputError
        When `plan` is none, or `directory` no path.
    ArchiveError
        When a file is missing, damaged, of another version, or does not belong to the others.
    """
    require_plan(plan, "cmbot.load_tracking")
    folder = given_path(directory, "cmbot.load_tracking", "directory", "the path of a plan directory")
    if not any((folder / name).exists() for name in TRACKING_FILES):
        return None
    source = folder / _FIGURES
    data = read_json(read_file(source), str(source))
    if data.get("format") != FORMAT:
        raise ArchiveError(str(source), "format", shown(data.get("format")), repr(FORMAT))
    contents = {name: read_file(folder / name) for name in (PLAN_FILE, _PLANNED, _BASELINE)}
    for name, content in contents.items():
        got, expected = hashlib.sha256(content).hexdigest(), _entry(data, source, "files", name)
        if got != expected:
            why = f"{shown(expected)[:16]}…: {name} has changed since the simulation; simulate again"
            raise ArchiveError(str(source), f"files.{name}", f"{got[:16]}… now", why)
    options = validated(SimulationOptions, _entry(data, source, "options"), str(source), ArchiveError)
    drives = {
        "planned": (_PLANNED, PrescribedMotion.along(plan.trajectory), plan.sag),
        "baseline": (_BASELINE, PrescribedMotion.through(plan.baseline.t, plan.baseline.q), None),
    }
    motions = {
        name: _motion(plan, drive, contents[file], folder / file, _frequencies(data, source, name), sag)
        for name, (file, drive, sag) in drives.items()
    }
    return Tracking(options=options, seconds=float(_number(data, source, "seconds")), **motions)


def _motion(
    plan: Plan,
    drive: PrescribedMotion,
    content: bytes,
    source: Path,
    frequencies: FloatArray,
    sag: Sag | None,
) -> MotionTracking:
    table = np.array(read_rows(content, str(source), COLUMNS))
    if len(table) < 2 or not np.isfinite(table).all() or not (np.diff(table[:, 0]) > 0).all():
        got, expected = (
            counted(len(table), "row"),
            "two or more rows of finite numbers, their times increasing",
        )
        raise ArchiveError(str(source), "", got, expected)
    t, error, static = table[:, 0].copy(), table[:, 1:4].copy(), table[:, 4:7].copy()
    rigid, predicted = expected_tool(plan.robot, drive, t, sag)
    return motion_tracking(plan.task, drive, t, rigid + predicted, error, static, frequencies)


def _frequencies(data: dict[str, Any], source: Path, motion: str) -> FloatArray:
    modes = _entry(data, source, motion, "modes")
    if not isinstance(modes, list):
        raise ArchiveError(str(source), f"{motion}.modes", shown(modes), "a list")
    counted_modes = {**data, motion: {"modes": dict(enumerate(modes))}}
    found = [_number(counted_modes, source, motion, "modes", k, "frequency") for k in range(len(modes))]
    return np.array(found, dtype=np.float64)


def _number(data: Any, source: Path, *path: str | int) -> float:
    value = _entry(data, source, *path)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ArchiveError(str(source), ".".join(map(str, path)), shown(value), "a number")
    return float(value)


def _entry(data: Any, source: Path, *path: str | int) -> Any:
    for depth, key in enumerate(path, start=1):
        if not isinstance(data, dict) or key not in data:
            raise ArchiveError(str(source), ".".join(map(str, path[:depth])), "nothing", "an entry")
        data = data[key]
    return data
