"""A plan's job as a ROS 2 message in a file of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import to_json

from cmbot.archive.folder import write_file
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import given_path, hint
from cmbot.planning import Plan, require_plan
from cmbot.robot import Dynamics
from cmbot.trajectory import QuinticTrajectory

# Points of a message unless more are asked for.
_DEFAULT_MAX_POINTS = 200
# Times between two points at which the motion is compared, and most points of all.
_TIMES_BETWEEN_POINTS, _LARGEST_MESSAGE = 16, 100_000
_NANO = 1e-9
# What moves by less, rad or m, is at rest; times at which that is seen.
_AT_REST_STEP, _TIMES_OF_MOTION = 1e-6, 2001


@dataclass(frozen=True, kw_only=True)
class RosTrajectory:
    """A ``trajectory_msgs/JointTrajectory``.

    Attributes
    ----------
    message : dict
    points : int
    deviation : float, rad, of joints that slide m
        How far the quintics through its points, which controllers drive, are from the plan at most.
    left_out : dict of str to float, rad, of joints that slide m
        The joints that move in the plan and are not in the message, and how far from end to end.
    """

    message: dict[str, Any]
    points: int
    deviation: float
    left_out: dict[str, float]


def export_ros(
    plan: Plan,
    path: str | Path,
    *,
    max_points: int | None = None,
    rate: float | None = None,
    joints: Sequence[str] | None = None,
    effort: bool = False,
) -> RosTrajectory:
    """Write the planned job of a plan as JSON of a ``trajectory_msgs/JointTrajectory``, whole or not at all.

    Its points have positions, velocities and accelerations: the quintics that controllers make of these are
    the plan's own where all its knots are among them.

    Parameters
    ----------
    plan : Plan
    path : str or Path
        An earlier file of that name is replaced.
    max_points : int, optional
        Of more knots those are left out that matter least; by default 200.
    rate : float, Hz, optional
        Points in equal steps, and one at the end, in place of knots.
    joints : sequence of str, optional
        In their order, in place of all joints: for a message to one of several controllers.
    effort : bool
        Give the points the joints' torques, too, Nm, of joints that slide forces, N. The controller of
        ros2_control refuses such a message, but for those of Jazzy and later that command efforts.

    Returns
    -------
    RosTrajectory
        What was written, and how far it is from the plan.

    Raises
    ------
    InputError
        When `plan` is none, a joint is none of the arm's, or the points are too few or too many.
    ArchiveError
        When the file cannot be written.
    """
    require_plan(plan, "cmbot.export_ros")
    target = given_path(path, "cmbot.export_ros", "path", "the path of a file to write")
    nanoseconds = message_times(plan.job.trajectory, max_points, rate)
    found = trajectory_message(plan, nanoseconds, joints=joints, effort=effort)
    write_file(target, to_json(found.message) + b"\n")
    return found


def message_times(
    trajectory: QuinticTrajectory, max_points: int | None = None, rate: float | None = None
) -> IntArray:
    """Return the times (k,), whole nanoseconds, of the points of a message, which begins with time 0.

    Raises
    ------
    InputError
        When these are too few or too many.
    """
    if rate is not None:
        if not (rate > 0 and trajectory.duration * rate < _LARGEST_MESSAGE):
            raise InputError(
                "cmbot.export_ros",
                "rate",
                f"{rate:g}",
                f"a frequency, Hz, for up to {_LARGEST_MESSAGE} points",
            )
        inside = np.arange(0, int(np.ceil(trajectory.duration * rate))) / rate
        return _whole(np.append(trajectory.t[0] + inside, trajectory.t[-1]))
    most = _DEFAULT_MAX_POINTS if max_points is None else max_points
    if not 2 <= most <= _LARGEST_MESSAGE:
        raise InputError("cmbot.export_ros", "max_points", most, f"2 to {_LARGEST_MESSAGE}")
    return _whole(_fewer(trajectory, most))


def trajectory_message(
    plan: Plan,
    nanoseconds: IntArray | None = None,
    *,
    joints: Sequence[str] | None = None,
    effort: bool = False,
) -> RosTrajectory:
    """Return the job of a plan at times (k,), by default its knots, as a message; errors as `export_ros`."""
    trajectory, names = plan.job.trajectory, plan.robot.joints
    if nanoseconds is None:
        nanoseconds = message_times(trajectory)
    columns = list(range(len(names))) if joints is None else [_column(joint, names) for joint in joints]
    t = np.minimum(trajectory.t[0] + _NANO * nanoseconds, trajectory.t[-1])
    q, v, a = trajectory.states(t)
    fields = {"positions": q, "velocities": v, "accelerations": a}
    if effort:
        fields["effort"] = _efforts(plan, t)
    rows = zip(*(values[:, columns].tolist() for values in fields.values()), strict=True)
    points = [
        {
            **dict(zip(fields, row, strict=True)),
            "time_from_start": {"sec": time // 10**9, "nanosec": time % 10**9},
        }
        for row, time in zip(rows, nanoseconds.tolist(), strict=True)
    ]
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    message = {"header": header, "joint_names": [names[k] for k in columns], "points": points}
    deviation = _deviation(trajectory, t)[:, columns]
    return RosTrajectory(
        message=message,
        points=len(points),
        deviation=float(deviation.max(initial=0.0)),
        left_out=_left_out(trajectory, names, columns),
    )


def _left_out(
    trajectory: QuinticTrajectory, names: Sequence[str], columns: Sequence[int]
) -> dict[str, float]:
    """The joints that move without being in a message, and how far from end to end."""
    moves = np.ptp(
        trajectory.evaluate(np.linspace(trajectory.t[0], trajectory.t[-1], _TIMES_OF_MOTION)), axis=0
    )
    return {
        name: float(moves[k]) for k, name in enumerate(names) if k not in columns and moves[k] > _AT_REST_STEP
    }


def _column(joint: str, names: Sequence[str]) -> int:
    if joint not in names:
        raise InputError("cmbot.export_ros", "joints", joint, f"a joint{hint(joint, names)}", tuple(names))
    return names.index(joint)


def _whole(t: FloatArray) -> IntArray:
    """Whole nanoseconds from the first of times, none twice."""
    return np.unique(np.rint((t - t[0]) / _NANO).astype(np.intp))


def _deviation(trajectory: QuinticTrajectory, t: FloatArray) -> FloatArray:
    """How far the quintics between times (k,) are from a trajectory at most, (k - 1, n)."""
    q, v, a = trajectory.states(t)
    through = QuinticTrajectory(t=t, q=q, v=v, a=a)
    shares = np.arange(1, _TIMES_BETWEEN_POINTS) / _TIMES_BETWEEN_POINTS
    every = (t[:-1, None] + shares * np.diff(t)[:, None]).ravel()
    away = np.abs(through.evaluate(every) - trajectory.evaluate(every))
    return np.asarray(away.reshape(len(t) - 1, len(shares), -1).max(axis=1))


def _fewer(trajectory: QuinticTrajectory, most: int) -> FloatArray:
    """So many knots at most: one after the other that without which the motion changes least is left out."""
    t = trajectory.t
    before, after = np.arange(len(t)) - 1, np.arange(len(t)) + 1
    version = np.zeros(len(t), dtype=np.intp)

    def cost(k: int) -> tuple[float, int, int]:
        without = _deviation(trajectory, t[[before[k], after[k]]])
        return float(without.max()), k, int(version[k])

    if len(t) <= most:
        return t
    left = [cost(k) for k in range(1, len(t) - 1)]
    heapify(left)
    kept = np.ones(len(t), dtype=np.bool_)
    while kept.sum() > most:
        _, k, counted = heappop(left)
        if not kept[k] or counted != version[k]:
            continue
        kept[k] = False
        after[before[k]], before[after[k]] = after[k], before[k]
        for beside in (before[k], after[k]):
            if 0 < beside < len(t) - 1:
                version[beside] += 1
                heappush(left, cost(int(beside)))
    return np.asarray(t[kept])


def _efforts(plan: Plan, t: FloatArray) -> FloatArray:
    """The joints' torques (k, n) at times (k,) of the job; a join belongs to the segment that ends there."""
    segments, torque = plan.job.segments, np.empty((len(t), plan.robot.dof))
    numbers = np.searchsorted([segment.end for segment in segments[:-1]], t)
    for number, segment in enumerate(segments):
        which = numbers == number
        robot = plan.robot if segment.kind == "stroke" else plan.robot.tool_off
        states = plan.job.trajectory.states(t[which])
        torque[which] = Dynamics(robot).efforts(*states).joint_torque
    return torque
