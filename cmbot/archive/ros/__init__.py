"""Plans for ROS 2: the job as one message or an MCAP file of many, the robot as a description package."""

from cmbot.archive.ros.job_file import export_ros
from cmbot.archive.ros.mcap_file import export_mcap
from cmbot.archive.ros.ros_package import export_ros_package

__all__ = ["export_mcap", "export_ros", "export_ros_package"]
