"""Plan a scene: read `plan` as the paper's abstract."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, LimitViolation, PathNotFound, PlanningError
from cmbot.common.validation import checked_options, require_type
from cmbot.common.watching import watched
from cmbot.optimization import ExchangeReport
from cmbot.planning.certification.certificate import certify
from cmbot.planning.certification.metrics import figures, measure
from cmbot.planning.context import PlanningContext, build_context
from cmbot.planning.failures import constraints_named, in_keys, slower, slower_legs
from cmbot.planning.flexibility.sag_compensation import MOST_ROUNDS, Compensation, compensate
from cmbot.planning.flexibility.vibration_suppression import VibrationSuppression, suppress_vibration
from cmbot.planning.free_motion.approach import plan_approach
from cmbot.planning.free_motion.free_move import largest_objective
from cmbot.planning.free_motion.return_move import SAME_POSTURE, plan_return
from cmbot.planning.initial_guess import initial_guess, leaps_told, sliding_guess
from cmbot.planning.job import Job, Segment
from cmbot.planning.objectives import WrenchFunction
from cmbot.planning.path.first_posture import starting_at_path
from cmbot.planning.path.gradient_projection import follow_path
from cmbot.planning.path.raster_reach import reached_scene
from cmbot.planning.precheck import (
    failures_explained,
    require_reasonable_size,
    require_tool_speed,
    require_within_reach,
    solver_of,
)
from cmbot.planning.progress import Progress, ProgressReporter
from cmbot.planning.result.plan import Plan, Seconds
from cmbot.planning.result.stroke_plan import Start, StrokePlan, objective_metrics
from cmbot.planning.retries import Attempt, with_retries
from cmbot.planning.stroke_order import in_least_travel
from cmbot.planning.torque import Optimised, optimise, segments
from cmbot.scene import PlannerOptions, Scene

__all__ = ["plan"]

# Slower legs are tried so often where velocities, accelerations or jerks are what fails.
_TRIALS = 3
# The scene's posture is planned from, too, where that may lower the peak of the job by more than this share.
_WORTH_PLANNING = 1e-2
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
    """
    require_type(scene, Scene, "cmbot.plan", "scene", "a Scene, as cmbot.load_scene returns it")
    for key, value in (("objective", objective), ("progress", progress)):
        if not (value is None or value is False or callable(value)):
            raise InputError("cmbot.plan", key, type(value).__name__, "something to call, or None")
    given = scene.planner if options is None else checked_options(PlannerOptions, options, "PlannerOptions")
    with threadpool_limits(limits=1, user_api="blas"), failures_explained(scene):
        scene = reached_scene(scene, given)
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
        reporter = ProgressReporter(report, limit=options.time_limit_s)
        reporter.stage("path")
        context = build_context(scene, options, objective, reporter)
        for number, stroke in enumerate(context.strokes):
            require_reasonable_size(scene, stroke, context.robot.dof, options)
            require_tool_speed(scene, stroke)
            require_within_reach(context.at_stroke(number, scene, context.posture, 0.0, 0.0))
        made: list[tuple[Attempt, _Motion]] = []
        for number in range(len(context.strokes)):
            made.append(_stroke(_at_stroke(context, scene, number, made), automatic=automatic))
        return _plan(scene, made, custom=objective is not None)


def _in_best_order(
    scene: Scene,
    options: PlannerOptions,
    objective: WrenchFunction | None,
    progress: Callable[[Progress], None] | Literal[False] | None,
) -> Plan:
    """The plan in the order of least travel, or in the given one where the peak of that is lower.

    Of two peaks that are about the same, the quicker job counts.
    """
    given, travels_least = replace(scene, order=None), in_least_travel(scene)
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
        f"{stroke.name}{' backwards' if stroke.backwards else ''}" for stroke in best.scene.each_stroke
    )
    chosen = f"Order of the strokes: {names}."
    return replace(best, fallbacks=(chosen, *best.fallbacks))


def _at_stroke(
    context: PlanningContext, scene: Scene, number: int, made: Sequence[tuple[Attempt, _Motion]]
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


def _stroke(context: PlanningContext, *, automatic: bool) -> tuple[Attempt, _Motion]:
    """Plan a stroke and the free moves that go with it."""
    try:
        if context.stroke.begins_elsewhere:
            context = starting_at_path(context)
        return _search(context, automatic=automatic)
    except PlanningError as failure:
        if len(context.strokes) > 1:
            failure.add_hint(f"this is stroke {context.stroke.name}")
        if hints := [*_hints(context, failure, automatic=automatic)]:
            failure.add_hint("; ".join(hints))
        raise


def _search(context: PlanningContext, *, automatic: bool) -> tuple[Attempt, _Motion]:
    if context.task.path.open_legs:
        # Imported where needed: SciPy's splines and linear programs take a while to load.
        from cmbot.planning.timing.shortest_time import in_shortest_time

        work = in_shortest_time(
            context, _certified_motion, lambda motion: motion.work.trajectory, automatic=automatic
        )
        return _lighter(*work)
    first = Attempt(context=context, guess=initial_guess(context), automatic=automatic)
    return _lighter(*with_retries(first, _certified_motion))


def _lighter(attempt: Attempt, motion: _Motion) -> tuple[Attempt, _Motion]:
    """The motion from the scene's posture in place of one whose approach asks more than all of that does.

    The peak over the whole job counts: a better start is none where the way there is worse.
    """
    context, guess, approach = attempt.context, attempt.guess, motion.approach
    pinned = None if guess.choice is None else guess.choice.pinned
    if approach is None or pinned is None or guess.failures or context.reporter.expired():
        return attempt, motion
    asked, margin = _peak(context, motion.job.segments), 1 + context.options.gap_target
    rest = _peak(context, [each for each in motion.job.segments if each is not approach])
    off = context.tool_off
    idle = off.objective.at_rest(off.postures.at(np.stack([context.posture, context.first])))
    before = float(idle.max())
    # No job from the scene's posture asks less than it does at rest, before the tool is on or then.
    if asked <= max(margin, 1 + _WORTH_PLANNING) * max(pinned, rest, before, context.reached):
        return attempt, motion
    context.reporter.stage("path")
    context.reporter.step("the approach asks more than the work; trying the scene's posture")
    try:
        stays = sliding_guess(context, search=guess.search, stay=True)
        here, there = (each.problem.parametrization.via_points for each in (stays, guess))
        if np.array_equal(here, there):
            return attempt, motion
        other, lighter = with_retries(replace(attempt, guess=stays), _certified_motion)
    except PlanningError:
        return attempt, motion
    peak = _peak(other.context, lighter.job.segments)
    if margin * peak > asked:
        return attempt, motion
    unit = context.objective.unit
    fallback = (
        f"A start that is better at work is not used: the approach to it would ask {asked:.4g} {unit}, the "
        f"whole job from the scene's posture {peak:.4g} {unit}."
    )
    return replace(other, fallbacks=(*other.fallbacks, fallback)), lighter


def _peak(context: PlanningContext, parts: Sequence[Segment]) -> float:
    """The largest value of the objective over segments."""
    return max(
        largest_objective(context if segment.kind == "stroke" else context.tool_off, segment.trajectory)
        for segment in parts
    )


def _hints(context: PlanningContext, failure: PlanningError, *, automatic: bool) -> Iterator[str]:
    """What would help, and what was not tried."""
    if isinstance(failure, LimitViolation) and (remedy := context.stroke.remedy_for(failure.quantity)):
        yield f"{remedy} may help"
    late = context.reporter.expired()
    if late and "the time" not in str(failure):
        limit = f"{context.options.time_limit_s:g} s (planner.time_limit_s)"
        yield f"then the time, {limit}, was over"
    if "the time was over" in str(failure):
        return  # what is not met yet says nothing of the legs
    if context.task.path.open_legs:
        return  # ever longer times were tried
    tried = context
    for _ in range(_TRIALS):
        factors = slower_legs(tried, failure)
        if factors is None:
            return
        tried = slower(tried, factors)
        legs = in_keys(context, tried)
        if not late:
            context.reporter.step(f"trying {legs}")
            try:
                _search(replace(tried, reporter=context.reporter.quiet()), automatic=automatic)
            except PlanningError as again:
                failure, late = again, context.reporter.expired()
            else:
                yield f"{legs} would do"
                return
        if late:
            yield f"{legs} may do"
            return


def _plan(scene: Scene, made: Sequence[tuple[Attempt, _Motion]], *, custom: bool) -> Plan:
    """Return the plan of a job's motions, beside the baseline."""
    context = made[0][0].context
    strokes, at = list[StrokePlan](), None
    for attempt, motion in made:
        strokes.append(_stroke_plan(attempt, motion, at, custom=custom))
        at = strokes[-1].baseline.q[-1]
    shares = [attempt.guess.search.step_share for attempt, _ in made if attempt.guess.search is not None]
    return Plan.of(
        strokes,
        context.clearances,
        scene=_as_planned(scene, [attempt.context for attempt, _ in made]),
        options=replace(context.options, step_share=min(shares)) if shares else context.options,
        robot=context.robot,
        job=Job(segments=tuple(segment for _, motion in made for segment in motion.job.segments)),
        sag=context.sag,
        fallbacks=tuple(_all_fallbacks(made)),
        seconds=Seconds(**context.reporter.seconds()),
    )


def _as_planned(scene: Scene, contexts: Sequence[PlanningContext]) -> Scene:
    """The scene with the number of via-points and the time laws that each stroke was planned with."""
    changes: list[dict[str, Any]] = [{} for _ in contexts]
    for stroke, context, changed in zip(scene.each_stroke, contexts, changes, strict=True):
        if len(context.times) != stroke.via_points:
            changed["via_points"] = len(context.times)
        if context.stroke.file.time_laws != stroke.time_laws:
            changed["time_laws"] = context.stroke.file.time_laws
    if not any(changes):
        return scene
    if scene.strokes is None:
        return replace(scene, **changes[0])
    strokes = (each.model_copy(update=new) for each, new in zip(scene.strokes, changes, strict=True))
    return replace(scene, strokes=tuple(strokes))


def _stroke_plan(attempt: Attempt, motion: _Motion, at: FloatArray | None, *, custom: bool) -> StrokePlan:
    """What is planned of a stroke, beside the baseline from the posture `at` (n,), by default the scene's."""
    context, guess, options = attempt.context, attempt.guess, attempt.context.options
    # The comparison is with the paper's motion from the scene's own posture, obstacles or not.
    path = follow_path(
        context if at is None else _starting_near(context, at),
        stop_at_obstacles=False,
        report=partial(context.reporter.part, "following the tool path as the baseline does"),
    )
    baseline = measure(
        context.robot, context.task, context.clearances, path.t, path.motion(), clearance=path.clearance
    )
    baseline_figures = figures(context.robot, baseline)
    bound = guess.lower_bound if guess.search is not None else None
    if bound is not None and context.sag is None:
        at_rest = context.objective.at_rest(context.postures.at(motion.optimised.via_points))
        bound = bound.met(at_rest)
    objective = objective_metrics(
        context.objective,
        options,
        own=custom,
        baseline=(baseline_figures, baseline),
        planned=(motion.work.figures, motion.work.trajectory),
        floor=None if bound is None else bound.value,
    )
    return StrokePlan(
        name=context.stroke.name,
        task=context.task,
        start=motion.start,
        baseline=baseline,
        baseline_figures=baseline_figures,
        drift=float(path.drift.max()),
        smallest_singular_value=float(path.singular_value.min()),
        passes=motion.optimised.passes,
        objective=objective,
        lower_bound=bound,
        choice=guess.choice,
        compensation=motion.compensation,
        quieting=motion.quieting,
    )


def _starting_near(context: PlanningContext, q: FloatArray) -> PlanningContext:
    """The context of a stroke that starts in the admissible posture nearest to `q` (n,)."""
    try:
        return starting_at_path(replace(context, posture=q))
    except PathNotFound:
        # What was planned starts in one.
        return context


def _quiets(options: PlannerOptions) -> bool:
    return options.knots == "sliding" and options.quiet_modes > 0


def _all_fallbacks(made: Sequence[tuple[Attempt, _Motion]]) -> Iterator[str]:
    for attempt, motion in made:
        of = f"Stroke {attempt.context.stroke.name}: " if len(made) > 1 else ""
        for fallback in _fallbacks(attempt, motion):
            yield of + fallback


def _fallbacks(attempt: Attempt, motion: _Motion) -> Iterator[str]:
    """What failed, or was left out, on the way to a motion."""
    yield from attempt.fallbacks
    context, optimised = attempt.context, motion.optimised
    limit = f"{context.options.time_limit_s:g} s (planner.time_limit_s)"
    if not optimised.complete:
        expired = context.reporter.expired()
        why = f"Stopped after {limit}" if expired else "The last stage of the optimisation failed"
        yield f"{why}: the best motion so far."
    if context.arm is not None and _quiets(context.options) and motion.quieting is None:
        yield f"The vibration at the ends of the legs is not suppressed: the time, {limit}, was over."
    if why := optimised.whole_because:
        yield f"The path was optimised as a whole, as a segment failed ({why}): that took longer."


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """The optimised and certified motion of a job."""

    optimised: Optimised
    compensation: Compensation | None
    quieting: VibrationSuppression | None
    start: Start
    job: Job

    @property
    def work(self) -> Segment:
        return self.job.strokes[0]

    @property
    def approach(self) -> Segment | None:
        first = self.job.segments[0]
        return first if first.kind == "free" else None


def _return(context: PlanningContext, before: tuple[Segment, ...]) -> Segment | None:
    """The return of a job after what is planned of it."""
    if context.end_posture is None:
        return None
    context.reporter.step("planning the return")
    work, allowed = before[-1], max(context.reached, _peak(context, before))
    return plan_return(context, work.trajectory.q[-1], begin=work.end, allowed=allowed)


def _certified_motion(attempt: Attempt) -> _Motion:
    context, guess = attempt.context, attempt.guess
    reporter, options = context.reporter, context.options
    reporter.stage("optimise")

    # Every segment of a long path may have as many.
    most = options.max_passes * len(segments(guess.problem))

    def each_pass(report: ExchangeReport, rounds: int = 0) -> None:
        reporter.passed(report, context.objective.unit, most, rounds=rounds, most_rounds=MOST_ROUNDS)

    compensation = quieting = None
    with constraints_named(context):
        problem = guess.problem
        with leaps_told(context, problem.parametrization.via_points):
            optimised = optimise(problem, each_pass)
        if context.sag is not None:
            optimised, compensation, problem = compensate(context, guess, optimised, context.sag, each_pass)
    if context.arm is not None and _quiets(options):
        optimised, quieting = suppress_vibration(context.arm, problem, optimised)

    reporter.stage("certify")
    posture = optimised.trajectory.q[0]
    moved = float(np.abs(context.robot.metric.coordinates(posture - context.posture)).max())
    certificate = certify(
        context.robot,
        context.task,
        optimised.trajectory,
        context.clearances,
        options,
        via_points=len(context.times),
        start=context.posture if moved <= SAME_POSTURE else None,
        sag=context.sag,
    )
    if optimised.failure is not None and not certificate.holds:
        raise optimised.failure
    certificate.require()
    approach: Segment | None = None
    if moved <= SAME_POSTURE:
        posture, moved = context.posture, 0.0
    elif guess.search is not None or context.first is not context.posture:
        reporter.step("planning the approach to the start")
        at_rest = context.objective.at_rest(context.postures.at(optimised.trajectory.q))
        chart = context.first[None] if guess.search is None else guess.search.first_chart.q
        approach = plan_approach(context, posture, chart, way=guess.way, allowed=float(at_rest.max()))
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
    return _Motion(
        optimised=optimised,
        compensation=compensation,
        quieting=quieting,
        start=Start(posture=posture, moved=moved, failures=guess.failures),
        job=Job(segments=(*before, work, *after)),
    )
