"""The plan of a job, composed of what was planned of its strokes, beside its baseline if any."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.common.reading.validation import counted
from cmbot.planning.attempts.stroke import PlannedStroke
from cmbot.planning.certification.metrics import figures, measure
from cmbot.planning.job import Job
from cmbot.planning.path.first_posture import starting_at_path
from cmbot.planning.path.gradient_projection import follow_path
from cmbot.planning.request import StrokeRequest
from cmbot.planning.result.plan import Plan, Seconds
from cmbot.planning.result.stroke_plan import (
    StrokeBaseline,
    StrokePlan,
    baseline_task,
    objective_metrics,
)
from cmbot.scene import Scene
from cmbot.toolpath import SAME_PLACE


def composed(scene: Scene, made: Sequence[PlannedStroke], *, custom: bool) -> Plan:
    """Return the plan of a job's motions, beside a baseline where one is asked for."""
    motions = [stroke.trial.result for stroke in made]
    request = motions[0].request
    # What follows stops nothing: it only says what was planned.
    stopped = next((mark for motion in motions if (mark := motion.request.deadline.mark)), None)
    strokes, at = list[StrokePlan](), None
    for stroke in made:
        strokes.append(_stroke_plan(stroke, at, custom=custom))
        if (baseline := strokes[-1].baseline) is not None:
            at = baseline.samples.q[-1]
    shares = [motion.guess.search.step_share for motion in motions if motion.guess.search is not None]
    return Plan.of(
        strokes,
        request.cell.clearances,
        scene=_as_planned(scene, [motion.request for motion in motions]),
        options=replace(request.cell.options, step_share=min(shares)) if shares else request.cell.options,
        robot=request.cell.robot,
        job=Job(segments=tuple(segment for motion in motions for segment in motion.job.segments)),
        sag=request.cell.sag,
        fallbacks=tuple(_all_fallbacks(made, stopped=stopped is not None)),
        stopped=stopped,
        seconds=Seconds(**request.reporter.seconds()),
    )


def _as_planned(scene: Scene, requests: Sequence[StrokeRequest]) -> Scene:
    """The scene with the number of via-points and the time laws that each stroke was planned with."""
    changes: list[dict[str, Any]] = [{} for _ in requests]
    for stroke, request, changed in zip(scene.strokes, requests, changes, strict=True):
        if len(request.times) != stroke.via_points:
            changed["via_points"] = len(request.times)
        if request.stroke.file.time_laws != stroke.time_laws:
            changed["time_laws"] = request.stroke.file.time_laws
    if not any(changes):
        return scene
    pairs = zip(scene.strokes, changes, strict=True)
    return scene.with_strokes([stroke.changed(**new) for stroke, new in pairs], scene.order)


def _stroke_plan(stroke: PlannedStroke, at: FloatArray | None, *, custom: bool) -> StrokePlan:
    """What is planned of a stroke, beside a baseline from the posture `at` (n,), by default the scene's."""
    motion = stroke.trial.result
    request, guess, options = motion.request, motion.guess, motion.request.cell.options
    baseline = None
    if options.baseline != "none":
        baseline = _baseline(request if at is None else _starting_near(request, at))
    # Of travel no peak is sought.
    is_bounded = guess.search is not None and options.objective != "travel"
    bound = guess.lower_bound if is_bounded else None
    if bound is not None and request.cell.sag is None:
        at_rest = request.cell.objective.at_rest(request.cell.postures.at(motion.optimised.via_points))
        bound = bound.met(at_rest)
    objective = objective_metrics(
        request.cell.objective,
        options,
        own=custom,
        baseline=baseline,
        planned=(motion.work.figures, motion.work.trajectory),
        floor=None if bound is None else bound.value,
    )
    return StrokePlan(
        name=request.stroke.name,
        task=request.task,
        start=motion.start,
        baseline=baseline,
        passes=motion.optimised.passes,
        objective=objective,
        lower_bound=bound,
        choice=guess.choice if is_bounded else None,
        compensation=motion.compensation,
        runs=stroke.runs,
    )


def _baseline(request: StrokeRequest) -> StrokeBaseline:
    """The motion without optimisation along a stroke, from the posture of a request, obstacles or not."""
    cell = request.cell
    request = replace(request, task=baseline_task(request.task, request.stroke.file, cell.options))
    if cell.options.baseline == "straight":
        request = request.with_options(avoidance_gain=0.0, centre_of_gravity_weight=0.0)
    path = follow_path(
        request,
        stop_at_obstacles=False,
        report=partial(request.reporter.part, "following the tool path as the baseline does"),
    )
    samples = measure(
        cell.robot, request.task, cell.clearances, path.t, path.motion(), clearance=path.clearance
    )
    return StrokeBaseline(
        samples=samples,
        figures=figures(cell.robot, samples),
        drift=float(path.drift.max()),
        smallest_singular_value=float(path.singular_value.min()),
    )


def _starting_near(request: StrokeRequest, q: FloatArray) -> StrokeRequest:
    """The request of a stroke that starts in the admissible posture nearest to `q` (n,)."""
    try:
        return starting_at_path(replace(request, state=replace(request.state, posture=q)))
    except PathNotFound:
        # What was planned starts in one.
        return request


def _all_fallbacks(made: Sequence[PlannedStroke], *, stopped: bool) -> Iterator[str]:
    for stroke in made:
        of = f"Stroke {stroke.trial.result.request.stroke.name}: " if len(made) > 1 else ""
        for fallback in _fallbacks(stroke, stopped=stopped):
            yield of + fallback
    if stopped and all(stroke.trial.result.optimised.complete for stroke in made):
        limit = made[0].trial.result.request.deadline.in_words
        was_over = "was over before all was tried: more time may find a better motion"
        yield f"{limit[0].upper()}{limit[1:]}, {was_over}."


def _fallbacks(stroke: PlannedStroke, *, stopped: bool) -> Iterator[str]:
    """What failed, or was left out, on the way to a motion."""
    yield from stroke.trial.told
    motion = stroke.trial.result
    request, optimised = motion.request, motion.optimised
    if merged := request.stroke.file.merged:
        is_ = "waypoint is" if merged == 1 else "waypoints are"
        yield f"{merged} {is_} merged with the one before, less than {1e3 * SAME_PLACE:g} mm away."
    rests = len(request.stroke.path.segments) // (request.stroke.file.passes or 1) - 1
    if request.stroke.file.waypoints and rests:
        yield f"It rests at {counted(rests, 'waypoint')}, corners and turns in place (corner_deg)."
    if not optimised.complete:
        limit = request.deadline.in_words
        why = f"Stopped as {limit}, was over" if stopped else "The last stage of the optimisation failed"
        yield f"{why}: the best motion so far."
    number, asked = len(stroke.trial.chain[0].attempt.request.times), request.stroke.via_points
    if number != asked:
        yield f"{number} via-points in place of {asked}, for up to four in a period of the slowest mode."
    if (timing := stroke.trial.attempt.timing) is not None and timing.both is not None:
        yield (
            "As predicted, the shortest time of the legs is {:.4g} s within the limits (speed_profile.kind: "
            "shortest), {:.4g} s with quiet laws.".format(*timing.both)
        )
    if request.least_travel:
        name, least = request.cell.objective.name, 100 * request.cell.options.min_gain
        yield (
            f"The {name} at rest has less than {least:.3g} % to gain, in its peak and its mean "
            "(planner.min_gain): the joints travel least instead."
        )
    if (more := stroke.trial.attempt.more_time) is not None:
        yield (
            f"Leg {more.leg + 1} takes {more.seconds:.3g} s, {more.periods:.1f} periods of the slowest mode: "
            f"in {more.longer:.3g} s the tool would sway and swing by {1e3 * more.less:.2g} mm in place of "
            f"{1e3 * more.sway:.2g} mm, as predicted."
        )
    if why := optimised.whole_because:
        yield f"The path was optimised as a whole, as a segment failed ({why}): that took longer."
