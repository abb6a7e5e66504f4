"""Functions of the state: values by definition, derivatives by finite differences, samples by thresholds."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from finite_differences import check_derivative, check_state_derivatives
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation
from small_scenes import parts, short_request, short_scene, with_corners
from state_samples import StateSamples as RandomStates

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.optimization.program import Linearization, StateFunction, StateSamples
from cmbot.planning.task import ToolTask
from cmbot.planning.torque.constraints import (
    ClearanceMargin,
    HoldingTorque,
    JointTorque,
    ToolDeviation,
    ToolLag,
    ToolRotation,
    ToolSpeed,
    ToolTilt,
)
from cmbot.planning.workcell.objectives import efforts_of
from cmbot.robot import Dynamics, Efforts, Kinematics, Postures, Robot
from cmbot.trajectory.quintic import QuinticTrajectory

N = 6
Corner = tuple[Robot, ToolTask, Clearances]


@pytest.fixture(scope="module")
def corner() -> Corner:
    legs = [{"by": [0, -0.3, 0], "seconds": 2}, {"by": [0, 0, 0.2], "seconds": 2}]
    robot, task, _, clearances = parts(short_scene(tool_path={"legs": legs}))
    return robot, task, clearances


@pytest.fixture
def states(cmbot_robot: Robot, random_states: RandomStates, rng: np.random.Generator) -> StateSamples:
    return StateSamples(rng.uniform(0, 4, N), *random_states(cmbot_robot, N))


def check_linearization(
    function: StateFunction, states: StateSamples, component: IntArray, step: float, tolerance: float
) -> None:
    """Value and derivatives of one component at each state; clearances are rough, torques are not."""
    got = function.linearize(states, component)
    assert got.value.shape == (N,)
    for k in range(N):

        def alone(at: StateSamples, k: int = k) -> FloatArray:
            return function.linearize(at, component[k : k + 1]).value

        here = slice(k, k + 1)
        np.testing.assert_allclose(got.value[here], alone(states[here]), rtol=0, atol=1e-12)
        one = Linearization(got.value[here], *got.derivatives[:, here])
        check_state_derivatives(alone, states[here], one, step=step, rtol=tolerance, atol=tolerance)


def test_joint_torque(cmbot_robot: Robot, cmbot_dynamics: Dynamics, states: StateSamples) -> None:
    bound = cmbot_robot.limits.torque
    function = JointTorque(cmbot_dynamics, bound)
    value, component = function.sample(states)
    assert value.shape == component.shape == (N, function.components) == (N, 14)
    torque = cmbot_dynamics.efforts(states.q, states.v, states.a).joint_torque
    np.testing.assert_allclose(value, np.hstack([torque, -torque]) / np.tile(bound, 2) - 1, atol=1e-12)
    # Above zero exactly where the bound is passed, on the side where it is.
    np.testing.assert_array_equal(value > 0, np.hstack([torque > bound, torque < -bound]))
    assert (value > 0).any()
    np.testing.assert_array_equal(component, np.tile(np.arange(14), (N, 1)))


@pytest.mark.parametrize("chosen", [*range(14), [0, 13, 6, 7, 3, 3]])
def test_derivatives_of_a_joint_torque(
    cmbot_robot: Robot, cmbot_dynamics: Dynamics, states: StateSamples, chosen: int | list[int]
) -> None:
    function = JointTorque(cmbot_dynamics, cmbot_robot.limits.torque)
    component = np.broadcast_to(chosen, N)
    expected = function.sample(states)[0][np.arange(N), component]
    np.testing.assert_allclose(function.linearize(states, component).value, expected, rtol=0, atol=1e-12)
    check_linearization(function, states, component, 1e-3, 1e-8)


@pytest.mark.parametrize("chosen", range(4))
def test_torque_that_locked_joints_hold(cmbot_robot: Robot, states: StateSamples, chosen: int) -> None:
    dynamics, bound = Dynamics(cmbot_robot), np.array([300.0, 200.0])
    function = HoldingTorque(dynamics, bound)
    value, component = function.sample(states)
    assert value.shape == component.shape == (N, function.components) == (N, 4)
    wrench = dynamics.efforts(states.q, states.v, states.a).guardrail_wrench
    torque = cmbot_robot.holding_torque(wrench)
    np.testing.assert_array_equal(value > 0, np.hstack([torque > bound, torque < -bound]))
    component = np.full(N, chosen)
    np.testing.assert_allclose(function.linearize(states, component).value, value[:, chosen], atol=1e-12)
    check_linearization(function, states, component, 1e-3, 1e-7)


def test_tool_deviation(corner: Corner, states: StateSamples) -> None:
    robot, task, _ = corner
    function = ToolDeviation(Postures(robot), task, 0.5)
    value, component = function.sample(states)
    p_WT, _ = Kinematics(robot).tool_poses(states.q)
    start, middle, end = task.path.corners
    for k in range(N):
        a, b = (start, middle) if states.t[k] < 2 else (middle, end)
        along = a + np.linspace(0, 1, 2001)[:, None] * (b - a)
        nearest = np.linalg.norm(along - p_WT[k], axis=1).min()
        assert value[k, 0] == pytest.approx(nearest / 0.5 - 1, abs=1e-6)
    check_linearization(function, states, component[:, 0], 1e-3, 1e-7)


def test_tool_lag(corner: Corner, states: StateSamples) -> None:
    robot, task, _ = corner
    function = ToolLag(Postures(robot), task, 0.5)
    value, component = function.sample(states)
    p_WT, _ = Kinematics(robot).tool_poses(states.q)
    corners = task.path.corners
    for k in range(N):
        leg = corners[1] - corners[0] if states.t[k] < 2 else corners[2] - corners[1]
        lag = (p_WT[k] - task.path.position(states.t[[k]])[0]) @ leg / np.linalg.norm(leg)
        np.testing.assert_allclose(value[k], [lag / 0.5 - 1, -lag / 0.5 - 1], atol=1e-12)
    for side in (0, 1):
        check_linearization(function, states, component[:, side], 1e-3, 1e-7)


@pytest.mark.parametrize("keep", ["pose", "axis"])
def test_tool_rotation(corner: Corner, states: StateSamples, keep: Any) -> None:
    robot, task, _ = corner
    task = replace(task, keep=keep)
    function = ToolRotation(Postures(robot), task, 0.5)
    value, component = function.sample(states)
    _, R_WT = Kinematics(robot).tool_poses(states.q)
    for k in range(N):
        turn = Rotation.from_matrix(task.path.orientation @ R_WT[k].T).magnitude()
        axes = np.arccos(np.clip(task.path.orientation[:, 2] @ R_WT[k][:, 2], -1, 1))
        assert value[k, 0] == pytest.approx((turn if keep == "pose" else axes) / 0.5 - 1, abs=1e-7)
    check_linearization(function, states, component[:, 0], 1e-3, 1e-6)


@pytest.mark.parametrize("near", [False, True])
def test_tool_tilt(corner: Corner, states: StateSamples, near: bool) -> None:
    """The squared chord: at the cone it is 0, where the axes agree -1, and smooth there."""
    robot, task, _ = corner
    task, bound = replace(task, keep="position", cone=0.3), 0.3
    if near:
        q = np.deg2rad([-10.0, -90, 90, 0, 10, 50, 0]) + 1e-3 * states.q
        states = StateSamples(states.t, q, states.v, states.a)
    function = ToolTilt(Postures(robot), task, bound)
    value, component = function.sample(states)
    z = Kinematics(robot).tool_poses(states.q)[1][:, :, 2]
    angle = np.arctan2(
        np.linalg.norm(np.cross(z, task.path.orientation[:, 2]), axis=1), z @ task.path.orientation[:, 2]
    )
    np.testing.assert_allclose(value[:, 0], (np.sin(angle / 2) / np.sin(0.15)) ** 2 - 1, atol=1e-12)
    np.testing.assert_array_equal(value[:, 0] > 0, angle > bound)
    check_linearization(function, states, component[:, 0], 1e-3, 1e-7)
    at = function.linearize(states, component[:, 0])
    cuts = np.array([cut.value for cut in at.cuts])
    assert cuts.shape == (8, N)
    assert (cuts <= at.value + 1e-12).all()


def test_a_tilt_out_of_the_cone_is_seen_from_its_middle(corner: Corner) -> None:
    """There the squared chord has no slope; in every direction some cut says where the cone ends."""
    robot, task, _ = corner
    function = ToolTilt(Postures(robot), replace(task, keep="position", cone=0.2), 0.2)
    q = np.deg2rad([[-10.0, -90, 90, 0, 10, 50, 0]])
    at = function.linearize(StateSamples.at_rest(np.zeros(1), q), np.zeros(1, dtype=np.intp))
    assert at.value[0] == pytest.approx(-1, abs=1e-12)
    assert np.abs(at.d_q).max() < 1e-6
    X_WT, J = Kinematics(robot).tool_jacobian(q[0])
    for angle in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        # A move of the joints that turns the tool about an axis across its own.
        turn = X_WT.rotation @ [np.cos(angle), np.sin(angle), 0.0]
        dq = np.linalg.pinv(J) @ np.concatenate([np.zeros(3), turn])
        predicted = max(float(cut.value[0] + 0.25 * cut.d_q[0] @ dq) for cut in at.cuts)
        assert predicted > 0.25 / 0.2 * np.cos(np.pi / 8) * 2 - 2 - 1e-2 > 0
        inside = max(float(cut.value[0] + 0.19 * cut.d_q[0] @ dq) for cut in at.cuts)
        assert inside < 0


def test_direction_cuts_of_the_tool_deviation(corner: Corner, rng: np.random.Generator) -> None:
    """In eight directions across the leg, the offset's own among them; none ever exceeds the deviation."""
    robot, task, _ = corner
    bound = 0.01
    function, kinematics = ToolDeviation(Postures(robot), task, bound), Kinematics(robot)
    t = np.array([0.0, 0.0, 0.0])
    q = np.deg2rad([-10.0, -90, 90, 0, 10, 50, 0]) + 0.01 * rng.normal(size=(3, 7))
    at = function.linearize(StateSamples.at_rest(t, q), np.zeros(3, dtype=np.intp))
    cuts = np.array([cut.value for cut in at.cuts])
    assert cuts.shape == (7, 3)
    assert (cuts <= at.value + 1e-12).all()
    leg = (task.path.corners[1] - task.path.corners[0]) / 0.3
    offset = task.path.leg_offset(t, kinematics.tool_poses(q)[0])
    across = offset - (offset @ leg)[:, None] * leg
    for k in range(3):
        u = across[k] / np.linalg.norm(across[k])
        for number, cut in enumerate(at.cuts, start=1):
            angle = number * np.pi / 4
            direction = np.cos(angle) * u + np.sin(angle) * np.cross(leg, u)

            def towards(x: FloatArray, k: int = k, direction: FloatArray = direction) -> float:
                there = task.path.leg_offset(t[[k]], kinematics.tool_poses(x[None])[0])[0]
                return float(direction @ there / bound - 1)

            assert cut.value[k] == pytest.approx(towards(q[k]), abs=1e-10)
            check_derivative(lambda x, f=towards: f(x), q[k], cut.d_q[k], rtol=1e-6)
            assert not (cut.d_v.any() or cut.d_a.any())


@pytest.mark.parametrize("rests", [False, True])
def test_tool_deviation_on_the_path_is_flat(corner: Corner, rests: bool) -> None:
    """A distance has no derivative at zero: none is made up, and nothing is divided by, nor in a pause."""
    robot, task, _ = corner
    q = np.deg2rad([[-10.0, -90, 90, 0, 10, 50, 0]])
    if rests:
        (start,) = Kinematics(robot).tool_poses(q)[0]
        corners = np.array([start, start, *task.path.corners[2:]])
        task = replace(task, path=with_corners(task.path, corners))
    got = ToolDeviation(Postures(robot), task, 1e-3).linearize(
        StateSamples.at_rest(np.zeros(1), q), np.zeros(1, dtype=np.intp)
    )
    assert got.value[0] == pytest.approx(-1, abs=1e-9)
    for each in (got, *got.cuts):
        assert np.isfinite(each.d_q).all()
    # Where the deviation knows no direction its cuts do.
    assert all(np.abs(cut.d_q).max() > 100 for cut in got.cuts)


def test_clearance_margin(corner: Corner, states: StateSamples) -> None:
    _, _, clearances = corner
    function = ClearanceMargin(clearances, 0.02)
    value, component = function.sample(states)
    smallest = clearances.query(states.q)
    np.testing.assert_allclose(value[:, 0], (0.02 - smallest.distance) / 0.1, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(component[:, 0], smallest.pair)
    # Violated exactly where something is nearer than the margin.
    np.testing.assert_array_equal(value[:, 0] > 0, smallest.distance < 0.02)
    outside = np.array([k for k, pair in enumerate(clearances.pairs) if pair.link == "tool"][:1] * N)
    check_linearization(function, states, outside, 1e-4, 1e-3)


def swinging(seed: int, number: int = 300) -> FloatArray:
    """Postures (number, 7) along a smooth motion."""
    rng = np.random.default_rng(seed)
    q, v, a = rng.normal(size=(3, 8, 7)) * np.array([0.3, 0.3, 0.5])[:, None, None]
    return QuinticTrajectory(t=np.arange(8.0), q=q, v=v, a=a).evaluate(np.linspace(0, 7, number))


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.6), st.sampled_from([-0.02, -0.5, 0.1]))
def test_clearances_are_measured_wherever_they_matter(seed: int, margin: float, threshold: float) -> None:
    """Along motions that come nearer to each other, with few samples or many, as an optimisation asks."""
    asked, _ = short_request()
    clearance = ClearanceMargin(asked.cell.clearances, margin)
    here, there = (asked.state.posture + 0.5 * swinging(seed + k) for k in (0, 1))
    for share, every in ((0.0, 10), (0.0, 1), (0.5, 1), (0.6, 10), (0.6, 1), (0.61, 1), (0.611, 1)):
        q = ((1 - share) * here + share * there)[::every]
        states = StateSamples.at_rest(np.linspace(0, 7, len(q)), q)
        exact, nearest = (each[:, 0] for each in clearance.sample(states))
        value, pair = (each[:, 0] for each in clearance.sample(states, threshold))
        known = np.isfinite(value)
        np.testing.assert_allclose(value[known], exact[known], atol=1e-6)
        # Where two pairs are equally near either may be named.
        other = known & (pair != nearest)
        np.testing.assert_allclose(
            clearance.linearize(states[np.flatnonzero(other)], pair[other]).value, exact[other], atol=1e-6
        )
        above = exact > threshold
        near = above | np.append(above[1:], False) | np.append(False, above[:-1])
        assert known[near].all()
        assert np.isneginf(value[~known]).all()


def test_neighbours_of_what_matters_are_measured() -> None:
    """Though bounds say that they are far enough: a top between samples is found from three of them."""

    class Wall(SimpleNamespace):
        """A distance that changes as fast as it can, and is zero at 5."""

        pairs, pair_reach = ("wall",), np.ones((1, 1))

        def lower_bounds(self, q: FloatArray) -> FloatArray:
            return np.full((len(q), 1), -np.inf)

        def distances(self, q: FloatArray, posture: IntArray, pair: IntArray) -> FloatArray:
            assert (pair == 0).all()
            return np.abs(q[posture, 0] - 5.0)

    t = np.arange(33.0)
    clearance: Any = ClearanceMargin(Wall(), 0.0)
    value, pair = clearance.sample(StateSamples.at_rest(t, t[:, None]), -0.02)
    known = np.flatnonzero(np.isfinite(value[:, 0]))
    np.testing.assert_array_equal(known, [4, 5, 6])
    np.testing.assert_allclose(value[known, 0], -np.abs(known - 5) / 0.1, atol=1e-12)
    np.testing.assert_array_equal(pair[known, 0], 0)
    # What is remembered holds as far as postures have moved since.
    for shift in (20.0, 0.0, 1.5, 0.5):
        value = clearance.sample(StateSamples.at_rest(t, t[:, None] + shift), -0.02)[0][:, 0]
        matters = np.abs(t + shift - 5) < 0.002
        assert np.isfinite(value[matters]).all()
        assert matters.any() == (shift == 0.0)


def test_clearances_that_hardly_change_are_not_measured_again() -> None:
    measured: list[int] = []

    class Counted(Clearances):
        def distances(self, q, posture, pair):  # type: ignore[no-untyped-def]
            measured.append(len(pair))
            return super().distances(q, posture, pair)

        def lower_bounds(self, q: FloatArray) -> FloatArray:
            return np.full((len(q), len(self.pairs)), -np.inf)

    asked, _ = short_request()
    clearances = Counted(asked.cell.robot, ())
    clearance, t = ClearanceMargin(clearances, 0.0), np.linspace(0, 9, 4000)
    q = asked.state.posture + 0.05 * np.sin(t)[:, None]
    for shift in (0.0, 1e-4, 2e-4):
        clearance.sample(StateSamples.at_rest(t, q + shift), -0.02)
        if shift == 0.0:
            assert 0 < sum(measured) <= len(clearances.pairs) * (4000 / 16 + 1)
            measured.clear()
    assert sum(measured) == 0


def test_a_posture_that_is_no_number_is_measured() -> None:
    """What was remembered says nothing of it."""
    asked, _ = short_request()
    clearance, t = ClearanceMargin(asked.cell.clearances, 0.0), np.linspace(0, 1, 50)
    q = np.repeat(asked.state.posture[None], 50, axis=0)
    clearance.sample(StateSamples.at_rest(t, q), -0.02)
    q[20] = np.nan
    value = clearance.sample(StateSamples.at_rest(t, q), -0.02)[0]
    assert np.isnan(value[20, 0])


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
        got = efforts_of(Dynamics(robot), states).joint_torque
        expected = efforts(Dynamics(robot), states.q, states.v, states.a).joint_torque
        np.testing.assert_array_equal(got, expected)
    assert asked == [cmbot_robot, loaded]


def test_tool_speed(any_arm: Robot, random_states: RandomStates, rng: np.random.Generator) -> None:
    states = StateSamples(rng.uniform(0, 4, N), *random_states(any_arm, N))
    function = ToolSpeed(Postures(any_arm), bound=0.7)
    value, component = function.sample(states)
    assert value.shape == component.shape == (N, 1)
    for k in range(N):
        J = Kinematics(any_arm).tool_jacobian(states.q[k])[1]
        assert value[k, 0] == pytest.approx(np.linalg.norm(J[:3] @ states.v[k]) / 0.7 - 1)
    check_linearization(function, states, component[:, 0], step=1e-3, tolerance=1e-7)
    still = StateSamples(states.t, states.q, 0 * states.v, states.a)
    at_rest = function.linearize(still, component[:, 0])
    np.testing.assert_array_equal(at_rest.value, -1.0)
    assert np.isfinite(at_rest.derivatives).all()
