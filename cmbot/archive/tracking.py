"""Tracking errors beside the plan they belong to: two tables and their figures."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.archive.folder import PLAN_FILE, add_file, read_file
from cmbot.archive.strict_json import json_bytes
from cmbot.archive.tables import table_csv
from cmbot.common.errors import ArchiveError
from cmbot.common.validation import given_path, require_type
from cmbot.simulation import ErrorMetrics, MotionTracking, Statistics, Tracking
from cmbot.version import __version__

__all__ = ["COLUMNS", "FORMAT", "TRACKING_FILES", "require_no_tracking", "save_tracking", "tracking_json"]

TRACKING_FILES = ("tracking.csv", "tracking_baseline.csv", "tracking.json")
"""What `save_tracking` writes, the figures last: where they are, the tables are, too."""

FORMAT = "cmbot-tracking/1"
COLUMNS = ("t", *(f"{part}_{axis}" for part in ("error", "static") for axis in "xyz"))


def save_tracking(tracking: Tracking, directory: str | Path, *, force: bool = False) -> tuple[Path, ...]:
    """Add the tracking errors to a plan directory, each file whole or not at all.

    The figures have a file of their own, ``tracking.json``, not a block in ``plan.json``: that one is the
    certified record of what was planned, with the hashes of the files beside it, and stays as it was written.

    Parameters
    ----------
    tracking : Tracking
        Of the plan that was saved there.
    directory : str or Path
    force : bool
        Replace tracking errors that are there.

    Returns
    -------
    tuple of Path
        Of the files.

    Raises
    ------
    InputError
        When `tracking` is none, or `directory` no path.
    ArchiveError
        When `directory` is no plan directory, holds tracking errors already, a number is not finite, or the
        system refuses.
    """
    expected = "a Tracking, as cmbot.simulate returns it"
    require_type(tracking, Tracking, "cmbot.save_tracking", "tracking", expected)
    folder = given_path(directory, "cmbot.save_tracking", "directory", "the path of a plan directory")
    require_no_tracking(folder, force=force)
    tables = {
        name: _table(motion, name)
        for name, motion in zip(TRACKING_FILES, (tracking.planned, tracking.baseline), strict=False)
    }
    plan = read_file(folder / PLAN_FILE)
    hashes = {
        name: hashlib.sha256(content).hexdigest() for name, content in {PLAN_FILE: plan, **tables}.items()
    }
    figures = json_bytes(tracking_json(tracking) | {"files": hashes}, indent=2)
    contents = {**tables, TRACKING_FILES[-1]: figures}
    return tuple(add_file(folder, name, content) for name, content in contents.items())


def require_no_tracking(directory: str | Path, *, force: bool = False) -> None:
    """Refuse a directory that `save_tracking` would refuse; worth asking before the simulation.

    Raises
    ------
    ArchiveError
        When tracking errors are there and are not to be replaced.
    """
    folder = Path(directory)
    for name in TRACKING_FILES:
        if (folder / name).exists() and not force:
            expected = "a plan without tracking errors; --force (in Python force=True) replaces them"
            raise ArchiveError(str(folder / name), "", "a file that is already there", expected)


def tracking_json(tracking: Tracking) -> dict[str, Any]:
    """Return the figures of tracking errors as JSON can hold them, SI units."""
    return {
        "format": FORMAT,
        "cmbot": __version__,
        "options": asdict(tracking.options),
        "seconds": tracking.seconds,
        "baseline": _motion(tracking.baseline),
        "planned": _motion(tracking.planned),
    }


def _motion(motion: MotionTracking) -> dict[str, Any]:
    figures = motion.metrics
    return {
        "stop": motion.stop,
        **{part: _statistics(getattr(figures, part)) for part in ("total", "static", "dynamic", "path")},
        "residual": _residual(figures),
        "modes": [
            {"frequency": frequency, "power": power}
            for frequency, power in zip(
                figures.mode_frequencies.tolist(), figures.mode_power.tolist(), strict=True
            )
        ],
        "largest_command_error": float(np.linalg.norm(motion.command, axis=1).max()),
    }


def _statistics(statistics: Statistics) -> dict[str, dict[str, float]]:
    names = ("x", "y", "z", "norm")
    return {key: dict(zip(names, value.tolist(), strict=True)) for key, value in vars(statistics).items()}


def _residual(figures: ErrorMetrics) -> dict[str, Any] | None:
    residual = figures.residual
    if residual is None:
        return None
    return {
        "seconds": residual.seconds,
        "peak_to_peak": dict(zip("xyz", residual.peak_to_peak.tolist(), strict=True)),
        "diameter": residual.diameter,
        "decay": residual.decay,
    }


def _table(motion: MotionTracking, name: str) -> bytes:
    table = np.column_stack([motion.t, motion.error, motion.static])
    if not np.isfinite(table).all():
        row, column = np.argwhere(~np.isfinite(table))[0]
        key = f"line {row + 2}, {COLUMNS[column]}"
        raise ArchiveError(name, key, table[row, column], "a finite number")
    return table_csv(COLUMNS, table)
