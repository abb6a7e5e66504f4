"""Plan a scene: read `plan` as the paper's abstract."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from cmbot.arrays import FloatArray
from cmbot.errors import InputError, PathNotFound, SceneError
from cmbot.planning.certificate import certify
from cmbot.planning.families import FixedKnots, WhitenedSplines
from cmbot.planning.figures import Samples, figures, measure
from cmbot.planning.gradient_projection import JointPath, follow_path, place_on_task
from cmbot.planning.optimiser import PassReport, optimise
from cmbot.planning.plan import Plan, Seconds
from cmbot.planning.problem import TorqueProblem
from cmbot.planning.spline_space import SplineSpace
from cmbot.planning.starts import find_path
from cmbot.planning.task import ToolTask
from cmbot.robot import Kinematics, Robot, load_robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.scene.clearance import Clearances
from cmbot.scene.obstacles import pose
from cmbot.scene.tool_path import ToolPath
from cmbot.validation import validated

__all__ = ["Progress", "plan", "robot_of", "task_of"]


@dataclass(frozen=True, kw_only=True)
class Progress:
    """What the planner is doing.

    Attributes
    ----------
    stage : str
        ``path``, ``optimise`` or ``certify``.
    failed_starts : int
        Starting postures from which no path was found so far.
    report : PassReport or None
        After each pass of the optimiser.
    """

    stage: str
    failed_starts: int = 0
    report: PassReport | None = None


def plan(
    scene: Scene,
    *,
    options: PlannerOptions | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Plan:
    """Plan the motion of a scene's arm.

    Gradient projection carries the arm along the tool path, free of collisions; quintic splines through
    via-points of that path are optimised so that the torque on the guardrail stays small and the jerk smooth;
    the result is certified apart from the optimiser.

    Parameters
    ----------
    scene : Scene
    options : PlannerOptions, optional
        In place of the scene's own.
    progress : callable, optional
        Called with a `Progress` as the work goes on.

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    PathNotFound
        When the path ends at an obstacle, a joint's range or out of reach, from the scene's posture and from
        the others that were tried.
    OptimisationFailed
        When no trajectory through the path's via-points keeps the limits.
    LimitViolation
        When the certificate does not hold.
    """
    tell = progress or (lambda _: None)
    options = checked(options) if options is not None else scene.planner
    clock = _Clock()
    # The matrices are small: more threads of linear algebra than one only wait for each other.
    with threadpool_limits(limits=1, user_api="blas"):
        return _plan(scene, options, tell, clock)


def _plan(scene: Scene, options: PlannerOptions, tell: Callable[[Progress], None], clock: _Clock) -> Plan:
    robot = robot_of(scene)
    posture = robot.posture(scene.posture, source=scene.source, key="posture_deg", error_type=SceneError)
    task = task_of(scene, robot)
    clearances = Clearances(robot, scene.obstacles)

    tell(Progress(stage="path"))
    path, start = find_path(
        robot,
        task,
        posture,
        clearances,
        options,
        lambda failed: tell(Progress(stage="path", failed_starts=failed)),
    )
    via_times = task.path.via_times(scene.via_points)
    via_points = _via_points(robot, task, path, via_times)
    path_seconds = clock.lap()

    tell(Progress(stage="optimise"))
    family = fixed_knots(robot, via_times, via_points, options)
    problem = TorqueProblem(robot, task, family, clearances, options, resting=(0, -1))
    optimised = optimise(problem, lambda report: tell(Progress(stage="optimise", report=report)))
    optimise_seconds = clock.lap()

    tell(Progress(stage="certify"))
    certificate = certify(robot, task, optimised.trajectory, via_points, clearances, options)
    certificate.require()
    if start.moved > 0:
        # The comparison is with the paper's motion from the scene's own posture, obstacles or not.
        path = follow_path(robot, task, posture, clearances, options, stop_at_obstacles=False)
    baseline = _baseline(robot, task, clearances, path)
    certify_seconds = clock.lap()
    return Plan(
        scene=scene,
        options=options,
        robot=robot,
        task=task,
        start=start,
        baseline=baseline,
        baseline_figures=figures(robot, baseline),
        drift=float(path.drift.max()),
        smallest_singular_value=float(path.singular_value.min()),
        trajectory=optimised.trajectory,
        certificate=certificate,
        passes=optimised.passes,
        seconds=Seconds(
            path=path_seconds, optimise=optimise_seconds, certify=certify_seconds, total=clock.total()
        ),
    )


def robot_of(scene: Scene) -> Robot:
    """Load the robot that a scene names.

    Raises
    ------
    ModelError
        When its files cannot be used.
    """
    source = scene.robot
    mount = None
    if source.mount_xyz is not None and source.mount_rpy is not None:
        mount = pose(source.mount_xyz, source.mount_rpy)
    return load_robot(
        source.model,
        base_frame=source.base_frame,
        tool_frame=source.tool_frame,
        limits=source.limits,
        srdf=source.srdf,
        mount=mount,
        tool_length=source.tool_length,
        payload=source.payload,
    )


def task_of(scene: Scene, robot: Robot) -> ToolTask:
    """Return the timed tool path of a scene, from the tool pose of its posture.

    Raises
    ------
    SceneError
        When the posture does not fit the robot.
    """
    posture = robot.posture(scene.posture, source=scene.source, key="posture_deg", error_type=SceneError)
    X_WT = Kinematics(robot).tool_pose(posture)
    steps = np.array([leg.by for leg in scene.legs])
    path = ToolPath(
        corners=X_WT.translation + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]),
        orientation=X_WT.rotation,
        seconds=np.array([leg.seconds for leg in scene.legs]),
        profile=scene.speed_profile,
    )
    return ToolTask(path, scene.keep)


def checked(options: PlannerOptions) -> PlannerOptions:
    """Return `options` when every one is within its bounds.

    Raises
    ------
    InputError
        Naming the option, what it is and what it may be.
    """
    return validated(PlannerOptions, asdict(options), "PlannerOptions", InputError)


def _via_points(robot: Robot, task: ToolTask, path: JointPath, times: FloatArray) -> FloatArray:
    """Take via-points from a joint path at `times` (n,), each put onto the tool task exactly."""
    kinematics = Kinematics(robot)
    rough = np.stack([np.interp(times, path.t, joint) for joint in path.q.T], axis=1)
    via_points = np.empty_like(rough)
    for k, (q, point) in enumerate(zip(rough, task.path.position(times), strict=True)):
        placed = place_on_task(kinematics, task, q, point)
        if placed is None:
            nearest = int(np.abs(path.t - times[k]).argmin())
            raise PathNotFound(
                f"via-point {k + 1} cannot be put onto the tool path exactly: out of reach or singular",
                time=float(times[k]),
                progress=task.path.progress(float(times[k])),
                smallest_singular_value=float(path.singular_value[nearest]),
            )
        via_points[k] = placed
    return via_points


def _baseline(robot: Robot, task: ToolTask, clearances: Clearances, path: JointPath) -> Samples:
    acceleration = np.gradient(path.v, path.t, axis=0)
    jerk = np.gradient(acceleration, path.t, axis=0)
    return measure(robot, task, clearances, path.t, (path.q, path.v, acceleration, jerk))


def fixed_knots(
    robot: Robot, times: FloatArray, via_points: FloatArray, options: PlannerOptions
) -> FixedKnots:
    """Return the family of splines through fixed via-points (n, d), rad, from the least-jerk spline on."""
    splines = WhitenedSplines(SplineSpace(times), robot.limits)
    numbers = np.zeros((splines.basis.shape[1], robot.dof))
    return FixedKnots(splines, via_points, numbers, options.smoothing_weight)


class _Clock:
    """Wall time, in laps."""

    def __init__(self) -> None:
        self._start = self._lap = time.perf_counter()

    def lap(self) -> float:
        """Seconds since the last lap."""
        now = time.perf_counter()
        seconds, self._lap = now - self._lap, now
        return seconds

    def total(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self._start
