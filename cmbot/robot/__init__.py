"""What moves: the robot, its kinematics and its dynamics."""

from cmbot.robot.chain import Chain
from cmbot.robot.dynamics import Dynamics, EffortDerivatives, Efforts, WrenchDerivatives
from cmbot.robot.elasticity import LinkTube
from cmbot.robot.inspection import Finding, inspect_urdf, parse_urdf
from cmbot.robot.kinematics import Kinematics
from cmbot.robot.limits import JointLimits
from cmbot.robot.loading import load_robot
from cmbot.robot.overview import overview
from cmbot.robot.postures import PostureBatch, Postures, ToolBatch
from cmbot.robot.robot import Robot

__all__ = [
    "Chain",
    "Dynamics",
    "EffortDerivatives",
    "Efforts",
    "Finding",
    "JointLimits",
    "Kinematics",
    "LinkTube",
    "PostureBatch",
    "Postures",
    "Robot",
    "ToolBatch",
    "WrenchDerivatives",
    "inspect_urdf",
    "load_robot",
    "overview",
    "parse_urdf",
]
