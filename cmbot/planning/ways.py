"""The two ways to via-points: on the path of gradient projection, or sliding to where the torque is least."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.errors import PathNotFound
from cmbot.planning.families import FixedKnots, SlidingKnots, WhitenedSplines
from cmbot.planning.global_stage import Floor, GlobalStage
from cmbot.planning.gradient_projection import JointPath, place_on_task
from cmbot.planning.problem import TorqueProblem
from cmbot.planning.self_motion import Chart
from cmbot.planning.setting import Setting
from cmbot.planning.spline_space import SplineSpace
from cmbot.planning.starts import find_path
from cmbot.robot import Kinematics, Postures

__all__ = ["Choice", "Way", "fixed_way", "sliding_way"]


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What the global stage found for each choice of the start.

    Attributes
    ----------
    free, pinned : float or None, Nm
        Peak static torque over the via-points; None where there is no way.
    """

    free: float | None
    pinned: float | None


@dataclass(frozen=True, kw_only=True)
class Way:
    """Where the optimisation starts, and what is known of it.

    Attributes
    ----------
    problem : TorqueProblem
    failures : tuple of PathNotFound
        Starts that led nowhere, the scene's posture first.
    floor : Floor or None
        With sliding knots only.
    choice : Choice or None
        With sliding knots only.
    chart : Chart or None
        Of the self-motion at the start; with sliding knots only.
    """

    problem: TorqueProblem
    failures: tuple[PathNotFound, ...] = ()
    floor: Floor | None = None
    choice: Choice | None = None
    chart: Chart | None = None


def fixed_way(setting: Setting, tell: Callable[[int], None]) -> Way:
    """Take via-points from the path of gradient projection, to stay there (Chang 2021, Eqs. (15)-(30)).

    Parameters
    ----------
    setting : Setting
    tell : callable
        Called with the number of failed starts before each further one is tried.

    Raises
    ------
    PathNotFound
        When no start leads to the end of the path.
    """
    path, failures = find_path(
        setting.robot, setting.task, setting.posture, setting.clearances, setting.options, tell
    )
    splines, numbers = _splines(setting)
    family = FixedKnots(splines, _via_points(setting, path), numbers, setting.options.smoothing_weight)
    static = Postures(setting.robot).at(family.via_points).guardrail_torque
    floor = float(np.linalg.norm(static, axis=1).max())
    return Way(problem=_problem(setting, family, resting=(0, -1), floor=floor), failures=failures)


def sliding_way(setting: Setting) -> Way:
    """Take via-points from the global stage, to slide along the self-motion.

    With ``start: pinned`` the arm starts in the scene's posture; with ``free`` wherever the tool is the same.

    Raises
    ------
    PathNotFound
        When a via-point is blocked, or nothing leads from one to the next.
    """
    options = setting.options
    stage = GlobalStage(
        setting.robot, setting.task, setting.times, setting.posture, setting.clearances, options
    )
    pinned = options.start == "pinned"
    solution = stage.solve(pinned=pinned)
    try:
        other: float | None = stage.solve(pinned=not pinned).peak
    except PathNotFound:
        other = None
    splines, numbers = _splines(setting)
    family = SlidingKnots(
        splines,
        solution.q,
        numbers,
        options.smoothing_weight,
        postures=Postures(setting.robot),
        task=setting.task,
        points=setting.task.path.position(setting.times),
        pinned=pinned,
    )
    return Way(
        problem=_problem(setting, family, resting=(0,) if pinned else (), floor=stage.floor.torque),
        floor=stage.floor,
        choice=Choice(free=other if pinned else solution.peak, pinned=solution.peak if pinned else other),
        chart=stage.first_chart,
    )


def _problem(
    setting: Setting, family: FixedKnots, *, resting: tuple[int, ...], floor: float
) -> TorqueProblem:
    return TorqueProblem(
        setting.robot,
        setting.task,
        family,
        setting.clearances,
        setting.options,
        resting=resting,
        floor=floor,
    )


def _splines(setting: Setting) -> tuple[WhitenedSplines, FloatArray]:
    """Splines over the via-points' times, and the numbers of the least-jerk one."""
    splines = WhitenedSplines(SplineSpace(setting.times), setting.robot.limits)
    return splines, np.zeros((splines.basis.shape[1], setting.robot.dof))


def _via_points(setting: Setting, path: JointPath) -> FloatArray:
    """Take via-points from a joint path, each put onto the tool task exactly."""
    kinematics, task, times = Kinematics(setting.robot), setting.task, setting.times
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
