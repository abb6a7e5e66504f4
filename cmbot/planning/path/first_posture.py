"""Where the work starts when the tool path begins apart from the tool in the scene's posture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.nearest_miss import nearest_miss
from cmbot.planning.path.projection import project_onto_task

# Random postures from which Newton's method starts, and its steps.
_RESTARTS, _STEPS = 1000, 40


def starting_at_path(context: PlanningContext) -> PlanningContext:
    """Return the context whose work starts in the admissible posture nearest to the scene's.

    Raises
    ------
    PathNotFound
        When none was found.
    """
    found = _admissible(context, context.posture[None])
    if not len(found):
        limits, rng = context.robot.limits, np.random.default_rng(0)
        half = limits.sampled_half
        low, high = limits.range_middle - half, limits.range_middle + half
        found = _admissible(context, rng.uniform(low, high, (_RESTARTS, len(low))))
    if not len(found):
        begin = ", ".join(f"{x:.3f}" for x in context.task.path.corners[0])
        reason = (
            f"no posture that holds the tool where the path begins, at ({begin}) m, within the joint ranges, "
            f"clear of obstacles and strong enough was found in {_RESTARTS} attempts"
        )
        if miss := nearest_miss(context, is_clear=True, times=np.zeros(1)):
            reason = "; ".join(filter(None, (f"the path begins {miss.reason()}", miss.remedy())))
        raise context.path_not_found(reason, context.posture)
    away = context.robot.metric.lengths(found - context.posture)
    return replace(context, first=found[int(away.argmin())])


def _admissible(context: PlanningContext, q: FloatArray) -> FloatArray:
    """Postures near `q` (N, n) that hold the tool at the path's beginning, (k, n)."""
    limits, goal = context.robot.limits, context.task.path.poses([0.0])
    placed, reached = project_onto_task(
        context.postures, context.task.on_axis, q, goal, steps=_STEPS, tolerance=1e-12
    )
    placed = limits.turned_to_middle(placed[reached])
    placed = placed[limits.contain(placed)]
    placed = placed[context.use_at_rest(context.postures.at(placed)) <= 1.0]
    return np.asarray(placed[~context.clearances.check_collision(placed, context.options.safety_margin_m)])
