"""Footholds: where nothing is in the way of a foot on a member of the guardrail, or of the climber."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from cmbot.collision import Box, Clearances, Obstacle, touched_by
from cmbot.common.arrays import FloatArray
from cmbot.robot import ARM_JOINTS, Robot, load_climbing_robot
from cmbot.scene import FootholdFile, Scene, foothold_pose

# The foot in its frame, as the URDF has it, m: sides, and its centre above the member's axis.
_FOOT, _CENTRE = (0.13, 0.05, 0.15), 0.065
_LIFT_M = 0.06


def lift_height() -> float:
    """Return how far a foot is lifted off along the normal of the face before it swings, m."""
    return _LIFT_M


def in_the_way(scene: Scene, place: FootholdFile) -> str | None:
    """Return the name of an obstacle or member that a foot touches there, or on its way there from above.

    Joints of members, such as a post behind a rail, are in the way as lamps are. None where nothing is.

    Parameters
    ----------
    scene : Scene
    place : FootholdFile
    """
    X = foothold_pose(scene.elastic_guardrail, place)
    X[:3, 3] += (_CENTRE + _LIFT_M / 2) * X[:3, 1]
    box = Box(size=(_FOOT[0], _FOOT[1] + _LIFT_M, _FOOT[2]))
    others = [obstacle for obstacle in scene.all_obstacles if obstacle.name != place.member]
    return touched_by(box, np.asarray(X), others)


def bare_climber(root: FloatArray, obstacles: Sequence[Obstacle] = (), *, foot_2: bool = True) -> Clearances:
    """Return clearances of the climber without the arm, by the climbing joints (N, 5), foot 1 at `root`.

    Where foot 2 holds something its own shapes do not count.
    """
    robot = load_climbing_robot(1, root, np.zeros(len(ARM_JOINTS)))
    left_out = {"tool"} if foot_2 else {"tool", "foot_2"}
    moving = without_links(robot, lambda link: link in left_out or link.startswith("link_"))
    return Clearances(moving, obstacles)


def without_links(robot: Robot, left_out: Callable[[str], bool]) -> Robot:
    """Return the robot without the collision shapes of some links."""
    shapes, frames = pin.GeometryModel(robot.collision_model), robot.model.frames
    # Each removal moves the shapes behind it.
    names = [str(s.name) for s in shapes.geometryObjects if left_out(str(frames[s.parentFrame].name))]
    for name in names:
        shapes.removeGeometryObject(name)
    return replace(robot, collision_model=shapes)
