"""Reads a scene: from a shipped scene's name, a file, or the same content as a mapping."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.elastic import Guardrail
from cmbot.errors import SceneError
from cmbot.resources import scene_folder
from cmbot.scene.guardrail import guardrail_from_file, guardrail_obstacles
from cmbot.scene.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere, pose
from cmbot.scene.options import PlannerOptions
from cmbot.scene.schema import ObstacleFile, RobotFile, SceneFile
from cmbot.scene.speed_profile import SpeedProfile
from cmbot.validation import shown, validated
from cmbot.yaml_reader import read_yaml

__all__ = [
    "Leg",
    "RobotSource",
    "Scene",
    "load_scene",
    "scene_from_file_model",
    "shipped_scenes",
]


@dataclass(frozen=True, kw_only=True)
class RobotSource:
    """Where the robot comes from; the fields that may be None are None exactly for the shipped model.

    Attributes
    ----------
    model : str or Path
        ``cmbot``, or the path of a URDF.
    base_frame, tool_frame : str or None
        Frames of another URDF: what is mounted, and what follows the tool path.
    limits : Path or None
        Joint-limits file of another URDF.
    srdf : Path or None
        SRDF of another URDF; None also where it has none.
    elasticity : Path or None
        Elasticity file of another URDF; None also where it is the one beside the URDF, or none.
    mount_xyz : tuple of float or None
        (3,), position of the base frame of another URDF in W, m.
    mount_rpy : tuple of float or None
        (3,), its roll, pitch, yaw, rad: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
    tool_length : float or None
        m; None: as in the model.
    payload : float
        Point mass at the tool, kg.
    """

    model: str | Path
    base_frame: str | None
    tool_frame: str | None
    limits: Path | None
    srdf: Path | None
    elasticity: Path | None
    mount_xyz: tuple[float, float, float] | None
    mount_rpy: tuple[float, float, float] | None
    tool_length: float | None
    payload: float


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A straight leg of the tool's path.

    Attributes
    ----------
    by : tuple of float
        (3,), displacement in W, m.
    seconds : float
        Duration, s.
    """

    by: tuple[float, float, float]
    seconds: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What to plan, and where. Equal `content_hash` means the same scene.

    Attributes
    ----------
    name : str
        Usable as a folder's name.
    source : str
        Where it came from, for messages.
    robot : RobotSource
    posture : array
        (n,), joint angles at the start, rad; read-only.
    keep : str
        What of the tool is prescribed: ``pose``, ``axis`` or ``position``.
    legs : tuple of Leg
        From the pose of the tool at `posture`.
    speed_profile : SpeedProfile
    via_points : int
        In all, with the ends of the legs.
    obstacles : tuple of Obstacle
        The scene's own, then the members of the guardrail.
    guardrail : Guardrail
    planner : PlannerOptions
    file : SceneFile
        The file's content with every default filled in; paths as written there.
    content_hash : str
        SHA-256 (hexadecimal) of that content and of the mesh files' bytes.
    """

    name: str
    source: str
    robot: RobotSource
    posture: FloatArray
    keep: Literal["pose", "axis", "position"]
    legs: tuple[Leg, ...]
    speed_profile: SpeedProfile
    via_points: int
    obstacles: tuple[Obstacle, ...]
    guardrail: Guardrail
    planner: PlannerOptions
    file: SceneFile
    content_hash: str


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
        content_hash=_content_hash(file, own, source),
    )


def _scene_path(source: str | Path) -> Path:
    if isinstance(source, str) and source in shipped_scenes():
        return scene_folder() / f"{source}.yaml"
    path = Path(source)
    if not _exists(path):
        expected = "a scene file or the name of a shipped scene"
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
    raise SceneError(source, key, shown(text), "a file that exists (relative to the scene file)")


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


def _content_hash(file: SceneFile, obstacles: tuple[Obstacle, ...], source: str) -> str:
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
