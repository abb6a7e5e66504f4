"""The precheck: problems of a scene that can be named before it is planned."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cmbot.collision import Clearances, ShapePair
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import MissingExtra, PathNotFound, SceneError
from cmbot.common.installation import install_command
from cmbot.common.validation import counted
from cmbot.optimization import piqp_module
from cmbot.planning.context import PlanningContext, robot_of, task_of
from cmbot.planning.task import ToolTask, task_dimension
from cmbot.robot import Dynamics, Finding, Robot
from cmbot.scene import PlannerOptions, Scene, ToolPath
from cmbot.trajectory import SUPPORT

__all__ = [
    "MOST_UNKNOWNS",
    "BeyondReach",
    "Precheck",
    "beyond_reach",
    "oversized",
    "precheck_options",
    "precheck_scene",
    "require_reasonable_size",
    "require_within_reach",
    "solver_of",
]

MOST_UNKNOWNS = 3000
"""Of a problem for SLSQP, whose dense matrices cost the cube of them: here an exchange iteration takes one to
two minutes, at 4,000 more than three."""

# A stretched arm is not out of its own reach.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class Precheck:
    """What was found.

    Attributes
    ----------
    found : tuple of (str, str)
        What the scene asks for and how it begins, as names and values with units.
    warnings : tuple of Finding
        Reasons why planning it may fail.
    """

    found: tuple[tuple[str, str], ...]
    warnings: tuple[Finding, ...]


def precheck_scene(scene: Scene) -> Precheck:
    """Check what a scene asks for and how it begins.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    """
    robot = robot_of(scene)
    task = task_of(scene, robot)
    clearances = Clearances(robot, scene.obstacles)
    smallest = clearances.smallest(scene.posture[None])
    index, distance = int(smallest.pair[0]), float(smallest.distance[0])
    pair = clearances.pairs[index] if index >= 0 else None
    efforts = Dynamics(robot).static_efforts(scene.posture[None])
    torque = float(np.linalg.norm(efforts.guardrail_torque))
    use = np.abs(efforts.joint_torque[0]) / robot.limits.torque
    return Precheck(
        found=(
            *_asked(scene, robot, task.path),
            *_beginning(scene, robot, task, pair, distance, torque, use),
        ),
        warnings=(
            *_posture_warnings(scene, robot, pair, distance, use),
            *_reach_warnings(robot, task.path),
            *filter(None, [oversized(scene, robot.dof, scene.planner)]),
            *precheck_options(scene.planner),
        ),
    )


def precheck_options(options: PlannerOptions) -> Iterator[Finding]:
    """Yield reasons why planning with some options may fail.

    Parameters
    ----------
    options : PlannerOptions
    """
    if options.objective == "torque" and not any(options.axis_weights[:2]):
        weights = ", ".join(f"{weight:g}" for weight in options.axis_weights)
        yield _warning(
            "planner.axis_weights",
            f"[{weights}]: gravity has no torque about z, so only what the motion itself asks would be "
            "minimised, and slowly",
            "a weight above 0 for x or y, as in [1, 1, 1]; or start: pinned and more seconds for the legs",
        )


@dataclass(frozen=True, kw_only=True)
class BeyondReach:
    """A leg whose end no posture reaches.

    Attributes
    ----------
    key : str
        Of the leg in a scene file.
    distance : float, m
        Of its end from the arm's first joint.
    reach : float, m
        The largest that there can be: `Robot.reach`.
    """

    key: str
    distance: float
    reach: float


def beyond_reach(robot: Robot, path: ToolPath) -> Iterator[BeyondReach]:
    """Yield the legs that end further from the arm's first joint than the stretched arm reaches.

    What lies between two ends within reach is within reach.
    """
    reach = robot.reach
    distances = np.linalg.norm(path.corners[1:] - robot.base_point, axis=1)
    for k in np.flatnonzero(distances > reach * (1 + _ROUNDING)):
        yield BeyondReach(key=f"tool_path.legs[{k}].by", distance=float(distances[k]), reach=reach)


def require_within_reach(context: PlanningContext) -> None:
    """Refuse a tool path that leaves the reach of the stretched arm.

    Raises
    ------
    PathNotFound
        Naming the first leg that ends out of reach, and by how much.
    """
    path, robot = context.task.path, context.robot
    first = next(beyond_reach(robot, path), None)
    if first is None:
        return
    away = np.linalg.norm(context.points - robot.base_point, axis=1)
    time = float(context.times[np.argmax(away > first.reach * (1 + _ROUNDING))])
    raise PathNotFound(
        f"{first.key} ends {first.distance:.3f} m from the arm's first joint, "
        f"{first.distance - first.reach:.3f} m out of reach (the arm with its tool stretched out is "
        f"{first.reach:.3f} m long); shorten the leg (lengths are in metres), or take another posture_deg",
        time=time,
        progress=path.progress(time),
        # The stretched arm cannot move further out.
        smallest_singular_value=0.0,
    )


def solver_of(options: PlannerOptions) -> Literal["sqp", "slsqp"]:
    """Return the solver that the options ask for, or with ``auto`` the best that is installed.

    Raises
    ------
    MissingExtra
        When it is ``sqp`` and PIQP is not installed.
    """
    if options.solver == "slsqp":
        return "slsqp"
    try:
        piqp_module()
    except MissingExtra:
        if options.solver == "auto":
            return "slsqp"
        raise
    return "sqp"


def oversized(scene: Scene, joints: int, options: PlannerOptions) -> Finding | None:
    """Return what is wrong when a problem is too large for the solver that `options` would plan it with."""
    try:
        solver = solver_of(options)
    except MissingExtra:
        return None
    slides = max(joints - task_dimension(scene.keep), 0) if options.knots == "sliding" else 0
    # `SplineSpace.dimension` unknowns a joint, and the slides.
    unknowns = (scene.via_points - SUPPORT) * joints + scene.via_points * slides
    if solver == "sqp" or unknowns <= MOST_UNKNOWNS:
        return None
    most = (MOST_UNKNOWNS + SUPPORT * joints) // (joints + slides)
    installed = importlib.util.find_spec("piqp") is not None
    how = "" if installed else f" ({install_command('fast')})"
    return _warning(
        "tool_path.via_points",
        f"{scene.via_points} with solver: slsqp, whose time grows with the cube of their number",
        f"at most {most}, or planner.solver: sqp{how}, whose time grows in proportion",
    )


def require_reasonable_size(scene: Scene, joints: int, options: PlannerOptions) -> None:
    """Refuse a scene that is `oversized`.

    Raises
    ------
    SceneError
        With what to do about it.
    """
    found = oversized(scene, joints, options)
    if found is not None:
        raise SceneError(scene.source, found.key, found.got, found.expected)


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
    task: ToolTask,
    pair: ShapePair | None,
    distance: float,
    torque: float,
    use: FloatArray,
) -> Iterator[tuple[str, str]]:
    point = ", ".join(f"{x:.4f}" for x in task.path.corners[0])
    yield "tool point at the start", f"({point}) m"
    if pair is not None:
        yield "clearance at the start", f"{distance:.4f} m ({pair.link} to {pair.other})"
    yield "smallest singular value there", f"{task.smallest_singular_value(robot, scene.posture):.4f}"
    yield "torque on the guardrail there", f"{torque:.2f} Nm"
    yield "largest joint torque there", f"{use.max():.2f} of the bound of {robot.joints[use.argmax()]}"


def _posture_warnings(
    scene: Scene, robot: Robot, pair: ShapePair | None, distance: float, use: FloatArray
) -> Iterator[Finding]:
    margin = scene.planner.safety_margin_m
    if pair is not None and distance < margin:
        yield _warning(
            "posture_deg",
            pair.describe(distance, margin),
            "a start that is clear: another posture, other obstacles or a lower planner.safety_margin_m",
        )
    if use.max() > 1.0:
        got = f"{use.max():.2f} of the torque that {robot.joints[use.argmax()]} can bear, at rest"
        yield _warning("posture_deg", got, "at most 1: another posture or less payload")


def _reach_warnings(robot: Robot, path: ToolPath) -> Iterator[Finding]:
    for leg in beyond_reach(robot, path):
        got = f"an end {leg.distance:.3f} m from the arm's first joint"
        yield _warning(leg.key, got, f"at most {leg.reach:.3f} m, the arm with its tool stretched out")


def _warning(key: str, got: str, expected: str) -> Finding:
    return Finding(severity="warning", key=key, got=got, expected=expected)
