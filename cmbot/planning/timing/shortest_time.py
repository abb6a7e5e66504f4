"""Legs with ``seconds: auto``: planned slowly, timed along the joint path found, planned again in that time.

A motion in the shortest time of its own joint path is planned by the same steps as any other, with its laws
as the scene's: the same splines, the same certificate. Where no such motion is certified the laws are
stretched.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import LimitViolation, PlanningError
from cmbot.planning.context import PlanningContext
from cmbot.planning.failures import slower, slower_legs
from cmbot.planning.initial_guess import InitialGuess, initial_guess, shifted_problem
from cmbot.planning.retries import Attempt, with_retries
from cmbot.planning.timing.leg_paths import LegPath, leg_paths, shortest_laws
from cmbot.planning.torque import optimise
from cmbot.scene import LegLaw
from cmbot.trajectory import QuinticTrajectory

__all__ = ["in_shortest_time", "in_time"]

# Attempts at a first, slow motion.
_FIRST_TRIALS = 3
# Factors by which laws are stretched while no motion is certified; after the first success only the first few
# are tried for a shorter one.
_STRETCHED, _FEW = (1.0, 1.01, 1.03, 1.06, 1.1, 1.2, 1.4, 2.0), 2
# Rounds of laws along the path that was planned last, and what is worth another one, as a share of the time.
_ROUNDS, _WORTH = 3, 0.99
# How many times as long as the round before has to be left for it.
_TIMES_AS_LONG = 1.2

Work = TypeVar("Work")


def in_shortest_time(
    context: PlanningContext,
    work: Callable[[Attempt], Work],
    trajectory_of: Callable[[Work], QuinticTrajectory],
    *,
    automatic: bool,
) -> tuple[Attempt, Work]:
    """Plan a stroke in the shortest time that is found.

    Parameters
    ----------
    context : PlanningContext
        Some legs of its path are open.
    work : callable
        From an attempt to its certified motion.
    trajectory_of : callable
        The stroke's, of such a motion.
    automatic : bool
        The solver was chosen by ``auto``.

    Raises
    ------
    PlanningError
        When no motion is found, however slow.
    """
    legs = sorted(context.task.path.open_legs)
    before, trajectory = _slow_motion(context, automatic=automatic)
    made: tuple[Attempt, Work] | None = None
    for _ in range(_ROUNDS):
        left = context.reporter.time_left
        context.reporter.stage("path")
        context.reporter.step("seeking the shortest time within the limits")
        paths = leg_paths(before.context, legs, trajectory)
        laws = tuple(shortest_laws(before.context, paths))
        known = () if made is None else made[0].context.stroke.file.time_laws or ()
        if known and _seconds(laws) > _WORTH * _seconds(known):
            break
        try:
            made = _certified(before, trajectory, paths, laws, work, _STRETCHED[: _FEW if made else None])
        except PlanningError:
            if made is None:
                raise
            break
        before, trajectory = made[0], trajectory_of(made[1])
        took = left - context.reporter.time_left
        if context.reporter.time_left < _TIMES_AS_LONG * took:
            break
    if made is None:
        raise RuntimeError("no round was begun")
    return made


def in_time(context: PlanningContext, laws: Sequence[LegLaw]) -> PlanningContext:
    """Return the context of a stroke whose open legs have these laws."""
    path = context.task.path.timed(laws)
    file = context.stroke.file.changed(time_laws=tuple(laws))
    stroke = replace(context.stroke, path=path, file=file)
    strokes = (*context.strokes[: context.number], stroke, *context.strokes[context.number + 1 :])
    times = path.via_times(len(context.times))
    return replace(context, task=replace(context.task, path=path), strokes=strokes, times=times)


def _slow_motion(context: PlanningContext, *, automatic: bool) -> tuple[Attempt, QuinticTrajectory]:
    """A motion whose limits hardly matter: its via-points are where the objective is least."""
    for trial in range(_FIRST_TRIALS):
        try:
            first = Attempt(context=context, guess=initial_guess(context), automatic=automatic)
            attempt, optimised = with_retries(first, lambda attempt: optimise(attempt.guess.problem))
        except PlanningError as failure:
            factors = slower_legs(context, failure)
            if factors is None or trial == _FIRST_TRIALS - 1 or context.reporter.expired():
                raise
            context = slower(context, factors)
        else:
            return attempt, optimised.trajectory
    raise RuntimeError("no trial was made")


def _certified(
    before: Attempt,
    trajectory: QuinticTrajectory,
    paths: Sequence[LegPath],
    laws: Sequence[LegLaw],
    work: Callable[[Attempt], Work],
    stretched: Sequence[float],
) -> tuple[Attempt, Work]:
    """The first certified motion in ever longer times; with all retries in the last of them.

    Where the motions before failed on some legs alone, only these are stretched, if that is certified, too.
    """
    tried = _Tried(before, trajectory, paths, laws)
    for factor in stretched:
        try:
            attempt = tried.attempt(np.full(len(laws), factor))
            is_last = factor == stretched[-1] and len(stretched) == len(_STRETCHED)
            made = with_retries(attempt, work) if is_last else (attempt, work(attempt))
        except PlanningError as failure:
            tried.failed(failure)
            if factor == stretched[-1] or before.context.reporter.expired():
                raise
            continue
        if tried.at_fault.all() or not tried.at_fault.any() or before.context.reporter.expired():
            return made
        try:
            attempt = tried.attempt(np.where(tried.at_fault, factor, 1.0))
            return attempt, work(attempt)
        except PlanningError:
            return made
    raise RuntimeError("no time was tried")


class _Tried:
    """Attempts to follow joint paths by laws, and the legs on which they failed."""

    def __init__(
        self,
        before: Attempt,
        trajectory: QuinticTrajectory,
        paths: Sequence[LegPath],
        laws: Sequence[LegLaw],
    ) -> None:
        self._before, self._trajectory, self._paths, self._laws = before, trajectory, paths, laws
        self._guess: InitialGuess | None = None
        self._context = before.context
        self._reason = ""
        self.at_fault = np.zeros(len(laws), dtype=np.bool_)

    def attempt(self, factors: FloatArray) -> Attempt:
        """The attempt in which each leg takes so many times as long as by its law."""
        before, pairs = self._before, zip(self._laws, factors, strict=True)
        context = self._context = in_time(before.context, [law.slowed(float(by)) for law, by in pairs])
        if self._guess is None:
            guess = initial_guess(context)
            self._guess = replace(guess, pinned=before.guess.pinned, failures=before.guess.failures)
        via_points = _via_points(before.context, self._trajectory, self._paths, context)
        problem = shifted_problem(context, self._guess, via_points)
        attempt = replace(before, context=context, guess=replace(self._guess, problem=problem))
        if not self._reason:
            return attempt
        slower = factors > 1.0
        legs = "" if slower.all() else f" on {slower.sum()} of {len(factors)} legs"
        more = (
            f"In {_seconds(self._laws):.4g} s, the shortest time along the joint path, no motion is "
            f"certified ({self._reason}): planned {100 * (factors.max() - 1):.0f} % slower{legs}."
        )
        return replace(attempt, fallbacks=(*attempt.fallbacks, more))

    def failed(self, failure: PlanningError) -> None:
        """Note the legs on which the last attempt failed: all of them, where that is not known."""
        self._reason = self._reason or str(failure).partition(";")[0]
        legs = np.array([law.leg for law in self._laws])
        factors = slower_legs(self._context, failure)
        if factors is not None:
            self.at_fault |= factors[legs] > 1.0
        elif isinstance(failure, LimitViolation):
            ends = self._context.task.path.leg_times
            self.at_fault |= (ends[legs] <= failure.time) & (failure.time <= ends[legs + 1])
        else:
            self.at_fault[:] = True


def _via_points(
    before: PlanningContext,
    trajectory: QuinticTrajectory,
    paths: Sequence[LegPath],
    context: PlanningContext,
) -> FloatArray:
    """Postures (k, n) of a joint path at the via-points of a context in another time."""
    leg, share = context.task.path.leg_shares(context.times)
    old = np.empty(len(leg))
    for k in np.unique(leg):
        old[leg == k] = before.task.path.times_at(int(k), share[leg == k])
    q = trajectory.evaluate(old)
    for path in paths:
        q[leg == path.leg] = path.q(share[leg == path.leg])
    # The arm starts where it did.
    q[0] = trajectory.q[0]
    return q


def _seconds(laws: Sequence[LegLaw]) -> float:
    return sum(law.duration for law in laws)
