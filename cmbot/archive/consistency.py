"""Consistency of a plan directory: its files, motions and numbers are those of one plan."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np

from cmbot.archive.names import EARLIER_FORMAT, PLAN_FILE
from cmbot.archive.schema import MetricsFile, PlanFile, StrokeEntries, made
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.common.validation import counted, shown
from cmbot.planning import (
    RETURN,
    Job,
    MotionMetrics,
    ObjectiveMetrics,
    QuinticTrajectory,
    free_move_name,
)
from cmbot.scene import PlannerOptions, Scene

__all__ = [
    "require_combined",
    "require_fit",
    "require_segments",
    "require_times",
    "require_unchanged",
]

# Relative tolerance of times and shares; tolerance of angles, rad, because degrees round.
_SAME, _SAME_ANGLE = 1e-9, 1e-9


def require_times(t: FloatArray, duration: float, source: str, whose: str) -> None:
    """Refuse times `t` (N,) of the file `source` that do not run from 0 to `duration`, s, as `whose` do."""
    if t[0] != 0.0 or abs(t[-1] - duration) > _SAME * duration:
        raise ArchiveError(source, "t", f"{t[0]:g} to {t[-1]:g} s", f"0 to {duration:g} s, as in {whose}")


def require_unchanged(folder: Path, file: PlanFile, contents: Mapping[str, bytes]) -> None:
    """Refuse files that were not saved together with plan.json."""
    for name, content in contents.items():
        if file.files.get(name) != hashlib.sha256(content).hexdigest():
            expected = f"the file that was saved with {PLAN_FILE}"
            raise ArchiveError(str(folder / name), "", "other content", expected)
    if strange := sorted(file.files.keys() - contents.keys()):
        got = ", ".join(strange)
        raise ArchiveError(str(folder / PLAN_FILE), "files", got, "none but the files of this plan")


def require_segments(file: PlanFile, folder: Path, scene: Scene, *, returns: bool) -> None:
    """Refuse other segments and strokes than the scene and the start ask for, and gaps between segments.

    `returns`: the scene asks for a return, which there is unless the work ends there.
    """
    source, names = str(folder / PLAN_FILE), [str(stroke.name) for stroke in scene.each_stroke]
    several = names if len(names) > 1 else []
    if (got_strokes := [stroke.name for stroke in file.strokes]) != several:
        wanted = f"{', '.join(several) or 'none'}, by the scene"
        raise ArchiveError(source, "strokes", shown(", ".join(got_strokes)) or "none", wanted)
    got = [(segment.name, segment.kind) for segment in file.segments]
    expected: list[tuple[str, str]] = []
    for number, name in enumerate(names):
        move = (free_move_name(number), "free")
        approaches = file.options.knots == "sliding" or scene.begins_elsewhere or number > 0
        start = file.strokes[number].start if file.strokes else file.start
        if approaches and start.moved_deg > 0:
            expected.append(move)
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
        if file.format != EARLIER_FORMAT and segment.duration is not None:
            integral, key = segment.mean_guardrail_torque * segment.seconds, f"segments[{k}]"
            _require_number(segment.duration, segment.seconds, source, f"{key}.duration")
            stored = segment.guardrail_torque_integral
            _require_number(stored, integral, source, f"{key}.guardrail_torque_integral")


def require_fit(file: PlanFile, posture: FloatArray, end: FloatArray | None, job: Job, folder: Path) -> None:
    """Refuse a plan whose motions do not join, or whose entries contradict each other.

    `posture` (n,), rad, is the scene's, and `end` that in which its job ends; None: where the work ends.
    `folder`, the plan directory, is for messages.
    """
    source, strokes = str(folder / PLAN_FILE), job.strokes
    _require_clearances(file, source)
    entries: dict[str, StrokeEntries] = {"": file}
    if file.strokes:
        entries = {f"strokes[{k}].": stroke for k, stroke in enumerate(file.strokes)}
    planned: list[MetricsFile] = [file.planned]
    if file.strokes:
        planned = [*(segment for segment in file.segments if segment.kind == "stroke")]
        _require_stroke(file, file, file.planned, source)
    for (prefix, entry), stroke, metrics in zip(entries.items(), strokes, planned, strict=True):
        _require_start(entry, stroke.trajectory, source, prefix)
        _require_stroke(file, entry, metrics, source, prefix)
    _require_torque_floor(file, source)
    counts = [len(stroke.trajectory.t) for stroke in strokes]
    for (prefix, entry), count in zip(entries.items(), counts, strict=True):
        _require_floor(entry, count, source, prefix)
    _require_floor(file, sum(counts), source)
    _require_joins(job, posture, end, folder, earlier=file.format == EARLIER_FORMAT)
    _require_work(file, job, source)
    if file.format != EARLIER_FORMAT:
        _require_figures(file.planned.job, job.figures, source, "planned.job")
        if job.free_figures is not None:
            _require_figures(file.planned.free, job.free_figures, source, "planned.free")


def _require_joins(
    job: Job, posture: FloatArray, end: FloatArray | None, folder: Path, *, earlier: bool
) -> None:
    """Refuse segments of which one does not start where the one before it ends."""
    knots = str(folder / ("approach.npz" if earlier else "job.npz"))
    first, last = job.segments[0], job.segments[-1]
    if first.kind == "free":
        _require_posture(first.trajectory.q[0], posture, knots, "q", "the scene's posture at first")
    for before, after in pairwise(job.segments):
        if after.kind == "stroke":
            got, expected = before.trajectory.q[-1], after.trajectory.q[0]
            what = "the work" if len(job.strokes) == 1 else after.name
            _require_posture(got, expected, knots, "q", f"where {what} starts at last")
        else:
            got, expected = after.trajectory.q[0], before.trajectory.q[-1]
            what = "the work" if len(job.strokes) == 1 else before.name
            _require_posture(got, expected, knots, "q", f"where {what} ends at first")
    if end is not None:
        _require_posture(last.trajectory.q[-1], end, knots, "q", "where the job is to end at last")


def _require_stroke(
    file: PlanFile, entry: StrokeEntries, planned: MetricsFile, source: str, prefix: str = ""
) -> None:
    """Refuse entries of a stroke, or of all, that the options exclude, and objectives of other motions."""
    sliding = file.options.knots == "sliding"
    _require_there(entry.floor, sliding, source, f"{prefix}floor")
    _require_there(entry.choice, sliding, source, f"{prefix}choice")
    _require_objective(entry, file.options, planned, source, prefix)


def _require_work(file: PlanFile, job: Job, source: str) -> None:
    """Refuse figures or a certificate of one stroke that are not those of the work; of several, figures."""
    if file.strokes:
        _require_figures(file.planned, job.stroke_figures, source, "planned")
        return
    key, stroke = next(
        (f"segments[{k}]", each) for k, each in enumerate(file.segments) if each.kind == "stroke"
    )
    for name in MetricsFile.model_fields:
        if getattr(stroke, name) != getattr(file.planned, name):
            raise ArchiveError(source, f"{key}.{name}", "another value", f"that of planned.{name}")
    if stroke.certificate != file.certificate:
        raise ArchiveError(source, f"{key}.certificate", "another certificate", "that of the plan")


def _require_figures(got: MetricsFile | None, expected: MotionMetrics, source: str, key: str) -> None:
    """Refuse figures of a job, or of its strokes, that are not those of its segments."""
    if got is None:
        raise ArchiveError(source, key, "null", "figures")
    for name, value in vars(expected).items():
        if isinstance(value, float):
            _require_number(getattr(got, name), value, source, f"{key}.{name}")
    for name, value in vars(expected.limit_use).items():
        _require_number(getattr(got.limit_use, name), value, source, f"{key}.limit_use.{name}")
    if got.adhesion_needed is None or expected.adhesion_needed is None:
        if got.adhesion_needed is not expected.adhesion_needed:
            raise ArchiveError(source, f"{key}.adhesion_needed", "null for a part", "null or figures for all")
        return
    for name, value in vars(expected.adhesion_needed).items():
        if isinstance(value, float):
            where = f"{key}.adhesion_needed.{name}"
            _require_number(getattr(got.adhesion_needed, name), value, source, where)


def _require_clearances(file: PlanFile, source: str) -> None:
    """Refuse a clearance that is infinite for one motion alone: all have the same shapes around them."""
    if np.isinf(file.baseline.min_clearance) != np.isinf(file.planned.min_clearance):
        got, expected = "null for one motion alone", "null, for nothing to hit, or numbers for both"
        raise ArchiveError(source, "baseline.min_clearance", got, expected)


def _require_start(entry: StrokeEntries, work: QuinticTrajectory, source: str, prefix: str) -> None:
    start = entry.start.made().posture
    key = f"{prefix}start.posture{'_deg' if entry.start.posture is None else ''}"
    if start.shape != work.q[0].shape:
        got, expected = (counted(len(posture), "joint") for posture in (start, work.q[0]))
        raise ArchiveError(source, key, got, expected)
    what = "where trajectory.npz begins" if not prefix else "where the stroke begins in job.npz"
    _require_posture(start, work.q[0], source, key, what)


def _require_there(block: object, expected: bool, source: str, key: str) -> None:
    """Refuse a block that is missing, or there although the options exclude it."""
    if expected and block is None:
        raise ArchiveError(source, key, "null", "a block: the knots slide, or the work starts elsewhere")
    if not expected and block is not None:
        raise ArchiveError(source, key, "a block", "null: the knots are fixed, or the work starts at once")


def _require_torque_floor(file: PlanFile, source: str) -> None:
    """Refuse a lower bound of the torque that is not that of the objective."""
    objective = made(ObjectiveMetrics, file.objective)
    value = None if file.floor is None else file.floor.value
    reported = value if objective.is_guardrail_torque else None
    _require_number(file.torque_floor, reported, source, "torque_floor")
    _require_kind(file, source)
    gap = file.planned.peak_guardrail_torque / reported - 1.0 if reported else None
    _require_number(file.gap_to_floor, gap, source, "gap_to_floor")


def _require_floor(entry: StrokeEntries, via_points: int, source: str, prefix: str = "") -> None:
    """Refuse a lower bound of other via-points, and entries that contradict it."""
    floor, objective = entry.floor, made(ObjectiveMetrics, entry.objective)
    value = None if floor is None else floor.value
    _require_number(entry.objective.floor, value, source, f"{prefix}objective.floor")
    _require_number(entry.objective.gap, objective.gap, source, f"{prefix}objective.gap")
    if floor is None:
        return
    if len(floor.each) != via_points:
        got, expected = (counted(number, "number") for number in (len(floor.each), via_points))
        raise ArchiveError(source, f"{prefix}floor.each", got, expected)
    if floor.via_point >= via_points:
        raise ArchiveError(source, f"{prefix}floor.via_point", floor.via_point, f"less than {via_points}")
    _require_number(floor.value, floor.each[floor.via_point], source, f"{prefix}floor.value")


def _require_kind(file: PlanFile, source: str) -> None:
    """Refuse a kind and an error of the torque's lower bound that are not that bound's."""
    floor = None if file.torque_floor is None else file.floor
    kind, error = (None, None) if floor is None else (floor.kind, floor.error)
    if file.torque_floor_kind is None and kind != "proven":
        # A plan of an earlier version.
        error = None
    elif file.torque_floor_kind != kind:
        got, expected = (shown(value) for value in (file.torque_floor_kind, kind))
        raise ArchiveError(source, "torque_floor_kind", got, f"{expected}, by the other figures")
    _require_number(file.torque_floor_error, error, source, "torque_floor_error")


def _require_objective(
    entry: StrokeEntries, options: PlannerOptions, planned: MetricsFile, source: str, prefix: str
) -> None:
    """Refuse an objective other than that of the options, unless it is a custom one, and other peaks."""
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
    if made(ObjectiveMetrics, objective).is_guardrail_torque:
        for key, motion in (("baseline_peak", entry.baseline), ("planned_peak", planned)):
            peak = motion.peak_guardrail_torque
            _require_number(getattr(objective, key), peak, source, f"{prefix}objective.{key}")


def require_combined(file: PlanFile, expected: StrokeEntries, source: str) -> None:
    """Refuse entries of all strokes that do not follow from those of each."""
    got = StrokeEntries.model_validate(
        {name: getattr(file, name) for name in StrokeEntries.model_fields}, from_attributes=True
    )
    _require_same_entries(got.model_dump(), expected.model_dump(), source, "")


def _require_same_entries(got: object, expected: object, source: str, key: str) -> None:
    if isinstance(got, Mapping) and isinstance(expected, Mapping):
        for name, value in expected.items():
            # What a plan's own baseline has beside, the figures of the job, is checked elsewhere.
            _require_same_entries(got[name], value, source, f"{key}.{name}" if key else str(name))
    elif isinstance(got, list | tuple) and isinstance(expected, list | tuple) and len(got) == len(expected):
        for k, (one, other) in enumerate(zip(got, expected, strict=True)):
            _require_same_entries(one, other, source, f"{key}[{k}]")
    elif isinstance(got, float) and isinstance(expected, float):
        _require_number(got, expected, source, key)
    elif got != expected:
        raise ArchiveError(source, key, shown(got), f"{shown(expected)}, by the strokes")


def _require_number(got: float | None, expected: float | None, source: str, key: str) -> None:
    if got is None or expected is None or got == expected:
        # Infinite clearances are the same, too.
        same = got == expected
    else:
        same = abs(got - expected) <= _SAME * max(1.0, abs(expected))
    if not same:
        shown = "null" if expected is None else f"{expected:g}"
        raise ArchiveError(source, key, "null" if got is None else got, f"{shown}, by the other figures")


def _require_posture(got: FloatArray, expected: FloatArray, source: str, key: str, what: str) -> None:
    """Refuse a posture that is not the expected one."""
    if np.abs(got - expected).max() > _SAME_ANGLE:
        shown, wanted = (", ".join(f"{angle:.3f}" for angle in np.degrees(q)) for q in (got, expected))
        if key == "start.posture":
            # Of an arm with joints that slide.
            raise ArchiveError(source, key, f"{got.tolist()}", f"{what}, {expected.tolist()} (rad and m)")
        raise ArchiveError(source, key, f"({shown}) deg", f"{what}, ({wanted}) deg")
