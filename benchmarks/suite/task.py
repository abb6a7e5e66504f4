"""What a scene asks of the oracle's arm: timed tool points, and the world they lie in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from cmbot.scene import Scene, load_scene
from suite.arms import ARMS, Arm
from suite.world import FloatArray, World

__all__ = ["TimedPath", "read_scene", "world_of"]


class TimedPath:
    """Straight legs, each from rest to rest."""

    def __init__(
        self, start: FloatArray, legs: list[tuple[FloatArray, float]], ramp: float, *, jerk_limited: bool
    ) -> None:
        self.corners = start + np.concatenate([np.zeros((1, 3)), np.cumsum([by for by, _ in legs], axis=0)])
        self.ends = np.concatenate([[0.0], np.cumsum([seconds for _, seconds in legs])])
        # Speed at shares of the time, and its integral: fine enough for 1e-9 of the length.
        self._u = np.linspace(0.0, 1.0, 20_001)
        x = np.clip(np.minimum(self._u, 1 - self._u) / ramp, 0.0, 1.0)
        speed = np.where(x < 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2) if jerk_limited else x
        covered = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
        self._covered = covered / covered[-1]

    @property
    def duration(self) -> float:
        """Total time, s."""
        return float(self.ends[-1])

    def point(self, t: float) -> FloatArray:
        """Tool point (3,), m, at a time, s."""
        leg = min(int(np.searchsorted(self.ends, t, side="right")) - 1, len(self.ends) - 2)
        u = (t - self.ends[leg]) / (self.ends[leg + 1] - self.ends[leg])
        return np.asarray(self.corners[leg] + self._share(u) * (self.corners[leg + 1] - self.corners[leg]))

    def leg_distance(self, t: float, p: FloatArray) -> float:
        """Distance of a point from the leg of a time, m."""
        leg = min(int(np.searchsorted(self.ends, t, side="right")) - 1, len(self.ends) - 2)
        a, edge = self.corners[leg], self.corners[leg + 1] - self.corners[leg]
        along = np.clip((p - a) @ edge / (edge @ edge), 0.0, 1.0)
        return float(np.linalg.norm(p - a - along * edge))

    def dense_times(self, spacing: float) -> FloatArray:
        """Times whose tool points are no further apart than `spacing`, m, the ends of the legs among them."""
        times = [0.0]
        for k, length in enumerate(np.linalg.norm(np.diff(self.corners, axis=0), axis=1)):
            steps = max(4, int(np.ceil(length / spacing)))
            shares = np.interp(np.arange(1, steps + 1) / steps, self._covered, self._u)
            times += list(self.ends[k] + shares * (self.ends[k + 1] - self.ends[k]))
        return np.array(times)

    def _share(self, u: float) -> float:
        """Share of the length that is covered at share `u` of the time."""
        return float(np.interp(u, self._u, self._covered))


def arm_of(scene: Scene) -> Arm:
    """The suite's arm that a scene has."""
    if scene.robot.model == "cmbot":
        return ARMS[0]
    return next(arm for arm in ARMS if arm.urdf.resolve() == Path(scene.robot.model).resolve())


def world_of(scene: Scene) -> World:
    """The oracle's world of a scene."""
    arm, robot = arm_of(scene), scene.robot
    srdf = Path(robot.srdf) if robot.srdf else arm.urdf.with_suffix(".srdf")
    mount = None if robot.mount is None else pin.SE3(np.array(robot.mount.matrix))
    world = World(arm, mount, srdf, scene.planner.safety_margin_m)
    world.place_scene(scene)
    return world


def rigid(scene: Scene) -> Scene:
    """A scene whose rigid arm follows the path, as the oracle's does."""
    return scene.with_options(compensate=False)


def read_scene(folder: str | Path) -> tuple[Scene, World, TimedPath, FloatArray]:
    """A scene's folder as scene, world, timed path and the tool's orientation (3, 3) at the start."""
    scene = rigid(load_scene(Path(folder, "scene.yaml")))
    world = world_of(scene)
    p, R = world.pose(np.array(scene.posture))
    legs = [(np.array(leg.by), leg.seconds) for leg in scene.strokes[0].legs]
    profile = scene.strokes[0].speed_profile
    path = TimedPath(p, legs, profile.ramp, jerk_limited=profile.kind == "jerk_limited")
    return scene, world, path, R
