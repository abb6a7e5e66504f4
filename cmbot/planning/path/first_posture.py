"""Where the work starts when the tool path begins apart from the tool in the scene's posture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cmbot.planning.path.nearest_miss import nearest_miss
from cmbot.planning.postures.sampler import PostureSampler
from cmbot.planning.request import StrokeRequest

# Random postures from which Newton's method starts.
_MAX_RESTARTS = 1000


def starting_at_path(request: StrokeRequest) -> StrokeRequest:
    """Return the request whose work starts in the admissible posture nearest to the scene's.

    Raises
    ------
    PathNotFound
        When none was found.
    """
    posture, begin = request.state.posture, request.task.path.poses([0.0])
    sampler = PostureSampler(cell=request.cell, task=request.task, tolerance=1e-12)
    found = sampler.near(posture[None], begin)
    if not len(found):
        (found,) = sampler.at_each(begin, _MAX_RESTARTS, posture)
    if not len(found):
        where = ", ".join(f"{x:.3f}" for x in request.task.path.corners[0])
        reason = (
            f"no posture that holds the tool where the path begins, at ({where}) m, within the joint ranges, "
            f"clear of obstacles and strong enough was found in {_MAX_RESTARTS} attempts"
        )
        if miss := nearest_miss(request, is_clear=True, times=np.zeros(1)):
            reason = "; ".join(filter(None, (f"the path begins {miss.reason()}", miss.remedy())))
        raise request.path_not_found(reason, posture)
    away = request.cell.robot.metric.lengths(found - posture)
    return replace(request, first=found[int(away.argmin())])
