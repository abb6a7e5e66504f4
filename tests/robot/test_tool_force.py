"""The force on the tool: in joint torques, in the wrench on the guardrail, and in their derivatives."""

from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import check_derivative
from hypothesis import given, settings, strategies as st
from state_samples import FloatArray, StateSamples

from cmbot.robot import Dynamics, Kinematics, Postures, Robot

FORCE = (13.0, -27.0, -150.0)


def pushed(robot: Robot, force: FloatArray | tuple[float, ...] = FORCE) -> Robot:
    x, y, z = map(float, force)
    return replace(robot, tool_force=(x, y, z))


def loaded(robot: Robot, mass: float) -> Robot:
    """A robot with another point mass at its tool."""
    model = robot.model.copy()
    tool = model.frames[model.getFrameId(robot.tool_frame)]
    point = pin.Inertia(mass, tool.placement.translation, np.zeros((3, 3)))
    model.appendBodyToJoint(tool.parentJoint, point, pin.SE3.Identity())
    return replace(robot, model=model)


def rows(dynamics: Dynamics, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Force and torque on the guardrail, then joint torques, of one state."""
    at = dynamics.efforts(q[None], v[None], a[None])
    return np.concatenate([at.guardrail_force[0], at.guardrail_torque[0], at.joint_torque[0]])


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), mass=st.floats(0.1, 30))
def test_a_force_straight_down_is_a_weight_at_the_tool(any_arm: Robot, seed: int, mass: float) -> None:
    q = np.random.default_rng(seed).uniform(-2, 2, any_arm.dof)
    R_WT = Kinematics(any_arm).tool_pose(q).rotation
    weight = pushed(any_arm, R_WT.T @ [0, 0, -9.81 * mass])
    with_load = loaded(any_arm, mass)
    for by in (Dynamics(weight).static_efforts(q[None]), Postures(weight).at(q[None])):
        expected = Dynamics(with_load).static_efforts(q[None])
        for name, value in vars(expected).items():
            scale = 1 + np.abs(value).max()
            np.testing.assert_allclose(getattr(by, name), value, rtol=0, atol=1e-11 * scale)


def test_efforts_are_those_of_an_external_force(any_arm: Robot, random_states: StateSamples) -> None:
    """pinocchio's recursion with the force on the last body, the base held on a free-flyer."""
    robot = pushed(any_arm)
    states = random_states(robot, 20)
    model = robot.floating_model
    tool = model.frames[model.getFrameId(robot.tool_frame)]
    external = [pin.Force.Zero()] * model.njoints
    external[tool.parentJoint] = tool.placement.act(pin.Force(np.array(FORCE), np.zeros(3)))
    for q, v, a in zip(*states, strict=True):
        still = np.zeros(6)
        tau = pin.rnea(
            model,
            model.createData(),
            np.concatenate([still, [1.0], q]),
            np.concatenate([still, v]),
            np.concatenate([still, a]),
            external,
        )
        expected = np.concatenate([-tau[:6], tau[6:]])
        got = rows(Dynamics(robot), q, v, a)
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_derivatives_turn_the_force_with_the_tool(any_arm: Robot, random_states: StateSamples) -> None:
    dynamics = Dynamics(pushed(any_arm))
    q, v, a = random_states(any_arm, 6)
    wrench, torques = dynamics.wrench_derivatives(q, v, a), dynamics.derivatives(q, v, a)
    for k in range(len(q)):
        expected = rows(dynamics, q[k], v[k], a[k])
        for got, part in ((wrench, slice(0, 6)), (torques, slice(3, None))):
            np.testing.assert_allclose(got.value[k], expected[part], rtol=1e-10, atol=1e-9)

            def value(x: FloatArray, k: int = k, part: slice = part) -> FloatArray:
                return rows(dynamics, x, v[k], a[k])[part]

            check_derivative(value, q[k], got.d_q[k], rtol=1e-8)


def test_without_a_force_nothing_is_pushed(cmbot_robot: Robot, random_states: StateSamples) -> None:
    on, off = pushed(cmbot_robot), pushed(cmbot_robot).tool_off
    assert (on.pushed, off.pushed, cmbot_robot.pushed) == (True, False, False)
    assert on.tool_off is on.tool_off
    assert cmbot_robot.tool_off is cmbot_robot
    states = random_states(cmbot_robot, 5)
    got, expected = (Dynamics(robot).efforts(*states) for robot in (off, cmbot_robot))
    for name, value in vars(expected).items():
        np.testing.assert_array_equal(getattr(got, name), value)


def test_velocity_of_the_tool_point(any_arm: Robot, random_states: StateSamples) -> None:
    q, v, _ = random_states(any_arm, 5)
    postures = Postures(any_arm)
    velocity, d_q = postures.tool_at(q).point_velocity(v)
    for k in range(len(q)):

        def point(t: FloatArray, k: int = k) -> FloatArray:
            return postures.tool_at(q[k : k + 1] + t * v[k]).tool_point[0]

        check_derivative(point, [0.0], velocity[k][:, None], rtol=1e-8, step=1e-4)
        moved = partial(lambda x, k: postures.tool_at(x[None]).point_velocity(v[k : k + 1])[0][0], k=k)
        check_derivative(moved, q[k], d_q[k], rtol=1e-8)


@pytest.mark.parametrize("number", [1, 700])
def test_any_number_of_postures(cmbot_robot: Robot, random_states: StateSamples, number: int) -> None:
    robot = pushed(cmbot_robot)
    q = random_states(robot, number)[0]
    static, at = Dynamics(robot).static_efforts(q), Postures(robot).at(q)
    for name, value in vars(static).items():
        np.testing.assert_allclose(getattr(at, name), value, rtol=0, atol=1e-9)
