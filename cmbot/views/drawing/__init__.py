"""What is drawn in 3-D: robot and bridge as meshes, how they bend, and from where they are seen."""

from cmbot.views.drawing.bending import Bending, Intervals, drawn_factor, most_factor
from cmbot.views.drawing.bridge import bridge_of, jobs_of
from cmbot.views.drawing.camera import ARROW, focus_of, focus_on, link_corners, link_poses, workpieces
from cmbot.views.drawing.meshcat_scene import (
    bridge_commands,
    carrier_commands,
    moving_robot_commands,
    obstacle_commands,
    path_commands,
    reach,
    scene_commands,
)
from cmbot.views.drawing.support import supports
from cmbot.views.drawing.surfaces import obstacle_surface

__all__ = [
    "ARROW",
    "Bending",
    "Intervals",
    "bridge_commands",
    "bridge_of",
    "carrier_commands",
    "drawn_factor",
    "focus_of",
    "focus_on",
    "jobs_of",
    "link_corners",
    "link_poses",
    "most_factor",
    "moving_robot_commands",
    "obstacle_commands",
    "obstacle_surface",
    "path_commands",
    "reach",
    "scene_commands",
    "supports",
    "workpieces",
]
