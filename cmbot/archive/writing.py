"""From a plan to the files of its directory."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.archive.folder import FORMAT, PLAN_FILE, write_folder
from cmbot.archive.knots import knots_npz
from cmbot.archive.ros import ros_json
from cmbot.archive.schema import PlanFile, or_null
from cmbot.archive.strict_json import json_bytes
from cmbot.archive.tables import samples_csv
from cmbot.common.errors import ArchiveError
from cmbot.common.validation import given_path, validated
from cmbot.planning import (
    Approach,
    Certificate,
    MotionMetrics,
    Plan,
    QuinticTrajectory,
    Samples,
    Start,
    require_plan,
)
from cmbot.robot import Robot
from cmbot.scene import Mesh, Scene, SceneFile, scene_from_file, update_file
from cmbot.version import __version__

__all__ = ["save"]

_PACKAGES = ("numpy", "scipy", "pin", "coal")


def save(plan: Plan, directory: str | Path, *, force: bool = False) -> Path:
    """Write a plan directory; it appears whole or not at all.

    Parameters
    ----------
    plan : Plan
    directory : str or Path
        A new folder; folders above it are made as needed.
    force : bool
        Replace the plan that is there, with all files that were added to it. What is no plan directory is
        never replaced.

    Returns
    -------
    Path
        The directory.

    Raises
    ------
    InputError
        When `plan` is none, or `directory` no path.
    ArchiveError
        When something is in the way, the system refuses, or the plan holds a number that is not finite.
    SceneError
        When a file that the scene names has gone since, or Python changed the scene into one that no scene
        file describes.
    """
    require_plan(plan, "cmbot.save")
    directory = given_path(directory, "cmbot.save", "directory", "the path of a new folder")
    contents = _motion_files("trajectory", plan.robot, plan.trajectory, plan.samples)
    contents["baseline.csv"] = samples_csv(plan.baseline, "baseline.csv")
    if plan.approach is not None and plan.approach_samples is not None:
        contents |= _motion_files("approach", plan.robot, plan.approach.trajectory, plan.approach_samples)
    contents[PLAN_FILE] = _plan_json(plan, contents)
    write_folder(contents, directory, force=force)
    return directory


def _motion_files(
    name: str, robot: Robot, trajectory: QuinticTrajectory, samples: Samples
) -> dict[str, bytes]:
    """Return the files of a planned motion."""
    return {
        f"{name}.csv": samples_csv(samples, f"{name}.csv"),
        f"{name}.npz": knots_npz(trajectory),
        f"{name}.ros.json": ros_json(robot, samples),
    }


def _plan_json(plan: Plan, contents: Mapping[str, bytes]) -> bytes:
    given = update_file(plan.scene)
    scene = _resolved(given)
    approach, bound, choice, quieting = plan.approach, plan.lower_bound, plan.choice, plan.quieting
    holds = plan.certificate.holds and (approach is None or approach.certificate.holds)
    data = {
        "format": FORMAT,
        "status": "certified" if holds else "a promise is broken",
        "baseline": _figures(plan.baseline_figures),
        "planned": _figures(plan.figures),
        "approach": None if approach is None else _approach(approach),
        "quieting": None if quieting is None else {**asdict(quieting), "share": quieting.share},
        "compensation": None if plan.compensation is None else asdict(plan.compensation),
        "torque_floor": plan.torque_floor,
        "gap_to_floor": plan.gap_to_floor,
        "objective": {**asdict(plan.objective), "gap": plan.objective.gap},
        "floor": None if bound is None else {**asdict(bound), "each": bound.each.tolist()},
        "choice": None if choice is None else asdict(choice),
        "fallbacks": plan.fallbacks,
        "seconds": asdict(plan.seconds),
        "certificate": _certificate(plan.certificate),
        "start": _start(plan.start),
        "drift": plan.drift,
        "smallest_singular_value": plan.smallest_singular_value,
        "options": asdict(plan.options),
        "scene": scene.as_data(),
        "versions": _versions(),
        "hashes": {
            "robot": plan.robot.content_hash,
            "scene": given.content_hash,
            "resolved_scene": scene_from_file(scene, Path.cwd(), plan.scene.source).content_hash,
        },
        "files": {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()},
        "passes": [asdict(report) for report in plan.passes],
    }
    # What could not be read back is not written.
    validated(PlanFile, data, PLAN_FILE, ArchiveError)
    return json_bytes(data, indent=2)


def _figures(figures: MotionMetrics) -> dict[str, Any]:
    return {**asdict(figures), "min_clearance": or_null(figures.min_clearance)}


def _approach(approach: Approach) -> dict[str, Any]:
    return {
        **_figures(approach.certificate.figures),
        "seconds": approach.trajectory.duration,
        "along_self_motion": approach.along_self_motion,
        "certificate": _certificate(approach.certificate),
    }


def _certificate(certificate: Certificate) -> dict[str, Any]:
    return {
        "clearance_bound": or_null(certificate.clearance_bound),
        "checks": [
            {
                **asdict(check),
                "value": or_null(check.value),
                "bound": or_null(check.bound),
                "holds": bool(check.holds),
            }
            for check in certificate.checks
        ],
    }


def _start(start: Start) -> dict[str, Any]:
    return {
        "posture_deg": np.degrees(start.posture).tolist(),
        "moved_deg": float(np.degrees(start.moved)),
        "failures": [
            {
                "reason": failure.reason,
                "time": failure.time,
                "progress": failure.progress,
                "smallest_singular_value": failure.smallest_singular_value,
                "pair": failure.pair,
            }
            for failure in start.failures
        ],
    }


def _resolved(scene: Scene) -> SceneFile:
    """Return the scene's content with absolute paths, so that it can be read back from anywhere."""
    # The scene's own obstacles come before the guardrail's members.
    shapes = [obstacle.shape for obstacle in scene.obstacles[: len(scene.file.obstacles)]]
    obstacles = tuple(
        file.model_copy(update={"mesh": str(shape.path)}) if isinstance(shape, Mesh) else file
        for file, shape in zip(scene.file.obstacles, shapes, strict=True)
    )
    paths = {name: getattr(scene.robot, name) for name in ("model", "limits", "srdf", "elasticity")}
    robot = scene.file.robot.model_copy(
        update={name: str(path) for name, path in paths.items() if path is not None}
    )
    return scene.file.model_copy(update={"obstacles": obstacles, "robot": robot})


def _versions() -> dict[str, str]:
    packages = {name: metadata.version(name) for name in _PACKAGES}
    return {"cmbot": __version__, "python": platform.python_version(), **packages}
