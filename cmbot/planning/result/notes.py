"""What should be known of a plan beside its table: notes with a level, a key and values, no sentences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cmbot.accuracy import assumed_in_words
from cmbot.common.limit import Limit
from cmbot.elastic import elastic_base
from cmbot.planning.job import RETURN
from cmbot.planning.precheck import precheck_options
from cmbot.planning.request import end_posture_of
from cmbot.planning.result.baseline import Baseline
from cmbot.planning.result.judgement import (
    SAME,
    baseline_faults,
    bound_use,
    during,
    further,
    hold_use,
    tightest_check,
    travels,
)
from cmbot.planning.result.plan import Plan
from cmbot.planning.workcell.units import mistaken_units, unit_findings
from cmbot.planning.workcell.workcell import held_guardrail, identified_in_words, load_remark, tube_warning
from cmbot.robot import Dynamics, postures_in_words
from cmbot.scene import STOW, start_entry
from cmbot.toolpath import FaceSurface

# A peak lower by less than this share is no gain; a baseline this near to the lower bound leaves none.
_MIN_GAIN_SHARE, _NEAR_BOUND = 1e-2, 1e-2
# Largest error of a lower bound that the search closed, as a share of it.
_CLOSED_GAP_SHARE = 1e-2
# More jerk than so many times the baseline's, and than that share of the limits, may well make the tool sway
# more.
_MUCH_JERK_FACTOR, _LITTLE_JERK = 2.0, 1e-3
# Joints that travel so many times as far as the baseline's are told.
_TOLD_TRAVEL_RATIO = 2.0
# A lift that moves by more may well bend otherwise, m.
_TOLD_SLIDE_M = 0.01
# A lower bound below this share of the peak counts as zero.
_ZERO_BOUND_SHARE = 1e-9
# What a magnet is thought to lose to rust, paint and gaps.
_ADHESION_LOSS_SHARE = 0.2

# Free moves that take so many times as long as the work are told; a rate that is used as far bounds them.
_LONG_FREE_RATIO, _REACHED_SHARE = 1.0, 0.9
# How far from the ends of their ranges joints are in a start that is advised.
_ROOM_DEG, _ROOM_M = 5.0, 0.01
_RATES = (Limit.VELOCITY, Limit.ACCELERATION, Limit.JERK)

Level = Literal["first", "fault", "warning", "note"]


@dataclass(frozen=True, kw_only=True)
class Note:
    """What should be known of a plan.

    Attributes
    ----------
    level : str
        ``first``: where the tool is, whether it holds, what the base bears, what would help; ``fault``: what
        is missing of what was asked, ``warning``, ``note``.
    key : str
        What it is about.
    values : dict
        Numbers, names and, where other parts of the package have sentences, text.
    """

    level: Level
    key: str
    values: dict[str, Any]


def _note(level: Level, key: str, /, **values: Any) -> Note:
    return Note(level=level, key=key, values=values)


def notes(plan: Plan) -> tuple[Note, ...]:
    """Return what should be known of a plan beside its table, in the order of its levels.

    Parameters
    ----------
    plan : Plan
    """
    found = [*_first(plan), *_faults(plan), *_start(plan), *_told(plan), *_objective(plan)]
    if plan.baseline is not None:
        found += _compared(plan, plan.baseline)
    found += [*_faces(plan), *_return(plan), *_bound(plan), *_certified(plan)]
    levels = ("first", "fault", "warning", "note")
    return tuple(sorted(found, key=lambda note: levels.index(note.level)))


def _first(plan: Plan) -> Iterator[Note]:
    """Where the tool is, what holds, what the base bears, what would help."""
    accuracy, tolerance = plan.accuracy, plan.scene.tool.tolerance
    if accuracy is not None:
        values = {
            "within_mm": accuracy.within_mm,
            "probability": accuracy.probability,
            "part": accuracy.parts[0].name if accuracy.parts else None,
            "part_share": accuracy.shares[0] if accuracy.parts else None,
            "assumed": assumed_in_words(accuracy.parts[0].name, plan.scene) if accuracy.parts else None,
            "kept": accuracy.tolerance_kept,
            "share": accuracy.tolerance_share,
            "across_mm": tolerance and tolerance.across_mm,
            "along_axis_mm": tolerance and tolerance.along_axis_mm,
        }
        yield _note("first", "tool", **values)
    else:
        yield _note("first", "rigid_tool", within_mm=1e3 * plan.figures.max_tool_deviation)
    yield from _holds(plan)
    yield _note("first", "base", **_base(plan))
    yield from _free_moves(plan)
    if accuracy is not None and accuracy.remedies:
        best = accuracy.remedies[0]
        # What is asked for and not kept asks what comes next.
        then = best.largest if accuracy.tolerance_kept is False else ""
        yield _note("first", "help", remedy=best.name, within_mm=best.within_mm, then=then)


def _holds(plan: Plan) -> Iterator[Note]:
    holding, needed = plan.robot.holding, plan.job.figures.adhesion_needed
    if holding is None:
        return
    stop = plan.emergency_stop
    values: dict[str, Any] = {"stop_kn": stop and stop.peak / 1e3}
    if needed is not None:
        foot = holding.feet[needed.foot - 1]
        values |= {"needed_kn": needed.peak / 1e3, "mode": needed.mode, "has_kn": None, "foot": needed.foot}
        more = foot.gap == "allowed" and needed.closed > (1 + SAME) * needed.peak
        values["asked"] = holding.magnets_asked(needed)
        values["closed_kn"] = needed.closed / 1e3 if more else None
        values["pressure_mpa"] = needed.peak / (1e6 * foot.contact.area) if foot.contact else 0.0
        values["beyond_magnets"] = needed.peak > foot.most_adhesion > 0
        if foot.adhesion is not None:
            less = (1 - _ADHESION_LOSS_SHARE) * foot.adhesion
            holds = "with safety" if less >= foot.safety * needed.peak else "without safety"
            values |= {"has_kn": foot.adhesion / 1e3, "lost": _ADHESION_LOSS_SHARE}
            values["less"] = holds if less >= needed.peak else "not"
    if (use := hold_use(plan.job)) is not None:
        segment, check = tightest_check(plan.job, limit=Limit.HOLD)
        values |= {"quantity": check.quantity, "use": use, "time": check.time, "locked": None}
        if plan.robot.holding_joints:
            where, locked = tightest_check(plan.job, limit=Limit.HOLDING_TORQUE)
            if bound_use(locked) > use:
                values["locked"] = (locked.quantity, bound_use(locked), locked.bound, during(where, plan.job))
        yield _note("first", "holds", **values, when=during(segment, plan.job))
    else:
        welded = any(foot.kind == "welded" for foot in holding.feet)
        yield _note("first", "unknown_hold", **values, welded=welded)


def _base(plan: Plan) -> dict[str, Any]:
    """What the base must bear, and where that is: in the posture at an end, at rest, or during a segment."""
    peak, baseline = plan.job.figures.peak_guardrail_torque, plan.baseline
    calmer = plan.baseline_sway
    values: dict[str, Any] = {
        "base": plan.scene.base_name,
        "peak_nm": peak,
        "work_nm": plan.figures.peak_guardrail_torque if len(plan.job.segments) > 1 else None,
        "baseline_nm": None if baseline is None else baseline.job_figures.peak_guardrail_torque,
        "baseline_work_nm": None if baseline is None else baseline.figures.peak_guardrail_torque,
        "faults": baseline_faults(plan),
        "work_faults": baseline_faults(plan, work=True),
        "further": further(plan),
        "swings": None if calmer is None or plan.sway is None else (plan.sway.swing_mm, 1e3 * calmer[1]),
        "still_nm": float(np.linalg.norm(plan.robot.carrier_torque)),
    }
    ends = [("begins", plan.scene.posture)]
    if (end := end_posture_of(plan.scene, plan.robot)) is not None:
        ends.append(("ends", end))
    for which, q in ends:
        at_rest = Dynamics(plan.robot.tool_off).static_efforts(np.asarray(q)[None]).guardrail_torque
        if np.linalg.norm(at_rest) >= (1 - SAME) * peak:
            return values | {"rest": which}
    segment = max(plan.job.segments, key=lambda each: each.figures.peak_guardrail_torque)
    samples = plan.segment_samples[segment.name]
    time = segment.begin + samples.t[np.linalg.norm(samples.guardrail_torque, axis=1).argmax()]
    return values | {"rest": None, "when": during(segment, plan.job), "time": float(time)}


def _free_moves(plan: Plan) -> Iterator[Note]:
    """What bounds the longest free move, where these take longer than the work, and from where none leads."""
    free, total = [each for each in plan.job.segments if each.kind == "free"], plan.job.duration
    seconds = sum(each.duration for each in free)
    if seconds > _LONG_FREE_RATIO * (total - seconds):
        longest = max(free, key=lambda each: each.duration)
        rates = (check for check in longest.certificate.checks if check.limit in _RATES)
        by = next((check.quantity for check in rates if bound_use(check) > _REACHED_SHARE), None)
        values = {"seconds": seconds, "total": total, "which": longest.in_words, "by": by}
        limits, q, moved = plan.robot.limits, plan.start.posture, bool(plan.start.moved)
        room = np.minimum(q - limits.lower, limits.upper - q)
        # Near an end of a range a motion that starts there has nowhere to go.
        roomy = moved and bool((room >= np.where(limits.prismatic, _ROOM_M, np.radians(_ROOM_DEG))).all())
        values["start"] = start_entry(q, limits) if roomy else None
        values["pinned"] = plan.scene.pinned_posture if moved and plan.options.start == "free" else None
        yield _note("first", "free_moves", **values)


def _faults(plan: Plan) -> Iterator[Note]:
    """What is missing of what was asked, and what is kept and looks as if it were not."""
    if unreached := plan.whole_coverage.unreached:
        found = [*unit_findings(plan.scene, plan.robot), *precheck_options(plan.options, plan.scene.tool)]
        likely = [f" First see {each.key}: {each.got}, expected {each.expected}." for each in found]
        values = {"area_m2": plan.whole_coverage.area, "unreached_m2": unreached}
        yield _note("fault", "unreached", **values, likely="".join(likely[:1]))
    (without, off), allowed = plan.bent_offsets, plan.options.max_tool_deviation_m
    if off is not None and off > allowed:
        values = {"off_mm": 1e3 * off, "allowed_mm": 1e3 * allowed, "pushed": plan.robot.pushed}
        key = "off_path" if np.isfinite(off) else "too_soft"
        yield _note("fault", key, **values, base=plan.scene.base_name)
    elif off is not None and without is not None and without < off:
        yield _note("note", "deviates", off_mm=1e3 * off, without_mm=1e3 * without, allowed_mm=1e3 * allowed)


def _start(plan: Plan) -> Iterator[Note]:
    start, failures = plan.start, plan.start.failures
    if start.moved == 0:
        if failures:
            yield _note("warning", "unused_start", reason=failures[0].reason)
        return
    moves, slides = np.abs(start.posture - plan.scene.posture), plan.robot.limits.prismatic
    values: dict[str, Any] = {
        "posture": postures_in_words(slides, start.posture),
        "turned_deg": float(np.rad2deg(moves[~slides].max(initial=0.0))),
        "slid_m": float(moves[slides].max(initial=0.0)),
        "from": plan.scene.pinned_posture,
        "seconds": plan.job.segments[0].duration,
    }
    near = plan.robot.metric.lengths(start.posture - plan.scene.posture) < plan.options.chart_spacing
    if failures:
        yield _note("warning", "other_start", **values, reason=failures[0].reason, tried=len(failures))
    elif plan.compensation is not None and near:
        yield _note("note", "sagging_start", **values)
    else:
        key, choice = "path_start" if plan.scene.begins_elsewhere else "better_start", plan.choice
        # The mean over the work may gain, or the travel, where the peak hardly does.
        least = 1 + plan.options.min_gain
        better = not (choice and choice.free and choice.pinned) or choice.pinned >= least * choice.free
        yield _note("note", key, **values, better=better)


def _told(plan: Plan) -> Iterator[Note]:
    """What other parts of the package say of what was assumed, and of what failed."""
    for text in plan.fallbacks:
        yield _note("warning", "fallback", text=text)
    for text in plan.robot.remarks:
        yield _note("warning", "robot", text=text)
    if tube := tube_warning(plan.scene, plan.robot):
        yield _note("warning", "stiffness", text=tube)
    for told in (load_remark(plan.scene, plan.robot), identified_in_words(plan.scene)):
        if told:
            yield _note("note", "stiffness", text=told)
    yield from _slid(plan)
    for key, looks, units in mistaken_units(plan.scene, plan.robot):
        yield _note("warning", "units", of=key, looks=looks, units=units)


def _faces(plan: Plan) -> Iterator[Note]:
    """What was chosen of the faces of meshes and of the rows over them."""
    surfaces = {stroke.file.part_of or stroke.name: stroke.surface for stroke in plan.asked_strokes}
    faces = {name: each for name, each in surfaces.items() if isinstance(each, FaceSurface)}
    if found := {name: each.found for name, each in faces.items() if each.found}:
        yield _note("note", "faces", found=found)


def _slid(plan: Plan) -> Iterator[Note]:
    """A lift or rail that moves, on a base that bends the same wherever it is."""
    if elastic_base(held_guardrail(plan.scene, plan.robot)) is None or not plan.robot.limits.prismatic[0]:
        return
    q = np.concatenate([segment.trajectory.q[:, 0] for segment in plan.job.segments])
    if np.ptp(q) > _TOLD_SLIDE_M:
        ends = {"low": float(q.min()), "high": float(q.max())}
        yield _note("warning", "slid", joint=plan.robot.joints[0], **ends, base=plan.scene.base_name)


def _objective(plan: Plan) -> Iterator[Note]:
    """What was minimised, where that is not the torque on the base or gravity has no part in it."""
    objective, holding = plan.objective, plan.robot.holding
    if objective.floor is not None and objective.floor <= _ZERO_BOUND_SHARE * objective.planned_peak:
        yield _note("warning", "no_gravity")
    if not objective.is_guardrail_torque:
        factor, unit = objective.shown_unit
        before = objective.baseline_peak
        values = {
            "name": objective.name,
            "own": objective.own,
            "magnets": holding is not None and bool(holding.adhesive),
            "about": objective.moment_about,
            "weights": objective.axis_weights,
            "unit": unit,
            "before": None if before is None else factor * before,
            "after": factor * objective.planned_peak,
            "faults": baseline_faults(plan, work=True),
        }
        yield _note("note", "objective", **values)


def _compared(plan: Plan, baseline: Baseline) -> Iterator[Note]:
    """Where the plan is no better than the baseline, or that is no measure."""
    faults = baseline_faults(plan, work=True)
    if faults:
        yield _note("warning", "baseline", faults=faults)
    approach, work = plan.approach, max(f.peak_guardrail_torque for f in (plan.figures, baseline.figures))
    if approach is not None and approach.figures.peak_guardrail_torque > work * (1 + _MIN_GAIN_SHARE):
        yield _note("warning", "approach", base=plan.scene.base_name)
    if (factor := further(plan)) >= _TOLD_TRAVEL_RATIO:
        ours, theirs = travels(plan, baseline)
        joint = int(plan.robot.metric.coordinates(ours - theirs).argmax())
        units = plan.robot.limits.units(joint, shown=True)
        far, other = (float(units.factor * each[joint]) for each in (ours, theirs))
        of = {"joint": plan.robot.joints[joint], "unit": units.position}
        yield _note("note", "travel", factor=factor, **of, far=far, other=other)
    before, after = (each.limit_use.jerk for each in (baseline.figures, plan.figures))
    if plan.sway is not None and after > max(_MUCH_JERK_FACTOR * before, _LITTLE_JERK):
        yield _note("warning", "jerk", factor=after / before, share=after)
    peak, least, floor = plan.objective.planned_peak, plan.objective.baseline_peak, plan.objective.floor
    sought = plan.options.objective != "travel"
    if least is None or not sought or peak < least * (1 - _MIN_GAIN_SHARE):
        return
    if peak > least * (1 + _MIN_GAIN_SHARE):
        yield _note("warning", "higher", share=peak / least - 1)
    elif not faults:
        yield _note("note", "no_gain", near=floor is not None and least < floor * (1 + _NEAR_BOUND))


def _return(plan: Plan) -> Iterator[Note]:
    if plan.scene.return_to != "none":
        to = str(plan.scene.return_to)
        lacks = to == "stow" and STOW not in plan.robot.group_states
        yield _note("note", "return", to=to, lacks_stow=lacks, moves=plan.job.segment(RETURN) is not None)


def _bound(plan: Plan) -> Iterator[Note]:
    bound, objective = plan.lower_bound, plan.objective
    if bound is None or plan.choice is None:
        return
    closed = bound.kind == "proven" or bound.error <= _CLOSED_GAP_SHARE * bound.value
    factor, unit = objective.shown_unit
    values = {
        "proven": bound.kind == "proven",
        "closed": closed,
        "value": factor * bound.value,
        "error": factor * bound.error,
        "unit": unit,
        "basis": bound.basis,
        "gap": objective.gap,
        "over_sequences": plan.gap_to_sequences,
        "any_start": plan.options.start == "pinned",
        "before_sag": plan.compensation is not None,
    }
    yield _note("note" if closed else "warning", "bound", **values)


def _certified(plan: Plan) -> Iterator[Note]:
    segment, check = tightest_check(plan.job)
    promise = {**vars(check), "limit": str(check.limit), "when": during(segment, plan.job)}
    yield _note("note", "promise", **promise)
    whole, seconds = plan.job.certificate, plan.seconds
    yield _note("note", "certified", checks=len(whole.checks), text=whole.at_all_times(plan.scene.base_name))
    each = {name: getattr(seconds, name) for name in ("path", "optimise", "certify", "total")}
    yield _note("note", "seconds", **each, passes=len(plan.passes))
