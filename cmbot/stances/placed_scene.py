"""Scenes for stances: the job stays where it is in the world, and the robot stands elsewhere."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.poses import rpy_deg
from cmbot.planning import robot_of, strokes_of
from cmbot.scene import STOW, WORK, JobStrokes, Scene, StrokeFile
from cmbot.stances.candidates import AnyCandidate, Candidate, MountCandidate, stiffness_in_world
from cmbot.toolpath import Goal

T = TypeVar("T")

_LONGEST_NAME, _STANCE = 90, "_stance"
_PLAIN_KEYS: dict[str, Any] = dict.fromkeys(("lead_in_m", "lead_out_m", "speed_tolerance", "passes"))
# What scenes of one bridge have in common, by their keys.
_COMMON_KEYS = {
    "robot": "robot",
    "base": "base",
    "tool": "tool",
    "return": "return_to",
    "identified": "identified",
    "planner": "planner",
}


def scene_at(scene: Scene, candidate: AnyCandidate, posture: FloatArray | None) -> Scene:
    """Return the scene with the robot in another stance.

    Parameters
    ----------
    scene : Scene
        As `in_world` returns it.
    candidate : Candidate or MountCandidate
        Of a mount the torque is that about the origin of the base frame.
    posture : (n,), rad, or None
        In which the arm starts: elsewhere the scene's own, None, may be in the way of something.
    """
    changes: dict[str, Any] = {}
    if isinstance(candidate, Candidate):
        changes["guardrail"] = scene.guardrail.changed(stance=candidate.in_file)
    elif candidate.mount is not None:
        stiffness = stiffness_in_world(candidate)
        rows = None if stiffness is None else [[*map(float, row)] for row in (stiffness + stiffness.T) / 2]
        changes["robot"] = scene.robot.changed(mount=candidate.mount)
        changes["guardrail"] = scene.guardrail.changed(bays=0, stiffness=rows, mass=None)
        changes["base"] = None if scene.base is None else scene.base.changed(modes=None, tube=None)
    if isinstance(candidate, MountCandidate):
        changes["planner"] = replace(scene.planner, moment_about="base")
    if posture is not None:
        changes["start"] = {"posture": posture}
    name = scene.name if scene.name.endswith(_STANCE) else f"{scene.name}{_STANCE}"
    return scene.changed(name=name, **changes)


def put_away(scene: Scene) -> Scene:
    """Return the scene with an arm that comes from its stow posture, and is put away again.

    An arm without one comes from where it starts, and returns there; so does one whose scene says that it
    returns there.
    """
    stowed = STOW in robot_of(scene).group_states and scene.return_to != "start"
    changes: dict[str, Any] = {"start": {"stow": True}} if stowed else {}
    if scene.return_to == "none":
        changes["return_to"] = "stow" if stowed else "start"
    return scene.changed(**changes)


def in_world(scene: Scene) -> Scene:
    """Return the scene with a tool path whose strokes begin at poses in the world, where they begin now."""
    robot, strokes = robot_of(scene), list(scene.strokes)
    moved = False
    for k, stroke in enumerate(scene.strokes):
        goal = stroke.start_pose
        fixed = goal is not None and goal.frame != "tool" and goal.rpy_deg is not None
        if not stroke.legs or fixed:
            continue
        # Without leads and turns it begins where its first leg does.
        alone = scene.with_strokes((*scene.strokes[:k], stroke.changed(**_PLAIN_KEYS, backwards=False)))
        pose = strokes_of(alone, robot)[-1].path.poses([0.0])
        begin = Goal(xyz=tuple(pose.point[0].tolist()), rpy_deg=rpy_deg(pose.rotation[0]))
        strokes[k], moved = stroke.changed(start_pose=begin), True
    return scene.with_strokes(strokes, scene.order) if moved else scene


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
    obstacles, frames = {one.name: one for one in first.obstacles}, dict(first.frames)
    strokes = {f"{first.name}_{stroke.name}": stroke for stroke in _strokes(first)}
    for other in others:
        for key, name in _COMMON_KEYS.items():
            _require_same(key, getattr(first, name), getattr(other, name), first, other)
        own, its = (scene.guardrail.changed(stance=None) for scene in (first, other))
        _require_same("guardrail", own, its, first, other)
        obstacles = _united("obstacles", obstacles, {one.name: one for one in other.obstacles}, first, other)
        frames = _united("frames", frames, dict(other.frames), first, other)
        strokes |= {f"{other.name}_{stroke.name}": stroke for stroke in _strokes(other)}
    names = [stroke.name for stroke in strokes.values()]
    renamed = [
        stroke if names.count(stroke.name) == 1 else stroke.changed(name=long)
        for long, stroke in strokes.items()
    ]
    return first.changed(
        name="_".join(scene.name for scene in scenes)[:_LONGEST_NAME],
        tool_path=JobStrokes(strokes=tuple(renamed)),
        obstacles=tuple(obstacles.values()),
        frames=frames,
    )


def with_strokes(scene: Scene, numbers: Collection[int], name: str) -> Scene:
    """Return a scene, as `in_world` returns it, with some of its strokes in their order, and a name."""
    strokes = tuple(stroke for k, stroke in enumerate(_strokes(scene)) if k in numbers)
    return scene.changed(name=name, tool_path=JobStrokes(strokes=strokes, order=scene.order))


def _strokes(scene: Scene) -> list[StrokeFile]:
    """The strokes of a scene; that of a path without strokes has the scene's name."""
    return [stroke.changed(name=scene.name) if stroke.name == WORK else stroke for stroke in scene.strokes]


def _require_same(key: str, own: object, its: object, first: Scene, other: Scene) -> None:
    if own != its:
        expected = f"the same {key} in all scenes of a bridge, that of {first.source}"
        raise SceneError(other.source, key, "another one", expected)


def _united(key: str, own: Mapping[str, T], its: Mapping[str, T], first: Scene, other: Scene) -> dict[str, T]:
    """Obstacles or frames of both, each name once."""
    for name in own.keys() & its.keys():
        _require_same(f"{key}.{name}", own[name], its[name], first, other)
    return {**own, **its}
