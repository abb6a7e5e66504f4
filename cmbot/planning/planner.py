"""Plan a scene: read `plan` as the paper's abstract."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, LimitViolation, OptimisationFailed, PathNotFound, PlanningError
from cmbot.common.validation import checked_options, require_type
from cmbot.common.watching import watched
from cmbot.optimization import ExchangeReport
from cmbot.planning.certification.certificate import Certificate, certify
from cmbot.planning.context import PlanningContext, build_context
from cmbot.planning.failures import constraints_named, eased, in_keys, slower, slower_legs
from cmbot.planning.flexibility.sag_compensation import Compensation, compensate
from cmbot.planning.flexibility.vibration_suppression import VibrationSuppression, suppress_vibration
from cmbot.planning.free_motion.approach import plan_approach
from cmbot.planning.free_motion.free_move import largest_objective
from cmbot.planning.free_motion.return_move import SAME_POSTURE, plan_return
from cmbot.planning.initial_guess import InitialGuess, initial_guess, leap_failure, sliding_guess
from cmbot.planning.job import Job, Segment
from cmbot.planning.objectives import WrenchFunction
from cmbot.planning.path.first_posture import starting_at_path
from cmbot.planning.path.raster_reach import reached_scene
from cmbot.planning.precheck import (
    failures_explained,
    require_reasonable_size,
    require_tool_speed,
    solver_of,
)
from cmbot.planning.progress import Progress, ProgressReporter
from cmbot.planning.reach import require_posture, require_postures, require_within_reach
from cmbot.planning.result.composition import StrokeMotion, composed, suppresses_vibration
from cmbot.planning.result.plan import Plan
from cmbot.planning.result.stroke_plan import Start
from cmbot.planning.retries import Attempt, is_little_nearer, with_retries
from cmbot.planning.stroke_order import in_least_travel
from cmbot.planning.torque import Optimised, optimise
from cmbot.scene import PlannerOptions, Scene
from cmbot.trajectory import QuinticTrajectory

__all__ = ["plan"]

# Slower legs are tried so often where velocities, accelerations or jerks are what fails.
_TRIALS = 3
# And for this share of the time limit, or as long as planning took.
_ADVICE = 0.1
# The scene's posture is planned from, too, where that may lower the peak of the job by more than this share.
_WORTH_PLANNING = 1e-2
# That is given up where its peak is above by this share, which is more than less smoothing lowers it by.
_HARDLY_LOWERED = 0.02
# Peaks of two orders of strokes that differ by less are the same.
_SAME_PEAK = 1.001


def plan(
    scene: Scene,
    *,
    options: PlannerOptions | None = None,
    objective: WrenchFunction | None = None,
    progress: Callable[[Progress], None] | Literal[False] | None = None,
) -> Plan:
    """Plan the motion of a scene's arm.

    With sliding knots, charts of the self-motion and dynamic programming over them give via-points with the
    least torque on the guardrail at rest; with fixed knots, gradient projection gives those of the paper.
    Quintic splines through them are optimised for a small peak of the torque and little jerk. The result is
    certified apart from the optimiser, and so is the approach to its start.

    Parameters
    ----------
    scene : Scene
    options : PlannerOptions, optional
        In place of the scene's own.
    objective : callable, optional
        A function of the wrench on the guardrail to minimise in place of what the options say: from
        wrenches (N, 6) to values (N,), never negative, and gradients (N, 6); see
        `cmbot.planning.WrenchFunction`. A plan directory holds its name only.
    progress : callable, optional
        Called with a `Progress` as the work goes on. Left out, that is shown on a terminal and in a notebook;
        with False nowhere.

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    InputError
        When an option is out of its bounds, or `objective` is no such function.
    MissingExtra
        When the options ask for a solver that is not installed.
    PathNotFound
        When the path ends at an obstacle, a joint's range or out of reach, from the scene's posture and from
        the others that were tried.
    OptimisationFailed
        When no trajectory through the path's via-points keeps the limits.
    LimitViolation
        When the certificate does not hold.

    Examples
    --------
    >>> plan = cmbot.plan(cmbot.load_scene("triangle"), progress=False)
    >>> plan
    <Plan triangle: peak torque on the guardrail 486.4 Nm in 29.9 s, at work 383.8 Nm ...>
    >>> f"{plan.figures.peak_guardrail_torque:.1f} Nm at work"
    '383.8 Nm at work'
    >>> plan.trajectory.q.shape[1]
    7
    """
    require_type(scene, Scene, "cmbot.plan", "scene", "a Scene, as cmbot.load_scene returns it")
    for key, value in (("objective", objective), ("progress", progress)):
        if not (value is None or value is False or callable(value)):
            raise InputError("cmbot.plan", key, type(value).__name__, "something to call, or None")
    given = scene.planner if options is None else checked_options(PlannerOptions, options, "PlannerOptions")
    timer = ProgressReporter(None, limit=given.time_limit_s)
    with threadpool_limits(limits=1, user_api="blas"), failures_explained(scene):
        scene = reached_scene(scene, given, timer)
    if scene.order == "best":
        return _in_best_order(scene, given, objective, progress)
    # The plan holds the solver that it was made with.
    automatic, options = given.solver == "auto", replace(given, solver=solver_of(given))
    # The matrices are small: more threads of linear algebra than one only wait for each other.
    with (
        threadpool_limits(limits=1, user_api="blas"),
        watched(progress) as report,
        failures_explained(scene),
    ):
        followed = any(file.raster is not None for file in scene.strokes)
        reporter = ProgressReporter(report, limit=timer.time_left if followed else options.time_limit_s)
        reporter.stage("path")
        context = build_context(scene, options, objective, reporter)
        for number, stroke in enumerate(context.strokes):
            require_reasonable_size(scene, stroke, context.robot.dof, options)
            require_tool_speed(scene, stroke)
            require_within_reach(context.at_stroke(number, scene, context.posture, 0.0, 0.0))
        require_postures(context, scene)
        made: list[tuple[Attempt, StrokeMotion]] = []
        for number in range(len(context.strokes)):
            made.append(_stroke(_at_stroke(context, scene, number, made), automatic=automatic))
        return composed(scene, made, custom=objective is not None)


def _in_best_order(
    scene: Scene,
    options: PlannerOptions,
    objective: WrenchFunction | None,
    progress: Callable[[Progress], None] | Literal[False] | None,
) -> Plan:
    """The plan in the order of least travel, or in the given one where the peak of that is lower.

    Of two peaks that are about the same, the quicker job counts.
    """
    given, travels_least = scene.with_strokes(scene.strokes), in_least_travel(scene)
    orders = [travels_least]
    if travels_least.strokes != given.strokes:
        orders.append(given)
    options = replace(options, time_limit_s=options.time_limit_s / len(orders))
    plans, failures = list[Plan](), list[PlanningError]()
    for order in orders:
        try:
            plans.append(plan(order, options=options, objective=objective, progress=progress))
        except PlanningError as error:
            failures.append(error)
    if not plans:
        raise failures[-1]
    lowest = min(each.job.figures.peak_guardrail_torque for each in plans)
    alike = [each for each in plans if each.job.figures.peak_guardrail_torque <= _SAME_PEAK * lowest]
    best = min(alike, key=lambda each: each.job.duration)
    names = ", ".join(
        f"{stroke.name}{' backwards' if stroke.backwards else ''}" for stroke in best.scene.strokes
    )
    chosen = f"Order of the strokes: {names}."
    return replace(best, fallbacks=(chosen, *best.fallbacks))


def _at_stroke(
    context: PlanningContext, scene: Scene, number: int, made: Sequence[tuple[Attempt, StrokeMotion]]
) -> PlanningContext:
    """The context of a stroke after those that are planned."""
    left = len(context.strokes) - number
    if left > 1:
        # Only the last stroke leads to where the job ends.
        context = replace(context, end_posture=None)
    if len(context.strokes) > 1:
        context.reporter.begin_stroke(context.strokes[number].name, left)
    if not made:
        return context
    before = made[-1][1].job.segments[-1]
    reached = max(_peak(attempt.context, motion.job.segments) for attempt, motion in made)
    return context.at_stroke(number, scene, before.trajectory.q[-1], before.end, reached)


def _stroke(context: PlanningContext, *, automatic: bool) -> tuple[Attempt, StrokeMotion]:
    """Plan a stroke and the free moves that go with it."""
    try:
        if context.stroke.begins_elsewhere:
            context = starting_at_path(context)
        return _search(context, automatic=automatic)
    except PlanningError as failure:
        if not _starts_too_near(failure):
            # Before anything else is advised; and it says by how much a place is missed.
            require_posture(context, is_clear=True)
        if len(context.strokes) > 1:
            failure.add_hint(f"this is stroke {context.stroke.name}")
        if hints := [*_hints(context, failure, automatic=automatic)]:
            failure.add_hint("; ".join(hints))
        raise


def _starts_too_near(failure: PlanningError) -> bool:
    """Whether it is the start posture that is too near to something: then no other place is the matter."""
    return isinstance(failure, PathNotFound) and failure.pair is not None and failure.time == 0.0


def _search(context: PlanningContext, *, automatic: bool) -> tuple[Attempt, StrokeMotion]:
    if context.task.path.open_legs:
        # Imported where needed: SciPy's splines and linear programs take a while to load.
        from cmbot.planning.timing.shortest_time import in_shortest_time

        work = in_shortest_time(
            context, _certified_motion, lambda motion: motion.work.trajectory, automatic=automatic
        )
        return _lighter(*work)
    first = Attempt(context=context, guess=initial_guess(context), automatic=automatic)
    return _lighter(*with_retries(first, _certified_motion))


def _lighter(attempt: Attempt, motion: StrokeMotion) -> tuple[Attempt, StrokeMotion]:
    """The motion from the scene's posture in place of one whose approach has a larger peak than that job.

    The peak over the whole job counts: a better start is none where the approach to it is worse.
    """
    context, guess, approach = attempt.context, attempt.guess, motion.approach
    pinned = None if guess.choice is None else guess.choice.pinned
    if approach is None or pinned is None or guess.failures or context.reporter.expired():
        return attempt, motion
    highest, margin = _peak(context, motion.job.segments), 1 + context.options.gap_target
    rest = _peak(context, [each for each in motion.job.segments if each is not approach])
    off = context.tool_off
    idle = off.objective.at_rest(off.postures.at(np.stack([context.posture, context.first])))
    before = float(idle.max())
    # No job from the scene's posture has a smaller peak than at rest there, with the tool off or on.
    if highest <= max(margin, 1 + _WORTH_PLANNING) * max(pinned, rest, before, context.reached):
        return attempt, motion
    context.reporter.stage("path")
    context.reporter.step("the peak is on the approach; trying the scene's posture")
    try:
        stays = sliding_guess(context, search=guess.search, stay=True)
        here, there = (each.problem.parametrization.via_points for each in (stays, guess))
        if np.array_equal(here, there):
            return attempt, motion
        useless = (1 + _HARDLY_LOWERED) * highest
        other, lighter = with_retries(
            replace(attempt, guess=stays), partial(_certified_motion, useless=useless)
        )
    except (PlanningError, _UselessMotion):
        return attempt, motion
    peak = _peak(other.context, lighter.job.segments)
    if margin * peak > highest:
        return attempt, motion
    unit = context.objective.unit
    fallback = (
        f"A start that is better at work is not used: the approach to it would have a peak of "
        f"{highest:.4g} {unit}, the whole job from the scene's posture {peak:.4g} {unit}."
    )
    return replace(other, fallbacks=(*other.fallbacks, fallback)), lighter


def _peak(context: PlanningContext, parts: Sequence[Segment]) -> float:
    """The largest value of the objective over segments."""
    return max(
        largest_objective(context if segment.kind == "stroke" else context.tool_off, segment.trajectory)
        for segment in parts
    )


def _hints(context: PlanningContext, failure: PlanningError, *, automatic: bool) -> Iterator[str]:
    """What was tried and would do; and that the time was over, where nothing can be tried."""
    if context.reporter.expired():
        if "the time" not in str(failure):
            yield f"then the time, {context.options.time_limit_s:g} s (planner.time_limit_s), was over"
        return
    # Seeking advice takes no longer than what it is about, or a small share of the time.
    reporter = context.reporter
    tried = replace(context, reporter=reporter.silent(max(reporter.used, _ADVICE * reporter.limit)))
    trial, latest = tried, failure
    for number in range(_TRIALS + 1):
        slowed = None if number == _TRIALS else _slowed(tried, trial, latest)
        step = slowed or eased(tried, failure)
        if step is None:
            return
        words, trial = step
        reporter.step(f"trying {words}")
        try:
            _search(trial, automatic=automatic)
        except PlanningError as again:
            latest = again
            if slowed is None or trial.reporter.expired():
                return
        else:
            yield f"{words} would do"
            return


def _slowed(
    first: PlanningContext, failed: PlanningContext, failure: PlanningError
) -> tuple[str, PlanningContext] | None:
    """The context of slower legs than of the one that failed, in words what is changed of the first one.

    None where time is not the matter, and of legs whose time is sought: ever longer ones were tried.
    """
    factors = None if first.task.path.open_legs else slower_legs(failed, failure)
    if factors is None:
        return None
    after = slower(failed, factors)
    return in_keys(first, after), after


def _return(context: PlanningContext, before: tuple[Segment, ...]) -> Segment | None:
    """The return of a job after what is planned of it."""
    if context.end_posture is None:
        return None
    context.reporter.step("planning the return")
    work, allowed = before[-1], max(context.reached, _peak(context, before))
    return plan_return(context, work.trajectory.q[-1], begin=work.end, allowed=allowed)


class _UselessMotion(Exception):
    """The least peak of a motion is more than it may be."""


def _certified_motion(attempt: Attempt, useless: float = np.inf) -> StrokeMotion:
    """Optimise and certify the motion of an attempt, with the free moves that go with it.

    A `_UselessMotion` is raised where its least peak is above `useless`.
    """
    context, guess = attempt.context, attempt.guess
    optimised, compensation, suppression = _optimised(context, guess, useless)
    context.reporter.stage("certify")
    posture = optimised.trajectory.q[0]
    moved = float(np.abs(context.robot.metric.coordinates(posture - context.posture)).max())
    certificate = _certified(context, optimised, start=context.posture if moved <= SAME_POSTURE else None)
    approach: Segment | None = None
    if moved <= SAME_POSTURE:
        posture, moved = context.posture, 0.0
    else:
        approach = _approach(context, guess, optimised.trajectory)
    work = Segment(
        name=context.stroke.name,
        kind="stroke",
        begin=context.begin if approach is None else approach.end,
        trajectory=optimised.trajectory,
        certificate=certificate,
        task=context.task,
    )
    before = () if approach is None else (approach,)
    back = _return(context, (*before, work))
    after = () if back is None else (back,)
    return StrokeMotion(
        optimised=optimised,
        compensation=compensation,
        suppression=suppression,
        start=Start(posture=posture, moved=moved, failures=guess.failures),
        job=Job(segments=(*before, work, *after)),
    )


def _optimised(
    context: PlanningContext, guess: InitialGuess, useless: float
) -> tuple[Optimised, Compensation | None, VibrationSuppression | None]:
    """The optimised motion, with sag compensated and vibration suppressed where something bends."""
    reporter, options = context.reporter, context.options
    reporter.stage("optimise")

    def each_pass(report: ExchangeReport, rounds: int = 0) -> None:
        reporter.passed(report, context.objective.unit, rounds)
        if report.stage == "peak" and report.ended and report.peak_torque > useless:
            raise _UselessMotion

    compensation = suppression = None
    with constraints_named(context):
        problem = guess.problem
        try:
            optimised = optimise(problem, each_pass)
        except OptimisationFailed as failure:
            leaps = leap_failure(problem)
            if leaps is None:
                raise
            raise leaps from failure
        if context.sag is not None:
            optimised, compensation, problem = compensate(context, guess, optimised, context.sag, each_pass)
    if context.arm is not None and suppresses_vibration(options):
        optimised, suppression = suppress_vibration(context.arm, problem, optimised)
    return optimised, compensation, suppression


def _certified(context: PlanningContext, optimised: Optimised, start: FloatArray | None) -> Certificate:
    """The certificate of an optimised motion; where none holds, the error is the solver's if it has one."""
    certificate = certify(
        context.robot,
        context.task,
        optimised.trajectory,
        context.clearances,
        context.options,
        via_points=len(context.times),
        start=start,
        sag=context.sag,
    )
    try:
        certificate.require()
    except LimitViolation as violation:
        if optimised.failure is not None and not is_little_nearer(violation):
            raise optimised.failure from violation
        raise
    return certificate


def _approach(context: PlanningContext, guess: InitialGuess, trajectory: QuinticTrajectory) -> Segment:
    """The free move to where a trajectory starts."""
    context.reporter.step("planning the approach to the start")
    at_rest = context.objective.at_rest(context.postures.at(trajectory.q))
    chart = context.first[None] if guess.search is None else guess.search.first_chart.q
    stays = guess.choice is not None and guess.choice.pinned is not None
    return plan_approach(
        context, trajectory.q[0], chart, way=guess.way, allowed=float(at_rest.max()), dispensable=stays
    )
