"""The process: a force on the tool while it is on, and a bound of its speed."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forgeries import certified, changed_scene
from hypothesis import given, settings, strategies as st
from plan_folders import edit
from small_motions import wild
from small_scenes import request_of, short_scene, strokes_scene, task_at

from cmbot.accuracy import stroke_sway
from cmbot.archive import load_plan, save
from cmbot.archive.verification.asked import require_still
from cmbot.collision import Clearances
from cmbot.common.errors import ArchiveError, PlanningError, SceneError
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.generalized_alpha import ElasticSystem, GeneralizedAlpha
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan, certify, plan, precheck_scene
from cmbot.robot import Dynamics, Kinematics, Robot
from cmbot.scene import PlannerOptions, Scene, Tool
from cmbot.simulation import PrescribedWork, SimulationOptions, simulate
from cmbot.simulation.tracking import elastic_arm_of
from cmbot.trajectory import QuinticTrajectory

FORCE = (20.0, 0.0, -60.0)
GRAVITY = 9.81
KEPT = ("pose", "axis", "position")
# 0.3 m in 4 s, ramps of a fifth: the speed in between, m/s.
SPEED = 0.09375


def scene_with(tool: dict[str, Any], **changes: Any) -> Scene:
    path = {"speed_profile": {"kind": "trapezoidal"}, **changes.pop("tool_path", {})}
    return short_scene(tool=tool, tool_path=path, **changes)


@pytest.fixture(scope="module")
def pushed_plan() -> Plan:
    """With an approach, in which the tool is off, from a folded posture."""
    begin = {"xyz": [1.75, 0.7, -2.0], "axis": [0.8, 0, -0.6]}
    return plan(
        scene_with(
            {"process_force_n": list(FORCE)},
            posture_deg=[26, -146, 43, 161, -84, -112, -55],
            tool_path={"from": begin},
            planner={"knots": "sliding", "min_gain": 1e-3},
        )
    )


def test_the_force_acts_at_work_and_not_on_the_approach(pushed_plan: Plan) -> None:
    approach, work, robot = pushed_plan.approach_samples, pushed_plan.samples, pushed_plan.robot
    assert approach is not None
    weight = np.array([0, 0, -GRAVITY * robot.arm_mass])
    X_WT = Kinematics(robot).tool_pose(work.q[0])
    push = X_WT.rotation @ FORCE
    # Both rest in the same posture, one before and one after the tool is on.
    before, after = (x.guardrail_force[k] for x, k in ((approach, -1), (work, 0)))
    np.testing.assert_allclose(before, weight, atol=1e-6)
    np.testing.assert_allclose(after, weight + push, atol=1e-6)
    more = work.guardrail_torque[0] - approach.guardrail_torque[-1]
    np.testing.assert_allclose(more, np.cross(X_WT.translation, push), atol=1e-5)
    way = pushed_plan.approach.trajectory
    t = np.linspace(0, way.duration, 2001)
    peak = np.linalg.norm(Dynamics(robot.tool_off).efforts(*way.states(t)).guardrail_torque, axis=1).max()
    certificate = pushed_plan.approach.certificate
    assert peak == pytest.approx(certificate.figures.peak_guardrail_torque, rel=1e-4)
    assert peak <= certificate.guardrail_torque_bound


def test_the_peak_under_a_force_is_enclosed(pushed_plan: Plan) -> None:
    x, certificate = pushed_plan.trajectory, pushed_plan.certificate
    states = x.states(np.linspace(0, x.duration, 20_001))
    robot = replace(pushed_plan.robot.tool_off, tool_force=FORCE)
    torque = np.linalg.norm(Dynamics(robot).efforts(*states).guardrail_torque, axis=1)
    assert torque.max() <= certificate.guardrail_torque_bound
    assert torque.max() == pytest.approx(certificate.guardrail_torque_bound, rel=1e-5)
    assert pushed_plan.baseline.figures.peak_guardrail_torque > torque.max()
    assert pushed_plan.torque_floor_kind == "proven"
    assert pushed_plan.gap_to_floor == pytest.approx(0, abs=0.01)
    assert "peak of its static part at work, Nm" in [row[0] for row in pushed_plan.rows()]


@settings(max_examples=4)
@given(
    seed=st.integers(0, 2**32 - 1), force=st.tuples(*[st.floats(-500, 500)] * 3), keep=st.sampled_from(KEPT)
)
def test_enclosures_under_a_force_miss_nothing(
    cmbot_robot: Robot, seed: int, force: tuple[float, float, float], keep: str
) -> None:
    robot, x = replace(cmbot_robot, tool_force=force), wild(seed, joints=7, knots=3)
    task = replace(task_at(robot, x.q[0], keep), max_speed=1.0)
    found = certify(robot, task, x, Clearances(robot, ()), PlannerOptions(), via_points=3)
    q, v, a = x.states(np.linspace(0, x.duration, 4001))
    peak = np.linalg.norm(Dynamics(robot).efforts(q, v, a).guardrail_torque, axis=1).max()
    J = Kinematics(robot).tool_point_jacobians(q)[1]
    speed = np.linalg.norm(np.einsum("kij,kj->ki", J, v), axis=1).max()
    (check,) = (check for check in found.checks if check.quantity == "tool speed")
    for sampled, bound in ((peak, found.guardrail_torque_bound), (speed, check.value)):
        assert sampled <= bound * (1 + 1e-9)
        assert sampled == pytest.approx(bound, rel=1e-3)


def test_a_plan_under_a_force_is_read_back(pushed_plan: Plan, tmp_path: Path) -> None:
    folder = save(pushed_plan, tmp_path / "plan")
    again = load_plan(folder, verify=True)
    assert again.robot.tool_force == FORCE
    assert again.scene.tool == Tool(process_force_n=FORCE)
    for got, expected in (
        (again.samples, pushed_plan.samples),
        (again.approach_samples, pushed_plan.approach_samples),
        (again.baseline.samples, pushed_plan.baseline.samples),
    ):
        got, expected = got.guardrail_torque, expected.guardrail_torque
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("force", [[0.0, 0.0, 0.0], [20.0, 0.0, -61.0], [20.0, 0.0, 60.0]], ids=str)
def test_a_plan_that_claims_another_force(pushed_plan: Plan, tmp_path: Path, force: list[float]) -> None:
    folder = save(pushed_plan, tmp_path / "plan")
    edit(
        folder,
        lambda data: changed_scene(data, lambda scene: scene["tool"].update(process_force_n=force), folder),
    )
    with pytest.raises(ArchiveError, match=r"guardrail_torque.*as computed again"):
        load_plan(folder, verify=True)


def test_a_motion_made_without_the_force_does_not_certify_with_it(short_plan: Plan) -> None:
    heavy = scene_with({"process_force_n": [0.0, 200.0, -400.0]})
    (check, *_) = (
        check for check in certified(heavy, short_plan, short_plan.trajectory).checks if not check.holds
    )
    assert check.quantity.startswith("torque of")
    with pytest.raises(PlanningError):
        plan(heavy)


def test_the_idle_objective_knows_no_force() -> None:
    for planner in ({}, {"objective": "sag"}):
        asked = request_of(scene_with({"process_force_n": list(FORCE)}, planner=planner))
        alone = request_of(short_scene(planner=planner))
        idle, q = asked.tool_off, asked.state.posture[None]
        off, without, on = (c.cell.objective.at_rest(c.cell.postures.at(q))[0] for c in (idle, alone, asked))
        assert off == without != on
        assert idle.tool_off is idle
        assert not idle.cell.robot.pushed


def test_the_bent_arm_is_pushed_in_the_simulation() -> None:
    """At rest under the force it stays; let go it does not."""
    asked = request_of(scene_with({"process_force_n": list(FORCE)}))
    assert asked.cell.arm is not None
    free = elastic_arm(asked.cell.robot.tool_off, asked.cell.arm.base)
    q = asked.state.posture
    bent = Sag(asked.cell.arm).at(q[None]).u[0]
    still = QuinticTrajectory.held(q, 0.1)

    def moved(system: ElasticSystem) -> float:
        run = GeneralizedAlpha(system, step=1e-3, rho_inf=0.9, corrections=2)
        return float(np.abs(run.run([still], bent, np.zeros_like(bent)).u - bent).max())

    none = np.zeros((len(bent), len(bent)))
    assert moved(ElasticSystem.of(asked.cell.arm, none)) < 1e-9
    assert moved(ElasticSystem.of(free, none)) > 1e-5


@pytest.fixture(scope="module")
def compensated_plan() -> Plan:
    soft = {"stiffness": np.diag([1e6, 1e6, 1e6, 2e4, 2e4, 2e4]).tolist()}
    tool = {"process_force_n": list(FORCE), "max_speed_m_s": SPEED}
    return plan(scene_with(tool, guardrail=soft, planner={"compensate": True}))


def test_sag_under_a_force_is_compensated(compensated_plan: Plan) -> None:
    made, sag = compensated_plan, compensated_plan.sag
    assert sag is not None
    times = made.task.path.via_times(8)
    q = made.trajectory.evaluate(times)
    away = Kinematics(made.robot).tool_poses(q)[0] + sag.at(q).tool - made.task.path.position(times)
    assert np.linalg.norm(away, axis=1).max() < made.options.max_tool_deviation_m
    unpushed = Sag(elastic_arm(made.robot.tool_off, sag.arm.base)).at(q).tool
    assert np.linalg.norm(unpushed - sag.at(q).tool, axis=1).min() > 1e-4


def test_a_tool_path_that_is_too_fast_is_refused_before_planning() -> None:
    scene = scene_with({"max_speed_m_s": 0.09})
    wanted = (
        r"tool_path.legs\[0\].seconds: got 4 s, in which the tool reaches 0.09375 m/s, "
        "expected at least 4.17 s, for tool.max_speed_m_s 0.09"
    )
    with pytest.raises(SceneError, match=wanted):
        plan(scene)
    (warning,) = precheck_scene(scene).warnings
    assert warning.key == "tool_path.legs[0].seconds"
    assert not precheck_scene(scene_with({"max_speed_m_s": SPEED})).warnings


def test_the_speed_of_the_tool_is_bounded_and_certified(short_plan: Plan) -> None:
    """The path just keeps the bound; between via-points the tool has five per cent."""
    made = plan(scene_with({"max_speed_m_s": SPEED}))
    x = made.trajectory
    q, v, _ = x.states(np.linspace(0, x.duration, 20_001))
    J = Kinematics(made.robot).tool_point_jacobians(q)[1]
    speed = np.linalg.norm(np.einsum("kij,kj->ki", J, v), axis=1).max()
    (check,) = (check for check in made.certificate.checks if check.quantity == "tool speed")
    assert check.bound == pytest.approx(1.05 * SPEED)
    assert speed <= check.value <= check.bound
    assert speed == pytest.approx(check.value, rel=1e-5)
    assert "tool speed" not in [check.quantity for check in short_plan.certificate.checks]


def test_check_says_what_the_process_asks() -> None:
    tool = {"process_force_n": list(FORCE), "max_speed_m_s": 0.1}
    planner = {"axis_weights": [0, 0, 1]}
    pinned = precheck_scene(scene_with(tool, planner=planner))
    found = dict(pinned.found)
    assert found["process force on the tool"] == "(20, 0, -60) N along its axes"
    assert found["tool speed"] == "0.09375 of at most 0.1 m/s"
    # Unlike gravity it has a torque about z.
    assert not pinned.warnings
    (warning,) = precheck_scene(short_scene(planner=planner)).warnings
    assert warning.key == "planner.axis_weights"
    # Where the work may start elsewhere, the arm waits with the tool off.
    key = "torque on the guardrail there"
    free = dict(precheck_scene(scene_with(tool, planner={"knots": "sliding"})).found)
    assert free[key] == dict(precheck_scene(short_scene()).found)[key] == "486.41 Nm" != found[key]


def test_the_speed_of_the_bent_tool_is_what_is_certified(compensated_plan: Plan) -> None:
    x, sag = compensated_plan.trajectory, compensated_plan.sag
    assert sag is not None
    t, step = np.arange(0, x.duration - 0.01, 0.01), 1e-4
    ends = [x.evaluate(t + shift) for shift in (0.0, step)]
    points = [Kinematics(compensated_plan.robot).tool_poses(q)[0] + sag.at(q).tool for q in ends]
    speed = np.linalg.norm(points[1] - points[0], axis=1).max() / step
    (check,) = (
        check for check in compensated_plan.certificate.checks if check.quantity == "expected tool speed"
    )
    assert speed == pytest.approx(check.value, rel=1e-3)


@pytest.mark.parametrize(("force", "number"), [([0, 0, 30], 1), ([5, 0, -30], 0), ([5, 0, 0], 0)])
def test_a_force_that_pulls_the_tool_forward_is_told(force: list[float], number: int) -> None:
    found = precheck_scene(scene_with({"process_force_n": force})).warnings
    about = [each.got for each in found if each.key == "tool.process_force_n"]
    assert about == ["[0, 0, 30], which pulls the tool forward"] * number


RAMP = 0.4


@pytest.fixture(scope="module")
def ramped_plan() -> Plan:
    return plan(strokes_scene(RAMP))


def test_the_arm_stands_beside_strokes_while_the_force_sets_in_and_ends(
    ramped_plan: Plan, strokes_plan: Plan, tmp_path: Path
) -> None:
    """At both ends of free moves that join strokes, of the baseline's too; the strokes are as without."""
    for job, plain in ((ramped_plan.job, strokes_plan.job), (ramped_plan.baseline, strokes_plan.baseline)):
        assert job is not None and plain is not None
        longer = [a.duration - b.duration for a, b in zip(job.segments, plain.segments, strict=True)]
        stands = {"approach": RAMP, "free_1": 2 * RAMP, "return": RAMP}
        expected = [stands.get(segment.name, 0.0) for segment in job.segments]
        np.testing.assert_allclose(longer, expected, atol=1e-9)
    for segment in ramped_plan.job.segments:
        x, before, after = segment.trajectory, segment.name in ("free_1", "return"), segment.name == "free_1"
        if segment.kind == "free":
            t = np.linspace(0.0, RAMP, 9)
            assert (x.evaluate(t) == x.q[0]).all() == before
            assert (x.evaluate(x.duration - t) == x.q[-1]).all() == (after or segment.name == "approach")
            assert segment.certificate.holds
    save(ramped_plan, tmp_path)
    again = load_plan(tmp_path, verify=True)
    assert again.robot.tool_ramp == RAMP
    np.testing.assert_array_equal(again.job.trajectory.t, ramped_plan.job.trajectory.t)


def test_an_arm_that_does_not_stand_so_long_is_refused(ramped_plan: Plan, strokes_plan: Plan) -> None:
    """As planned for a force that sets in at once, or sooner than the scene says."""
    for made, ramp in ((strokes_plan, RAMP), (ramped_plan, 1.1 * RAMP)):
        told = replace(made, robot=replace(made.robot, tool_ramp=ramp))
        with pytest.raises(ArchiveError, match=r"moves .* while the process force sets in or ends") as no:
            require_still(told, made.options, "plan.json")
        assert no.value.key in ("approach", "free_1")
    require_still(ramped_plan, ramped_plan.options, "plan.json")
    (free,) = (segment for segment in ramped_plan.job.segments if segment.name == "free_1")
    assert free.moved_in_ramps(1e3) == np.inf


def test_a_force_that_sets_in_slowly_is_simulated(ramped_plan: Plan, strokes_plan: Plan) -> None:
    """Between strokes it goes from all to nothing and back; the tool sways as predicted, and by less."""
    options = SimulationOptions(settle_s=0.0)
    slow, fast = (simulate(each, options).planned for each in (ramped_plan, strokes_plan))
    free = PrescribedWork.planned(ramped_plan).parts[1]
    share = free.force_share(ramped_plan.robot, np.linspace(0.0, free.motion.duration, 1001))
    assert share[[0, 500, -1]] == pytest.approx([1.0, 0.0, 1.0], abs=1e-9)
    # The sag has no jumps: between two outputs the share of the force changes by little.
    sag = np.linalg.norm(np.diff(slow.static, axis=0), axis=1).max()
    assert sag < 0.1 * np.linalg.norm(np.diff(fast.static, axis=0), axis=1).max()
    # The second stroke inherits what the free move leaves.
    most = list[float]()
    for tracking, made in ((slow, ramped_plan), (fast, strokes_plan)):
        first = made.job.strokes[0]
        sway = stroke_sway(elastic_arm_of(made, options), first.trajectory, 0.0)
        most.append(float(np.linalg.norm(sway.tool[1, sway.t <= first.duration], axis=1).max()))
        simulated = np.linalg.norm(tracking.dynamic[tracking.t <= first.duration], axis=1).max()
        assert simulated == pytest.approx(most[-1], rel=0.02)
    assert most[0] < 0.5 * most[1]


def test_samples_have_the_force_as_it_sets_in(ramped_plan: Plan) -> None:
    """The wrench on the base has no step where work begins and ends, of the baseline neither."""
    segments = ramped_plan.job.segments
    planned = [ramped_plan.segment_samples[segment.name] for segment in segments]
    for each in (planned, [segment.samples for segment in ramped_plan.baseline.segments]):
        for before, after in pairwise(each):
            np.testing.assert_allclose(before.guardrail_force[-1], after.guardrail_force[0], atol=1e-6)
            np.testing.assert_allclose(before.joint_torque[-1], after.joint_torque[0], atol=1e-6)
    # On the approach the weight alone until it stands; then the force, half of it half-way.
    (approach, work), robot = planned[:2], ramped_plan.robot
    weight = approach.guardrail_force[0]
    by_force = work.guardrail_force[0] - weight
    assert np.linalg.norm(by_force) == pytest.approx(np.linalg.norm(robot.tool_force), rel=1e-9)
    left = segments[0].duration - approach.t
    share = (approach.guardrail_force - weight) @ by_force / (by_force @ by_force)
    np.testing.assert_allclose(np.interp(-0.5 * RAMP, -left, share), 0.5, atol=0.01)
    off = Dynamics(robot.tool_off).efforts(*segments[0].trajectory.states(approach.t)).guardrail_force
    np.testing.assert_allclose(approach.guardrail_force[left > RAMP], off[left > RAMP], atol=1e-9)
