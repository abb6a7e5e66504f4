"""A scene file of the first format as one of the second, which means the same."""

from __future__ import annotations

import io
import os
from collections.abc import MutableMapping
from pathlib import Path
from typing import Any

from cmbot.common.errors import SceneError
from cmbot.common.input_files import read_input
from cmbot.scene.path.time_law import SpeedProfile
from cmbot.scene.scene import FORMAT
from cmbot.scene.scene_file import load_scene, scene_path

__all__ = ["migrated"]

_ROBOT_FILES = ("limits", "srdf", "elasticity")
_SCHEMA = "$schema="


def migrated(source: str | Path, target: Path, schema: str) -> str:
    """Return the text of a scene file of ``cmbot-scene/1`` in ``cmbot-scene/2``, comments and all.

    Parameters
    ----------
    source : str or Path
        The name of a shipped scene, or the path of a scene file.
    target : Path
        Where it is to lie: relative paths in it start there.
    schema : str
        Where the JSON Schema lies, for editors.

    Raises
    ------
    SceneError
        When it is no scene, or of the second format already.
    """
    # Imported where needed: it takes a while to load.
    from ruamel.yaml import YAML

    path = scene_path(source)
    scene = load_scene(path)
    if scene.file.format == FORMAT:
        raise SceneError(str(path), "format", FORMAT, "cmbot-scene/1: there is nothing to migrate")
    yaml = YAML()
    yaml.preserve_quotes, yaml.width = True, 120
    yaml.indent(mapping=2, sequence=4, offset=2)
    data = yaml.load(read_input(path, SceneError).decode())
    data["format"] = FORMAT
    at = list(data).index("posture_deg")
    data.insert(at, "start", {"posture_deg": data.pop("posture_deg")})
    tool_path = data["tool_path"]
    # Scenes of the second format have another speed profile where they give none.
    given, default = tool_path.setdefault("speed_profile", {}), SpeedProfile()
    for key in ("kind", "ramp"):
        given.setdefault(key, getattr(default, key))
    # Nor do their joints give way.
    data.setdefault("robot", {}).setdefault("joints", "rigid")
    _move(data, path.parent, target.resolve().parent)
    text = io.StringIO()
    yaml.dump(data, text)
    head, *lines = text.getvalue().splitlines(keepends=True)
    if _SCHEMA in head:
        head = f"{head.partition(_SCHEMA)[0]}{_SCHEMA}{schema}\n"
    return "".join([head, *lines])


def _move(data: MutableMapping[str, Any], old: Path, new: Path) -> None:
    """Let relative paths of a scene file in one folder start in another one."""

    def moved(text: str) -> str:
        # Names of robots are no files.
        return os.path.relpath(old / text, new) if (old / text).exists() else text

    robot = data.get("robot", {})
    for key in _ROBOT_FILES:
        if key in robot:
            robot[key] = moved(robot[key])
    if robot.get("model", "cmbot") != "cmbot":
        robot["model"] = moved(robot["model"])
    for obstacle in data.get("obstacles", ()):
        if "mesh" in obstacle:
            obstacle["mesh"] = moved(obstacle["mesh"])
    if "package_dirs" in robot:
        robot["package_dirs"] = [moved(place) for place in robot["package_dirs"]]
