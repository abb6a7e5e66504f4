"""The baseline: Chang 2021, Eq. (22) integrated, as a motion to compare with."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.gradient_projection import JointPath
from cmbot.planning.verification.metrics import Samples, measure

__all__ = ["baseline_samples"]


def baseline_samples(context: PlanningContext, path: JointPath) -> Samples:
    """Measure a path as a motion that rests before it begins and after it ends.

    Parameters
    ----------
    setting : PlanningContext
    path : JointPath
        At even steps.
    """
    # Two steps of rest on either side: the central differences are then the same all along.
    rates = np.pad(path.v, ((2, 2), (0, 0)))
    acceleration = _central_difference(rates, path.t[1])
    jerk = _central_difference(acceleration, path.t[1])
    acceleration = acceleration[1:-1]
    # The trapezoid sets off and stops with a jump of acceleration. Half a jump is what no instant has: the
    # first and the last sample are those of the arm at rest, so that its rest counts among the torques.
    acceleration[[0, -1]] = 0.0
    motion = (path.q, path.v, acceleration, jerk)
    return measure(context.robot, context.task, context.clearances, path.t, motion, clearance=path.clearance)


def _central_difference(x: FloatArray, step: float) -> FloatArray:
    """Derivatives (N - 2, n) at the inner samples of `x` (N, n)."""
    return np.asarray((x[2:] - x[:-2]) / (2 * step))
