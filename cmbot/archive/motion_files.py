"""The files of a motion: samples as CSV and as a ROS 2 message, knots as a NumPy .npz file."""

from __future__ import annotations

import io
import math
import re
import zipfile
import zlib
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydantic_core import to_json

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.validation import counted, shown
from cmbot.planning import QuinticTrajectory, Samples
from cmbot.robot import Robot
from cmbot.trajectory import LARGEST

__all__ = [
    "columns",
    "job_columns",
    "knots_npz",
    "largest_knots",
    "largest_table",
    "motion_files",
    "read_knots",
    "read_motion",
    "read_table",
    "samples_csv",
    "table_csv",
    "trajectory_json",
    "trajectory_message",
]

_JOINT_COLUMNS = ("q", "v", "a", "j", "tau")
_VECTORS = ("guardrail_torque", "guardrail_force", "tool")
_CLEARANCE, _SEGMENT, _ADHESION = "clearance", "segment", "adhesion_needed"
_KNOTS = ("t", "q", "v", "a")
# Several times as many as a scene may have via-points.
_MOST_KNOTS = 100_000
# Begins an entry of the directory at a zip file's end; few numbers contain it by chance.
_ZIP_ENTRY, _MOST_ENTRIES = b"PK\x01\x02", 100
_NPY_VERSION_1 = b"\x93NUMPY\x01\x00"
# Narrower than NumPy's own reader, which evaluates the header as Python.
_NPY_HEADER = re.compile(
    rb"\{'descr': '<f8', 'fortran_order': (?P<order>True|False), "
    rb"'shape': \((?P<rows>\d{1,9}),(?: (?P<columns>\d{1,9}))?\), \} *\n"
)
# The longest number is -2.2250738585072014e-308, and a comma after it.
_LONGEST_CELL = 25
_LARGEST_TABLE = 2_000_000_000
# What zipfile raises for a file that is damaged or no .zip at all.
_DAMAGED = (
    EOFError,
    KeyError,
    NotImplementedError,
    OSError,
    RuntimeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)


def motion_files(
    name: str,
    robot: Robot,
    trajectory: QuinticTrajectory,
    samples: Samples,
    labels: Sequence[str] | None = None,
) -> dict[str, bytes]:
    """Return the files of a planned motion: from each file's name, which begins with `name`, to its bytes.

    `labels` (N,) are the names of the segments that the samples belong to.
    """
    names, table = _table(samples, job=labels is not None)
    _require_numbers(table, names, f"{name}.csv")
    return {
        f"{name}.csv": _csv(names, table, labels),
        f"{name}.npz": knots_npz(trajectory),
        f"{name}.ros.json": trajectory_json(robot, samples),
    }


# Tables


def columns(dof: int, *, compensated: bool = False) -> tuple[str, ...]:
    """Return the columns' names for an arm of `dof` joints: ``t, q1, ..., clearance``.

    With compensated sag, ``tool`` is the commanded point and ``expected_tool``, at the end, the one with sag.
    """
    joints = (f"{letter}{i}" for letter in _JOINT_COLUMNS for i in range(1, dof + 1))
    vectors = (f"{vector}_{axis}" for vector in _VECTORS for axis in "xyz")
    expected = (f"expected_tool_{axis}" for axis in ("xyz" if compensated else ""))
    return ("t", *joints, *vectors, _CLEARANCE, *expected)


def job_columns(dof: int, *, compensated: bool = False, feet: int = 0) -> tuple[str, ...]:
    """Return the columns' names of ``job.csv``: those of `columns`, adhesion needed, the segment's name.

    `feet` is the number of those with a flat contact: one column each.
    """
    return (*columns(dof, compensated=compensated), *_adhesion_columns(feet), _SEGMENT)


def _adhesion_columns(feet: int) -> tuple[str, ...]:
    return (_ADHESION,) if feet == 1 else tuple(f"{_ADHESION}_{foot}" for foot in range(1, feet + 1))


def samples_csv(samples: Samples, source: str) -> bytes:
    """Return samples as CSV: one row a sample, SI units, radians, world frame; `source` is for messages.

    Numbers have to be finite, but for a clearance that is infinite without obstacles.
    """
    return table_csv(*_table(samples, job=False), source)


def _table(samples: Samples, *, job: bool) -> tuple[tuple[str, ...], FloatArray]:
    """Names of columns (k,) and a table (N, k) of samples; that of the whole `job` has the adhesion."""
    vectors = (samples.guardrail_torque, samples.guardrail_force, samples.tool_point)
    joints = (samples.q, samples.v, samples.a, samples.j, samples.joint_torque)
    expected = samples.expected_tool_point
    more = [] if expected is None else [expected]
    names = columns(samples.q.shape[1], compensated=expected is not None)
    if job and samples.adhesion_needed is not None:
        names += _adhesion_columns(samples.adhesion_needed.shape[1])
        more.append(samples.adhesion_needed)
    return names, np.column_stack([samples.t, *joints, *vectors, samples.clearance, *more])


def table_csv(names: tuple[str, ...], table: FloatArray, source: str) -> bytes:
    """Return a table (N, k) of finite numbers with its columns' names as CSV, each in as few digits as do."""
    _require_numbers(table, names, source)
    return _csv(names, table)


def _csv(names: tuple[str, ...], table: FloatArray, labels: Sequence[str] | None = None) -> bytes:
    """Columns' names and a table (N, k) as CSV; `labels` (N,), the names of segments, are a last column.

    pydantic's writer of JSON is ten times as fast as `repr`: the rows are a list's lists.
    """
    text = to_json(table.tolist(), inf_nan_mode="constants").decode("ascii").replace("Infinity", "inf")
    rows = text[2:-2].split("],[") if len(table) else []
    if labels is not None:
        names, rows = (*names, _SEGMENT), [f"{row},{label}" for row, label in zip(rows, labels, strict=True)]
    return "\n".join([",".join(names), *rows, ""]).encode()


def largest_table(rows: float, columns: int) -> int:
    """Bytes of the largest table with so many rows: ten more, and 16 kB for the columns' names."""
    return round(min((rows + 10) * columns * _LONGEST_CELL, _LARGEST_TABLE)) + 16_000


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
    if _CLEARANCE in names:
        clearance = names.index(_CLEARANCE)
        wrong[:, clearance] &= table[:, clearance] != math.inf
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        key = f"line {row + 2}, {names[column]}"
        raise ArchiveError(source, key, table[row, column], f"a finite number of at most {LARGEST:g}")


# ROS 2


def trajectory_json(robot: Robot, samples: Samples, *, effort: bool = False) -> bytes:
    """Return `trajectory_message` as JSON."""
    return to_json(trajectory_message(robot, samples, effort=effort)) + b"\n"


def trajectory_message(robot: Robot, samples: Samples, *, effort: bool = False) -> dict[str, Any]:
    """Return samples, all of them finite, as a ``trajectory_msgs/JointTrajectory``; the first is at time 0.

    Its points have the joints' torques only with `effort`: most controllers refuse them.
    """
    nanoseconds = np.rint(1e9 * (samples.t - samples.t[0])).astype(np.int64).tolist()
    fields = {"positions": samples.q, "velocities": samples.v, "accelerations": samples.a}
    if effort:
        fields["effort"] = samples.joint_torque
    rows = zip(*(values.tolist() for values in fields.values()), strict=True)
    points = [
        {
            **dict(zip(fields, row, strict=True)),
            "time_from_start": {"sec": time // 10**9, "nanosec": time % 10**9},
        }
        for row, time in zip(rows, nanoseconds, strict=True)
    ]
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    return {"header": header, "joint_names": list(robot.joints), "points": points}


# Knots


def knots_npz(trajectory: QuinticTrajectory) -> bytes:
    """Return a trajectory's knots as .npz: they define the quintics exactly; nothing is pickled."""
    file = io.BytesIO()
    np.savez(file, t=trajectory.t, q=trajectory.q, v=trajectory.v, a=trajectory.a)
    return file.getvalue()


def largest_knots(dof: int) -> int:
    """Bytes of the largest file that `read_knots` takes: knots and 16 kB for names and headers."""
    return 8 * _MOST_KNOTS * (1 + 3 * dof) + 16_000


def read_knots(content: bytes, source: str, dof: int) -> QuinticTrajectory:
    """Return the trajectory of `dof` joints whose knots are in a file's `content`; `source` is for messages.

    An `ArchiveError` is raised when the file is damaged, holds other arrays, or they are no knots. Names,
    types and shapes are checked before numbers are unpacked.
    """
    if content.count(_ZIP_ENTRY) > _MOST_ENTRIES:  # zipfile makes an object of each
        raise ArchiveError(source, "", "many members", f"the arrays {', '.join(_KNOTS)}")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _require_members(archive, source)
            knots = {name: _array(archive, name, source, dof) for name in _KNOTS}
    except ArchiveError:
        raise
    except _DAMAGED as error:
        got = f"a damaged file ({shown(str(error))})"
        raise ArchiveError(source, "", got, "a NumPy .npz file") from error
    try:
        return QuinticTrajectory(**knots)
    except InputError as error:
        raise ArchiveError(source, error.key, error.got, error.expected) from error


def _require_members(archive: zipfile.ZipFile, source: str) -> None:
    names = archive.namelist()
    if sorted(names) != sorted(f"{name}.npy" for name in _KNOTS):
        got = shown(", ".join(names[: len(_KNOTS) + 1]))
        raise ArchiveError(source, "", f"the members {got}", f"the arrays {', '.join(_KNOTS)}")


def _array(archive: zipfile.ZipFile, name: str, source: str, dof: int) -> FloatArray:
    """Return an array (n,) or (n, dof) of float64; of another one, only the header is unpacked."""
    with archive.open(f"{name}.npy") as member:
        preamble = member.read(10)
        if len(preamble) != 10 or preamble[:8] != _NPY_VERSION_1:
            raise ArchiveError(source, name, shown(preamble), "an array in version 1.0 of NumPy's format")
        header = member.read(int.from_bytes(preamble[8:], "little"))
        match = _NPY_HEADER.fullmatch(header)
        if match is None:
            got = shown(header.decode("latin-1").strip())
            raise ArchiveError(source, name, got, "an array of float64, with one or two dimensions")
        shape = tuple(int(match[key]) for key in ("rows", "columns") if match[key])
        rows, wanted = shape[0], ((shape[0],) if name == "t" else (shape[0], dof))
        if not 2 <= rows <= _MOST_KNOTS or shape != wanted:
            expected = f"2 to {_MOST_KNOTS} knots" + ("" if name == "t" else f" of {counted(dof, 'joint')}")
            raise ArchiveError(source, name, f"an array of shape {shape}", expected)
        size = 8 * math.prod(shape)
        numbers = member.read(size + 1)
        if len(numbers) != size:
            got = "fewer numbers" if len(numbers) < size else "more numbers"
            raise ArchiveError(source, name, got, f"an array of shape {shape}, as its header says")
    order: Literal["F", "C"] = "F" if match["order"] == b"True" else "C"
    return np.frombuffer(numbers, "<f8").reshape(shape, order=order)
