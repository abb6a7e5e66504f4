"""The shipped arm on the shipped guardrail, and a motion for it that needs no planning."""

import numpy as np
import pinocchio as pin

from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, ElasticOptions, elastic_arm
from cmbot.robot import Robot
from cmbot.scene import load_scene
from cmbot.simulation import PrescribedMotion


def arm_on_its_guardrail(robot: Robot, segments: int = 1) -> ElasticArm:
    return elastic_arm(
        robot, elastic_base(load_scene("triangle").guardrail), ElasticOptions(segments=segments)
    )


def swing(seconds: float, size: float = 0.15) -> PrescribedMotion:
    """All joints out from the triangle's posture and back, from rest to rest."""
    t = np.linspace(0.0, seconds, 81)
    ways = np.sin(np.pi * t / seconds)[:, None] ** 2 * np.cos(np.arange(7) + t[:, None])
    return PrescribedMotion.through(t, np.array(load_scene("triangle").posture) + size * (ways - ways[0]))


def tool_points(arm: ElasticArm, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Tool of the bent arm, (N, 3), m."""
    data, points = arm.model.createData(), np.empty((len(q), 3))
    for k, configuration in enumerate(arm.configuration(q, u)):
        pin.forwardKinematics(arm.model, data, configuration)
        points[k] = pin.updateFramePlacement(arm.model, data, arm.tool_frame_id).translation
    return points
