"""A plan from its directory."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.accuracy import Accuracy
from cmbot.archive.consistency import require_fit, require_same, require_segments
from cmbot.archive.folder import read_folder, without_hashes
from cmbot.archive.knots import require_times, segment_trajectories
from cmbot.archive.names import BASELINE_FILE, JOB_FILES, PLAN_FILE, PLAN_FILES
from cmbot.archive.places import plans_nearby
from cmbot.archive.plan_file import (
    BaselineFile,
    JobBaselineFile,
    PlanFile,
    SegmentFile,
    StrokeEntries,
    made,
)
from cmbot.archive.tables import read_motion
from cmbot.archive.verification.asked import require_asked, require_promised
from cmbot.archive.verification.exported import unverified_files
from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.validation import given_path, require_type, shown, validated
from cmbot.elastic.sag import Sag
from cmbot.planning import (
    Baseline,
    Certificate,
    Job,
    MotionMetrics,
    Plan,
    QuinticTrajectory,
    Samples,
    Segment,
    StrokeBaseline,
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
    resolved_options,
    robot_of,
    sag_of,
    strokes_of,
    task_of,
)
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Kinematics, Robot
from cmbot.scene import PlannerOptions, Scene

# Relative and absolute tolerance of metrics computed again: processors round differently.
_SAME, _SAME_ZERO = 1e-6, 1e-9
# The same of what is drawn in single precision.
_SAME_DRAWN = 1e-4


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
) -> tuple[Plan, tuple[str, ...]]:
    """Read a plan directory as `load_plan` does; return also the names of files that were not compared."""
    source = folder / PLAN_FILE

    def listed(hashes: Mapping[str, str]) -> tuple[str, ...]:
        own = [name for name in PLAN_FILES if name in hashes or name in JOB_FILES]
        shown_files = sorted(hashes.keys() - {*PLAN_FILES}) if verify else ()
        return (*own, *(name for name in shown_files if (folder / name).exists()))

    data, contents = _read(folder, listed)
    try:
        file = validated(PlanFile, without_hashes(data), str(source), ArchiveError)
    except ArchiveError as error:
        # Its content is as it was written: most likely by a version with other keys.
        expected = f"{error.expected}; of a plan of another version: cmbot plan SCENE makes it anew"
        raise ArchiveError(error.source, error.key, error.got, expected, error.choices) from error
    with _as_archive_error(str(source)):
        scene = file.scene.with_source(str(source))
        robot = _robot(scene, file, source)
        what = "the scene in this file or the meshes that it names have changed since"
        _require_hash(scene.content_hash, file.hashes.scene, source, "hashes.scene", what)
        strokes = strokes_of(scene, robot)
        end = end_posture_of(scene, robot)
        clearances = Clearances(robot, scene.all_obstacles)
    if asked is not None:
        require_asked(scene, asked, str(source))
    promised = options or (asked.planner if asked is not None else file.options)
    require_promised(file.options, resolved_options(scene, robot, promised), str(source), "options")
    require_segments(file, str(source), scene, returns=end is not None)
    knots = str(folder / JOB_FILES[1])
    trajectories = segment_trajectories(file, contents[JOB_FILES[1]], knots, robot.dof, strokes)
    tasks = [task_of(stroke, scene) for stroke in strokes]
    job = _job(file, trajectories, tasks, source)
    require_fit(file, np.array(scene.posture), end, job, str(source), knots)
    plan = Plan.of(
        _stroke_plans(file, folder, contents, [stroke.name for stroke in strokes], tasks, robot, clearances),
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
    peaks = [joint.peak_nm for joint in file.holding_joints.values()]
    vars(plan)["holding_torque"] = np.array(peaks) if peaks else None
    if plan.several and plan.baseline is not None:
        _require_straight(plan.baseline, contents[BASELINE_FILE], str(folder / BASELINE_FILE), robot.dof)
    again = PlanFile.of_plan(plan, file.hashes).as_data()
    if file.baseline is not None:
        # Its free moves are not in the table but measured again, which is compared where it is verified.
        again["baseline"] |= {name: data["baseline"][name] for name in ("free", "job")}
    # What it was made of, and by what, is not computed.
    given = {name: data[name] for name in ("scene", "versions")}
    require_same(without_hashes(data), again | given, str(source), "")
    if not verify:
        return plan, ()
    plan = _verified(plan, file.baseline, clearances, source)
    _require_told(file, plan, source)
    return plan, unverified_files(plan, folder)


def _require_told(file: PlanFile, plan: Plan, source: Path) -> None:
    """Refuse what a file tells of accuracy, sway and locked joints if a verified plan has it otherwise."""
    _require_accuracy(file.accuracy, plan.accuracy, source)
    sways = [None if sway is None else asdict(sway) for sway in (file.sway, plan.sway)]
    require_same(sways[0], sways[1], str(source), "sway", _SAME_DRAWN, _SAME_ZERO)
    peaks = [] if plan.holding_torque is None else plan.holding_torque.tolist()
    told, held = (
        {name: {"peak_nm": peak} for name, peak in zip(file.holding_joints, values, strict=True)}
        for values in ([joint.peak_nm for joint in file.holding_joints.values()], peaks)
    )
    require_same(told, held, str(source), "holding_joints", _SAME, _SAME_ZERO)


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
    except (OSError, ValueError) as error:  # no permission; a name that no file can have
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


def _robot(scene: Scene, file: PlanFile, source: Path) -> Robot:
    robot = robot_of(scene)
    what = f"the robot's files have changed since ({robot.urdf}, SRDF, joint limits or elasticity)"
    _require_hash(robot.content_hash, file.hashes.robot, source, "hashes.robot", what)
    return robot


def _require_hash(got: str, expected: str, source: Path, key: str, what: str) -> None:
    if got != expected:
        raise ArchiveError(str(source), key, f"{got[:16]}… now", f"{expected[:16]}…: {what}; plan again")


def _job(
    file: PlanFile, trajectories: Sequence[QuinticTrajectory], tasks: Sequence[ToolTask], source: Path
) -> Job:
    segments, number = [], 0
    for k, (entry, trajectory) in enumerate(zip(file.segments, trajectories, strict=True)):
        # A free move belongs to the stroke that it leads to, the return to the last one.
        task = tasks[min(number, len(tasks) - 1)]
        own = task if entry.kind == "stroke" else task.held_at_start()
        number += entry.kind == "stroke"
        certificate = _certificate(entry, str(source), f"segments[{k}].certificate")
        segments.append(made(Segment, entry, trajectory=trajectory, certificate=certificate, task=own))
    return Job(segments=tuple(segments))


def _certificate(entry: SegmentFile, source: str, key: str) -> Certificate:
    certificate = entry.certificate.made(made(MotionMetrics, entry))
    for index, check in enumerate(certificate.checks):
        if not check.holds:
            got = f"a broken promise ({check.quantity})"
            raise ArchiveError(source, f"{key}.checks[{index}]", got, "kept ones")
    return certificate


def _stroke_plans(
    file: PlanFile,
    folder: Path,
    contents: Mapping[str, bytes],
    names: Sequence[str],
    tasks: Sequence[ToolTask],
    robot: Robot,
    clearances: Clearances,
) -> list[StrokePlan]:
    """What is planned of each stroke, beside its baseline."""
    entries: tuple[StrokeEntries, ...] = file.strokes or (file,)
    baselines: Sequence[StrokeBaseline | None] = [None] * len(entries)
    if file.baseline is not None:
        baselines = _baselines(file, folder, contents.get(BASELINE_FILE), tasks, robot, clearances)
    strokes = []
    for entry, name, task, baseline in zip(entries, names, tasks, baselines, strict=True):
        own = {"start": entry.start.made(), "lower_bound": entry.floor, "baseline": baseline}
        strokes.append(made(StrokePlan, entry, name=name, task=task, **own))
    return strokes


def _baselines(
    file: PlanFile,
    folder: Path,
    content: bytes | None,
    tasks: Sequence[ToolTask],
    robot: Robot,
    clearances: Clearances,
) -> list[StrokeBaseline]:
    """The baseline along each stroke, from the content of its table."""
    source = str(folder / BASELINE_FILE)
    if content is None:
        expected = f"the file that was saved with {PLAN_FILE}"
        raise ArchiveError(str(folder / PLAN_FILE), "files", f"no {BASELINE_FILE}", expected)
    t, motion = read_motion(content, source, robot.dof)
    if not file.strokes:
        require_times(t, tasks[0].path.duration, source, "the scene")
    baselines = []
    for entry, task in zip(file.strokes or (file,), tasks, strict=True):
        stored: BaselineFile | None = entry.baseline
        if stored is None:  # where one of several strokes lacks it
            raise ArchiveError(str(folder / PLAN_FILE), "strokes", "baseline: null", "one of every stroke")
        begin = getattr(stored, "begin", 0.0)
        rows = _rows(t, begin, begin + task.path.duration, source)
        samples = measure(robot, task, clearances, t[rows] - t[rows[0]], [array[rows] for array in motion])
        baselines.append(made(StrokeBaseline, stored, samples=samples, figures=made(MotionMetrics, stored)))
    return baselines


def _rows(t: FloatArray, begin: float, end: float, source: str) -> IntArray:
    """Which of the times `t` (N,) of a table are those of a stroke."""
    room = _SAME_ZERO * max(end, 1.0)
    rows = np.flatnonzero((t >= begin - room) & (t <= end + room))
    if not len(rows) or abs(t[rows[0]] - begin) > room or abs(t[rows[-1]] - end) > room:
        expected = f"rows from {begin:g} to {end:g} s"
        raise ArchiveError(source, "t", "no row where a stroke begins or ends", expected)
    return rows


def _require_straight(baseline: Baseline, content: bytes, source: str, dof: int) -> None:
    """Refuse a table of a baseline with other motions between its strokes than the quickest straight ones."""
    t, motion = read_motion(content, source, dof)
    if not (_agree(baseline.samples.t, t) and _agree(baseline.samples.q, motion[0])):
        raise ArchiveError(source, "", "other motions between the strokes", "the quickest straight ones")


def _agree(got: FloatArray, expected: FloatArray) -> bool:
    return got.shape == expected.shape and np.allclose(got, expected, rtol=_SAME_ZERO, atol=_SAME_ZERO)


def _sag(scene: Scene, robot: Robot, options: PlannerOptions) -> Sag | None:
    return sag_of(scene, bending_arm(scene, robot), options)


# Certified again


def _require_accuracy(stored: Accuracy | None, computed: Accuracy | None, source: Path) -> None:
    """Refuse another accuracy budget than that of the motion; its draws are in single precision."""

    def by_name(accuracy: Accuracy | None) -> object:
        """Its entries, in an order that does not depend on their sizes."""
        if accuracy is None:
            return None
        listed = ("parts", "remedies")
        named = {name: {each.name: asdict(each) for each in getattr(accuracy, name)} for name in listed}
        return asdict(accuracy) | named

    given, again = by_name(stored), by_name(computed)
    require_same(given, again, str(source), "accuracy", _SAME_DRAWN, _SAME_ZERO)


def _verified(plan: Plan, stored: JobBaselineFile | None, clearances: Clearances, source: Path) -> Plan:
    """Return the plan with new certificates; their metrics must be those in the file."""
    job = plan.job
    for k, segment in enumerate(plan.job.segments):
        certificate = _certified(plan, k, clearances)
        certificate.require()
        key = "planned" if segment.kind == "stroke" and not plan.several else f"segments[{k}]"
        _require_again(segment.figures, certificate.figures, source, key)
        job = job.changed(segment.name, certificate=certificate)
    prefixes = [f"strokes[{k}]." for k in range(len(plan.several))] or [""]
    for prefix, stroke in zip(prefixes, plan.strokes, strict=True):
        if stroke.baseline is not None:
            _verify_baseline(plan.robot, stroke.task, stroke.baseline, source, f"{prefix}baseline")
        if not plan.objective.own:
            _verify_objective(plan, stroke, source, f"{prefix}objective")
    if stored is not None and plan.baseline is not None:
        _require_again(stored.job, plan.baseline.job_figures, source, "baseline.job")
        if stored.free is not None and plan.baseline.free_figures is not None:
            _require_again(stored.free, plan.baseline.free_figures, source, "baseline.free")
    return replace(plan, job=job)


def _verify_baseline(robot: Robot, task: ToolTask, baseline: StrokeBaseline, source: Path, key: str) -> None:
    """Refuse figures of a baseline that are not those of its motion."""
    _require_again(baseline.figures, figures(robot, baseline.samples), source, key)
    for name, value in _along_baseline(robot, task, baseline.samples).items():
        require_same(getattr(baseline, name), value, str(source), f"{key}.{name}", _SAME, _SAME_ZERO)


def _certified(plan: Plan, number: int, clearances: Clearances) -> Certificate:
    """Return a new certificate of a segment, by the scene and its neighbours, and by a second opinion."""
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
            # Where it follows on a segment, that they join has been checked.
            start=before if number == 0 else None,
            sag=sag,
        )
    else:
        # That the scene asks for a return, and where it leads to, has been checked.
        last = number + 1 == len(segments)
        after = np.array(end_posture_of(plan.scene, robot)) if last else segments[number + 1].trajectory.q[0]
        certificate = certify_move(robot, segment.task, trajectory, clearances, options, before, after)
    checks = second_opinion(plan.scene, options, trajectory, robot=robot, stroke=stroke, sag=sag)
    return replace(certificate, checks=(*certificate.checks, *checks))


def _along_baseline(robot: Robot, task: ToolTask, baseline: Samples) -> dict[str, float]:
    """What a stroke has of its baseline beside the figures: `drift` and `smallest_singular_value`."""
    kinematics, task = Kinematics(robot), task.on_axis
    smallest = np.inf
    for q in baseline.q:
        X_WT, J = kinematics.tool_jacobian(q)
        J = task.jacobian(X_WT.rotation, robot.metric.positions(J))
        smallest = min(smallest, float(np.linalg.svd(J, compute_uv=False)[-1]))
    away = baseline.tool_point - task.path.poses(baseline.t).point
    drift = float(np.linalg.norm(away, axis=1).max())
    return {"drift": drift, "smallest_singular_value": smallest}


def _verify_objective(plan: Plan, stroke: StrokePlan, source: Path, key: str) -> None:
    """Refuse peaks of the objective that are not those of the motions."""
    (segment,) = (each for each in plan.job.strokes if each.name == stroke.name)
    fresh = objective_metrics(
        objective_of(plan.robot, plan.options, sag=_sag(plan.scene, plan.robot, plan.options)),
        plan.options,
        own=False,
        baseline=stroke.baseline,
        planned=(segment.figures, segment.trajectory),
        floor=stroke.objective.floor,
    )
    _require_again(stroke.objective, fresh, source, key)


def _require_again(stored: Any, fresh: Any, source: Path, key: str) -> None:
    """Refuse figures that differ from those that are measured again."""
    require_same(asdict(stored), asdict(fresh), str(source), key, _SAME, _SAME_ZERO)


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
