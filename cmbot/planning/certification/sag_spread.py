"""How far the tool may be from its path within the uncertainty of an identified stiffness."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.limit import Limit
from cmbot.elastic.sag import Sag
from cmbot.planning.certification.check import Check
from cmbot.toolpath import ToolPath
from cmbot.trajectory import QuinticTrajectory

# Longest time between postures in which the standard deviation is computed, s; it changes slowly.
_SPREAD_INTERVAL_S = 0.25


def across_path(path: ToolPath, sag: Sag, t: FloatArray, q: FloatArray) -> FloatArray:
    """Return the standard deviations (N,), m, of the tool's place across its path in postures `q` (N, n).

    Those in the worst direction across the leg of each time `t` (N,), by the covariance of the stiffness.
    """
    covariance, along = sag.spread(q), path.leg_directions(t)
    across = np.eye(3) - along[:, :, None] * along[:, None, :]
    largest = np.linalg.eigvalsh(across @ covariance @ across)[:, -1]
    return np.asarray(np.sqrt(np.maximum(largest, 0.0)))


def spread_times(trajectory: QuinticTrajectory) -> FloatArray:
    """Return times (N,), s, along a trajectory at which its standard deviation is computed."""
    count = max(int(np.ceil(trajectory.duration / _SPREAD_INTERVAL_S)), 8)
    return np.linspace(trajectory.t[0], trajectory.t[-1], count + 1)


def largest_spread(path: ToolPath, sag: Sag, trajectory: QuinticTrajectory) -> tuple[float, float]:
    """Return the largest standard deviation across the path, m, and when, s.

    Half its largest change from one computed posture to the next is added, for what lies between them.
    """
    t = spread_times(trajectory)
    spread = across_path(path, sag, t, trajectory.evaluate(t))
    between = 0.5 * float(np.abs(np.diff(spread)).max())
    return float(spread.max()) + between, float(t[spread.argmax()])


def spread_check(
    path: ToolPath, sag: Sag, trajectory: QuinticTrajectory, expected: float, sigmas: float, allowed: float
) -> Check:
    """Check the expected deviation, at most `expected`, m, and some standard deviations together.

    The largest of both count, wherever they are.
    """
    largest, when = largest_spread(path, sag, trajectory)
    return Check(
        quantity=f"tool deviation within {sigmas:g} standard deviations of the stiffness",
        time=when,
        value=expected + sigmas * largest,
        bound=allowed,
        unit="m",
        limit=Limit.TOOL_DEVIATION,
    )
