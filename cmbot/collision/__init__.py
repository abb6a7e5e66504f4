"""Clearances: the smallest distances between the arm, the obstacles and the arm itself.

What needs coal or pinocchio is imported when it is first used: a scene is read without them.
"""

from typing import TYPE_CHECKING

from cmbot.collision.mesh_file import load_mesh
from cmbot.collision.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere
from cmbot.common.lazy_imports import on_first_use

if TYPE_CHECKING:
    from cmbot.collision.clearance import RESOLUTION, Clearances, Nearest, Smallest
    from cmbot.collision.motion_bounds import raise_bounds, travel
    from cmbot.collision.point_distances import PointDistances
    from cmbot.collision.shapes import PairedShapes, ShapePair, extent_of, touched_by

__getattr__ = on_first_use(__name__)
