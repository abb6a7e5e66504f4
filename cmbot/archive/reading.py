"""A plan from its directory."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.archive.folder import read_folder, require_settled
from cmbot.archive.knots import require_times, segment_trajectories
from cmbot.archive.places import plans_nearby
from cmbot.archive.plan_file import CertificateFile, HashesFile, PlanFile, StrokeEntries, made, plan_record
from cmbot.archive.records import BASELINE_FILE, JOB_FILES, PLAN_FILE, PLAN_FILES, require_same
from cmbot.archive.tables import read_motion
from cmbot.archive.verification.asked import (
    require_asked,
    require_fixed,
    require_promised,
    require_still,
)
from cmbot.archive.verification.exported import FilesBeside, compared_files
from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.limit import Limit
from cmbot.common.reading.validation import counted, given_path, require_type, shown, validated
from cmbot.elastic.sag import Sag
from cmbot.planning import (
    RETURN,
    Certificate,
    Check,
    Job,
    MotionMetrics,
    ObjectiveMetrics,
    Plan,
    Segment,
    Start,
    StrokeBaseline,
    StrokePlan,
    ToolTask,
    baseline_task,
    bending_arm,
    certify,
    certify_move,
    end_posture_of,
    figures,
    free_move_name,
    measure,
    objective_metrics,
    objective_of,
    require_sound_path,
    resolved_options,
    robot_of,
    sag_of,
    strokes_of,
    task_of,
)
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, Scene

# Relative and absolute tolerance of metrics computed again: processors round differently.
_SAME, _SAME_ZERO = 1e-6, 1e-9
# The same of what is drawn in single precision.
_SINGLE_PRECISION_TOLERANCE = 1e-4
_ANGLE_TOLERANCE = 1e-9  # rad


def load_plan(
    directory: str | Path,
    *,
    verify: bool = False,
    scene: Scene | None = None,
    options: PlannerOptions | None = None,
) -> Plan:
    """Read a plan directory.

    The scene is checked as one from a file. Robot and meshes are loaded from their paths and must not have
    changed since the plan was made. The baseline's torques, clearances and tool points are computed again.
    Pages, plots and tracking errors may be missing.

    Parameters
    ----------
    directory : str or Path
    verify : bool
        Certify trajectory and approach again, and compute them a second time, with the extra ``verify``
        also by MuJoCo (some seconds); require tables and exported files beside it to have the same motion,
        and pages, plots and tracking errors that are there to be those that were written. Peaks of a custom
        objective are not checked: the file has only its name.
    scene : Scene, optional
        That was asked for; with `verify`. The plan has to be one of it. Left out: what the plan promises is
        judged by what the directory says that was asked; hashes in it find damage, not malice.
    options : PlannerOptions, optional
        That were asked for, in place of those of `scene`, or of the scene in the directory; with `verify`.
        The plan has to promise no less.

    Raises
    ------
    InputError
        When `directory` is no path, or `scene` or `options` are none, or given without `verify`.
    ArchiveError
        When a file is missing, damaged, of another version, or contradicts the others; when robot, scene or
        meshes have changed since; with `verify`, when the metrics in the file, or the motion in a file beside
        it, are not those of the motion, or the plan is another one than was asked for.
    LimitViolation
        With `verify`, when trajectory or approach breaks a promise, or the second computation differs.

    Examples
    --------
    >>> again = cmbot.load_plan("out/triangle")
    >>> bool((again.trajectory.q == plan.trajectory.q).all())
    True
    """
    folder = given_path(directory, "cmbot.load_plan", "directory", "the path of a plan directory")
    for key, value, kind in (("scene", scene, Scene), ("options", options, PlannerOptions)):
        if value is not None:
            require_type(value, kind, "cmbot.load_plan", key, f"{kind.__name__} or None")
            if not verify:
                raise InputError("cmbot.load_plan", "verify", "False", f"True, beside {key}")
    return read_plan(folder, verify=verify, asked=scene, options=options)[0]


def read_plan(
    folder: Path, *, verify: bool, asked: Scene | None = None, options: PlannerOptions | None = None
) -> tuple[Plan, FilesBeside]:
    """Read a plan directory as `load_plan` does; return also which files were compared with it."""
    source = folder / PLAN_FILE

    def listed(hashes: Mapping[str, str]) -> tuple[str, ...]:
        own = [name for name in PLAN_FILES if name in hashes or name in JOB_FILES]
        shown_files = sorted(hashes.keys() - {*PLAN_FILES}) if verify else ()
        return (*own, *(name for name in shown_files if (folder / name).exists()))

    data, contents = _read(folder, listed)
    if verify:
        require_settled(folder)
    file = _plan_file(data, str(source))
    try:
        parts = _Parts(file, folder, contents)
        scene, robot = parts.scene, parts.robot
        clearances = Clearances(robot, scene.all_obstacles)
        end = end_posture_of(scene, robot)
    except ArchiveError:
        raise
    except InputError as error:
        # An error of the scene or the robot is one of the plan.
        key = f"scene.{error.key}" if error.source == str(source) else error.key
        raise ArchiveError(error.source, key, error.got, error.expected, error.choices) from error
    promised = options or (asked.planner if asked is not None else file.options)
    if asked is not None:
        require_asked(scene, asked, str(source), file.options, promised)
        if file.missing:
            raise ArchiveError(str(source), "missing", ", ".join(file.missing), "none: each stroke is there")
    resolved = resolved_options(scene, bending_arm(scene, robot), promised)
    require_promised(file.options, resolved, str(source), "options")
    job = parts.job(end)
    plan = Plan.of(
        parts.strokes(job, clearances),
        clearances,
        scene=scene,
        options=file.options,
        robot=robot,
        job=job,
        sag=_sag(scene, robot, file.options) if file.options.compensate else None,
        missing=file.missing,
        fallbacks=file.fallbacks,
        stopped=file.stopped,
        seconds=file.seconds,
    )
    # It costs a third of a second, and is computed anew where the plan is verified.
    vars(plan)["accuracy"], vars(plan)["sway"] = file.accuracy, file.sway
    again = plan_record(plan, file.hashes)
    if plan.baseline is not None:
        # Its free moves are not in the table but measured again, which is compared where it is verified.
        again["baseline"] |= {name: data["baseline"].get(name) for name in ("free", "job")}
    # What it was made of, and by what, is not computed.
    again |= {name: data.get(name) for name in ("scene", "versions")}
    require_same(data, again, str(source), "")
    if not verify:
        return plan, FilesBeside()
    require_still(plan, promised, str(source))
    plan = _verified(plan, clearances, again, str(source))
    if resolved.knots == "fixed":
        require_fixed(plan, resolved, str(source))
    return plan, compared_files(plan, folder)


def _plan_file(data: Mapping[str, Any], source: str) -> PlanFile:
    try:
        return validated(PlanFile, data, source, ArchiveError)
    except ArchiveError as error:
        # It has the hash of its content: of a version with other keys, or of whoever changed it.
        told = "the file was changed, or is of another version: cmbot plan SCENE makes it anew"
        expected = f"{error.expected}; {told}"
        raise ArchiveError(error.source, error.key, error.got, expected, error.choices) from error


def plan_data(directory: Path) -> dict[str, Any]:
    """Return what is in a directory's plan.json.

    Raises
    ------
    ArchiveError
        When it is no plan directory, or the file is damaged or of another version.
    """
    return _read(directory, lambda hashes: ())[0]


def _read(folder: Path, wanted: Any) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Read plan.json and files beside it; where there is none, say which plan may have been meant."""
    try:
        is_folder = folder.is_dir()
    except OSError as error:  # no permission; a name that is too long
        raise ArchiveError(shown(str(folder)), "", shown(str(error)), "a plan directory") from error
    expected = "a plan directory, as cmbot plan writes it"
    if not is_folder:
        got = "a file, not a folder" if folder.is_file() else "no such folder"
        raise ArchiveError(str(folder), "", got, f"{expected}{plans_nearby(folder)}")
    try:
        return read_folder(folder, PLAN_FILE, wanted)
    except ArchiveError as error:
        if (folder / PLAN_FILE).exists():
            raise
        # A path leaves out what "." adds.
        source = f"{folder}{os.sep}{PLAN_FILE}"
        raise ArchiveError(source, "", "no such file", f"{expected}{plans_nearby(folder)}") from error


class _Parts:
    """What a plan directory holds, as the planner has it."""

    def __init__(self, file: PlanFile, folder: Path, contents: Mapping[str, bytes]) -> None:
        self._file, self._contents = file, contents
        self._source, self._knots, self._table = (
            str(folder / name) for name in (PLAN_FILE, JOB_FILES[1], BASELINE_FILE)
        )
        self.scene = file.scene.with_source(self._source)
        self.robot = robot = robot_of(self.scene)
        what = f"the robot's files have changed since ({robot.urdf}, SRDF, joint limits or elasticity)"
        self._require_hash("robot", robot.content_hash, what)
        what = "the scene in this file or the meshes that it names have changed since"
        self._require_hash("scene", self.scene.content_hash, what)
        self._strokes = strokes_of(self.scene, robot)
        for stroke in self._strokes:
            require_sound_path(self.scene, stroke)
        self._tasks = [task_of(stroke, self.scene) for stroke in self._strokes]

    def _require_hash(self, name: str, got: str, what: str) -> None:
        if got != (expected := getattr(self._file.hashes, name)):
            told = f"{expected[:16]}…: {what}; plan again"
            raise ArchiveError(self._source, f"hashes.{name}", f"{got[:16]}… now", told)

    def job(self, end: FloatArray | None) -> Job:
        """The scene's strokes and the free moves around them; it ends in a posture (n,), or at the work."""
        entries, tasks = self._file.segments, self._tasks
        order = "".join(segment.kind[0] for segment in entries)  # f: free, s: stroke
        if not re.fullmatch(f"(f?s){{{len(tasks)}}}{'' if end is None else 'f?'}", order):
            expected = f"{counted(len(tasks), 'stroke')}, by the scene, free moves around them"
            got = ", ".join(segment.name for segment in entries)
            raise ArchiveError(self._source, "segments", shown(got), expected)
        begins = np.cumsum([0.0, *(segment.seconds for segment in entries)])
        content, dof = self._contents[JOB_FILES[1]], self.robot.dof
        trajectories = segment_trajectories(entries, begins, content, self._knots, dof, self._strokes)
        segments = list[Segment]()
        number = 0
        for k, (entry, trajectory) in enumerate(zip(entries, trajectories, strict=True)):
            # A free move belongs to the stroke that it leads to, the return to the last one.
            task = tasks[min(number, len(tasks) - 1)]
            if entry.kind == "stroke":
                name, number = str(self._strokes[number].name), number + 1
            else:
                task, name = task.held_at_start(), free_move_name(number) if number < len(tasks) else RETURN
                if np.abs(trajectory.q[-1] - trajectory.q[0]).max() <= _ANGLE_TOLERANCE:
                    raise ArchiveError(self._knots, "q", f"{name} to where it begins", "no such move")
            given = {"name": name, "begin": float(begins[k]), "trajectory": trajectory, "task": task}
            segments.append(made(Segment, entry, **given, certificate=self._certificate(k)))
        ends = {0: ("the scene's posture at first", np.array(self.scene.posture))}
        if end is not None:
            ends[-1] = ("where the job is to end at last", end)
        for k, (what, posture) in ends.items():
            if (off := np.abs(segments[k].trajectory.q[k] - posture).max()) > _ANGLE_TOLERANCE:
                raise ArchiveError(self._knots, "q", f"another posture, off by {off:.3g}", what)
        return Job(segments=tuple(segments))

    def _certificate(self, number: int) -> Certificate:
        entry = self._file.segments[number]
        integral = entry.mean_guardrail_torque * entry.seconds
        measured = made(MotionMetrics, entry, duration=entry.seconds, guardrail_torque_integral=integral)
        certificate = made(Certificate, entry.certificate, figures=measured)
        for index, check in enumerate(certificate.checks):
            if not check.holds:
                key, broken = f"segments[{number}].certificate.checks[{index}]", check.quantity
                raise ArchiveError(self._source, key, f"a broken promise ({broken})", "kept ones")
        return certificate

    def strokes(self, job: Job, clearances: Clearances) -> list[StrokePlan]:
        """What is planned of each stroke."""
        several = [segment.name for segment in job.strokes] if len(job.strokes) > 1 else []
        given = [stroke.name for stroke in self._file.strokes]
        require_same(given, several, self._source, "strokes", why="the scene has them")
        entries: tuple[StrokeEntries, ...] = self._file.strokes or (self._file,)
        baselines = self._baselines(entries, clearances)
        strokes, before = [], np.array(self.scene.posture)
        for k, (entry, segment, baseline) in enumerate(zip(entries, job.strokes, baselines, strict=True)):
            posture, key = segment.trajectory.q[0], f"strokes[{k}]." if several else ""
            moved = float(np.abs(self.robot.metric.coordinates(posture - before)).max())
            failures = tuple(failure.made() for failure in entry.start.failures)
            start = Start(posture=posture, moved=moved * (moved > _ANGLE_TOLERANCE), failures=failures)
            if (floor := entry.floor) is not None:
                require_same(len(floor.each), len(segment.trajectory.t), self._source, f"{key}floor.each")
                lowest = dict(enumerate(floor.each.tolist())).get(floor.via_point)
                require_same(floor.value, lowest, self._source, f"{key}floor.value")
            own = {"name": segment.name, "task": segment.task, "start": start, "lower_bound": floor}
            objective = self._objective(entry, segment)
            strokes.append(made(StrokePlan, entry, **own, baseline=baseline, objective=objective))
            before = segment.trajectory.q[-1]
        return strokes

    def _objective(self, entry: StrokeEntries, planned: Segment) -> ObjectiveMetrics:
        """An objective as what else is known has it; its peaks, and a custom one, are the file's word."""
        stored, options = entry.objective, self._file.options
        of_torque = not stored.own and options.objective == "torque"
        objective = replace(
            stored,
            name=stored.name if stored.own else options.objective,
            moment_about=options.moment_about if of_torque else None,
            axis_weights=options.axis_weights if of_torque else None,
            floor=None if entry.floor is None else entry.floor.value,
        )
        if not objective.is_guardrail_torque:
            return objective
        before = None if entry.baseline is None else entry.baseline.peak_guardrail_torque
        return replace(objective, baseline_peak=before, planned_peak=planned.figures.peak_guardrail_torque)

    def _baselines(
        self, entries: Sequence[StrokeEntries], clearances: Clearances
    ) -> list[StrokeBaseline | None]:
        """The baseline along each stroke, from its table; none where the options ask for none."""
        if self._file.options.baseline == "none":
            return [None] * len(entries)
        stored = [entry.baseline for entry in entries]
        if None in stored or self._file.baseline is None:
            expected = "one of the job and of every stroke, by options.baseline"
            raise ArchiveError(self._source, "baseline", "null", expected)
        if BASELINE_FILE not in self._contents:
            expected = f"the file that was saved with {PLAN_FILE}"
            raise ArchiveError(self._source, "files", f"no {BASELINE_FILE}", expected)
        t, motion = read_motion(self._contents[BASELINE_FILE], self._table, self.robot.dof)
        if len(entries) == 1:
            require_times(t, self._tasks[0].path.duration, self._table, "the scene")
        baselines = list[StrokeBaseline | None]()
        tasks = (
            baseline_task(task, file, self._file.options)
            for task, file in zip(self._tasks, self.scene.strokes, strict=True)
        )
        for entry, task in zip(filter(None, stored), tasks, strict=True):
            rows = _rows(t, entry.begin, entry.begin + task.path.duration, self._table)
            part = [array[rows] for array in motion]
            samples = measure(self.robot, task, clearances, t[rows] - t[rows[0]], part)
            along = made(MotionMetrics, entry)
            baselines.append(made(StrokeBaseline, entry, samples=samples, figures=along))
        return baselines


def _rows(t: FloatArray, begin: float, end: float, source: str) -> IntArray:
    """Which of the times `t` (N,) of a table are those of a stroke."""
    room = _SAME_ZERO * max(end, 1.0)
    rows = np.flatnonzero((t >= begin - room) & (t <= end + room))
    if not len(rows) or abs(t[rows[0]] - begin) > room or abs(t[rows[-1]] - end) > room:
        expected = f"rows from {begin:g} to {end:g} s"
        raise ArchiveError(source, "t", "no row where a stroke begins or ends", expected)
    return rows


def _sag(scene: Scene, robot: Robot, options: PlannerOptions) -> Sag | None:
    return sag_of(scene, bending_arm(scene, robot), options)


# Certified again


def _verified(plan: Plan, clearances: Clearances, data: dict[str, Any], source: str) -> Plan:
    """Return the plan certified and measured anew: the record of that has to be `data`."""
    certified = [_certified(plan, k, clearances) for k in range(len(plan.job.segments))]
    for certificate, _ in certified:
        certificate.require()
    segments = tuple(
        replace(segment, certificate=certificate)
        for segment, (certificate, _) in zip(plan.job.segments, certified, strict=True)
    )
    strokes = [
        _measured(plan, *each)
        for each in zip(plan.strokes, plan.baseline_tasks, Job(segments=segments).strokes, strict=True)
    ]
    own = ("scene", "options", "robot", "sag", "missing", "fallbacks", "stopped", "seconds")
    given = {name: getattr(plan, name) for name in own}
    again = Plan.of(strokes, clearances, job=Job(segments=segments), **given)
    hashes = HashesFile(**data["hashes"])
    record = plan_record(again, hashes)
    bounds = _bounds(record)
    given_again = ("certificate", "scene", "versions", "accuracy", "sway")
    expected = record | {name: data[name] for name in given_again}
    for stored, entry in zip(data["segments"], record["segments"], strict=True):
        entry["certificate"] = stored["certificate"]
    require_same(data, expected, source, "", _SAME, _SAME_ZERO)
    require_same(_drawn(data), _drawn(record), source, "", _SINGLE_PRECISION_TOLERANCE, _SAME_ZERO)
    require_same(_bounds(data), bounds, source, "segments", _SAME, _SAME_ZERO)
    seconds = [
        replace(segment, certificate=replace(certificate, checks=(*certificate.checks, *checks)))
        for segment, (certificate, checks) in zip(segments, certified, strict=True)
    ]
    for segment in seconds:
        segment.certificate.require()
    return replace(plan, job=Job(segments=tuple(seconds)))


def _bounds(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What the certificates of segments say that holds at all times; where a peak is may be open."""
    names = [field.name for field in fields(CertificateFile) if field.name != "checks"]
    each = [entry["certificate"] for entry in data["segments"]]
    return [{name: own[name] for name in names} | {"checks": _found(own["checks"])} for own in each]


def _found(checks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What checks found: not the pair that they name, nor when, as another one may be as near.

    Nor by how much there is less of a jump than rounding allows: that differs between processors.
    """
    names, rounding = ("value", "bound", "unit", "at_least", "limit"), ("value", Limit.CONTINUITY)
    return [{name: check[name] for name in names if (name, check["limit"]) != rounding} for check in checks]


def _drawn(data: Mapping[str, Any]) -> dict[str, Any]:
    """What is drawn in single precision; by names, since the order is that of the sizes."""
    accuracy = data["accuracy"] and dict(data["accuracy"])
    for listed in ("parts", "remedies") if accuracy else ():
        accuracy[listed] = sorted(accuracy[listed], key=lambda entry: entry["name"])
    return {"accuracy": accuracy, "sway": data["sway"]}


def _measured(plan: Plan, stroke: StrokePlan, task: ToolTask, segment: Segment) -> StrokePlan:
    """A stroke with figures of its baseline and peaks of its objective that are measured again."""
    if (baseline := stroke.baseline) is not None:
        samples, on_axis = baseline.samples, task.on_axis
        away = np.linalg.norm(samples.tool_point - on_axis.path.poses(samples.t).point, axis=1)
        smallest = min(on_axis.smallest_singular_value(plan.robot, q) for q in samples.q)
        along = figures(plan.robot, samples)
        baseline = replace(baseline, figures=along, drift=float(away.max()), smallest_singular_value=smallest)
    if stroke.objective.own:
        return replace(stroke, baseline=baseline)
    objective = objective_metrics(
        objective_of(plan.robot, plan.options, sag=_sag(plan.scene, plan.robot, plan.options)),
        plan.options,
        own=False,
        baseline=baseline,
        planned=(segment.figures, segment.trajectory),
        floor=stroke.objective.floor,
    )
    return replace(stroke, baseline=baseline, objective=objective)


def _certified(plan: Plan, number: int, clearances: Clearances) -> tuple[Certificate, tuple[Check, ...]]:
    """Return a new certificate of a segment, by the scene and its neighbours, and a second opinion."""
    robot, options, segments = plan.robot, plan.options, plan.job.segments
    segment = segments[number]
    at_work, trajectory = segment.kind == "stroke", segment.trajectory
    before = np.array(plan.scene.posture) if number == 0 else segments[number - 1].trajectory.q[-1]
    stroke, sag = None, None
    if at_work:
        stroke, sag = [each.name for each in plan.job.strokes].index(segment.name), plan.sag
        number_of_via_points = plan.scene.strokes[stroke].via_points
        if not isinstance(number_of_via_points, int):
            expected = "a number, as plans have it"
            key = "scene.tool_path.via_points"
            raise ArchiveError(plan.scene.source, key, number_of_via_points, expected)
        certificate = certify(
            robot,
            segment.task,
            trajectory,
            clearances,
            options,
            via_points=number_of_via_points,
            start=before if number == 0 or segments[number - 1].kind == "stroke" else None,
            sag=sag,
            arm=bending_arm(plan.scene, robot),
        )
    else:
        # That the scene asks for a return, and where it leads to, has been checked.
        last = number + 1 == len(segments)
        after = np.array(end_posture_of(plan.scene, robot)) if last else segments[number + 1].trajectory.q[0]
        certificate = certify_move(robot, segment.task, trajectory, clearances, options, before, after)
    return certificate, second_opinion(plan.scene, options, trajectory, robot=robot, stroke=stroke, sag=sag)
