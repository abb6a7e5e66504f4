"""A plan's job as a ROS ``trajectory_msgs/JointTrajectory``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbot.archive.folder import write_file
from cmbot.archive.strict_json import json_bytes
from cmbot.common.validation import given_path
from cmbot.planning import Plan, require_plan

__all__ = ["Message", "export_ros", "joint_trajectory", "stamp"]

Message = dict[str, Any]


def export_ros(plan: Plan, path: str | Path) -> None:
    """Write the planned job of a plan as a ``trajectory_msgs/JointTrajectory`` in JSON, every 0.01 s.

    Parameters
    ----------
    plan : Plan
    path : str or Path
        An earlier file of that name is replaced.

    Raises
    ------
    InputError
        When `plan` is none.
    ArchiveError
        When the file cannot be written.
    """
    require_plan(plan, "cmbot.archive.export_ros")
    target = given_path(path, "cmbot.archive.export_ros", "path", "the path of a file to write")
    write_file(target, json_bytes(joint_trajectory(plan)))


def joint_trajectory(plan: Plan) -> Message:
    """Return the whole job as a message; time 0 is its beginning."""
    samples, _ = plan.job_samples
    rows = zip(samples.t, samples.q, samples.v, samples.a, samples.joint_torque, strict=True)
    return {
        "header": {"stamp": stamp(0.0), "frame_id": ""},
        "joint_names": list(plan.robot.joints),
        "points": [
            {
                "positions": q.tolist(),
                "velocities": v.tolist(),
                "accelerations": a.tolist(),
                "effort": torque.tolist(),
                "time_from_start": stamp(float(t)),
            }
            for t, q, v, a, torque in rows
        ],
    }


def stamp(time: float) -> Message:
    """Return a time, s, as ``builtin_interfaces/Time`` and ``Duration`` have it."""
    seconds, nanoseconds = divmod(round(1e9 * time), 10**9)
    return {"sec": seconds, "nanosec": nanoseconds}
