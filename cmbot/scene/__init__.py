"""Where the robot works: the scene file, the tool path, obstacles, the guardrail, the planner's options."""

from cmbot.common.installation import shipped_scenes
from cmbot.scene.attached_tool import AttachedToolFile
from cmbot.scene.base.guardrail import GuardrailFile, elastic_guardrail, feet_at, guardrail_obstacles
from cmbot.scene.base.hold import HoldFile, held_member
from cmbot.scene.base.identified import IdentifiedBase, IdentifiedSpring, IdentifiedStiffness
from cmbot.scene.base.stance import FootholdFile, Stance, StanceFile, axis_point, foothold_face, foothold_pose
from cmbot.scene.changes import changed_content, is_within, whole_key
from cmbot.scene.excitation import DamperFile, ExcitationFile, TrainsFile
from cmbot.scene.files import FOLDER, TRAINS
from cmbot.scene.mesh_file import load_mesh
from cmbot.scene.mounts import MountsFile
from cmbot.scene.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, ObstacleFile, Shape, Sphere, pose
from cmbot.scene.options import MOST_SAMPLES, PlannerOptions
from cmbot.scene.path.legs import ArcTo, Goal, Leg
from cmbot.scene.path.path_file import WORK, AxisCone, JobStrokes, Keep, StrokeFile
from cmbot.scene.path.raster_parts import rows_alone
from cmbot.scene.path.stroke import Stroke, coverage_of, pieces_left_out
from cmbot.scene.path.time_law import LegLaw, PiecewiseLaw, SpeedProfile
from cmbot.scene.path.tool_path import ShiftedToolPath, ToolPath, share_out_segments
from cmbot.scene.path.tool_poses import ToolPoses, shortest_turns
from cmbot.scene.path.waypoints import SAME_PLACE
from cmbot.scene.raster.pieces import RowPiece, cells_of
from cmbot.scene.raster.raster import CylinderPatch, FaceSelection, Raster
from cmbot.scene.raster.surface import Coverage
from cmbot.scene.robot_entry import STOW, MountFile, NamedState, PostureFile, RobotFile
from cmbot.scene.scene import Scene
from cmbot.scene.scene_file import load_scene, scene_from_data, scene_path
from cmbot.scene.template import NewRobot, limits_text, scene_text
from cmbot.scene.tool import SPEED_TOLERANCE, Tool
from cmbot.scene.uncertainty import JointUncertainty, Placement, Tolerance, Uncertainty

__all__ = [
    "FOLDER",
    "MOST_SAMPLES",
    "SAME_PLACE",
    "SPEED_TOLERANCE",
    "STOW",
    "TRAINS",
    "WORK",
    "ArcTo",
    "AttachedToolFile",
    "AxisCone",
    "Box",
    "Capsule",
    "Coverage",
    "Cylinder",
    "CylinderPatch",
    "DamperFile",
    "ExcitationFile",
    "FaceSelection",
    "FootholdFile",
    "Goal",
    "GuardrailFile",
    "HoldFile",
    "IdentifiedBase",
    "IdentifiedSpring",
    "IdentifiedStiffness",
    "JobStrokes",
    "JointUncertainty",
    "Keep",
    "Leg",
    "LegLaw",
    "Mesh",
    "MountFile",
    "MountsFile",
    "NamedState",
    "NewRobot",
    "Obstacle",
    "ObstacleFile",
    "PiecewiseLaw",
    "Placement",
    "PlannerOptions",
    "PostureFile",
    "Raster",
    "RobotFile",
    "RowPiece",
    "Scene",
    "Shape",
    "ShiftedToolPath",
    "SpeedProfile",
    "Sphere",
    "Stance",
    "StanceFile",
    "Stroke",
    "StrokeFile",
    "Tolerance",
    "Tool",
    "ToolPath",
    "ToolPoses",
    "TrainsFile",
    "Uncertainty",
    "axis_point",
    "cells_of",
    "changed_content",
    "coverage_of",
    "elastic_guardrail",
    "feet_at",
    "foothold_face",
    "foothold_pose",
    "guardrail_obstacles",
    "held_member",
    "is_within",
    "limits_text",
    "load_mesh",
    "load_scene",
    "pieces_left_out",
    "pose",
    "rows_alone",
    "scene_from_data",
    "scene_path",
    "scene_text",
    "share_out_segments",
    "shipped_scenes",
    "shortest_turns",
    "whole_key",
]
