"""Footholds: where nothing is in the way of a foot on a member of the guardrail."""

from __future__ import annotations

import numpy as np

from cmbot.collision import touched_by
from cmbot.scene import Box, FootholdFile, Scene, foothold_pose

__all__ = ["in_the_way", "lift_height"]

# The foot in its frame, as the URDF has it, m: sides, and its centre above the member's axis.
_FOOT, _CENTRE = (0.13, 0.05, 0.15), 0.065
_LIFT = 0.06


def lift_height() -> float:
    """Return how far a foot is lifted off along the normal of the face before it swings, m."""
    return _LIFT


def in_the_way(scene: Scene, place: FootholdFile) -> str | None:
    """Return the name of an obstacle or member that a foot touches there, or on its way there from above.

    Joints of members, such as a post behind a rail, are in the way as lamps are. None where nothing is.

    Parameters
    ----------
    scene : Scene
    place : FootholdFile
    """
    X = foothold_pose(scene.guardrail, place)
    X[:3, 3] += (_CENTRE + _LIFT / 2) * X[:3, 1]
    box = Box(size=(_FOOT[0], _FOOT[1] + _LIFT, _FOOT[2]))
    others = [obstacle for obstacle in scene.obstacles if obstacle.name != place.member]
    return touched_by(box, np.asarray(X), others)
