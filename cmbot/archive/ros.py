"""A sampled motion as a ROS 2 ``trajectory_msgs/JointTrajectory`` in JSON."""

from __future__ import annotations

import numpy as np

from cmbot.archive.number_text import number_rows
from cmbot.archive.strict_json import json_bytes
from cmbot.planning import Samples
from cmbot.robot import Robot

__all__ = ["ros_json"]

_POINT = (
    '{{"positions": [{}], "velocities": [{}], "accelerations": [{}], "effort": [{}], '
    '"time_from_start": {{"sec": {}, "nanosec": {}}}}}'
)


def ros_json(robot: Robot, samples: Samples) -> bytes:
    """Return samples, all of them finite, as the content of a file."""
    message = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(robot.joints),
        "points": [],
    }
    vectors = (number_rows(x) for x in (samples.q, samples.v, samples.a, samples.joint_torque))
    nanoseconds = np.rint(1e9 * (samples.t - samples.t[0])).astype(np.int64).tolist()
    points = [
        _POINT.format(*map(", ".join, parts), *divmod(time, 10**9))
        for *parts, time in zip(*vectors, nanoseconds, strict=True)
    ]
    # Nearly all of the file are numbers, and json writes them slowly.
    head, end = json_bytes(message).decode().rsplit("]", 1)
    return f"{head}{', '.join(points)}]{end}".encode()
