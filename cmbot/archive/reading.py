"""A plan from its directory."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.archive.atomic import recover
from cmbot.archive.consistency import (
    require_combined,
    require_fit,
    require_segments,
    require_times,
    require_unchanged,
)
from cmbot.archive.folder import plans_nearby, read_file
from cmbot.archive.job_files import job_trajectories
from cmbot.archive.motion_files import columns, largest_knots, largest_table, read_motion
from cmbot.archive.names import (
    EARLIER_FILES,
    EARLIER_FORMAT,
    FORMAT,
    JOB_FILES,
    PLAN_FILE,
    SAVED_FILES,
)
from cmbot.archive.schema import (
    CertificateFile,
    EarlierPlanFile,
    MetricsFile,
    MotionFile,
    PlanFile,
    StrokeEntries,
    made,
)
from cmbot.archive.strict_json import read_json
from cmbot.archive.writing import stroke_entries
from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.validation import given_path, shown, validated
from cmbot.elastic.sag import Sag
from cmbot.planning import (
    Certificate,
    Check,
    Job,
    MotionMetrics,
    ObjectiveMetrics,
    Plan,
    QuinticTrajectory,
    Segment,
    StrokePlan,
    ToolTask,
    bending_arm,
    certify,
    certify_move,
    end_posture_of,
    figures,
    measure,
    objective_metrics,
    objective_of,
    robot_of,
    sag_of,
    strokes_of,
    task_of,
    tool_lag,
)
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Kinematics, Robot
from cmbot.scene import PlannerOptions, Scene, scene_from_file

__all__ = ["load_plan", "plan_data"]

# Relative and absolute tolerance of metrics computed again: processors round differently.
_SAME, _SAME_ZERO = 1e-6, 1e-9
# Of the tables of planned motions.
_ROWS_A_SECOND = 100.0
# The baseline's free moves lead to other postures, and may take longer than the planned ones by so much.
_SLOWER_BASELINE = 10.0
# Cells of a table that a segment's name is as long as, at most, and those of what two feet need.
_LABEL, _FEET = 5, 2


def load_plan(directory: str | Path, *, verify: bool = False) -> Plan:
    """Read a plan directory.

    Where a call that wrote there was killed, what it left is put back first, with a warning.

    The scene is checked as one from a file. Robot and meshes are loaded from their paths and must not have
    changed since the plan was made. The baseline's torques, clearances and tool points are computed again.

    Parameters
    ----------
    directory : str or Path
    verify : bool
        Certify trajectory and approach again, and compute them a second time, with the extra ``verify``
        also by MuJoCo (some seconds). Peaks of a custom objective are not checked: the
        file has only its name.

    Raises
    ------
    InputError
        When `directory` is no path.
    ArchiveError
        When a file is missing, damaged, of another version, or contradicts the others; when robot, scene or
        meshes have changed since; with `verify`, when the metrics in the file are not those of the motion.
    LimitViolation
        With `verify`, when trajectory or approach breaks a promise, or the second computation differs.

    Examples
    --------
    >>> again = cmbot.load_plan("out/triangle")
    >>> bool((again.trajectory.q == plan.trajectory.q).all())
    True
    """
    folder = given_path(directory, "cmbot.load_plan", "directory", "the path of a plan directory")
    source = folder / PLAN_FILE
    data = plan_data(folder)
    earlier = data["format"] == EARLIER_FORMAT
    read: PlanFile | EarlierPlanFile = (
        validated(EarlierPlanFile, data, str(source), ArchiveError)
        if earlier
        else validated(PlanFile, data, str(source), ArchiveError)
    )
    with _as_archive_error(str(source)):
        scene = _scene(read, source)
        robot = _robot(scene, read, source)
        strokes = strokes_of(scene, robot)
        end = end_posture_of(scene, robot)
        clearances = Clearances(robot, scene.obstacles)
    duration = strokes[0].path.duration
    file = read.upgraded(duration) if isinstance(read, EarlierPlanFile) else read
    require_segments(file, folder, scene, returns=end is not None)
    contents = _contents(folder, file, robot.dof)
    # What is in them is looked at only when they are the ones that were saved.
    require_unchanged(folder, file, contents)
    trajectories = job_trajectories(file, contents, folder, robot.dof, strokes)
    tasks = [task_of(stroke, scene) for stroke in strokes]
    job = _job(file, trajectories, robot, tasks, source)
    require_fit(file, np.array(scene.posture), end, job, folder)
    table, names = str(folder / "baseline.csv"), [stroke.name for stroke in strokes]
    t, motion = read_motion(contents["baseline.csv"], table, robot.dof)
    plan = Plan.of(
        _stroke_plans(file, names, tasks, robot, clearances, t, motion, table),
        clearances,
        scene=scene,
        options=file.options,
        robot=robot,
        job=job,
        sag=_sag(scene, robot, file.options) if file.options.compensate else None,
        fallbacks=file.fallbacks,
        seconds=file.seconds,
    )
    if plan.several:
        if not (_agree(plan.baseline.t, t) and _agree(plan.baseline.q, motion[0])):
            raise ArchiveError(table, "", "other motions between the strokes", "the quickest straight ones")
        entries = StrokeEntries.model_validate(stroke_entries(plan, robot), from_attributes=True)
        require_combined(file, entries, str(source))
    return _verified(plan, file.baseline, clearances, source) if verify else plan


def _stroke_plans(
    file: PlanFile,
    names: Sequence[str],
    tasks: Sequence[ToolTask],
    robot: Robot,
    clearances: Clearances,
    t: FloatArray,
    motion: Sequence[FloatArray],
    source: str,
) -> list[StrokePlan]:
    """What is planned of each stroke, with its part of the baseline at times `t` (N,), from `source`."""
    if not file.strokes:
        require_times(t, tasks[0].path.duration, source, "the scene")
        return [_stroke_plan(file, names[0], robot, tasks[0], clearances, t, motion)]
    strokes = []
    for entry, task in zip(file.strokes, tasks, strict=True):
        begin, end = entry.baseline_begin, entry.baseline_begin + task.path.duration
        room = _SAME_ZERO * max(end, 1.0)
        rows = np.flatnonzero((t >= begin - room) & (t <= end + room))
        if not len(rows) or abs(t[rows[0]] - begin) > room or abs(t[rows[-1]] - end) > room:
            expected = f"rows from {begin:g} to {end:g} s ({entry.name})"
            raise ArchiveError(source, "t", "no row where a stroke begins or ends", expected)
        along = [array[rows] for array in motion]
        strokes.append(_stroke_plan(entry, entry.name, robot, task, clearances, t[rows] - t[rows[0]], along))
    return strokes


def _agree(got: FloatArray, expected: FloatArray) -> bool:
    return got.shape == expected.shape and np.allclose(got, expected, rtol=_SAME_ZERO, atol=_SAME_ZERO)


def _stroke_plan(
    entry: StrokeEntries,
    name: str,
    robot: Robot,
    task: ToolTask,
    clearances: Clearances,
    t: FloatArray,
    motion: Sequence[FloatArray],
) -> StrokePlan:
    """What is planned of a stroke, with its baseline at times `t` (N,)."""
    return StrokePlan(
        name=name,
        task=task,
        start=entry.start.made(),
        baseline=measure(robot, task, clearances, t, motion),
        baseline_figures=_metrics(entry.baseline, robot, task, t, motion[0]),
        drift=entry.drift,
        smallest_singular_value=entry.smallest_singular_value,
        passes=entry.passes,
        objective=made(ObjectiveMetrics, entry.objective),
        lower_bound=None if entry.floor is None else entry.floor.made(),
        choice=entry.choice,
        compensation=entry.compensation,
        suppression=None if entry.suppression is None else entry.suppression.made(),
    )


def plan_data(directory: Path) -> dict[str, Any]:
    """Return what is in a directory's plan.json, after what an interrupted call left there is put back.

    Raises
    ------
    ArchiveError
        When it is no plan directory, or the file is damaged or of another version.
    """
    recover(directory)
    try:
        is_folder = directory.is_dir()
    except (OSError, ValueError) as error:  # no permission; a name that no file can have
        raise ArchiveError(shown(str(directory)), "", shown(str(error)), "a plan directory") from error
    expected = "a plan directory, as cmbot plan writes it"
    if not is_folder:
        got = "a file, not a folder" if directory.is_file() else "no such folder"
        raise ArchiveError(str(directory), "", got, f"{expected}{plans_nearby(directory)}")
    path = directory / PLAN_FILE
    if not path.exists():
        # A path leaves out what "." adds.
        source = f"{directory}{os.sep}{PLAN_FILE}"
        raise ArchiveError(source, "", "no such file", f"{expected}{plans_nearby(directory)}")
    data = read_json(read_file(path), str(path))
    # Checked first: in another version anything else may differ.
    if data.get("format") not in (FORMAT, EARLIER_FORMAT):
        expected = f"{FORMAT!r} or {EARLIER_FORMAT!r}"
        raise ArchiveError(str(path), "format", shown(data.get("format")), expected)
    return data


def _contents(folder: Path, file: PlanFile, dof: int) -> dict[str, bytes]:
    """Read the files beside plan.json, each at most as large as a plan of that duration has them."""
    names: tuple[str, ...] = (*SAVED_FILES, *JOB_FILES)
    if file.format == EARLIER_FORMAT:
        names = SAVED_FILES if len(file.segments) == 1 else (*SAVED_FILES, *EARLIER_FILES)
    seconds = sum(segment.seconds for segment in file.segments)
    # The baseline's free moves are as quick as they can be.
    steps = dict.fromkeys(("trajectory", "job", "approach"), _ROWS_A_SECOND * seconds)
    steps["baseline"] = _ROWS_A_SECOND * _SLOWER_BASELINE * seconds + seconds / file.options.path_step_s
    contents = {}
    for name in names:
        motion, _, kind = name.partition(".")
        rows, width = steps[motion], len(columns(dof, compensated=True)) + _LABEL + _FEET
        largest = largest_knots(dof) if kind == "npz" else largest_table(rows, width)
        contents[name] = read_file(folder / name, largest)
    return contents


def _scene(file: PlanFile | EarlierPlanFile, source: Path) -> Scene:
    scene = scene_from_file(file.scene, source.parent, str(source))
    what = "the scene in this file or the meshes that it names have changed since"
    _require_hash(scene.content_hash, file.hashes.resolved_scene, source, "hashes.resolved_scene", what)
    # The hash is that of the file that the scene was read from.
    return replace(scene, content_hash=file.hashes.scene)


def _robot(scene: Scene, file: PlanFile | EarlierPlanFile, source: Path) -> Robot:
    robot = robot_of(scene)
    what = f"the robot's files have changed since ({robot.urdf}, SRDF, joint limits or elasticity)"
    _require_hash(robot.content_hash, file.hashes.robot, source, "hashes.robot", what)
    return robot


def _require_hash(got: str, expected: str, source: Path, key: str, what: str) -> None:
    if got != expected:
        raise ArchiveError(str(source), key, f"{got[:16]}… now", f"{expected[:16]}…: {what}; plan again")


def _sag(scene: Scene, robot: Robot, options: PlannerOptions) -> Sag | None:
    return sag_of(scene, bending_arm(scene, robot), options)


def _metrics(entry: MetricsFile, robot: Robot, task: ToolTask, t: FloatArray, q: FloatArray) -> MotionMetrics:
    """Return the metrics; the lag, which older files do not have, from postures `q` (N, n) at `t` (N,)."""
    lag = entry.max_tool_lag
    if lag is None:
        lag = float(tool_lag(task, t, Kinematics(robot).tool_poses(q)[0]).max())
    return made(MotionMetrics, entry, max_tool_lag=lag)


def _knots(trajectory: QuinticTrajectory) -> tuple[FloatArray, FloatArray]:
    """Times (N,) and postures (N, n) between the knots, and at them."""
    t = np.union1d(trajectory.t, 0.5 * (trajectory.t[:-1] + trajectory.t[1:]))
    return t, trajectory.evaluate(t)


def _certificate(entry: CertificateFile, metrics: MotionMetrics, source: Path, key: str) -> Certificate:
    checks = tuple(made(Check, check) for check in entry.checks)
    for index, (stored, check) in enumerate(zip(entry.checks, checks, strict=True)):
        if not (check.holds and stored.holds):
            where, got = f"{key}.checks[{index}]", f"a broken promise ({check.quantity})"
            raise ArchiveError(str(source), where, got, "kept ones")
    return made(Certificate, entry, checks=checks, figures=metrics)


def _job(
    file: PlanFile,
    trajectories: Sequence[QuinticTrajectory],
    robot: Robot,
    tasks: Sequence[ToolTask],
    source: Path,
) -> Job:
    segments, number = [], 0
    for k, (entry, trajectory) in enumerate(zip(file.segments, trajectories, strict=True)):
        # A free move belongs to the stroke that it leads to, the return to the last one.
        task = tasks[min(number, len(tasks) - 1)]
        own = task if entry.kind == "stroke" else task.held_at_start()
        metrics = _metrics(entry, robot, own, *_knots(trajectory))
        stored, key = entry.certificate, f"segments[{k}].certificate"
        if entry.kind == "stroke":
            number += 1
            if not file.strokes:
                stored, key = file.certificate, "certificate"
        elif file.format == EARLIER_FORMAT:
            key = "approach.certificate"
        certificate = _certificate(stored, metrics, source, key)
        segments.append(made(Segment, entry, trajectory=trajectory, certificate=certificate, task=own))
    return Job(segments=tuple(segments))


def _verified(plan: Plan, baseline: MotionFile, clearances: Clearances, source: Path) -> Plan:
    """Return the plan with new certificates; their metrics must be those in the file."""
    job = plan.job
    for k, segment in enumerate(plan.job.segments):
        certificate = _certified(plan, k, clearances)
        certificate.require()
        key = "planned" if segment.kind == "stroke" and not plan.several else f"segments[{k}]"
        _require_same(segment.figures, certificate.figures, source, key)
        job = job.changed(segment.name, certificate=certificate)
    prefixes = [f"strokes[{k}]." for k in range(len(plan.several))] or [""]
    for prefix, stroke in zip(prefixes, plan.strokes, strict=True):
        fresh = figures(plan.robot, stroke.baseline)
        _require_same(stroke.baseline_figures, fresh, source, f"{prefix}baseline")
        if not plan.objective.own:
            _verify_objective(plan, stroke, source, f"{prefix}objective")
    for name, stored, measured in (
        ("job", baseline.job, plan.baseline_job_figures),
        ("free", baseline.free, plan.baseline_free_figures),
    ):
        if stored is not None and measured is not None:
            _require_same(made(MotionMetrics, stored), measured, source, f"baseline.{name}")
    return replace(plan, job=job)


def _certified(plan: Plan, number: int, clearances: Clearances) -> Certificate:
    """Return a new certificate of a segment, by the scene and its neighbours, and by a second opinion."""
    robot, options, segments = plan.robot, plan.options, plan.job.segments
    segment = segments[number]
    at_work, trajectory = segment.kind == "stroke", segment.trajectory
    before = np.array(plan.scene.posture) if number == 0 else segments[number - 1].trajectory.q[-1]
    stroke, sag = None, None
    if at_work:
        stroke, sag = [each.name for each in plan.job.strokes].index(segment.name), plan.sag
        # Where it follows on a segment, that they join has been checked.
        rests_there = number == 0 and (options.knots == "sliding" or plan.scene.begins_elsewhere)
        number_of_via_points = plan.scene.each_stroke[stroke].via_points
        if not isinstance(number_of_via_points, int):
            expected = "a number, as plans have it"
            raise ArchiveError(
                plan.scene.source, "scene.tool_path.via_points", number_of_via_points, expected
            )
        certificate = certify(
            robot,
            segment.task,
            trajectory,
            clearances,
            options,
            via_points=number_of_via_points,
            start=before if rests_there else None,
            sag=sag,
        )
    else:
        # That the scene asks for a return, and where it leads to, has been checked.
        last = number + 1 == len(segments)
        after = np.array(end_posture_of(plan.scene, robot)) if last else segments[number + 1].trajectory.q[0]
        certificate = certify_move(robot, segment.task, trajectory, clearances, options, before, after)
    checks = second_opinion(plan.scene, options, trajectory, robot=robot, stroke=stroke, sag=sag)
    return replace(certificate, checks=(*certificate.checks, *checks))


def _verify_objective(plan: Plan, stroke: StrokePlan, source: Path, key: str) -> None:
    """Refuse peaks of the objective that are not those of the motions."""
    (segment,) = (each for each in plan.job.strokes if each.name == stroke.name)
    fresh = objective_metrics(
        objective_of(plan.robot, plan.options, sag=_sag(plan.scene, plan.robot, plan.options)),
        plan.options,
        own=False,
        baseline=(stroke.baseline_figures, stroke.baseline),
        planned=(segment.figures, segment.trajectory),
        floor=stroke.objective.floor,
    )
    _require_same(stroke.objective, fresh, source, key)


def _require_same(stored: object, fresh: object, source: Path, key: str) -> None:
    """Refuse numbers of a dataclass, or of one in it, that differ from the new ones.

    Files of earlier versions lack some. Where a peak is reached twice, its time is not determined.
    """
    for field in fields(fresh):  # type: ignore[arg-type]
        got, value = getattr(stored, field.name), getattr(fresh, field.name)
        if not (isinstance(value, float) or is_dataclass(value)) or got is None or field.name == "time":
            continue
        if is_dataclass(value):
            _require_same(got, value, source, f"{key}.{field.name}")
        elif not np.isclose(got, value, rtol=_SAME, atol=_SAME_ZERO):
            raise ArchiveError(str(source), f"{key}.{field.name}", got, f"{value:g}, as measured again")


@contextmanager
def _as_archive_error(source: str) -> Iterator[None]:
    """Turn errors of the scene or the robot into those of the plan."""
    try:
        yield
    except ArchiveError:
        raise
    except InputError as error:
        key = f"scene.{error.key}" if error.source == source else error.key
        raise ArchiveError(error.source, key, error.got, error.expected, error.choices) from error
