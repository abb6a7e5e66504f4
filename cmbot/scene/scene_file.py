"""From a scene file to a scene, and from a scene, as Python may have changed it, back to its file."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.errors import MissingExtra, SceneError
from cmbot.common.input_files import LARGEST_MESH, is_file, is_folder, read_csv, read_input
from cmbot.common.installation import scene_folder, shipped_scenes
from cmbot.common.robot_library import LIBRARY, LIBRARY_EXTRA, is_robot_name, library_robots
from cmbot.common.validation import counted, given_path, hint, plain, shown, validated
from cmbot.common.yaml_reader import lines_named, read_yaml
from cmbot.elastic import Guardrail
from cmbot.scene.base.guardrail import guardrail_from_file, guardrail_obstacles
from cmbot.scene.base.stance import resolved_stance
from cmbot.scene.excitation import excitation_files, with_excitation_files
from cmbot.scene.fields import si_fields
from cmbot.scene.mesh_file import is_mesh_file
from cmbot.scene.obstacles import Mesh, Obstacle, obstacle_data, obstacle_from_file
from cmbot.scene.path.path_file import FEWEST_WAYPOINTS
from cmbot.scene.scene import RobotFile, RobotSource, Scene, SceneFile
from cmbot.scene.stow import start_posture
from cmbot.scene.tool import Tool

__all__ = ["load_scene", "scene_from_data", "scene_from_file", "scene_path", "update_file"]

_LONGEST_SOURCE = 300
# Feet hold where they did when the stiffness was measured, m.
_SAME_PLACE = 0.01
_LARGEST_WAYPOINTS = 1_000_000
_WAYPOINT_COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")
_PACKAGES = "robot.package_dirs"

_Find = Callable[[str, str], Path]


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
    MissingExtra
        Its robot is no file but could be one of example-robot-data, and that is not installed.

    Examples
    --------
    >>> scene = cmbot.load_scene("triangle")
    >>> scene
    <Scene triangle: ...>
    >>> scene.planner.safety_margin_m
    0.02
    """
    if isinstance(source, Mapping):
        name = "scene"
        return scene_from_file(validated(SceneFile, dict(source), name, SceneError), Path.cwd(), name)
    path = scene_path(source)
    with lines_named(path):
        return scene_from_data(read_yaml(path, SceneError), path.parent, str(path))


def scene_from_data(data: Mapping[str, Any], folder: Path, source: str) -> Scene:
    """Return the scene of a scene file's content, in which relative paths start at `folder`.

    Parameters
    ----------
    data : mapping
        As `cmbot.common.yaml_reader.read_yaml` returns it.
    folder : Path
    source : str
        Where it came from, for messages.

    Raises
    ------
    SceneError, MissingExtra
        As `load_scene`.
    """
    _require_model(data, folder, source)
    data = _with_files(data, folder, source)
    return scene_from_file(validated(SceneFile, data, source, SceneError), folder, source)


def _require_model(data: Mapping[str, Any], folder: Path, source: str) -> None:
    """Refuse a URDF that is missing before the keys that go with one."""
    robot = data.get("robot")
    model = robot.get("model") if isinstance(robot, dict) else None
    if isinstance(model, str) and model not in ("", "cmbot"):
        _model(partial(_found, folder, source), model)


def _with_files(data: Mapping[str, Any], folder: Path, source: str) -> dict[str, Any]:
    """The content with the rows of CSV files of waypoints, and absolute paths of meshes of rasters, in it.

    A plan of the scene is read from another folder.
    """

    def with_files(entry: Any, key: str) -> Any:
        if not isinstance(entry, dict):
            return entry
        entry, raster = dict(entry), entry.get("raster")
        if isinstance(entry.get("waypoints"), str):
            rows = _found(folder, source, entry["waypoints"], f"{key}.waypoints")
            entry["waypoints"] = _waypoints(rows)
        if isinstance(raster, dict) and isinstance(raster.get("mesh"), str) and is_mesh_file(raster["mesh"]):
            mesh = _found(folder, source, raster["mesh"], f"{key}.raster.mesh")
            entry["raster"] = {**raster, "mesh": str(mesh)}
        return entry

    data = dict(data)
    if isinstance(data.get("identified"), str):
        data["identified"] = read_yaml(_found(folder, source, data["identified"], "identified"), SceneError)
    if isinstance(data.get("excitation"), dict):
        data["excitation"] = with_excitation_files(data["excitation"], partial(_found, folder, source))
    tool_path = with_files(data.get("tool_path"), "tool_path")
    if isinstance(tool_path, dict) and isinstance(tool_path.get("strokes"), list):
        each = enumerate(tool_path["strokes"])
        tool_path = {
            **tool_path,
            "strokes": [with_files(stroke, f"tool_path.strokes[{k}]") for k, stroke in each],
        }
    return data if tool_path is None else data | {"tool_path": tool_path}


def _waypoints(source: Path) -> list[list[float]]:
    """The rows of a CSV file of waypoints."""
    rows = read_csv(source, SceneError, kind="a CSV file of waypoints", largest=_LARGEST_WAYPOINTS)
    heading = [name.strip() for name in rows[0]] if rows else []
    if heading != list(_WAYPOINT_COLUMNS):
        got = shown(",".join(heading))
        raise SceneError(str(source), "line 1", got, f"the columns {','.join(_WAYPOINT_COLUMNS)}")
    waypoints = []
    for line, row in enumerate(rows[1:], start=2):
        try:
            numbers = [float(cell) for cell in row]
        except ValueError:
            numbers = []
        if len(numbers) != len(_WAYPOINT_COLUMNS) or not np.isfinite(numbers).all():
            got = shown(",".join(row))
            raise SceneError(str(source), f"line {line}", got, f"{len(_WAYPOINT_COLUMNS)} finite numbers")
        waypoints.append(numbers)
    if len(waypoints) < FEWEST_WAYPOINTS:
        got = counted(len(waypoints), "waypoint")
        raise SceneError(str(source), "", got, f"{FEWEST_WAYPOINTS} or more below the names of the columns")
    return waypoints


def scene_from_file(file: SceneFile, base_folder: Path, source: str) -> Scene:
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
    find = partial(_found, base_folder, source)
    own = tuple(obstacle_from_file(entry, f"obstacles[{k}]", find) for k, entry in enumerate(file.obstacles))
    guardrail, robot = _guardrail(file, source), _robot(file, find)
    if file.guardrail.stance is not None:
        robot = replace(robot, stance=resolved_stance(file.guardrail.stance, guardrail, source))
    return Scene(
        name=file.name,
        source=source,
        robot=robot,
        posture=read_only(np.array(start_posture(file, robot, source))),
        return_to=file.return_ or "none",
        tool=file.tool or Tool(),
        obstacles=(*own, *guardrail_obstacles(guardrail)),
        guardrail=guardrail,
        planner=file.planner,
        file=file,
        content_hash=_content_hash(file, own, source),
        **dict(file.tool_path),
    )


def update_file(scene: Scene) -> Scene:
    """Return a scene whose file and hash agree with its fields, its own obstacles before the guardrail's.

    Raises
    ------
    SceneError
        When no scene file can describe it.
    """
    own = _own_obstacles(scene)
    obstacles = (*own, *(one for one in scene.obstacles if one not in own))
    entries = {entry.name: entry for entry in scene.file.obstacles}
    data = scene.file.as_data() | {
        "name": scene.name,
        "robot": _robot_data(scene.robot, scene.file.robot),
        **scene.file.with_posture(scene.posture, start_posture(scene.file, scene.robot, scene.source)),
        "tool_path": {
            field.alias or name: plain(getattr(scene, name), "Scene")
            for name, field in type(scene.file.tool_path).model_fields.items()
        },
        "obstacles": [obstacle_data(obstacle, entries.get(obstacle.name)) for obstacle in own],
        "planner": plain(scene.planner, "Scene"),
    }
    if scene.return_to != (scene.file.return_ or "none"):
        data["return"] = scene.return_to
    if scene.tool != (scene.file.tool or Tool()):
        data["tool"] = plain(scene.tool, "Scene")
    if scene.robot.joints != scene.file.joints:
        data["robot"]["joints"] = scene.robot.joints
    file = validated(SceneFile, data, "Scene", SceneError)
    if file == scene.file:
        return replace(scene, obstacles=obstacles)
    hashed = _content_hash(file, own, scene.source)
    return replace(scene, obstacles=obstacles, file=file, content_hash=hashed)


def _found(base_folder: Path, source: str, text: str, key: str) -> Path:
    """The path of a file that a scene names."""
    path = base_folder / text
    if key == _PACKAGES and is_folder(path):
        return path.resolve()
    if key != _PACKAGES and is_file(path):
        return path.resolve()
    kind, known = ("folder" if key == _PACKAGES else "file"), ""
    if key == "robot.model":
        robots = library_robots()
        named = "the name of a robot" + ("" if robots else f" (of the extra {LIBRARY_EXTRA})")
        known = f", cmbot, or {named}{hint(text, ('cmbot', *(robots or ())))}"
    raise SceneError(source, key, shown(text), f"a {kind} that exists (relative to the scene file){known}")


def _model(find: _Find, text: str) -> str | Path:
    """The URDF that a scene names, or the name of a robot; a file of that name comes first."""
    try:
        return find(text, "robot.model")
    except SceneError as error:
        robots = library_robots()
        if robots is not None and text in robots:
            return text
        if robots is None and is_robot_name(text) and "did you mean" not in error.expected:
            missing = MissingExtra(LIBRARY, LIBRARY_EXTRA)
            missing.add_hint(
                f"{error.source}: {error.key}: {text} is no file, and may be a robot of that package"
            )
            raise missing from error
        raise


def scene_path(source: str | Path) -> Path:
    """Return the path of a scene file, or of a shipped scene by its name; a `SceneError` without one."""
    names = shipped_scenes()
    if isinstance(source, str) and source in names:
        return scene_folder() / f"{source}.yaml"
    path = given_path(source, "load_scene", "source", "the path of a scene file, or its content as a mapping")
    expected = "a scene file or the name of a shipped scene"
    if source == "":  # as a path that is the current folder
        raise SceneError("load_scene", "source", "nothing", expected, names)
    if not os.path.exists(path):  # noqa: PTH110  Path.exists raises for names that no file can have
        text = str(path)
        where = text if text.isprintable() and len(text) <= _LONGEST_SOURCE else shown(text)
        beside = f"{text}.yaml"
        tip = f"; did you mean {beside}?" if is_file(beside) else hint(path.stem, names)
        raise SceneError(where, "", "no such file", f"{expected}{tip}", names)
    if is_folder(path):
        raise SceneError(str(path), "", "a folder", expected, names)
    return path


def _robot(scene: SceneFile, find: _Find) -> RobotSource:
    file = scene.robot
    values = si_fields(file) | {"joints": scene.joints}
    for key in ("limits", "srdf", "elasticity"):
        if values[key] is not None:
            values[key] = find(values[key], f"robot.{key}")
    if file.package_dirs is not None:
        values["package_dirs"] = tuple(find(place, _PACKAGES) for place in file.package_dirs)
    if file.model != "cmbot":
        values["model"] = _model(find, file.model)
    mount = values.pop("mount")
    placed = {} if mount is None else si_fields(mount)
    return RobotSource(**values, mount_xyz=placed.get("xyz"), mount_rpy=placed.get("rpy"))


def _guardrail(file: SceneFile, source: str) -> Guardrail:
    """The guardrail of a scene, with the stiffness that was identified."""
    guardrail, base = guardrail_from_file(file.guardrail), file.identified and file.identified.base
    if file.base is not None and file.base.modes is not None:
        stiffness, mass, damping = file.base.modes.matrices()
        return replace(guardrail, stiffness=stiffness, mass=mass, damping=damping)
    if not base:
        return guardrail
    if not np.allclose(base.footholds, guardrail.footholds, rtol=0, atol=_SAME_PLACE):
        at, held = (
            ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in one.footholds) for one in (guardrail, base)
        )
        expected = f"a stiffness measured where the feet hold now, {at}"
        raise SceneError(source, "identified.base.footholds", held, expected)
    own = None if base.mass is None else read_only(np.array(base.mass))
    return replace(guardrail, stiffness=read_only(np.array(base.stiffness)), mass=own, stiffness_factor=1.0)


def _content_hash(file: SceneFile, obstacles: Sequence[Obstacle], source: str) -> str:
    """`Scene.content_hash` of a file's content, its own obstacles' meshes and those of rasters."""
    # The one JSON text that equal scenes share.
    text = json.dumps(file.as_data(), sort_keys=True, separators=(",", ":"), allow_nan=False)
    total = hashlib.sha256(text.encode())
    named = excitation_files(file.excitation)
    meshes = named | {
        f"obstacles[{k}].mesh": one.shape.path
        for k, one in enumerate(obstacles)
        if isinstance(one.shape, Mesh)
    }
    path = file.tool_path
    rasters = {"tool_path": path.raster} if path.strokes is None else {}
    rasters |= {f"tool_path.strokes[{k}]": each.raster for k, each in enumerate(path.strokes or ())}
    for key, raster in rasters.items():
        if raster is not None and raster.mesh_file is not None:
            meshes[f"{key}.raster.mesh"] = raster.mesh_file
    for key, mesh in meshes.items():
        try:
            content = read_input(mesh, SceneError, largest=LARGEST_MESH)
        except SceneError as error:
            raise SceneError(source, key, error.got, error.expected) from error
        total.update(hashlib.sha256(content).digest())
    return total.hexdigest()


def _own_obstacles(scene: Scene) -> tuple[Obstacle, ...]:
    """The scene's obstacles but the guardrail's members, which its file does not list."""
    expected = "that of its file: change the file's guardrail block, and load it"
    if plain(scene.guardrail, "Scene") != plain(_guardrail(scene.file, scene.source), "Scene"):
        raise SceneError("Scene", "guardrail", "another guardrail than its file's", expected)
    members = {member.name: plain(member, "Scene") for member in guardrail_obstacles(scene.guardrail)}
    there = {one.name for one in scene.obstacles if plain(one, "Scene") == members.get(one.name)}
    if missing := ", ".join(sorted(members.keys() - there)):
        expected = "all of it, as loaded; guardrail: {bays: 0} in the scene's file takes it away"
        raise SceneError("Scene", "obstacles", f"a guardrail without {missing}, or with others", expected)
    return tuple(one for one in scene.obstacles if one.name not in there)


def _robot_data(robot: RobotSource, file: RobotFile) -> dict[str, Any]:
    """The file's entry of a robot; a path is written as the file has it, where it has one."""
    data: dict[str, Any] = {
        "base_frame": robot.base_frame,
        "tool_frame": robot.tool_frame,
        "tool_length_m": robot.tool_length,
        "payload_kg": robot.payload,
        "joints": file.joints,
    }
    shipped = robot.model == "cmbot"
    data["model"] = file.model if shipped == (file.model == "cmbot") else str(robot.model)
    for key in ("limits", "srdf", "elasticity"):
        path = getattr(robot, key)
        data[key] = None if path is None else getattr(file, key) or str(path)
    if robot.package_dirs is not None:
        data["package_dirs"] = file.package_dirs or [str(place) for place in robot.package_dirs]
    if robot.mount_xyz is not None and robot.mount_rpy is not None:
        rpy_deg = _degrees(robot.mount_rpy, file.mount.rpy_deg if file.mount else None)
        data["mount"] = {"xyz": list(robot.mount_xyz), "rpy_deg": rpy_deg}
    return data


def _degrees(radians: Sequence[float] | FloatArray, known: Sequence[float] | None) -> list[float]:
    """Angles in degrees; the known ones where these are the same in radians."""
    if known is not None and np.array_equal(np.radians(known), radians):
        return list(known)
    return [float(angle) for angle in np.degrees(radians)]
