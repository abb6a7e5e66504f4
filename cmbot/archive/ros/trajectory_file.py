"""A plan's job as a ROS 2 message in a file of its own."""

from __future__ import annotations

from pathlib import Path

from cmbot.archive.folder import write_file
from cmbot.archive.motion_files import trajectory_json
from cmbot.common.validation import given_path
from cmbot.planning import Plan, require_plan

__all__ = ["export_ros"]


def export_ros(plan: Plan, path: str | Path, *, effort: bool = False) -> None:
    """Write the planned job of a plan as JSON of a ``trajectory_msgs/JointTrajectory``, whole or not at all.

    Without `effort` that is ``job.ros.json`` of a plan directory.

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
    write_file(target, trajectory_json(plan.robot, plan.job_samples[0], effort=effort))
