"""The robot: its model from a URDF, its kinematics and its dynamics."""

from cmbot.robot.arm_model import convex_hull, encloses_volume
from cmbot.robot.dynamics import Dynamics, Efforts
from cmbot.robot.elasticity import LinkTube
from cmbot.robot.inspection import Finding, inspect_urdf, overview
from cmbot.robot.kinematics import Chain, Kinematics, PostureBatch, Postures, ToolBatch
from cmbot.robot.limits import JointLimits
from cmbot.robot.loading import load_robot
from cmbot.robot.mesh_file import locate_meshes
from cmbot.robot.robot import Robot
from cmbot.robot.xml_file import parse_urdf

__all__ = [
    "Chain",
    "Dynamics",
    "Efforts",
    "Finding",
    "JointLimits",
    "Kinematics",
    "LinkTube",
    "PostureBatch",
    "Postures",
    "Robot",
    "ToolBatch",
    "convex_hull",
    "encloses_volume",
    "inspect_urdf",
    "load_robot",
    "locate_meshes",
    "overview",
    "parse_urdf",
]
