"""Tables of deflections as they are: a posture, a weight, and how far it moved the tool, in each row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cmbot.common.errors import InputError
from cmbot.common.reading.text_table import read_table
from cmbot.common.reading.validation import counted
from cmbot.planning import robot_of
from cmbot.scene import load_scene

_WEIGHT_COLUMNS = ("weight_kg", "weight", "load_kg", "load", "mass_kg", "mass", "kg")
_IN_MILLIMETRES = {"": 1.0, "mm": 1.0, "m": 1e3, "um": 1e-3, "µm": 1e-3}
# Weights that differ by less, kg, are one.
_WEIGHT_TOLERANCE_KG = 1e-3


def read_deflections(path: str | Path, scene: str) -> list[dict[str, Any]]:
    """Read a table of deflections as the contents of files of measurements, one for each weight.

    Columns are the joints, by their names or ``q1`` and so on, in rad, of joints that slide m, or with the
    suffix ``_deg``; ``weight_kg``; and ``dx``, ``dy``, ``dz``, or some of them, along the axes of W in mm.

    Parameters
    ----------
    path : str or Path
    scene : str
        A scene file, or the name of a shipped scene: the robot and its base.

    Raises
    ------
    InputError
        When it is no such table; or as `cmbot.load_scene`.
    """
    table = read_table(Path(path), InputError, kind="a table of deflections")
    postures, _ = table.joints(robot_of(load_scene(scene)).joints)
    weight = table.index(*_WEIGHT_COLUMNS)
    axes = {axis: table.index(f"d{axis}", f"d{axis}_mm") for axis in "xyz"}
    measured = {axis: column for axis, column in axes.items() if column is not None}
    if weight is None or not measured:
        what = "a column weight_kg" if weight is None else "columns dx, dy, dz, or some of them"
        raise InputError(table.source, "line 1", f"the columns {','.join(table.names)}", what)
    units = [table.units[column].lower() for column in measured.values()]
    if unknown := [unit for unit in units if unit not in _IN_MILLIMETRES]:
        raise InputError(table.source, "line 1", f"the unit {unknown[0]}", "mm, m or um")
    kilograms = table.numbers([weight])[:, 0]
    millimetres = table.numbers(list(measured.values())) * [_IN_MILLIMETRES[unit] for unit in units]
    if (wrong := np.flatnonzero(kilograms <= 0)).size:
        key = f"line {table.lines[wrong[0]]}, {table.names[weight]}"
        raise InputError(table.source, key, f"{kilograms[wrong[0]]:g}", "the weight that was hung on, kg")
    sheets = list[dict[str, Any]]()
    for load in np.unique(np.round(kilograms / _WEIGHT_TOLERANCE_KG)) * _WEIGHT_TOLERANCE_KG:
        rows = np.flatnonzero(np.abs(kilograms - load) <= _WEIGHT_TOLERANCE_KG)
        measurements = [
            {
                "posture": postures[row].tolist(),
                "deflection_mm": dict(zip(measured, millimetres[row].tolist(), strict=True)),
            }
            for row in rows
        ]
        sheets.append(
            {
                "format": "cmbot-measurements/1",
                "scene": scene,
                "weight_kg": float(load),
                "measurements": measurements,
            }
        )
    if sum(len(sheet["measurements"]) for sheet in sheets) != len(table.rows):
        got = counted(len(table.rows), "row")
        raise InputError(table.source, table.names[weight], got, "weights that are told apart by 1 g or more")
    return sheets
