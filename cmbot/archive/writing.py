"""A plan as the files of its directory."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from cmbot.archive.folder import shown_files, write_folder
from cmbot.archive.motion_files import motion_files, samples_csv
from cmbot.archive.names import FORMAT, PLAN_FILE
from cmbot.archive.schema import PlanFile
from cmbot.archive.strict_json import json_bytes
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.common.validation import given_path, input_error, validated
from cmbot.planning import Plan, Segment, StrokePlan, require_plan
from cmbot.robot import Robot
from cmbot.scene import Mesh, Scene, SceneFile, scene_from_file, update_file
from cmbot.version import versions

__all__ = ["resolved_file", "save", "stroke_entries"]


def save(
    plan: Plan,
    directory: str | Path,
    *,
    force: bool = False,
    added: Mapping[str, bytes | str] | None = None,
) -> Path:
    """Write a plan directory; it appears whole or not at all.

    Parameters
    ----------
    plan : Plan
    directory : str or Path
        A new folder; folders above it are made as needed.
    force : bool
        Replace the plan that is there, with its pages, plots and tracking errors; never another folder.
        Files of other names are not the plan's: they stay.
    added : mapping from str to bytes or str, optional
        Pages and plots that appear with it, by their names: those that the command line gives them.

    Returns
    -------
    Path
        The directory.

    Raises
    ------
    InputError
        When `plan` is no Plan, or `directory` no path.
    ArchiveError
        When something is in the way, another process is writing there, the system refuses, or the plan holds
        a number that is not finite.
    SceneError
        When a file that the scene names is missing, or Python made a scene that no scene file describes.

    Examples
    --------
    >>> folder = cmbot.save(plan, "out/triangle")
    >>> (folder / "job.csv").is_file()
    True
    """
    require_plan(plan, "cmbot.save")
    directory = given_path(directory, "cmbot.save", "directory", "the path of a new folder")
    shown = shown_files(added)
    contents = motion_files("trajectory", plan.robot, plan.trajectory, plan.samples)
    contents["baseline.csv"] = samples_csv(plan.baseline, "baseline.csv")
    contents |= motion_files("job", plan.robot, plan.job.trajectory, *plan.job_samples)
    contents[PLAN_FILE] = _plan_json(plan, contents)
    write_folder(contents | shown, directory, force=force)
    return directory


def _plan_json(plan: Plan, contents: Mapping[str, bytes]) -> bytes:
    given = update_file(plan.scene)
    scene = resolved_file(given)
    entries = {
        "format": FORMAT,
        "status": "certified" if plan.job.certificate.holds else "a promise is broken",
        **stroke_entries(plan, plan.robot),
        "baseline": {
            **vars(plan.baseline_figures),
            "free": plan.baseline_free_figures,
            "job": plan.baseline_job_figures,
        },
        "planned": {**vars(plan.figures), "free": plan.job.free_figures, "job": plan.job.figures},
        "segments": tuple(map(_segment, plan.job.segments)),
        "strokes": tuple(_several(plan)),
        "torque_floor": plan.torque_floor,
        "torque_floor_kind": plan.torque_floor_kind,
        "torque_floor_error": plan.torque_floor_error,
        "gap_to_floor": plan.gap_to_floor,
        "fallbacks": plan.fallbacks,
        "seconds": plan.seconds,
        "certificate": plan.certificate,
        "options": plan.options,
        "scene": scene,
        "versions": versions(),
        "hashes": {
            "robot": plan.robot.content_hash,
            "scene": given.content_hash,
            "resolved_scene": scene_from_file(scene, Path.cwd(), plan.scene.source).content_hash,
        },
        "files": {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()},
    }
    try:
        file = PlanFile.model_validate(entries, from_attributes=True)
    except ValidationError as error:
        raise input_error(PLAN_FILE, error, ArchiveError, PlanFile) from error
    data = file.model_dump()
    # What could not be read back is not written.
    validated(PlanFile, data, PLAN_FILE, ArchiveError)
    first = {name: data[name] for name in ("format", "status", "baseline", "planned")}
    return json_bytes(first | data, indent=2)


def stroke_entries(stroke: StrokePlan, robot: Robot) -> dict[str, object]:
    """Return the entries of what is planned of a stroke, or of a plan of all of them."""
    start, bound = stroke.start, stroke.lower_bound
    return {
        "baseline": stroke.baseline_figures,
        "suppression": stroke.suppression,
        "compensation": stroke.compensation,
        "objective": stroke.objective,
        "floor": None if bound is None else {**vars(bound), "each": tuple(bound.each.tolist())},
        "choice": stroke.choice,
        "start": {
            **_posture(start.posture, robot),
            "moved_deg": float(np.degrees(start.moved)),
            "failures": start.failures,
        },
        "drift": stroke.drift,
        "smallest_singular_value": stroke.smallest_singular_value,
        "passes": stroke.passes,
    }


def _several(plan: Plan) -> Iterator[dict[str, object]]:
    """The entries of each of several strokes."""
    begins = {each.name: each.begin for each in plan.baseline_segments}
    for stroke in plan.several:
        begin = begins[stroke.name] - begins[plan.strokes[0].name]
        yield {**stroke_entries(stroke, plan.robot), "name": stroke.name, "baseline_begin": begin}


def _posture(q: FloatArray, robot: Robot) -> dict[str, tuple[float, ...]]:
    """A posture in degrees, or in rad and m where joints slide."""
    if robot.limits.prismatic.any():
        return {"posture": tuple(q.tolist())}
    return {"posture_deg": tuple(np.degrees(q).tolist())}


def _segment(segment: Segment) -> dict[str, object]:
    names = ("name", "kind", "begin", "along_self_motion", "certificate")
    entries = {name: getattr(segment, name) for name in names}
    return {**vars(segment.figures), **entries, "seconds": segment.duration}


def resolved_file(scene: Scene) -> SceneFile:
    """Return the scene's content with absolute paths, so that it can be read back from anywhere."""
    # The scene's own obstacles come before the guardrail's members.
    shapes = [obstacle.shape for obstacle in scene.obstacles[: len(scene.file.obstacles)]]
    obstacles = tuple(
        file.model_copy(update={"mesh": str(shape.path)}) if isinstance(shape, Mesh) else file
        for file, shape in zip(scene.file.obstacles, shapes, strict=True)
    )
    paths = {name: getattr(scene.robot, name) for name in ("model", "limits", "srdf", "elasticity")}
    resolved: dict[str, object] = {name: str(path) for name, path in paths.items() if path is not None}
    if scene.robot.package_dirs is not None:
        resolved["package_dirs"] = tuple(map(str, scene.robot.package_dirs))
    robot = scene.file.robot.model_copy(update=resolved)
    return scene.file.model_copy(update={"obstacles": obstacles, "robot": robot})
