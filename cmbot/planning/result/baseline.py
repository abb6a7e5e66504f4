"""The baseline of a job: that along every stroke, the quickest straight joint motions between them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Literal

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.planning.certification.metrics import MotionMetrics, Samples, figures, measure
from cmbot.planning.free_motion.return_move import SAME_POSTURE
from cmbot.planning.free_motion.straight_move import quickest_straight
from cmbot.planning.job import (
    RETURN,
    BaselineSegment,
    Timeline,
    at_work,
    force_share,
    free_move_name,
    job_metrics,
    stands_of,
)
from cmbot.planning.result.stroke_plan import StrokeBaseline, StrokePlan
from cmbot.planning.task import ToolTask
from cmbot.robot import Robot
from cmbot.trajectory import SAMPLE_STEP


@dataclass(frozen=True, kw_only=True)
class Baseline(StrokeBaseline, Timeline[BaselineSegment]):
    """The baseline of a job.

    What a `StrokeBaseline` says of its stroke, this says of all of them: its samples lead from the first
    stroke to the last one, its figures are those of the strokes.

    Attributes
    ----------
    segments : tuple of BaselineSegment
        Of the whole job, from where the arm is to where it ends.
    """

    segments: tuple[BaselineSegment, ...]

    @cached_property
    def job_figures(self) -> MotionMetrics:
        """Figures of the whole job."""
        return job_metrics(self.segments)

    @property
    def work(self) -> tuple[BaselineSegment, ...]:
        """What lies between the beginning of the first stroke and the end of the last one."""
        return tuple(at_work(self.segments))


def baseline_of(
    robot: Robot,
    clearances: Clearances,
    strokes: Sequence[StrokePlan],
    start: FloatArray,
    end: FloatArray | None,
) -> Baseline | None:
    """Return the baseline of a whole job; None where its strokes have none.

    Between the strokes it takes the quickest straight joint motions within the limits of velocity,
    acceleration and jerk, every 0.01 s; torques and collisions are ignored.

    Parameters
    ----------
    robot : Robot
    clearances : Clearances
    strokes : sequence of StrokePlan
        With the baseline along each, or without any.
    start : (n,), rad, of joints that slide m
        Where the arm is before the job.
    end : (n,) or None
        Where it goes after the last stroke; None: nowhere.
    """
    each = [stroke.baseline for stroke in strokes if stroke.baseline is not None]
    if not each:
        return None
    segments, at, begin = list[BaselineSegment](), start, 0.0

    def move(name: str, goal: FloatArray, task: ToolTask) -> None:
        if np.abs(goal - at).max() <= SAME_POSTURE:
            return
        t, motion = quickest_straight(robot.limits, at, goal, SAMPLE_STEP, stands_of(name, robot.tool_ramp))
        share = force_share(robot, t, float(t[-1]), name)
        samples = measure(robot, task.held_at_start(), clearances, t, motion, share=share)
        add(name, "free", samples, figures(robot.tool_off, samples))

    def add(name: str, kind: Literal["stroke", "free"], samples: Samples, measured: MotionMetrics) -> None:
        nonlocal begin
        segments.append(BaselineSegment(name=name, kind=kind, begin=begin, samples=samples, figures=measured))
        begin = segments[-1].end

    for number, (stroke, along) in enumerate(zip(strokes, each, strict=True)):
        move(free_move_name(number), along.samples.q[0], stroke.task)
        add(stroke.name, "stroke", along.samples, along.figures)
        at = along.samples.q[-1]
    if end is not None:
        move(RETURN, end, strokes[-1].task)
    return _joined(segments, each)


def _joined(segments: Sequence[BaselineSegment], each: Sequence[StrokeBaseline]) -> Baseline:
    """The baseline of a job of these segments, from what is known along `each` of its strokes."""
    work = at_work(segments)
    samples, figures_of_strokes = each[0].samples, each[0].figures
    if len(each) > 1:
        begin = work[0].begin
        samples, _ = joined_samples(
            (part.name, part.begin - begin, part.samples, part.kind == "stroke") for part in work
        )
        figures_of_strokes = job_metrics([part for part in work if part.kind == "stroke"], begin)
    return Baseline(
        samples=samples,
        figures=figures_of_strokes,
        drift=max(along.drift for along in each),
        smallest_singular_value=min(along.smallest_singular_value for along in each),
        segments=tuple(segments),
    )


def joined_samples(each: Iterable[tuple[str, float, Samples, bool]]) -> tuple[Samples, tuple[str, ...]]:
    """Return samples that follow on each other as one, and of which each of them is, by their names.

    Parameters
    ----------
    each : iterable of (str, float, Samples, bool)
        Their name, when each begins on the common clock, s, and whether it keeps its samples at both ends: of
        two that share a join, the one that keeps its own has it there, else the one that ends there.
    """
    parts = list(each)
    kept = list[slice]()
    for k, (_, _, samples, keeps) in enumerate(parts):
        yields_first = k > 0 and (not keeps or parts[k - 1][3])
        yields_last = k + 1 < len(parts) and not keeps and parts[k + 1][3]
        kept.append(slice(int(yields_first), len(samples.t) - int(yields_last)))
    joined: dict[str, FloatArray | None] = {}
    for field in fields(Samples):
        arrays = [getattr(samples, field.name) for _, _, samples, _ in parts]
        if field.name == "t":
            arrays = [begin + samples.t for _, begin, samples, _ in parts]
        known = [array[part] for array, part in zip(arrays, kept, strict=True) if array is not None]
        joined[field.name] = np.concatenate(known) if len(known) == len(parts) else None
    names = np.repeat([name for name, *_ in parts], [part.stop - part.start for part in kept])
    return Samples(**joined), tuple(names.tolist())  # type: ignore[arg-type]
