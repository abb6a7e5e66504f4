"""The robot: its model from a URDF, its kinematics and its dynamics."""

from cmbot.robot.climber import CLIMBING_JOINTS, Climber, ClimberBodies
from cmbot.robot.description.completion import AttachedTool, ToolShape
from cmbot.robot.description.files import RobotFiles, robot_files
from cmbot.robot.description.frames import arm_frames
from cmbot.robot.description.hulls import convex_hull, encloses_volume
from cmbot.robot.description.mesh_file import faces_of, is_mesh, locate_meshes, vertices_of
from cmbot.robot.description.self_collision import MOST_FAR, NEAR, sampled_postures
from cmbot.robot.description.xml_file import parse_urdf, urdf_content
from cmbot.robot.dynamics import Dynamics, Efforts, external_forces
from cmbot.robot.elasticity import JointElasticity, LinkTube
from cmbot.robot.holding_joints import HoldingJoint, holding_rows, leg_compliance
from cmbot.robot.inspection import Finding, inspect_robot, inspect_urdf, overview
from cmbot.robot.joint_kinds import (
    JointUnits,
    PostureMetric,
    joint_units,
    postures_in_words,
    prismatic_joints,
    slide_axes,
    turn_axis,
)
from cmbot.robot.kinematics import Chain, Kinematics, PostureBatch, Postures, ToolBatch, link_poses
from cmbot.robot.limits import JointLimits
from cmbot.robot.loading import (
    ARM_JOINTS,
    Side,
    inspect_loaded,
    load_climbing_robot,
    load_robot,
    other_foot,
    srdf_text,
)
from cmbot.robot.robot import Robot

__all__ = [
    "ARM_JOINTS",
    "CLIMBING_JOINTS",
    "MOST_FAR",
    "NEAR",
    "AttachedTool",
    "Chain",
    "Climber",
    "ClimberBodies",
    "Dynamics",
    "Efforts",
    "Finding",
    "HoldingJoint",
    "JointElasticity",
    "JointLimits",
    "JointUnits",
    "Kinematics",
    "LinkTube",
    "PostureBatch",
    "PostureMetric",
    "Postures",
    "Robot",
    "RobotFiles",
    "Side",
    "ToolBatch",
    "ToolShape",
    "arm_frames",
    "convex_hull",
    "encloses_volume",
    "external_forces",
    "faces_of",
    "holding_rows",
    "inspect_loaded",
    "inspect_robot",
    "inspect_urdf",
    "is_mesh",
    "joint_units",
    "leg_compliance",
    "link_poses",
    "load_climbing_robot",
    "load_robot",
    "locate_meshes",
    "other_foot",
    "overview",
    "parse_urdf",
    "postures_in_words",
    "prismatic_joints",
    "robot_files",
    "sampled_postures",
    "slide_axes",
    "srdf_text",
    "turn_axis",
    "urdf_content",
    "vertices_of",
]
