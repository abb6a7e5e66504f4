"""Files of motions: a table, a ROS JointTrajectory as JSON or YAML, a plan directory."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.archive import load_plan
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.input_files import is_folder, read_input
from cmbot.common.reading.text_table import TextTable, read_table
from cmbot.common.reading.validation import counted, hint, require_unique_keys, shown
from cmbot.common.reading.yaml_reader import read_yaml
from cmbot.evaluation.motion import JointMotion
from cmbot.robot import Robot

_MOTION_TIME_COLUMNS = ("t", "time", "seconds", "time_from_start")
# Where messages have their trajectory: goals of actions, RobotTrajectory, DisplayTrajectory.
_TRAJECTORY_KEYS = ("trajectory", "joint_trajectory", "goal")
_EXPECTED_FILES = "a table with t and the joints, a JointTrajectory (.json, .yaml), or a plan directory"
_BAGS = (".mcap", ".bag", ".db3")
_NANO = 1e-9


def read_motion(path: str | Path, robot: Robot) -> JointMotion:
    """Read the motion of a robot's joints from a file.

    A table has a column of times, ``t``, s, and one for each joint, by its name in rad, of joints that slide
    in m, or with the suffix ``_deg``, or ``q1`` and so on; ``v1`` and ``a1`` and so on are velocities and
    accelerations. A ``trajectory_msgs/JointTrajectory`` may stand alone or in the message of a goal or of
    MoveIt. A plan directory has its job, and the time laws that were chosen for it.

    Parameters
    ----------
    path : str or Path
    robot : Robot

    Raises
    ------
    InputError
        When it is no such file, or has not all joints of the arm.
    ArchiveError
        When it is a folder without a plan.
    """
    path = Path(path)
    if is_folder(path):
        plan = load_plan(path)
        motion = plan.job.trajectory
        if motion.q.shape[1] != robot.dof:
            got = f"a plan of {counted(motion.q.shape[1], 'joint')}"
            raise InputError(str(path), "", got, f"one of the scene's arm with {counted(robot.dof, 'joint')}")
        return JointMotion(t=motion.t, q=motion.q, v=motion.v, a=motion.a, strokes=plan.scene.strokes)
    if path.suffix.lower() == ".json":
        return _from_message(_json(path), str(path), robot)
    if path.suffix.lower() in (".yaml", ".yml"):
        return _from_message(read_yaml(path, InputError, _EXPECTED_FILES), str(path), robot)
    if path.suffix.lower() in _BAGS:
        expected = f"{_EXPECTED_FILES}; of a plan's own bag cmbot verify says whether it has its motion"
        raise InputError(str(path), "", "a bag of ROS messages", expected)
    return _from_table(read_table(path, InputError, kind=_EXPECTED_FILES), robot)


def _from_table(table: TextTable, robot: Robot) -> JointMotion:
    time = table.index(*_MOTION_TIME_COLUMNS)
    if time is None:
        got = f"the columns {','.join(table.names)}" if table.names else "no heading"
        raise InputError(table.source, "line 1", shown(got), "a column t, in s, beside those of the joints")
    q, columns = table.joints(robot.joints)
    used = [time, *columns]

    def derivative(letter: str) -> FloatArray | None:
        found = table.columns(f"{letter}{number}" for number in range(1, robot.dof + 1))
        used.extend(found)
        return table.numbers(found) if found else None

    velocity, acceleration = derivative("v"), derivative("a")
    return JointMotion(
        t=_increasing(table.seconds(time), table.source),
        q=q,
        v=velocity,
        a=acceleration,
        unknown=tuple(name for k, name in enumerate(table.names) if k not in used),
    )


def _json(path: Path) -> dict[str, Any]:
    """The object in a JSON file, which may be longer than YAML of cmbot is."""
    content = read_input(path, InputError, kind=_EXPECTED_FILES)
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(str(path), "", f"no JSON ({error})", _EXPECTED_FILES) from error
    if not isinstance(data, dict):
        raise InputError(str(path), "", shown(data), _EXPECTED_FILES)
    require_unique_keys(content, str(path), InputError)
    return data


def _from_message(data: Mapping[str, Any], source: str, robot: Robot) -> JointMotion:
    message, key = _unwrapped(data)
    names, points = message.get("joint_names"), message.get("points")
    if not (isinstance(names, list) and isinstance(points, list) and points):
        expected = "joint_names and points, as a trajectory_msgs/JointTrajectory has them"
        raise InputError(source, key, "a message without them", expected)
    if missing := [joint for joint in robot.joints if joint not in names]:
        expected = (
            f"all joints of the arm, {missing[0]}, too{hint(missing[0], [str(name) for name in names])}"
        )
        raise InputError(source, f"{key}joint_names", shown(", ".join(map(str, names))), expected)
    order = [names.index(joint) for joint in robot.joints]

    def field(name: str) -> FloatArray | None:
        rows = [point.get(name) if isinstance(point, Mapping) else None for point in points]
        if name != "positions" and not all(rows):
            return None
        for k, row in enumerate(rows):
            if not (isinstance(row, list) and len(row) == len(names) and all(map(_is_number, row))):
                expected = f"{counted(len(names), 'finite number')}, one for each joint"
                raise InputError(source, f"{key}points[{k}].{name}", shown(row), expected)
        return np.array(rows, dtype=float)[:, order]

    times = np.array([_seconds(point, source, f"{key}points[{k}]") for k, point in enumerate(points)])
    return JointMotion(
        t=_increasing(times, source),
        q=field("positions"),  # type: ignore[arg-type]
        v=field("velocities"),
        a=field("accelerations"),
        unknown=tuple(str(name) for name in names if name not in robot.joints),
    )


def _unwrapped(data: Mapping[str, Any]) -> tuple[Mapping[str, Any], str]:
    """The trajectory in a message, and where in it that is."""
    message, key = data, ""
    while "points" not in message:
        name = next((each for each in _TRAJECTORY_KEYS if each in message), None)
        inner = message[name] if name else None
        if isinstance(inner, list) and inner:
            name, inner = f"{name}[0]", inner[0]
        if not isinstance(inner, Mapping):
            break
        message, key = inner, f"{key}{name}."
    return message, key


def _seconds(point: object, source: str, key: str) -> float:
    """``time_from_start``, s: of ROS 2, of ROS 1, or a plain number."""
    time = point.get("time_from_start") if isinstance(point, Mapping) else None
    if isinstance(time, Mapping):
        for whole, parts in (("sec", "nanosec"), ("secs", "nsecs")):
            if _is_number(time.get(whole)) and _is_number(time.get(parts)):
                return float(time[whole]) + _NANO * float(time[parts])
    if not _is_number(time):
        expected = "sec and nanosec, or a number of seconds"
        raise InputError(source, f"{key}.time_from_start", shown(time), expected)
    return float(time)  # type: ignore[arg-type]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _increasing(t: FloatArray, source: str) -> FloatArray:
    """Refuse times that do not increase."""
    wrong = np.flatnonzero(~(np.diff(t) > 0))
    if len(t) < 2 or len(wrong):
        got = counted(len(t), "point") if len(t) < 2 else f"{t[wrong[0] + 1]:g} s after {t[wrong[0]]:g} s"
        raise InputError(source, "t", got, "two or more points, their times increasing")
    return t
