"""Postures in one call: the same as pinocchio, one at a time."""

from __future__ import annotations

import numpy as np
from finite_differences import check_derivative

from cmbot.robot import Dynamics, Kinematics, Postures, Robot, load_robot


def test_a_batch_equals_pinocchio(rng: np.random.Generator) -> None:
    robot = load_robot(payload=3.0, tool_length=0.4)
    q = rng.uniform(-3, 3, (200, robot.dof))
    batch, kinematics = Postures(robot).at(q), Kinematics(robot)
    efforts = Dynamics(robot).static_efforts(q)
    np.testing.assert_allclose(batch.guardrail_torque, efforts.guardrail_torque, atol=1e-11)
    np.testing.assert_allclose(batch.joint_torque, efforts.joint_torque, atol=1e-11)
    for k, q_k in enumerate(q):
        X_WT, J = kinematics.tool_jacobian(q_k)
        np.testing.assert_allclose(batch.tool_point[k], X_WT.translation, atol=1e-13)
        np.testing.assert_allclose(batch.tool_rotation[k], X_WT.rotation, atol=1e-13)
        np.testing.assert_allclose(batch.jacobian[k], J, atol=1e-13)


def test_the_torques_derivative(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    postures = Postures(cmbot_robot)
    for q in rng.uniform(-3, 3, (5, cmbot_robot.dof)):
        check_derivative(
            lambda x: postures.at(x[None]).guardrail_torque[0],
            q,
            postures.at(q[None]).guardrail_torque_derivative[0],
            step=1e-3,
            rtol=1e-8,
            atol=1e-6,
        )
