"""The shipped arm on the shipped guardrail, and a motion for it that needs no planning."""

import numpy as np
import pinocchio as pin

from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, ElasticOptions, elastic_arm
from cmbot.elastic.sag import Sag
from cmbot.planning import ToolTask
from cmbot.robot import Robot
from cmbot.scene import load_scene
from cmbot.simulation import PrescribedWork, SimulationOptions, track_work
from cmbot.simulation.tracking import MotionTracking
from cmbot.trajectory import QuinticTrajectory


def arm_on_its_guardrail(robot: Robot, segments: int = 1) -> ElasticArm:
    return elastic_arm(
        robot, elastic_base(load_scene("triangle").elastic_guardrail), ElasticOptions(segments=segments)
    )


def swing(seconds: float, size: float = 0.15) -> QuinticTrajectory:
    """All joints out from the triangle's posture and back, from rest to rest."""
    t = np.linspace(0.0, seconds, 81)
    ways = np.sin(np.pi * t / seconds)[:, None] ** 2 * np.cos(np.arange(7) + t[:, None])
    return QuinticTrajectory.through(t, np.array(load_scene("triangle").posture) + size * (ways - ways[0]))


def track(
    arm: ElasticArm,
    task: ToolTask,
    motion: QuinticTrajectory,
    options: SimulationOptions,
    sag: Sag | None = None,
) -> MotionTracking:
    """Simulate an elastic arm under one motion along a task's path."""
    return track_work(arm, PrescribedWork.of([(motion, task.path)]), options, sag=sag)


def tool_points(arm: ElasticArm, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Tool of the bent arm, (N, 3), m."""
    data, points = arm.model.createData(), np.empty((len(q), 3))
    for k, configuration in enumerate(arm.configuration(q, u)):
        pin.forwardKinematics(arm.model, data, configuration)
        points[k] = pin.updateFramePlacement(arm.model, data, arm.tool_frame_id).translation
    return points


def wild(seed: int, joints: int = 2, knots: int = 6) -> QuinticTrajectory:
    """Random knots: several radians, and rates to match, between them."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.2, 2.0, knots))
    q, v, a = (scale * rng.normal(size=(knots, joints)) for scale in (1.5, 1.0, 1.0))
    return QuinticTrajectory(t=t - t[0], q=q, v=v, a=a)
