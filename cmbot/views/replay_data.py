"""What the replay page needs of a plan's two motions, at equal time steps."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from cmbot.planning import MotionFigures, Plan, Samples
from cmbot.robot import Robot

__all__ = ["link_names", "replay_data"]

FloatArray = NDArray[np.float64]

FRAME_STEP = 0.02
"""Between two frames, s, unless that gives too many; the page interpolates."""

MOST_POSES = 12_000
"""Frames times links."""


def replay_data(plan: Plan) -> dict[str, Any]:
    """Return the page's data, ready for JSON; arrays are little-endian float32 in base64.

    Poses are those of the arm's joint frames in W, as position (m) and quaternion x, y, z, w.
    """
    duration = float(max(plan.samples.t[-1], plan.baseline.t[-1]))
    frames = int(min(np.ceil(duration / FRAME_STEP), MOST_POSES // plan.robot.dof)) + 1
    times = np.linspace(0.0, duration, frames)
    return {
        "title": plan.scene.name,
        "robot": plan.robot.name,
        "duration": duration,
        "frames": frames,
        "legTimes": plan.task.path.leg_times.tolist(),
        "links": link_names(plan.robot),
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
    for motion in (plan.samples, plan.baseline):
        points += [motion.tool_point, _poses(plan.robot, motion.q[:: max(1, len(motion.q) // 50)])[..., :3]]
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
