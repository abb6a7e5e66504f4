"""The return: the free move from the end of the work to the posture in which the arm is left."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.free_motion.free_move import FreeMove, plan_move
from cmbot.planning.job import RETURN, Segment, stands_of
from cmbot.planning.request import StrokeRequest

SAME_POSTURE = 1e-9
"""Postures that differ by less, rad and m, are the same: no move leads from one to the other."""


def plan_return(request: StrokeRequest, start: FloatArray, *, begin: float, allowed: float) -> Segment | None:
    """Plan the free move from the end of the work, `start` (n,), to where the scene wants the arm.

    Parameters
    ----------
    request : StrokeRequest
    start : (n,), rad, of joints that slide m
    begin : float, s
        When the work ends on the job's clock.
    allowed : float
        Value of the objective that the job reaches anyway.

    Returns
    -------
    Segment or None
        None where the scene asks for no return, or the work ends there.

    Raises
    ------
    PathNotFound
        When nothing leads there.
    """
    end = request.end_posture
    if end is None or np.abs(end - start).max() <= SAME_POSTURE:
        return None
    move = FreeMove(
        name=RETURN,
        start=start,
        end=end,
        start_name="the end of the work",
        end_name=f"the {'start' if np.array_equal(end, request.state.posture) else 'stow'} posture",
        begin=begin,
        allowed=allowed,
        stands=stands_of(RETURN, request.cell.robot.tool_ramp),
    )
    try:
        return plan_move(request, move)
    except PathNotFound as failure:
        # It is planned last, after all else is certified.
        failure.add_hint("with return: none the job is planned")
        raise
