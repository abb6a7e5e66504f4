"""Plans for ROS 2: the job as messages in an MCAP file, the robot as a description package."""

from cmbot.archive.ros.messages import RosTrajectory, enough_points, export_mcap, export_ros
from cmbot.archive.ros.ros_package import export_ros_package

__all__ = ["RosTrajectory", "enough_points", "export_mcap", "export_ros", "export_ros_package"]
