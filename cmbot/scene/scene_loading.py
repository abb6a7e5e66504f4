"""Reads a scene: from a shipped scene's name, a file, or the same content as a mapping."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np

from cmbot.common.arguments import given_path
from cmbot.common.errors import SceneError
from cmbot.common.resources import scene_folder
from cmbot.common.validation import hint, shown, validated
from cmbot.common.yaml_reader import read_yaml
from cmbot.scene.guardrail import guardrail_from_file, guardrail_obstacles
from cmbot.scene.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere, pose
from cmbot.scene.scene import Leg, RobotSource, Scene
from cmbot.scene.schema import ObstacleFile, RobotFile, SceneFile
from cmbot.scene.speed_profile import SpeedProfile

__all__ = ["content_hash", "load_scene", "scene_from_file_model", "shipped_scenes"]


def load_scene(source: str | Path | Mapping[str, object]) -> Scene:
    """Read and check a scene.

    Parameters
    ----------
    source : str, Path or mapping
        The name of a shipped scene, such as ``triangle``; the path of a scene file; or the content of one,
        in which relative paths start at the current folder.

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        The file is missing or unreadable, a key or value in it is wrong, or a file that it names is missing.
    """
    if isinstance(source, Mapping):
        name = "scene"
        return scene_from_file_model(validated(SceneFile, dict(source), name, SceneError), Path.cwd(), name)
    path = _scene_path(source)
    file = validated(SceneFile, read_yaml(path, SceneError), str(path), SceneError)
    return scene_from_file_model(file, path.parent, str(path))


def shipped_scenes() -> tuple[str, ...]:
    """Return the names that `load_scene` knows, in alphabetical order."""
    return tuple(sorted(path.stem for path in scene_folder().glob("*.yaml")))


def scene_from_file_model(file: SceneFile, base_folder: Path, source: str) -> Scene:
    """Return the scene that a checked file describes.

    Parameters
    ----------
    file : SceneFile
    base_folder : Path
        Where relative paths in `file` start.
    source : str
        Where it came from, for messages.

    Raises
    ------
    SceneError
        A file that it names is missing.
    """
    own = tuple(
        _obstacle(obstacle, f"obstacles[{index}]", base_folder, source)
        for index, obstacle in enumerate(file.obstacles)
    )
    guardrail = guardrail_from_file(file.guardrail)
    posture = np.radians(file.posture_deg)
    posture.setflags(write=False)
    path = file.tool_path
    return Scene(
        name=file.name,
        source=source,
        robot=_robot(file.robot, base_folder, source),
        posture=posture,
        keep=path.keep,
        legs=tuple(Leg(by=leg.by, seconds=leg.seconds) for leg in path.legs),
        speed_profile=SpeedProfile(kind=path.speed_profile.kind, ramp=path.speed_profile.ramp),
        via_points=path.via_points,
        obstacles=(*own, *guardrail_obstacles(guardrail)),
        guardrail=guardrail,
        planner=file.planner,
        file=file,
        content_hash=content_hash(file, own, source),
    )


def _scene_path(source: str | Path) -> Path:
    if isinstance(source, str) and source in shipped_scenes():
        return scene_folder() / f"{source}.yaml"
    path = given_path(source, "load_scene", "source", "the path of a scene file, or its content as a mapping")
    if source == "":  # as a path that is the current folder
        expected = "a scene file or the name of a shipped scene"
        raise SceneError("load_scene", "source", "nothing", expected, shipped_scenes())
    if not _exists(path):
        expected = f"a scene file or the name of a shipped scene{hint(path.stem, shipped_scenes())}"
        raise SceneError(_as_source(path), "", "no such file", expected, shipped_scenes())
    return path


def _as_source(path: Path) -> str:
    text = str(path)
    return text if text.isprintable() and len(text) <= 300 else shown(text)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a name too long, or one that no file can have
        return False


def _named_file(text: str, key: str, base_folder: Path, source: str) -> Path:
    path = base_folder / text
    try:
        if path.is_file():
            return path.resolve()
    except (OSError, ValueError) as error:
        raise SceneError(source, key, shown(text), "the path of a file") from error
    expected = "a file that exists (relative to the scene file)"
    if key == "robot.model":
        expected += f", or cmbot{hint(text, ('cmbot',))}"
    raise SceneError(source, key, shown(text), expected)


def _robot(file: RobotFile, base_folder: Path, source: str) -> RobotSource:
    def named(text: str | None, key: str) -> Path | None:
        return None if text is None else _named_file(text, f"robot.{key}", base_folder, source)

    mount, shipped = file.mount, file.model == "cmbot"
    return RobotSource(
        model="cmbot" if shipped else _named_file(file.model, "robot.model", base_folder, source),
        base_frame=file.base_frame,
        tool_frame=file.tool_frame,
        limits=named(file.limits, "limits"),
        srdf=named(file.srdf, "srdf"),
        elasticity=named(file.elasticity, "elasticity"),
        mount_xyz=None if mount is None else mount.xyz,
        mount_rpy=None if mount is None else _radians(mount.rpy_deg),
        tool_length=file.tool_length_m,
        payload=file.payload_kg,
    )


def _radians(degrees: tuple[float, float, float]) -> tuple[float, float, float]:
    roll, pitch, yaw = degrees
    return math.radians(roll), math.radians(pitch), math.radians(yaw)


def _obstacle(file: ObstacleFile, key: str, base_folder: Path, source: str) -> Obstacle:
    return Obstacle(
        name=file.name,
        shape=_shape(file, key, base_folder, source),
        X_WO=pose(file.xyz, _radians(file.rpy_deg)),
        workpiece=file.workpiece,
    )


def _shape(file: ObstacleFile, key: str, base_folder: Path, source: str) -> Shape:
    if file.box is not None:
        return Box(size=file.box)
    if file.cylinder is not None:
        return Cylinder(radius=file.cylinder[0], length=file.cylinder[1])
    if file.capsule is not None:
        return Capsule(radius=file.capsule[0], length=file.capsule[1])
    if file.sphere is not None:
        return Sphere(radius=file.sphere)
    mesh = cast("str", file.mesh)  # the schema lets exactly one through
    return Mesh(path=_named_file(mesh, f"{key}.mesh", base_folder, source))


def content_hash(file: SceneFile, obstacles: tuple[Obstacle, ...], source: str) -> str:
    """Return `Scene.content_hash` of a file's content and of its own obstacles' meshes.

    Raises
    ------
    SceneError
        When a mesh cannot be read.
    """
    total = hashlib.sha256(file.canonical_json().encode())
    for index, obstacle in enumerate(obstacles):
        if isinstance(obstacle.shape, Mesh):
            try:
                with obstacle.shape.path.open("rb") as mesh:
                    total.update(hashlib.file_digest(mesh, "sha256").digest())
            except OSError as error:
                got = f"a file that cannot be read ({error.strerror})"
                raise SceneError(source, f"obstacles[{index}].mesh", got, "a readable file") from error
    return total.hexdigest()
