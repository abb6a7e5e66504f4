"""From a plan directory back to a plan."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from cmbot.archive.folder import FORMAT, PLAN_FILE, SAVED_FILES, read_file
from cmbot.archive.knots import read_knots
from cmbot.archive.schema import PlanFile
from cmbot.archive.strict_json import read_json
from cmbot.archive.tables import read_motion
from cmbot.arrays import FloatArray
from cmbot.errors import ArchiveError, InputError
from cmbot.planning import Certificate, MotionFigures, Plan, robot_of, task_of
from cmbot.planning.certificate import certify
from cmbot.planning.figures import figures, measure
from cmbot.robot import Robot
from cmbot.scene import Scene, scene_from_file_model
from cmbot.scene.clearance import Clearances
from cmbot.validation import shown, validated

__all__ = ["load_plan"]

# Figures computed again agree with those in the file to this relative and absolute tolerance: another machine
# rounds differently.
_SAME, _SAME_ZERO = 1e-6, 1e-9


def load_plan(directory: str | Path, *, verify: bool = False) -> Plan:
    """Read a plan directory.

    The scene is checked as if it came from a file, robot and meshes are loaded from where they were, and all
    of it must be what the plan was made with. The baseline's torques, clearances and tool points are measured
    again.

    Parameters
    ----------
    directory : str or Path
    verify : bool
        Certify the trajectory again (about a second) rather than take the file's word for it.

    Raises
    ------
    ArchiveError
        When a file is missing, damaged, of another version, or does not belong to the others; when robot,
        scene or meshes have changed since; with `verify`, when the file's figures are not the motion's.
    LimitViolation
        With `verify`, when the trajectory breaks a promise.
    """
    folder = Path(directory)
    file = _plan_file(folder)
    source = folder / PLAN_FILE
    certificate = _certificate(file, source)
    with _as_archive_error(str(source)):
        scene = _scene(file, source)
        robot = _robot(scene, file, source)
        task = task_of(scene, robot)
        clearances = Clearances(robot, scene.obstacles)
    contents = {name: read_file(folder / name) for name in SAVED_FILES}
    duration = task.path.duration
    trajectory = read_knots(contents["trajectory.npz"], str(folder / "trajectory.npz"), robot.dof)
    _require_times(trajectory.t, duration, str(folder / "trajectory.npz"))
    t, motion = read_motion(contents["baseline.csv"], str(folder / "baseline.csv"), robot.dof)
    _require_times(t, duration, str(folder / "baseline.csv"))
    _require_unchanged(folder, file, contents)

    baseline = measure(robot, task, clearances, t, motion)
    baseline_figures = file.baseline.figures()
    start = file.start.start()
    if start.posture.shape != (robot.dof,):
        raise ArchiveError(
            str(source), "start.posture_deg", f"{len(start.posture)} joints", f"{robot.dof} joints"
        )
    if verify:
        _require_same(baseline_figures, figures(robot, baseline), source, "baseline")
        fresh = certify(robot, task, trajectory, trajectory.q, clearances, file.options)
        fresh.require()
        _require_same(certificate.figures, fresh.figures, source, "planned")
        certificate = fresh
    return Plan(
        scene=scene,
        options=file.options,
        robot=robot,
        task=task,
        start=start,
        baseline=baseline,
        baseline_figures=baseline_figures,
        drift=file.drift,
        smallest_singular_value=file.smallest_singular_value,
        trajectory=trajectory,
        certificate=certificate,
        passes=tuple(entry.report() for entry in file.passes),
        seconds=file.seconds.seconds(),
    )


def _plan_file(folder: Path) -> PlanFile:
    try:
        is_folder = folder.is_dir()
    except (OSError, ValueError) as error:  # a folder that may not be entered; a name that no file can have
        raise ArchiveError(shown(str(folder)), "", shown(str(error)), "a plan directory") from error
    if not is_folder:
        expected = "a plan directory, as cmbot plan writes it"
        raise ArchiveError(str(folder), "", "no such folder", expected)
    source = folder / PLAN_FILE
    data = read_json(read_file(source), str(source))
    # First of all: in another version anything else may differ.
    if data.get("format") != FORMAT:
        raise ArchiveError(str(source), "format", shown(data.get("format")), repr(FORMAT))
    return validated(PlanFile, data, str(source), ArchiveError)


def _scene(file: PlanFile, source: Path) -> Scene:
    scene = scene_from_file_model(file.scene, source.parent, str(source))
    if scene.content_hash != file.hashes.resolved_scene:
        raise _changed(
            source,
            "hashes.resolved_scene",
            scene.content_hash,
            file.hashes.resolved_scene,
            "the scene in this file or the meshes that it names have changed since",
        )
    # The scene's identity is that of the file it came from, wherever that lay.
    return replace(scene, content_hash=file.hashes.scene)


def _robot(scene: Scene, file: PlanFile, source: Path) -> Robot:
    robot = robot_of(scene)
    if robot.content_hash != file.hashes.robot:
        raise _changed(
            source,
            "hashes.robot",
            robot.content_hash,
            file.hashes.robot,
            f"the robot's files have changed since ({robot.urdf}, its SRDF or its joint limits)",
        )
    return robot


def _changed(source: Path, key: str, got: str, expected: str, what: str) -> ArchiveError:
    return ArchiveError(str(source), key, f"{got[:16]}… now", f"{expected[:16]}…: {what}; plan again")


def _require_times(t: FloatArray, duration: float, source: str) -> None:
    if t[0] != 0.0 or abs(t[-1] - duration) > 1e-9 * duration:
        raise ArchiveError(source, "t", f"{t[0]:g} to {t[-1]:g} s", f"0 to {duration:g} s, as in the scene")


def _require_unchanged(folder: Path, file: PlanFile, contents: dict[str, bytes]) -> None:
    """Refuse files that were not saved together: the figures would be another motion's."""
    for name, content in contents.items():
        if file.files.get(name) != hashlib.sha256(content).hexdigest():
            expected = f"the file that was saved with {PLAN_FILE}"
            raise ArchiveError(str(folder / name), "", "other content", expected)


def _certificate(file: PlanFile, source: Path) -> Certificate:
    checks = tuple(entry.check() for entry in file.certificate.checks)
    for index, (entry, check) in enumerate(zip(file.certificate.checks, checks, strict=True)):
        if not (check.holds and entry.holds):
            raise ArchiveError(
                str(source),
                f"certificate.checks[{index}]",
                f"a broken promise ({check.quantity})",
                "kept ones",
            )
    return Certificate(
        checks=checks,
        figures=file.planned.figures(),
        clearance_bound=file.certificate.clearance_bound_m(),
    )


def _require_same(stored: MotionFigures, fresh: MotionFigures, source: Path, key: str) -> None:
    def flat(motion: MotionFigures) -> dict[str, float]:
        values = asdict(motion)
        return values | {f"limit_use.{name}": value for name, value in values.pop("limit_use").items()}

    for name, value in flat(fresh).items():
        got = flat(stored)[name]
        if not np.isclose(got, value, rtol=_SAME, atol=_SAME_ZERO):
            raise ArchiveError(str(source), f"{key}.{name}", got, f"{value:g}, as measured again")


@contextmanager
def _as_archive_error(source: str) -> Iterator[None]:
    """Say of a scene or a robot that cannot be had any more that the plan cannot be read."""
    try:
        yield
    except ArchiveError:
        raise
    except InputError as error:
        key = f"scene.{error.key}" if error.source == source else error.key
        raise ArchiveError(error.source, key, error.got, error.expected, error.choices) from error
