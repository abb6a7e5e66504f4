"""The tables of a plan: its figures beside the baseline's, the tool's first; and the loads of its job."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.limit import Limit
from cmbot.hold import CLAMP_LOAD
from cmbot.planning.result.holding import clamp_in_stop
from cmbot.planning.result.judgement import baseline_faults, further, hold_use
from cmbot.planning.result.plan import Plan

LOAD_HEADINGS = ("", "largest", "unit", "at, s", "during", "share of its limit")
"""Headings of `load_rows`."""

# Areas that differ by less are the same, as a share.
_AREA_TOLERANCE = 1e-6
# Factors from SI to the units of the table.
_UNIT_FACTORS = {"mm": 1e3, "kN": 1e-3, "deg": float(np.rad2deg(1.0)), "%": 1e2}


@dataclass(frozen=True, kw_only=True)
class Row:
    """A line of a plan's table.

    Attributes
    ----------
    label : str
    key : str
        Of the metric, as in ``plan.json`` where that has it.
    unit : str
        Empty where there is none.
    format : str
        Of the values.
    baseline, planned : float or None
        In `unit`; None where there is none.
    modes : two of str
        A word behind each value.
    first : bool
        Whether it is one of the lines that are shown first, at most ten of them.
    """

    label: str
    key: str
    unit: str = ""
    format: str = ".2f"
    baseline: float | None = None
    planned: float | None
    modes: tuple[str, str] = ("", "")
    first: bool = False

    @property
    def cells(self) -> tuple[str, str, str]:
        """Label with unit, the baseline's value and the planned one."""
        before, planned = (
            "-" if value is None else f"{value:{self.format}} {mode}".rstrip()
            for value, mode in zip((self.baseline, self.planned), self.modes, strict=True)
        )
        return f"{self.label}, {self.unit}".removesuffix(", "), before, planned

    @property
    def is_shown_first(self) -> bool:
        """Whether it is `first`, and no peak of the whole job that is the baseline's: see that at work."""
        is_peak = "peak" in self.key and "whole job" in self.label
        return self.first and not (is_peak and self.cells[1] == self.cells[2])


def plan_rows(plan: Plan) -> tuple[Row, ...]:
    """Return the table of a plan, the lines that are shown first at the top.

    Parameters
    ----------
    plan : Plan
    """
    each = [*_tool(plan), *_holding(plan), *_base(plan), *_work(plan), *_effort(plan), *_search(plan)]
    return tuple(sorted(each, key=lambda row: not row.first))


def _row(
    label: str, key: str, unit: str, format: str, planned: Any, baseline: Any = None, **more: Any
) -> Row:
    """A row from values in SI."""
    factor = _UNIT_FACTORS.get(unit, 1.0)
    shown = [None if value is None else factor * float(value) for value in (baseline, planned)]
    return Row(label=label, key=key, unit=unit, format=format, baseline=shown[0], planned=shown[1], **more)


def _tool(plan: Plan) -> Iterator[Row]:
    """Where the tool is."""
    accuracy, compensation = plan.accuracy, plan.compensation
    if accuracy is not None:
        name = f"tool off its path, all errors counted, with {100 * accuracy.probability:g} %"
        yield _row(name, "accuracy.within_mm", "mm", ".3g", 1e-3 * accuracy.within_mm, first=True)
    before, after = (off if off is not None and np.isfinite(off) else None for off in plan.bent_offsets)
    if after is not None:
        name = "bent tool off its path, at rest"
        yield _row(name, "bent_offsets", "mm", ".2f", after, before, first=True)
    if (sway := plan.sway) is not None:
        (swayed, swung), swing = plan.baseline_sway or (None, None), 1e-3 * sway.swing_mm
        of = f", stiffness ±{100 * sway.stiffness_share:g} %"
        # Of several, each is integrated alone; `simulate` has what free moves leave, too.
        what = "a stroke, free moves left out" if plan.several else "the work"
        yield _row(f"tool swings after {what}{of}", "sway.swing_mm", "mm", ".3f", swing, swung, first=True)
        # A process force that sets in sways the tool by more than it swings at last.
        name, size, first = f"largest sway at work{of}", 1e-3 * sway.sway_mm, plan.robot.pushed
        yield _row(name, "sway.sway_mm", "mm", ".3f", size, swayed, first=first)
        if sway.unshaped_sway_mm is not None and sway.unshaped_swing_mm is not None:
            alone, swing = 1e-3 * sway.unshaped_sway_mm, 1e-3 * sway.unshaped_swing_mm
            yield _row("sway by speed_profile alone", "sway.unshaped_sway_mm", "mm", ".3f", alone)
            yield _row("swing by speed_profile alone", "sway.unshaped_swing_mm", "mm", ".3f", swing)
    if compensation is not None:
        shift, deviation = compensation.largest_shift, compensation.deviation
        yield _row("joints aim beside the path", "compensation.largest_shift", "mm", ".2f", shift)
        if deviation:
            name = "standard deviation by the identified stiffness"
            yield _row(name, "compensation.deviation", "mm", ".2f", deviation)
    yield from _metrics(
        plan,
        ("largest tool deviation", "max_tool_deviation", "mm", ".3f", accuracy is None),
        ("largest tool rotation", "max_tool_rotation", "deg", ".3f", False),
    )
    for stroke, segment in zip(plan.strokes, plan.job.strokes, strict=True):
        parts, of = stroke.task.path.process_parts, f" of {stroke.name}" if plan.several else ""
        kept = [check for check in segment.certificate.checks if check.limit is Limit.PROCESS_SPEED]
        if stroke.task.speed_tolerance is not None and len(parts) and kept:
            yield _row(f"process speed{of}", "process_speed", "m/s", ".4g", parts[:, 2].max())
            name = f"process speed{of} kept within"
            yield _row(name, "certificate", "%", ".2f", kept[0].value)


def _holding(plan: Plan) -> Iterator[Row]:
    """What the feet bear: of the baseline at its samples, of the plan as certified."""
    robot, holding, baseline = plan.robot, plan.robot.holding, plan.baseline
    samples = [] if baseline is None else [segment.samples for segment in baseline.segments]
    wrenches = [np.hstack([each.guardrail_force, each.guardrail_torque]) for each in samples]
    each_held = [np.abs(robot.holding_torque(wrench)).max(axis=0) for wrench in wrenches]
    for number, (joint, peak) in enumerate(zip(robot.holding_joints, plan.holding_torque, strict=True)):
        before = max((float(held[number]) for held in each_held), default=None)
        name = f"torque that the locked {joint.name} holds, whole job"
        yield _row(name, "holding_joints", "Nm", ".1f", float(peak), before)
    if holding is None:
        return
    if (use := hold_use(plan.job)) is not None:
        yield _row("feet use of what their safety allows", "certificate", "%", ".0f", use, first=True)
    for name, planned, other in (
        ("adhesion needed, whole job", plan.job.figures, None if baseline is None else baseline.job_figures),
        ("adhesion needed at work", plan.figures, None if baseline is None else baseline.figures),
    ):
        needed = [None if each is None else each.adhesion_needed for each in (planned, other)]
        if any(needed):
            after, before = (None if each is None else each.peak for each in needed)
            modes, first = tuple("" if each is None else each.mode for each in needed[::-1]), "whole" in name
            yield _row(name, "adhesion_needed.peak", "kN", ".2f", after, before, modes=modes, first=first)
    if (stop := plan.emergency_stop) is not None:
        name, modes = "adhesion needed in an emergency stop", ("", stop.mode)
        yield _row(name, "emergency_stop", "kN", ".2f", stop.peak, modes=modes)
    for number in holding.clamps:
        quantity = holding.named(CLAMP_LOAD, number)
        used = max((float(holding.use(number, wrench).max()) for wrench in wrenches), default=None)
        worst = max(check.value for _, check in plan.job.checks() if check.quantity == quantity)
        name = f"{quantity} included, whole job, share of its bounds"
        yield _row(name, "certificate", "", ".3f", worst, used)
        name = f"{quantity} included, in an emergency stop, share of its bounds"
        yield _row(name, "emergency_stop", "", ".3f", clamp_in_stop(plan.scene, plan.robot, plan.job, number))


def _base(plan: Plan) -> Iterator[Row]:
    """What the base bears."""
    base, part = plan.scene.base_name, "static" if plan.robot.pushed else "gravity"
    about = about_point(plan)
    yield from _metrics(
        plan,
        (f"peak torque on the {base}{about}, whole job", "peak_guardrail_torque", "Nm", ".2f", True),
        ("peak torque at work", "peak_guardrail_torque", "Nm", ".2f", True),
    )
    for segment in plan.job.segments:
        if segment.kind == "free":
            other = plan.baseline and plan.baseline.segment(segment.name)
            before = other and other.figures.peak_guardrail_torque
            after, key = segment.figures.peak_guardrail_torque, "segments.peak_guardrail_torque"
            yield _row(f"peak torque on {segment.in_words}", key, "Nm", ".2f", after, before)
    yield from _metrics(
        plan,
        ("mean torque, whole job", "mean_guardrail_torque", "Nm", ".2f", False),
        ("mean torque at work", "mean_guardrail_torque", "Nm", ".2f", False),
        ("root mean square torque, whole job", "rms_guardrail_torque", "Nm", ".2f", False),
        (f"peak of its {part} part at work", "peak_static_guardrail_torque", "Nm", ".2f", False),
    )
    most = plan.largest_torque_difference
    # Against a motion that breaks limits no gain is stated.
    if most is not None and not baseline_faults(plan, work=True):
        yield _row("most below the baseline", "largest_torque_difference", "Nm", ".1f", most[0])


def _work(plan: Plan) -> Iterator[Row]:
    """Clearances, places and times."""
    yield from _metrics(plan, ("smallest clearance, whole job", "min_clearance", "mm", ".1f", True))
    if plan.coverage:
        whole, other = plan.whole_coverage, plan.baseline
        # The baseline follows the same rows.
        name, before = f"area covered of {whole.area:.4g} m2", other and whole.covered
        yield _row(name, "coverage.covered", "m2", ".4f", whole.covered, before)
        left_out = whole.left_out - whole.unreached
        if left_out > _AREA_TOLERANCE * whole.area:
            yield _row("area beyond the rows' ends", "coverage.left_out", "m2", ".4f", left_out)
        if area := whole.unreached:
            name = "area that is not reached"
            yield _row(name, "coverage.unreached", "m2", ".4f", area, other and area, first=True)
    before = plan.baseline and plan.baseline.duration
    yield _row("time of the whole job", "job.duration", "s", ".1f", plan.job.duration, before, first=True)
    for segment in plan.job.segments:
        if segment.kind == "free":
            name = f"time of {segment.in_words}"
            yield _row(name, "segments.seconds", "s", ".1f", segment.duration)
    for file, stroke in zip(plan.scene.strokes, plan.job.strokes, strict=True):
        if file.time_laws and file.is_open:
            of = f" of {stroke.name}" if plan.several else ""
            legs = "the leg" if len(file.time_laws) == 1 else f"{len(file.time_laws)} legs"
            seconds = sum(law.duration for law in file.time_laws)
            yield _row(f"shortest time{of}, {legs}", "segments.seconds", "s", ".4g", seconds)


def _effort(plan: Plan) -> Iterator[Row]:
    """What the joints do."""
    other = plan.baseline and plan.baseline.figures.limit_use
    for limit in ("velocity", "acceleration", "jerk", "torque"):
        after, before = getattr(plan.figures.limit_use, limit), other and getattr(other, limit)
        name = f"joint {limit} at work, share of its bound"
        yield _row(name, f"limit_use.{limit}", "", ".3f", after, before)
    if plan.baseline is not None:
        yield _row("joints travel at work, times the baseline's", "travel", "", ".2f", further(plan))


def _search(plan: Plan) -> Iterator[Row]:
    """What no plan can undercut, and what others would have."""
    bound, choice, objective = plan.lower_bound, plan.choice, plan.objective
    if not objective.is_guardrail_torque and plan.options.objective != "travel":
        values = objective.planned_peak, objective.baseline_peak
        yield _objective_row(plan, "peak of what was minimised", "objective.planned_peak", *values)
    if bound is None or choice is None:
        return
    yield _objective_row(plan, "lower bound of the peak at rest", "torque_floor", bound.value)
    if objective.gap is not None:
        yield _row("peak from that", "gap_to_floor", "%", "+.3f", objective.gap)
    pinned, least = plan.options.start == "pinned", plan.least_of_sequences
    if least is not None:
        yield _objective_row(plan, "least peak of sequences of postures (estimate)", "choice", least)
    other, start = (choice.free, "in another posture") if pinned else (choice.pinned, "where the arm is")
    if other is not None and not plan.several and (pinned or plan.start.moved):
        yield _objective_row(plan, f"peak at rest, had it started {start}", "choice", other)


def _objective_row(plan: Plan, label: str, key: str, planned: float, baseline: float | None = None) -> Row:
    """A row of values of the objective with its unit, which custom functions lack."""
    return _row(label, key, plan.objective.shown_unit[1], ".2f", planned, baseline)


def _metrics(plan: Plan, *lines: tuple[str, str, str, str, bool]) -> Iterator[Row]:
    """Rows of metrics, of the whole job where the label says so, else of the work."""
    for label, key, unit, format, first in lines:
        figures, other = plan.figures, plan.baseline and plan.baseline.figures
        if "whole job" in label:
            figures, other = plan.job.figures, plan.baseline and plan.baseline.job_figures
        before = other and getattr(other, key)
        yield _row(label, key, unit, format, getattr(figures, key), before, first=first)


@dataclass(frozen=True, kw_only=True)
class Load:
    """A component of the wrench on the base, or the torque or force of a joint, where it is largest.

    Attributes
    ----------
    name : str
    value : float
        With its sign, in `unit`.
    unit : str
    time : float, s
        On the job's clock.
    segment : str
        Of the job.
    limit : float or None
        What a joint can bear, in `unit`; None of components on the base.
    """

    name: str
    value: float
    unit: str
    time: float
    segment: str
    limit: float | None = None


def loads(plan: Plan) -> tuple[Load, ...]:
    """Return the largest loads of a job: three forces and three torques on the base, and one of each joint.

    They are those of the samples of ``job.csv``. What the arm exerts on the base is about `load_point`, along
    the axes of W.

    Parameters
    ----------
    plan : Plan
    """
    return tuple(_loads(plan))


def load_point(plan: Plan) -> FloatArray:
    """Return the point (3,), m, in W, about which `loads` has torques: the origin of the base's link."""
    return np.array(plan.robot.foot_point)


def about_point(plan: Plan) -> str:
    """Return in words about which point the torque on a base is; empty on a guardrail: about the foot."""
    return "" if plan.scene.on_guardrail else f" about ({', '.join(f'{x:.3g}' for x in load_point(plan))}) m"


def _loads(plan: Plan) -> Iterator[Load]:
    samples, segments = plan.job_samples

    def largest(name: str, values: FloatArray, unit: str, limit: float | None = None) -> Load:
        k = int(np.abs(values).argmax())
        value, time = float(values[k]), float(samples.t[k])
        return Load(name=name, value=value, unit=unit, time=time, segment=segments[k], limit=limit)

    base = plan.scene.base_name
    for what, unit, of in (
        ("force", "N", samples.guardrail_force),
        ("torque", "Nm", samples.guardrail_torque),
    ):
        for k, axis in enumerate("xyz"):
            yield largest(f"{what} on the {base}, {axis}", of[:, k], unit)
        yield largest(f"{what} on the {base}, norm", np.linalg.norm(of, axis=1), unit)
    limits = plan.robot.limits
    for k, joint in enumerate(plan.robot.joints):
        unit = limits.units(k).torque
        what = "force" if limits.prismatic[k] else "torque"
        yield largest(f"{what} of {joint}", samples.joint_torque[:, k], unit, float(limits.torque[k]))


def load_rows(plan: Plan) -> Iterator[tuple[str, ...]]:
    """Yield the loads of a plan as rows of a table below `LOAD_HEADINGS`.

    Parameters
    ----------
    plan : Plan
    """
    for load in loads(plan):
        share = "" if load.limit is None else f"{100 * abs(load.value) / load.limit:.1f} %"
        yield load.name, f"{load.value:.4g}", load.unit, f"{load.time:.2f}", load.segment, share
