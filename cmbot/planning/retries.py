"""Retries: what is tried where no certified motion is found, in the order of `RETRIES`.

1. `spare_clearance`: where the certificate finds less clearance than the safety margin by less than 1 mm,
   more than that margin for what is optimised.
2. `finer_samples`: where the certificate misses a bound narrowly, twice the samples per segment, and 1.
3. `shorter_steps`: a guess with shorter steps between via-points, and 1, 2.
4. `clearer_guess`: where a clearance cannot be kept, a guess that keeps a little more of it, and 1 to 3.
5. `more_via_points`: where the tool strays between via-points, or the compensation of the sag does not
   settle, 2 to 4 times as many, and 1 to 4.
6. `fewer_via_points`: where accelerations or jerks cannot be kept, fewer of them, and 1 to 5.
7. `another_start`: a guess that leaves the scene's posture where no trajectory leads on from it, and 1 to 6.
8. `reachable_start`: a guess that starts where self-motion leads to from the scene's posture, and 1 to 7.
9. `joined_start`: a guess that starts where a free move leads to, and 1 to 8.
10. `scene_start`: a guess that starts in the scene's posture, where a trajectory may lead on, and 1 to 9.
11. `dense_solver`: SLSQP, and 1 to 10.

Each remedy runs while there is time (`PlannerOptions.time_limit_s`).

Blends at corners are no remedy: the tool rests at every corner (`ToolPath.leg_times`), so a corner is no
harder for the joints than any other end of a leg. Jumps of acceleration need much jerk, as at the ends of
trapezoidal ramps; ``tool_path.speed_profile.kind: jerk_limited`` has none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, Protocol, TypeGuard, TypeVar

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import LimitViolation, OptimisationFailed, PathNotFound, PlanningError
from cmbot.planning.context import PlanningContext
from cmbot.planning.free_motion.approach import joined_starts, reachable
from cmbot.planning.initial_guess import (
    SMOOTHER,
    InitialGuess,
    initial_guess,
    leap,
    leap_failure,
    roughness,
    searched,
    sliding_guess,
    solved,
)
from cmbot.planning.torque import TorqueProblem
from cmbot.scene import MOST_SAMPLES

__all__ = [
    "RETRIES",
    "Attempt",
    "another_start",
    "clearer_guess",
    "dense_solver",
    "fewer_via_points",
    "finer_samples",
    "guesses_in_shorter_steps",
    "is_little_nearer",
    "joined_start",
    "more_via_points",
    "reachable_start",
    "scene_start",
    "shorter_steps",
    "spare_clearance",
    "with_retries",
]

# Halvings of the steps, and guesses among these that are optimised, at most.
_HALVINGS, _TRIES = 4, 2
# What the certificate may miss a bound by for more samples to help, as a share of it.
_BY_A_HAIR = 0.01
# The certificate may find so much less clearance than the safety margin, m, for spare clearance to help, of
# which there is what is missing and so much more, so many times.
_LITTLE_NEARER, _SPARE, _SPARED = 1e-3, 1.5e-4, 2
# Via-points at most for which SLSQP is tried: its time grows with the cube of their number.
_FEW_VIA_POINTS = 100
# Least and largest factor by which there are more via-points, and how many at most: all takes longer in
# proportion.
_FINER, _MOST_VIA_POINTS = (2, 4), 300
# Shares of the via-points that are left where fewer are tried, and how few there may be in a leg.
_COARSER, _FEWEST_IN_A_LEG = (0.7, 0.5), 4
# Factors on the safety margin that guesses keep where trajectories cannot keep it.
_CLEARER = (1.02, 1.1)
# Constraints on joints that move too suddenly, and such that splines break between via-points, by words in
# their names.
_RATES = ("acceleration", "jerk")
_BETWEEN_VIA_POINTS = (
    "tool deviation",
    "tool rotation",
    "tool tilt",
    "tool lag",
    "tool speed",
    "process speed",
    "change of the shift",
)
_FAILURES = (OptimisationFailed, PathNotFound, LimitViolation)

Work = TypeVar("Work")


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """What a motion is planned from."""

    context: PlanningContext
    guess: InitialGuess
    automatic: bool = False  # the solver was chosen by ``auto``
    fallbacks: tuple[str, ...] = ()  # what failed before, and what was done instead, a sentence each


Run = Callable[[Attempt], tuple[Attempt, Work]]


class Retry(Protocol):
    """Runs other attempts in place of a failed one, or raises its failure."""

    def __call__(self, failed: Attempt, failure: PlanningError, run: Run[Work], /) -> tuple[Attempt, Work]:
        """Return the attempt that succeeded and its result."""


def spare_clearance(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where the certificate finds a little less clearance than the safety margin, as between samples."""
    for _ in range(_SPARED):
        if not is_little_nearer(failure) or failed.context.reporter.expired():
            break
        failed = _spared(failed, failure)
        try:
            return run(failed)
        except LimitViolation as again:
            failure = again
    raise failure


def is_little_nearer(failure: PlanningError) -> TypeGuard[LimitViolation]:
    """Whether a certificate misses the safety margin by so little that spare clearance may make up for it."""
    if not isinstance(failure, LimitViolation) or not failure.quantity.startswith("clearance"):
        return False
    return 0 < failure.bound - failure.value < _LITTLE_NEARER


def _spared(failed: Attempt, failure: LimitViolation) -> Attempt:
    """The same attempt with what is missing of the safety margin, and a little more, to spare."""
    missing = failure.bound - failure.value
    spare = failed.context.spare_clearance + missing + _SPARE
    context = replace(failed.context, spare_clearance=spare)
    context.reporter.stage("path")
    context.reporter.step(f"{1e3 * missing:.2g} mm of clearance are missing; planning with more of it")
    fallback = (
        f"The safety margin was missed by {1e3 * missing:.2g} mm ({failure}): planned with "
        f"{1e3 * spare:.2g} mm more than it instead."
    )
    guess = failed.guess
    form, least = guess.problem.parametrization, guess.lower_bound.value
    guess = replace(guess, problem=TorqueProblem(context, form, least))
    return replace(failed, context=context, guess=guess, fallbacks=(*failed.fallbacks, fallback))


def finer_samples(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where the certificate misses a bound narrowly, which sampled constraints overlooked."""
    context = failed.context
    options = context.options
    missed = isinstance(failure, LimitViolation) and _excess(failure) <= _BY_A_HAIR
    if not missed or 2 * options.samples_per_segment > MOST_SAMPLES:
        raise failure
    context.reporter.stage("path")
    options = replace(options, samples_per_segment=2 * options.samples_per_segment)
    context = replace(context, options=options)
    fallback = f"A bound was missed narrowly ({failure}): planned with twice the samples instead."
    guess = initial_guess(context, failed.guess.search)
    return run(replace(failed, context=context, guess=guess, fallbacks=(*failed.fallbacks, fallback)))


def shorter_steps(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where no trajectory follows a guess: the first one in shorter steps that a trajectory follows.

    The global search bounds the steps between via-points by the joints' velocities alone. They may turn round
    from one via-point to the next faster than accelerations and jerks allow; the shorter, the less.
    """
    if isinstance(failure, OptimisationFailed):
        for attempt in guesses_in_shorter_steps(failed, failure):
            try:
                return run(attempt)
            except OptimisationFailed:
                continue
            except PathNotFound:
                # No approach leads to its start; only a free start has another retry.
                if not attempt.guess.pinned:
                    raise
    raise failure


def clearer_guess(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where a clearance cannot be kept: a guess that keeps a little more of it.

    Postures of least torque may lie at the safety margin itself, where splines have no room to either side.
    """
    context, search = failed.context, failed.guess.search
    near = isinstance(failure, OptimisationFailed) and failure.constraint.startswith("clearance")
    if not near or search is None:
        raise failure
    for factor in _CLEARER:
        if context.reporter.expired():
            break
        margin = context.options.safety_margin_m
        context.reporter.stage("path")
        context.reporter.step(
            f"no trajectory keeps clear; trying postures {1e3 * factor * margin:.3g} mm away"
        )
        wider = replace(context, options=replace(context.options, safety_margin_m=factor * margin))
        try:
            guess = sliding_guess(context, failed.guess.unreached, searched(wider, search)[0])
            fallback = (
                f"From postures at the safety margin no trajectory keeps clear ({_told(failure)}): planned "
                f"from such that keep {100 * (factor - 1):.0f} % more."
            )
            return run(replace(failed, guess=guess, fallbacks=(*failed.fallbacks, fallback)))
        except (OptimisationFailed, PathNotFound):
            continue
    raise failure


def more_via_points(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where the tool strays from its path between via-points: more of them, which hold it more often.

    Splines miss a smooth path by the square of their segments' length or less, so a deviation of r times its
    bound needs sqrt(r) times the segments; twice as many are tried first. They help no guess that leaps.
    """
    context, count = failed.context, len(failed.context.times)
    leaps = leap(context, failed.guess.problem.parametrization.via_points) > 0.0
    ratio = 1.0 if leaps else _excess_between_via_points(failure)
    most = int(np.clip(np.ceil(np.sqrt(ratio)), *_FINER))
    for factor in sorted({_FINER[0], most}) if ratio > 1.0 else ():
        number = factor * (count - 1) + 1
        if number > _MOST_VIA_POINTS or context.reporter.expired():
            break
        step = f"the tool strays between via-points; trying {number} of them"
        reason = f"the tool strays from its path between them ({_told(failure)})"
        if planned := _with_via_points(number, failed, run, step, reason):
            return planned
    raise failure


def fewer_via_points(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where accelerations or jerks cannot be kept: fewer via-points, between which the tool has some room.

    The tool is on its path at every via-point, in time; between them only the bounds on its deviation and lag
    count. The denser they are, the more exactly splines follow the speed profile, whose acceleration jumps.
    """
    context = failed.context
    count, legs = len(context.times), len(context.task.path.seconds)
    for share in _COARSER if _is_sudden(failure) else ():
        number = max(round(share * (count - 1)), _FEWEST_IN_A_LEG * legs) + 1
        if number >= count or context.reporter.expired():
            break
        step = f"no trajectory keeps the rates; trying {number} via-points"
        reason = f"no trajectory was found ({_told(failure)})"
        if planned := _with_via_points(number, failed, run, step, reason):
            return planned
    raise failure


def _with_via_points(
    number: int, failed: Attempt, run: Run[Work], step: str, reason: str
) -> tuple[Attempt, Work] | None:
    """Plan with so many via-points; None where that fails, too."""
    context, count = failed.context, len(failed.context.times)
    context.reporter.stage("path")
    context.reporter.step(step)
    other = replace(context, times=context.task.path.via_times(number))
    instead = f"{context.stroke.key}.via_points {number} instead"
    fallback = f"With {count} via-points {reason}: planned with {instead}."
    try:
        guess = initial_guess(other)
        return run(replace(failed, context=other, guess=guess, fallbacks=(*failed.fallbacks, fallback)))
    except PlanningError:
        return None


def another_start(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where no trajectory leads on from the scene's posture: a part of the self-motion where one may.

    The way on from there may be so sudden that only rest is possible.
    """
    context, guess, search = failed.context, failed.guess, failed.guess.search
    # Where an approach has failed before, the scene's posture is all that is left.
    if not isinstance(failure, OptimisationFailed) or search is None or guess.unreached or not guess.pinned:
        raise failure
    context.reporter.stage("path")
    reason = f"no trajectory follows the tool path ({_told(failure)})"
    unfollowed = context.path_not_found(reason, context.first)
    rough, tries, parts = roughness(guess.problem), 0, search.parts_of_first_chart()
    for _ in range(1 + _HALVINGS):
        pinned = solved(search, pinned=True)
        for starts in parts:
            if tries == _TRIES or context.reporter.expired():
                raise failure
            try:
                left = sliding_guess(
                    context, search=search, starts=starts, unfollowed=unfollowed, pinned=pinned
                )
                if roughness(left.problem) <= SMOOTHER * rough:
                    tries += 1
                    return run(replace(failed, guess=left))
            except (OptimisationFailed, PathNotFound):
                continue
        search = search.halved()
    raise failure


def reachable_start(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where no approach leads to a better start: the best start that self-motion leads to."""
    context, search = failed.context, failed.guess.search
    if not isinstance(failure, PathNotFound) or search is None or failed.guess.pinned:
        raise failure
    if context.stroke.begins_elsewhere:
        # The scene's posture holds the tool elsewhere.
        raise failure
    context.reporter.stage("path")
    starts = reachable(context, search.first_chart.q)
    guess = sliding_guess(context, search=search, starts=starts)
    if guess.pinned:
        # Nothing that can be reached is better; `scene_start` says so.
        raise failure
    fallback = f"No approach leads to the best start ({failure.reason}): the best that self-motion leads to."
    return run(replace(failed, guess=guess, fallbacks=(*failed.fallbacks, fallback)))


def joined_start(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where no approach leads to the start that was chosen: the best of those that trees lead to."""
    context, search = failed.context, failed.guess.search
    if not isinstance(failure, PathNotFound) or search is None or not context.stroke.begins_elsewhere:
        raise failure
    context.reporter.step("no approach leads there; seeking a start that one leads to")
    for starts, way in joined_starts(context, search.first_chart.q):
        context.reporter.stage("path")
        try:
            guess = sliding_guess(context, search=search, starts=starts, pinned=failure)
            guess = replace(guess, way=way)
            why = failure.reason.partition(";")[0]
            fallback = f"No approach leads to the best start ({why}): the best of those that one leads to."
            return run(replace(failed, guess=guess, fallbacks=(*failed.fallbacks, fallback)))
        except (OptimisationFailed, PathNotFound):
            if context.reporter.expired():
                break
    raise failure


def scene_start(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where no approach leads to a better start, or no trajectory on from there: the scene's posture."""
    context, guess = failed.context, failed.guess
    if isinstance(failure, LimitViolation) or guess.search is None or guess.pinned:
        raise failure
    if isinstance(failure, PathNotFound):
        context.reporter.stage("path")
        return run(replace(failed, guess=sliding_guess(context, unreached=failure, search=guess.search)))
    if context.stroke.begins_elsewhere:
        # The scene's posture holds the tool elsewhere.
        raise failure
    context.reporter.stage("path")
    context.reporter.step("no trajectory leads on from a better start; trying the scene's posture")
    fallback = f"From a better start no trajectory was found ({_told(failure)}): planned from the scene's."
    stays = initial_guess(context, guess.search, stay=True)
    return run(replace(failed, guess=stays, fallbacks=(*failed.fallbacks, fallback)))


def dense_solver(failed: Attempt, failure: PlanningError, run: Run[Work]) -> tuple[Attempt, Work]:
    """Where the sparse solver that ``auto`` chose ended undecided: SLSQP, for few via-points."""
    context = failed.context
    sparse = failed.automatic and context.options.solver == "sqp" and len(context.times) <= _FEW_VIA_POINTS
    if not (sparse and isinstance(failure, OptimisationFailed) and failure.undecided):
        raise failure
    context.reporter.step("sqp gave up; trying slsqp")
    context.reporter.stage("path")
    context = replace(context, options=replace(context.options, solver="slsqp"))
    fallback = f"The solver sqp gave up ({failure.reason}): planned with slsqp instead."
    guess = initial_guess(context, failed.guess.search)
    return run(Attempt(context=context, guess=guess, fallbacks=(fallback,)))


def _is_sudden(failure: PlanningError) -> bool:
    """Whether joints would have to move too suddenly."""
    if not isinstance(failure, OptimisationFailed):
        return False
    return any(word in failure.constraint for word in _RATES)


def _excess(violation: LimitViolation) -> float:
    """By how much a bound is missed, as a share of it."""
    return abs(violation.value - violation.bound) / max(abs(violation.bound), 1e-12)


def _excess_between_via_points(failure: PlanningError) -> float:
    """How often a bound that splines break between via-points goes into what they do there; else 1."""
    if isinstance(failure, LimitViolation):
        name, ratio = failure.quantity, failure.value / failure.bound
    elif isinstance(failure, OptimisationFailed):
        name, ratio = failure.constraint, 1.0 + failure.violation
    else:
        return 1.0
    return ratio if any(word in name for word in _BETWEEN_VIA_POINTS) else 1.0


def _told(failure: PlanningError) -> str:
    if isinstance(failure, OptimisationFailed):
        return f"{failure.reason}; {failure.constraint}"
    return str(failure)


RETRIES: tuple[Retry, ...] = (
    spare_clearance,
    finer_samples,
    shorter_steps,
    clearer_guess,
    more_via_points,
    fewer_via_points,
    another_start,
    reachable_start,
    joined_start,
    scene_start,
    dense_solver,
)


def with_retries(
    attempt: Attempt, work: Callable[[Attempt], Work], retries: Sequence[Retry] = RETRIES
) -> tuple[Attempt, Work]:
    """Return the first attempt at which `work` succeeds, and its result.

    Each of `retries` runs its attempts with all retries before it. What failed is not worked at again:
    several lead to the same guess.

    Raises
    ------
    OptimisationFailed
        When no trajectory follows the guess, nor any other.
    PathNotFound
        When a guess cannot be made, or no approach leads to its start.
    LimitViolation
        When the certificate does not hold.
    """
    return _retried(attempt, _Once(work), retries)


def _retried(
    attempt: Attempt, work: Callable[[Attempt], Work], retries: Sequence[Retry]
) -> tuple[Attempt, Work]:
    if not retries:
        return attempt, work(attempt)
    run: Run[Work] = partial(_retried, work=work, retries=retries[:-1])
    try:
        return run(attempt)
    except _FAILURES as failure:
        if attempt.context.reporter.expired():
            raise
        return retries[-1](attempt, failure, run)


class _Once(Generic[Work]):
    """Work that raises the failure of the same attempt before.

    After a failure nothing is optimised from a guess that leaps: hardly any trajectory leads on from there.
    """

    def __init__(self, work: Callable[[Attempt], Work]) -> None:
        self._work = work
        self._failed: list[tuple[Attempt, PlanningError]] = []

    def __call__(self, attempt: Attempt) -> Work:
        for before, failure in self._failed:
            if _are_same(before, attempt):
                raise failure
        leaps = leap_failure(attempt.guess.problem) if self._failed else None
        if leaps is not None:
            raise leaps
        try:
            return self._work(attempt)
        except _FAILURES as failure:
            self._failed.append((attempt, failure))
            raise


def _are_same(one: Attempt, other: Attempt) -> bool:
    """Whether two attempts at a stroke are the same but for what failed before."""

    def numbers(attempt: Attempt) -> list[FloatArray]:
        guess, form = attempt.guess, attempt.guess.problem.parametrization
        chart = None if guess.search is None else guess.search.first_chart.q
        return [
            np.empty(0) if each is None else each
            for each in (form.space.t, form.via_points, chart, guess.way)
        ]

    alike = one.context.options == other.context.options and one.guess.pinned == other.guess.pinned
    alike &= one.context.spare_clearance == other.context.spare_clearance
    return alike and all(map(np.array_equal, numbers(one), numbers(other)))


def guesses_in_shorter_steps(failed: Attempt, failure: OptimisationFailed) -> Iterator[Attempt]:
    """Yield attempts with ever shorter steps between via-points, each smoother than the one before.

    Their peak at rest may be higher. Where no path leads on from the scene's posture in shorter steps, they
    start elsewhere; see `sliding_guess`. With fixed knots there are none.
    """
    context, search = failed.context, failed.guess.search
    if search is None:
        return
    rough, tries = roughness(failed.guess.problem), 0
    for _ in range(_HALVINGS):
        if tries == _TRIES or context.reporter.expired():
            return
        search = search.halved()
        context.reporter.step(f"no trajectory follows that guess; trying step_share {search.step_share:.3g}")
        try:
            guess = sliding_guess(context, failed.guess.unreached, search)
        except PathNotFound:
            return
        found = roughness(guess.problem)
        if found <= SMOOTHER * rough:
            rough, tries = found, tries + 1
            fallback = (
                f"With planner.step_share {context.options.step_share:g} no trajectory was found "
                f"({_told(failure)}): planned with {search.step_share:.3g} instead, "
                "a smoother sequence of postures."
            )
            yield replace(failed, guess=guess, fallbacks=(*failed.fallbacks, fallback))
