"""The verdict on a plan: what the base must bear over the whole job, and how near its promises are."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.limit import Limit
from cmbot.common.validation import counted
from cmbot.planning.certification.check import Check
from cmbot.planning.job import Job, Segment
from cmbot.planning.request import end_posture_of
from cmbot.planning.result.baseline import Baseline
from cmbot.planning.result.plan import Plan
from cmbot.robot import Dynamics

# Peaks that differ by less, as a share of them, are the same.
_SAME = 1e-3
# A peak lower by less than this share is hardly a gain.
_LITTLE = 1e-2
# A gain below this share is told with what it costs: joints that travel so many times as far, or more.
_SMALL, _FURTHER = 5e-2, 3.0
# A motion of joints by less is none, rad.
_NO_TRAVEL = 1e-6
# Times the tool deviation of a plan: a baseline that strays further follows another path.
_STRAYS = 10.0


def verdict(plan: Plan, *, area: bool = True) -> str:
    """Return in a few sentences where the tool is, what the base must bear, and how near the promises are.

    Parameters
    ----------
    plan : Plan
    area : bool
        Whether it tells what of the rasters is not reached, too; `left_out` does that alone.
    """
    base, job = plan.scene.base_name, plan.job
    peak = job.figures.peak_guardrail_torque
    text = f"The {base} must bear {peak:.1f} Nm over the whole job ({_where(plan)}){_gain(plan)}"
    if len(job.segments) > 1:
        text += f"; the work alone {_at_work(plan)}"
    if area and (missing := left_out(plan)):
        text += f"; {missing}"
    segment, check = tightest_check(job)
    promise = promised(check, f"{during(segment, job)}, at {check.time:.1f} s")
    return f"{accuracy_in_words(plan)}{text}. Tightest promise: {promise}{_room(check)}."


def accuracy_in_words(plan: Plan) -> str:
    """Return in a sentence within how much of its path the tool is, why, and what would help.

    Empty where nothing bends.

    Parameters
    ----------
    plan : Plan
    """
    accuracy, tolerance = plan.accuracy, plan.scene.tool.tolerance
    if accuracy is None:
        return ""
    text = f"The tool is within {accuracy.within_mm:.3g} mm of its path with {100 * accuracy.probability:g} %"
    if accuracy.tolerance_share is not None and tolerance is not None:
        asked = [
            f"{value:g} mm {where}"
            for value, where in (
                (tolerance.across_mm, "across"),
                (tolerance.along_axis_mm, "along the tool's axis"),
            )
            if value is not None
        ]
        kept = "kept" if accuracy.tolerance_kept else "not kept"
        share, least = (f"{100 * x:.3g} %" for x in (accuracy.tolerance_share, accuracy.probability))
        text += f", tolerance {' and '.join(asked)}: {kept} (within it in {share} of cases, asked {least})"
    if accuracy.parts:
        most = accuracy.parts[0]
        text += f"; most of it: {most.name} ({most.size_mm:.3g} mm)"
    if accuracy.remedies:
        with_all = accuracy.remedies[0]
        text += f"; with {with_all.name} it would be {with_all.within_mm:.3g} mm"
    return f"{text}. "


def promised(check: Check, when: str) -> str:
    """Return what a check promises, and how near it is to its bound, in words; `when` as `during` says it."""
    if check.limit is Limit.POSITION and check.holds:
        # A share of how far a joint is from an end of its range says nothing.
        return f"{check.joint} stays within its range {when}"
    return f"{check.quantity} {when}, {100 * bound_use(check):.0f} % of its bound"


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
    return float(metric.lengths(ours)) / max(float(metric.lengths(theirs)), _NO_TRAVEL)


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


def left_out(plan: Plan) -> str:
    """Return in words what of the rasters is not reached; empty where nothing is left out.

    Parameters
    ----------
    plan : Plan
    """
    area, unreached = (
        sum(getattr(one, name) for one in plan.coverage.values()) for name in ("area", "unreached")
    )
    return f"{unreached:.3g} of {area:.3g} m2 are not reached" if unreached else ""


def promises(plan: Plan) -> str:
    """Return in a sentence whether every promise is kept.

    Parameters
    ----------
    plan : Plan
    """
    each = [check for _, check in plan.job.checks()]
    broken = sum(not check.holds for check in each)
    if broken:
        return f"NOT SAFE: {broken} of {len(each)} promises {'is' if broken == 1 else 'are'} broken."
    return f"Every promise is kept: {counted(len(each), 'check')} hold at all times."


def _room(check: Check) -> str:
    """How far a value is from its bound, in words, where its unit is a physical one."""
    factor, unit = 1.0, check.unit
    if unit.startswith("rad"):
        factor, unit = float(np.rad2deg(1.0)), f"deg{unit.removeprefix('rad')}"
    elif unit == "m":
        factor, unit = 1e3, "mm"
    elif unit.startswith("of "):
        return ""
    distance = f"{factor * abs(check.bound - check.value):.3g} {unit}"
    return f" ({distance} left)" if check.holds else f" ({distance} beyond it)"


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
    rates = max(use.velocity, use.acceleration, use.torque) > 1 + _SAME
    if rates or any(bool(((q < limits.lower - _SAME) | (q > limits.upper + _SAME)).any()) for q in each):
        yield "breaks joint limits"
    off = figures.max_tool_deviation
    if strays(plan):
        yield f"leaves its path by {1e3 * baseline.drift:.0f} mm"
    elif off > options.max_tool_deviation_m * (1 + _SAME):
        yield f"leaves its path by {1e3 * off:.1f} mm"
    if max(_rotations(plan)) > np.deg2rad(options.max_tool_rotation_deg) * (1 + _SAME):
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


def tightest_check(job: Job, quantity: str | None = None) -> tuple[Segment, Check]:
    """Return the promise of a job that uses most of its bound, with the segment that makes it.

    Parameters
    ----------
    job : Job
    quantity : str, optional
        Of the promises of that quantity alone, which every segment makes.
    """
    some = (each for each in job.checks() if quantity in (None, each[1].quantity))
    return max(some, key=lambda each: bound_use(each[1]))


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


def _where(plan: Plan) -> str:
    """Where the torque of a job is largest: in the posture at an end, at rest, or during a segment."""
    peak = plan.job.figures.peak_guardrail_torque
    ends = [("begins", plan.scene.posture)]
    if (end := end_posture_of(plan.scene, plan.robot)) is not None:
        ends.append(("ends", end))
    for which, q in ends:
        at_rest = Dynamics(plan.robot.tool_off).static_efforts(q[None]).guardrail_torque
        if np.linalg.norm(at_rest) >= (1 - _SAME) * peak:
            return f"at rest in the posture in which the arm {which}"
    segment = max(plan.job.segments, key=lambda each: each.figures.peak_guardrail_torque)
    samples = plan.segment_samples[segment.name]
    time = segment.begin + samples.t[np.linalg.norm(samples.guardrail_torque, axis=1).argmax()]
    return f"{during(segment, plan.job)}, at {time:.1f} s"


def _gain(plan: Plan) -> str:
    """How the peak over the whole job compares with the baseline's, where that keeps the limits."""
    if plan.baseline is None:
        return ""
    peak, before = (
        figures.peak_guardrail_torque for figures in (plan.job.figures, plan.baseline.job_figures)
    )
    if faults := baseline_faults(plan):
        return f"; no gain is stated, as the baseline ({before:.1f} Nm) {faults}"
    text = f", {_compared(peak, before)}"
    if _SAME < 1 - peak / before < _LITTLE:
        return f"{text}: hardly anything is gained"
    if _LITTLE <= 1 - peak / before < _SMALL and (factor := further(plan)) >= _FURTHER:
        return f"{text}, with joints that travel {factor:.1f} times as far at work"
    return text


def _at_work(plan: Plan) -> str:
    work = plan.figures.peak_guardrail_torque
    if plan.baseline is None:
        return f"{work:.1f} Nm"
    before = plan.baseline.figures.peak_guardrail_torque
    if baseline_faults(plan) and not baseline_faults(plan, work=True):
        # It is in its free moves that the baseline breaks a limit.
        return f"{work:.1f} Nm, {_compared(work, before)}"
    return f"{work:.1f} Nm (baseline {before:.1f} Nm)"


def _compared(peak: float, baseline: float) -> str:
    change = peak / baseline - 1.0
    if abs(change) <= _SAME:
        return "as much as the baseline"
    more = "more" if change > 0 else "less"
    return f"{100 * abs(change):.1f} % {more} than the baseline's {baseline:.1f} Nm"
