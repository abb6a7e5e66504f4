"""Piecewise quintic splines: nothing of robots.

Read `quintic`, then `spline_space`, `local_basis` and `parametrization`; `enclosure` bounds functions.
"""

from cmbot.trajectory.enclosure import (
    Ellipses as Ellipses,
    Peak as Peak,
    Pieces as Pieces,
    clenshaw_curtis as clenshaw_curtis,
    highest as highest,
)
from cmbot.trajectory.local_basis import LocalRows as LocalRows, SparseSplines as SparseSplines
from cmbot.trajectory.parametrization import Parametrization as Parametrization, Retraction as Retraction
from cmbot.trajectory.polynomials import bernstein_coefficients as bernstein_coefficients, halves as halves
from cmbot.trajectory.quintic import (
    LARGEST as LARGEST,
    SAMPLE_STEP as SAMPLE_STEP,
    Extrema as Extrema,
    QuinticTrajectory as QuinticTrajectory,
    sample_step as sample_step,
)
from cmbot.trajectory.spline_space import SUPPORT as SUPPORT, SplineSpace as SplineSpace
