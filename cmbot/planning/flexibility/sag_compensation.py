"""Sag compensation: the via-points are shifted by the predicted sag, so that the bent arm follows the path.

The sag of a posture is known beforehand, but shifting a via-point changes its posture and with it the sag.
So Newton's method finds postures near a trajectory whose bent tool is on the path, and the shift is minus the
sag there. The trajectory that is optimised along the shifted path may use the self-motion otherwise, which
changes the sag a little: the shift is computed again along it until it converges.
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
from cmbot.planning.initial_guess import InitialGuess, shifted_problem
from cmbot.planning.postures.projection import least_norm_step, task_jacobian
from cmbot.planning.request import StrokeRequest
from cmbot.planning.torque import Optimised, TorqueProblem, optimise
from cmbot.toolpath import ShiftedToolPath, ToolPoses

MOST_ROUNDS = 8
"""Rounds at most."""

# The change of the shift, as a share of the tool deviation allowed, that ends them.
_SETTLED = 0.04
# Share of the tool deviation that is left to the optimiser; the rest is for what the shift misses.
_LEFT = 0.95
# By how much the standard deviation may grow while the trajectory changes, and the least share of the tool
# deviation beside it.
_GROWS, _LEAST = 1.05, 0.2
# Times per spline segment at which the sag is computed.
_PER_SEGMENT = 4
# Newton steps at most to a posture whose bent tool is on the path, and the error, m or rad, that ends them.
_STEPS, _ON_PATH = 8, 1e-8


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
        Largest change of a commanded tool point in the last round.
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
    """Optimise again and again along the path shifted by the sag of the trajectory before.

    `optimised` came from `guess`; `progress` is called with the number of the round, from 1, after every
    exchange iteration. Returns the last trajectory and the problem whose solution it is.

    Raises
    ------
    PathNotFound
        When a shifted via-point is out of reach.
    OptimisationFailed
        When a round finds no trajectory, or the shift does not settle.
    """
    allowed = request.cell.options.max_tool_deviation_m
    settled = _SETTLED * allowed
    room = _LEFT * (allowed - _uncertain(request, optimised, sag))
    narrower = request.with_options(max_tool_deviation_m=room)
    times = np.linspace(request.times[:-1], request.times[1:], _PER_SEGMENT, endpoint=False, axis=1)
    times = np.append(times.ravel(), request.times[-1])
    goals = request.task.goals(times)
    shift, problem = np.zeros((len(times), 3)), guess.problem
    for rounds in range(MOST_ROUNDS + 1):
        q, wanted = _bent_on_path(request, sag, optimised.trajectory.evaluate(times), goals)
        change = float(np.linalg.norm(wanted - shift, axis=1).max())
        if change < settled:
            largest = float(np.linalg.norm(shift, axis=1).max())
            spread = 0.0
            if sag.covariance is not None:
                spread, _ = largest_spread(request.task.path, sag, optimised.trajectory)
            done = Compensation(rounds=rounds, largest_shift=largest, last_change=change, deviation=spread)
            return optimised, done, problem
        if rounds == MOST_ROUNDS:
            break
        if request.deadline.expired():
            tried = f"{rounds} of at most {MOST_ROUNDS} rounds"
            raise OptimisationFailed(
                f"{request.deadline.over_in_words} after {tried} of the compensation of the sag",
                constraint="change of the shift",
                violation=change / settled - 1,
                limit=Limit.SHIFT,
                stopped=True,
            )
        shift = wanted
        task = replace(request.task, path=_shifted(request, times, shift))
        around = replace(narrower, task=task)
        problem = shifted_problem(around, guess, q[::_PER_SEGMENT])
        report = None if progress is None else partial(progress, rounds=rounds + 1)
        optimised = optimise(problem, report)
    raise OptimisationFailed(
        f"the compensation of the sag did not settle in {MOST_ROUNDS} rounds",
        constraint="change of the shift",
        violation=change / settled - 1,
        limit=Limit.SHIFT,
    )


def _bent_on_path(
    request: StrokeRequest, sag: Sag, q: FloatArray, goals: ToolPoses
) -> tuple[FloatArray, FloatArray]:
    """Postures (N, n) near `q` (N, n) whose bent tool is at `goals`, and minus the sag there (N, 3), m.

    Newton steps of least norm on the bent tool's point and the rigid arm's orientation, which is what the
    path prescribes of it.
    """
    task, metric = request.task, request.cell.postures.metric
    for _ in range(_STEPS):
        bent, at = sag.at(q), request.cell.postures.tool_at(q)
        error = task.errors(at.tool_point + bent.tool, at.tool_rotation, goals)
        if np.abs(error).max() < _ON_PATH:
            break
        J = task_jacobian(task, at, metric)
        J[:3] += metric.positions(bent.d_tool).transpose(1, 2, 0)
        q = q + metric.positions(least_norm_step(J, error.T)[0].T)
    return q, -bent.tool


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


def _shifted(request: StrokeRequest, times: FloatArray, shift: FloatArray) -> ShiftedToolPath:
    # Imported where needed: it takes a while to load, and few plans need it.
    from scipy.interpolate import CubicSpline

    return ShiftedToolPath.of(request.task.path, CubicSpline(times, shift))
