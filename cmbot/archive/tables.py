"""A sampled motion as CSV: one row a sample, SI units, radians, world frame."""

from __future__ import annotations

import math

import numpy as np

from cmbot.archive.number_text import number_rows
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.common.validation import counted, shown
from cmbot.planning import Samples

__all__ = ["columns", "read_motion", "read_rows", "samples_csv", "table_csv"]

_JOINT_COLUMNS = ("q", "v", "a", "j", "tau")
_VECTORS = ("guardrail_torque", "guardrail_force", "tool")
_CLEARANCE = "clearance"
_EXPECTED = "expected_tool"


def columns(dof: int, *, compensated: bool = False) -> tuple[str, ...]:
    """Return the columns' names for an arm of `dof` joints: ``t, q1, ..., clearance``.

    Where sag is compensated, ``tool`` is commanded and ``expected_tool``, at the end, is where it will be.
    """
    joints = (f"{letter}{i}" for letter in _JOINT_COLUMNS for i in range(1, dof + 1))
    vectors = (f"{vector}_{axis}" for vector in _VECTORS for axis in "xyz")
    expected = (f"{_EXPECTED}_{axis}" for axis in ("xyz" if compensated else ""))
    return ("t", *joints, *vectors, _CLEARANCE, *expected)


def samples_csv(samples: Samples, source: str) -> bytes:
    """Return samples as CSV; every number is the shortest text that reads back as the same.

    Parameters
    ----------
    samples : Samples
    source : str
        Name of the file, for messages.

    Raises
    ------
    ArchiveError
        When a number is not finite; an infinite clearance is, where nothing is there to be hit.
    """
    vectors = (samples.guardrail_torque, samples.guardrail_force, samples.tool_point)
    joints = (samples.q, samples.v, samples.a, samples.j, samples.joint_torque)
    expected = samples.expected_tool_point
    more = () if expected is None else (expected,)
    table = np.column_stack([samples.t, *joints, *vectors, samples.clearance, *more])
    names = columns(samples.q.shape[1], compensated=expected is not None)
    _require_numbers(table, names, source)
    return table_csv(names, table)


def table_csv(names: tuple[str, ...], table: FloatArray) -> bytes:
    """Return a table (N, k) with its columns' names as CSV."""
    lines = [",".join(names), *map(",".join, number_rows(table)), ""]
    return "\n".join(lines).encode()


def read_motion(
    content: bytes, source: str, dof: int
) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Read times and motion from such a table.

    Parameters
    ----------
    content : bytes
    source : str
        The file, for messages.
    dof : int
        Number n of the arm's joints.

    Returns
    -------
    t : (N,), s
    motion : four arrays (N, n)
        Position, velocity, acceleration and jerk.

    Raises
    ------
    ArchiveError
        When columns are missing or strange, a cell is no number, or times do not increase.
    """
    names = columns(dof)
    table = np.array(read_rows(content, source, names))
    if len(table) < 2 or not (np.diff(table[:, 0]) > 0).all():
        got, expected = counted(len(table), "row"), "two or more rows, their times increasing"
        raise ArchiveError(source, "t", got, expected)
    _require_numbers(table, names, source)
    q, v, a, j = (table[:, 1 + k * dof : 1 + (k + 1) * dof].copy() for k in range(4))
    return table[:, 0].copy(), (q, v, a, j)


def read_rows(content: bytes, source: str, names: tuple[str, ...]) -> list[list[float]]:
    """Return the numbers of a table with the columns `names`.

    Raises
    ------
    ArchiveError
        When columns are missing or strange, or a cell is no number.
    """
    try:
        header, *lines = content.decode("ascii").splitlines() or [""]
    except UnicodeDecodeError as error:
        got = f"a strange byte (byte {error.start})"
        raise ArchiveError(source, "", got, "a table of numbers") from error
    if header != ",".join(names):
        raise ArchiveError(source, "line 1", shown(header), f"the columns {','.join(names)}")
    rows = []
    for number, line in enumerate(lines, start=2):
        cells = line.split(",")
        if len(cells) != len(names):
            got, expected = (counted(len(row), "cell") for row in (cells, names))
            raise ArchiveError(source, f"line {number}", got, expected)
        try:
            rows.append(list(map(float, cells)))
        except ValueError as error:
            column, cell = next(pair for pair in zip(names, cells, strict=True) if not _is_number(pair[1]))
            raise ArchiveError(source, f"line {number}, {column}", shown(cell), "a number") from error
    return rows


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _require_numbers(table: FloatArray, names: tuple[str, ...], source: str) -> None:
    wrong = ~np.isfinite(table)
    # With nothing to be hit, the clearance is infinite.
    wrong[:, -1] &= table[:, -1] != math.inf
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        key = f"line {row + 2}, {names[column]}"
        raise ArchiveError(source, key, table[row, column], "a finite number")
