"""Tables of text as programs and loggers write them: columns by name, whatever separates them.

Cells are separated by commas, semicolons, tabs or blanks, as the first row shows; with other separators than
the comma a comma may be the decimal mark. Empty lines do not count; lines that begin with ``#`` neither, but
for one with names of the columns before the first row. Units may follow names in brackets: ``Time (s)``,
and those of places ``_`` or ``/``: ``x_mm``.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.input_files import read_input
from cmbot.common.reading.validation import counted, hint, shown
from cmbot.common.representation import ShortRepr

_NAME_AND_UNIT = re.compile(r"\s*(.*?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*")
_SEPARATORS = (";", "\t", ",")
_COMMENT_MARK = "#"
# Of a place the unit may end the name, too: x_mm, dx/mm.
_PLACE_AND_UNIT = re.compile(r"\s*(d?[xyz])[_/](m|mm|cm|um|in)\s*", re.IGNORECASE)
_IN_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "in": 0.0254}
_IN_RADIANS_OR_METRES = {"rad": 1.0, "deg": math.radians(1.0), "°": math.radians(1.0), "m": 1.0, "mm": 1e-3}
_IN_SECONDS = {**dict.fromkeys(("s", "sec", "seconds"), 1.0), "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
# What stands where nothing was measured.
GAPS = ("", "-", "nan", "null", "none")


@dataclass(frozen=True, kw_only=True, eq=False)
class TextTable(ShortRepr):
    """Rows of cells, each with its line in the file.

    Attributes
    ----------
    source : str
        The file.
    names : tuple of str
        Of the columns, in small letters, without their units; empty where the file has none.
    units : tuple of str
        Of the columns, empty where none is given.
    rows : tuple of tuple of str
        N rows, each with a cell for every column.
    lines : tuple of int
        Their N lines in the file, from 1.
    error_type : type
        What is raised of a cell that is no number.
    """

    source: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    error_type: type[InputError]

    def index(self, *names: str) -> int | None:
        """Return the number of the column that has one of some names; None where there is none.

        Raises
        ------
        InputError
            When several columns have it.
        """
        name = next((name for name in names if name in self.names), None)
        if name is None:
            return None
        if (number := self.names.count(name)) > 1:
            got = f"{number} columns of this name"
            raise self.error_type(self.source, f"line 1, {name}", got, "one")
        return self.names.index(name)

    def columns(self, names: Iterable[str]) -> list[int]:
        """Return the numbers of the columns of those names; none of them where any is not there."""
        found = [self.index(name) for name in names]
        return [] if None in found else [column for column in found if column is not None]

    def joints(self, names: Sequence[str]) -> tuple[FloatArray, list[int]]:
        """Return the positions (N, n) of joints, rad and m, and the numbers of their columns.

        Each has a column of its name, or ``q1`` and so on, in degrees with the suffix or unit ``deg``.

        Raises
        ------
        InputError
            When one has none, or one of another unit, or a cell is no finite number.
        """
        columns, scales = list[int](), list[float]()
        for number, joint in enumerate(names, start=1):
            called = (joint.lower(), f"q{number}")
            at, in_degrees = self.index(*called), self.index(*(f"{name}_deg" for name in called))
            column = in_degrees if at is None else at
            if column is None:
                expected = f"a column {joint}, {joint}_deg or q{number}{hint(joint.lower(), self.names)}"
                raise self.error_type(self.source, "line 1", f"no column of joint {joint}", expected)
            columns.append(column)
            expected = "rad, deg, or of a joint that slides m, mm"
            unit = "deg" if at is None else "rad"
            scales.append(self._scale(column, unit, _IN_RADIANS_OR_METRES, expected))
        return self.numbers(columns) * np.array(scales), columns

    def lengths(self, columns: Sequence[int], unit: str, *, gaps: bool = False) -> FloatArray:
        """Return lengths (N, k), m, of k columns, in `unit` where they name none; else as `numbers`.

        Raises
        ------
        InputError
            When a column has another unit; or as by `numbers`.
        """
        scales = [self._scale(column, unit, _IN_METRES, "m, cm, mm, um or in") for column in columns]
        return np.asarray(self.numbers(columns, gaps=gaps) * scales)

    def seconds(self, column: int) -> FloatArray:
        """Return the times (N,), s, of a column; errors as of `lengths`."""
        return self.numbers([column])[:, 0] * self._scale(column, "s", _IN_SECONDS, "s, ms or us")

    def _scale(self, column: int, unit: str, scales: Mapping[str, float], expected: str) -> float:
        """The scale of a column's unit, or of `unit` where it names none; an error where it is not known."""
        given = self.units[column].lower() or unit
        if given not in scales:
            key = f"line 1, {self.names[column]}"
            raise self.error_type(self.source, key, f"the unit {given}", expected)
        return scales[given]

    def numbers(self, columns: Sequence[int], *, gaps: bool = False) -> FloatArray:
        """Return the numbers (N, k) of k columns, all finite; NaN for empty cells where `gaps` may be.

        Raises
        ------
        InputError
            For the first cell that is no finite number.
        """
        try:
            table = np.array([[row[k] for k in columns] for row in self.rows], dtype=float)
        except ValueError:
            table = np.array([[_number(row[k]) for k in columns] for row in self.rows])
        table = table.reshape(len(self.rows), len(columns))
        for row, column in np.argwhere(~np.isfinite(table)):
            if gaps and self.rows[row][columns[column]].lower() in GAPS:
                continue
            name = self.names[columns[column]] if self.names else f"column {columns[column] + 1}"
            cell = self.rows[row][columns[column]]
            key = f"line {self.lines[row]}, {name}"
            raise self.error_type(self.source, key, shown(cell), "a finite number")
        return np.asarray(table)


def read_table(
    path: Path, error_type: type[InputError], *, kind: str, largest: int = 20_000_000
) -> TextTable:
    """Read a table of text.

    Parameters
    ----------
    path : Path
    error_type : type
        What to raise: `SceneError`, `InputError`, …
    kind : str
        What the file should be, for messages.
    largest : int
        Most bytes that it may have.

    Raises
    ------
    InputError
        Of `error_type`: the file cannot be read, it has no row of numbers, or rows of different lengths.
    """
    source, content = str(path), read_input(path, error_type, kind=kind, largest=largest)
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        got = f"text that cannot be read (byte {error.start})"
        raise error_type(source, "", got, f"{kind} in UTF-8") from error
    given = [(k, line) for k, line in enumerate(lines, start=1) if line.strip(" \t,;")]
    first = next((at for at, (_, line) in enumerate(given) if _begins_with_number(line)), None)
    if first is None:
        raise error_type(source, "", "no row of numbers" if given else "an empty file", kind)
    separator = _separator(given[first][1])
    rows = [
        (number, row)
        for (number, line), row in zip(
            given[first:], _cells((line for _, line in given[first:]), separator), strict=True
        )
        if not line.lstrip().startswith(_COMMENT_MARK)
    ]
    width = len(rows[0][1])
    for number, row in rows:
        if len(row) != width:
            got, expected = counted(len(row), "cell"), f"{counted(width, 'cell')}, as in line {rows[0][0]}"
            raise error_type(source, f"line {number}", got, expected)
    names, units = _heading([line for _, line in given[:first]], separator, width)
    return TextTable(
        source=source,
        names=names,
        units=units,
        rows=tuple(tuple(row) for _, row in rows),
        lines=tuple(number for number, _ in rows),
        error_type=error_type,
    )


def _separator(line: str) -> str:
    return next((mark for mark in _SEPARATORS if mark in line), " ")


def _cells(lines: Iterable[str], separator: str) -> list[list[str]]:
    if separator == " ":
        return [line.split() for line in lines]
    return [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]


def _begins_with_number(line: str) -> bool:
    cell = _cells([line], _separator(line))[0][0]
    return not cell.startswith(_COMMENT_MARK) and bool(np.isfinite(_number(cell)))


def _number(cell: str) -> float:
    """A number, with a decimal comma, too; not a number where it is none."""
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return float("nan")


def _heading(lines: Sequence[str], separator: str, width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the columns, from the last line before the rows that has as many cells."""
    for line in reversed(lines):
        cells = _cells([line.lstrip().lstrip(_COMMENT_MARK).strip()], separator)[0]
        if len(cells) == width:
            found = [_PLACE_AND_UNIT.fullmatch(cell) or _NAME_AND_UNIT.fullmatch(cell) for cell in cells]
            names = tuple(match[1].lower() if match else "" for match in found)
            return names, tuple((match[2] or "") if match else "" for match in found)
    return (), ()
