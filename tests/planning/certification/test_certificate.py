"""The certificate: it holds for plans, notices every kind of tampering, bounds what lies between samples."""

from __future__ import annotations

import ast
import re
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import chang2021_arm
from small_scenes import short_scene, tool_points, with_corners

import cmbot
from cmbot.accuracy import Sway
from cmbot.collision import Box, Clearances, Obstacle
from cmbot.common.errors import InputError, LimitViolation
from cmbot.common.poses import pose
from cmbot.planning import Plan, QuinticTrajectory, bending_arm, plan
from cmbot.planning.certification.certificate import (
    Certificate,
    Check,
    certify,
    continuity_check,
    posture_checks,
)
from cmbot.planning.certification.metrics import Samples, figures, measure
from cmbot.robot import Dynamics, Efforts, Kinematics, Robot, load_robot
from cmbot.simulation import Tracking
from cmbot.trajectory import Parametrization, SparseSplines, SplineSpace

FloatArray = NDArray[np.float64]
QUANTITIES = (
    "distance of * from the middle of its range",
    "velocity of *",
    "acceleration of *",
    "jerk of *",
    "torque of *",
    "jump of a joint's position, velocity, acceleration or jerk",
    "clearance",
    "difference of the trajectory's times from the tool path's",
    "distance of the tool from its place at a via-point",
    "rotation of the tool from its orientation at a via-point",
    "tool deviation",
    "tool rotation",
    "tool lag",
    "torque that climb_1 holds",
    "torque that climb_2 holds",
)
START = "distance of the start from the posture required there"


@pytest.fixture(scope="module")
def short_plan() -> Plan:
    scene = short_scene(obstacles=[{"name": "plate", "box": [0.5, 0.02, 0.5], "xyz": [2.3, 0.6, -2.06]}])
    return plan(scene, options=replace(scene.planner, samples_per_segment=20, max_tool_deviation_m=0.003))


def again(planned: Plan, **changes: Any) -> Certificate:
    """Certify a plan again, after tampering."""
    robot = changes.pop("robot", planned.robot)
    obstacles = changes.pop("obstacles", planned.scene.all_obstacles)
    arguments: dict[str, Any] = {
        "task": planned.task,
        "trajectory": planned.trajectory,
        "via_points": planned.scene.strokes[0].via_points,
        "options": planned.options,
        "start": planned.scene.posture if planned.start.moved == 0 else None,
    } | changes
    return certify(robot=robot, clearances=Clearances(robot, obstacles), **arguments)


def broken(certificate: Certificate) -> dict[str, Check]:
    """Checks that do not hold, by the first word of their quantity."""
    failed = [check for check in certificate.checks if not check.holds]
    if failed:
        with pytest.raises(LimitViolation) as caught:
            certificate.require()
        assert caught.value.quantity == failed[0].quantity
        assert (caught.value.time, caught.value.bound) == (failed[0].time, failed[0].bound)
        np.testing.assert_equal(caught.value.value, failed[0].value)
    return {check.quantity.split(" of ")[0]: check for check in failed}


@pytest.mark.parametrize("name", ["triangle_plan", "fixed_triangle_plan", "fixed_line_plan", "short_plan"])
def test_plans_hold(name: str, request: pytest.FixtureRequest) -> None:
    planned: Plan = request.getfixturevalue(name)
    certificate = planned.certificate
    assert certificate.holds
    certificate.require()
    joints = planned.robot.joints
    got = [check.quantity for check in certificate.checks]
    assert (START in got) == (planned.start.moved == 0)
    # Of the bent arm's tool where sag is compensated, which it is by default.
    expected = "expected " if planned.compensation is not None else ""
    assert any(each.startswith("expected ") for each in got) == bool(expected)
    got = [re.sub("^clearance of .+ from .+$", "clearance", each.removeprefix(expected)) for each in got]
    for quantity, pattern in zip([each for each in got if each != START], QUANTITIES, strict=True):
        assert quantity in {pattern.replace("*", joint) for joint in joints}


def test_certifying_again_finds_the_same(short_plan: Plan) -> None:
    assert again(short_plan) == short_plan.certificate


@pytest.mark.parametrize(("name", "order"), [("velocity", 1), ("acceleration", 2), ("jerk", 3)])
def test_time_that_is_run_too_fast(short_plan: Plan, name: str, order: int) -> None:
    """Scaled until just this bound is passed by a thousandth; then also where, and by how much."""
    x = short_plan.trajectory
    bound = getattr(short_plan.robot.limits, name)
    use = (x.extrema(order).largest()[0] / bound).max()
    speed = (1.001 / use) ** (1 / order)
    faster = QuinticTrajectory(t=x.t / speed, q=x.q, v=x.v * speed, a=x.a * speed**2)
    failed = broken(again(short_plan, trajectory=faster))
    assert name in failed
    check = failed[name]
    assert check.value / check.bound == pytest.approx(1.001)
    joint = short_plan.robot.joints.index(check.quantity.split(" of ")[1])
    assert abs(faster.evaluate([check.time], order)[0, joint]) == pytest.approx(check.value, rel=1e-6)
    slower = QuinticTrajectory(t=x.t * 1.5, q=x.q, v=x.v / 1.5, a=x.a / 1.5**2)
    assert name not in broken(again(short_plan, trajectory=slower))


@pytest.mark.parametrize(("shift", "holds"), [(1e-8, True), (2e-6, False)])
def test_a_via_point_that_was_shifted(short_plan: Plan, shift: float, holds: bool) -> None:
    x = short_plan.trajectory
    q = x.q.copy()
    q[3, 2] += shift
    certificate = again(short_plan, trajectory=QuinticTrajectory(t=x.t, q=q, v=x.v, a=x.a))
    (check,) = (check for check in certificate.checks if "its place at a via-point" in check.quantity)
    assert check.holds is holds
    assert check.time == x.t[3]
    poses = [Kinematics(short_plan.robot).tool_pose(each[3]).translation for each in (q, x.q)]
    assert check.value == pytest.approx(np.linalg.norm(poses[0] - poses[1]), rel=1e-3)


def test_a_kink(short_plan: Plan) -> None:
    """Another acceleration at one knot: only the jerk jumps there."""
    x = short_plan.trajectory
    a = x.a.copy()
    a[4, 1] += 1e-6
    failed = broken(again(short_plan, trajectory=QuinticTrajectory(t=x.t, q=x.q, v=x.v, a=a)))
    assert list(failed) == ["jump"]
    check = failed["jump"]
    bent = QuinticTrajectory(t=x.t, q=x.q, v=x.v, a=a)
    jumps = np.abs(bent.jumps(3) / short_plan.robot.limits.jerk)
    assert check.value == pytest.approx(jumps.max() / 1e-9, rel=1e-3)
    # The neighbouring knots feel it too.
    assert check.time in x.t[3:6]


@pytest.mark.parametrize(("kept", "end"), [(slice(1, None), 0), (slice(None, -1), -1)])
def test_ends_that_do_not_rest(short_plan: Plan, kept: slice, end: int) -> None:
    """Without its first or last segment a plan is as smooth as before, but starts or stops with a jolt."""
    x = short_plan.trajectory
    cut = QuinticTrajectory(t=x.t[kept], q=x.q[kept], v=x.v[kept], a=x.a[kept])
    failed = broken(again(short_plan, trajectory=cut))
    assert {"jump", "difference"} <= set(failed)
    assert failed["jump"].time == cut.t[end]


@pytest.mark.parametrize("order", [1, 2])
def test_a_short_segment_allows_no_more_than_its_own_rounding(short_plan: Plan, order: int) -> None:
    """The last digits of a jerk over 1e-5 s are no allowance for a rate, nor for other segments."""
    x = short_plan.trajectory
    t = np.concatenate([[0.0, 1e-5], x.t[1:]])
    q, v, a = (np.array(each) for each in x.states(t))
    assert "jump" not in broken(again(short_plan, trajectory=QuinticTrajectory(t=t, q=q, v=v, a=a)))
    (v, a)[order - 1][0] += 1e-4
    assert "jump" in broken(again(short_plan, trajectory=QuinticTrajectory(t=t, q=q, v=v, a=a)))
    a = x.a.copy()
    a[5, 1] += 1e-6
    q, v, a = (
        np.insert(each, 1, other, axis=0) for each, other in zip((x.q, x.v, a), x.states([1e-5]), strict=True)
    )
    failed = broken(again(short_plan, trajectory=QuinticTrajectory(t=t, q=q, v=v, a=a)))
    assert failed["jump"].time in x.t[4:7]


def test_dense_knots_are_smooth_as_far_as_their_digits_go(cmbot_robot: Robot) -> None:
    """A last digit of a position is a jump of the jerk, and nothing that could be felt; more is a jump."""
    t = np.linspace(0, 10, 1001)
    space, via_points = SplineSpace(t), np.sin(np.outer(t, np.linspace(0.2, 1.0, 7)))
    limits = cmbot_robot.limits
    splines = SparseSplines(space, np.stack([limits.velocity, limits.acceleration, limits.jerk]))
    # As plans are made; solved for the whole path at once, twice as many digits would be lost.
    smooth = Parametrization(splines, via_points, splines.least_jerk(via_points)).trajectory
    check = continuity_check(cmbot_robot, smooth)
    assert 1e-3 < check.value <= check.bound == 1.0
    a = smooth.a.copy()
    a[500, 2] += 1e-6
    assert not continuity_check(cmbot_robot, replace(smooth, a=a)).holds


def test_a_joint_beyond_its_range(short_plan: Plan) -> None:
    furthest = short_plan.trajectory.extrema(0).value.max(axis=(0, 2))
    limits = replace(short_plan.robot.limits, upper=furthest - 1e-6)
    failed = broken(again(short_plan, robot=replace(short_plan.robot, limits=limits)))
    assert list(failed) == ["distance"]
    assert "range" in failed["distance"].quantity


def test_an_obstacle_in_the_way(short_plan: Plan) -> None:
    # Where the tool passes: nothing of the certificate but the clearance knows of it.
    middle = short_plan.task.path.position([2.0])[0]
    post = Obstacle(name="post", shape=Box(size=(0.01, 0.01, 0.01)), X_WO=pose(middle))
    failed = broken(again(short_plan, obstacles=(*short_plan.scene.all_obstacles, post)))
    assert list(failed) == ["clearance"]
    assert failed["clearance"].quantity.endswith(" from post")
    assert failed["clearance"].at_least
    assert failed["clearance"].time == pytest.approx(2.0, abs=0.2)
    assert failed["clearance"].bound == short_plan.options.safety_margin_m


def test_a_load_that_is_too_heavy(short_plan: Plan) -> None:
    failed = broken(again(short_plan, robot=load_robot("cmbot", payload=25.0)))
    assert list(failed) == ["torque", "torque that climb_1 holds"]


@pytest.mark.parametrize(("name", "k"), [("start", 0), ("end", -1)])
def test_a_posture_that_is_required_at_an_end(short_plan: Plan, name: str, k: int) -> None:
    x, ends = short_plan.trajectory, {"start": None, "end": None}
    for off in (0.0, 1e-6):
        required = ends | {name: x.q[k] - off * np.eye(7)[2]}
        (check,) = posture_checks(short_plan.robot, x, **required)
        assert check.holds == (off == 0.0)
        assert check.quantity == f"distance of the {name} from the posture required there"
        assert (check.time, check.unit) == (x.t[k], "rad")
        assert check.value == pytest.approx(off)


def test_another_tool_path(short_plan: Plan) -> None:
    path = short_plan.task.path
    corners = path.corners + np.array([[0, 0, 0], [0, 0, 0.02]])
    failed = broken(again(short_plan, task=replace(short_plan.task, path=with_corners(path, corners))))
    assert set(failed) == {"distance", "tool deviation"}
    assert failed["tool deviation"].value == pytest.approx(0.02, rel=0.1)
    assert failed["tool deviation"].time == pytest.approx(4.0, abs=0.5)


@pytest.mark.parametrize("quantity", ["tool deviation", "tool rotation", "tool lag"])
def test_bounds_of_the_tool_are_met_to_the_last_digits(short_plan: Plan, quantity: str) -> None:
    """The value holds for all times and is no more than a millionth, or 1e-7 m or rad, above what occurs."""
    (check,) = (check for check in short_plan.certificate.checks if check.quantity == quantity)
    t = np.linspace(0, short_plan.trajectory.t[-1], 40_001)
    motion = [short_plan.trajectory.evaluate(t, order) for order in range(4)]
    clearance = np.zeros_like(t)
    clearances = Clearances(short_plan.robot, ())
    samples = measure(short_plan.robot, short_plan.task, clearances, t, motion, clearance=clearance)
    largest = getattr(samples, quantity.replace(" ", "_")).max()
    assert largest <= check.value <= largest + 1e-7


@pytest.mark.parametrize("name", ["velocity", "acceleration", "jerk", "torque"])
def test_the_joint_that_is_over_its_bound_is_named(short_plan: Plan, name: str) -> None:
    bound = getattr(short_plan.robot.limits, name).copy()
    bound[3] *= 1e-6
    limits = replace(short_plan.robot.limits, **{name: bound})
    failed = broken(again(short_plan, robot=replace(short_plan.robot, limits=limits)))
    assert set(failed) in ({name}, {name, "jump"})
    assert failed[name].quantity == f"{name} of joint_4"
    assert failed[name].bound == bound[3]


@pytest.mark.parametrize(("share", "holds"), [(0.999, False), (1.001, True)])
def test_a_bound_of_the_torque_on_the_base(short_plan: Plan, share: float, holds: bool) -> None:
    peak = short_plan.figures.peak_guardrail_torque
    certificate = again(short_plan, task=replace(short_plan.task, max_base_torque=share * peak))
    assert set(broken(certificate)) == (set() if holds else {"torque on the base"})
    (check,) = (each for each in certificate.checks if each.quantity == "torque on the base")
    assert (check.value, check.bound) == (certificate.guardrail_torque_bound, share * peak)
    there = Dynamics(short_plan.robot).efforts(*short_plan.trajectory.states([check.time]))
    assert np.linalg.norm(there.guardrail_torque) == pytest.approx(peak, rel=1e-5)


def test_a_tool_that_may_turn(short_plan: Plan) -> None:
    """Its point is on the last joint's axis: turned there, it only misses its orientation, if one is kept."""
    x = short_plan.trajectory
    turned = {"trajectory": replace(x, q=x.q + 0.2 * np.eye(7)[6]), "start": None}
    assert {"rotation", "tool rotation"} <= set(broken(again(short_plan, **turned)))
    certificate = again(short_plan, **turned, task=replace(short_plan.task, keep="position"))
    assert not {"rotation", "tool rotation"} & set(broken(certificate))
    assert certificate.figures.max_tool_rotation == 0.0


@pytest.mark.parametrize(("joint", "tilt"), [(6, 0.0), (5, 0.2)])
def test_a_tool_that_may_lean(short_plan: Plan, joint: int, tilt: float) -> None:
    """By 0.2 rad about another joint, out of its cone; about its own axis, the last joint's, not at all."""
    x = short_plan.trajectory
    turned = {"trajectory": replace(x, q=x.q + 0.2 * np.eye(7)[joint]), "start": None}
    certificate = again(short_plan, **turned, task=replace(short_plan.task, keep="position", cone=0.1))
    (check,) = (each for each in certificate.checks if each.quantity.startswith("tool tilt"))
    assert (check.bound, check.holds) == (0.1, tilt < 0.1)
    # Between via-points the plan itself is off by less.
    assert check.value == pytest.approx(tilt, abs=1e-4)
    assert not [each for each in certificate.checks if each.quantity.startswith("rotation of the tool")]


def test_speed_and_sway_of_the_bent_tool(compensated_short: tuple[Plan, Tracking]) -> None:
    """The speed by differences of the bent tool's place, the sway by the simulation of all that bends."""
    made, simulated = compensated_short
    assert made.sag is not None
    task = replace(made.task, max_speed=1.0, max_sway=1e-3)
    options = replace(made.options, quiet_stiffness_share=0.0)
    arm = bending_arm(made.scene, made.robot)
    certificate = again(made, task=task, options=options, sag=made.sag, arm=arm)
    assert certificate.holds
    checks = {check.quantity: check for check in certificate.checks}
    t = np.linspace(0, made.trajectory.duration, 8001)
    q = made.trajectory.evaluate(t)
    steps = np.diff(tool_points(made.robot, q) + made.sag.at(q).tool, axis=0)
    speed = np.linalg.norm(steps, axis=1).max() / t[1]
    assert checks["expected tool speed"].value == pytest.approx(speed, rel=1e-5)
    motion = simulated.planned
    sway = np.linalg.norm(motion.error - motion.static, axis=1)
    check = checks["simulated sway of the tool"]
    # Small vibrations about the sagging arm: linear, in other steps.
    assert check.value == pytest.approx(sway.max(), rel=0.05)
    assert check.time == pytest.approx(motion.t[sway.argmax()], abs=0.02)
    less = replace(task, max_speed=0.99 * speed, max_sway=0.9 * check.value)
    failed = broken(again(made, task=less, options=options, sag=made.sag, arm=arm))
    assert set(failed) == {"expected tool speed", "simulated sway"}
    assert failed["simulated sway"].bound == less.max_sway


def test_numbers_that_are_none(short_plan: Plan) -> None:
    """They cannot get into a trajectory; from anywhere else they break what they are compared in."""
    x = short_plan.trajectory
    with pytest.raises(InputError, match="finite"):
        QuinticTrajectory(t=x.t, q=np.full_like(x.q, np.nan), v=x.v, a=x.a)
    away = with_corners(short_plan.task.path, np.full_like(short_plan.task.path.corners, np.nan))
    failed = broken(again(short_plan, task=replace(short_plan.task, path=away)))
    assert {"tool deviation", "tool lag", "distance"} <= set(failed)
    nothing = Check(quantity="x", time=0.0, value=np.nan, bound=1.0, unit="")
    assert not nothing.holds
    assert not replace(nothing, at_least=True).holds
    assert replace(nothing, value=1.0).holds
    assert replace(nothing, value=1.0, at_least=True).holds


def test_bounds_are_rounded_away_from_what_was_found(short_plan: Plan) -> None:
    certificate = replace(
        short_plan.certificate,
        clearance_bound=0.02349,
        guardrail_torque_bound=411.111,
        adhesion_bound=12341.0,
    )
    assert certificate.at_all_times("base") == (
        "clearance stays above 23.4 mm, the torque on the base below 411.12 Nm and "
        "the adhesion needed below 12.35 kN"
    )
    bounds = {"guardrail_torque_bound": np.inf, "adhesion_bound": np.inf}
    assert replace(certificate, **bounds).at_all_times() == "clearance stays above 23.4 mm"


def test_figures_by_hand(triangle_plan: Plan) -> None:
    """The paper's recursion, typed in again, at 400 times a segment."""
    x = triangle_plan.trajectory
    grid = np.append(np.linspace(x.t[:-1], x.t[1:], 400, endpoint=False, axis=1).ravel(), x.t[-1])
    q, v, a = x.states(grid)
    tau, n_0, _ = chang2021_arm.efforts(q, v, a)
    norm = np.linalg.norm(n_0, axis=1)
    certificate, figures = triangle_plan.certificate, triangle_plan.figures
    assert figures.peak_guardrail_torque == pytest.approx(norm.max(), rel=1e-6)
    assert norm.max() <= certificate.guardrail_torque_bound <= norm.max() * (1 + 2e-6)
    assert figures.mean_guardrail_torque == pytest.approx(np.trapezoid(norm, grid) / 20, rel=1e-7)
    assert figures.rms_guardrail_torque**2 == pytest.approx(np.trapezoid(norm**2, grid) / 20, rel=1e-7)
    static = np.linalg.norm(chang2021_arm.efforts(q, 0 * v, 0 * a)[1], axis=1)
    assert figures.peak_static_guardrail_torque == pytest.approx(static.max(), rel=1e-6)
    share = np.abs(tau) / triangle_plan.robot.limits.torque
    assert figures.limit_use.torque == pytest.approx(share.max(), rel=2e-6)
    (check,) = (check for check in certificate.checks if check.quantity.startswith("torque of"))
    assert check.value >= share.max() * check.bound
    at = np.abs(grid - check.time).argmin()
    assert np.abs(tau[at]).max() == pytest.approx(check.value, rel=1e-4)


def test_figures_of_samples_are_those_of_the_certificate(short_plan: Plan) -> None:
    """Two computations of the same: of dense samples, and of enclosures."""
    robot, x = short_plan.robot, short_plan.trajectory
    t = np.union1d(np.linspace(x.t[0], x.t[-1], 4001), x.t)
    motion = [x.evaluate(t, order) for order in range(4)]
    samples = measure(robot, short_plan.task, Clearances(robot, short_plan.scene.all_obstacles), t, motion)
    got, expected = asdict(figures(robot, samples)), asdict(short_plan.certificate.figures)
    for part in ("limit_use", "adhesion_needed"):
        one, other = got.pop(part), expected.pop(part)
        assert one.pop("mode", "") == other.pop("mode", "")
        assert one == pytest.approx(other, rel=1e-4, abs=1e-3)
    assert got == pytest.approx(expected, rel=1e-4, abs=1e-7)


def test_a_force_of_which_a_share_acts_is_a_smaller_force(short_plan: Plan) -> None:
    x, force = short_plan.trajectory, np.array([30.0, -20.0, -50.0])
    t = np.linspace(0.0, x.duration, 5)
    motion = [x.evaluate(t, order) for order in range(4)]
    pushed = replace(short_plan.robot, tool_force=tuple(force))

    def measured(robot: Robot, share: FloatArray | None) -> Samples:
        return measure(
            robot, short_plan.task, Clearances(robot, ()), t, motion, clearance=np.zeros(5), share=share
        )

    for share in (np.array([0.0, 0.25, 1.0, 0.5, 0.0]), np.zeros(5)):
        got = measured(pushed, share)
        for k, part in enumerate(share):
            alone = measured(replace(pushed, tool_force=tuple(part * force)), None)
            for name in ("joint_torque", "guardrail_force", "guardrail_torque"):
                np.testing.assert_allclose(
                    getattr(got, name)[k], getattr(alone, name)[k], rtol=1e-9, atol=1e-9
                )


def test_the_first_pair_of_shapes_is_named_too(short_plan: Plan) -> None:
    """Of an arm with one shape and one obstacle."""
    whole = short_plan.robot.collision_model
    (shape,) = (x for x in whole.geometryObjects if x.parentJoint == short_plan.robot.dof)
    (plate,) = (x for x in short_plan.scene.all_obstacles if x.name == "plate")
    alone = type(whole)()
    alone.addGeometryObject(shape)
    robot = replace(short_plan.robot, collision_model=alone)
    certificate = again(short_plan, robot=robot, obstacles=[plate])
    (check,) = (check for check in certificate.checks if check.quantity.startswith("clearance"))
    assert check.quantity == "clearance of tool from plate"


def test_a_motion_that_is_absurdly_fast_is_not_looked_at_closely(
    short_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its rates are broken a million times: what else is found are bounds all the same, but coarse ones."""
    x, asked = short_plan.job.strokes[0].trajectory, list[int]()

    def counting(dynamics: Dynamics, q: FloatArray, *rates: FloatArray) -> Efforts:
        asked.append(len(q))
        return efforts(dynamics, q, *rates)

    efforts = Dynamics.efforts
    monkeypatch.setattr(Dynamics, "efforts", counting)
    certificate = again(short_plan, trajectory=replace(x, v=1e6 * x.v, a=1e6 * x.a))
    assert not certificate.holds
    assert max(asked) <= 20 * len(x.t)
    assert certificate.clearance_bound <= certificate.figures.min_clearance
    assert certificate.guardrail_torque_bound >= certificate.figures.peak_guardrail_torque


@pytest.mark.parametrize("growth", [-1e-4, 1e-4])
def test_sway_between_the_steps_of_its_simulation_counts(
    short_plan: Plan, monkeypatch: pytest.MonkeyPatch, growth: float
) -> None:
    """A harmonic sway whose peaks lie in the middle between two steps, largest at one end of its time."""
    last = short_plan.trajectory.t[-1]
    t = np.linspace(0.0, last + 2.0, 24 * 12 + 1)
    wave = np.cos(np.pi / 12 * (np.arange(len(t)) + 0.5)) * (1 + growth * t)
    tool = np.multiply.outer(wave, [0.6e-3, 0.0, 0.8e-3])
    sway = Sway(t=t, tool=np.stack([0.5 * tool, tool, 0.2 * tool]))
    assert sway.largest[0] < 0.993e-3
    monkeypatch.setattr("cmbot.planning.certification.certificate.stroke_sway", lambda *_: sway)
    task = replace(short_plan.task, max_sway=3e-3)
    checks = {check.quantity: check for check in again(short_plan, task=task, arm=object()).checks}
    at_work, after = (
        checks[f"simulated {name}"] for name in ("sway of the tool", "swing of the tool after the stop")
    )
    assert at_work.value == pytest.approx(1e-3, rel=1e-3)
    assert after.value == pytest.approx(2e-3, rel=1e-3)
    assert at_work.time == (last if growth > 0 else t[0])
    assert after.time == last
    assert at_work.bound == after.bound == 3e-3


def test_sway_is_judged_of_what_bends_where_it_is_bounded(short_plan: Plan) -> None:
    for changes in ({"arm": object()}, {"task": replace(short_plan.task, max_sway=1e-3)}):
        assert again(short_plan, **changes) == short_plan.certificate


def test_a_stiffness_that_is_hardly_known_is_part_of_the_deviation(short_plan: Plan) -> None:
    """A sag of no size whose standard deviation is 1 mm across the path, which is along y."""
    sag: Any = SimpleNamespace(
        covariance=np.eye(1),
        following=lambda q: np.zeros((len(q), 3)),
        spread=lambda q: np.tile(np.diag([1e-6, 0.04, 0.0]), (len(q), 1, 1)),
    )
    options = replace(short_plan.options, deviation_sigmas=2.5)
    checks = {check.quantity: check for check in again(short_plan, options=options, sag=sag).checks}
    name, expected = (
        "tool deviation within {} standard deviations of the stiffness",
        "expected tool deviation",
    )
    check = checks[name.format("2.5")]
    assert check.value == pytest.approx(checks[expected].value + 2.5e-3, rel=1e-6)
    assert (check.bound, check.unit) == (options.max_tool_deviation_m, "m")
    # Nothing is said where no covariance is known, nor where none is asked for.
    sure = SimpleNamespace(**{**vars(sag), "covariance": None})
    for known, sigmas in ((sure, 2.5), (sag, 0.0)):
        said = again(short_plan, options=replace(options, deviation_sigmas=sigmas), sag=known).checks
        assert not [each for each in said if "standard deviations" in each.quantity]


@pytest.mark.parametrize("samples", [4, 400])
def test_the_resolution_is_not_an_option(short_plan: Plan, samples: int) -> None:
    options = replace(short_plan.options, samples_per_segment=samples)
    assert again(short_plan, options=options) == short_plan.certificate


def test_certificate_of_an_arm_without_shapes(short_plan: Plan) -> None:
    """Nothing can be hit, so no distance is small."""
    bare: Robot = replace(short_plan.robot, collision_model=type(short_plan.robot.collision_model)())
    certificate = again(short_plan, robot=bare)
    assert certificate.holds
    assert np.isposinf([certificate.clearance_bound, certificate.figures.min_clearance]).all()


def imported_by(module: str, seen: set[str]) -> set[str]:
    """Modules of the package that a module's source names in its imports, and theirs, and so on."""
    root = Path(cmbot.__file__).parent
    file = root.joinpath(*module.split(".")[1:]).with_suffix(".py")
    if module in seen or not file.exists():
        return seen
    seen.add(module)
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("cmbot."):
            imported_by(node.module, seen)
    return seen


def test_the_certificate_leans_on_nothing_that_made_the_plan() -> None:
    imported = imported_by("cmbot.planning.certification.certificate", set())
    method = {
        name
        for name in imported
        if name.startswith(("cmbot.planning", "cmbot.optimization", "cmbot.trajectory"))
        and not name.startswith("cmbot.planning.certification.")
    }
    assert method <= {
        "cmbot.planning.task",
        "cmbot.trajectory.enclosure",
        "cmbot.trajectory.polynomials",
        "cmbot.trajectory.quintic",
    }
    # The walk itself works: what makes a plan does lean on the solver.
    assert "cmbot.optimization.slsqp" in imported_by("cmbot.optimization.exchange", set())
