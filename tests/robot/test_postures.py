"""Many postures in one call: the same as pinocchio, one at a time."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from conftest import StateSamples
from finite_differences import check_derivative

from cmbot.robot import Chain, Dynamics, Kinematics, Postures, Robot, load_robot


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


@pytest.mark.parametrize("number", [0, 3, 700])
def test_tool_poses_and_jacobians_are_those_of_each_posture(
    any_arm: Robot, random_states: StateSamples, number: int
) -> None:
    q, kinematics = random_states(any_arm, number)[0], Kinematics(any_arm)
    points, rotations = kinematics.tool_poses(q)
    again, J = kinematics.tool_point_jacobians(q)
    assert (points.shape, rotations.shape, J.shape) == ((number, 3), (number, 3, 3), (number, 3, any_arm.dof))
    for k in range(number):
        X_WT, J_k = kinematics.tool_jacobian(q[k])
        np.testing.assert_allclose(points[k], X_WT.translation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(rotations[k], X_WT.rotation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(again[k], X_WT.translation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(J[k], J_k[:3], rtol=0, atol=1e-13)


def test_a_chain_carries_its_vectors(
    any_arm: Robot, random_states: StateSamples, rng: np.random.Generator
) -> None:
    """Another number of them on every joint, none on some."""
    model, data = any_arm.model, any_arm.model.createData()
    vectors = [rng.normal(size=(k % 3, 3)) for k in range(any_arm.dof)]
    q = random_states(any_arm, 20)[0]
    walked = list(Chain(model, vectors).walk(q.T))
    assert len(walked) == any_arm.dof
    for k, q_k in enumerate(q):
        J = pin.computeJointJacobians(model, data, q_k)
        for joint, (origin, axis, turned) in enumerate(walked, start=1):
            X = data.oMi[joint]
            np.testing.assert_allclose(origin[:, k], X.translation, rtol=0, atol=1e-13)
            np.testing.assert_allclose(axis[:, k], J[3:, joint - 1], rtol=0, atol=1e-13)
            expected = vectors[joint - 1] @ X.rotation.T
            np.testing.assert_allclose(turned[:, :, k], expected, rtol=0, atol=1e-13)
