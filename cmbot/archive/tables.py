"""Motions as tables: one row a sample, SI units, radians, world frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.common.reading.validation import counted, shown
from cmbot.planning import Samples
from cmbot.trajectory import LARGEST

_JOINT_COLUMNS = ("q", "v", "a", "j", "tau")
_VECTOR_COLUMNS = ("guardrail_torque", "guardrail_force", "tool")
_CLEARANCE, _SEGMENT, _ADHESION = "clearance", "segment", "adhesion_needed"
# Of the bent tool to its path; between strokes there is none, and cells are NaN.
OFF_PATH = "off_path"
# Digits in all, and after the point; the baseline's motion is read back, and figures computed from it.
_DIGITS, _READ_BACK = 9, 12
# What cells that are computed again may differ by, as a share and in the unit of the column.
_CELL_TOLERANCE = 1e-6


def columns(dof: int, *, compensated: bool = False) -> tuple[str, ...]:
    """Return the columns' names for an arm of `dof` joints: ``t, q1, ..., clearance``.

    With compensated sag, ``tool`` is the commanded point and ``expected_tool``, at the end, the one with sag.
    """
    joints = (f"{letter}{i}" for letter in _JOINT_COLUMNS for i in range(1, dof + 1))
    vectors = (f"{vector}_{axis}" for vector in _VECTOR_COLUMNS for axis in "xyz")
    expected = (f"expected_tool_{axis}" for axis in ("xyz" if compensated else ""))
    return ("t", *joints, *vectors, _CLEARANCE, *expected)


def samples_csv(samples: Samples, source: str, labels: Sequence[str] | None = None) -> bytes:
    """Return samples (N,) as CSV; `source` is for messages.

    Of a whole job `labels` (N,), the names of the segments, are the last column, after the adhesion that each
    foot with a flat contact needs. Numbers have to be finite, but for a clearance without obstacles.
    """
    vectors = (samples.guardrail_torque, samples.guardrail_force, samples.tool_point)
    joints = (samples.q, samples.v, samples.a, samples.j, samples.joint_torque)
    expected = samples.expected_tool_point
    more = [] if expected is None else [expected]
    names = columns(samples.q.shape[1], compensated=expected is not None)
    if labels is not None and samples.adhesion_needed is not None:
        feet = samples.adhesion_needed.shape[1]
        names += (_ADHESION,) if feet == 1 else tuple(f"{_ADHESION}_{foot}" for foot in range(1, feet + 1))
        more.append(samples.adhesion_needed)
    table = np.column_stack([samples.t, *joints, *vectors, samples.clearance, *more])
    joints, rest = samples.q.shape[1], len(names) - 1
    digits: list[int | None] = [None, *[_DIGITS] * rest]
    if labels is None:
        # Free moves of a millionth of a second follow from where strokes end and begin.
        digits = [*[None] * (1 + joints), *[_READ_BACK] * (3 * joints), *[_DIGITS] * (rest - 4 * joints)]
    return table_csv(names, table, source, digits, labels)


def table_csv(
    names: tuple[str, ...],
    table: FloatArray,
    source: str,
    digits: Sequence[int | None] = (),
    labels: Sequence[str] | None = None,
) -> bytes:
    """Return a table (N, k) of finite numbers with its columns' names as CSV.

    `digits` (k,) are as many as the numbers of each column have at most, and after the point; None, and where
    they are left out: all. `labels` (N,) are one more column.
    """
    table = np.array(table)
    _require_numbers(table, names, source)
    digits = digits or [None] * len(names)
    form = ",".join("%r" if number is None else f"%.{number}g" for number in digits)
    for column, number in enumerate(digits):
        if number is not None:
            table[:, column] = np.round(table[:, column], number)
    rows = [form % tuple(row) for row in table.tolist()]
    if labels is not None:
        names, rows = (*names, _SEGMENT), [f"{row},{label}" for row, label in zip(rows, labels, strict=True)]
    return "\n".join([",".join(names), *rows, ""]).encode()


def read_motion(
    content: bytes, source: str, dof: int
) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Read a table of samples of n = `dof` joints, as `read_table` does; `source` is the file, for messages.

    Returns the times (N,), s, and position, velocity, acceleration and jerk, (N, n) each.
    """
    table = read_table(content, source, columns(dof))
    q, v, a, j = (table[:, 1 + k * dof : 1 + (k + 1) * dof].copy() for k in range(4))
    return table[:, 0].copy(), (q, v, a, j)


def read_table(content: bytes, source: str, names: tuple[str, ...]) -> FloatArray:
    """Return the table (N, k) with the columns `names`, of which the first is the time.

    Columns may not be missing or unknown, cells have to be numbers of reasonable size, times to increase.
    """
    try:
        header, *lines = content.decode("ascii").splitlines() or [""]
    except UnicodeDecodeError as error:
        got = f"a strange byte (byte {error.start})"
        raise ArchiveError(source, "", got, "a table of numbers") from error
    if header != ",".join(names):
        raise ArchiveError(source, "line 1", shown(header), f"the columns {','.join(names)}")
    table = np.array([_read_row(line, number, source, names) for number, line in enumerate(lines, start=2)])
    if len(table) < 2 or not (np.diff(table[:, 0]) > 0).all():
        got, expected = counted(len(table), "row"), "two or more rows, their times increasing"
        raise ArchiveError(source, "t", got, expected)
    _require_numbers(table, names, source)
    return table


def require_table(content: bytes, expected: bytes, source: str) -> None:
    """Refuse a table in the file `source` that is not an expected one, up to rounding.

    Raises
    ------
    ArchiveError
        For the first row that differs.
    """
    got, wanted = (text.decode("ascii", "replace").rstrip("\n").split("\n") for text in (content, expected))
    names = wanted[0].split(",")
    if got[0] != wanted[0]:
        raise ArchiveError(source, "line 1", shown(got[0]), f"the columns {shown(wanted[0])}")
    if len(got) != len(wanted):
        rows = [counted(len(each) - 1, "row") for each in (got, wanted)]
        raise ArchiveError(source, "", rows[0], f"{rows[1]}, as the knots have them")
    for number, (line, other_line) in enumerate(zip(got, wanted, strict=True), start=1):
        if line == other_line:
            continue
        cells, others = line.split(","), other_line.split(",")
        if len(cells) != len(others):
            key, counts = f"line {number}", [counted(len(each), "cell") for each in (cells, others)]
            raise ArchiveError(source, key, counts[0], counts[1])
        for name, cell, other in zip(names, cells, others, strict=True):
            if cell != other and not _is_near(cell, other):
                key, why = f"line {number}, {name}", f"{other}, as the knots have it"
                raise ArchiveError(source, key, shown(cell), why)


def _is_near(cell: str, other: str) -> bool:
    with suppress(ValueError):
        # For Python alone 1_0 is a number.
        number = math.nan if "_" in cell else float(cell)
        return math.isclose(number, float(other), rel_tol=_CELL_TOLERANCE, abs_tol=_CELL_TOLERANCE)
    return False


def _read_row(line: str, number: int, source: str, names: tuple[str, ...]) -> list[float]:
    cells, row = line.split(","), list[float]()
    if len(cells) != len(names):
        got, expected = (counted(len(each), "cell") for each in (cells, names))
        raise ArchiveError(source, f"line {number}", got, expected)
    try:
        row.extend(map(float, cells))
    except ValueError as error:
        # The row has the numbers before the first cell that is none.
        key = f"line {number}, {names[len(row)]}"
        raise ArchiveError(source, key, shown(cells[len(row)]), "a number") from error
    return row


def _require_numbers(table: FloatArray, names: tuple[str, ...], source: str) -> None:
    wrong = ~(np.abs(table) <= LARGEST)
    gaps = [name.startswith(OFF_PATH) for name in names]
    wrong[:, gaps] &= ~np.isnan(table[:, gaps])
    if _CLEARANCE in names:
        clearance = names.index(_CLEARANCE)
        wrong[:, clearance] &= table[:, clearance] != math.inf
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        key = f"line {row + 2}, {names[column]}"
        raise ArchiveError(source, key, table[row, column], f"a finite number of at most {LARGEST:g}")
