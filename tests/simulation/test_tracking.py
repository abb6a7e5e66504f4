"""Plans simulated: rigid limits, rest, initial conditions, options, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from small_motions import arm_on_its_guardrail, swing, track
from small_scenes import parts, short_scene

import cmbot
from cmbot.common.errors import InputError, SimulationDiverged
from cmbot.elastic import elastic_base
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan, ToolTask
from cmbot.robot import Kinematics, Robot
from cmbot.scene import Scene, load_scene
from cmbot.simulation import (
    SimulationOptions,
    Tracking,
    base_movement,
    interval_rows,
    simulate,
    tracking as tracking_module,
    tracking_remarks,
    tracking_rows,
)
from cmbot.simulation.tracking import MotionTracking, elastic_arm_of
from cmbot.trajectory import QuinticTrajectory

OPTIONS = SimulationOptions()


def planned_motion(plan: Plan, **changes: Any) -> MotionTracking:
    """What `simulate` finds for the planned motion, without the baseline's."""
    options = replace(OPTIONS, **changes)
    motion = plan.trajectory
    return track(elastic_arm_of(plan, options), plan.task, motion, options, sag=plan.sag)


def baseline_motion(plan: Plan, **changes: Any) -> MotionTracking:
    options = replace(OPTIONS, **changes)
    motion = QuinticTrajectory.through(plan.baseline.samples.t, plan.baseline.samples.q)
    return track(elastic_arm_of(plan, options), plan.task, motion, options)


@pytest.fixture
def tracking(short_tracking: Tracking) -> Tracking:
    return short_tracking


@pytest.fixture(scope="module")
def task() -> ToolTask:
    return parts(short_scene())[1]


def test_both_motions_are_simulated_to_the_end_and_beyond(tracking: Tracking, short_plan: Plan) -> None:
    assert tracking.options == replace(OPTIONS, stiffness_share=0.3, damping=0.01)
    assert tracking.seconds > 0
    for motion in (tracking.baseline, tracking.planned):
        assert motion.stop == short_plan.trajectory.duration
        np.testing.assert_allclose(motion.t, 0.005 * np.arange(1201), atol=1e-12)
        for array in (motion.error, motion.static, motion.command, motion.path_error):
            assert array.shape == (1201, 3)
            assert np.isfinite(array).all()
        np.testing.assert_array_equal(motion.dynamic, motion.error - motion.static)


def test_the_error_starts_at_the_sag_and_follows_it(tracking: Tracking, short_plan: Plan) -> None:
    arm = elastic_arm_of(short_plan, OPTIONS)
    motion, q = tracking.planned, short_plan.trajectory.evaluate(np.linspace(0, 4, 81))
    tool = Sag(arm).at(q).tool
    np.testing.assert_allclose(motion.static[:801:10], tool, atol=1e-7)
    np.testing.assert_allclose(motion.static[800:], np.tile(tool[-1], (401, 1)), atol=1e-12)
    np.testing.assert_allclose(motion.error[0], tool[0], atol=1e-12)
    assert np.linalg.norm(tool, axis=1).min() > 3e-3
    assert np.abs(motion.dynamic).max() < 0.5 * np.abs(motion.static).max()
    # The trajectory is driven as it is.
    again = track(arm, short_plan.task, short_plan.trajectory, OPTIONS)
    np.testing.assert_array_equal(again.error, motion.error)


def test_the_sag_of_a_slow_motion_is_computed_less_often(
    short_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, given, counts = elastic_arm_of(short_plan, OPTIONS), short_plan.trajectory, list[int]()
    following = Sag.following

    def counted(self: Sag, q: np.ndarray) -> np.ndarray:
        counts.append(len(q))
        return following(self, q)

    monkeypatch.setattr(Sag, "following", counted)
    for factor in (1.0, 20.0):
        slow = replace(given, t=factor * given.t, v=given.v / factor, a=given.a / factor**2)
        t = np.linspace(0.0, slow.t[-1], 50)
        found = tracking_module._sag(arm, slow, t)
        np.testing.assert_allclose(found, Sag(arm).at(slow.evaluate(t)).tool, rtol=0, atol=1e-8)
    assert counts[1] < 0.2 * t[-1] / 0.02


def test_the_base_gives_way_to_the_wrench_on_it_as_its_stiffness_says(
    tracking: Tracking, short_plan: Plan
) -> None:
    moved, guardrail = tracking.planned.base, elastic_base(short_plan.scene.elastic_guardrail)
    assert moved is not None
    assert guardrail is not None
    model, data = short_plan.robot.model, short_plan.robot.model.createData()
    pin.centerOfMass(model, data, short_plan.trajectory.q[0])
    # The arm, and the climber, which the model holds still.
    bodies = ((data.mass[0], data.com[0]), (model.inertias[0].mass, model.inertias[0].lever))
    wrench = np.zeros(6)
    for mass, centre in bodies:
        weight = mass * model.gravity.linear
        wrench += np.concatenate([weight, np.cross(centre - short_plan.robot.foot_point, weight)])
    expected = np.linalg.solve(guardrail.stiffness, wrench)
    # At rest in its first posture; the loads of the bent arm are a little different.
    for part in (slice(3), slice(3, 6)):
        assert moved[0, part] == pytest.approx(expected[part], abs=0.03 * np.abs(expected[part]).max())
    borne = short_plan.samples.guardrail_torque[0]
    assert moved[0, 6:] == pytest.approx(borne, abs=0.03 * np.linalg.norm(borne))


def test_a_mast_moves_at_its_end_and_bears_what_handbooks_say() -> None:
    """A cantilever with a force and a moment at its end, wherever W is: at the clamp, or at the end."""
    L, EI = 1.6, 70e9 * np.pi / 64 * (0.09**4 - 0.08**4)
    found = []
    for floor in (0.0, -L):
        plan = cmbot.plan(on_a_mast(floor, L), progress=False)
        tracking = simulate(plan, replace(OPTIONS, settle_s=1.0), progress=False)
        assert tracking.planned.base is not None
        base, torque = np.split(tracking.planned.base, [6], axis=1)
        found.append(base[0])
        dx, dy, _, rx, ry, _ = base.T
        ends = [
            np.stack([-6 * EI / L**2 * dy - 2 * EI / L * rx, 6 * EI / L**2 * dx - 2 * EI / L * ry], axis=1),
            np.stack([6 * EI / L**2 * dy + 4 * EI / L * rx, -6 * EI / L**2 * dx + 4 * EI / L * ry], axis=1),
        ]
        still = plan.robot.model.inertias[0]
        weight = np.cross(still.lever, still.mass * plan.robot.model.gravity.linear)
        expected = ends[0 if floor == 0 else 1] - weight[:2]
        np.testing.assert_allclose(torque[:, :2], expected, atol=2e-3 * np.abs(expected).max())
        after = torque[tracking.planned.t > tracking.planned.stop]
        assert np.ptp(after, axis=0).max() > 1e-3
        said = base_movement(plan, tracking)
        assert f"at (0, 0, {floor + L:g}) m, the mast moves by up to" in said
        assert f"up to {np.linalg.norm(torque[: -len(after)], axis=1).max():.2f} Nm about (0, 0, 0) m" in said
    # Rotations are of first order about the origin of W.
    np.testing.assert_allclose(found[0], found[1], atol=0.01 * np.abs(found[0]).max())


def on_a_mast(floor: float, length: float) -> Scene:
    """A Panda on a mast that begins at a height of W, a short stroke before it."""
    tube = {
        **{"start_m": [0, 0, floor], "end_m": [0, 0, floor + length], "outer_diameter_m": 0.09},
        **{"wall_m": 0.005, "young_pa": 70e9, "shear_pa": 26e9, "density_kg_m3": 2700},
    }
    data = load_scene("mast_inspection").as_data()
    data["robot"] |= {"mount": {"xyz": [0, 0, floor + length], "rpy_deg": [0, 0, 0]}}
    path = {"legs": [{"by": [0, 0.1, 0], "seconds": 2}], "keep": "axis", "via_points": 8}
    posture = [-26.7447, -0.414, 0.1791, -108.2655, 0.0014, 107.8515, 18.434]
    changes = {"tool_path": path, "start": {"posture_deg": posture}, "obstacles": []}
    changes["planner"] = {"knots": "fixed", "path_step_s": 0.02, "compensate": False, "quiet_modes": 0}
    return load_scene(data | changes | {"base": {"name": "mast", "tube": tube}})


def test_the_largest_rotation_of_the_base_is_an_angle(tracking: Tracking) -> None:
    angles, count = np.array([0.3, -0.2, 0.5]), len(tracking.planned.t)
    turned = replace(tracking.planned, base=np.tile([0.003, 0.0, 0.004, *angles, 3, 0, 4], (count, 1)))
    rotation = np.eye(3)
    for axis, angle in zip(np.eye(3), angles, strict=True):
        rotation = rotation @ pin.AngleAxis(angle, axis).toRotationMatrix()
    assert turned.largest_base_rotation == pytest.approx(np.arccos((np.trace(rotation) - 1) / 2))
    assert (turned.largest_base_displacement, turned.largest_base_torque) == pytest.approx((0.005, 5))
    rigid = replace(tracking.planned, base=None)
    assert (rigid.largest_base_displacement, rigid.largest_base_rotation) == (0.0, 0.0)


def test_the_command_is_what_the_joints_do(tracking: Tracking, short_plan: Plan) -> None:
    points, _ = Kinematics(short_plan.robot).tool_poses(short_plan.baseline.samples.q)
    off = points - short_plan.task.path.position(short_plan.baseline.samples.t)
    every = round(short_plan.baseline.samples.t[1] / 0.005)
    np.testing.assert_allclose(tracking.baseline.command[:801:every], off, atol=1e-9)
    assert short_plan.baseline.drift == pytest.approx(np.linalg.norm(off, axis=1).max(), rel=1e-6)


def test_off_the_path_is_the_error_across_it(tracking: Tracking, short_plan: Plan) -> None:
    """One leg along y: what is along it is no way off, unless it is beyond an end."""
    (leg,) = np.diff(short_plan.task.path.corners, axis=0)
    assert np.flatnonzero(leg).tolist() == [1]
    motion = tracking.baseline
    bent = motion.error + motion.command
    np.testing.assert_allclose(motion.path_error[:, [0, 2]], bent[:, [0, 2]], atol=1e-12)
    middle = slice(200, 600)
    np.testing.assert_allclose(motion.path_error[middle, 1], 0.0, atol=1e-12)


def test_a_compensated_motion_errs_from_where_it_expects_the_tool(
    compensated_short: tuple[Plan, Tracking], tracking: Tracking
) -> None:
    """What it errs is vibration; the baseline, which reckons with no sag, is what it always was."""
    compensated, foreseen = compensated_short
    motion, n = foreseen.planned, len(foreseen.planned.t)
    assert np.abs(motion.static).max() < 1e-6
    assert np.abs(motion.error - motion.dynamic).max() < 1e-6
    assert motion.metrics.total.rms[3] < 0.05 * foreseen.baseline.metrics.total.rms[3]
    np.testing.assert_array_equal(foreseen.baseline.error, tracking.baseline.error[:n])
    np.testing.assert_array_equal(foreseen.baseline.command, tracking.baseline.command[:n])
    # Measured from where a rigid tool would be, the error is the sag, as ever.
    arm = elastic_arm_of(compensated, OPTIONS)
    from_rigid = track(arm, compensated.task, compensated.trajectory, OPTIONS)
    sag = Sag(arm).at(compensated.trajectory.evaluate(motion.t[:801:20])).tool
    np.testing.assert_allclose((from_rigid.error[:n] - motion.error)[:801:20], sag, atol=1e-6)
    assert np.linalg.norm(sag, axis=1).min() > 3e-3


def test_a_compensated_motion_expects_the_tool_on_its_path(
    compensated_short: tuple[Plan, Tracking],
) -> None:
    compensated, foreseen = compensated_short
    motion, path = foreseen.planned, compensated.task.path
    moving = motion.t <= motion.stop
    expected = path.position(motion.t) + motion.command
    allowed = compensated.options.max_tool_deviation_m
    assert np.linalg.norm(path.leg_offset(motion.t, expected), axis=1)[moving].max() < 1.001 * allowed
    # And the bent tool is as near, but for what vibrates.
    bent = path.leg_offset(motion.t, expected + motion.error)
    np.testing.assert_allclose(motion.path_error, bent, atol=1e-12)
    largest = np.linalg.norm(motion.error, axis=1).max()
    assert np.linalg.norm(motion.path_error, axis=1).max() < allowed + largest
    assert motion.metrics.path.rms[3] < 0.15 * foreseen.baseline.metrics.path.rms[3]


def test_a_sag_that_was_not_foreseen_stays(compensated_short: tuple[Plan, Tracking]) -> None:
    """At stiffness f the sag is 1/f of the predicted one, nearly: weights turn with what bends."""
    compensated, foreseen = compensated_short
    assert compensated.sag is not None
    at = slice(0, 801, 20)
    predicted = compensated.sag.at(compensated.trajectory.evaluate(foreseen.planned.t[at])).tool
    for factor in (0.8, 1.25):
        factors = {"guardrail_factor": factor, "link_factor": factor}
        static = planned_motion(compensated, settle_s=0.0, **factors).static[at]
        expected = (1 / factor - 1) * predicted
        assert np.linalg.norm(static - expected, axis=1).max() < 0.03 * np.linalg.norm(expected, axis=1).max()


def test_an_arm_at_rest_stays_at_rest_and_one_let_go_swings_about_its_sag(
    cmbot_robot: Robot, task: ToolTask
) -> None:
    arm, start = arm_on_its_guardrail(cmbot_robot), swing(1.0).states([0.0])[0][0]
    resting = track(arm, task, QuinticTrajectory.held(start, 1.0), OPTIONS)
    assert np.abs(resting.static).max() > 3e-3
    assert np.abs(resting.dynamic).max() < 1e-9
    assert resting.metrics.residual is not None
    assert resting.metrics.residual.diameter < 1e-9
    options = replace(OPTIONS, initial="undeformed", damping=0.1)
    motion = track(arm, task, QuinticTrajectory.held(start, 20.0), options)
    np.testing.assert_allclose(motion.error[0], 0.0, atol=1e-12)
    sag = motion.static[0]
    along = motion.error @ sag / (sag @ sag)
    assert 1.5 < along.max() < 2.0
    np.testing.assert_allclose(motion.error[-1], sag, atol=1e-6)


def test_the_damping_ratio_is_that_of_the_first_modes(cmbot_robot: Robot, task: ToolTask) -> None:
    """Seen in the decay of a free vibration, when the higher modes have gone: exp(-ratio omega t)."""
    arm = arm_on_its_guardrail(cmbot_robot.with_rigid_joints)
    still = QuinticTrajectory.held(swing(1.0).states([0.0])[0][0], 14.0)
    for damping in (0.01, 0.03):
        motion = track(arm, task, still, replace(OPTIONS, initial="undeformed", damping=damping))
        square = (motion.dynamic**2).sum(axis=1)
        rate = -0.5 * np.log(square[2000:2800].mean() / square[1200:2000].mean()) / 4.0
        first, second = 2 * np.pi * motion.metrics.mode_frequencies[:2]
        assert damping * first < rate < damping * second


def test_what_hardly_bends_keeps_to_its_path(short_plan: Plan) -> None:
    stiff = simulate(short_plan, replace(OPTIONS, guardrail_factor=1e6, link_factor=1e6, settle_s=0.1))
    for motion in (stiff.baseline, stiff.planned):
        assert np.abs(motion.error).max() < 1e-7


def test_a_softer_or_heavier_arm_errs_more_and_a_finer_one_hardly(
    short_plan: Plan, tracking: Tracking
) -> None:
    before = tracking.planned.metrics
    for factors in ({"guardrail_factor": 0.7}, {"link_factor": 0.7}):
        soft = planned_motion(short_plan, **factors).metrics
        assert soft.total.rms[3] > 1.1 * before.total.rms[3]
        assert soft.mode_frequencies[0] < before.mode_frequencies[0]
    heavy = planned_motion(short_plan, payload_kg=5.0).metrics
    assert heavy.static.rms[3] > 1.15 * before.static.rms[3]
    as_it_was = planned_motion(short_plan, payload_kg=0.0)
    np.testing.assert_array_equal(as_it_was.error, tracking.planned.error)
    fine = planned_motion(short_plan, segments=3)
    np.testing.assert_allclose(fine.static, tracking.planned.static, atol=1e-4)
    np.testing.assert_allclose(fine.metrics.mode_frequencies, before.mode_frequencies, rtol=0.02)


def test_the_ends_of_the_interval_are_simulated_too(short_plan: Plan) -> None:
    options = replace(OPTIONS, stiffness_share=0.3, joint_factor=0.9)
    found = simulate(short_plan, options)
    assert [case.stiffness for case in found.interval] == [0.7, 1.3]
    for case in found.interval:
        factors = {"guardrail_factor": case.stiffness, "link_factor": case.stiffness}
        soft = planned_motion(short_plan, **factors, joint_factor=0.9 * case.stiffness)
        assert case.off_path[1] == pytest.approx(soft.largest_off_path, rel=1e-9)
        assert case.swing[1] == pytest.approx(soft.metrics.residual.diameter, rel=1e-9)
    assert found.interval[0].off_path > found.interval[1].off_path
    told = [row[-1] for row in interval_rows(found)]
    assert told == [f"{1e3 * x:.3f}" for case in found.interval for x in (case.off_path[1], case.swing[1])]


def test_half_the_step_gives_the_same_error(short_plan: Plan, tracking: Tracking) -> None:
    fine, finer = (baseline_motion(short_plan, step_s=step, settle_s=0.0).error for step in (1e-3, 5e-4))
    coarse = tracking.baseline.error[: len(fine)]
    coarse_error, fine_error = (np.abs(error - finer).max() for error in (coarse, fine))
    assert coarse_error < 2e-5
    # Of second order: with the finest as the truth, (16 - 1)/(4 - 1).
    assert coarse_error / fine_error == pytest.approx(5.0, rel=0.2)


def test_the_output_does_not_change_the_motion(short_plan: Plan, tracking: Tracking) -> None:
    finer = baseline_motion(short_plan, output_step_s=0.001)
    np.testing.assert_allclose(finer.error[::5], tracking.baseline.error, atol=1e-12)


def test_the_end_need_not_be_a_multiple_of_the_output(short_plan: Plan) -> None:
    motion = planned_motion(short_plan, output_step_s=0.007, settle_s=0.5)
    assert motion.t[-1] == pytest.approx(0.007 * 642)
    assert motion.metrics.residual is not None
    assert motion.metrics.residual.seconds == pytest.approx(motion.t[-1] - 0.007 * 571)


def test_without_settling_there_is_no_residual(short_plan: Plan) -> None:
    found = simulate(short_plan, replace(OPTIONS, settle_s=0.0))
    assert found.planned.metrics.residual is None
    assert found.planned.t[-1] == pytest.approx(4.0)
    printed = [row[0] for row in tracking_rows(found)] + list(tracking_remarks(found))
    assert not any("after the stop" in text for text in printed)


def test_rows_are_the_figures_in_millimetres(tracking: Tracking) -> None:
    rows = {(name, motion): numbers for name, motion, *numbers in tracking_rows(tracking)}
    assert len(rows) == 34
    figures = tracking.planned.metrics
    parts = {"error": figures.total, "static part": figures.static, "dynamic part": figures.dynamic}
    for name, statistics in parts.items():
        printed = [float(x) for x in rows[f"{name}, RMS", "planned"]]
        np.testing.assert_allclose(printed, 1e3 * statistics.rms, atol=6e-4)
    assert figures.residual is not None
    assert float(rows["after the stop, peak to peak", "planned"][3]) == pytest.approx(
        1e3 * figures.residual.diameter, abs=6e-4
    )


def test_the_damping_is_that_of_the_robot_unless_another_is_asked_for(short_plan: Plan) -> None:
    calm = replace(short_plan, robot=replace(short_plan.robot, damping_ratio=0.05))
    short = replace(OPTIONS, damping=None, settle_s=0.5)
    own, asked = simulate(calm, short), simulate(short_plan, replace(short, damping=0.05))
    assert own.options.damping == asked.options.damping == 0.05
    np.testing.assert_array_equal(own.planned.error, asked.planned.error)
    assert simulate(short_plan, short).options.damping == 0.01


def test_remarks_state_initial_condition_and_damping(short_plan: Plan, tracking: Tracking) -> None:
    text = " ".join(tracking_remarks(tracking))
    assert "Starts hanging in equilibrium; damping 1 % of critical" in text
    assert f"near {tracking.planned.metrics.mode_frequencies[0]:.2f} Hz" in text
    options = replace(OPTIONS, initial="undeformed", damping=0.0, link_factor=0.8, settle_s=0.0)
    other = simulate(short_plan, options)
    text = " ".join(tracking_remarks(other))
    assert "Starts undeformed, and let go; damping 0 %" in text
    assert "stiffness times 1 (base), 0.8 (links) and 1 (joints)" in text


def test_an_arm_too_soft_or_with_nothing_that_bends_is_refused(short_plan: Plan) -> None:
    with pytest.raises(InputError, match="stiff enough"):
        simulate(short_plan, replace(OPTIONS, guardrail_factor=1e-4, link_factor=1e-4))
    rigid = replace(short_plan.robot, elasticity={})
    scene = short_scene(guardrail={"bays": 0})
    with pytest.raises(InputError, match="guardrail: got nothing that bends"):
        simulate(replace(short_plan, robot=rigid, scene=scene))


def test_divergence_is_an_error_not_a_result(cmbot_robot: Robot, task: ToolTask) -> None:
    """The joints whirl faster than the arm can hold together."""
    drive = swing(0.2, size=60.0)
    with pytest.raises(SimulationDiverged):
        track(arm_on_its_guardrail(cmbot_robot), task, drive, OPTIONS)


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("step_s", 0.0, "at least 1e-05"),
        ("step_s", 0.1, "at most 0.02"),
        ("step_s", float("nan"), "finite|something else"),
        ("output_step_s", -1.0, "at least 0.0001"),
        ("settle_s", -0.1, "at least 0"),
        ("damping", -0.01, "at least 0"),
        ("damping", 3.0, "a share of what is critical, less than 1: 0.03 is 3 %"),
        ("initial", "relaxed", "equilibrium"),
        ("segments", 0, "at least 1"),
        ("segments", 1.5, "a whole number"),
        ("guardrail_factor", 0.0, "at least 1e-06"),
        ("link_factor", -1.0, "at least 1e-06"),
        ("payload_kg", -1.0, "at least 0"),
        ("spectral_radius", 1.1, "at most 1"),
        ("corrections", 0, "at least 1"),
    ],
)
def test_options_are_checked(short_plan: Plan, option: str, value: object, expected: str) -> None:
    with pytest.raises(InputError, match=expected) as caught:
        simulate(short_plan, replace(OPTIONS, **{option: value}))
    assert (caught.value.source, caught.value.key) == ("SimulationOptions", option)


def test_remarks_say_what_was_foreseen_of_a_compensated_plan(
    compensated_short: tuple[Plan, Tracking],
) -> None:
    _, tracking = compensated_short
    plain, told = (list(tracking_remarks(tracking, compensated=given)) for given in (False, True))
    assert "of the planned motion from there with the sag that was foreseen; static" in told[0]
    assert "foreseen" not in " ".join(plain)
    assert sum(each.startswith("Planned: with the sag that was foreseen, the joints") for each in told) == 1
    assert [each for each in plain if each.startswith("Baseline: apart")] == [
        each for each in told if each.startswith("Baseline: apart")
    ]
