"""A tool that stands in W, seen from the part that the arm holds: kinematics, bounds, bending."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import check_derivative, finite_difference
from state_samples import StateSamples

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.base import ElasticBase
from cmbot.elastic.sag import Sag
from cmbot.robot import Kinematics, Postures, Robot

TOOL = pin.SE3(pin.exp3(np.array([0.4, -1.1, 2.0])), np.array([0.9, -0.4, 0.7]))


def seen(model: Any, frame: int, q: FloatArray, tool: Any = TOOL) -> FloatArray:
    """Pose (4, 4) of the tool in a frame of a model, by a product of homogeneous matrices."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return np.linalg.inv(data.oMf[frame].homogeneous) @ tool.homogeneous


def test_pose_and_jacobian_are_those_seen_from_the_part(any_arm: Robot, random_states: StateSamples) -> None:
    robot = replace(any_arm, fixed_tool=TOOL)
    kinematics, (q, v, _) = Kinematics(robot), random_states(robot, 80)
    every = np.array([seen(robot.model, robot.tool_frame_id, each) for each in q])
    # One by one, and from a batch.
    for some in (slice(None), slice(3)):
        p, R = kinematics.tool_poses(q[some])
        np.testing.assert_allclose(p, every[some, :3, 3], atol=1e-12)
        np.testing.assert_allclose(R, every[some, :3, :3], atol=1e-12)
    batch = Postures(robot).at(q)
    velocity, by_q = batch.point_velocity(v)
    for k in range(3):
        _, J = kinematics.tool_jacobian(q[k])
        np.testing.assert_allclose(batch.jacobian[k], J, atol=1e-12)
        check_derivative(lambda x: kinematics.tool_pose(x).translation, q[k], J[:3], rtol=1e-9)
        dR = finite_difference(lambda x: kinematics.tool_pose(x).rotation, q[k])
        S = np.einsum("abi,cb->aci", dR, every[k, :3, :3])
        np.testing.assert_allclose(J[3:], [S[2, 1], S[0, 2], S[1, 0]], atol=1e-9)
        np.testing.assert_allclose(velocity[k], J[:3] @ v[k], atol=1e-10)
        check_derivative(lambda x: kinematics.tool_jacobian(x)[1][:3] @ v[k], q[k], by_q[k], rtol=1e-8)  # noqa: B023
        assert (
            np.linalg.norm(J[:3], axis=0) <= np.where(robot.limits.prismatic, 1.0, robot.levers) + 1e-9
        ).all()


def test_a_step_misses_its_prediction_by_no_more_than_the_bend(
    any_arm: Robot, random_states: StateSamples, rng: np.random.Generator
) -> None:
    robot = replace(any_arm, fixed_tool=TOOL)
    postures, (q, _, _) = Postures(robot), random_states(robot, 200)
    step = rng.uniform(-0.05, 0.05, q.shape)
    at, moved = postures.tool_at(q), postures.tool_at(q + step)
    predicted = at.tool_point + np.einsum("kij,kj->ki", at.jacobian[:, :3], step)
    total = np.abs(postures.metric.coordinates(step)).sum(axis=1)
    assert (np.linalg.norm(moved.tool_point - predicted, axis=1) <= postures.bend * total**2).all()
    # Sample caches tell arms by that.
    assert postures.geometry != Postures(any_arm).geometry


def test_points_of_the_part_lie_in_the_world_where_it_is(
    cmbot_robot: Robot, random_states: StateSamples
) -> None:
    """The tool's own point is at the tool in every posture; without a fixed tool nothing is moved."""
    robot, (q, _, _) = replace(cmbot_robot, fixed_tool=TOOL), random_states(cmbot_robot, 5)
    kinematics = Kinematics(robot)
    points = kinematics.in_world(q, kinematics.tool_poses(q)[0])
    np.testing.assert_allclose(points, np.tile(TOOL.translation, (5, 1)), atol=1e-12)
    assert Kinematics(cmbot_robot).in_world(q, points) is points


@pytest.fixture
def bent_arm(cmbot_robot: Robot) -> Any:
    """The shipped arm, whose tubes bend, on a base that gives way."""
    stiffness, none = np.diag([4e5, 3e5, 5e5, 2e4, 3e4, 1e4]), np.zeros((6, 6))
    base = ElasticBase(stiffness=stiffness, mass=none, damping=none)
    return elastic_arm(replace(cmbot_robot, fixed_tool=TOOL), base)


def test_sag_is_that_of_the_point_at_the_tool(bent_arm: Any, random_states: StateSamples) -> None:
    """From the equilibrium's poses, with the part's turn; and its derivative."""
    sag, robot = Sag(bent_arm), bent_arm.robot
    q = random_states(robot, 4)[0]
    states = sag.at(q)
    for k in range(4):
        bent = seen(bent_arm.model, bent_arm.tool_frame_id, bent_arm.configuration(q[k], states.u[k]))
        rigid = seen(robot.model, robot.tool_frame_id, q[k])
        np.testing.assert_allclose(states.tool[k], (bent - rigid)[:3, 3], atol=1e-12)
    check_derivative(lambda x: sag.at(x[None]).tool[0], q[0], states.d_tool[0], rtol=1e-6)
    np.testing.assert_allclose(sag.following(q[:1]), states.tool[:1], atol=1e-9)
    away = np.linalg.norm(Sag(elastic_arm(replace(robot, fixed_tool=None), bent_arm.base)).at(q).tool, axis=1)
    assert (np.abs(np.linalg.norm(states.tool, axis=1) - away) > 1e-4).any()
