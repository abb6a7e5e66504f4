"""A look at a scene before it is planned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.collision import Clearances, ShapePair
from cmbot.common.arrays import FloatArray
from cmbot.common.validation import counted
from cmbot.planning.context import robot_of, task_of
from cmbot.planning.problem_size import oversized
from cmbot.planning.tool_reach import beyond_reach
from cmbot.robot import Dynamics, Efforts, Finding, Robot
from cmbot.scene import PlannerOptions, Scene, ToolPath

__all__ = ["Precheck", "precheck_options", "precheck_scene"]


@dataclass(frozen=True, kw_only=True)
class Precheck:
    """What was seen.

    Attributes
    ----------
    found : tuple of (str, str)
        What the scene asks for and how it begins, as names and values with units.
    warnings : tuple of Finding
        What speaks against planning it.
    """

    found: tuple[tuple[str, str], ...]
    warnings: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True)
class _Nearest:
    pair: ShapePair
    distance: float


def precheck_scene(scene: Scene) -> Precheck:
    """Look at what a scene asks for and how it begins.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    """
    robot = robot_of(scene)
    path = task_of(scene, robot).path
    nearest = _nearest(scene, robot)
    efforts = Dynamics(robot).static_efforts(scene.posture[None])
    use = np.abs(efforts.joint_torque[0]) / robot.limits.torque
    return Precheck(
        found=(*_asked(scene, robot, path), *_beginning(scene, robot, path, nearest, efforts, use)),
        warnings=(
            *_near(scene, nearest),
            *_weak(robot, use),
            *_out_of_reach(robot, path),
            *_too_large(scene, robot),
            *precheck_options(scene.planner),
        ),
    )


def precheck_options(options: PlannerOptions) -> Iterator[Finding]:
    """Yield what speaks against planning with some options.

    Parameters
    ----------
    options : PlannerOptions
    """
    if options.objective == "torque" and not any(options.axis_weights[:2]):
        weights = ", ".join(f"{weight:g}" for weight in options.axis_weights)
        yield _warning(
            "planner.axis_weights",
            f"[{weights}]: gravity has no torque about z, so only what the motion itself asks would be made "
            "small, and slowly",
            "a weight above 0 for x or y, as in [1, 1, 1]; or start: pinned and more seconds for the legs",
        )


def _nearest(scene: Scene, robot: Robot) -> _Nearest | None:
    clearances = Clearances(robot, scene.obstacles)
    smallest = clearances.smallest(scene.posture[None])
    if smallest.pair[0] < 0:
        return None
    return _Nearest(pair=clearances.pairs[smallest.pair[0]], distance=float(smallest.distance[0]))


def _asked(scene: Scene, robot: Robot, path: ToolPath) -> Iterator[tuple[str, str]]:
    yield "scene", f"{scene.name} ({scene.source})"
    joints, legs = counted(robot.dof, "joint"), counted(len(scene.legs), "leg")
    yield "robot", f"{robot.name}: {joints}, {robot.mass:.2f} kg ({robot.arm_mass:.2f} kg moving)"
    yield (
        "tool path",
        f"{legs}, {path.lengths.sum():.3f} m in {path.duration:g} s, keeps the tool's {scene.keep}",
    )
    yield "via-points", str(len(path.via_times(scene.via_points)))
    workpieces = counted(sum(obstacle.workpiece for obstacle in scene.obstacles), "workpiece")
    yield "obstacles", f"{len(scene.obstacles)}, of them {workpieces}"


def _beginning(
    scene: Scene,
    robot: Robot,
    path: ToolPath,
    nearest: _Nearest | None,
    efforts: Efforts,
    use: FloatArray,
) -> Iterator[tuple[str, str]]:
    point = ", ".join(f"{x:.4f}" for x in path.corners[0])
    yield "tool point at the start", f"({point}) m"
    if nearest is not None:
        pair = nearest.pair
        yield "clearance at the start", f"{nearest.distance:.4f} m ({pair.link} to {pair.other})"
    value = task_of(scene, robot).smallest_singular_value(robot, scene.posture)
    yield "smallest singular value there", f"{value:.4f}"
    yield "torque on the guardrail there", f"{np.linalg.norm(efforts.guardrail_torque):.2f} Nm"
    yield "largest joint torque there", f"{use.max():.2f} of the bound of {robot.joints[use.argmax()]}"


def _near(scene: Scene, nearest: _Nearest | None) -> Iterator[Finding]:
    margin = scene.planner.safety_margin_m
    if nearest is not None and nearest.distance < margin:
        got = nearest.pair.describe(nearest.distance, margin)
        expected = (
            "a start that is clear: another posture, other obstacles or a lower planner.safety_margin_m"
        )
        yield _warning("posture_deg", got, expected)


def _weak(robot: Robot, use: FloatArray) -> Iterator[Finding]:
    if use.max() > 1.0:
        got = f"{use.max():.2f} of the torque that {robot.joints[use.argmax()]} can bear, at rest"
        yield _warning("posture_deg", got, "at most 1: another posture or less payload")


def _out_of_reach(robot: Robot, path: ToolPath) -> Iterator[Finding]:
    for leg in beyond_reach(robot, path):
        got = f"an end {leg.distance:.3f} m from the arm's first joint"
        yield _warning(leg.key, got, f"at most {leg.reach:.3f} m, the arm with its tool stretched out")


def _too_large(scene: Scene, robot: Robot) -> Iterator[Finding]:
    found = oversized(scene, robot.dof, scene.planner)
    if found is not None:
        yield found


def _warning(key: str, got: str, expected: str) -> Finding:
    return Finding(severity="warning", key=key, got=got, expected=expected)
