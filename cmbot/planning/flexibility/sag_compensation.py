"""Sag compensation: the tool that is held to the path is the bent arm's.

Near a motion the sag is known to first order in the joints. With it Newton's method finds via-points whose
bent tool is on the path, and the program of the motion has the bent tool as its task: via-points slide along
its self-motion, and between them it is its deviation that is bounded. Where the motion leads so
far away that the sag is another one, it is linearized again there; at last with via-points that stay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed
from cmbot.common.file_types import Count, NonNegative
from cmbot.common.limit import Limit
from cmbot.elastic.sag import Sag
from cmbot.planning.certification.sag_spread import largest_spread
from cmbot.planning.initial_guess import InitialGuess, problem_near
from cmbot.planning.request import StrokeRequest
from cmbot.planning.torque import Optimised, TorqueProblem, optimise
from cmbot.planning.workcell.bent_tool import BentTool

MOST_ROUNDS = 8
"""Rounds at most."""

# Rounds in which via-points slide; after them they stay, so that what follows is near what is known.
_SLIDING_ROUNDS = 2

# The change of the shift, as a share of the tool deviation allowed, that ends them.
_SETTLED = 0.04
# Share of the tool deviation that is left to the optimiser; the rest is for what the shift misses.
_LEFT = 0.95
# By how much the standard deviation may grow while the trajectory changes, and the least share of the tool
# deviation beside it.
_GROWS, _LEAST = 1.05, 0.2
# Times per spline segment at which the sag is computed.
_PER_SEGMENT = 4


@dataclass(frozen=True, kw_only=True)
class Compensation:
    """How the predicted sag was compensated.

    Attributes
    ----------
    rounds : int
        Trajectories that were optimised for it.
    largest_shift : float, m
        Of a commanded tool point from where the path has it.
    last_change : float, m
        By how much the sag along the motion differs from what it was taken for in the last round.
    deviation : float, m
        Largest standard deviation of the tool's place across its path, by that of an identified stiffness; 0
        where none is known.
    """

    rounds: Count
    largest_shift: NonNegative
    last_change: NonNegative
    deviation: NonNegative = 0.0


def compensate(
    request: StrokeRequest,
    guess: InitialGuess,
    optimised: Optimised,
    sag: Sag,
    progress: Callable[..., None] | None = None,
) -> tuple[Optimised, Compensation, TorqueProblem]:
    """Optimise the motion of the bent tool, its sag linearized near the trajectory before.

    `optimised` came from `guess`; `progress` is called with the number of the round, from 1, after every
    exchange iteration. Returns the last trajectory and the problem whose solution it is.

    Raises
    ------
    PathNotFound
        When a via-point of the bent arm is out of reach.
    OptimisationFailed
        When a round finds no trajectory, or the shift does not settle.
    """
    allowed = request.cell.options.max_tool_deviation_m
    settled = _SETTLED * allowed
    room = _LEFT * (allowed - _uncertain(request, optimised, sag))
    narrower = request.with_options(max_tool_deviation_m=room)
    times = np.linspace(request.times[:-1], request.times[1:], _PER_SEGMENT, endpoint=False, axis=1)
    times = np.append(times.ravel(), request.times[-1])
    change = np.inf
    for rounds in range(1, MOST_ROUNDS + 1):
        if request.deadline.expired():
            tried = f"{rounds - 1} of at most {MOST_ROUNDS} rounds"
            raise OptimisationFailed(
                f"{request.deadline.over_in_words} after {tried} of the compensation of the sag",
                constraint="change of the shift",
                violation=change / settled - 1,
                limit=Limit.SHIFT,
                stopped=True,
            )
        bent = _bent_near(request, sag, times, optimised.trajectory.evaluate(times))
        problem = problem_near(
            replace(narrower, bent=bent), guess, bent.q[::_PER_SEGMENT], stays=rounds > _SLIDING_ROUNDS
        )
        optimised = optimise(problem, None if progress is None else partial(progress, rounds=rounds))
        q = optimised.trajectory.evaluate(times)
        actual = sag.following(q)
        change = float(np.linalg.norm(actual - bent.at(times, q).sag, axis=1).max())
        if change < settled:
            largest = float(np.linalg.norm(actual, axis=1).max())
            spread = 0.0
            if sag.covariance is not None:
                spread, _ = largest_spread(request.task.path, sag, optimised.trajectory)
            done = Compensation(rounds=rounds, largest_shift=largest, last_change=change, deviation=spread)
            return optimised, done, problem
    raise OptimisationFailed(
        f"the compensation of the sag did not settle in {MOST_ROUNDS} rounds",
        constraint="change of the shift",
        violation=change / settled - 1,
        limit=Limit.SHIFT,
    )


def _bent_near(request: StrokeRequest, sag: Sag, times: FloatArray, q: FloatArray) -> BentTool:
    """The bent tool near a motion `q` (N, n) at `times` (N,)."""
    at = sag.at(q)
    return BentTool(postures=request.cell.postures, times=times, q=q, sag=at.tool, slope=at.d_tool)


def _uncertain(request: StrokeRequest, optimised: Optimised, sag: Sag) -> float:
    """What of the allowed deviation is for the errors of an identified stiffness, m."""
    sigmas, allowed = request.cell.options.deviation_sigmas, request.cell.options.max_tool_deviation_m
    if sag.covariance is None or not sigmas:
        return 0.0
    spread, _ = largest_spread(request.task.path, sag, optimised.trajectory)
    uncertain = _GROWS * sigmas * spread
    if uncertain > (1 - _LEAST) * allowed:
        raise OptimisationFailed(
            f"the stiffness is known too little: {sigmas:g} standard deviations of the tool's place across "
            f"its path are {1e3 * sigmas * spread:.2f} mm, of {1e3 * allowed:g} mm that are allowed",
            constraint="tool deviation within standard deviations of the stiffness",
            violation=uncertain / allowed - 1,
            limit=Limit.TOOL_DEVIATION,
        )
    return uncertain
