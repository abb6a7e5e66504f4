"""Scenes that plan in a moment: the shipped robot, one short leg, few via-points."""

import copy
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.planning import ToolTask, robot_of, strokes_of, task_of
from cmbot.planning.initial_guess import initial_guess
from cmbot.planning.request import StrokeRequest, build_request
from cmbot.planning.torque.problem import TorqueProblem, parametrization_through
from cmbot.robot import Dynamics, Kinematics, Postures, Robot
from cmbot.scene import Scene, load_scene
from cmbot.toolpath import SpeedProfile, ToolPath, ToolPoses
from cmbot.trajectory.quintic import QuinticTrajectory

SHORT: dict[str, Any] = {
    "format": "cmbot-scene/2",
    "name": "short",
    "robot": {"model": "cmbot", "joints": "rigid"},
    "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
    "tool_path": {
        "legs": [{"by": [0, -0.3, 0], "seconds": 4}],
        "speed_profile": {"kind": "trapezoidal"},
        "via_points": 8,
    },
    "planner": {"knots": "fixed", "path_step_s": 0.02, "baseline": "paper", "compensate": False},
}


def short_scene(
    *,
    robot: dict[str, Any] | None = None,
    tool_path: dict[str, Any] | None = None,
    posture_deg: list[float] | None = None,
    **changes: Any,
) -> Scene:
    """Scene of a short leg; entries of blocks given as mappings are changed one by one."""
    data = copy.deepcopy(SHORT)
    if posture_deg is not None:
        data["start"] = {"posture_deg": posture_deg}
    data["robot"] |= robot or {}
    data["tool_path"] |= tool_path or {}
    data["planner"] |= changes.pop("planner", {})
    return load_scene(data | changes)


def panda_scene(tool_path: dict[str, Any], **entries: Any) -> Scene:
    """A Panda on the floor that follows a path."""
    return load_scene(
        {
            "format": "cmbot-scene/2",
            "name": "panda",
            "robot": {"model": "panda", "tool_frame": "panda_hand"},
            "guardrail": {"bays": 0},
            "start": {"posture": [0.0, 0.2, 0.0, -1.8, 0.0, 2.0, 0.8]},
            "tool_path": tool_path,
        }
        | entries
    )


def strokes_scene(ramp: float = 0.0, **planner: Any) -> Scene:
    """Scene of two short strokes 0.1 m apart with a process force, sliding knots, and a return."""
    way = {"via_points": 12, "speed_profile": {"kind": "jerk_limited", "ramp": 0.4}}
    there = {"name": "there", "legs": [{"by": [0, -0.1, 0], "seconds": 3}], **way}
    begin = {"frame": "world", "xyz": [1.8154, 0.6796, -1.9628]}
    back = {"name": "back", "from": begin, "legs": [{"by": [0, 0.1, 0], "seconds": 3}], **way}
    changes = {
        "name": "strokes",
        "tool": {"process_force_n": [0, 0, -40], "process_ramp_s": ramp},
        "tool_path": {"strokes": [there, back]},
        "return": "start",
        "planner": {"path_step_s": 0.02, "baseline": "paper", "compensate": False, **planner},
    }
    return load_scene({**copy.deepcopy(SHORT), **changes})


def parts(scene: Scene) -> tuple[Robot, ToolTask, FloatArray, Clearances]:
    """Robot, task, posture and clearances of a scene."""
    robot = robot_of(scene)
    return (
        robot,
        task_of(strokes_of(scene, robot)[0], scene),
        scene.posture,
        Clearances(robot, scene.all_obstacles),
    )


def path_through(corners: FloatArray, orientation: FloatArray) -> ToolPath:
    """A tool path of a second a leg."""
    seconds = np.ones(len(corners) - 1)
    return ToolPath.straight(corners, orientation, seconds, SpeedProfile().law)


def task_at(robot: Robot, q: FloatArray, keep: Any = "pose") -> ToolTask:
    """The task of moving the tool 0.1 m up from posture `q` (n,)."""
    X_WT = Kinematics(robot).tool_pose(q)
    corners = X_WT.translation + np.array([[0.0, 0, 0], [0, 0, 0.1]])
    return ToolTask(path_through(corners, X_WT.rotation), keep)


def goals_at(task: ToolTask, points: FloatArray) -> ToolPoses:
    """The path's orientation at other points, (N, 3) or (3,)."""
    return ToolPoses(point=np.atleast_2d(points), rotation=task.path.orientation[None])


def off_task(robot: Robot, task: ToolTask, q: FloatArray, goals: ToolPoses) -> float:
    """Largest error of the task in postures `q` (N, n), m or rad."""
    at = Postures(robot).tool_at(q)
    return float(np.abs(task.errors(at.tool_point, at.tool_rotation, goals)).max())


def tool_points(robot: Robot, q: FloatArray) -> FloatArray:
    """The tool (N, 3), m, in postures `q` (N, n), by pinocchio alone."""
    data, points = robot.model.createData(), np.empty((len(q), 3))
    for k, q_k in enumerate(q):
        pin.framesForwardKinematics(robot.model, data, q_k)
        points[k] = data.oMf[robot.tool_frame_id].translation
    return points


def torque_along(problem: TorqueProblem, trajectory: QuinticTrajectory, times: FloatArray) -> FloatArray:
    """Torque on the guardrail (N,) in units of the problem's scale."""
    efforts = Dynamics(problem.request.cell.robot).efforts(*trajectory.states(times))
    return np.asarray(np.linalg.norm(efforts.guardrail_torque, axis=1) / problem.scale)


def request_of(scene: Scene, **options: Any) -> StrokeRequest:
    """The planning asked of a scene, with other options."""
    return build_request(scene, replace(scene.planner, **options))


def problem_of(scene: Scene, **options: Any) -> TorqueProblem:
    """The torque problem around the initial guess for a scene, with other options."""
    return initial_guess(request_of(scene, **options)).problem


@cache
def short_request() -> tuple[StrokeRequest, FloatArray]:
    """The asked of the short scene, and its via-points by gradient projection."""
    asked = request_of(short_scene())
    return asked, initial_guess(asked).problem.parametrization.via_points


@cache
def torque_problem(kind: str, least: float = 0.0) -> TorqueProblem:
    """The short scene's problem with via-points that are ``fixed``, ``free``, or ``pinned`` at the start."""
    asked, via_points = short_request()
    form = parametrization_through(asked, via_points, sliding=kind != "fixed", pinned=kind == "pinned")
    return TorqueProblem(asked, form, least)


def with_corners(path: ToolPath, corners: FloatArray) -> ToolPath:
    """Straight legs between other corners, timed as those of a path."""
    return ToolPath.straight(corners, path.orientation, path.seconds, path.segments[0].law)
