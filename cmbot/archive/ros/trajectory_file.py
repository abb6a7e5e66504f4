"""A plan's job as a ROS 2 message in a file of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import to_json

from cmbot.archive.folder import write_file
from cmbot.common.validation import given_path
from cmbot.planning import Plan, Samples, require_plan
from cmbot.robot import Robot


def export_ros(plan: Plan, path: str | Path, *, effort: bool = False) -> None:
    """Write the planned job of a plan as JSON of a ``trajectory_msgs/JointTrajectory``, whole or not at all.

    Parameters
    ----------
    plan : Plan
    path : str or Path
        An earlier file of that name is replaced.
    effort : bool
        Give the points the joints' torques, too, Nm, of joints that slide forces, N. The controller of
        ros2_control refuses such a message, but for those of Jazzy and later that command efforts.

    Raises
    ------
    InputError
        When `plan` is none.
    ArchiveError
        When the file cannot be written.
    """
    require_plan(plan, "cmbot.export_ros")
    target = given_path(path, "cmbot.export_ros", "path", "the path of a file to write")
    write_file(target, to_json(trajectory_message(plan.robot, plan.job_samples[0], effort=effort)) + b"\n")


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
