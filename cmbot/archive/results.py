"""What is added to the directory of a plan: tracking errors and their tables, and an excitation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cmbot.archive.folder import read_folder
from cmbot.archive.places import add_results
from cmbot.archive.records import EXCITATION_FILE, PLAN_FILE, TRACKING_FILES, Entry, json_bytes, read_json
from cmbot.archive.tables import OFF_PATH, read_table, require_table, table_csv
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.common.reading.validation import adapter, given_path, require_type, shown, validated
from cmbot.excitation import Excitation
from cmbot.planning import Plan, require_plan
from cmbot.simulation import (
    MotionTracking,
    PrescribedWork,
    SimulationOptions,
    StiffnessCase,
    Tracking,
    execution_error,
    expected_tool,
    motion_tracking,
)
from cmbot.version import __version__

T = TypeVar("T")

_FORMATS = {TRACKING_FILES[2]: "cmbot-tracking/1", EXCITATION_FILE: "cmbot-excitation/1"}
_PLANNED, _BASELINE, _METRICS = TRACKING_FILES
_TABLES = {_PLANNED: "planned", _BASELINE: "baseline"}
_TRACKING_COLUMNS = (
    "t",
    *(f"{part}_{axis}" for part in ("error", "static", OFF_PATH) for axis in "xyz"),
    OFF_PATH,
)
# Of an elastic base; rotations as in `MotionTracking.base`.
_BASE = tuple(f"{part}_{axis}" for part in ("base", "base_rotation", "base_torque") for axis in "xyz")


class _Mode(Entry):
    frequency: float


class _Motion(Entry):
    modes: tuple[_Mode, ...]


class _TrackingFile(Entry):
    options: SimulationOptions
    seconds: float
    interval: tuple[StiffnessCase, ...] = ()
    baseline: _Motion | None
    planned: _Motion


def save_tracking(
    tracking: Tracking,
    directory: str | Path,
    *,
    force: bool = False,
    added: Mapping[str, bytes | str] | None = None,
) -> tuple[Path, ...]:
    """Add the tracking errors to a plan directory, all files or none.

    The metrics have a file of their own, ``tracking.json``; ``plan.json`` takes the hashes of the new files.

    Parameters
    ----------
    tracking : Tracking
        Of the plan that was saved there.
    directory : str or Path
    force : bool
        Replace tracking errors that are there.
    added : mapping from str to bytes or str, optional
        Pages and plots that are added with them, by their names: those that the command line gives them.

    Returns
    -------
    tuple of Path
        Of the files.

    Raises
    ------
    InputError
        When `tracking` is no Tracking, or `directory` no path.
    ArchiveError
        When `directory` is no plan directory, holds tracking errors already, a number is not finite, another
        process is writing there, or the system refuses.

    Examples
    --------
    >>> [path.name for path in cmbot.save_tracking(tracking, "out/triangle")]
    ['tracking.csv', 'tracking_baseline.csv', 'tracking.json']
    """
    expected = "a Tracking, as cmbot.simulate returns it"
    require_type(tracking, Tracking, "cmbot.save_tracking", "tracking", expected)
    folder = given_path(directory, "cmbot.save_tracking", "directory", "the path of a plan directory")
    motions = {name: getattr(tracking, attribute) for name, attribute in _TABLES.items()}
    contents = {name: _motion_csv(motion, name) for name, motion in motions.items() if motion is not None}
    contents[_METRICS] = json_bytes(tracking_json(tracking), indent=2)
    return add_results(folder, contents, added, force=force)


def load_tracking(plan: Plan, directory: str | Path) -> Tracking | None:
    """Read the tracking errors beside a plan; their metrics are computed again.

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
        When `plan` is no plan, or `directory` no path.
    ArchiveError
        When a file is missing, damaged, of another version, or does not belong to the others.

    Examples
    --------
    >>> read = cmbot.load_tracking(plan, "out/triangle")
    >>> f"{1e3 * read.planned.largest_off_path:.1f} mm off its path, bent"
    '0.2 mm off its path, bent'
    """
    require_plan(plan, "cmbot.load_tracking")
    folder = given_path(directory, "cmbot.load_tracking", "directory", "the path of a plan directory")
    file, contents = _read(folder, _METRICS, _TrackingFile, (_PLANNED, _BASELINE))
    if file is None:
        return None
    source = str(folder / _METRICS)
    works = [(_PLANNED, PrescribedWork.planned(plan), plan.sag)]
    if (other := PrescribedWork.baseline(plan)) is not None:
        works.append((_BASELINE, other, None))
    if (file.baseline is None) != (len(works) == 1) or len(works) + 1 != len(contents):
        got, expected = ", ".join(sorted(contents)), "a table of each motion of the plan"
        raise ArchiveError(source, "baseline", got, expected)
    motions = dict[str, MotionTracking]()
    for name, work, sag in works:
        with_base = contents[name].partition(b"\n")[0].endswith(_BASE[-1].encode())
        columns = _TRACKING_COLUMNS + _BASE if with_base else _TRACKING_COLUMNS
        table = read_table(contents[name], str(folder / name), columns)
        t, error, static = table[:, 0].copy(), table[:, 1:4].copy(), table[:, 4:7].copy()
        rigid, predicted = expected_tool(plan.robot, work, t, sag)
        entry: _Motion = getattr(file, _TABLES[name])
        frequencies = np.array([mode.frequency for mode in entry.modes], dtype=np.float64)
        execution = execution_error(plan.robot, work, t, file.options)
        base = table[:, len(_TRACKING_COLUMNS) :].copy() if with_base else None
        motion = motion_tracking(work, t, rigid + predicted, error, static, frequencies, execution, base)
        require_table(contents[name], _motion_csv(motion, name), str(folder / name))
        motions[_TABLES[name]] = motion
    return Tracking(
        options=file.options,
        seconds=file.seconds,
        interval=file.interval,
        baseline=motions.get("baseline"),
        planned=motions["planned"],
    )


def save_excitation(
    excitation: Excitation,
    directory: str | Path,
    *,
    force: bool = False,
    added: Mapping[str, bytes | str] | None = None,
) -> tuple[Path, ...]:
    """Add an excitation to a plan directory, all files or none; ``plan.json`` takes their hashes.

    Parameters
    ----------
    excitation : Excitation
        Of the plan that was saved there.
    directory : str or Path
    force : bool
        Replace one that is there.
    added : mapping from str to bytes or str, optional
        Pages and plots that are added with it, by their names.

    Returns
    -------
    tuple of Path
        Of the files.

    Raises
    ------
    InputError
        When `excitation` is no Excitation, or `directory` no path.
    ArchiveError
        When `directory` is no plan directory, holds one already, a number is not finite, another process is
        writing there, or the system refuses.

    Examples
    --------
    >>> [path.name for path in cmbot.save_excitation(excitation, "out/triangle")]
    ['excitation.json']
    """
    expected = "an Excitation, as cmbot.excite returns it"
    require_type(excitation, Excitation, "cmbot.save_excitation", "excitation", expected)
    folder = given_path(directory, "cmbot.save_excitation", "directory", "the path of a plan directory")
    contents = {EXCITATION_FILE: json_bytes(excitation_json(excitation), indent=2)}
    return add_results(folder, contents, added, force=force)


def load_excitation(directory: str | Path) -> Excitation | None:
    """Read the excitation beside a plan.

    Parameters
    ----------
    directory : str or Path

    Returns
    -------
    Excitation or None
        None where there is none.

    Raises
    ------
    InputError
        When `directory` is no path.
    ArchiveError
        When a file is missing, damaged or of another version.

    Examples
    --------
    >>> excitation = cmbot.load_excitation("out/triangle")
    """
    folder = given_path(directory, "cmbot.load_excitation", "directory", "the path of a plan directory")
    return _read(folder, EXCITATION_FILE, Excitation)[0]


def excitation_json(excitation: Excitation) -> dict[str, Any]:
    """Return an excitation ready for JSON, SI units but where a key says otherwise."""
    content = adapter(Excitation).dump_python(excitation, mode="json")
    return {"format": _FORMATS[EXCITATION_FILE], "cmbot": __version__, "rms_mm": excitation.rms_mm, **content}


def _motion_csv(motion: MotionTracking, source: str) -> bytes:
    """The table of a motion; distances from the path follow from the rest: others are refused on reading."""
    bent = [] if motion.base is None else [motion.base]
    parts = [motion.t, motion.error, motion.static, motion.path_error, motion.off_path, *bent]
    return table_csv(_TRACKING_COLUMNS + (_BASE if bent else ()), np.column_stack(parts), source)


def _read(
    folder: Path, name: str, kind: type[T], tables: Sequence[str] = ()
) -> tuple[T | None, dict[str, bytes]]:
    """Read results beside a plan, with those of their tables that are there; None where there are none."""

    def wanted(hashes: Mapping[str, str]) -> list[str]:
        # The first table has to be there: without a baseline there is no table of it.
        return [*tables[:1], *(hashes.keys() & tables[1:]), name] if name in hashes else []

    _, contents = read_folder(folder, PLAN_FILE, wanted)
    if not contents:
        return None, contents
    source = str(folder / name)
    data = read_json(contents[name], source)
    if data.get("format") != _FORMATS[name]:
        raise ArchiveError(source, "format", shown(data.get("format")), repr(_FORMATS[name]))
    return validated(kind, data, source, ArchiveError), contents


def tracking_json(tracking: Tracking) -> dict[str, Any]:
    """Return the metrics of tracking errors ready for JSON, SI units."""
    return {
        "format": _FORMATS[_METRICS],
        "cmbot": __version__,
        "options": asdict(tracking.options),
        "seconds": tracking.seconds,
        "baseline": None if tracking.baseline is None else _motion(tracking.baseline),
        "planned": _motion(tracking.planned),
        "interval": [asdict(case) for case in tracking.interval],
    }


def _motion(motion: MotionTracking) -> dict[str, Any]:
    metrics, residual = motion.metrics, motion.metrics.residual
    modes = zip(metrics.mode_frequencies.tolist(), metrics.mode_power.tolist(), strict=True)
    return {
        "stop": motion.stop,
        **{
            part: {name: _by_axis(values) for name, values in vars(getattr(metrics, part)).items()}
            for part in ("total", "static", "dynamic", "path")
        },
        "residual": residual and {**vars(residual), "peak_to_peak": _by_axis(residual.peak_to_peak)},
        "modes": [{"frequency": frequency, "power": power} for frequency, power in modes],
        "largest_command_error": _largest(motion.command),
        "largest_execution_error": None if motion.execution is None else _largest(motion.execution),
        "largest_base_displacement": motion.largest_base_displacement,
        "largest_base_rotation": motion.largest_base_rotation,
        "largest_base_torque": motion.largest_base_torque,
    }


def _largest(vectors: FloatArray) -> float:
    return float(np.nanmax(np.linalg.norm(vectors, axis=1)))


def _by_axis(values: FloatArray) -> dict[str, float]:
    """Numbers of x, y, z and, if there is a fourth, the norm."""
    return dict(zip(("x", "y", "z", "norm"), values.tolist(), strict=False))
