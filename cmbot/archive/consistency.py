"""Consistency of a plan directory: its motions and numbers are those of one plan, and of its scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cmbot.archive.plan_file import PlanFile, StrokeEntries
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.common.validation import counted, shown
from cmbot.planning import RETURN, Job, free_move_name
from cmbot.scene import PlannerOptions, Scene

# Relative tolerance of times and shares; tolerance of angles, rad, because degrees round.
_SAME, _SAME_ANGLE = 1e-9, 1e-9


def require_segments(file: PlanFile, source: str, scene: Scene, *, returns: bool) -> None:
    """Refuse other segments and strokes than the scene and the start ask for, and gaps between segments.

    `returns`: the scene asks for a return, which there is unless the work ends there.
    """
    names = [str(stroke.name) for stroke in scene.strokes]
    several = names if len(names) > 1 else []
    if (got_strokes := [stroke.name for stroke in file.strokes]) != several:
        wanted = f"{', '.join(several) or 'none'}, by the scene"
        raise ArchiveError(source, "strokes", shown(", ".join(got_strokes)) or "none", wanted)
    got = [(segment.name, segment.kind) for segment in file.segments]
    expected: list[tuple[str, str]] = []
    for number, name in enumerate(names):
        start = file.strokes[number].start if file.strokes else file.start
        if start.moved_deg > 0:
            expected.append((free_move_name(number), "free"))
        expected.append((name, "stroke"))
    if returns and got[-1:] == [(RETURN, "free")]:
        expected.append((RETURN, "free"))
    if got != expected:
        shown_got, wanted = (", ".join(name for name, _ in each) for each in (got, expected))
        raise ArchiveError(source, "segments", shown(shown_got), f"{wanted}, by the scene and the start")
    begin = 0.0
    for k, segment in enumerate(file.segments):
        if abs(segment.begin - begin) > _SAME * max(begin, 1.0):
            raise ArchiveError(source, f"segments[{k}].begin", segment.begin, f"{begin:g}, where one ended")
        begin = segment.begin + segment.seconds
        for name, value in (
            ("duration", segment.seconds),
            ("guardrail_torque_integral", segment.mean_guardrail_torque * segment.seconds),
        ):
            require_same(getattr(segment, name), value, source, f"segments[{k}].{name}")


def require_fit(
    file: PlanFile, posture: FloatArray, end: FloatArray | None, job: Job, source: str, knots: str
) -> None:
    """Refuse a plan whose motions do not join, or whose entries contradict each other or the options.

    `posture` (n,), rad, is the scene's, and `end` that in which its job ends; None: where the work ends.
    `source` and `knots` are the files plan.json and job.npz, for messages.
    """
    if (file.options.baseline == "none") != (file.baseline is None):
        got, expected = ("a block", "null") if file.baseline else ("null", "a block")
        raise ArchiveError(source, "baseline", got, f"{expected}, by options.baseline")
    baseline = file.baseline
    if baseline and np.isinf(baseline.min_clearance) != np.isinf(file.planned.min_clearance):
        got, expected = "null for one motion alone", "null, for nothing to hit, or numbers for both"
        raise ArchiveError(source, "baseline.min_clearance", got, expected)
    entries: dict[str, StrokeEntries] = {f"strokes[{k}].": stroke for k, stroke in enumerate(file.strokes)}
    entries = entries or {"": file}
    for (prefix, entry), stroke in zip(entries.items(), job.strokes, strict=True):
        _require_start(entry, stroke.trajectory.q[0], source, prefix, knots)
        _require_floor(entry, len(stroke.trajectory.t), file.options, source, prefix)
        _require_objective(entry, file.options, source, prefix)
        _require_peaks(entry, stroke.figures.peak_guardrail_torque, source, prefix)
    _require_joins(job, posture, end, knots)


def _require_start(entry: StrokeEntries, first: FloatArray, source: str, prefix: str, knots: str) -> None:
    start, key = entry.start.made().posture, f"{prefix}start.posture"
    key += "_deg" if entry.start.posture is None else ""
    if start.shape != first.shape:
        got, expected = (counted(len(posture), "joint") for posture in (start, first))
        raise ArchiveError(source, key, got, expected)
    _require_posture(start, first, source, key, f"where the stroke begins in {knots}")


def _require_floor(
    entry: StrokeEntries, via_points: int, options: PlannerOptions, source: str, prefix: str
) -> None:
    """Refuse a bound or a choice that the options exclude, and a bound of other via-points."""
    for name, block, other in (("floor", entry.floor, entry.choice), ("choice", entry.choice, entry.floor)):
        if block is not None and options.knots == "fixed":
            raise ArchiveError(source, f"{prefix}{name}", "a block", "null: the knots are fixed")
        if block is None and other is not None and options.knots == "sliding":
            # Without charts, as near an earlier plan, there is neither.
            raise ArchiveError(source, f"{prefix}{name}", "null", "floor and choice, or neither")
    floor = entry.floor
    require_same(entry.objective.floor, floor and floor.value, source, f"{prefix}objective.floor")
    if floor is None:
        return
    if len(floor.each) != via_points:
        got, expected = (counted(number, "number") for number in (len(floor.each), via_points))
        raise ArchiveError(source, f"{prefix}floor.each", got, expected)
    if floor.via_point >= via_points:
        raise ArchiveError(source, f"{prefix}floor.via_point", floor.via_point, f"less than {via_points}")
    require_same(floor.value, float(floor.each[floor.via_point]), source, f"{prefix}floor.value")


def _require_objective(entry: StrokeEntries, options: PlannerOptions, source: str, prefix: str) -> None:
    """Refuse an objective other than that of the options, unless it is a custom one."""
    objective = entry.objective
    if objective.own:
        expected: tuple[object, ...] = (objective.name, None, None)
    else:
        of_torque = options.objective == "torque"
        about, weights = (options.moment_about, options.axis_weights) if of_torque else (None, None)
        expected = (options.objective, about, weights)
    for key, value in zip(("name", "moment_about", "axis_weights"), expected, strict=True):
        if getattr(objective, key) != value:
            got = shown(getattr(objective, key))
            raise ArchiveError(source, f"{prefix}objective.{key}", got, f"{shown(value)}, by the options")


def _require_peaks(entry: StrokeEntries, planned: float, source: str, prefix: str) -> None:
    """Refuse peaks of the objective that are not those of the figures."""
    if entry.objective.is_guardrail_torque:
        before = None if entry.baseline is None else entry.baseline.peak_guardrail_torque
        require_same(entry.objective.baseline_peak, before, source, f"{prefix}objective.baseline_peak")
        require_same(entry.objective.planned_peak, planned, source, f"{prefix}objective.planned_peak")


def _require_joins(job: Job, posture: FloatArray, end: FloatArray | None, knots: str) -> None:
    """Refuse a job that begins or ends elsewhere; its segments share the knots at their joins."""
    first, last = job.segments[0], job.segments[-1]
    if first.kind == "free":
        _require_posture(first.trajectory.q[0], posture, knots, "q", "the scene's posture at first")
    if end is not None:
        _require_posture(last.trajectory.q[-1], end, knots, "q", "where the job is to end at last")


def require_same(
    got: object,
    expected: object,
    source: str,
    key: str,
    tolerance: float = _SAME,
    zero: float = _SAME,
    why: str = "computed again",
) -> None:
    """Refuse an entry that differs from what the other entries, or what is computed again, make of it.

    Numbers may differ by `tolerance` as a share, or by `zero`. Where a peak is reached twice, its time is not
    determined.
    """
    if isinstance(got, Mapping) and isinstance(expected, Mapping):
        for name in (*expected, *(got.keys() - expected.keys())):
            where = f"{key}.{name}" if key else str(name)
            if name not in got:
                raise ArchiveError(source, where, "nothing", f"{shown(expected[name])}, as {why}")
            if name not in expected:
                raise ArchiveError(source, where, shown(got[name]), f"no such key, as {why}")
            if name != "time":
                require_same(got[name], expected[name], source, where, tolerance, zero, why)
    elif isinstance(got, list | tuple) and isinstance(expected, list | tuple) and len(got) == len(expected):
        for k, (one, other) in enumerate(zip(got, expected, strict=True)):
            require_same(one, other, source, f"{key}[{k}]", tolerance, zero, why)
    elif not isinstance(got, bool) and isinstance(got, int | float) and isinstance(expected, int | float):
        if got != expected and not abs(got - expected) <= zero + tolerance * abs(expected):
            raise ArchiveError(source, key, got, f"{expected:g}, as {why}")
    elif got != expected:
        given, wanted = ("null" if value is None else shown(value) for value in (got, expected))
        raise ArchiveError(source, key, given, f"{wanted}, as {why}")


def _require_posture(got: FloatArray, expected: FloatArray, source: str, key: str, what: str) -> None:
    """Refuse a posture that is not the expected one."""
    if np.abs(got - expected).max() > _SAME_ANGLE:
        if key.endswith("start.posture"):  # of an arm with joints that slide
            raise ArchiveError(source, key, f"{got.tolist()}", f"{what}, {expected.tolist()} (rad and m)")
        given, wanted = (", ".join(f"{angle:.3f}" for angle in np.degrees(q)) for q in (got, expected))
        raise ArchiveError(source, key, f"({given}) deg", f"{what}, ({wanted}) deg")
