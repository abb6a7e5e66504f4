"""The joint path: gradient projection with a singularity-robust inverse (Chang 2021, Eqs. (15)-(22))."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbot.collision.clearance import Clearances, Nearest
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.path.task import ToolTask
from cmbot.robot import Kinematics, Robot
from cmbot.scene.options import PlannerOptions

__all__ = ["JointPath", "follow_path", "place_on_task", "robust_inverse"]


# The tool is lost, not merely drifting, when it lags this far behind its path.
_LOST = 0.01
# Power k of the weights by which the nearest of several pairs prevails: small lets them cancel out, large
# comes near to Eq. (17)'s jumps.
_SHARPNESS = 8
# Corrections of a via-point end when the task error is below this (m and rad); more steps than this many
# mean that it cannot be reached.
_ON_TASK = 1e-12
_MOST_CORRECTIONS = 50


@dataclass(frozen=True, kw_only=True)
class JointPath:
    """A path in joint space that follows the tool path: the paper's motion without optimisation.

    Attributes
    ----------
    t : (N,), s
        Equal steps.
    q, v : (N, n), rad and rad/s
        Postures, and the rates of Eq. (22) by which each was left.
    clearance : (N,), m
        Smallest distance to obstacles and of the arm to itself.
    singular_value : (N,)
        Smallest singular value of the task Jacobian, Eq. (19).
    drift : (N,), m
        Distance of the tool point from where it should be at that time.
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    clearance: FloatArray
    singular_value: FloatArray
    drift: FloatArray


def follow_path(
    robot: Robot,
    task: ToolTask,
    posture: FloatArray,
    clearances: Clearances,
    options: PlannerOptions,
    *,
    stop_at_obstacles: bool = True,
    tell: Callable[[int, int], None] | None = None,
) -> JointPath:
    """Follow a tool path from a posture, away from obstacles.

    Integrates Eq. (22). The commanded velocity leads from where the tool should be now to where it should be
    one step later, plus feedback of the pose error, so that neither the step nor the damping lets it drift.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
    posture : (n,), rad
        Where the arm starts; its tool pose is the start of the tool path.
    clearances : Clearances
    options : PlannerOptions
    stop_at_obstacles : bool
        False carries on whatever happens, to show what the motion would be.
    tell : callable, optional
        Called with the number of steps that are done, and of all.

    Raises
    ------
    PathNotFound
        When a joint leaves its range, a shape comes within the safety margin, or the tool cannot follow.
    """
    kinematics = Kinematics(robot)
    steps = max(round(task.path.duration / options.path_step_s), 1)
    t = np.linspace(0.0, task.path.duration, steps + 1)
    points = task.path.position(t)
    dt = t[1]
    q, v = np.empty((steps + 1, robot.dof)), np.empty((steps + 1, robot.dof))
    clearance, singular_value, drift = (np.empty(steps + 1) for _ in range(3))
    q[0] = posture
    for k in range(steps + 1):
        X_WT, J = kinematics.tool_jacobian(q[k])
        J = task.jacobian(X_WT, J)
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        error = task.error(X_WT, points[k])
        singular_value[k] = s[-1]
        drift[k] = np.linalg.norm(X_WT.translation - points[k])
        if stop_at_obstacles:
            smallest = clearances.smallest(q[k : k + 1])
            clearance[k] = smallest.distance[0]
            obstacle = _obstacle(robot, clearances, smallest.pair[0], q[k], clearance[k], error, options)
            if obstacle is not None:
                reason, pair = obstacle
                raise PathNotFound(
                    reason,
                    time=float(t[k]),
                    progress=task.path.progress(float(t[k])),
                    smallest_singular_value=float(s[-1]),
                    pair=pair,
                )
        ahead = points[min(k + 1, steps)] - points[k]
        command = np.zeros(len(error))
        command[:3] = ahead / dt
        command += options.drift_gain * error
        gradient = _gradient(kinematics, clearances, q[k], options)
        # (I - J+ J) gradient of Eq. (16): the part that leaves the task alone.
        aside = gradient - Vt.T @ (Vt @ gradient)
        v[k] = _damped_inverse(U, s, Vt, options) @ command + options.avoidance_gain * aside
        if k < steps:
            q[k + 1] = q[k] + dt * v[k]
        if tell is not None:
            tell(k + 1, steps + 1)
    if not stop_at_obstacles:
        # All at once is quicker.
        clearance = clearances.smallest(q).distance
    return JointPath(t=t, q=q, v=v, clearance=clearance, singular_value=singular_value, drift=drift)


def robust_inverse(J: FloatArray, options: PlannerOptions) -> FloatArray:
    """Singularity-robust inverse J* (n, m) of `J` (m, n), Chang 2021, Eqs. (18)-(21)."""
    return _damped_inverse(*np.linalg.svd(J, full_matrices=False), options)


def _damped_inverse(U: FloatArray, s: FloatArray, Vt: FloatArray, options: PlannerOptions) -> FloatArray:
    s_h = options.damping_threshold
    damping = options.damping_max * (1 - s[-1] / s_h) if s[-1] < s_h else 0.0
    return np.asarray((Vt.T * (s / (s**2 + damping**2))) @ U.T)


def place_on_task(
    kinematics: Kinematics, task: ToolTask, q: FloatArray, point: FloatArray
) -> FloatArray | None:
    """Move posture `q` (n,) the least way onto the task at `point` (3,); None where it cannot be reached."""
    for _ in range(_MOST_CORRECTIONS):
        X_WT, J = kinematics.tool_jacobian(q)
        error = task.error(X_WT, point)
        if np.abs(error).max() < _ON_TASK:
            return q
        q = q + np.linalg.lstsq(task.jacobian(X_WT, J), error, rcond=1e-6)[0]
    X_WT = kinematics.tool_pose(q)
    return q if np.abs(task.error(X_WT, point)).max() < 1e3 * _ON_TASK else None


def _gradient(
    kinematics: Kinematics, clearances: Clearances, q: FloatArray, options: PlannerOptions
) -> FloatArray:
    """Gradient of H, (n,): away from what is near, and the arm's centre of mass towards the foot."""
    away = _away_switched if options.avoidance == "switch" else _away_smoothly
    gradient = away(clearances, q, options.avoidance_distance_m)
    if options.centre_of_gravity_weight > 0:
        centre, J_c = kinematics.centre_of_mass(q)
        # Only the horizontal lever makes a torque about the foot.
        gradient -= options.centre_of_gravity_weight * (J_c[:2].T @ centre[:2])
    return gradient


def _away_switched(clearances: Clearances, q: FloatArray, d_s: float) -> FloatArray:
    """J_C+ u of the nearest pair where it is nearer than `d_s`: Chang 2021, Eq. (17) to the letter."""
    smallest = clearances.smallest(q[None], avoidable_only=True)
    if not smallest.distance[0] <= d_s:
        return np.zeros(len(q))
    return _away_from(clearances.nearest(q, int(smallest.pair[0])))


def _away_smoothly(clearances: Clearances, q: FloatArray, d_s: float) -> FloatArray:
    """Eq. (17) for every near pair: ``sum w^(k+1) J_C+ u / sum w^k`` with ``w = 1 - d/d_s``.

    With one near pair that is its direction, fading in. With several the nearest prevails, without the jump
    on which Eq. (17) would chatter where another pair becomes the nearest.
    """
    total, weights = np.zeros(len(q)), 0.0
    for near in clearances.within(q, d_s):
        w = 1.0 - max(near.distance, 0.0) / d_s
        total += w ** (_SHARPNESS + 1) * _away_from(near)
        weights += w**_SHARPNESS
    return total / weights if weights > 0 else total


def _away_from(near: Nearest) -> FloatArray:
    """J_C+ u: the joint rates that move the arm's nearest point straight away."""
    return np.asarray(np.linalg.lstsq(near.jacobian, near.direction, rcond=1e-6)[0])


def _obstacle(
    robot: Robot,
    clearances: Clearances,
    pair: Any,
    q: FloatArray,
    clearance: float,
    error: FloatArray,
    options: PlannerOptions,
) -> tuple[str, tuple[str, str] | None] | None:
    """What keeps the arm from being in posture `q`: a reason and the pair of shapes, or nothing."""
    if not clearance >= options.safety_margin_m:
        shapes = clearances.pairs[pair]
        return shapes.too_near(clearance, options.safety_margin_m), (shapes.link, shapes.other)
    outside = np.flatnonzero((q < robot.limits.lower) | (q > robot.limits.upper))
    if len(outside):
        i = outside[0]
        low, high = np.rad2deg([robot.limits.lower[i], robot.limits.upper[i]])
        return (
            f"{robot.joints[i]} leaves its range {low:g} to {high:g} deg ({np.rad2deg(q[i]):.1f} deg)",
            None,
        )
    if np.linalg.norm(error[:3]) > _LOST:
        return f"the tool is {np.linalg.norm(error[:3]):.3f} m behind its path: out of reach", None
    return None
