"""What moves: the robot, its kinematics and its dynamics."""

from cmbot.robot.dynamics import Dynamics, EffortDerivatives, Efforts
from cmbot.robot.inspection import Finding, inspect_urdf, parse_urdf
from cmbot.robot.kinematics import Kinematics
from cmbot.robot.limits import JointLimits
from cmbot.robot.loading import load_robot
from cmbot.robot.postures import PostureBatch, Postures
from cmbot.robot.robot import Robot

__all__ = [
    "Dynamics",
    "EffortDerivatives",
    "Efforts",
    "Finding",
    "JointLimits",
    "Kinematics",
    "PostureBatch",
    "Postures",
    "Robot",
    "inspect_urdf",
    "load_robot",
    "parse_urdf",
]
