"""Plan a scene: read `plan` as the paper's abstract."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, OptimisationFailed, PathNotFound
from cmbot.common.validation import checked_options, require_type
from cmbot.optimization.exchange import ExchangeReport
from cmbot.optimization.program import StateSamples
from cmbot.planning.approach.approach import Approach, plan_approach
from cmbot.planning.context import PlanningContext, build_context
from cmbot.planning.flexibility.sag_compensation import MOST_ROUNDS, Compensation, compensate
from cmbot.planning.flexibility.vibration_suppression import VibrationSuppression, quiet
from cmbot.planning.initial_guess import InitialGuess, fixed_guess, sliding_guess
from cmbot.planning.objective_metrics import objective_metrics
from cmbot.planning.path.gradient_projection import follow_path
from cmbot.planning.plan import Plan, Seconds, Start
from cmbot.planning.problem_size import require_reasonable_size
from cmbot.planning.progress import Progress, ProgressReporter
from cmbot.planning.retries import followed
from cmbot.planning.solvers import solver_of
from cmbot.planning.tool_reach import require_within_reach
from cmbot.planning.torque.decomposition import Optimised, optimise, segments
from cmbot.planning.verification.baseline import baseline_samples
from cmbot.planning.verification.certificate import Certificate, certificate_grid, certify
from cmbot.planning.verification.metrics import figures
from cmbot.planning.wrench_functions import WrenchFunction
from cmbot.scene import PlannerOptions, Scene
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["checked", "plan"]

# The arm starts in the scene's posture when no joint is further from it than this, rad.
_SAME_POSTURE = 1e-9
# Via-points up to which it is worth waiting for SLSQP where the sparse solver gave up.
_BEARABLE = 100


def plan(
    scene: Scene,
    *,
    options: PlannerOptions | None = None,
    objective: WrenchFunction | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Plan:
    """Plan the motion of a scene's arm.

    With sliding knots, charts of the self-motion and dynamic programming over them give via-points with the
    least torque on the guardrail; with fixed knots, gradient projection gives those of the paper. Quintic
    splines through them are optimised so that the torque stays small and the jerk smooth. The result is
    certified apart from the optimiser, and so is the approach to where it starts.

    Parameters
    ----------
    scene : Scene
    options : PlannerOptions, optional
        In place of the scene's own.
    objective : callable, optional
        A function of the wrench on the guardrail to make small in place of what the options say: from
        wrenches (N, 6) to values (N,), never negative, and gradients (N, 6); see
        `cmbot.planning.WrenchFunction`. A plan directory holds its name only.
    progress : callable, optional
        Called with a `Progress` as the work goes on.

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
        if not (value is None or callable(value)):
            raise InputError("cmbot.plan", key, type(value).__name__, "something to call, or None")
    options = checked(options) if options is not None else scene.planner
    # What the plan holds then says which solver it was made with.
    asked, options = options.solver, replace(options, solver=solver_of(options))
    reporter, clock = ProgressReporter(progress), _Clock()
    # The matrices are small: more threads of linear algebra than one only wait for each other.
    with threadpool_limits(limits=1, user_api="blas"):
        try:
            return _plan(scene, options, objective, reporter, clock)
        except OptimisationFailed as failure:
            bearable = scene.via_points <= _BEARABLE
            if not (failure.undecided and asked == "auto" and options.solver == "sqp" and bearable):
                raise
            reporter.step("sqp gave up; trying slsqp")
            made = _plan(scene, replace(options, solver="slsqp"), objective, reporter, clock)
            gave_up = f"The solver sqp gave up ({failure.reason}): planned with slsqp instead."
            return replace(made, fallbacks=(gave_up, *made.fallbacks))


def _plan(
    scene: Scene,
    options: PlannerOptions,
    own: WrenchFunction | None,
    reporter: ProgressReporter,
    clock: _Clock,
) -> Plan:
    reporter.stage("path")
    context = build_context(scene, options, own, reporter)
    require_reasonable_size(scene, context.robot.dof, options)
    require_within_reach(context)
    way = sliding_guess(context) if options.knots == "sliding" else fixed_guess(context)
    path_seconds = clock.lap()
    try:
        way, work = followed(context, way, partial(_work, context, clock))
    except PathNotFound as failure:
        if way.choice is None or 0 in way.resting:
            raise
        # No approach leads to the better start: the work begins where the arm is.
        reporter.stage("path")
        way = sliding_guess(context, unreached=failure)
        path_seconds += clock.lap()
        way, work = followed(context, way, partial(_work, context, clock))
    # The comparison is with the paper's motion from the scene's own posture, obstacles or not.
    path = follow_path(
        context,
        stop_at_obstacles=False,
        report=partial(reporter.part, "following the tool path as the baseline does"),
    )
    baseline = baseline_samples(context, path)
    baseline_figures = figures(context.robot, baseline)
    made_small = objective_metrics(
        context.objective,
        options,
        own=own is not None,
        baseline=(baseline_figures, StateSamples(baseline.t, baseline.q, baseline.v, baseline.a)),
        planned=(work.certificate.figures, _states(work.optimised.trajectory, options)),
        floor=None if way.floor is None else way.floor.value,
    )
    return Plan(
        scene=scene,
        options=options if way.stage is None else replace(options, step_share=way.stage.step_share),
        robot=context.robot,
        task=context.task,
        start=work.start,
        baseline=baseline,
        baseline_figures=baseline_figures,
        drift=float(path.drift.max()),
        smallest_singular_value=float(path.singular_value.min()),
        trajectory=work.optimised.trajectory,
        certificate=work.certificate,
        passes=work.optimised.passes,
        objective=made_small,
        lower_bound=way.floor,
        choice=way.choice,
        approach=work.approach,
        compensation=work.compensation,
        quieting=work.quieting,
        sag=context.sag,
        fallbacks=_fallbacks(way, work.optimised),
        seconds=Seconds(
            path=path_seconds,
            optimise=work.optimise_seconds,
            certify=work.certify_seconds + clock.lap(),
            total=clock.total(),
        ),
    )


@dataclass(frozen=True, kw_only=True)
class _Work:
    """The optimised and certified motion, and how the arm gets to its start."""

    optimised: Optimised
    compensation: Compensation | None
    quieting: VibrationSuppression | None
    certificate: Certificate
    start: Start
    approach: Approach | None
    optimise_seconds: float
    certify_seconds: float


def _work(context: PlanningContext, clock: _Clock, way: InitialGuess) -> _Work:
    reporter = context.reporter
    reporter.stage("optimise")

    # Every stretch of a long path may have as many.
    most = context.options.max_passes * len(segments(way.problem))

    def each_pass(report: ExchangeReport, rounds: int = 0) -> None:
        reporter.passed(report, context.objective.unit, most, rounds=rounds, most_rounds=MOST_ROUNDS)

    problem, optimised = way.problem, optimise(way.problem, each_pass)
    compensation = quieting = None
    if context.sag is not None:
        optimised, compensation, problem = compensate(context, way, optimised, context.sag, each_pass)
    if context.arm is not None and context.options.knots == "sliding" and context.options.quiet_modes:
        optimised, quieting = quiet(context, context.arm, problem, optimised)
    optimise_seconds = clock.lap()

    reporter.stage("certify")
    robot, task, clearances, options = context.robot, context.task, context.clearances, context.options
    certificate = certify(
        robot,
        task,
        optimised.trajectory,
        optimised.via_points,
        clearances,
        options,
        sag=context.sag,
        tell=partial(reporter.part, "certifying"),
    )
    certificate.require()
    start = _start(context, way, optimised.via_points[0])
    approach = None
    if way.chart is not None and start.moved > _SAME_POSTURE:
        reporter.step("planning the approach to the start")
        approach = plan_approach(context, start.posture, way.chart.q)
    return _Work(
        optimised=optimised,
        compensation=compensation,
        quieting=quieting,
        certificate=certificate,
        start=start,
        approach=approach,
        optimise_seconds=optimise_seconds,
        certify_seconds=clock.lap(),
    )


def _fallbacks(way: InitialGuess, optimised: Optimised) -> tuple[str, ...]:
    done = [way.instead_of] if way.instead_of else []
    if optimised.whole_because:
        why = f"not stretch by stretch, as a stretch failed ({optimised.whole_because}): that took longer."
        done.append(f"The path was optimised as a whole, {why}")
    return tuple(done)


def _states(trajectory: QuinticTrajectory, options: PlannerOptions) -> StateSamples:
    """The planned motion as finely sampled as it is certified."""
    grid = certificate_grid(trajectory, options)
    return StateSamples(grid, *trajectory.states(grid))


def _start(context: PlanningContext, way: InitialGuess, posture: FloatArray) -> Start:
    moved = float(np.abs(posture - context.posture).max())
    if moved <= _SAME_POSTURE:
        posture, moved = context.posture, 0.0
    return Start(posture=posture, moved=moved, failures=way.failures)


def checked(options: PlannerOptions) -> PlannerOptions:
    """Return `options` when every one is within its bounds.

    Raises
    ------
    InputError
        Naming the option, what it is and what it may be.
    """
    return checked_options(PlannerOptions, options, "PlannerOptions")


class _Clock:
    """Wall time, in laps."""

    def __init__(self) -> None:
        self._start = self._lap = time.perf_counter()

    def lap(self) -> float:
        """Seconds since the last lap."""
        now = time.perf_counter()
        seconds, self._lap = now - self._lap, now
        return seconds

    def total(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self._start
