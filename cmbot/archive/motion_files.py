"""The files of a motion: samples as CSV and as a ROS 2 message, knots as a NumPy .npz file."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from typing import Any

import numpy as np
from pydantic_core import to_json

from cmbot.archive.strict_json import json_bytes
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.validation import counted, shown
from cmbot.planning import QuinticTrajectory, Samples
from cmbot.robot import Robot

__all__ = [
    "columns",
    "knots_npz",
    "motion_files",
    "number_rows",
    "read_knots",
    "read_motion",
    "read_table",
    "samples_csv",
    "table_csv",
]

_JOINT_COLUMNS = ("q", "v", "a", "j", "tau")
_VECTORS = ("guardrail_torque", "guardrail_force", "tool")
_CLEARANCE = "clearance"
_ROS_POINT = (
    '{{"positions": [{}], "velocities": [{}], "accelerations": [{}], "effort": [{}], '
    '"time_from_start": {{"sec": {}, "nanosec": {}}}}}'
)
# `repr` writes numbers outside these sizes with an exponent.
_WITHOUT_EXPONENT = (1e-4, 1e16)
# What np.load raises for a file that is damaged or no .npz at all.
_DAMAGED = (
    EOFError,
    KeyError,
    MemoryError,
    NotImplementedError,
    OSError,
    RuntimeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)


def motion_files(
    name: str, robot: Robot, trajectory: QuinticTrajectory, samples: Samples
) -> dict[str, bytes]:
    """Return the files of a planned motion: from each file's name, which begins with `name`, to its bytes."""
    return {
        f"{name}.csv": samples_csv(samples, f"{name}.csv"),
        f"{name}.npz": knots_npz(trajectory),
        f"{name}.ros.json": _ros_json(robot, samples),
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


def samples_csv(samples: Samples, source: str) -> bytes:
    """Return samples as CSV: one row a sample, SI units, radians, world frame; `source` is for messages.

    Numbers have to be finite, but for a clearance that is infinite without obstacles.
    """
    vectors = (samples.guardrail_torque, samples.guardrail_force, samples.tool_point)
    joints = (samples.q, samples.v, samples.a, samples.j, samples.joint_torque)
    expected = samples.expected_tool_point
    more = () if expected is None else (expected,)
    table = np.column_stack([samples.t, *joints, *vectors, samples.clearance, *more])
    return table_csv(columns(samples.q.shape[1], compensated=expected is not None), table, source)


def table_csv(names: tuple[str, ...], table: FloatArray, source: str) -> bytes:
    """Return a table (N, k) of finite numbers with its columns' names as CSV, written by `number_rows`."""
    _require_numbers(table, names, source)
    lines = [",".join(names), *map(",".join, number_rows(table)), ""]
    return "\n".join(lines).encode()


def number_rows(table: FloatArray) -> list[list[str]]:
    """Return the numbers of a table (N, k) as text, row by row: the shortest that reads back as the same.

    pydantic's writer is ten times as fast as `repr`. Where the two differ, `repr` is used.
    """
    numbers, size, width = table.ravel().tolist(), np.abs(table.ravel()), table.shape[1]
    cells = to_json(numbers, inf_nan_mode="constants").decode("ascii")[1:-1].split(",")
    least, most = _WITHOUT_EXPONENT
    for k in np.flatnonzero(~((size >= least) & (size < most))).tolist():
        cells[k] = repr(numbers[k])
    return [cells[k : k + width] for k in range(0, table.size, width)]


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

    Columns may not be missing or unknown, cells have to be finite numbers, times have to increase.
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
    wrong = ~np.isfinite(table)
    if _CLEARANCE in names:
        clearance = names.index(_CLEARANCE)
        wrong[:, clearance] &= table[:, clearance] != math.inf
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        key = f"line {row + 2}, {names[column]}"
        raise ArchiveError(source, key, table[row, column], "a finite number")


# ROS 2


def _ros_json(robot: Robot, samples: Samples) -> bytes:
    """Samples, all finite, as a ``trajectory_msgs/JointTrajectory``."""
    message = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(robot.joints),
        "points": [],
    }
    vectors = (number_rows(x) for x in (samples.q, samples.v, samples.a, samples.joint_torque))
    nanoseconds = np.rint(1e9 * (samples.t - samples.t[0])).astype(np.int64).tolist()
    points = [
        _ROS_POINT.format(*map(", ".join, parts), *divmod(time, 10**9))
        for *parts, time in zip(*vectors, nanoseconds, strict=True)
    ]
    # Nearly all of the file are numbers, and json writes them slowly.
    head, end = json_bytes(message).decode().rsplit("]", 1)
    return f"{head}{', '.join(points)}]{end}".encode()


# Knots


def knots_npz(trajectory: QuinticTrajectory) -> bytes:
    """Return a trajectory's knots as .npz: they define the quintics exactly; nothing is pickled."""
    file = io.BytesIO()
    np.savez(file, t=trajectory.t, q=trajectory.q, v=trajectory.v, a=trajectory.a)
    return file.getvalue()


def read_knots(content: bytes, source: str, dof: int) -> QuinticTrajectory:
    """Return the trajectory of `dof` joints whose knots are in a file's `content`; `source` is for messages.

    An `ArchiveError` is raised when the file is damaged, holds other arrays, or they are no knots.
    """
    knots = _arrays(content, source)
    if sorted(knots) != ["a", "q", "t", "v"]:
        raise ArchiveError(source, "", f"the arrays {', '.join(sorted(knots))}", "the arrays t, q, v, a")
    for name, array in knots.items():
        # A member without NumPy's header is read as bytes.
        if not isinstance(array, np.ndarray) or array.dtype != np.float64:
            got = getattr(array, "dtype", "no array")
            raise ArchiveError(source, name, got, "an array of float64")
    try:
        trajectory = QuinticTrajectory(**knots)
    except InputError as error:
        raise ArchiveError(source, error.key, error.got, error.expected) from error
    if trajectory.q.shape[1] != dof:
        raise ArchiveError(source, "q", counted(trajectory.q.shape[1], "joint"), counted(dof, "joint"))
    return trajectory


def _arrays(content: bytes, source: str) -> dict[str, Any]:
    expected = "a NumPy .npz file"
    try:
        file = np.load(io.BytesIO(content), allow_pickle=False)
        if isinstance(file, np.lib.npyio.NpzFile):
            return {name: file[name] for name in file.files}
    except _DAMAGED as error:
        raise ArchiveError(source, "", f"a damaged file ({shown(str(error))})", expected) from error
    raise ArchiveError(source, "", "a lone array", expected)
