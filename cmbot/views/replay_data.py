"""What the pages need of a plan's motions (approach, work, baseline), at equal time steps."""

from __future__ import annotations

import base64
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.collision.clearance import Clearances
from cmbot.common.arguments import require_type
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.planning import Plan, Samples
from cmbot.planning.verification.metrics import figures, measure
from cmbot.robot import Robot
from cmbot.simulation import MotionTracking, Tracking
from cmbot.views.frames import Frames, frame_times, poses_of, resampled
from cmbot.views.meshcat_scene import reach, scene_commands

__all__ = ["link_names", "replay_data"]

FRAME_STEP = 0.02
"""Between two frames, s, unless that gives too many; the page interpolates."""

MOST_POSES = 12_000
"""Frames times links, approach and work together."""


def replay_data(plan: Plan, tracking: Tracking | None = None) -> dict[str, Any]:
    """Return the page's data, ready for JSON; `Frames.motion` says what there is of each motion.

    The work starts at time 0, the approach at ``start`` before it; with `tracking` the arms rest after the
    work until ``end``.

    Raises
    ------
    InputError
        When `tracking` is none, or that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    duration = float(max(plan.samples.t[-1], plan.baseline.t[-1]))
    approach_duration = plan.approach.trajectory.duration if plan.approach is not None else 0.0
    if tracking is not None:
        require_type(tracking, Tracking, "tracking", "", "a Tracking, as cmbot.simulate returns it")
    end = duration if tracking is None else _end(tracking, duration)
    step = max(FRAME_STEP, (approach_duration + end) * plan.robot.dof / MOST_POSES)
    clearances = Clearances(plan.robot, plan.scene.obstacles)
    frames = Frames(plan.robot, clearances, plan.options.avoidance_distance_m)
    return {
        "title": plan.scene.name,
        "robot": plan.robot.name,
        "start": 0.0 - approach_duration,
        "duration": duration,
        "end": end,
        "legTimes": plan.task.path.leg_times.tolist(),
        "floor": plan.torque_floor,
        "margin": plan.options.safety_margin_m,
        "links": link_names(plan.robot),
        "approach": _approach(plan, frames, clearances, step),
        **_work(plan, tracking, frames, frame_times(0.0, duration, step)),
        "rest": None if tracking is None else _rest(plan, tracking, frames, duration, end, step),
        "pairs": frames.pairs,
        "focus": _focus(plan),
        "reach": reach(plan.robot),
        "commands": [base64.b64encode(command).decode("ascii") for command in scene_commands(plan)],
    }


def link_names(robot: Robot) -> list[str]:
    """Return the name of the link that each joint of the arm moves: its frame is the joint's."""
    bodies = [frame for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
    return [
        next((frame.name for frame in bodies if frame.parentJoint == joint), robot.model.names[joint])
        for joint in range(1, robot.model.njoints)
    ]


def _end(tracking: Tracking, duration: float) -> float:
    for name, motion in (("planned", tracking.planned), ("baseline", tracking.baseline)):
        if not np.isclose(motion.stop, duration, rtol=1e-9, atol=0.0):
            expected = f"{duration:g} s, the plan's duration: the tracking errors of this plan"
            raise InputError("tracking", f"{name}.stop", f"{motion.stop:g} s", expected)
    return float(max(duration, tracking.planned.t[-1], tracking.baseline.t[-1]))


def _work(plan: Plan, tracking: Tracking | None, frames: Frames, times: FloatArray) -> dict[str, Any]:
    planned, baseline = (None, None) if tracking is None else (tracking.planned, tracking.baseline)
    return {
        "planned": frames.motion(plan.samples, plan.figures, times, _error(planned, times)),
        "baseline": frames.motion(plan.baseline, plan.baseline_figures, times, _error(baseline, times)),
    }


def _approach(plan: Plan, frames: Frames, clearances: Clearances, step: float) -> dict[str, Any] | None:
    """Return the planned arm's approach; meanwhile the baseline's arm rests where it starts."""
    robot, approach, planned = plan.robot, plan.approach, plan.approach_samples
    if approach is None or planned is None:
        return None
    t = frame_times(0.0, approach.trajectory.duration, step)
    ends = t[[0, -1]]
    posture = np.repeat(plan.baseline.q[:1], 2, axis=0)
    still = [posture, *np.zeros((3, *posture.shape))]
    baseline = measure(robot, plan.task, clearances, ends, still)
    return {
        "label": "approach along the self-motion" if approach.along_self_motion else "approach, tool off",
        "planned": frames.motion(planned, approach.certificate.figures, t),
        "baseline": frames.motion(baseline, figures(robot, baseline), ends),
    }


def _rest(
    plan: Plan, tracking: Tracking, frames: Frames, duration: float, end: float, step: float
) -> dict[str, Any] | None:
    """Return both arms after the stop: their joints rest, what bends swings on."""
    if end <= duration:
        return None
    t = frame_times(duration, end, step)
    motions = {
        "planned": (plan.samples, plan.figures, tracking.planned),
        "baseline": (plan.baseline, plan.baseline_figures, tracking.baseline),
    }
    held = {
        name: frames.motion(_last(samples, t[[0, -1]]), of_it, t, _error(track, t))
        for name, (samples, of_it, track) in motions.items()
    }
    return {"label": "after the stop", **held}


def _last(samples: Samples, ends: FloatArray) -> Samples:
    """Return what a motion is at its end, at two times."""
    held = {
        field.name: np.repeat(value[-1:], 2, axis=0)
        for field in fields(Samples)
        if (value := getattr(samples, field.name)) is not None
    }
    return replace(samples, **{**held, "t": ends})


def _error(motion: MotionTracking | None, times: FloatArray) -> FloatArray | None:
    return None if motion is None else resampled(times, motion.t, motion.error)


def _focus(plan: Plan) -> dict[str, Any]:
    """Return a ball (m, in W) about the foot, the path and the arm's joints, and from where to look at it."""
    points = [np.zeros((1, 3)), plan.task.path.corners]
    motions = [plan.samples.q, plan.baseline.q]
    if plan.approach is not None:
        motions.append(plan.approach.trajectory.q)
    points += [motion.tool_point for motion in (plan.samples, plan.baseline)]
    points += [poses_of(plan.robot, q[:: max(1, len(q) // 50)])[..., :3] for q in motions]
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
