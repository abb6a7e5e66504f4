"""What the replay page needs of a plan's motions (approach, work, baseline), at equal time steps."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from cmbot.planning import MotionFigures, Plan, Samples
from cmbot.planning.figures import figures, measure
from cmbot.robot import Robot
from cmbot.scene.clearance import Clearances

__all__ = ["link_names", "replay_data"]

FloatArray = NDArray[np.float64]

FRAME_STEP = 0.02
"""Between two frames, s, unless that gives too many; the page interpolates."""

MOST_POSES = 12_000
"""Frames times links, approach and work together."""


def replay_data(plan: Plan) -> dict[str, Any]:
    """Return the page's data, ready for JSON; arrays are little-endian float32 in base64.

    Poses are those of the arm's joint frames in W, as position (m) and quaternion x, y, z, w. The work starts
    at time 0, the approach at ``start`` before it.
    """
    duration = float(max(plan.samples.t[-1], plan.baseline.t[-1]))
    approach_duration = plan.approach.trajectory.duration if plan.approach is not None else 0.0
    step = max(FRAME_STEP, (approach_duration + duration) * plan.robot.dof / MOST_POSES)
    times = _frame_times(0.0, duration, step)
    return {
        "title": plan.scene.name,
        "robot": plan.robot.name,
        "start": 0.0 - approach_duration,
        "duration": duration,
        "legTimes": plan.task.path.leg_times.tolist(),
        "floor": plan.torque_floor,
        "links": link_names(plan.robot),
        "approach": _approach(plan, step),
        "planned": _motion(plan.robot, plan.samples, plan.figures, times),
        "baseline": _motion(plan.robot, plan.baseline, plan.baseline_figures, times),
        "focus": _focus(plan),
    }


def link_names(robot: Robot) -> list[str]:
    """Return the name of the link that each joint of the arm moves: its frame is the joint's."""
    bodies = [frame for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
    return [
        next((frame.name for frame in bodies if frame.parentJoint == joint), robot.model.names[joint])
        for joint in range(1, robot.model.njoints)
    ]


def _approach(plan: Plan, step: float) -> dict[str, Any] | None:
    """Return the planned arm's approach; meanwhile the baseline's arm rests where it starts."""
    robot, approach, planned = plan.robot, plan.approach, plan.approach_samples
    if approach is None or planned is None:
        return None
    t = _frame_times(0.0, approach.trajectory.duration, step)
    ends = t[[0, -1]]
    posture = np.repeat(plan.baseline.q[:1], 2, axis=0)
    rest = [posture, *np.zeros((3, *posture.shape))]
    baseline = measure(robot, plan.task, Clearances(robot, plan.scene.obstacles), ends, rest)
    return {
        "label": "approach along the self-motion" if approach.along_self_motion else "approach, tool off",
        "planned": _motion(robot, planned, approach.certificate.figures, t),
        "baseline": _motion(robot, baseline, figures(robot, baseline), ends),
    }


def _frame_times(start: float, end: float, step: float) -> FloatArray:
    return np.linspace(start, end, int(np.ceil((end - start) / step)) + 1)


def _motion(robot: Robot, samples: Samples, figures: MotionFigures, times: FloatArray) -> dict[str, Any]:
    q = _resampled(times, samples.t, samples.q)
    return {
        "poses": _packed(_poses(robot, q)),
        "torque": _packed(_resampled(times, samples.t, samples.guardrail_torque)),
        "clearance": _packed(np.interp(times, samples.t, samples.clearance)),
        "peakTorque": figures.peak_guardrail_torque,
        "minClearance": figures.min_clearance,
    }


def _resampled(times: FloatArray, t: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(times, t, column) for column in values.T], axis=1)


def _poses(robot: Robot, q: FloatArray) -> FloatArray:
    """Poses (N, n, 7) of the joint frames in W at postures `q` (N, n)."""
    data = robot.model.createData()
    poses = np.empty((*q.shape, 7))
    for k, q_k in enumerate(q):
        pin.forwardKinematics(robot.model, data, q_k)
        for joint in range(1, robot.model.njoints):
            poses[k, joint - 1] = pin.SE3ToXYZQUAT(data.oMi[joint])
    return poses


def _focus(plan: Plan) -> dict[str, Any]:
    """Return a ball (m, in W) about the foot, the path and the arm's joints, and from where to look at it."""
    points = [np.zeros((1, 3)), plan.task.path.corners]
    motions = [plan.samples.q, plan.baseline.q]
    if plan.approach is not None:
        motions.append(plan.approach.trajectory.q)
    points += [motion.tool_point for motion in (plan.samples, plan.baseline)]
    points += [_poses(plan.robot, q[:: max(1, len(q) // 50)])[..., :3] for q in motions]
    cloud = np.concatenate([block.reshape(-1, 3) for block in points])
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    radius = max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    return {"centre": ((low + high) / 2).tolist(), "radius": radius, "azimuth": _azimuth(plan)}


def _azimuth(plan: Plan) -> float:
    """Return where a spectator stands about z of W: outside the guardrail, at 45 deg to the stretched arm.

    The torque of a weight is at right angles to the arm, so both are seen.
    """
    x, y, _ = plan.samples.tool_point.mean(axis=0)
    arm = np.arctan2(y, x)
    outside = np.pi / 2
    return float(min((arm - np.pi / 4, arm + np.pi / 4), key=lambda angle: abs(angle - outside)))


def _packed(array: FloatArray) -> str:
    return base64.b64encode(array.astype("<f4").tobytes()).decode("ascii")
