"""Legs with ``seconds: auto``: planned slowly, timed along the joint path found, planned again in that time.

A motion in the shortest time of its own joint path is planned by the same steps as any other, with its laws
as the scene's: the same splines, the same certificate. Where no such motion is certified the laws are
stretched.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cmbot.common.arrays import BoolArray
from cmbot.common.limit import Limit
from cmbot.planning.attempts.advice import SLOWER_LEGS, slower_legs
from cmbot.planning.attempts.agenda import Remedy, Solved, Trial
from cmbot.planning.attempts.attempt import Attempt, agenda_of
from cmbot.planning.attempts.failure import Failure, NoWay, Uncertified, attempted, briefly, strays
from cmbot.planning.attempts.motion import StrokeMotion, is_better
from cmbot.planning.attempts.remedies import REMEDIES
from cmbot.planning.budget import Budget
from cmbot.planning.initial_guess import InitialGuess
from cmbot.planning.timing.leg_paths import RoughLaw, leg_paths, rough_laws, shortest_laws_of
from cmbot.planning.timing.quiet_laws import shortest_quiet_law
from cmbot.planning.timing.timing import Timing
from cmbot.planning.torque import Optimised, optimise
from cmbot.scene import Stroke
from cmbot.trajectory import QuinticTrajectory

# Factors by which laws are stretched while no motion is certified.
_STRETCHED = (1.01, 1.03, 1.06, 1.1, 1.2, 1.4, 2.0)
# Those of laws along the path that was planned last.
_FASTER = (1.0, 1.01, 1.06, 1.2)
# So many times its bounds the tool may be off its path between via-points of a slow motion.
_LOOSE_TOOL = 10.0
# Rounds of laws along the path that was planned last, and what is worth another one, as a share of the time.
_MAX_LAW_ROUNDS, _WORTHWHILE_TIME_SHARE = 8, 0.99

Work = Callable[[Attempt], Solved[StrokeMotion] | Failure]


def in_shortest_time(
    first: Attempt, budget: Budget, work: Work, better: Remedy[Attempt, StrokeMotion]
) -> Trial[Attempt, StrokeMotion]:
    """Plan a stroke in the shortest time that is found.

    Parameters
    ----------
    first : Attempt
        Some legs of its path are open.
    budget : Budget
        Of the slow motion and all others.
    work : callable
        From an attempt to its certified motion.
    better : Remedy
        What else is tried after a success.

    Returns
    -------
    Trial
        Failed where no motion is found, however slow.
    """
    half = Budget(runs=budget.left // 2)
    slow = agenda_of(first.request, _slow_motion, (*REMEDIES, SLOWER_LEGS), half).search(first)
    budget.used += half.used
    if not isinstance(slow.outcome, Solved):
        return Trial(attempt=slow.attempt, outcome=slow.outcome, parent=slow.parent, remedy=slow.remedy)
    attempt, trajectory = slow.attempt, slow.outcome.result.trajectory
    rough = _roughly_timed(attempt, trajectory)
    timed = attempt.in_timing(_timing(attempt, trajectory, rough)) if isinstance(rough, tuple) else rough
    if not isinstance(timed, Attempt):
        return Trial(attempt=attempt, outcome=timed, parent=slow)
    remedies = (*REMEDIES, STRETCHED_LAWS, FEWER_STRETCHED_LEGS, FASTER_ROUND, better)
    agenda = agenda_of(first.request, work, remedies, budget, is_better(first.request))
    return agenda.search(replace(timed, is_first=False), slow)


def in_given_time(
    fast: Trial[Attempt, StrokeMotion], refused: Trial[Attempt, StrokeMotion], stroke: Stroke, work: Work
) -> Trial[Attempt, StrokeMotion] | None:
    """Plan a stroke by the laws of its shortest time, slowed to the seconds that are asked for.

    Parameters
    ----------
    fast : Trial
        The stroke in its shortest time.
    refused : Trial
        The stroke as it is asked for.
    stroke : Stroke
        As it is asked for.
    work : callable
        From an attempt to its certified motion.

    Returns
    -------
    Trial or None
        None where a leg takes longer than asked for even so, or no motion follows.
    """
    request, motion = fast.attempt.request, fast.result.work.trajectory
    known = request.stroke.file.time_laws or ()
    factors = [stroke.path.segments[law.leg].seconds / law.duration for law in known]
    if not factors or min(factors) < 1.0:
        return None
    own = replace(request.stroke, file=stroke.file.changed(via_points=len(request.times)))
    strokes = (*request.strokes[: request.number], own, *request.strokes[request.number + 1 :])
    request = replace(request, strokes=strokes)
    laws = tuple(law.slowed(factor) for law, factor in zip(known, factors, strict=True))
    attempt = fast.attempt.in_timing(Timing.along(request, motion, (), laws))
    if not isinstance(attempt, Attempt) or not isinstance(outcome := work(attempt), Solved):
        return None
    return Trial(attempt=attempt, outcome=outcome, remedy=SLOWED_LAWS, parent=refused)


def _tell_slowed(before: Trial[Attempt, Any], after: Trial[Attempt, Any]) -> str:
    return (
        f"By the speed profile no motion was found ({briefly(before.failure)}): the tool has the law of the "
        "shortest time, slowed to the seconds that are given."
    )


SLOWED_LAWS = Remedy(cost=0, propose=lambda trial: iter(()), tell=_tell_slowed)


def _slow_motion(attempt: Attempt) -> Solved[Optimised] | Failure:
    """A motion whose limits hardly matter: its via-points are where the objective is least.

    What holds the tool between them is loose: it makes steps short, and the joint path is put onto the task.
    How far the tool is off where even so no motion is found is told by the bounds that are asked for.
    """
    request, guess = attempt.request, attempt.guess
    if not isinstance(guess, InitialGuess):
        return guess
    loose = guess.asked(replace(request, tool_share=_LOOSE_TOOL)).problem
    found = attempted(request, lambda: Solved(result=optimise(loose)))
    return attempted(request, lambda: Solved(result=optimise(guess.problem))) if strays(found) else found


def _roughly_timed(before: Attempt, trajectory: QuinticTrajectory) -> tuple[RoughLaw, ...] | Failure:
    """Laws of few phases along the joint path of a motion."""
    request = before.request
    request.reporter.stage("path")
    request.reporter.step("seeking the shortest time within the limits")
    legs = sorted(request.task.path.open_legs) or [law.leg for law in request.stroke.file.time_laws or ()]
    return attempted(request, lambda: rough_laws(request, leg_paths(request, legs, trajectory)))


def _timing(before: Attempt, trajectory: QuinticTrajectory, rough: Sequence[RoughLaw]) -> Timing:
    """The shortest time along the joint path of a motion, by laws sought from rough ones."""
    request = before.request
    shortest = shortest_laws_of(rough, request.stroke.file.time_laws or ())
    timing = Timing.along(request, trajectory, [law.path for law in rough], shortest)
    timing = replace(timing, rough=_seconds(rough))
    if request.cell.arm is None:
        return timing
    pairs = zip(rough, shortest, strict=True)
    quiet = tuple(shortest_quiet_law(request, each.path, each.search.bounded, law) for each, law in pairs)
    laws = quiet if request.stroke.file.speed_profile.kind == "quiet" else shortest
    short, long = (sum(law.duration for law in each) for each in (shortest, quiet))
    return replace(timing, laws=laws, both=(short, long))


def _seconds(rough: Sequence[RoughLaw]) -> float:
    return sum(law.seconds for law in rough)


def _stretched_laws(trial: Trial[Attempt, Any]) -> Iterator[Attempt]:
    """Where no motion is certified in a time: a longer one."""
    timing, failure = trial.attempt.timing, trial.outcome
    if timing is None or isinstance(failure, Solved | NoWay):
        # No free move is found by another time.
        return
    least = timing.factors.max()
    if isinstance(failure, Uncertified) and failure.error.limit is Limit.SWAY:
        # The sway falls with the square of the time.
        least *= np.sqrt(failure.error.value / failure.error.bound)
    longer = [factor for factor in _STRETCHED if factor > least]
    if longer and (timing.factors == timing.factors[0]).all():
        at_fault = timing.at_fault | _at_fault(trial.attempt, timing, failure)
        factors = np.full(len(timing.laws), longer[0])
        yield from _stretched(trial, timing.stretched(factors, at_fault, briefly(failure)))


def _fewer_stretched_legs(trial: Trial[Attempt, Any]) -> Iterator[Attempt]:
    """Where motions before failed on some legs alone: only these are stretched."""
    timing = trial.attempt.timing
    if timing is None or not isinstance(trial.outcome, Solved) or timing.at_fault.all():
        return
    if timing.at_fault.any() and (timing.factors > 1.0).all():
        fewer = replace(timing, factors=np.where(timing.at_fault, timing.factors, 1.0))
        before, after = (each.timed.task.path.duration for each in (timing, fewer))
        if after <= _WORTHWHILE_TIME_SHARE * before:
            yield from _stretched(trial, fewer)


def _stretched(trial: Trial[Attempt, Any], timing: Timing) -> Iterator[Attempt]:
    # In any time what is optimised has to be as much nearer than what is certified.
    request = replace(timing.request, tool_share=trial.attempt.request.tool_share)
    attempt = trial.attempt.in_timing(replace(timing, request=request))
    if isinstance(attempt, Attempt):
        yield replace(attempt, is_first=False)


def _faster_round(trial: Trial[Attempt, StrokeMotion]) -> Iterator[Attempt]:
    """Along the path that was planned last, laws that are shorter still, if rough ones are."""
    timing, solved = trial.attempt.timing, trial.outcome
    if timing is None or not isinstance(solved, Solved):
        return
    known = sum(law.duration for law in trial.attempt.request.stroke.file.time_laws or ())
    trajectory = solved.result.work.trajectory
    rough = _roughly_timed(trial.attempt, trajectory)
    # Rough laws cost little, and tell by which share others are shorter.
    if not isinstance(rough, tuple) or _seconds(rough) / timing.rough > known / timing.seconds:
        return
    shorter = _timing(trial.attempt, trajectory, rough)
    # A little longer than the shortest is shorter than before; where that was needed, it is again.
    for factor in _FASTER[int((timing.factors > 1.0).any()) :]:
        if factor * shorter.seconds <= _WORTHWHILE_TIME_SHARE * known:
            yield from _stretched(trial, replace(shorter, factors=np.full(len(shorter.laws), factor)))


def _at_fault(attempt: Attempt, timing: Timing, failure: Failure) -> BoolArray:
    """The legs (L,) on which an attempt failed: all of them, where that is not known."""
    legs = np.array([law.leg for law in timing.laws])
    if isinstance(failure, Uncertified) and failure.error.limit is Limit.SWAY:
        return np.ones(len(legs), dtype=np.bool_)
    factors = slower_legs(attempt.request, failure)
    if factors is not None:
        return np.asarray(factors[legs] > 1.0)
    if isinstance(failure, Uncertified):
        ends = attempt.request.task.path.leg_times
        return np.asarray((ends[legs] <= failure.error.time) & (failure.error.time <= ends[legs + 1]))
    return np.ones(len(legs), dtype=np.bool_)


def _tell(before: Trial[Attempt, Any], after: Trial[Attempt, Any]) -> str:
    timing = after.attempt.timing
    if timing is None:
        return ""
    slower = timing.factors > 1.0
    legs = "" if slower.all() else f" on {slower.sum()} of {len(slower)} legs"
    return (
        f"In {timing.seconds:.4g} s, the shortest time along the joint path, no motion is certified "
        f"({timing.reason}): planned {100 * (timing.factors.max() - 1):.0f} % slower{legs}."
    )


STRETCHED_LAWS = Remedy(cost=10, propose=_stretched_laws, tell=_tell, topic="stretched", most=len(_STRETCHED))
FEWER_STRETCHED_LEGS = Remedy(
    cost=20, propose=_fewer_stretched_legs, tell=_tell, topic="stretched", most=_MAX_LAW_ROUNDS
)
FASTER_ROUND = Remedy(cost=30, propose=_faster_round, most=_MAX_LAW_ROUNDS - 1)
