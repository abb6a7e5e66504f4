"""Files of waypoints: columns by their names, in whatever order and with whatever else is there."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.poses import pose
from cmbot.common.reading.fields import Angles, Vector
from cmbot.common.reading.text_table import TextTable, read_table
from cmbot.common.reading.validation import FileModel, counted
from cmbot.toolpath import shortest_turns

_MAX_WAYPOINT_BYTES = 5_000_000
_POSITION_COLUMNS = ("x", "y", "z")
_QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
_ANGLE_COLUMNS = ("roll", "pitch", "yaw")
_NORMAL_COLUMNS = (("nx", "ny", "nz"), ("i", "j", "k"))
_TIME_COLUMNS = ("seconds", "time", "t")
_POSE_COLUMNS, _AXIS_COLUMNS = "qw,qx,qy,qz or roll,pitch,yaw", "nx,ny,nz or i,j,k"
_KUKA_COLUMNS = ("a", "b", "c")
# As messages have them: pose.position.x, pose.orientation.w, target-pos_x, target-rot_w.
_PART_OF_POSE = re.compile(r"(?:.*[^a-z])?(pos|position|rot|orientation|quaternion)[._]([wxyz])")
# Names that are no columns of anything: numbers of rows.
_ROW_NUMBERS = ("", "index", "id", "n", "nr", "no", "#")
# A unit quaternion up to what files round; a direction shorter than this is none.
_LENGTH_OF_QUATERNION, _NO_NORMAL, _MOST_TURNED = 1e-3, 1e-9, 4 * np.pi


class WaypointFile(FileModel):
    """A table of waypoints, and where its coordinates are."""

    file: Annotated[str, Field(min_length=1, max_length=4096)]
    """Its path, relative to the scene file. Columns ``x,y,z`` (or ``x_mm``, ``x (mm)``), then
    ``qw,qx,qy,qz`` or ``roll,pitch,yaw``, rad, or with ``_deg``; with ``keep: axis`` also ``nx,ny,nz`` or
    ``i,j,k``, against which the tool points; with ``keep: position`` none of these; times in ``seconds``."""
    units: Literal["m", "mm", "cm", "in"] = "m"
    """Of places whose columns name no unit."""
    xyz: Vector = (0.0, 0.0, 0.0)
    """Where the table's origin is in W, m."""
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    """How its axes are turned: roll, pitch, yaw as in URDF."""


def read_waypoints(path: Path, given: WaypointFile, keep: object) -> tuple[list[list[float]], float | None]:
    """Read a file of waypoints.

    Places are in the columns ``x,y,z``. Orientations are in ``qw,qx,qy,qz``, in any order, or in
    ``roll,pitch,yaw``, rad, with the suffix ``_deg`` in degrees. With ``nx,ny,nz``, normals of a surface that
    the tool's axis points against, or ``i,j,k``, the same of machine tools, only the axis is known. Times are
    in ``seconds``, ``time`` or ``t``.

    Parameters
    ----------
    path : Path
    given : WaypointFile
        Units and pose of its coordinates.
    keep : object
        What the scene keeps of the tool, as its file has it.

    Returns
    -------
    rows : list of list of float
        Point, m, and unit quaternion (w, x, y, z) of the tool in W, of each waypoint.
    seconds : float or None
        From the first to the last; None without times.

    Raises
    ------
    SceneError
        When it is no such file, or has less of the tool's pose than is kept.
    """
    table = read_table(path, SceneError, kind="a table of waypoints", largest=_MAX_WAYPOINT_BYTES)
    table = replace(table, names=tuple(_plain_name(name) for name in table.names))
    if not (used := table.columns(_POSITION_COLUMNS)):
        got = f"the columns {','.join(table.names)}" if table.names else "no name for each column"
        raise SceneError(table.source, "line 1", got, f"the columns x,y,z, and {_needed(keep)}")
    points = table.lengths(used, given.units)
    quaternions = _orientations(table, keep, used)
    if keep == "position" and (turns := [table.names[k] for k in used[len(_POSITION_COLUMNS) :]]):
        warnings.warn(f"keep: position keeps nothing of {','.join(turns)} of {path.name}", stacklevel=2)
    time = table.index(*_TIME_COLUMNS)
    seconds = None
    if time is not None:
        used.append(time)
        t = table.seconds(time)
        seconds = float(t[-1] - t[0]) if (np.diff(t) >= 0).all() and t[-1] > t[0] else None
    if unknown := _unread(table, used):
        verb = "is" if len(unknown) == 1 else "are"
        what = f"{counted(len(unknown), 'column')} of {path.name} {verb} not read: {', '.join(unknown[:5])}"
        warnings.warn(what, stacklevel=2)
    if any((*given.xyz, *given.rpy_deg)):
        X = pose(given.xyz, np.radians(given.rpy_deg))
        points = points @ X[:3, :3].T + X[:3, 3]
        turned = Rotation.from_matrix(X[:3, :3]) * Rotation.from_quat(quaternions, scalar_first=True)
        quaternions = turned.as_quat(scalar_first=True)
    return np.hstack([points, quaternions]).tolist(), seconds


def _unread(table: TextTable, used: Sequence[int]) -> list[str]:
    """Names of the columns that are not used, but for those of rows' numbers."""
    return [name for k, name in enumerate(table.names) if k not in used and name not in _ROW_NUMBERS]


def _plain_name(name: str) -> str:
    """A column of a pose by its own name: x for pose.position.x."""
    part = _PART_OF_POSE.fullmatch(name)
    return name if part is None else ("" if part[1].startswith("pos") else "q") + part[2]


def _orientations(table: TextTable, keep: object, used: list[int]) -> FloatArray:
    """Quaternions (N, 4), w first, in the coordinates of a table; their columns are added to those `used`."""
    if columns := table.columns(_QUATERNION_COLUMNS):
        used += columns
        numbers = table.numbers(columns)
        size = np.linalg.norm(numbers, axis=1)
        if (wrong := np.flatnonzero(np.abs(size - 1.0) > _LENGTH_OF_QUATERNION)).size:
            key = f"line {table.lines[wrong[0]]}"
            raise SceneError(table.source, key, f"a quaternion of length {size[wrong[0]]:.3g}", "a unit one")
        return numbers
    for suffix, factor in (("", 1.0), ("_deg", np.pi / 180)):
        if columns := table.columns(f"{name}{suffix}" for name in _ANGLE_COLUMNS):
            used += columns
            in_degrees = np.pi / 180 if table.units[columns[0]].lower() in ("deg", "°") else factor
            turns = in_degrees * table.numbers(columns)
            if (wrong := np.flatnonzero(np.abs(turns).max(axis=1) > _MOST_TURNED)).size:
                key, got = f"line {table.lines[wrong[0]]}", f"{np.abs(turns[wrong[0]]).max():g} rad"
                expected = "at most two turns; in degrees the columns are roll_deg,pitch_deg,yaw_deg"
                raise SceneError(table.source, key, got, expected)
            return np.asarray(Rotation.from_euler("xyz", turns).as_quat(scalar_first=True))
    for names in _NORMAL_COLUMNS:
        if columns := table.columns(names):
            if keep in (None, "pose"):
                got = f"the columns {','.join(names)}, which say where the tool's axis is"
                raise SceneError(table.source, "line 1", got, "keep: axis, or another cone, in the scene")
            used += columns
            return _against(table.numbers(columns), table, names)
    if keep != "position":
        others = _unread(table, used)
        got = f"places alone, and {', '.join(others[:5])}, which are not known" if others else "places alone"
        needed = _needed(keep)
        if set(_KUKA_COLUMNS) <= set(others):
            needed = f"{needed}; A,B,C of a KUKA are yaw_deg,pitch_deg,roll_deg"
        raise SceneError(table.source, "line 1", got, needed)
    return np.tile([1.0, 0.0, 0.0, 0.0], (len(table.rows), 1))


def _needed(keep: object) -> str:
    """The columns of orientation that go with what is kept, and what to keep of the tool without them."""
    if keep in (None, "pose"):
        return f"{_POSE_COLUMNS}; or with keep: axis {_AXIS_COLUMNS}, with keep: position none"
    return f"{_POSE_COLUMNS} or {_AXIS_COLUMNS}, or keep: position"


def _against(normals: FloatArray, table: TextTable, names: tuple[str, ...]) -> FloatArray:
    """Quaternions (N, 4) of z axes that point against normals (N, 3), each turned least from the last."""
    size = np.linalg.norm(normals, axis=1)
    if (wrong := np.flatnonzero(size < _NO_NORMAL)).size:
        key = f"line {table.lines[wrong[0]]}, {names[0]}"
        raise SceneError(table.source, key, "a direction of no length", "a direction")
    found, R = np.empty((len(normals), 4)), np.diag([1.0, -1.0, -1.0])
    for k, axis in enumerate(-normals / size[:, None]):
        R = Rotation.from_rotvec(shortest_turns(R[None, :, 2], axis[None])[0]).as_matrix() @ R
        found[k] = Rotation.from_matrix(R).as_quat(scalar_first=True)
    return found


def given_file(entry: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return what ``waypoints`` of a path says of a file; None where it has rows, or none."""
    given = entry.get("waypoints")
    if isinstance(given, str):
        return {"file": given}
    return given if isinstance(given, Mapping) else None
