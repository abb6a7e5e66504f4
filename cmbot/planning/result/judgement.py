"""How near the promises of a plan are, and whether the baseline is one that a plan may be compared with."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.limit import Limit
from cmbot.planning.certification.check import Check
from cmbot.planning.job import Job, Segment
from cmbot.planning.result.baseline import Baseline
from cmbot.planning.result.plan import Plan

SAME = 1e-3
"""Peaks that differ by less, as a share of them, are the same."""

# A motion of joints by less is none, rad.
_ZERO_TRAVEL = 1e-6
# Times the tool deviation of a plan: a baseline that strays further follows another path.
_STRAYS = 10.0


def further(plan: Plan) -> float:
    """Return how many times as far as the baseline's the joints travel along the strokes; 1 without one.

    Parameters
    ----------
    plan : Plan
    """
    if plan.baseline is None:
        return 1.0
    ours, theirs = travels(plan, plan.baseline)
    metric = plan.robot.metric
    return float(metric.lengths(ours)) / max(float(metric.lengths(theirs)), _ZERO_TRAVEL)


def travels(plan: Plan, baseline: Baseline) -> tuple[FloatArray, FloatArray]:
    """Return how far each joint travels along the strokes, (n,), rad, of joints that slide m.

    From knot to knot of the plan, and from sample to sample of the baseline.

    Parameters
    ----------
    plan : Plan
    baseline : Baseline
        Of that plan.
    """
    planned = [stroke.trajectory.q for stroke in plan.job.strokes]
    ours, theirs = (
        np.sum([np.abs(np.diff(q, axis=0)).sum(axis=0) for q in motion], axis=0)
        for motion in (planned, [segment.samples.q for segment in baseline.strokes])
    )
    return ours, theirs


def baseline_faults(plan: Plan, *, work: bool = False) -> str:
    """Return why no gain on the baseline is stated, in words after it.

    Empty where it keeps the limits, and without a baseline.

    A motion that collides, breaks the limits of joints, or is beside its path is none that a plan could be
    preferred to.

    Parameters
    ----------
    plan : Plan
    work : bool
        Of the strokes alone; else of the whole job, free moves included.
    """
    baseline = plan.baseline
    if baseline is None:
        return ""
    faults = [*_faults(plan, baseline, work=work)]
    return " and ".join([", ".join(faults[:-1]), faults[-1]] if faults[1:] else faults)


def _faults(plan: Plan, baseline: Baseline, *, work: bool) -> Iterator[str]:
    figures = baseline.figures if work else baseline.job_figures
    each = [segment.samples.q for segment in (baseline.strokes if work else baseline.segments)]
    limits, options, use = plan.robot.limits, plan.options, figures.limit_use
    if figures.min_clearance < 0:
        yield "collides"
    elif figures.min_clearance < options.safety_margin_m:
        yield "breaks the safety margin"
    # Without jerk: that of its time law has peaks that drives round off.
    rates = max(use.velocity, use.acceleration, use.torque) > 1 + SAME
    if rates or any(bool(((q < limits.lower - SAME) | (q > limits.upper + SAME)).any()) for q in each):
        yield "breaks joint limits"
    off = figures.max_tool_deviation
    if strays(plan):
        yield f"leaves its path by {1e3 * baseline.drift:.0f} mm"
    elif off > options.max_tool_deviation_m * (1 + SAME):
        yield f"leaves its path by {1e3 * off:.1f} mm"
    if max(_rotations(plan)) > np.deg2rad(options.max_tool_rotation_deg) * (1 + SAME):
        yield "turns the tool away"


def _rotations(plan: Plan) -> Iterator[float]:
    """By how much the baseline turns the tool away along each stroke, rad; within a cone it may."""
    for stroke in plan.strokes:
        most = 0.0 if stroke.task.cone is None else stroke.task.cone
        if stroke.baseline is not None:
            yield max(stroke.baseline.figures.max_tool_rotation - most, 0.0)


def strays(plan: Plan) -> bool:
    """Whether the baseline leaves its path by so much that its figures say little."""
    baseline = plan.baseline
    return baseline is not None and baseline.drift > _STRAYS * plan.options.max_tool_deviation_m


def tightest_check(job: Job, limit: Limit | None = None) -> tuple[Segment, Check]:
    """Return the promise of a job that uses most of its bound, with the segment that makes it.

    Parameters
    ----------
    job : Job
    limit : Limit, optional
        Of the promises of what that limits alone.
    """
    some = (each for each in job.checks() if limit in (None, each[1].limit))
    return max(some, key=lambda each: bound_use(each[1]))


def hold_use(job: Job) -> float | None:
    """Return the largest share that feet use of what their safety allows; None where that is not given."""
    return max((bound_use(each) for _, each in job.checks() if each.limit is Limit.HOLD), default=None)


def bound_use(check: Check) -> float:
    """Return the share of its bound that a check's value uses: 1 at the bound, more beyond it."""
    if check.at_least:
        return check.bound / check.value if check.value > 0 else inf
    return check.value / check.bound if check.bound else 0.0


def during(segment: Segment, job: Job) -> str:
    """Return when a segment of a job is, in words: ``at work``, ``along flange``, ``on the approach``."""
    if segment.kind == "stroke":
        return "at work" if len(job.strokes) == 1 else f"along {segment.name}"
    return f"on {segment.in_words}"
