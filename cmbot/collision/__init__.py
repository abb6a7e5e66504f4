"""Clearances: the smallest distances between the arm, the obstacles and the arm itself."""

from cmbot.collision.clearance import RESOLUTION, Clearances, Nearest, Smallest
from cmbot.collision.motion_bounds import raise_bounds, travel
from cmbot.collision.point_distances import PointDistances
from cmbot.collision.shapes import PairedShapes, ShapePair, extent_of, touched_by

__all__ = [
    "RESOLUTION",
    "Clearances",
    "Nearest",
    "PairedShapes",
    "PointDistances",
    "ShapePair",
    "Smallest",
    "extent_of",
    "raise_bounds",
    "touched_by",
    "travel",
]
