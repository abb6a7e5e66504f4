"""Plans for ROS 2: the job as messages in an MCAP file, the robot as a description package."""

from cmbot.archive.ros.mcap_file import export_mcap
from cmbot.archive.ros.ros_package import export_ros_package
from cmbot.archive.ros.trajectory_file import RosTrajectory, export_ros

__all__ = ["RosTrajectory", "export_mcap", "export_ros", "export_ros_package"]
