"""Where the robot works: the scene file, the tool path, obstacles, the guardrail, the planner's options."""

from cmbot.common.installation import shipped_scenes
from cmbot.common.reading.fields import FOLDER
from cmbot.scene.base.guardrail import GuardrailFile, elastic_guardrail, feet_at, guardrail_obstacles
from cmbot.scene.base.hold import HoldFile, held_member
from cmbot.scene.base.identified import IdentifiedBase, IdentifiedSpring, IdentifiedStiffness
from cmbot.scene.base.mounts import MountsFile
from cmbot.scene.base.stance import FootholdFile, Stance, StanceFile, axis_point, foothold_face, foothold_pose
from cmbot.scene.changes import changed_content, is_within, whole_key
from cmbot.scene.excitation import DamperFile, ExcitationFile, TrainsFile
from cmbot.scene.files import TRAINS
from cmbot.scene.obstacles import ObstacleFile
from cmbot.scene.options import MOST_SAMPLES, PlannerOptions
from cmbot.scene.path.path_file import WORK, AxisCone, JobStrokes, Keep, StrokeFile
from cmbot.scene.path.raster_parts import rows_alone
from cmbot.scene.path.stroke import Stroke, coverage_of, pieces_left_out
from cmbot.scene.robot_entry import STOW, AttachedToolFile, MountFile, NamedState, PostureFile, RobotFile
from cmbot.scene.scene import Scene
from cmbot.scene.scene_file import load_scene, scene_from_data, scene_path
from cmbot.scene.template import NewRobot, limits_text, scene_text
from cmbot.scene.tool import SPEED_TOLERANCE, Tool
from cmbot.scene.uncertainty import JointUncertainty, Placement, Tolerance, Uncertainty

__all__ = [
    "FOLDER",
    "MOST_SAMPLES",
    "SPEED_TOLERANCE",
    "STOW",
    "TRAINS",
    "WORK",
    "AttachedToolFile",
    "AxisCone",
    "DamperFile",
    "ExcitationFile",
    "FootholdFile",
    "GuardrailFile",
    "HoldFile",
    "IdentifiedBase",
    "IdentifiedSpring",
    "IdentifiedStiffness",
    "JobStrokes",
    "JointUncertainty",
    "Keep",
    "MountFile",
    "MountsFile",
    "NamedState",
    "NewRobot",
    "ObstacleFile",
    "Placement",
    "PlannerOptions",
    "PostureFile",
    "RobotFile",
    "Scene",
    "Stance",
    "StanceFile",
    "Stroke",
    "StrokeFile",
    "Tolerance",
    "Tool",
    "TrainsFile",
    "Uncertainty",
    "axis_point",
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
    "load_scene",
    "pieces_left_out",
    "rows_alone",
    "scene_from_data",
    "scene_path",
    "scene_text",
    "shipped_scenes",
    "whole_key",
]
