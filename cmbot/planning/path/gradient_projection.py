"""The joint path: gradient projection with a singularity-robust inverse (Chang 2021, Eqs. (15)-(22))."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cmbot.collision import Clearances, Nearest
from cmbot.common.arrays import FloatArray
from cmbot.planning.context import PlanningContext
from cmbot.robot import Kinematics
from cmbot.scene import PlannerOptions

__all__ = ["JointPath", "follow_path", "robust_inverse"]


# Lag of the tool behind its path, m, beyond which it is out of reach, not drifting.
_LOST = 0.01
# Power k of the weights of near pairs: with a small one they cancel out, with a large one the blend comes
# near to Eq. (17)'s jumps.
_SHARPNESS = 8


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
    context: PlanningContext,
    posture: FloatArray | None = None,
    *,
    stop_at_obstacles: bool = True,
    report: Callable[[int, int], None] | None = None,
) -> JointPath:
    """Follow a tool path from a posture, away from obstacles.

    Integrates Eq. (22). The commanded velocity leads from where the tool should be now to where it should be
    one step later, plus feedback of the pose error, so that neither the step nor the damping lets it drift.

    Parameters
    ----------
    context : PlanningContext
    posture : (n,), rad, optional
        Where the arm starts; its tool pose is the start of the tool path. By default the scene's.
    stop_at_obstacles : bool
        False carries on whatever happens, to show what the motion would be.
    report : callable, optional
        Called with the number of steps that are done, and of all.

    Raises
    ------
    PathNotFound
        When a joint leaves its range, a shape comes within the safety margin, or the tool cannot follow.
    """
    robot, task, clearances, options = context.robot, context.task, context.clearances, context.options
    kinematics = Kinematics(robot)
    steps = max(round(task.path.duration / options.path_step_s), 1)
    t = np.linspace(0.0, task.path.duration, steps + 1)
    points = task.path.position(t)
    dt = t[1]
    q, v = np.empty((steps + 1, robot.dof)), np.empty((steps + 1, robot.dof))
    clearance, singular_value, drift = (np.empty(steps + 1) for _ in range(3))
    q[0] = context.posture if posture is None else posture
    for k in range(steps + 1):
        X_WT, J = kinematics.tool_jacobian(q[k])
        U, s, Vt = np.linalg.svd(task.jacobian(X_WT.rotation, J), full_matrices=False)
        error = task.error(X_WT, points[k])
        singular_value[k] = s[-1]
        drift[k] = np.linalg.norm(X_WT.translation - points[k])
        if stop_at_obstacles:
            clearance[k] = _require_free(context, q[k], t[k], error)
        ahead = points[min(k + 1, steps)] - points[k]
        command = np.zeros(len(error))
        command[:3] = ahead / dt
        command += options.drift_gain * error
        gradient = _gradient(kinematics, clearances, q[k], options)
        # (I - J+ J) gradient of Eq. (16): the part in the null space of the task.
        aside = gradient - Vt.T @ (Vt @ gradient)
        v[k] = _damped_inverse(U, s, Vt, options) @ command + options.avoidance_gain * aside
        if k < steps:
            q[k + 1] = q[k] + dt * v[k]
        if report is not None:
            report(k + 1, steps + 1)
    if not stop_at_obstacles:
        # One batch is quicker.
        clearance = clearances.smallest(q).distance
    return JointPath(t=t, q=q, v=v, clearance=clearance, singular_value=singular_value, drift=drift)


def robust_inverse(J: FloatArray, options: PlannerOptions) -> FloatArray:
    """Singularity-robust inverse J* (n, m) of `J` (m, n), Chang 2021, Eqs. (18)-(21)."""
    return _damped_inverse(*np.linalg.svd(J, full_matrices=False), options)


def _damped_inverse(U: FloatArray, s: FloatArray, Vt: FloatArray, options: PlannerOptions) -> FloatArray:
    s_h = options.damping_threshold
    damping = options.damping_max * (1 - s[-1] / s_h) if s[-1] < s_h else 0.0
    return np.asarray((Vt.T * (s / (s**2 + damping**2))) @ U.T)


def _gradient(
    kinematics: Kinematics, clearances: Clearances, q: FloatArray, options: PlannerOptions
) -> FloatArray:
    """Gradient of H, (n,): away from near pairs, and the arm's centre of mass towards the foot."""
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
    """J_C+ u: the joint rates that move the arm's nearest point straight away from the other one."""
    return np.asarray(np.linalg.lstsq(near.jacobian, near.direction, rcond=1e-6)[0])


def _require_free(context: PlanningContext, q: FloatArray, time: float, error: FloatArray) -> float:
    """Return the clearance of posture `q`; refuse one that is too near, out of range or off the path."""
    robot, margin = context.robot, context.options.safety_margin_m
    smallest = context.clearances.smallest(q[None])
    clearance, lag = float(smallest.distance[0]), float(np.linalg.norm(error[:3]))
    outside = np.flatnonzero((q < robot.limits.lower) | (q > robot.limits.upper))
    pair = None
    if not clearance >= margin:
        shapes = context.clearances.pairs[smallest.pair[0]]
        reason, pair = shapes.describe(clearance, margin), (shapes.link, shapes.other)
    elif len(outside):
        i = outside[0]
        low, high, angle = np.rad2deg([robot.limits.lower[i], robot.limits.upper[i], q[i]])
        reason = f"{robot.joints[i]} leaves its range {low:g} to {high:g} deg ({angle:.1f} deg)"
    elif lag > _LOST:
        reason = f"the tool is {lag:.3f} m behind its path: out of reach"
    else:
        return clearance
    raise context.path_not_found(reason, q, time, pair)
