"""Piecewise quintic splines: nothing of robots.

Read `quintic`, then `spline_space`, `local_basis` and `parametrization`; `enclosure` bounds functions.
"""

from cmbot.trajectory.enclosure import Ellipses, Peak, Pieces, clenshaw_curtis, highest
from cmbot.trajectory.local_basis import LocalRows, SparseSplines
from cmbot.trajectory.parametrization import Parametrization, Retraction
from cmbot.trajectory.polynomials import bernstein_coefficients, halves
from cmbot.trajectory.quintic import LARGEST, SAMPLE_STEP, Extrema, QuinticTrajectory, sample_step
from cmbot.trajectory.spline_space import SUPPORT, SplineSpace
