"""Clearances: the smallest distances between the arm, the obstacles and the arm itself.

What needs coal or pinocchio is imported when it is first used: a scene is read without them.
"""

from typing import TYPE_CHECKING

from cmbot.collision.mesh_file import load_mesh as load_mesh
from cmbot.collision.obstacles import (
    Box as Box,
    Capsule as Capsule,
    Cylinder as Cylinder,
    Mesh as Mesh,
    Obstacle as Obstacle,
    Shape as Shape,
    Sphere as Sphere,
)
from cmbot.common.lazy_imports import on_first_use

if TYPE_CHECKING:
    from cmbot.collision.clearance import (
        RESOLUTION as RESOLUTION,
        Clearances as Clearances,
        Nearest as Nearest,
        Smallest as Smallest,
    )
    from cmbot.collision.motion_bounds import raise_bounds as raise_bounds, travel as travel
    from cmbot.collision.point_distances import PointDistances as PointDistances
    from cmbot.collision.shapes import (
        PairedShapes as PairedShapes,
        ShapePair as ShapePair,
        extent_of as extent_of,
        touched_by as touched_by,
    )

__getattr__ = on_first_use(__name__)
