"""Which solver a plan is made with, and the family of splines that goes with it."""

from __future__ import annotations

from typing import Literal

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import MissingExtra
from cmbot.optimization.qp import piqp_module
from cmbot.planning.context import PlanningContext
from cmbot.planning.torque.families import FixedKnots, SlidingKnots, WhitenedSplines
from cmbot.planning.torque.family import Family
from cmbot.planning.torque.null_space import TaskAtViaPoints
from cmbot.robot import Postures
from cmbot.scene import PlannerOptions
from cmbot.trajectory.local_basis import SparseSplines
from cmbot.trajectory.parametrization import Parametrization
from cmbot.trajectory.spline_space import SplineSpace

__all__ = ["family_through", "solver_of"]


def solver_of(options: PlannerOptions) -> Literal["sqp", "slsqp"]:
    """Return the solver that the options ask for, or with ``auto`` the best that is installed.

    Raises
    ------
    MissingExtra
        When it is ``sqp`` and PIQP is not installed.
    """
    if options.solver == "slsqp":
        return "slsqp"
    try:
        piqp_module()
    except MissingExtra:
        if options.solver == "auto":
            return "slsqp"
        raise
    return "sqp"


def family_through(
    context: PlanningContext, via_points: FloatArray, *, sliding: bool, pinned: bool = False
) -> Family:
    """Return the splines around the one of least jerk through `via_points`, as the solver wants them.

    Parameters
    ----------
    setting : PlanningContext
    via_points : (n, d), rad
    sliding : bool
        They may slide along the self-motion.
    pinned : bool
        All but the first.

    Raises
    ------
    MissingExtra
        When the solver is not installed.
    """
    space, limits = SplineSpace(context.times), context.robot.limits
    weight = context.options.smoothing_weight
    task = TaskAtViaPoints(
        postures=Postures(context.robot),
        task=context.task,
        points=context.task.path.position(context.times),
    )
    if solver_of(context.options) == "sqp":
        local = SparseSplines(space, limits)
        numbers = local.least_jerk(via_points)
        return Parametrization(
            local, via_points, numbers, weight, task=task if sliding else None, pinned=pinned and sliding
        )
    whitened = WhitenedSplines(space, limits)
    numbers = np.zeros((space.dimension, context.robot.dof))
    if not sliding:
        return FixedKnots(whitened, via_points, numbers, weight)
    return SlidingKnots(
        whitened,
        via_points,
        numbers,
        weight,
        postures=task.postures,
        task=task.task,
        points=task.points,
        pinned=pinned,
    )
