"""Where the work starts when the tool path begins apart from the tool in the scene's posture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.path.nearest_miss import nearest_miss
from cmbot.planning.path.projection import project_onto_task
from cmbot.planning.request import StrokeRequest

# Random postures from which Newton's method starts, and its steps.
_RESTARTS, _STEPS = 1000, 40


def starting_at_path(request: StrokeRequest) -> StrokeRequest:
    """Return the request whose work starts in the admissible posture nearest to the scene's.

    Raises
    ------
    PathNotFound
        When none was found.
    """
    found = _admissible(request, request.state.posture[None])
    if not len(found):
        limits, rng = request.cell.robot.limits, np.random.default_rng(0)
        half = limits.sampled_half
        low, high = limits.range_middle - half, limits.range_middle + half
        found = _admissible(request, rng.uniform(low, high, (_RESTARTS, len(low))))
    if not len(found):
        begin = ", ".join(f"{x:.3f}" for x in request.task.path.corners[0])
        reason = (
            f"no posture that holds the tool where the path begins, at ({begin}) m, within the joint ranges, "
            f"clear of obstacles and strong enough was found in {_RESTARTS} attempts"
        )
        if miss := nearest_miss(request, is_clear=True, times=np.zeros(1)):
            reason = "; ".join(filter(None, (f"the path begins {miss.reason()}", miss.remedy())))
        raise request.path_not_found(reason, request.state.posture)
    away = request.cell.robot.metric.lengths(found - request.state.posture)
    return replace(request, first=found[int(away.argmin())])


def _admissible(request: StrokeRequest, q: FloatArray) -> FloatArray:
    """Postures near `q` (N, n) that hold the tool at the path's beginning, (k, n)."""
    cell = request.cell
    limits, goal = cell.robot.limits, request.task.path.poses([0.0])
    placed, reached = project_onto_task(
        cell.postures, request.task.on_axis, q, goal, steps=_STEPS, tolerance=1e-12
    )
    placed = limits.turned_to_middle(placed[reached])
    placed = placed[limits.contain(placed)]
    placed = placed[cell.use_at_rest(cell.postures.at(placed)) <= 1.0]
    return np.asarray(placed[~cell.clearances.check_collision(placed, cell.options.safety_margin_m)])
