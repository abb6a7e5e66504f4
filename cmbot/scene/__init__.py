"""Where the robot works: the scene file, obstacles, the guardrail, the planner's options."""

from cmbot.scene.guardrail import guardrail_obstacles
from cmbot.scene.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere
from cmbot.scene.options import PlannerOptions
from cmbot.scene.scene import Leg, RobotSource, Scene
from cmbot.scene.scene_filing import filed
from cmbot.scene.scene_loading import load_scene, scene_from_file_model, shipped_scenes
from cmbot.scene.schema import SceneFile
from cmbot.scene.speed_profile import SpeedProfile

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "Leg",
    "Mesh",
    "Obstacle",
    "PlannerOptions",
    "RobotSource",
    "Scene",
    "SceneFile",
    "Shape",
    "SpeedProfile",
    "Sphere",
    "filed",
    "guardrail_obstacles",
    "load_scene",
    "scene_from_file_model",
    "shipped_scenes",
]
