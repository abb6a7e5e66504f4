"""What the optimiser is told of a state: values by definition, derivatives by finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from conftest import StateSamples as RandomStates
from finite_differences import check_derivative
from numpy.typing import NDArray
from small_scenes import parts, short_scene

from cmbot.collision import Clearances
from cmbot.planning.path.task import ToolTask
from cmbot.planning.torque.constraints import (
    ClearanceMargin,
    JointTorque,
    StateConstraint,
    StateSamples,
    ToolDeviation,
)
from cmbot.robot import Dynamics, Efforts, Kinematics, Robot

FloatArray = NDArray[np.float64]
N = 6


@pytest.fixture(scope="module")
def corner() -> tuple[Robot, ToolTask, Clearances]:
    """Two legs with a corner between them, and the guardrail."""
    legs = [{"by": [0, -0.3, 0], "seconds": 2}, {"by": [0, 0, 0.2], "seconds": 2}]
    robot, task, _, clearances = parts(short_scene(tool_path={"legs": legs}))
    return robot, task, clearances


@pytest.fixture
def states(cmbot_robot: Robot, random_states: RandomStates, rng: np.random.Generator) -> StateSamples:
    return StateSamples(rng.uniform(0, 4, N), *random_states(cmbot_robot, N))


def check_linearisation(
    function: StateConstraint,
    states: StateSamples,
    component: NDArray[np.intp],
    *,
    step: float,
    tolerance: float,
) -> None:
    """Value and derivatives of one component at each state; clearances are rough, torques are not."""
    got = function.linearise(states, component)
    assert got.value.shape == (N,)

    def alone(k: int, **changed: FloatArray) -> float:
        state = {"q": states.q[k], "v": states.v[k], "a": states.a[k]} | changed
        at = StateSamples(states.t[k : k + 1], *(x[None] for x in state.values()))
        return float(function.linearise(at, component[k : k + 1]).value[0])

    for k in range(N):
        assert got.value[k] == pytest.approx(alone(k), abs=1e-12)
        for name, x, derivative in (
            ("q", states.q, got.d_q),
            ("v", states.v, got.d_v),
            ("a", states.a, got.d_a),
        ):
            assert derivative.shape == (N, 7)
            changed: Callable[[FloatArray], float] = lambda y, k=k, name=name: alone(k, **{name: y})  # noqa: E731
            check_derivative(changed, x[k], derivative[k], step=step, rtol=tolerance, atol=tolerance)


def test_joint_torque(cmbot_robot: Robot, cmbot_dynamics: Dynamics, states: StateSamples) -> None:
    bound = cmbot_robot.limits.torque
    function = JointTorque(cmbot_dynamics, bound)
    value, component = function.values(states)
    assert value.shape == component.shape == (N, 14)
    assert function.components == 14
    torque = cmbot_dynamics.efforts(states.q, states.v, states.a).joint_torque
    for k in range(N):
        for joint in range(7):
            assert value[k, joint] == pytest.approx(torque[k, joint] / bound[joint] - 1)
            assert value[k, 7 + joint] == pytest.approx(-torque[k, joint] / bound[joint] - 1)
            # Above zero exactly where the bound is passed, on the side where it is.
            assert (value[k, joint] > 0) == (torque[k, joint] > bound[joint])
            assert (value[k, 7 + joint] > 0) == (torque[k, joint] < -bound[joint])
    np.testing.assert_array_equal(component, np.tile(np.arange(14), (N, 1)))


@pytest.mark.parametrize("component", range(14))
def test_derivatives_of_a_joint_torque(
    cmbot_robot: Robot, cmbot_dynamics: Dynamics, states: StateSamples, component: int
) -> None:
    function = JointTorque(cmbot_dynamics, cmbot_robot.limits.torque)
    chosen = np.full(N, component)
    expected = function.values(states)[0][:, component]
    np.testing.assert_allclose(function.linearise(states, chosen).value, expected, rtol=0, atol=1e-12)
    check_linearisation(function, states, chosen, step=1e-3, tolerance=1e-8)


def test_components_may_differ_from_state_to_state(
    cmbot_robot: Robot, cmbot_dynamics: Dynamics, states: StateSamples
) -> None:
    function = JointTorque(cmbot_dynamics, cmbot_robot.limits.torque)
    chosen = np.array([0, 13, 6, 7, 3, 3])
    got = function.linearise(states, chosen).value
    np.testing.assert_allclose(got, function.values(states)[0][np.arange(N), chosen], rtol=0, atol=1e-12)


def test_tool_deviation(corner: tuple[Robot, ToolTask, Clearances], states: StateSamples) -> None:
    robot, task, _ = corner
    function = ToolDeviation(Kinematics(robot), task, 0.5)
    value, component = function.values(states)
    p_WT, _ = Kinematics(robot).tool_poses(states.q)
    start, middle, end = task.path.corners
    for k in range(N):
        a, b = (start, middle) if states.t[k] < 2 else (middle, end)
        along = a + np.linspace(0, 1, 2001)[:, None] * (b - a)
        nearest = np.linalg.norm(along - p_WT[k], axis=1).min()
        assert value[k, 0] == pytest.approx(nearest / 0.5 - 1, abs=1e-6)
    check_linearisation(function, states, component[:, 0], step=1e-3, tolerance=1e-7)


def test_tool_deviation_on_the_path_is_flat(corner: tuple[Robot, ToolTask, Clearances]) -> None:
    """A distance has no derivative at zero: none is made up, and nothing is divided by."""
    robot, task, _ = corner
    q = np.deg2rad([[-10.0, -90, 90, 0, 10, 50, 0]])
    got = ToolDeviation(Kinematics(robot), task, 1e-3).linearise(
        StateSamples(np.zeros(1), q, 0 * q, 0 * q), np.zeros(1, dtype=np.intp)
    )
    assert got.value[0] == pytest.approx(-1, abs=1e-9)
    assert np.isfinite(got.d_q).all()


def test_clearance_margin(corner: tuple[Robot, ToolTask, Clearances], states: StateSamples) -> None:
    _, _, clearances = corner
    function = ClearanceMargin(clearances, 0.02)
    value, component = function.values(states)
    smallest = clearances.smallest(states.q)
    np.testing.assert_allclose(value[:, 0], (0.02 - smallest.distance) / 0.1, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(component[:, 0], smallest.pair)
    # Violated exactly where something is nearer than the margin.
    np.testing.assert_array_equal(value[:, 0] > 0, smallest.distance < 0.02)
    outside = np.array([k for k, pair in enumerate(clearances.pairs) if pair.link == "tool"][:1] * N)
    check_linearisation(function, states, outside, step=1e-4, tolerance=1e-3)


def test_states_can_be_picked(states: StateSamples) -> None:
    picked = states[np.array([4, 1])]
    for name in ("t", "q", "v", "a"):
        np.testing.assert_array_equal(getattr(picked, name), getattr(states, name)[[4, 1]])
    np.testing.assert_array_equal(states[1:3].q, states.q[1:3])


def test_what_a_motion_asks_is_worked_out_once_for_every_robot(
    cmbot_robot: Robot, states: StateSamples, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Robot] = []
    efforts = Dynamics.efforts

    def counted(self: Dynamics, q: FloatArray, v: FloatArray, a: FloatArray) -> Efforts:
        asked.append(self.robot)
        return efforts(self, q, v, a)

    monkeypatch.setattr(Dynamics, "efforts", counted)
    loaded = parts(short_scene(robot={"payload_kg": 3.0}))[0]
    for robot in (cmbot_robot, loaded, cmbot_robot, loaded):
        got = states.efforts(Dynamics(robot)).joint_torque
        np.testing.assert_array_equal(
            got, efforts(Dynamics(robot), states.q, states.v, states.a).joint_torque
        )
    assert asked == [cmbot_robot, loaded]
