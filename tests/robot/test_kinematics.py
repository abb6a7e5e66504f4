"""Forward kinematics against the paper's table and poses, Jacobians against finite differences."""

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import check_derivative, finite_difference
from hypothesis import given, strategies as st
from oracles import chang2021_arm
from state_samples import StateSamples

from cmbot.robot import Chain, Dynamics, Kinematics, Postures, Robot, load_robot

ANGLES = st.lists(st.floats(-2.2, 2.2), min_size=7, max_size=7).map(np.array)


def test_tool_poses_are_the_papers(
    cmbot_robot: Robot, cmbot_kinematics: Kinematics, random_states: StateSamples
) -> None:
    """Chang 2021, Eqs. (1)-(3)."""
    q, _, _ = random_states(cmbot_robot, 20_000)
    p, R = cmbot_kinematics.tool_poses(q)
    p_hand, R_hand = chang2021_arm.tool_pose(q)
    # The arm reaches 3.8 m: 1e-13 is a few hundred roundings.
    np.testing.assert_allclose(p, p_hand, rtol=0, atol=1e-13)
    np.testing.assert_allclose(R, R_hand, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("angles_deg", "wrist"), [((0, -90, 90, 0, 0, 0, 0), (1.61, 0, 1.87)), ((0,) * 7, (2.61, 0, 0.87))]
)
def test_known_wrist_centres(
    cmbot_robot: Robot, angles_deg: tuple[float, ...], wrist: tuple[float, ...]
) -> None:
    model, data = cmbot_robot.model, cmbot_robot.model.createData()
    pin.framesForwardKinematics(model, data, np.deg2rad(angles_deg))
    X_WB, X_W7 = (data.oMf[model.getFrameId(name)] for name in ("arm_base", "link_7"))
    np.testing.assert_allclose(X_WB.actInv(X_W7.translation), wrist, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("angles_deg", "point", "axis"),
    [
        ((-10, -90, 90, 0, 10, 50, 0), (1.815, 0.780, -2.063), (0.766, 0, -0.643)),
        ((-45, -90, 90, -10, 10, -55, 0), (0.812, 1.372, -1.984), (-0.733, -0.532, -0.425)),
    ],
)
def test_tool_at_the_start_of_both_experiments(
    cmbot_kinematics: Kinematics, angles_deg: tuple[float, ...], point: object, axis: object
) -> None:
    X_WT = cmbot_kinematics.tool_pose(np.deg2rad(angles_deg))
    np.testing.assert_allclose(X_WT.translation, point, rtol=0, atol=5e-4)
    np.testing.assert_allclose(X_WT.rotation[:, 2], axis, rtol=0, atol=5e-4)


@given(q=ANGLES)
def test_tool_pose_and_jacobian(cmbot_kinematics: Kinematics, q: np.ndarray) -> None:
    """Chang 2021, Eq. (15), also at singular postures."""
    X_WT = cmbot_kinematics.tool_pose(q)
    np.testing.assert_allclose(X_WT.rotation @ X_WT.rotation.T, np.eye(3), rtol=0, atol=1e-14)
    p, R = cmbot_kinematics.tool_poses(q[None])
    np.testing.assert_array_equal(p[0], X_WT.translation)
    np.testing.assert_array_equal(R[0], X_WT.rotation)
    beside, J = cmbot_kinematics.tool_jacobian(q)
    np.testing.assert_allclose(beside.homogeneous, X_WT.homogeneous, rtol=0, atol=1e-14)
    check_derivative(lambda x: cmbot_kinematics.tool_pose(x).translation, q, J[:3], rtol=1e-10)
    # dR = S(omega) R, and the angular velocity stands in S.
    dR = finite_difference(lambda x: cmbot_kinematics.tool_pose(x).rotation, q)
    S = np.einsum("abi,cb->aci", dR, X_WT.rotation)
    np.testing.assert_allclose(J[3:], [S[2, 1], S[0, 2], S[1, 0]], rtol=0, atol=1e-10)


@given(q=ANGLES)
def test_centre_of_mass_is_the_moving_arms(cmbot_kinematics: Kinematics, q: np.ndarray) -> None:
    centre, J = cmbot_kinematics.centre_of_mass(q)
    np.testing.assert_allclose(centre, chang2021_arm.centre_of_mass(q[None])[0], rtol=0, atol=1e-13)
    check_derivative(lambda x: cmbot_kinematics.centre_of_mass(x)[0], q, J, rtol=1e-10)


def test_results_do_not_alias_working_memory(cmbot_kinematics: Kinematics) -> None:
    q = np.linspace(-1, 1, 7)
    methods = (cmbot_kinematics.tool_pose, cmbot_kinematics.tool_jacobian, cmbot_kinematics.centre_of_mass)
    X_WT, (beside, J), (centre, J_c) = (method(q) for method in methods)
    kept = [array.copy() for array in (X_WT.homogeneous, beside.homogeneous, J, centre, J_c)]
    for method in methods:
        method(-q)
    now = (X_WT.homogeneous, beside.homogeneous, J, centre, J_c)
    for array, copy in zip(now, kept, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_no_posture_exceeds_the_reach(
    cmbot_robot: Robot, cmbot_kinematics: Kinematics, random_states: StateSamples
) -> None:
    q, *_ = random_states(cmbot_robot, 200)
    distances = np.linalg.norm(cmbot_kinematics.tool_poses(q)[0] - cmbot_robot.base_point, axis=1)
    assert 0.5 * cmbot_robot.reach < distances.max() <= cmbot_robot.reach


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
    for q_k, J_k in zip(q[:5], J, strict=False):
        check_derivative(lambda x: kinematics.tool_pose(x).translation, q_k, J_k, rtol=1e-9)


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
            slides = any_arm.limits.prismatic[joint - 1]
            along = J[:3, joint - 1] if slides else J[3:, joint - 1]
            np.testing.assert_allclose(axis[:, k], along, rtol=0, atol=1e-13)
            expected = vectors[joint - 1] @ X.rotation.T
            np.testing.assert_allclose(turned[:, :, k], expected, rtol=0, atol=1e-13)
