"""Remedies: what is tried where no certified motion is found.

Where the certificate misses a bound by little that is mended at once: more clearance to spare, finer samples.
All other remedies cost about the same, so that each of them is tried alone before two are tried together.

Blends at corners are no remedy: the tool rests at every corner (`ToolPath.leg_times`), so a corner is no
harder for the joints than any other end of a leg. Jumps of acceleration need much jerk, as at the ends of
trapezoidal ramps; ``tool_path.speed_profile.kind: jerk_limited`` has none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from cmbot.common.errors import LimitViolation
from cmbot.planning.attempts.agenda import Remedy, Solved, Trial
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.attempts.failure import (
    JointRate,
    NearObstacle,
    NoTrajectory,
    NoWay,
    ToolOff,
    Uncertified,
    attempted,
    briefly,
    in_words,
    strays,
)
from cmbot.planning.free_motion.approach import joined_starts, reachable
from cmbot.planning.initial_guess import (
    SMOOTHER,
    InitialGuess,
    guess_along,
    initial_guess,
    leap,
    roughness,
    searched,
    sliding_guess,
    solved,
)
from cmbot.scene import MOST_SAMPLES

AnyTrial = Trial[Attempt, Any]

# Halvings of the steps, and guesses of a remedy that are optimised, at most.
_MAX_STEP_HALVINGS, _MAX_OPTIMISED_GUESSES = 4, 2
# Starts to which a free move leads that are tried at most.
_MAX_JOINED_STARTS = 3
# What the certificate may miss a bound by for more samples to help, as a share of it.
_NARROW_MISS_SHARE = 0.01
# The certificate may find so much less clearance than the safety margin, m, for spare clearance to help, of
# which there is what is missing and so much more.
_LITTLE_NEARER, _SPARE = 1e-3, 1.5e-4
# The certificate may find the tool so many times as far off as it may be for a smaller bound to help, and how
# much smaller that is than in proportion.
_NEARLY_ON, _NEARER_TOOL_FACTOR = 2.0, 0.98
# Least and largest factor by which there are more via-points, and how many at most: all takes longer in
# proportion.
_FINER, _MOST_VIA_POINTS = (2, 4), 300
# Where a bound is missed by less than this share there are a quarter more, up to so many.
_MISSED, _MORE_VIA_POINTS_FACTOR, _MOST_OF_THEM = 0.05, 1.25, 1200
# Shares of the via-points that are left where fewer are tried, and how few there may be in a leg.
_COARSER, _FEWEST_IN_A_LEG = (0.7, 0.5), 4
# Factors on the safety margin that guesses keep where trajectories cannot keep it.
_MARGIN_FACTORS = (1.02, 1.1)


def is_little_nearer(failure: object) -> bool:
    """Whether a certificate misses the safety margin by so little that spare clearance may make up for it."""
    match failure:
        case Uncertified(broken=NearObstacle(distance=distance, margin=margin)):
            return 0 < margin - distance < _LITTLE_NEARER
    return False


def _spare_clearance(trial: AnyTrial) -> Iterator[Attempt]:
    """What is missing of the safety margin, and a little more, to spare in what is optimised."""
    attempt = trial.attempt
    match trial.outcome, attempt.guess:
        case Uncertified(error=LimitViolation(bound=bound, value=value)) as failure, InitialGuess() as guess:
            if not is_little_nearer(failure):
                return
            spare = attempt.request.spare_clearance + bound - value + _SPARE
            request = replace(attempt.request, spare_clearance=spare)
            missing = f"{1e3 * (bound - value):.2g} mm of clearance are missing"
            request.reporter.stage("path")
            request.reporter.step(f"{missing}; planning with more of it")
            yield from _changed(attempt, guess.asked(request), request=request)


def _tell_spare(before: AnyTrial, after: AnyTrial) -> str:
    failure, spare = before.failure, after.attempt.request.spare_clearance
    missing = failure.error.bound - failure.error.value if isinstance(failure, Uncertified) else 0.0
    return (
        f"The safety margin was missed by {1e3 * missing:.2g} mm ({in_words(failure)}): planned with "
        f"{1e3 * spare:.2g} mm more than it instead."
    )


def _nearer_tool(trial: AnyTrial) -> Iterator[Attempt]:
    """Smaller bounds on the tool in what is optimised, where what encloses it for all times exceeds them."""
    attempt = trial.attempt
    match trial.outcome, attempt.guess:
        case Uncertified(broken=ToolOff(ratio=ratio)) as failure, InitialGuess() as guess if (
            1.0 < ratio < _NEARLY_ON
        ):
            share = attempt.request.tool_share * _NEARER_TOOL_FACTOR / ratio
            request = replace(attempt.request, tool_share=share)
            request.reporter.stage("path")
            request.reporter.step(f"the tool is off by {ratio:.3g} times its bound; planning nearer")
            last = failure.trajectory
            # Where it ended is a little off what is asked now.
            near = None if last is None else attempted(request, partial(guess_along, request, guess, last))
            nearer = near if isinstance(near, InitialGuess) else guess.asked(request)
            yield from _changed(attempt, nearer, request=request)


def _tell_nearer(before: AnyTrial, after: AnyTrial) -> str:
    share = after.attempt.request.tool_share
    return f"A bound was missed ({in_words(before.failure)}): planned within {share:.0%} of it instead."


def _finer_samples(trial: AnyTrial) -> Iterator[Attempt]:
    """Twice the samples where the certificate misses a bound that sampled constraints overlooked."""
    attempt, options = trial.attempt, trial.attempt.request.cell.options
    match trial.outcome:
        case Uncertified(excess=excess) if excess <= _NARROW_MISS_SHARE:
            samples = 2 * options.samples_per_segment
            if samples <= MOST_SAMPLES:
                finer = attempt.request.with_options(samples_per_segment=samples)
                yield from _anew(attempt, request=finer)


def _changed(attempt: Attempt, guess: object, **changes: Any) -> Iterator[Attempt]:
    """The attempt from another guess, if there is one."""
    if isinstance(guess, InitialGuess):
        yield replace(attempt, guess=guess, is_first=False, **changes)


def _anew(attempt: Attempt, *, searches: bool = False, **changes: Any) -> Iterator[Attempt]:
    """The attempt from the first guess of a changed request, if there is one; charts are kept, or not.

    An attempt that starts in the scene's posture, perhaps as nothing leads elsewhere, still does.
    """
    request, search, stay = changes["request"], None if searches else attempt.search, attempt.is_pinned
    request.reporter.stage("path")
    guess = attempted(request, partial(initial_guess, request, search, stay=stay))
    if stay and isinstance(guess, InitialGuess) and isinstance(attempt.guess, InitialGuess):
        before = attempt.guess
        guess = replace(guess, unreached=before.unreached, failures=guess.failures or before.failures)
    yield from _changed(attempt, guess, **changes)


def _shorter_steps(trial: AnyTrial) -> Iterator[Attempt]:
    """Guesses in ever shorter steps between via-points, each smoother than the one before.

    The global search bounds the steps between via-points by the joints' velocities alone. They may turn round
    from one via-point to the next faster than accelerations and jerks allow; the shorter, the less. The peak
    at rest may be higher. Where no path leads on from the scene's posture in shorter steps, they start
    elsewhere; see `sliding_guess`. With fixed knots there are none.
    """
    request, guess = trial.attempt.request, trial.attempt.guess
    if not isinstance(trial.outcome, NoTrajectory) or not isinstance(guess, InitialGuess):
        return
    if (search := trial.attempt.search) is None:
        return
    rough, tries = roughness(guess.problem), 0
    for _ in range(_MAX_STEP_HALVINGS):
        if tries == _MAX_OPTIMISED_GUESSES or request.deadline.expired():
            return
        search = search.halved()
        request.reporter.step(f"no trajectory follows that guess; trying step_share {search.step_share:.3g}")
        shorter = attempted(request, partial(sliding_guess, request, guess.unreached, search))
        if not isinstance(shorter, InitialGuess):
            return
        if roughness(shorter.problem) <= SMOOTHER * rough:
            rough, tries = roughness(shorter.problem), tries + 1
            yield from _changed(trial.attempt, shorter)


def _tell_shorter(before: AnyTrial, after: AnyTrial) -> str:
    search, share = after.attempt.search, before.attempt.request.cell.options.step_share
    return (
        f"With planner.step_share {share:g} no trajectory was found ({in_words(before.failure)}): planned "
        f"with {search.step_share if search else share:.3g} instead, a smoother sequence of postures."
    )


def _clearer_guess(trial: AnyTrial) -> Iterator[Attempt]:
    """Where a clearance cannot be kept: a guess that keeps a little more of it.

    Postures of least torque may lie at the safety margin itself, where splines have no room to either side.
    """
    attempt = trial.attempt
    request, margin = attempt.request, attempt.request.cell.options.safety_margin_m
    match trial.outcome, attempt.guess:
        case NoTrajectory(broken=NearObstacle()), InitialGuess(unreached=unreached):
            if (search := attempt.search) is None:
                return
            for factor in _MARGIN_FACTORS:
                away = f"{1e3 * factor * margin:.3g} mm away"
                request.reporter.stage("path")
                request.reporter.step(f"no trajectory keeps clear; trying postures {away}")
                wider = request.with_options(safety_margin_m=factor * margin)
                found = attempted(request, partial(searched, wider, search))
                if isinstance(found, tuple):
                    guess = attempted(request, partial(sliding_guess, request, unreached, found[0]))
                    yield from _changed(attempt, guess, kept=factor)


def _tell_clearer(before: AnyTrial, after: AnyTrial) -> str:
    return (
        f"From postures at the safety margin no trajectory keeps clear ({in_words(before.failure)}): planned "
        f"from such that keep {100 * (after.attempt.kept - 1):.0f} % more."
    )


def _more_via_points(trial: AnyTrial) -> Iterator[Attempt]:
    """Where the tool strays from its path between via-points: more of them, which hold it more often.

    Splines miss a smooth path by the square of their segments' length or less, so a deviation of r times its
    bound needs sqrt(r) times the segments; twice as many are tried first, as where the arm collides between
    via-points. They help no guess that leaps.
    """
    request, guess = trial.attempt.request, trial.attempt.guess
    count = len(request.times) - 1

    def leaps() -> bool:
        return isinstance(guess, InitialGuess) and leap(request, guess.problem.parametrization.via_points) > 0

    match trial.outcome:
        case NoTrajectory(broken=ToolOff(ratio=ratio)) | Uncertified(broken=ToolOff(ratio=ratio)):
            if ratio <= 1.0 or leaps():
                return
            if ratio <= 1.0 + _MISSED and _MORE_VIA_POINTS_FACTOR * count < _MOST_OF_THEM:
                number = int(np.ceil(_MORE_VIA_POINTS_FACTOR * count)) + 1
                yield from _with_via_points(trial, number, "the tool strays a little")
            most = int(np.clip(np.ceil(np.sqrt(ratio)), *_FINER))
            for factor in sorted({_FINER[0], most}):
                number = factor * count + 1
                if number <= _MOST_VIA_POINTS:
                    yield from _with_via_points(trial, number, "the tool strays between via-points")
        case NoTrajectory(broken=NearObstacle(distance=distance)) if distance < 0 and not leaps():
            if (number := _FINER[0] * count + 1) <= _MOST_VIA_POINTS:
                yield from _with_via_points(trial, number, "the arm collides between via-points")


def _fewer_via_points(trial: AnyTrial) -> Iterator[Attempt]:
    """Where accelerations or jerks cannot be kept: fewer via-points, between which the tool has some room.

    The tool is on its path at every via-point, in time; between them only the bounds on its deviation and lag
    count. The denser they are, the more exactly splines follow the speed profile, whose acceleration jumps.
    """
    request = trial.attempt.request
    count, legs = len(request.times), len(request.task.path.seconds)
    match trial.outcome:
        case NoTrajectory(broken=JointRate(order=order)) if order != 1:
            for share in _COARSER:
                number = max(round(share * (count - 1)), _FEWEST_IN_A_LEG * legs) + 1
                if number < count:
                    yield from _with_via_points(trial, number, "no trajectory keeps the rates")


def _with_via_points(trial: AnyTrial, number: int, why: str) -> Iterator[Attempt]:
    request = trial.attempt.request
    request.reporter.step(f"{why}; trying {number} of them")
    request = replace(request, times=request.task.path.via_times(number))
    yield from _anew(trial.attempt, searches=True, request=request)


def _tell_via_points(before: AnyTrial, after: AnyTrial) -> str:
    count, number = (len(trial.attempt.request.times) for trial in (before, after))
    off = strays(before.failure)
    reason = "the tool strays from its path between them" if off else "no trajectory was found"
    key = f"{after.attempt.request.stroke.key}.via_points {number}"
    return f"With {count} via-points {reason} ({in_words(before.failure)}): planned with {key} instead."


def _another_start(trial: AnyTrial) -> Iterator[Attempt]:
    """Where no trajectory leads on from the scene's posture: a part of the self-motion where one may.

    The way on from there may be so sudden that only rest is possible. Where an approach has failed before,
    the scene's posture is all that is left.
    """
    request, guess = trial.attempt.request, trial.attempt.guess
    if not isinstance(trial.outcome, NoTrajectory) or not isinstance(guess, InitialGuess):
        return
    if guess.unreached or not guess.pinned or (search := trial.attempt.search) is None:
        return
    request.reporter.stage("path")
    reason = f"no trajectory follows the tool path ({in_words(trial.outcome)})"
    start = partial(sliding_guess, request, unfollowed=request.path_not_found(reason, request.first))
    rough, tries, parts = roughness(guess.problem), 0, search.parts_of_first_chart()
    for _ in range(1 + _MAX_STEP_HALVINGS):
        pinned = solved(search, pinned=True)
        for starts in parts:
            if tries == _MAX_OPTIMISED_GUESSES or request.deadline.expired():
                return
            left = attempted(request, partial(start, search=search, starts=starts, pinned=pinned))
            if isinstance(left, InitialGuess) and roughness(left.problem) <= SMOOTHER * rough:
                tries += 1
                yield from _changed(trial.attempt, left)
        search = search.halved()


def _reachable_start(trial: AnyTrial) -> Iterator[Attempt]:
    """Where no approach leads to a better start: the best start that self-motion leads to.

    Of a stroke that begins elsewhere the scene's posture does not hold the tool where it begins. Where
    nothing that can be reached is better, `SCENE_START` says so.
    """
    request = trial.attempt.request
    if not isinstance(trial.outcome, NoWay) or request.stroke.begins_elsewhere or trial.attempt.is_pinned:
        return
    if (search := trial.attempt.search) is not None:
        request.reporter.stage("path")
        starts = reachable(request, search.first_chart.q)
        best = attempted(request, partial(sliding_guess, request, search=search, starts=starts))
        if isinstance(best, InitialGuess) and not best.pinned:
            yield from _changed(trial.attempt, best)


def _joined_start(trial: AnyTrial) -> Iterator[Attempt]:
    """Where no approach leads to the start that was chosen: the best of those that trees lead to."""
    request = trial.attempt.request
    if not isinstance(trial.outcome, NoWay) or not request.stroke.begins_elsewhere:
        return
    if (search := trial.attempt.search) is not None:
        request.reporter.step("no approach leads there; seeking a start that one leads to")
        start = partial(sliding_guess, request, search=search, pinned=trial.outcome.error)
        for starts, way in islice(joined_starts(request, search.first_chart.q), _MAX_JOINED_STARTS):
            request.reporter.stage("path")
            best = attempted(request, partial(start, starts=starts))
            if isinstance(best, InitialGuess):
                yield from _changed(trial.attempt, replace(best, way=way))


def _scene_start(trial: AnyTrial) -> Iterator[Attempt]:
    """Where no approach leads to a better start, or no trajectory on from there: the scene's posture."""
    request = trial.attempt.request
    if isinstance(trial.outcome, Solved) or trial.attempt.is_pinned:
        return
    if (search := trial.attempt.search) is None:
        return
    match trial.outcome:
        case NoWay(error=error):
            stays = partial(sliding_guess, request, unreached=error, search=search)
        case NoTrajectory() if not request.stroke.begins_elsewhere:
            request.reporter.step("no trajectory leads on from a better start; trying the scene's posture")
            stays = partial(initial_guess, request, search, stay=True)
        case _:
            return
    request.reporter.stage("path")
    yield from _changed(trial.attempt, attempted(request, stays))


def _tell_scene_start(before: AnyTrial, after: AnyTrial) -> str:
    if isinstance(before.outcome, NoWay):
        # The start's failures tell of it.
        return ""
    why = in_words(before.failure)
    return f"From a better start no trajectory was found ({why}): planned from the scene's."


def _tell(words: str, before: AnyTrial, after: AnyTrial) -> str:
    return words.format(in_words(before.failure), briefly(before.failure))


SPARE_CLEARANCE = Remedy(cost=1, propose=_spare_clearance, tell=_tell_spare, most=2)
NEARER_TOOL = Remedy(cost=1, propose=_nearer_tool, tell=_tell_nearer, topic="nearer", most=2)
FINER_SAMPLES = Remedy(
    cost=2,
    propose=_finer_samples,
    tell=partial(_tell, "A bound was missed narrowly ({0}): planned with twice the samples instead."),
)
SHORTER_STEPS = Remedy(cost=101, propose=_shorter_steps, tell=_tell_shorter)
CLEARER_GUESS = Remedy(cost=102, propose=_clearer_guess, tell=_tell_clearer)
MORE_VIA_POINTS = Remedy(cost=103, propose=_more_via_points, tell=_tell_via_points)
FEWER_VIA_POINTS = Remedy(cost=104, propose=_fewer_via_points, tell=_tell_via_points)
ANOTHER_START = Remedy(cost=105, propose=_another_start)
REACHABLE_START = Remedy(
    cost=106,
    propose=_reachable_start,
    tell=partial(_tell, "No approach leads to the best start ({1}): the best that self-motion leads to."),
)
JOINED_START = Remedy(
    cost=107,
    propose=_joined_start,
    tell=partial(_tell, "No approach leads to the best start ({1}): the best of those that one leads to."),
)
SCENE_START = Remedy(cost=108, propose=_scene_start, tell=_tell_scene_start, replaces=True)

WAYS = (REACHABLE_START, JOINED_START, SCENE_START)
"""Where no approach leads to a start."""
REMEDIES = (
    *(
        SPARE_CLEARANCE,
        NEARER_TOOL,
        FINER_SAMPLES,
        SHORTER_STEPS,
        CLEARER_GUESS,
        MORE_VIA_POINTS,
        FEWER_VIA_POINTS,
    ),
    ANOTHER_START,
    *WAYS,
)
