"""Bounds at complex joint angles, against the paper's recursion evaluated there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings, strategies as st
from oracles import chang2021_arm
from rail_arms import rail_scene
from small_motions import wild
from state_samples import StateSamples

from cmbot.common.arrays import FloatArray
from cmbot.planning import robot_of
from cmbot.planning.certification.norm_bounds import norm_bounds, timed_pose_bounds
from cmbot.robot import Dynamics, Kinematics, Robot
from cmbot.toolpath.curves import Arc, CylinderCurve
from cmbot.toolpath.time_law import SpeedProfile
from cmbot.toolpath.tool_path import Segment, ToolPath
from cmbot.trajectory import Pieces, QuinticTrajectory
from cmbot.trajectory.enclosure import _ELLIPSE_SUMS, Ellipses

# Beyond this imaginary part of all angles together, rad, the oracle's own rounding, which grows by its
# exponential, hides what is compared; no remainder comes from there.
LARGEST_TURN = 30.0


_EVERY = 8
FORCE = (40.0, -300.0, -2000.0)
FIXED_TOOL, _STEP = np.array([1.5, 0.8, -1.9]), 1e-5


def _seen(q: FloatArray) -> FloatArray:
    """A fixed tool's points (N, 3) in the part's frame, at complex angles `q` (N, 7)."""
    p, R = chang2021_arm.tool_pose(q)
    return np.einsum("kji,kj->ki", R, FIXED_TOOL - p)


def _slopes(q: FloatArray, along: list[FloatArray]) -> list[FloatArray]:
    """Derivatives (N, 3) of the tool point at complex angles `q` (N, 7), by what moves them."""
    step = 1e-5
    ends = np.concatenate([q + sign * step * each for each in along for sign in (1, -1)])
    points = chang2021_arm.tool_pose(ends)[0].reshape(len(along), 2, -1, 3)
    return list((points[:, 0] - points[:, 1]) / (2 * step))


@settings(max_examples=5)
@given(seed=st.integers(min_value=0, max_value=2**32 - 1))
@example(169)
def test_nothing_is_larger_on_the_ellipses(cmbot_robot: Robot, seed: int) -> None:
    x = wild(seed, joints=7, knots=3)
    pieces = Pieces.between(x, np.empty(0))
    for _ in range(3):
        pieces = pieces.halved(np.ones(len(pieces.start), dtype=np.bool_))
    of, pushed = (
        norm_bounds(replace(cmbot_robot, tool_force=force), pieces.ellipses) for force in ((0, 0, 0), FORCE)
    )
    held = norm_bounds(replace(cmbot_robot, fixed_tool=pin.SE3(np.eye(3), FIXED_TOOL)), pieces.ellipses)
    usual = pieces.ellipses.turn.sum(axis=2) < LARGEST_TURN
    assert usual[:, 2].all()
    angle = np.exp(1j * np.linspace(0, 2 * np.pi, 24, endpoint=False))
    segment = np.searchsorted(x.t, pieces.middle, side="right") - 1
    for k, r in zip(*np.nonzero(usual), strict=True):
        rho = _ELLIPSE_SUMS[r] * angle
        t = pieces.middle[k] + 0.25 * (rho + 1 / rho) * (pieces.end[k] - pieces.start[k])
        c, h = x.coefficients[segment[k]].T, np.diff(x.t)[segment[k]]
        u = (t - x.t[segment[k]]) / h
        q, v, a = (
            np.polynomial.polynomial.polyval(u, np.polynomial.polynomial.polyder(c, order)).T / h**order
            for order in range(3)
        )
        tau, n_0, _ = chang2021_arm.efforts(q, v, a)
        p, R = chang2021_arm.tool_pose(q)
        slack = 1 + 1e-9
        assert (np.abs(tau) <= of.joint_torque[k, r] * slack).all()
        assert (np.linalg.norm(n_0, axis=1) <= of.guardrail_torque[k, r] * slack).all()
        assert (np.linalg.norm(p, axis=1) <= of.tool_point[k, r] * slack).all()
        assert (np.linalg.norm(R, 2, axis=(1, 2)) <= of.tool_rotation[k, r] * slack).all()
        # Of a fixed tool, which the part sees where it is less the part's place.
        rate = (_seen(q + _STEP * v) - _seen(q - _STEP * v)) / (2 * _STEP)
        assert (np.linalg.norm(_seen(q), axis=1) <= held.tool_point[k, r] * slack).all()
        assert (np.linalg.norm(rate, axis=1) <= held.tool_velocity[k, r] * (1 + 1e-6)).all()
        # With a force, at some of them.
        q, v, p, R, tau, n_0 = (x[::_EVERY] for x in (q, v, p, R, tau, n_0))
        F = R @ np.array(FORCE)
        *J, velocity = _slopes(q, [*np.eye(7), v])
        tau, n_0 = tau - np.einsum("jki,ki->kj", J, F), n_0 - np.cross(p, F)
        assert (np.abs(tau) <= pushed.joint_torque[k, r] * slack).all()
        assert (np.linalg.norm(n_0, axis=1) <= pushed.guardrail_torque[k, r] * slack).all()
        assert (np.linalg.norm(velocity, axis=1) <= of.tool_velocity[k, r] * (1 + 1e-6)).all()


def test_at_rest_only_gravity_and_the_stretched_arm_are_left(cmbot_robot: Robot) -> None:
    x = wild(1, joints=7)
    still = QuinticTrajectory(t=x.t, q=np.tile(x.q[:1], (len(x.t), 1)), v=0 * x.v, a=0 * x.a)
    of = norm_bounds(cmbot_robot, Pieces.between(still, np.empty(0)).ellipses)
    np.testing.assert_allclose(of.tool_rotation[:, 0], 1.0, rtol=1e-9)
    base = float(np.linalg.norm(cmbot_robot.base_point))
    np.testing.assert_allclose(of.tool_point[:, 0], base + cmbot_robot.reach, rtol=1e-9)
    # The weights' torques about O0 cannot be larger than with every link stretched out sideways.
    weight, levers = cmbot_robot.arm_mass * 9.81, base + cmbot_robot.reach
    assert (of.guardrail_torque[:, 0] <= weight * levers).all()


def test_nothing_is_larger_where_joints_turn_alike(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    """At constant rates in postures of right angles, where the joints' turns add up, the bounds are close."""
    dynamics, closest = Dynamics(cmbot_robot), 0.0
    for _ in range(400):
        q = rng.choice([-np.pi / 2, 0.0, np.pi / 2], (1, 1, 7))
        v, rest = 100.0 * rng.choice([0.0, 1.0], (1, 1, 7)), np.zeros((1, 1, 7))
        of = norm_bounds(cmbot_robot, Ellipses(turn=rest, q=np.abs(q), v=v, a=rest))
        true = dynamics.efforts(q[0], v[0], rest[0])
        assert (np.abs(true.joint_torque) <= of.joint_torque[0] * (1 + 1e-9)).all()
        for name in ("guardrail_force", "guardrail_torque"):
            share = np.linalg.norm(getattr(true, name)) / getattr(of, name)[0, 0]
            assert share <= 1 + 1e-9
            closest = max(closest, share)
    assert closest > 0.9


@pytest.mark.parametrize("rate", [0.3, 3.0])
def test_a_rod_that_turns_askew_shakes_the_base(cmbot_robot: Robot, rate: float) -> None:
    """Of an arm without mass but for a rod, at 45 degrees to the last joint's axis: w x J w is J w^2 / 2."""
    model, rest = cmbot_robot.model.copy(), np.zeros((1, 1, 7))
    rod = pin.utils.rotate("x", np.pi / 4) @ np.diag([1.0, 1.0, 0.0]) @ pin.utils.rotate("x", -np.pi / 4)
    for k in range(1, 8):
        model.inertias[k] = pin.Inertia(0.0, np.zeros(3), rod if k == 7 else np.zeros((3, 3)))
    robot, v = replace(cmbot_robot, model=model), rate * np.eye(7)[None, 6:]
    of = norm_bounds(robot, Ellipses(turn=rest, q=rest, v=v, a=rest))
    true = np.linalg.norm(Dynamics(robot).efforts(rest[0], v[0], rest[0]).guardrail_torque)
    assert true == pytest.approx(rate**2 / 2)
    assert true <= of.guardrail_torque[0, 0] <= rate**2 * (1 + 1e-9)


def test_motions_of_any_arm_are_within_what_is_bounded(any_arm: Robot, random_states: StateSamples) -> None:
    """Arms whose joints slide, too, and whose motors turn with them."""
    model = any_arm.model.copy()
    model.armature = np.full(any_arm.dof, 20.0)
    robot = replace(any_arm, model=model)
    q, v, a = random_states(robot, 4)
    x = QuinticTrajectory(t=np.arange(4.0), q=q, v=v, a=a)
    pieces = Pieces.between(x, np.empty(0)).halved(np.ones(3, dtype=np.bool_))
    holding = replace(robot, fixed_tool=pin.SE3(np.eye(3), FIXED_TOOL))
    of, held = (norm_bounds(each, pieces.ellipses) for each in (robot, holding))
    for k in range(len(pieces.start)):
        q, v, a = x.states(np.linspace(pieces.start[k], pieces.end[k], 50))[:3]
        efforts = Dynamics(robot).efforts(q, v, a)
        assert (np.abs(efforts.joint_torque) <= of.joint_torque[k, 0]).all()
        assert (np.linalg.norm(efforts.guardrail_torque, axis=1) <= of.guardrail_torque[k, 0]).all()
        for arm, bounds in ((robot, of), (holding, held)):
            points, J = Kinematics(arm).tool_point_jacobians(q)
            speeds = np.linalg.norm(np.einsum("kij,kj->ki", J, v), axis=1)
            assert (np.linalg.norm(points, axis=1) <= bounds.tool_point[k, 0]).all()
            assert (speeds <= bounds.tool_velocity[k, 0]).all()


def test_a_force_on_the_tool_has_the_stretched_arm_as_lever(cmbot_robot: Robot) -> None:
    """About the foot, of an arm at rest: more by the force than without one."""
    none = np.zeros((1, 1, 7))
    at_rest = Ellipses(turn=none, q=none, v=none, a=none)
    less, more = (
        norm_bounds(replace(cmbot_robot, tool_force=force), at_rest).guardrail_torque[0, 0]
        for force in ((0, 0, 0), FORCE)
    )
    lever = np.linalg.norm(cmbot_robot.base_point - cmbot_robot.foot_point) + cmbot_robot.reach
    assert more - less == pytest.approx(np.linalg.norm(FORCE) * lever, rel=1e-9)


def test_a_fixed_tool_moves_in_the_part_by_each_joint(any_arm: Robot, random_states: StateSamples) -> None:
    """As each joint alone, at a unit's rate, moves it there."""
    robot, none = replace(any_arm, fixed_tool=pin.SE3(np.eye(3), FIXED_TOOL)), np.zeros((1, 1, any_arm.dof))
    q = random_states(robot, 1)[0]
    _, J = Kinematics(robot).tool_point_jacobians(q)
    for column, rate in zip(J[0].T, np.eye(robot.dof), strict=True):
        on = Ellipses(turn=none, q=np.abs(q)[None], v=rate[None, None], a=none)
        assert np.linalg.norm(column) <= norm_bounds(robot, on).tool_velocity[0, 0] * (1 + 1e-9)


def test_a_slide_lengthens_the_lever_of_all_weights(tmp_path: Path) -> None:
    """Of an arm at rest on its rail: the torque about O0 grows by the weight times the way along the rail."""
    robot, none = robot_of(rail_scene(tmp_path)), np.zeros((1, 1, 7))
    weight = 9.81 * sum(body.mass for body in list(robot.model.inertias)[1:])
    for rail, others in ((0.6, 0.0), (0.6, 0.3), (0.0, 0.3)):
        q = np.where(np.arange(7) == 0, rail, others * ~robot.limits.prismatic)[None, None]
        moved, middle = (
            norm_bounds(robot, Ellipses(turn=none, q=at, v=none, a=none)).guardrail_torque[0, 0]
            for at in (q, none)
        )
        assert moved - middle == pytest.approx(weight * rail, rel=1e-9, abs=1e-9)


def test_the_timed_orientation_is_bounded_where_an_arc_is_rolled_on_a_cylinder() -> None:
    """An arc of 3 m on a pipe: the tool's angle about it is r / R times the cosine of that along the arc."""
    radius, pipe = 3.0, 0.5
    arc = Arc(np.zeros(3), np.eye(3)[2], np.array([radius, 0, 0]), 2.0)
    curve = CylinderCurve(arc, np.eye(4), pipe, np.eye(3))
    leg = Segment(curve=curve, seconds=3.0, law=SpeedProfile(kind="jerk_limited", ramp=0.3).law)
    path = ToolPath(segments=(leg,), orientation=np.eye(3))
    rest = np.zeros((2, 1))
    pieces = Pieces.between(QuinticTrajectory(t=np.array([0.0, 3.0]), q=rest, v=rest, a=rest), path.breaks)
    of, closest = timed_pose_bounds(path, pieces)[1], np.inf
    x = np.cos(np.pi * np.arange(pieces.times.shape[1])[::-1] / (pieces.times.shape[1] - 1))
    around = np.exp(1j * np.linspace(0, 2 * np.pi, 48, endpoint=False))
    for k, times in enumerate(pieces.times):
        angle = path.arc_angle(times, np.full_like(times, pieces.middle[k]))[0]
        fit = np.polynomial.chebyshev.chebfit(x, angle, 9)
        for r, rho in enumerate(_ELLIPSE_SUMS):
            complex_angle = np.polynomial.chebyshev.chebval(0.5 * (rho * around + 1 / (rho * around)), fit)
            if np.abs(complex_angle.imag).max() < 3.0:
                turned = np.abs((radius / pipe * np.cos(complex_angle)).imag).max()
                assert turned <= np.log(of[k, r]) * (1 + 1e-6) + 1e-6
                closest = min(closest, np.log(of[k, r]) / turned)
    assert closest < 1.5
