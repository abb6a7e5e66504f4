"""What the joint_trajectory_controller of ros2_control requires of a trajectory before it accepts it.

Written anew from what `validate_trajectory_msg` of ros2_controllers checks in the releases for Humble (2.x)
and Jazzy (4.x), with the strictest parameters: `allow_partial_joints_goal` and
`allow_nonzero_velocity_at_trajectory_end` false, the first of them their default, the second that of Jazzy.
They differ in efforts: Humble refuses every trajectory with some, and so do the first releases of Jazzy;
newer ones take them where the controller commands an effort interface.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal

import numpy as np

Release = Literal["humble", "jazzy"]
_STILL = float(np.finfo(np.float32).eps)


def refusals(
    trajectory: Mapping[str, Any], joints: Sequence[str], release: Release, *, commands_effort: bool = False
) -> list[str]:
    """Why a controller of `joints` refuses a ``trajectory_msgs/JointTrajectory``; it starts when it comes."""
    names, points = trajectory["joint_names"], trajectory["points"]
    if not names or not points:
        return ["no joints or no points"]
    found = []
    if sorted(names) != sorted(joints):
        found.append("other joints than the controller's")
    if np.abs(points[-1].get("velocities", [])).max(initial=0.0) > _STILL:
        found.append("it ends in motion")
    stamp = trajectory["header"]["stamp"]
    if (stamp["sec"], stamp["nanosec"]) != (0, 0):
        found.append("a time of start, which may be in the past")
    times = [each["time_from_start"]["sec"] * 10**9 + each["time_from_start"]["nanosec"] for each in points]
    if any(later <= earlier for earlier, later in pairwise(times)):
        found.append("times that do not increase strictly")
    for point in points:
        if len(point["positions"]) != len(names):
            found.append("other than one position for each joint")
        found += [
            f"neither none of {name} nor one for each joint"
            for name in ("velocities", "accelerations")
            if point.get(name) and len(point[name]) != len(names)
        ]
        if point.get("effort") and not (release == "jazzy" and commands_effort):
            found.append("effort")
    return sorted(set(found))
