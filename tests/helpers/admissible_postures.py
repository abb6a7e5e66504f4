"""Postures that a plan may pass a via-point in, found without charts."""

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.projection import project_onto_task


def values(context: PlanningContext, q: FloatArray) -> FloatArray:
    """The objective at rest."""
    return context.objective.at_rest(context.postures.at(q))


def admissible(context: PlanningContext, q: FloatArray) -> BoolArray:
    """Which postures are within joint ranges and torques, and clear."""
    limits, at = context.robot.limits, context.postures.at(q)
    holds = ((q >= limits.lower) & (q <= limits.upper)).all(axis=1)
    holds &= (np.abs(at.joint_torque) <= limits.torque).all(axis=1)
    holds[holds] = ~context.clearances.check_collision(q[holds], context.options.safety_margin_m)
    return holds


def restarts(context: PlanningContext, via_point: int, rng: np.random.Generator, number: int) -> FloatArray:
    """Admissible ones among random postures with the tool where it is at a via-point."""
    limits = context.robot.limits
    low, high = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    q = rng.uniform(low, high, (number, len(low)))
    placed, reached = project_onto_task(context.postures, context.task, q, context.goals[via_point], steps=40)
    placed = placed[reached]
    return placed[admissible(context, placed)]
