"""A plan from its directory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.archive.atomic import recover
from cmbot.archive.consistency import require_fit, require_segments, require_times, require_unchanged
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
    PlanFile,
    made,
)
from cmbot.archive.strict_json import read_json
from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.validation import given_path, shown, validated
from cmbot.elastic.sag import Sag
from cmbot.planning import (
    RETURN,
    Certificate,
    Check,
    Job,
    MotionMetrics,
    ObjectiveMetrics,
    Plan,
    QuinticTrajectory,
    Segment,
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
    second_opinion,
    strokes_of,
    task_of,
    tool_lag,
)
from cmbot.robot import Kinematics, Robot
from cmbot.scene import PlannerOptions, Scene, scene_from_file

__all__ = ["load_plan", "plan_data"]

# Relative and absolute tolerance of metrics computed again: processors round differently.
_SAME, _SAME_ZERO = 1e-6, 1e-9
# Of the tables of planned motions.
_ROWS_A_SECOND = 100.0
# Cells of a table that a segment's name is as long as, at most.
_LABEL = 5


def load_plan(directory: str | Path, *, verify: bool = False) -> Plan:
    """Read a plan directory.

    Where a call that wrote there was killed, what it left is put back first, with a warning.

    The scene is checked as one from a file. Robot and meshes are loaded from their paths and must not have
    changed since the plan was made. The baseline's torques, clearances and tool points are computed again.

    Parameters
    ----------
    directory : str or Path
    verify : bool
        Certify trajectory and approach again (some seconds). Peaks of a custom objective are not checked: the
        file has only its name.

    Raises
    ------
    InputError
        When `directory` is no path.
    ArchiveError
        When a file is missing, damaged, of another version, or contradicts the others; when robot, scene or
        meshes have changed since; with `verify`, when the metrics in the file are not those of the motion.
    LimitViolation
        With `verify`, when trajectory or approach breaks a promise.
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
        scene = _scene(read, data, source)
        robot = _robot(scene, read, source)
        task = task_of(strokes_of(scene, robot)[0], scene)
        end = end_posture_of(scene, robot)
        clearances = Clearances(robot, scene.obstacles)
    duration = task.path.duration
    file = read.upgraded(duration) if isinstance(read, EarlierPlanFile) else read
    require_segments(file, folder, begins_elsewhere=scene.begins_elsewhere, returns=end is not None)
    contents = _contents(folder, file, robot.dof, duration)
    # What is in them is looked at only when they are the ones that were saved.
    require_unchanged(folder, file, contents)
    trajectories = job_trajectories(file, contents, folder, robot.dof, duration)
    job = _job(file, trajectories, robot, task, source)
    t, motion = read_motion(contents["baseline.csv"], str(folder / "baseline.csv"), robot.dof)
    require_times(t, duration, str(folder / "baseline.csv"), "the scene")
    require_fit(file, np.array(scene.posture), end, job, folder)
    plan = Plan(
        scene=scene,
        options=file.options,
        robot=robot,
        task=task,
        start=file.start.made(),
        baseline=measure(robot, task, clearances, t, motion),
        baseline_figures=_metrics(file.baseline, robot, task, t, motion[0]),
        drift=file.drift,
        smallest_singular_value=file.smallest_singular_value,
        job=job,
        passes=file.passes,
        objective=made(ObjectiveMetrics, file.objective),
        lower_bound=None if file.floor is None else file.floor.made(),
        choice=file.choice,
        compensation=file.compensation,
        quieting=None if file.quieting is None else file.quieting.made(),
        sag=_sag(scene, robot, file.options) if file.options.compensate else None,
        fallbacks=file.fallbacks,
        seconds=file.seconds,
    )
    return _verified(plan, file.baseline.job, clearances, source) if verify else plan


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
        raise ArchiveError(str(path), "", "no such file", f"{expected}{plans_nearby(directory)}")
    data = read_json(read_file(path), str(path))
    # Checked first: in another version anything else may differ.
    if data.get("format") not in (FORMAT, EARLIER_FORMAT):
        expected = f"{FORMAT!r} or {EARLIER_FORMAT!r}"
        raise ArchiveError(str(path), "format", shown(data.get("format")), expected)
    return data


def _contents(folder: Path, file: PlanFile, dof: int, duration: float) -> dict[str, bytes]:
    """Read the files beside plan.json, each at most as large as a plan of that duration, s, has them."""
    names: tuple[str, ...] = (*SAVED_FILES, *JOB_FILES)
    if file.format == EARLIER_FORMAT:
        names = SAVED_FILES if len(file.segments) == 1 else (*SAVED_FILES, *EARLIER_FILES)
    seconds = dict.fromkeys(("job", "approach"), sum(segment.seconds for segment in file.segments))
    steps = {name: _ROWS_A_SECOND * value for name, value in ({"trajectory": duration} | seconds).items()}
    steps["baseline"] = duration / file.options.path_step_s
    contents = {}
    for name in names:
        motion, _, kind = name.partition(".")
        rows, width = steps[motion], len(columns(dof, compensated=True)) + _LABEL
        largest = largest_knots(dof) if kind == "npz" else largest_table(rows, width)
        contents[name] = read_file(folder / name, largest)
    return contents


def _scene(file: PlanFile | EarlierPlanFile, data: dict[str, Any], source: Path) -> Scene:
    scene = scene_from_file(file.scene, source.parent, str(source), data["scene"])
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
    task: ToolTask,
    source: Path,
) -> Job:
    segments = []
    for k, (entry, trajectory) in enumerate(zip(file.segments, trajectories, strict=True)):
        own = task if entry.kind == "stroke" else task.held_at_start()
        metrics = _metrics(entry, robot, own, *_knots(trajectory))
        stored, key = entry.certificate, f"segments[{k}].certificate"
        if entry.kind == "stroke":
            stored, key = file.certificate, "certificate"
        elif file.format == EARLIER_FORMAT:
            key = "approach.certificate"
        certificate = _certificate(stored, metrics, source, key)
        segments.append(made(Segment, entry, trajectory=trajectory, certificate=certificate, task=own))
    return Job(segments=tuple(segments))


def _verified(plan: Plan, baseline_job: MetricsFile | None, clearances: Clearances, source: Path) -> Plan:
    """Return the plan with new certificates; their metrics must be those in the file."""
    job = plan.job
    for k, segment in enumerate(plan.job.segments):
        certificate = _certified(plan, segment, clearances)
        certificate.require()
        key = "planned" if segment.kind == "stroke" else f"segments[{k}]"
        _require_same(segment.figures, certificate.figures, source, key)
        job = job.changed(segment.name, certificate=certificate)
    _require_same(plan.baseline_figures, figures(plan.robot, plan.baseline), source, "baseline")
    if baseline_job is not None:
        expected = made(MotionMetrics, baseline_job)
        _require_same(expected, plan.baseline_job_figures, source, "baseline.job")
    if not plan.objective.own:
        _verify_objective(plan, source)
    return replace(plan, job=job)


def _certified(plan: Plan, segment: Segment, clearances: Clearances) -> Certificate:
    """Return a new certificate of a segment, by the scene and its neighbours, and by a second opinion."""
    robot, options, trajectory = plan.robot, plan.options, segment.trajectory
    posture, at_work = np.array(plan.scene.posture), segment.kind == "stroke"
    sag = plan.sag if at_work else None
    if at_work:
        approaches = options.knots == "sliding" or plan.scene.begins_elsewhere
        rests_there = approaches and plan.approach is None
        certificate = certify(
            robot,
            plan.task,
            trajectory,
            clearances,
            options,
            via_points=plan.scene.via_points,
            start=posture if rests_there else None,
            sag=sag,
        )
    else:
        held = plan.task.held_at_start()
        start, end = posture, plan.trajectory.q[0]
        if segment.name == RETURN:
            # That the scene asks for it, and where it leads to, has been checked.
            start, end = plan.trajectory.q[-1], np.array(end_posture_of(plan.scene, robot))
        certificate = certify_move(robot, held, trajectory, clearances, options, start, end)
    checks = second_opinion(
        plan.scene, options, trajectory, robot=robot, stroke=0 if at_work else None, sag=sag
    )
    return replace(certificate, checks=(*certificate.checks, *checks))


def _verify_objective(plan: Plan, source: Path) -> None:
    """Refuse peaks of the objective that are not those of the motions."""
    fresh = objective_metrics(
        objective_of(plan.robot, plan.options, sag=_sag(plan.scene, plan.robot, plan.options)),
        plan.options,
        own=False,
        baseline=(plan.baseline_figures, plan.baseline),
        planned=(plan.figures, plan.trajectory),
        floor=plan.objective.floor,
    )
    _require_same(plan.objective, fresh, source, "objective")


def _require_same(stored: object, fresh: object, source: Path, key: str) -> None:
    """Refuse numbers of a dataclass, or of one in it, that differ from the new ones."""
    for field in fields(fresh):  # type: ignore[arg-type]
        got, value = getattr(stored, field.name), getattr(fresh, field.name)
        if is_dataclass(value):
            _require_same(got, value, source, f"{key}.{field.name}")
        elif isinstance(value, float) and not np.isclose(got, value, rtol=_SAME, atol=_SAME_ZERO):
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
