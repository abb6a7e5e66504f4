"""Tables of what was measured as they are: in each row a posture, a weight and how far it moved the tool."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.input_files import is_file
from cmbot.common.reading.text_table import GAPS, TextTable, read_table
from cmbot.common.reading.validation import hint, validated
from cmbot.identification.measurements import Measurements, MeasurementsFile, MeasuringSetup, in_si
from cmbot.planning import robot_of
from cmbot.scene import load_scene

_WEIGHT_COLUMNS = ("weight_kg", "weight", "load_kg", "load", "mass_kg", "mass", "kg")
_DEFLECTION_COLUMNS = ("dx", "dy", "dz")
# What a sheet says of all its rows, and its key where another name is usual.
_SETUP_KEYS = tuple(key for key in MeasuringSetup.model_fields if key != "prior")
_SETUP_COLUMNS = {
    **{key: key for key in _SETUP_KEYS if key != "weight_kg"},
    **{"gauge_mm": "gauge_sd_mm", "gauge": "gauge_sd_mm"},
}
_ROW_KEY = re.compile(r"measurements\[(\d+)\](.*)")
# Columns for whoever reads the table.
_REMARKS = ("note", "notes", "remark", "comment", "n", "id", "index", "row", "#", "")


def read_deflections(
    path: str | Path, scene: str, *, gauge_sd_mm: float | None = None, job: FloatArray | None = None
) -> tuple[Measurements, ...]:
    """Read a table of measurements, as sheets would have them: one for all rows of a weight and a gauge.

    Columns are the joints, by their names or ``q1`` and so on, in rad, of joints that slide m, or with the
    suffix ``_deg``; ``weight_kg``; ``dx``, ``dy``, ``dz``, or some of them, along the axes of W in mm;
    ``record``, a file relative to the table; and keys of sheets such as ``gauge_sd_mm``, ``record_axes``.
    Empty cells are not measured, or as in a sheet without the key.

    Parameters
    ----------
    path : str or Path
    scene : str
        A scene file, or the name of a shipped scene: the robot and its base.
    gauge_sd_mm : float, optional
        Error of the gauge in rows that do not say their own.
    job : (M, n), rad and m, optional
        Postures in which the sag is wanted.

    Raises
    ------
    InputError
        When it is no such table; or as `cmbot.load_scene`.
    """
    table = read_table(Path(path), InputError, kind="a table of deflections")
    loaded = load_scene(scene)
    postures, used = table.joints(robot_of(loaded).joints)
    posture = "posture"
    if all(table.names[column].endswith("_deg") for column in used):
        posture, postures = "posture_deg", table.numbers(used)
    weight, record = table.index(*_WEIGHT_COLUMNS), table.index("record")
    setup = {
        _SETUP_COLUMNS[name]: column for column, name in enumerate(table.names) if name in _SETUP_COLUMNS
    }
    axes = {name[1]: table.index(name) for name in _DEFLECTION_COLUMNS}
    measured = {axis: column for axis, column in axes.items() if column is not None}
    _require_columns(table, [*used, weight, record, *setup.values(), *measured.values()])
    deflections = 1e3 * table.lengths(list(measured.values()), "mm", gaps=True)
    if weight is not None:
        setup["weight_kg"] = weight
    given = {key: _values(table, column) for key, column in setup.items()}
    sheets = defaultdict[tuple[tuple[str, object], ...], list[int]](list)
    for row, cells in enumerate(table.rows):
        own = dict[str, object]() if gauge_sd_mm is None else {"gauge_sd_mm": gauge_sd_mm}
        own |= {key: values[row] for key, values in given.items() if cells[setup[key]].lower() not in GAPS}
        hung = np.isfinite(deflections[row]).any()
        if hung and weight is not None and not own.get("weight_kg"):
            key, got = f"line {table.lines[row]}, {table.names[weight]}", cells[weight] or "nothing"
            expected = "the weight that was hung on, kg: a row is a place with it less that without it"
            raise InputError(table.source, key, got, expected)
        sheets[tuple(own.items())].append(row)
    along = job if job is None else job.tolist()
    data = {"format": "cmbot-measurements/1", "scene": _named(scene), "job": along}
    records = [None if record is None else cells[record] or None for cells in table.rows]
    moved = [[x if np.isfinite(x) else None for x in by] for by in deflections.tolist()]
    each = [
        {posture: q, "deflection_mm": dict(zip(measured, by, strict=True)), "record": own}
        for q, by, own in zip(postures.tolist(), moved, records, strict=True)
    ]
    return tuple(
        _sheet(table, rows, data | dict(own) | {"measurements": [each[row] for row in rows]})
        for own, rows in sheets.items()
    )


def _named(scene: str) -> str:
    """A scene's name, or its path wherever the table lies."""
    return str(Path(scene).resolve()) if is_file(scene) else scene


def _require_columns(table: TextTable, used: Sequence[int | None]) -> None:
    """Refuse a table in which nothing was measured, or that has a column of which nothing is known."""
    setup = dict.fromkeys(_SETUP_COLUMNS.values())
    known = ("weight_kg", *_DEFLECTION_COLUMNS, "record", *setup, *_REMARKS[:1])
    if not {"record", *_DEFLECTION_COLUMNS} & {*table.names}:
        expected = "columns dx, dy, dz, or some of them, or record"
        raise InputError(table.source, "line 1", f"the columns {','.join(table.names)}", expected)
    if {*_DEFLECTION_COLUMNS} & {*table.names} and not {*_WEIGHT_COLUMNS} & {*table.names}:
        got = f"the columns {','.join(table.names)}"
        raise InputError(table.source, "line 1", got, "a column weight_kg beside dx, dy, dz")
    for column, name in enumerate(table.names):
        if column not in used and name not in _REMARKS:
            expected = f"a column of a joint (with _deg in degrees) or a known one{hint(name, known)}"
            raise InputError(table.source, f"line 1, {name}", "an unknown column", expected, known)


def _values(table: TextTable, column: int) -> Sequence[object]:
    """The cells of a column that says with what was measured."""
    if table.names[column] == "record_axes":
        return [row[column] for row in table.rows]
    return list(table.numbers([column], gaps=True)[:, 0].tolist())


def _sheet(table: TextTable, rows: Sequence[int], data: Mapping[str, Any]) -> Measurements:
    """Some rows of a table as a sheet; errors name their lines."""
    lines = [f"line {table.lines[row]}" for row in rows]
    try:
        file = validated(MeasurementsFile, data, table.source, InputError)
        return replace(in_si(file, Path(table.source).parent, table.source), rows=tuple(lines))
    except InputError as error:
        at = _ROW_KEY.match(error.key)
        if error.source != table.source or (at is None and error.key not in _SETUP_KEYS):
            raise
        key = f"{lines[0]}, {error.key}" if at is None else lines[int(at[1])] + at[2].replace(".", ", ")
        raise InputError(table.source, key, error.got, error.expected, error.choices) from error
