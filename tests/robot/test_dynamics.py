"""Joint torques and guardrail wrench against the paper's recursion, mechanics and finite differences."""

import dataclasses
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import check_derivative, finite_difference
from hypothesis import given, settings, strategies as st
from oracles import chang2021_arm
from state_samples import FloatArray, StateSamples

from cmbot.robot import Dynamics, Kinematics, Robot, load_robot

GRAVITY = 9.81


def weight(mass: float) -> FloatArray:
    return np.array([0.0, 0.0, -mass * GRAVITY])


def motion(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A smooth motion of period 2 pi, all joints: q, v, a (N, 7)."""
    centre, size = np.deg2rad([-10, -90, 90, 0, 10, 50, 0]), np.array([0.5, 0.3, 0.4, 0.6, 0.5, 0.4, 0.3])
    times, phase = np.array([1, 1, 2, 1, 3, 2, 1]), np.arange(7)
    angle = np.multiply.outer(t, times) + phase
    return centre + size * np.sin(angle), size * times * np.cos(angle), -size * times**2 * np.sin(angle)


def with_gravity(robot: Robot, gravity: FloatArray) -> Robot:
    model = robot.model.copy()
    model.gravity = pin.Motion(gravity, np.zeros(3))
    return dataclasses.replace(robot, model=model)


@pytest.fixture
def cmbot_states(cmbot_robot: Robot, random_states: StateSamples) -> StateSamples:
    return partial(random_states, cmbot_robot)


def test_efforts_are_the_papers_recursion(cmbot_dynamics: Dynamics, cmbot_states: StateSamples) -> None:
    q, v, a = cmbot_states(100_000)
    tau, n_0, f_0 = chang2021_arm.efforts(q, v, a)
    got = cmbot_dynamics.efforts(q, v, a)
    # A single component may cancel to nearly nothing, so errors count against the state's own largest torque
    # and force. Rounding accounts for about 1e-14 of it.
    torque_scale = np.maximum(np.abs(tau).max(axis=1), np.abs(n_0).max(axis=1))
    force_scale = np.abs(f_0).max(axis=1)
    assert np.abs(got.joint_torque - tau).max(axis=1) / torque_scale == pytest.approx(0, abs=1e-10)
    assert np.abs(got.guardrail_torque + n_0).max(axis=1) / torque_scale == pytest.approx(0, abs=1e-10)
    assert np.abs(got.guardrail_force + f_0).max(axis=1) / force_scale == pytest.approx(0, abs=1e-10)


def test_power_of_the_joints_is_the_change_of_energy(cmbot_robot: Robot, cmbot_dynamics: Dynamics) -> None:
    model, data = cmbot_robot.model, cmbot_robot.model.createData()
    t = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    q, v, a = motion(t)
    power = (cmbot_dynamics.efforts(q, v, a).joint_torque * v).sum(axis=1)

    def energy(at: FloatArray) -> float:
        q, v, _ = motion(at)
        return float(pin.computeMechanicalEnergy(model, data, q[0], v[0]))

    for at, expected in zip(t[::10, None], power[::10, None], strict=True):
        check_derivative(energy, at, expected, atol=1e-8 * np.abs(power).max())
    # Over the closed motion the work is zero. The rectangle rule is exact for a smooth periodic integrand.
    assert np.abs(power).mean() > 10
    assert power.mean() == pytest.approx(0, abs=1e-11 * np.abs(power).max())


def test_wrench_is_the_change_of_momentum(cmbot_robot: Robot, cmbot_dynamics: Dynamics) -> None:
    """Newton's and Euler's laws for the arm as a whole, about O0."""
    model, data = cmbot_robot.model, cmbot_robot.model.createData()

    def momentum(t: FloatArray) -> FloatArray:
        q, v, _ = motion(t)
        h = pin.computeCentroidalMomentum(model, data, q[0], v[0]).copy()
        return np.concatenate([h.linear, h.angular + np.cross(data.com[0], h.linear)])

    for t in np.linspace(0, 6, 13):
        q, v, a = motion(np.array([t]))
        got = cmbot_dynamics.efforts(q, v, a)
        centre = chang2021_arm.centre_of_mass(q)[0]
        W = weight(cmbot_robot.arm_mass)
        force, torque = W - got.guardrail_force[0], np.cross(centre, W) - got.guardrail_torque[0]
        check_derivative(momentum, [t], np.concatenate([force, torque])[:, None], rtol=1e-9)


def test_at_rest_the_force_is_the_weight_and_the_torque_its_lever(
    cmbot_dynamics: Dynamics, cmbot_states: StateSamples
) -> None:
    start = np.deg2rad([[-10, -90, 90, 0, 10, 50, 0]])
    q = np.vstack([start, cmbot_states(2000)[0]])
    got = cmbot_dynamics.static_efforts(q)
    W = weight(37.62)
    np.testing.assert_allclose(got.guardrail_force, np.tile(W, (len(q), 1)), rtol=0, atol=1e-10)
    lever = chang2021_arm.centre_of_mass(q)
    np.testing.assert_allclose(got.guardrail_torque, np.cross(lever, W), rtol=0, atol=1e-9)
    assert np.linalg.norm(got.guardrail_torque[0]) == pytest.approx(486.4, abs=0.05)


@pytest.mark.parametrize("factor", [0.0, 0.5, -2.0])
def test_only_the_static_part_scales_with_gravity(
    cmbot_robot: Robot, cmbot_dynamics: Dynamics, cmbot_states: StateSamples, factor: float
) -> None:
    q, v, a = cmbot_states(50)
    other = Dynamics(with_gravity(cmbot_robot, factor * weight(1.0)))
    still, moving = cmbot_dynamics.static_efforts(q), cmbot_dynamics.efforts(q, v, a)
    scaled_still, scaled_moving = other.static_efforts(q), other.efforts(q, v, a)
    for name in (field.name for field in dataclasses.fields(still)):
        static = getattr(still, name)
        np.testing.assert_allclose(getattr(scaled_still, name), factor * static, rtol=0, atol=1e-10)
        expected = getattr(moving, name) + (factor - 1) * static
        np.testing.assert_allclose(getattr(scaled_moving, name), expected, rtol=0, atol=1e-9)


def test_payload_is_a_point_mass_at_the_tool(cmbot_dynamics: Dynamics, cmbot_kinematics: Kinematics) -> None:
    loaded = load_robot("cmbot", payload=5.0)
    assert loaded.arm_mass == pytest.approx(42.62)
    assert loaded.carrier_mass == pytest.approx(30.38)

    def tool_velocity(t: FloatArray) -> FloatArray:
        q, v, _ = motion(t)
        return cmbot_kinematics.tool_jacobian(q[0])[1][:3] @ v[0]

    for t in np.linspace(0, 6, 7):
        state = motion(np.array([t]))
        X_WT, J = cmbot_kinematics.tool_jacobian(state[0][0])
        acceleration = finite_difference(tool_velocity, np.array([t]))[:, 0]
        force = weight(5.0) - 5.0 * acceleration
        with_load, without = Dynamics(loaded).efforts(*state), cmbot_dynamics.efforts(*state)
        for name, expected in (
            ("guardrail_force", force),
            ("guardrail_torque", np.cross(X_WT.translation, force)),
            ("joint_torque", -J[:3].T @ force),
        ):
            extra = getattr(with_load, name) - getattr(without, name)
            np.testing.assert_allclose(extra[0], expected, atol=1e-7)


def test_derivatives_are_those_of_the_efforts(any_arm: Robot, random_states: StateSamples) -> None:
    q, v, a = random_states(any_arm, 60)
    dynamics = Dynamics(any_arm)
    got = dynamics.derivatives(q, v, a)

    def value(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        efforts = dynamics.efforts(q[None], v[None], a[None])
        return np.concatenate([efforts.guardrail_torque[0], efforts.joint_torque[0]])

    for k in range(len(q)):
        expected = value(q[k], v[k], a[k])
        np.testing.assert_allclose(got.value[k], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
        check_derivative(lambda x, k=k: value(x, v[k], a[k]), q[k], got.d_q[k], rtol=1e-9)
        # Quadratic in velocity, linear in acceleration: a large step has no truncation error.
        check_derivative(lambda x, k=k: value(q[k], x, a[k]), v[k], got.d_v[k], step=1.0, rtol=1e-11)
        check_derivative(lambda x, k=k: value(q[k], v[k], x), a[k], got.d_a[k], step=1.0, rtol=1e-11)
    M = got.d_a[:, 3:]  # the mass matrix
    np.testing.assert_allclose(M, M.swapaxes(1, 2), rtol=0, atol=1e-11)
    assert np.linalg.eigvalsh(M).min() > 0


Draw = tuple[int, int, float, float]
draws = st.tuples(
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
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-11 * max(1.0, np.abs(expected).max()))


@settings(max_examples=20)
@given(draw=draws)
def test_efforts_are_those_of_the_arm_at_each_state(any_arm: Robot, draw: Draw) -> None:
    q, v, a = drawn(any_arm, *draw)
    got = Dynamics(any_arm).efforts(q, v, a)
    data = any_arm.model.createData()
    for k in range(len(q)):
        same(got.joint_torque[k], pin.rnea(any_arm.model, data, q[k], v[k], a[k]))
        # What the base exerts on the first joint's subtree, moved to W.
        wrench = data.liMi[1].act(data.f[1])
        same(got.guardrail_force[k], -wrench.linear)
        same(got.guardrail_torque[k], -wrench.angular)


@settings(max_examples=20)
@given(draw=draws)
def test_derivatives_are_those_of_the_free_flying_arm(any_arm: Robot, draw: Draw) -> None:
    q, v, a = drawn(any_arm, *draw)
    value, d_q, d_v, d_a = free_flying(any_arm, q, v, a)
    wrench, efforts = Dynamics(any_arm).wrench_derivatives(q, v, a), Dynamics(any_arm).derivatives(q, v, a)
    for name, expected in {"value": value, "d_q": d_q, "d_v": d_v, "d_a": d_a}.items():
        same(getattr(wrench, name), -expected[:, :6])
        same(getattr(efforts, name)[:, :3], -expected[:, 3:6])
        same(getattr(efforts, name)[:, 3:], expected[:, 6:])


def test_results_do_not_alias_working_memory(any_arm: Robot) -> None:
    dynamics, n = Dynamics(any_arm), any_arm.dof
    first = drawn(any_arm, 1, 3, 1.0, 1.0)
    methods = (dynamics.efforts, dynamics.derivatives, dynamics.wrench_derivatives)
    results = [vars(method(*first)) for method in methods]
    kept = [{name: array.copy() for name, array in result.items()} for result in results]
    for method in methods:
        method(*drawn(any_arm, 2, 3, 1.0, 1.0))
    for result, copies in zip(results, kept, strict=True):
        for name, copied in copies.items():
            np.testing.assert_array_equal(result[name], copied)
    # No states give empty results.
    none = np.empty((0, n))
    assert dynamics.efforts(none, none, none).guardrail_torque.shape == (0, 3)
    assert dynamics.derivatives(none, none, none).d_q.shape == (0, 3 + n, n)
