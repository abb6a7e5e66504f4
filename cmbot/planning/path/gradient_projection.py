"""The joint path: gradient projection with a singularity-robust inverse (Chang 2021, Eqs. (15)-(22)).

Where a path fails, "the manipulator should change its initial position" (Section 3.1): other starting
postures with the same tool pose are reached by self-motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg.lapack import dgesdd

from cmbot.collision import Clearances, Nearest
from cmbot.common.arrays import FloatArray, interpolated
from cmbot.common.errors import PathNotFound
from cmbot.planning.postures.projection import null_space, project_onto_task
from cmbot.planning.request import StrokeRequest
from cmbot.planning.workcell.diagnosis import no_start_left
from cmbot.robot import Kinematics, PostureMetric, postures_in_words
from cmbot.scene import PlannerOptions
from cmbot.trajectory import sample_step

# Lag of the tool behind its path, m, beyond which it no longer follows, not only drifts.
_MAX_PATH_LAG_M = 0.01
# Power k of the weights of near pairs: with a small one they cancel out, with a large one the blend comes
# near to Eq. (17)'s jumps.
_WEIGHT_EXPONENT = 8
# Singular values below this share of the largest one are none.
_RANK_TOLERANCE = 1e-6
# Length of the steps along a self-motion, rad, and how many are taken each way; every fourth posture is
# tried.
_TRIAL_STEP = 0.05
_MAX_STEPS = 400
_TRIED_STRIDE = 4
# Steps of Eq. (22) between reports of how far it is.
_REPORT_STRIDE = 20
# Step of a first, coarse integration of Eq. (22) from another start, s.
_COARSE_STEP_S = 0.05
# Beyond it, s, joints are moved away from obstacles in proportion less: steps are the same then.
_FULL_STEP_S = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class JointPath:
    """A path in joint space that follows the tool path: the paper's motion without optimisation.

    Attributes
    ----------
    t : (N,), s
        Equal steps.
    q, v : (N, n), rad and rad/s, of joints that slide m and m/s
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

    def at(self, times: FloatArray) -> FloatArray:
        """Return the postures (k, n) at `times` (k,), s, straight between those that are known."""
        return interpolated(times, self.t, self.q)

    def motion(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return position, velocity, acceleration and jerk (N, n), with rest before and after the path."""
        # Two steps of rest on either side: the central differences are then the same all along.
        rates = np.pad(self.v, ((2, 2), (0, 0)))
        acceleration = (rates[2:] - rates[:-2]) / (2 * self.t[1])
        jerk = (acceleration[2:] - acceleration[:-2]) / (2 * self.t[1])
        # The trapezoid begins and ends with a jump of acceleration, whose mean occurs at no instant: the
        # first and last samples are those of the arm at rest, so that the torques include those of rest.
        acceleration[[1, -2]] = 0.0
        return self.q, self.v, acceleration[1:-1], jerk


def follow_path(
    request: StrokeRequest,
    posture: FloatArray | None = None,
    *,
    stop_at_obstacles: bool = True,
    report: Callable[[int, int], None] | None = None,
) -> JointPath:
    """Follow a tool path from a posture (n,), by default the scene's, away from obstacles.

    Integrates Eq. (22). The commanded velocity leads from where the tool should be now to where it should be
    one step later, plus feedback of the pose error, so that neither the step nor the damping lets it drift.
    Steps are those of the options; of motions of more than 40,000 of them they are longer.
    Norms are those of `PostureMetric`: joints that slide have coordinates in rad, too.
    Where the tool's axis may lean it is held in the middle of its cone.
    Without `stop_at_obstacles` it goes on whatever happens. `report` is called with the number of steps that
    are done, and of all.

    Raises
    ------
    PathNotFound
        When a joint leaves its range, a shape comes within the safety margin, or the tool cannot follow.
    """
    cell = request.cell
    robot, task = cell.robot, request.task.on_axis
    clearances, options = cell.clearances, cell.options
    kinematics = Kinematics(robot)
    step = sample_step(task.path.duration, options.path_step_s)
    if step > options.path_step_s:
        # Euler's method is stable with them, too.
        gains = min(options.drift_gain, 1 / step), options.avoidance_gain * min(1.0, _FULL_STEP_S / step)
        options = replace(options, drift_gain=gains[0], avoidance_gain=gains[1])
    steps = max(round(task.path.duration / step), 1)
    t = np.linspace(0.0, task.path.duration, steps + 1)
    goals = task.path.poses(t)
    dt, metric = t[1], robot.metric
    # What leads from each goal to the next one; from the last one nowhere.
    ahead = np.diff(goals.point, axis=0, append=goals.point[-1:]) / dt
    q, v = np.empty((steps + 1, robot.dof)), np.empty((steps + 1, robot.dof))
    clearance, singular_value, tool = np.empty(steps + 1), np.empty(steps + 1), np.empty((steps + 1, 3))
    q[0] = request.first if posture is None else posture
    for k in range(steps + 1):
        X_WT, J = kinematics.tool_jacobian(q[k])
        J = metric.positions(J)
        U, s, Vt = _svd(task.jacobian(X_WT.rotation, J))
        error = task.error(X_WT, goals[k])
        singular_value[k], tool[k] = s[-1], X_WT.translation
        if stop_at_obstacles:
            clearance[k] = _require_free(request, q[k], t[k], error)
        command = options.drift_gain * error
        command[:3] += ahead[k]
        if k < steps and task.path.turns:
            command[3:] += (task.error(X_WT, goals[k + 1]) - error)[3:] / dt
        gradient = _gradient(kinematics, clearances, q[k], options)
        # (I - J+ J) gradient of Eq. (16): the part in the null space of the task.
        aside = gradient - Vt.T @ (Vt @ gradient)
        rates = Vt.T @ (_damped(s, options) * (U.T @ command)) + options.avoidance_gain * aside
        v[k] = metric.positions(rates)
        if k < steps:
            q[k + 1] = q[k] + dt * v[k]
        if report is not None and (k % _REPORT_STRIDE == 0 or k == steps):
            report(k + 1, steps + 1)
    if not stop_at_obstacles:
        # One batch is quicker.
        clearance = clearances.query(q).distance
    drift = np.linalg.norm(tool - goals.point, axis=1)
    return JointPath(t=t, q=q, v=v, clearance=clearance, singular_value=singular_value, drift=drift)


def aside_at_start(request: StrokeRequest, start: FloatArray) -> float:
    """Return how far a posture `start` (n,), rad, in which the work starts lies from the scene's posture.

    A bent arm's start is taken back by the sag first: to where a rigid one holds the tool.
    """
    cell, goal = request.cell, request.task.goals(np.zeros(1))
    if cell.sag is not None:
        start = project_onto_task(cell.postures, request.task, start[None], goal)[0][0]
    return float(np.abs(cell.robot.metric.coordinates(start - request.state.posture)).max())


def robust_inverse(J: FloatArray, options: PlannerOptions) -> FloatArray:
    """Singularity-robust inverse J* (n, m) of `J` (m, n), Chang 2021, Eqs. (18)-(21)."""
    U, s, Vt = _svd(J)
    return np.asarray((Vt.T * _damped(s, options)) @ U.T)


def _svd(J: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """U (m, k), s (k,) and V^T (k, n) of `J` (m, n): what numpy.linalg.svd calls, in half its time."""
    U, s, Vt, failed = dgesdd(J, full_matrices=0)
    if failed:
        raise np.linalg.LinAlgError("SVD did not converge")
    return U, s, Vt


def _damped(s: FloatArray, options: PlannerOptions) -> FloatArray:
    """The singular values of J* by those of J."""
    s_h = options.damping_threshold
    damping = options.damping_max * (1 - s[-1] / s_h) if s[-1] < s_h else 0.0
    return np.asarray(s / (s * s + damping * damping))


def _gradient(
    kinematics: Kinematics, clearances: Clearances, q: FloatArray, options: PlannerOptions
) -> FloatArray:
    """Gradient of H, (n,): away from near pairs, and the arm's centre of mass towards the foot.

    It is by the coordinates of the robot's metric.
    """
    metric = kinematics.robot.metric
    away = _away_switched if options.avoidance == "switch" else _away_smoothly
    gradient = away(clearances, q, options.avoidance_distance_m, metric)
    if options.centre_of_gravity_weight > 0:
        centre, J_c = kinematics.centre_of_mass(q)
        # Only the horizontal lever makes a torque about the foot.
        lever = centre[:2] - np.array(kinematics.robot.foot_point[:2])
        gradient -= options.centre_of_gravity_weight * (metric.positions(J_c)[:2].T @ lever)
    return gradient


def _away_switched(clearances: Clearances, q: FloatArray, d_s: float, metric: PostureMetric) -> FloatArray:
    """J_C+ u of the nearest pair where it is nearer than `d_s`: Chang 2021, Eq. (17) to the letter."""
    smallest = clearances.query(q[None], avoidable_only=True)
    if not smallest.distance[0] <= d_s:
        return np.zeros(len(q))
    return np.asarray(_away_from([clearances.nearest(q, int(smallest.pair[0]))], metric)[0])


def _away_smoothly(clearances: Clearances, q: FloatArray, d_s: float, metric: PostureMetric) -> FloatArray:
    """Eq. (17) for every near pair: ``sum w^(k+1) J_C+ u / sum w^k`` with ``w = 1 - d/d_s``.

    With one near pair that is its direction, fading in. With several the nearest prevails, without the jump
    on which Eq. (17) would chatter where another pair becomes the nearest.
    """
    near = clearances.within(q, d_s)
    if not near:
        return np.zeros(len(q))
    w = 1.0 - np.maximum([each.distance for each in near], 0.0) / d_s
    shares = w**_WEIGHT_EXPONENT
    total = shares.sum()
    return np.asarray((shares * w) @ _away_from(near, metric) / (total if total > 0 else 1.0))


def _away_from(near: Sequence[Nearest], metric: PostureMetric) -> FloatArray:
    """J_C+ u (k, n): the joint rates that move the arm's nearest points straight away from the others."""
    J = metric.positions(np.array([each.jacobian for each in near]))
    J_T = J.transpose(0, 2, 1)
    # By the eigenvalues of J J^T: that takes half the time of a least-squares solver. The first links move in
    # fewer directions than three.
    squares, Q = np.linalg.eigh(J @ J_T)
    there = squares > _RANK_TOLERANCE**2 * squares[:, -1:]
    inverse = there / np.where(there, squares, 1.0)
    along = np.array([each.direction for each in near])[:, None] @ Q
    return np.asarray((J_T @ (Q @ (along * inverse[:, None]).transpose(0, 2, 1)))[:, :, 0])


def _require_free(request: StrokeRequest, q: FloatArray, time: float, error: FloatArray) -> float:
    """Return the clearance of posture `q`; refuse one that is too near, out of range or off the path."""
    cell = request.cell
    robot, margin = cell.robot, cell.options.safety_margin_m
    smallest = cell.clearances.query(q[None])
    clearance, lag = float(smallest.distance[0]), float(np.linalg.norm(error[:3]))
    outside = np.flatnonzero((q < robot.limits.lower) | (q > robot.limits.upper))
    pair = None
    if not clearance >= margin:
        shapes = cell.clearances.pairs[smallest.pair[0]]
        reason, pair = shapes.describe(clearance, margin), (shapes.link, shapes.other)
    elif len(outside):
        i = int(outside[0])
        here = postures_in_words(robot.limits.prismatic[[i]], q[[i]])
        reason = f"{robot.joints[i]} leaves its range {robot.limits.range_in_words(i)} {here}"
    elif lag > _MAX_PATH_LAG_M:
        reason = f"the tool is {lag:.3f} m behind its path, which gradient projection cannot follow there"
    else:
        return clearance
    raise request.path_not_found(reason, q, time, pair)


def find_path(request: StrokeRequest) -> tuple[JointPath, tuple[PathNotFound, ...]]:
    """Follow the tool path from the scene's posture; where that fails, from others at the same tool pose.

    Returns the path and the failures from the starts before, the scene's first.

    Raises
    ------
    PathNotFound
        As from the scene's posture, when none of the nearest ``other_starts`` others leads to the end.
    """
    report = partial(request.reporter.part, "following the tool path")
    try:
        return follow_path(request, report=report), ()
    except PathNotFound as error:
        failures = [error]
    options = request.cell.options
    step = max(options.path_step_s, _COARSE_STEP_S)
    coarse = request.with_options(path_step_s=step)
    for start in self_motion_postures(request)[: options.other_starts]:
        if request.deadline.expired():
            break
        request.reporter.stage("path", failed_starts=len(failures))
        try:
            follow_path(coarse, start)
            return follow_path(request, start, report=report), tuple(failures)
        except PathNotFound as error:
            failures.append(error)
    raise no_start_left(failures) from failures[0]


def self_motion_postures(request: StrokeRequest) -> list[FloatArray]:
    """Return postures (n,) within the joint ranges that hold the task's start, the scene's nearest first.

    They lie on the curves that lead from the scene's posture along each direction of the null space, both
    ways; with a full pose and seven joints that is all of the self-motion connected with it. A curve ends at
    a joint's range, or where it comes back.
    """
    cell = request.cell
    posture, limits, task = request.first, cell.robot.limits, request.task.on_axis
    metric = cell.robot.metric
    directions = null_space(cell.postures, task, posture[None])[0]
    along = np.concatenate([directions, -directions])
    q = np.tile(posture, (len(along), 1))
    found: list[FloatArray] = []
    for step in range(1, _MAX_STEPS + 1):
        N = null_space(cell.postures, task, q)
        along = np.einsum("kai,kaj,kj->ki", N, *map(metric.coordinates, (N, along)))
        length = metric.lengths(along)[:, None]
        along /= np.maximum(length, 1e-6)
        q, follows = project_onto_task(
            cell.postures, task, q + _TRIAL_STEP * along, task.path.poses([0.0]), steps=50, tolerance=1e-12
        )
        follows &= length[:, 0] >= 1e-6
        follows &= limits.contain(q)
        if step > 2:
            follows &= metric.lengths(q - posture) >= _TRIAL_STEP
        q, along = q[follows], along[follows]
        if len(q) == 0:
            break
        if step % _TRIED_STRIDE == 0:
            found += list(q)
    return sorted(found, key=lambda q: float(metric.lengths(q - posture)))
