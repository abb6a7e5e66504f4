"""The plan of a job, composed of what was planned of its strokes, beside the baseline."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.certification.metrics import figures, measure
from cmbot.planning.context import PlanningContext
from cmbot.planning.flexibility.sag_compensation import Compensation
from cmbot.planning.flexibility.vibration_suppression import VibrationSuppression
from cmbot.planning.job import Job, Segment
from cmbot.planning.path.first_posture import starting_at_path
from cmbot.planning.path.gradient_projection import follow_path
from cmbot.planning.result.plan import Plan, Seconds
from cmbot.planning.result.stroke_plan import Start, StrokePlan, objective_metrics
from cmbot.planning.retries import Attempt
from cmbot.planning.torque import Optimised
from cmbot.scene import SAME_PLACE, PlannerOptions, Scene

__all__ = ["StrokeMotion", "composed", "suppresses_vibration"]


@dataclass(frozen=True, kw_only=True)
class StrokeMotion:
    """The optimised and certified motion of a stroke, with the free moves that go with it."""

    optimised: Optimised
    compensation: Compensation | None
    suppression: VibrationSuppression | None
    start: Start
    job: Job

    @property
    def work(self) -> Segment:
        """The stroke itself."""
        return self.job.strokes[0]

    @property
    def approach(self) -> Segment | None:
        """The free move to its start, if there is one."""
        first = self.job.segments[0]
        return first if first.kind == "free" else None


def composed(scene: Scene, made: Sequence[tuple[Attempt, StrokeMotion]], *, custom: bool) -> Plan:
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
    for stroke, context, changed in zip(scene.strokes, contexts, changes, strict=True):
        if len(context.times) != stroke.via_points:
            changed["via_points"] = len(context.times)
        if context.stroke.file.time_laws != stroke.time_laws:
            changed["time_laws"] = context.stroke.file.time_laws
    if not any(changes):
        return scene
    pairs = zip(scene.strokes, changes, strict=True)
    return scene.with_strokes([stroke.changed(**new) for stroke, new in pairs], scene.order)


def _stroke_plan(
    attempt: Attempt, motion: StrokeMotion, at: FloatArray | None, *, custom: bool
) -> StrokePlan:
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
        suppression=motion.suppression,
    )


def _starting_near(context: PlanningContext, q: FloatArray) -> PlanningContext:
    """The context of a stroke that starts in the admissible posture nearest to `q` (n,)."""
    try:
        return starting_at_path(replace(context, posture=q))
    except PathNotFound:
        # What was planned starts in one.
        return context


def suppresses_vibration(options: PlannerOptions) -> bool:
    """Say whether options ask for motions that leave little vibration."""
    return options.knots == "sliding" and options.quiet_modes > 0


def _all_fallbacks(made: Sequence[tuple[Attempt, StrokeMotion]]) -> Iterator[str]:
    for attempt, motion in made:
        of = f"Stroke {attempt.context.stroke.name}: " if len(made) > 1 else ""
        for fallback in _fallbacks(attempt, motion):
            yield of + fallback


def _fallbacks(attempt: Attempt, motion: StrokeMotion) -> Iterator[str]:
    """What failed, or was left out, on the way to a motion."""
    yield from attempt.fallbacks
    context, optimised = attempt.context, motion.optimised
    if merged := context.stroke.file.merged:
        is_ = "waypoint is" if merged == 1 else "waypoints are"
        yield f"{merged} {is_} merged with the one before, less than {1e3 * SAME_PLACE:g} mm away."
    limit = f"{context.options.time_limit_s:g} s (planner.time_limit_s)"
    if not optimised.complete:
        expired = context.reporter.expired()
        why = f"Stopped after {limit}" if expired else "The last stage of the optimisation failed"
        yield f"{why}: the best motion so far."
    if context.arm is not None and suppresses_vibration(context.options) and motion.suppression is None:
        yield f"The vibration at the ends of the legs is not suppressed: the time, {limit}, was over."
    if why := optimised.whole_because:
        yield f"The path was optimised as a whole, as a segment failed ({why}): that took longer."
