"""Sag compensation: the tool that is held to the path is the bent arm's.

Near a motion the sag is known to first order in the joints. With it Newton's method finds postures whose bent
tool is on the path from those of the guess, and the program of the motion has the bent tool as its task:
via-points slide along its self-motion, and between them it is its deviation that is bounded. Where the
solution is so far away that the sag is another one, it is linearized there, and the solution is the guess.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed
from cmbot.common.limit import Limit
from cmbot.common.reading.file_types import NonNegative
from cmbot.elastic.sag import Sag, TooSoftError
from cmbot.optimization import ExchangeReport, find_violations
from cmbot.planning.certification.sag_spread import largest_spread
from cmbot.planning.initial_guess import Aim, InitialGuess, fixed_guess, problem_near
from cmbot.planning.path.first_posture import starting_at_path
from cmbot.planning.request import StrokeRequest
from cmbot.planning.torque import Optimised, TorqueProblem, optimise
from cmbot.planning.workcell.bent_tool import BentTool
from cmbot.trajectory import QuinticTrajectory

# Newton steps from the guess; and linearizations at solutions at most, in the first of which via-points
# slide: after them they stay, so that what follows is near what is known.
_STEPS_FROM_GUESS, _LINEARIZATIONS, _SLIDING = 2, 8, 3
# The change of the sag, as a share of the tool deviation allowed, that ends them.
_SAG_CHANGE_SHARE = 0.04
# Share of the tool deviation that is left to the optimiser; the rest is for what the sag misses.
_OPTIMIZER_DEVIATION_SHARE = 0.95
# What the peak may exceed its least value by, as a share: that is known to first order.
_PEAK_TOLERANCE = 5e-4
# By how much the standard deviation may grow while the trajectory changes, and the least share of the tool
# deviation beside it.
_GROWS, _MIN_DEVIATION_SHARE = 1.05, 0.2
# Times per spline segment at which the sag is computed.
_TIMES_PER_SEGMENT = 4


@dataclass(frozen=True, kw_only=True)
class Compensation:
    """How the predicted sag was compensated.

    Attributes
    ----------
    largest_shift : float, m
        Of a commanded tool point from where the path has it.
    last_change : float, m
        By how much the sag along the motion differs from what it was taken for.
    deviation : float, m
        Largest standard deviation of the tool's place across its path, by that of an identified stiffness; 0
        where none is known.
    """

    largest_shift: NonNegative
    last_change: NonNegative
    deviation: NonNegative = 0.0


def optimise_bent(
    request: StrokeRequest,
    guess: InitialGuess,
    sag: Sag,
    progress: Callable[[ExchangeReport], None] | None = None,
) -> tuple[Optimised, Compensation, TorqueProblem]:
    """Optimise the motion of the bent arm, whose tool is the task.

    `progress` is called after every exchange iteration. Returns the trajectory and the problem whose
    solution it is.

    Raises
    ------
    PathNotFound
        When a via-point of the bent arm is out of reach.
    OptimisationFailed
        When there is no trajectory, the sag along it is not what it was taken for, or the arm topples.
    """
    try:
        bending = _Bending(request, guess, sag, progress)
        return bending.kept() if guess.aim is Aim.KEPT else bending.solved()
    except TooSoftError as error:
        raise OptimisationFailed(
            f"the arm on its base is too soft: {error.got} is on the way",
            constraint="change of the sag",
            violation=np.inf,
            limit=Limit.SHIFT,
        ) from error


def fixed_knots(request: StrokeRequest) -> FloatArray:
    """Return the via-points (k, n), rad, of a stroke whose knots are fixed, as it is planned from its state.

    Raises
    ------
    PathNotFound, OptimisationFailed
        As planning the stroke does.
    """
    request = starting_at_path(request) if request.stroke.begins_elsewhere else request
    guess, sag = fixed_guess(request), request.cell.sag
    if sag is None:
        return guess.problem.parametrization.via_points
    return optimise_bent(request, replace(guess, aim=Aim.KEPT), sag)[0].via_points


class _Bending:
    """The program of a bent arm's motion, its sag linearized along ever nearer ones."""

    def __init__(
        self,
        request: StrokeRequest,
        guess: InitialGuess,
        sag: Sag,
        progress: Callable[[ExchangeReport], None] | None,
    ) -> None:
        self._guess, self._sag, self._progress = guess, sag, progress
        near = guess.problem.parametrization.trajectory
        allowed = request.cell.options.max_tool_deviation_m - _uncertain(request, near, sag)
        self._request = request.with_options(max_tool_deviation_m=_OPTIMIZER_DEVIATION_SHARE * allowed)
        self._settled = _SAG_CHANGE_SHARE * allowed
        t = request.times
        self._times = np.append(
            np.linspace(t[:-1], t[1:], _TIMES_PER_SEGMENT, endpoint=False, axis=1).ravel(), t[-1]
        )
        self._passes: list[ExchangeReport] = []
        self._least = guess.lower_bound.value
        for _ in range(_STEPS_FROM_GUESS):
            self._bent = self._linearized(near)
            self._problem = self._placed(near.q, near=None if guess.aim is Aim.OPTIMUM else near)
            near = self._problem.parametrization.trajectory
            # What bending changes at rest in the postures of the guess it changes of the least value, too.
            shifted = guess.lower_bound.each + self._problem.at_via_points - guess.problem.at_via_points
            self._least = float(shifted.max()) * (1 + _PEAK_TOLERANCE)

    def kept(self) -> tuple[Optimised, Compensation, TorqueProblem]:
        """The motion of the guess, put onto the task: what of the sag it misses the certificate judges."""
        optimised = Optimised.start(self._problem)
        after, change = self._changed(optimised.trajectory)
        return optimised, self._done(optimised.trajectory, after.sag, change), self._problem

    def solved(self) -> tuple[Optimised, Compensation, TorqueProblem]:
        """Solve and linearize until the sag of the solution is what it was taken for."""
        optimised: Optimised | None = None
        feasible = self._guess.aim is Aim.FEASIBLE
        for number in range(_LINEARIZATIONS):
            corrected = None if optimised is None else self._corrected(optimised)
            optimised = corrected or optimise(self._problem, self._passed, feasible=feasible)
            near = optimised.trajectory
            after, change = self._changed(near)
            if change < self._settled:
                done = self._done(near, after.sag, change)
                return replace(optimised, passes=tuple(self._passes)), done, self._problem
            if self._request.deadline.expired():
                reason = f"{self._request.deadline.over_in_words} before the sag along the motion was settled"
                raise self._failure(reason, change, stopped=True)
            if optimised.passes:
                # The least peak hardly differs from one linearization to the next: it is sought once.
                self._least = max(self._least, optimised.passes[-1].peak_torque)
            self._bent = after
            self._problem = self._placed(near.q, near=near, stays=number >= _SLIDING)
        raise self._failure(f"the sag did not settle, linearized {_LINEARIZATIONS} times", change)

    def _corrected(self, optimised: Optimised) -> Optimised | None:
        """The solution put onto the task as it is linearized now, where that breaks no constraint."""
        form = self._problem.parametrization
        worst = find_violations(self._problem, form.trajectory, np.inf, 0.0, 1).worst
        if worst.value > self._request.cell.options.constraint_tolerance:
            return None
        return replace(optimised, trajectory=form.trajectory, via_points=form.via_points)

    def _changed(self, near: QuinticTrajectory) -> tuple[BentTool, float]:
        """The bent tool near a trajectory, and by how much its sag is not what it was taken for, m."""
        after = self._linearized(near)
        return after, float(np.linalg.norm(after.sag - self._bent.at(self._times, after.q).sag, axis=1).max())

    def _linearized(self, near: QuinticTrajectory) -> BentTool:
        """The bent tool near a trajectory."""
        q = near.evaluate(self._times)
        at = self._sag.at(q)
        postures = self._request.cell.postures
        return BentTool(postures=postures, times=self._times, q=q, sag=at.tool, slope=at.d_tool)

    def _placed(
        self, via_points: FloatArray, *, near: QuinticTrajectory | None = None, stays: bool = False
    ) -> TorqueProblem:
        """The program with via-points put onto the bent arm's task."""
        request = replace(self._request, bent=self._bent)
        return problem_near(request, self._guess, via_points, least=self._least, near=near, stays=stays)

    def _passed(self, report: ExchangeReport) -> None:
        """Count exchange iterations through."""
        self._passes.append(replace(report, number=len(self._passes) + 1))
        if self._progress is not None:
            self._progress(self._passes[-1])

    def _done(self, trajectory: QuinticTrajectory, sag: FloatArray, change: float) -> Compensation:
        spread = 0.0
        if self._sag.covariance is not None:
            spread, _ = largest_spread(self._request.task.path, self._sag, trajectory)
        largest = float(np.linalg.norm(sag, axis=1).max())
        return Compensation(largest_shift=largest, last_change=change, deviation=spread)

    def _failure(self, reason: str, change: float, *, stopped: bool = False) -> OptimisationFailed:
        return OptimisationFailed(
            reason,
            constraint="change of the sag",
            violation=change / self._settled - 1,
            limit=Limit.SHIFT,
            stopped=stopped,
        )


def _uncertain(request: StrokeRequest, near: QuinticTrajectory, sag: Sag) -> float:
    """What of the allowed deviation is for the errors of an identified stiffness, m."""
    sigmas, allowed = request.cell.options.deviation_sigmas, request.cell.options.max_tool_deviation_m
    if sag.covariance is None or not sigmas:
        return 0.0
    spread, _ = largest_spread(request.task.path, sag, near)
    uncertain = _GROWS * sigmas * spread
    if uncertain > (1 - _MIN_DEVIATION_SHARE) * allowed:
        raise OptimisationFailed(
            f"the stiffness is known too little: {sigmas:g} standard deviations of the tool's place across "
            f"its path are {1e3 * sigmas * spread:.2f} mm, of {1e3 * allowed:g} mm that are allowed",
            constraint="tool deviation within standard deviations of the stiffness",
            violation=uncertain / allowed - 1,
            limit=Limit.TOOL_DEVIATION,
        )
    return uncertain
