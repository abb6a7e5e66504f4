"""From a scene, as Python may have changed it, back to the scene file that says the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arguments import plain
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.validation import validated
from cmbot.scene.guardrail import guardrail_from_file, guardrail_obstacles
from cmbot.scene.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere, pose
from cmbot.scene.scene import RobotSource, Scene
from cmbot.scene.scene_loading import content_hash
from cmbot.scene.schema import MountFile, ObstacleFile, RobotFile, SceneFile

__all__ = ["filed"]


def filed(scene: Scene) -> Scene:
    """Return a scene whose file and hash say what its fields say, its own obstacles before the guardrail's.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    SceneError
        When no scene file can say it.
    """
    own = _own_obstacles(scene)
    obstacles = (*own, *(one for one in scene.obstacles if one not in own))
    entries = {entry.name: entry for entry in scene.file.obstacles}
    data = scene.file.as_data() | {
        "name": scene.name,
        "robot": _robot(scene.robot, scene.file.robot),
        "posture_deg": _degrees(scene.posture, scene.file.posture_deg),
        "tool_path": {
            "keep": scene.keep,
            "legs": plain(scene.legs, "Scene"),
            "speed_profile": plain(scene.speed_profile, "Scene"),
            "via_points": plain(scene.via_points, "Scene"),
        },
        "obstacles": [_obstacle(obstacle, entries.get(obstacle.name)) for obstacle in own],
        "planner": plain(scene.planner, "Scene"),
    }
    file = validated(SceneFile, data, "Scene", SceneError)
    if file == scene.file:
        return replace(scene, obstacles=obstacles)
    hashed = content_hash(file, own, scene.source)
    return replace(scene, obstacles=obstacles, file=file, content_hash=hashed)


def _own_obstacles(scene: Scene) -> tuple[Obstacle, ...]:
    """The scene's obstacles but the guardrail's members, which its file does not list."""
    expected = "that of its file: change the file's guardrail block, and load it"
    if plain(scene.guardrail, "Scene") != plain(guardrail_from_file(scene.file.guardrail), "Scene"):
        raise SceneError("Scene", "guardrail", "another guardrail than its file's", expected)
    members = {member.name: plain(member, "Scene") for member in guardrail_obstacles(scene.guardrail)}
    there = {one.name for one in scene.obstacles if plain(one, "Scene") == members.get(one.name)}
    if missing := ", ".join(sorted(members.keys() - there)):
        expected = "all of it, as loaded; guardrail: {bays: 0} in the scene's file takes it away"
        raise SceneError("Scene", "obstacles", f"a guardrail without {missing}, or with others", expected)
    return tuple(one for one in scene.obstacles if one.name not in there)


def _robot(robot: RobotSource, file: RobotFile) -> dict[str, Any]:
    """What the file says of a robot; paths are those of the file as long as there are any."""
    files = {"limits": robot.limits, "srdf": robot.srdf, "elasticity": robot.elasticity}
    shipped = robot.model == "cmbot"
    return {
        "model": file.model if shipped == (file.model == "cmbot") else str(robot.model),
        "base_frame": robot.base_frame,
        "tool_frame": robot.tool_frame,
        "mount": _mount(robot, file.mount),
        "tool_length_m": robot.tool_length,
        "payload_kg": robot.payload,
        **{key: None if path is None else getattr(file, key) or str(path) for key, path in files.items()},
    }


def _mount(robot: RobotSource, file: MountFile | None) -> dict[str, Any] | None:
    if robot.mount_xyz is None or robot.mount_rpy is None:
        return None
    return {
        "xyz": list(robot.mount_xyz),
        "rpy_deg": _degrees(robot.mount_rpy, file.rpy_deg if file else None),
    }


def _obstacle(obstacle: Obstacle, entry: ObstacleFile | None) -> dict[str, Any]:
    """What the file says of an obstacle; as it did, where that is the same."""
    X = obstacle.X_WO
    xyz, rpy_deg = X[:3, 3].tolist(), Rotation.from_matrix(X[:3, :3]).as_euler("xyz", degrees=True).tolist()
    if entry is not None and np.array_equal(pose(entry.xyz, np.radians(entry.rpy_deg).tolist()), X):
        xyz, rpy_deg = entry.xyz, entry.rpy_deg
    data = {"name": obstacle.name, "xyz": xyz, "rpy_deg": rpy_deg, "workpiece": obstacle.workpiece}
    match obstacle.shape:
        case Box(size=size):
            return data | {"box": plain(size, "Box")}
        case Cylinder(radius=radius, length=length):
            return data | {"cylinder": plain([radius, length], "Cylinder")}
        case Capsule(radius=radius, length=length):
            return data | {"capsule": plain([radius, length], "Capsule")}
        case Sphere(radius=radius):
            return data | {"sphere": plain(radius, "Sphere")}
        case Mesh(path=path):
            text = entry.mesh if entry is not None else None
            return data | {"mesh": text if text and Path(text).name == path.name else str(path)}


def _degrees(radians: Sequence[float] | FloatArray, known: Sequence[float] | None) -> list[float]:
    """Angles in degrees; those that are known where they are the same."""
    if known is not None and np.array_equal(np.radians(known), radians):
        return list(known)
    return [float(angle) for angle in np.degrees(radians)]
