"""Scenes for stances: the job stays where it is in the world, and the robot stands elsewhere."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.planning import robot_of, strokes_of
from cmbot.scene import Scene, scene_from_file
from cmbot.siting.candidates import Candidate

__all__ = ["in_world", "joined", "scene_at", "with_strokes"]

_LONGEST_NAME, _STANCE = 90, "_stance"
_PLAIN: dict[str, Any] = dict.fromkeys(("lead_in_m", "lead_out_m", "speed_tolerance", "passes"))
# What scenes of one bridge have in common.
_COMMON = ("robot", "base", "tool", "return", "identified", "planner")


def scene_at(scene: Scene, candidate: Candidate, posture: FloatArray | None) -> Scene:
    """Return the scene with the robot in another stance.

    Parameters
    ----------
    scene : Scene
        As `in_world` returns it.
    candidate : Candidate
    posture : (n,), rad, or None
        In which the arm starts: elsewhere the scene's own, None, may be in the way of something.
    """
    data = scene.file.as_data()
    if posture is not None:
        data["start"] = {"posture_deg": np.degrees(posture).tolist()}
    guardrail = {**data["guardrail"], "stance": candidate.as_data}
    name = scene.name if scene.name.endswith(_STANCE) else f"{scene.name}{_STANCE}"
    return _read(scene, data | {"guardrail": guardrail, "name": name})


def in_world(scene: Scene) -> Scene:
    """Return the scene with a tool path whose strokes begin at poses in the world, where they begin now."""
    robot, strokes = robot_of(scene), scene.each_stroke
    begins = dict[int, dict[str, Any]]()
    for k, stroke in enumerate(strokes):
        goal = stroke.start_pose
        fixed = goal is not None and goal.frame != "tool" and goal.rpy_deg is not None
        if not stroke.legs or fixed:
            continue
        # Without leads and turns it begins where its first leg does.
        alone = replace(scene, **_PLAIN)
        if scene.strokes is not None:
            last = stroke.model_copy(update={**_PLAIN, "backwards": False})
            alone = scene.with_strokes((*strokes[:k], last))
        pose = strokes_of(alone, robot)[-1].path.poses([0.0])
        begins[k] = {"frame": "world", "xyz": pose.point[0].tolist(), "rpy_deg": _rpy_deg(pose.rotation[0])}
    data = scene.file.as_data()
    if not begins:
        return scene
    path = data["tool_path"]
    if "strokes" in path:
        each = [{**one, "from": begins[k]} if k in begins else one for k, one in enumerate(path["strokes"])]
        path = {**path, "strokes": each}
    else:
        path = {**path, "from": begins[0]}
    return _read(scene, data | {"tool_path": path})


def joined(scenes: Sequence[Scene]) -> Scene:
    """Return a scene with the strokes and the obstacles of several ones, as `in_world` returns them.

    Where the robot starts is the first one's.

    Raises
    ------
    SceneError
        When there are none, or they do not have robot, guardrail, tool, return and planner in common, or
        different obstacles or frames of the same name.
    """
    if not scenes:
        raise SceneError("scenes", "", "none", "one scene or more")
    first, *others = (in_world(scene) for scene in scenes)
    if not others:
        return first
    data = _absolute(first)
    strokes = {f"{first.name}_{one['name']}": one for one in _strokes(first)}
    for other in others:
        more = _absolute(other)
        for key in _COMMON:
            _require_same(key, data.get(key), more.get(key), first, other)
        own, its = ({**each["guardrail"], "stance": None} for each in (data, more))
        _require_same("guardrail", own, its, first, other)
        for key in ("obstacles", "frames"):
            data[key] = _united(key, data, more, first, other)
        strokes |= {f"{other.name}_{one['name']}": one for one in _strokes(other)}
    names = [one["name"] for one in strokes.values()]
    each = [one if names.count(one["name"]) == 1 else {**one, "name": long} for long, one in strokes.items()]
    name = "_".join(scene.name for scene in scenes)[:_LONGEST_NAME]
    return _read(first, data | {"name": name, "tool_path": {"strokes": each}})


def with_strokes(scene: Scene, numbers: Collection[int], name: str) -> Scene:
    """Return a scene, as `in_world` returns it, with some of its strokes in their order, and a name."""
    data = scene.file.as_data()
    order = {key: value for key, value in data["tool_path"].items() if key == "order"}
    strokes = [one for k, one in enumerate(_strokes(scene)) if k in numbers]
    return _read(scene, data | {"name": name, "tool_path": {"strokes": strokes, **order}})


def _strokes(scene: Scene) -> list[dict[str, Any]]:
    """The strokes of a scene's file; that of a path without strokes has the scene's name."""
    path = scene.file.as_data()["tool_path"]
    if "strokes" in path:
        return list(path["strokes"])
    return [{**{key: value for key, value in path.items() if key != "order"}, "name": scene.name}]


def _absolute(scene: Scene) -> dict[str, Any]:
    """The content of a scene's file with the paths of meshes from anywhere."""
    data, folder = scene.file.as_data(), Path(scene.source).parent
    data["obstacles"] = [
        {**one, "mesh": str((folder / one["mesh"]).resolve())} if "mesh" in one else one
        for one in data["obstacles"]
    ]
    return data


def _require_same(key: str, own: object, its: object, first: Scene, other: Scene) -> None:
    if own != its:
        expected = f"the same {key} in all scenes of a bridge, that of {first.source}"
        raise SceneError(other.source, key, "another one", expected)


def _united(key: str, data: dict[str, Any], more: dict[str, Any], first: Scene, other: Scene) -> Any:
    """Obstacles or frames of both, each name once."""
    if key == "frames":
        ours, theirs = data.get(key, {}), more.get(key, {})
    else:
        ours, theirs = ({one["name"]: one for one in each.get(key, ())} for each in (data, more))
    for name in ours.keys() & theirs.keys():
        _require_same(f"{key}.{name}", ours[name], theirs[name], first, other)
    both = ours | theirs
    return both if key == "frames" else list(both.values())


def _read(scene: Scene, data: dict[str, Any]) -> Scene:
    """The scene of a file's content, read where another one was; options as Python has them."""
    file = type(scene.file).model_validate_json(json.dumps(data))
    return replace(scene_from_file(file, Path(scene.source).parent, scene.source), planner=scene.planner)


def _rpy_deg(R: FloatArray) -> list[float]:
    return [float(angle) for angle in Rotation.from_matrix(R).as_euler("xyz", degrees=True)]
