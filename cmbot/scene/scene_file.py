"""Scene files: where they are, and how they become scenes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cmbot.common.errors import SceneError
from cmbot.common.installation import scene_folder, shipped_scenes
from cmbot.common.reading.input_files import is_file, is_folder
from cmbot.common.reading.validation import given_path, hint, shown, validated
from cmbot.common.reading.yaml_reader import lines_named, read_yaml
from cmbot.scene.path.waypoint_file import WaypointFile, given_file, read_waypoints
from cmbot.scene.scene import Scene

_MAX_SOURCE_CHARACTERS = 300


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
        return scene_from_data(source, Path.cwd(), "scene")
    path = scene_path(source)
    with lines_named(path):
        return scene_from_data(read_yaml(path, SceneError), path.parent, str(path))


def scene_from_data(data: Mapping[str, Any], folder: Path, source: str) -> Scene:
    """Return the scene of a scene file's content, in which relative paths start at `folder`.

    Parameters
    ----------
    data : mapping
        As `cmbot.common.reading.yaml_reader.read_yaml` returns it.
    folder : Path
    source : str
        Where it came from, for messages.

    Raises
    ------
    SceneError, ModelError, MissingExtra
        As `load_scene`.
    """
    return Scene.of(_with_files(data, folder, source), source, folder)


def _with_files(data: Mapping[str, Any], folder: Path, source: str) -> dict[str, Any]:
    """The content with that of files of waypoints and of an identified stiffness in place of their paths."""

    def with_rows(entry: Any, key: str, timed: bool = False) -> Any:
        if not isinstance(entry, dict) or (found := given_file(entry)) is None:
            return entry
        try:
            given = validated(WaypointFile, found, source, SceneError)
        except SceneError as error:
            where = ".".join(filter(None, (f"{key}.waypoints", error.key)))
            placed = "xyz and rpy_deg of that frame, as a table has no other place" * (error.key == "frame")
            raise SceneError(source, where, error.got, placed or error.expected, error.choices) from error
        path = _found(folder, source, given.file, f"{key}.waypoints")
        rows, seconds = read_waypoints(path, given, entry.get("keep"))
        timed = timed or bool({"seconds", "speed_m_s"} & entry.keys()) or seconds is None
        return {**entry, "waypoints": rows} | ({} if timed else {"seconds": seconds})

    data = dict(data)
    if isinstance(text := data.get("identified"), str):
        data["identified"] = read_yaml(_found(folder, source, text, "identified"), SceneError)
    path = with_rows(data.get("tool_path"), "tool_path")
    if isinstance(path, dict) and isinstance(strokes := path.get("strokes"), list):
        timed = "seconds" in path
        rows = [with_rows(each, f"tool_path.strokes[{k}]", timed) for k, each in enumerate(strokes)]
        path = {**path, "strokes": rows}
    return data if path is None else data | {"tool_path": path}


def _found(folder: Path, source: str, text: str, key: str) -> Path:
    """The path of a file that becomes part of a scene."""
    if not is_file(path := folder / text):
        expected = "a file that exists (relative to the scene file)"
        raise SceneError(source, key, shown(text), expected)
    return path.resolve()


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
        where = text if text.isprintable() and len(text) <= _MAX_SOURCE_CHARACTERS else shown(text)
        beside = f"{text}.yaml"
        tip = f"; did you mean {beside}?" if is_file(beside) else hint(path.stem, names)
        raise SceneError(where, "", "no such file", f"{expected}{tip}", names)
    if is_folder(path):
        raise SceneError(str(path), "", "a folder", expected, names)
    return path
