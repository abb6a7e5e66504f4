"""Many states in one call against pinocchio, one state at a time: its fixed and its free-flying arm."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from conftest import StateSamples
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from seven_joint_arms import endless_scene, panda_scene

from cmbot.planning import robot_of
from cmbot.robot import Chain, Dynamics, Kinematics, Robot, load_robot

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module", params=["cmbot", "panda", "endless"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """The shipped arm with a load, a Panda, and one with endless joints; the last two on a mount."""
    folder = tmp_path_factory.mktemp(request.param)
    match request.param:
        case "panda":
            return robot_of(panda_scene(folder))
        case "endless":
            return robot_of(endless_scene(folder))
        case _:
            return load_robot(payload=3.0)


states = st.tuples(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 2, 9]),
    st.sampled_from([0.0, 0.3, 4.0]),
    st.sampled_from([0.0, 1.0, 30.0]),
)


def drawn(robot: Robot, seed: int, number: int, rate: float, push: float) -> tuple[FloatArray, ...]:
    rng = np.random.default_rng(seed)
    scales = (np.pi, rate, push)
    return tuple(scale * rng.uniform(-1, 1, (number, robot.dof)) for scale in scales)


def free_flying(robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray) -> tuple[FloatArray, ...]:
    """Wrench of the base on the arm and joint torques (N, 6 + n), and their derivatives (N, 6 + n, n)."""
    model, data = robot.floating_model, robot.floating_model.createData()
    rows: list[tuple[FloatArray, ...]] = []
    for k in range(len(q)):
        still = np.zeros(6)
        parts = pin.computeRNEADerivatives(
            model,
            data,
            np.concatenate([still, [1.0], q[k]]),
            np.concatenate([still, v[k]]),
            np.concatenate([still, a[k]]),
        )
        rows.append((data.tau.copy(), *(part[:, 6:].copy() for part in parts)))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def same(got: FloatArray, expected: FloatArray) -> None:
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-10 * max(1.0, np.abs(expected).max()))


@settings(max_examples=20)
@given(drawn_from=states)
def test_efforts_are_those_of_the_arm_at_each_state(
    arm: Robot, drawn_from: tuple[int, int, float, float]
) -> None:
    q, v, a = drawn(arm, *drawn_from)
    got = Dynamics(arm).efforts(q, v, a)
    data = arm.model.createData()
    for k in range(len(q)):
        same(got.joint_torque[k], pin.rnea(arm.model, data, q[k], v[k], a[k]))
        # What the base exerts on the first joint's subtree, moved to W.
        wrench = data.liMi[1].act(data.f[1])
        same(got.guardrail_force[k], -wrench.linear)
        same(got.guardrail_torque[k], -wrench.angular)


@settings(max_examples=20)
@given(drawn_from=states)
def test_derivatives_are_those_of_the_free_flying_arm(
    arm: Robot, drawn_from: tuple[int, int, float, float]
) -> None:
    q, v, a = drawn(arm, *drawn_from)
    value, d_q, d_v, d_a = free_flying(arm, q, v, a)
    wrench, efforts = Dynamics(arm).wrench_derivatives(q, v, a), Dynamics(arm).derivatives(q, v, a)
    for name, expected in {"value": value, "d_q": d_q, "d_v": d_v, "d_a": d_a}.items():
        same(getattr(wrench, name), -expected[:, :6])
        same(getattr(efforts, name)[:, :3], -expected[:, 3:6])
        same(getattr(efforts, name)[:, 3:], expected[:, 6:])


def test_results_are_nobodys_working_memory(arm: Robot) -> None:
    dynamics = Dynamics(arm)
    first = drawn(arm, 1, 3, 1.0, 1.0)
    efforts, wrench = dynamics.efforts(*first), dynamics.wrench_derivatives(*first)
    kept = [array.copy() for array in (efforts.joint_torque, wrench.value, wrench.d_q, wrench.d_a)]
    dynamics.efforts(*drawn(arm, 2, 3, 1.0, 1.0))
    dynamics.wrench_derivatives(*drawn(arm, 2, 3, 1.0, 1.0))
    now = (efforts.joint_torque, wrench.value, wrench.d_q, wrench.d_a)
    for array, copy in zip(now, kept, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("number", [0, 3, 700])
def test_tool_poses_and_jacobians_are_those_of_each_posture(
    arm: Robot, random_states: StateSamples, number: int
) -> None:
    q, kinematics = random_states(arm, number)[0], Kinematics(arm)
    points, rotations = kinematics.tool_poses(q)
    again, J = kinematics.tool_point_jacobians(q)
    assert (points.shape, rotations.shape, J.shape) == ((number, 3), (number, 3, 3), (number, 3, arm.dof))
    for k in range(number):
        X_WT, J_k = kinematics.tool_jacobian(q[k])
        np.testing.assert_allclose(points[k], X_WT.translation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(rotations[k], X_WT.rotation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(again[k], X_WT.translation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(J[k], J_k[:3], rtol=0, atol=1e-13)


def test_a_chain_carries_its_vectors(
    arm: Robot, random_states: StateSamples, rng: np.random.Generator
) -> None:
    """Another number of them on every joint, none on some."""
    model, data = arm.model, arm.model.createData()
    vectors = [rng.normal(size=(k % 3, 3)) for k in range(arm.dof)]
    q = random_states(arm, 20)[0]
    walked = list(Chain(model, vectors).walk(q.T))
    assert len(walked) == arm.dof
    for k, q_k in enumerate(q):
        J = pin.computeJointJacobians(model, data, q_k)
        for joint, (origin, axis, turned) in enumerate(walked, start=1):
            X = data.oMi[joint]
            np.testing.assert_allclose(origin[:, k], X.translation, rtol=0, atol=1e-13)
            np.testing.assert_allclose(axis[:, k], J[3:, joint - 1], rtol=0, atol=1e-13)
            expected = vectors[joint - 1] @ X.rotation.T
            np.testing.assert_allclose(turned[:, :, k], expected, rtol=0, atol=1e-13)
