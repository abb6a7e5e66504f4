"""Piecewise quintic splines: nothing of robots.

Read `quintic`, then `spline_space`, `local_basis` and `parametrization`.
"""

from cmbot.trajectory.local_basis import LocalRows, SparseSplines
from cmbot.trajectory.parametrization import Parametrization, Retraction
from cmbot.trajectory.quintic import Extrema, QuinticTrajectory
from cmbot.trajectory.spline_space import SUPPORT, SplineSpace

__all__ = [
    "SUPPORT",
    "Extrema",
    "LocalRows",
    "Parametrization",
    "QuinticTrajectory",
    "Retraction",
    "SparseSplines",
    "SplineSpace",
]
