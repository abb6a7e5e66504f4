"""Planning a stroke: the agenda of its attempts, and what would do where none succeeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cmbot.planning.attempts.advice import EASED_BOUND, LESS_KEPT, SLOWER_LEGS, changed_in_words
from cmbot.planning.attempts.agenda import Remedy, Solved, Trial
from cmbot.planning.attempts.attempt import Attempt, agenda_of
from cmbot.planning.attempts.failure import Failure, NoWay, attempted, briefly
from cmbot.planning.attempts.motion import StrokeMotion, certified_motion, is_better, peak_of, with_way
from cmbot.planning.attempts.remedies import REMEDIES, WAYS
from cmbot.planning.budget import (
    ADVICE_RUNS,
    CANDIDATE_RUNS,
    LESS_KEPT_RUNS,
    RUNS,
    SHORTEST_TIME_RUNS,
    Budget,
)
from cmbot.planning.initial_guess import Aim, InitialGuess, guess_near, sliding_guess
from cmbot.planning.path.first_posture import starting_at_path
from cmbot.planning.progress import ProgressReporter
from cmbot.planning.request import StrokeRequest
from cmbot.planning.timing.timing import with_enough_via_points
from cmbot.scene import Stroke

# A motion sways more than another where it does so by this factor: less is worth no second search.
_MORE = 1.1


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedStroke:
    """How planning a stroke ended.

    Attributes
    ----------
    trial : Trial
        The best that was found, or the one whose failure is to be told.
    runs : int
        Of optimise-and-certify that it took.
    shortest : float or None
        Where it failed for too little time: the seconds of the stroke with ``seconds: auto``, s, if known.
    """

    trial: Trial[Attempt, StrokeMotion]
    runs: int
    shortest: float | None = None


def plan_stroke(request: StrokeRequest, *, stays: bool = False) -> PlannedStroke:
    """Plan a stroke and the free moves that go with it.

    Parameters
    ----------
    request : StrokeRequest
        With an earlier motion along the stroke it is planned near that: moved onto the path as it is now,
        else changed from there until it meets the constraints.
    stays : bool
        It starts where the arm is before, with sliding knots.
    """
    if request.stroke.begins_elsewhere:
        begun = attempted(request, lambda: starting_at_path(request))
        if not isinstance(begun, StrokeRequest):
            attempt = Attempt(request=request, guess=begun)
            return PlannedStroke(trial=Trial(attempt=attempt, outcome=begun), runs=0)
        request = begun
    if (earlier := request.earlier.get(str(request.stroke.name))) is not None:
        near = attempted(request, lambda: guess_near(request, earlier))
        guesses = [near]
        if isinstance(near, InitialGuess) and near.aim is Aim.KEPT:
            # Where what is kept is not certified it is changed until it meets the constraints.
            guesses.append(replace(near, aim=Aim.FEASIBLE))
        budget = Budget(runs=len(guesses))
        for guess in guesses:
            attempt = Attempt(request=request, guess=guess, is_first=False)
            trial = agenda_of(request, certified_motion, (), budget).search(attempt)
            if isinstance(trial.outcome, Solved):
                break
        return PlannedStroke(trial=trial, runs=budget.used)
    runs = SHORTEST_TIME_RUNS if request.task.path.open_legs else RUNS
    budget = Budget(runs=min(runs, request.most_runs))
    request = with_enough_via_points(request)
    first = Attempt.of(request)
    if stays and request.cell.options.knots == "sliding":
        first = replace(first, guess=attempted(request, lambda: sliding_guess(request, stay=True)))
    for start in dict.fromkeys((first.of_least_travel(), first)):
        quiet, parent = start, None
        if start.chooses_laws and not request.task.path.open_legs:
            # A path to whose start nothing leads is not worth optimising.
            reached = agenda_of(request, with_way, WAYS, Budget(runs=RUNS)).search(start)
            if isinstance(reached.outcome, NoWay):
                # A motion would seek the same ways.
                trial = Trial(attempt=reached.attempt, outcome=reached.outcome, parent=reached.parent)
                continue
            if isinstance(reached.outcome, Solved):
                quiet, parent = reached.result.quiet(), reached
        trial = searched_motion(quiet, budget, parent)
        if isinstance(trial.outcome, Solved) or budget.left == 0:
            break
    if quiet.timing is not None and _sways_more(trial) and budget.left > 0:
        trial = min(searched_motion(replace(start, plain=True), budget), trial, key=_sway)
    trial = _bounded(trial) if request.proves else trial
    trial = replace(trial, attempt=replace(trial.attempt, more_time=quiet.more_time))
    return PlannedStroke(trial=trial, runs=budget.used)


def in_given_time(refused: PlannedStroke, stroke: Stroke, shortest: PlannedStroke) -> PlannedStroke:
    """Return a stroke that was refused for too little time as its shortest motion, slowed, leads to it.

    Parameters
    ----------
    refused : PlannedStroke
    stroke : Stroke
        As it is asked for.
    shortest : PlannedStroke
        The stroke with ``seconds: auto``.
    """
    if not isinstance(shortest.trial.outcome, Solved):
        return refused
    seconds = shortest.trial.result.work.duration
    is_free = all(stroke.asked_speed(leg) is None for leg in range(len(stroke.path.segments)))
    if is_free and stroke.file.speed_profile.kind == "quiet":
        # Imported where needed, as below.
        from cmbot.planning.attempts.shortest_time import in_given_time as slowed

        if (trial := slowed(shortest.trial, refused.trial, stroke, certified_motion)) is not None:
            return PlannedStroke(trial=trial, runs=refused.runs + shortest.runs + 1)
    return replace(refused, shortest=min(seconds, refused.shortest or np.inf))


def _sway(trial: Trial[Attempt, StrokeMotion]) -> float:
    """Largest sway and swing of a motion together, m; infinite where there is none."""
    if not isinstance(trial.outcome, Solved):
        return np.inf
    optimised, cell = trial.result.optimised, trial.attempt.request.cell
    return sum(optimised.sway or cell.sway_of(optimised.trajectory))


def _sways_more(trial: Trial[Attempt, StrokeMotion]) -> bool:
    """Whether laws that were chosen lead to no motion, or to one that sways more than by the scene's own.

    On the joint path that it ends with: a remedy may have changed that from the one they were chosen along.
    """
    if not isinstance(trial.outcome, Solved):
        return True
    request = trial.attempt.request
    if request.most_runs <= CANDIDATE_RUNS:
        return False  # of one of many stances it is enough to know what a motion asks
    unshaped = trial.result.work.unshaped(request.stroke.file)
    return unshaped is not None and _sway(trial) > _MORE * sum(request.cell.sway_of(unshaped))


def searched_motion(
    first: Attempt, budget: Budget, parent: Trial[Attempt, Attempt] | None = None
) -> Trial[Attempt, StrokeMotion]:
    """Return the best motion that is found from an attempt on, or the failure that is to be told.

    `parent` is the trial that led to it.
    """
    if first.request.task.path.open_legs:
        # Imported where needed: SciPy's splines and linear programs take a while to load.
        from cmbot.planning.attempts.shortest_time import in_shortest_time

        return in_shortest_time(first, budget, certified_motion, LIGHTER_START)
    remedies, better = (*REMEDIES, LIGHTER_START), is_better(first.request)
    return agenda_of(first.request, certified_motion, remedies, budget, better).search(first, parent)


def _bounded(trial: Trial[Attempt, StrokeMotion]) -> Trial[Attempt, StrokeMotion]:
    """The trial with the lower bound of its own via-points; with that of others where charts fail."""
    if trial.attempt.timing is None or not isinstance(trial.outcome, Solved):
        return trial
    motion = trial.result
    is_bounded = motion.guess.search is not None and motion.request.cell.options.objective != "travel"
    if not is_bounded or (search := trial.attempt.search) is None:
        return trial
    guess = replace(motion.guess, lower_bound=search.lower_bound, search=search)
    return replace(trial, outcome=Solved(result=replace(motion, guess=guess)))


def advice(refused: Trial[Attempt, StrokeMotion]) -> str:
    """Return what would do in place of a stroke that was refused, in words; or what fails in more time.

    It is tried: first other times and bounds, then less that is kept of the tool's pose, each within a budget
    of its own. Where nothing does, the slowest motion says the most; empty where none was slower.
    """
    first, reporter = refused.chain[0].attempt, refused.attempt.request.reporter
    silent = replace(first.request, reporter=ProgressReporter())
    is_open, failed = bool(silent.task.path.open_legs), list[tuple[float, str]]()
    # Ever longer times were tried of legs whose time is sought.
    times = [] if is_open else [replace(SLOWER_LEGS, cost=10, most=3)]
    after = [] if is_open else [remedy.where(lambda trial: trial.parent is not None) for remedy in REMEDIES]
    for remedies, runs in (([*times, EASED_BOUND], ADVICE_RUNS), ([LESS_KEPT], LESS_KEPT_RUNS)):
        budget = Budget(runs=runs)

        def work(attempt: Attempt, budget: Budget = budget) -> Solved[StrokeMotion] | Failure:
            reporter.step(f"trying {changed_in_words(silent, attempt.request)}")
            made = searched_motion(attempt, budget).outcome if is_open else certified_motion(attempt)
            slower = attempt.request.task.path.duration / silent.task.path.duration
            if not isinstance(made, Solved) and slower > 1.0:
                why = briefly(made).partition(" (")[0]
                failed.append((slower, f"in {slower:.3g} times the time: {why}"))
            return made

        agenda = agenda_of(silent, work, [*remedies, *after], Budget(runs=1) if is_open else budget)
        found = agenda.search_from(Trial(attempt=replace(first, request=silent), outcome=refused.outcome))
        if isinstance(found.outcome, Solved):
            return f"{changed_in_words(silent, found.attempt.request)} would do"
    return max(failed, key=lambda each: each[0])[1] if failed else ""


def _lighter_start(trial: Trial[Attempt, StrokeMotion]) -> Iterator[Attempt]:
    """The motion from the scene's posture in place of one whose approach has a larger peak than that job.

    The peak over the whole job counts: a better start is none where the approach to it is worse.
    """
    attempt, guess, solved = trial.attempt, trial.attempt.guess, trial.outcome
    if not isinstance(solved, Solved) or not isinstance(guess, InitialGuess):
        return
    request, motion = attempt.request, solved.result
    pinned = None if guess.choice is None else guess.choice.pinned
    if motion.approach is None or pinned is None or guess.failures:
        return
    rest = peak_of(request, [segment for segment in motion.job.segments if segment is not motion.approach])
    off = request.cell.tool_off
    idle = off.objective.at_rest(off.postures.at(np.stack([request.state.posture, request.first])))
    # No job from the scene's posture has a smaller peak than at rest there, with the tool off or on.
    least = max(pinned, rest, float(idle.max()), request.state.reached)
    if motion.peak <= (1 + request.cell.options.min_gain) * least:
        return
    request.reporter.stage("path")
    request.reporter.step("the peak is on the approach; trying the scene's posture")
    if attempt.timing is not None and not attempt.timing.request.task.path.open_legs:
        # Laws were chosen for another joint path.
        attempt = replace(attempt, request=attempt.timing.request, timing=None)
    stays = attempted(request, lambda: sliding_guess(attempt.request, search=attempt.search, stay=True))
    if isinstance(stays, InitialGuess):
        yield replace(attempt, guess=stays, is_first=False).quiet()


def _tell_lighter(before: Trial[Attempt, StrokeMotion], after: Trial[Attempt, StrokeMotion]) -> str:
    unit = after.attempt.request.cell.objective.unit
    return (
        f"A start that is better at work is not used: the approach to it would have a peak of "
        f"{before.result.peak:.4g} {unit}, the whole job from the scene's posture "
        f"{after.result.peak:.4g} {unit}."
    )


LIGHTER_START = Remedy(cost=1000, propose=_lighter_start, tell=_tell_lighter)
