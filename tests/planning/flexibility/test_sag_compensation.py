"""Sag compensation and sag as the objective: what is commanded, what is expected, what is said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from finite_differences import check_derivative
from small_scenes import request_of, short_scene, tool_points
from urdf_arms import arm_scene

from cmbot.archive import load_plan, save
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, OptimisationFailed, SceneError
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.first_order import DeckSway
from cmbot.elastic.sag import Sag, SagStates, TooSoftError
from cmbot.planning import (
    GlobalSearch,
    Plan,
    bending_arm,
    plan,
    remarks,
    robot_of,
    sag_of,
    strokes_of,
    task_of,
)
from cmbot.planning.attempts import motion
from cmbot.planning.budget import Deadline
from cmbot.planning.flexibility.sag_compensation import optimise_bent
from cmbot.planning.initial_guess import guess_along, initial_guess
from cmbot.planning.request import StrokeRequest, build_request
from cmbot.planning.torque.problem import TaskManifold
from cmbot.planning.workcell.bent_tool import BentTool
from cmbot.robot import Postures
from cmbot.scene import PlannerOptions, Scene, load_scene
from cmbot.toolpath import ToolPoses

ALLOWED = 0.001


@pytest.fixture(scope="module", params=["sliding free", "sliding pinned", "fixed"])
def compensated(request: pytest.FixtureRequest) -> Plan:
    knots, _, start = request.param.partition(" ")
    return plan(short_scene(planner={"knots": knots, "start": start or "free", "compensate": True}))


def test_the_bent_arm_follows_the_path(compensated: Plan) -> None:
    """Sag by the elastic model itself, at times of no sample."""
    scene, robot = compensated.scene, compensated.robot
    sag = Sag(elastic_arm(robot, elastic_base(scene.elastic_guardrail)))
    t = np.linspace(0, compensated.trajectory.duration, 217)
    q = compensated.trajectory.evaluate(t)
    commanded = tool_points(robot, q)
    bent = commanded + sag.at(q).tool
    legs = task_of(strokes_of(scene, robot)[0], scene).path
    assert np.linalg.norm(legs.leg_offset(t, bent), axis=1).max() <= ALLOWED
    # Without the shift the arm would be about a centimetre off.
    assert np.linalg.norm(legs.leg_offset(t, commanded), axis=1).max() > 5 * ALLOWED
    # It is where it should be not only on the legs but in time, at the via-points.
    via = compensated.trajectory.t
    at_via = np.array([np.interp(via, t, x) for x in bent.T]).T
    assert np.linalg.norm(at_via - legs.position(via), axis=1).max() < ALLOWED


@pytest.mark.parametrize("knots", ["sliding", "fixed"])
def test_a_soft_base_settles(knots: str) -> None:
    """The rail has a twelfth of its stiffness, and the tool sags by 7 to 9 cm: a posture's own sag counts."""
    soft = {"guardrail": {"stiffness_factor": 0.08}, "planner": {"knots": knots, "compensate": True}}
    compensated = plan(short_scene(**soft), progress=False)
    assert compensated.compensation.largest_shift > 0.07
    assert compensated.figures.max_tool_deviation <= ALLOWED
    bounds = [line for line in remarks(compensated) if line.startswith("Lower bound")]
    assert all(line.startswith("Lower bound, of the path before the sag is compensated: ") for line in bounds)
    assert len(bounds) == (knots == "sliding")


def test_commanded_and_expected_path_are_in_the_plan(compensated: Plan) -> None:
    samples = compensated.samples
    exact = compensated.sag.at(samples.q[::37]).tool
    found = (samples.expected_tool_point - samples.tool_point)[::37]
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7)
    assert samples.tool_deviation.max() <= ALLOWED
    names = [check.quantity for check in compensated.certificate.checks]
    assert "expected tool deviation" in names
    assert "tool deviation" not in names
    shift = np.linalg.norm(exact, axis=1).max()
    assert compensated.compensation.largest_shift == pytest.approx(shift, rel=0.05)
    assert compensated.compensation.last_change < 0.02 * ALLOWED


def test_what_it_keeps(compensated: Plan) -> None:
    assert compensated.certificate.holds
    assert compensated.figures.min_clearance >= compensated.options.safety_margin_m
    # The baseline is what it was: rigid, uncompensated.
    assert compensated.baseline.samples.expected_tool_point is None
    # The first posture is not the scene's, but near it when that is pinned.
    assert compensated.start.moved > 0
    if compensated.options.start == "pinned":
        assert compensated.start.moved < 0.05


def test_a_compensated_plan_is_read_back(compensated: Plan, tmp_path: Path) -> None:
    save(compensated, tmp_path / "plan")
    header = (tmp_path / "plan" / "job.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.endswith(
        "clearance,expected_tool_x,expected_tool_y,expected_tool_z,adhesion_needed,segment"
    )
    back = load_plan(tmp_path / "plan", verify=True)
    assert back.compensation == compensated.compensation
    assert back.figures.max_tool_deviation == pytest.approx(compensated.figures.max_tool_deviation, rel=1e-9)
    assert back.samples.expected_tool_point is not None


def test_without_compensation_nothing_is_expected(short_plan: Plan) -> None:
    assert short_plan.compensation is None
    assert short_plan.sag is None
    assert short_plan.samples.expected_tool_point is None


@pytest.mark.parametrize("options", [{"compensate": True}, {"objective": "sag"}, {"objective": "sway"}])
def test_nothing_bends(options: dict[str, object], tmp_path: Path) -> None:
    """A rigid hold and an arm without link tubes."""
    scene = short_scene(guardrail={"bays": 0}, planner=options)
    robot = replace(robot_of(scene), elasticity={})
    with pytest.raises(SceneError, match=r"something that bends: guardrail\.bays"):
        sag_of(scene, bending_arm(scene, robot), scene.planner)


def least_sag(spacing: float = 0.3, **changes: object) -> Scene:
    """A scene whose objective is the sag, with no more of anything else than that takes."""
    planner = {"knots": "sliding", "objective": "sag", "chart_spacing": spacing}
    # So far off its path the tool is between so few via-points.
    planner["max_tool_deviation_m"] = 0.01
    return short_scene(tool_path={"via_points": 5}, planner=planner, **changes)


def test_sag_as_the_objective(tmp_path: Path) -> None:
    """From the best posture there is: the global stage's."""
    best = GlobalSearch(request_of(least_sag(0.1))).solve(pinned=False).q[0]
    scene = least_sag(posture_deg=np.rad2deg(best).tolist())
    planned = plan(scene)
    torque = plan(scene, options=replace(scene.planner, objective="torque", start="pinned"))
    sag = sag_of(scene, bending_arm(scene, planned.robot), scene.planner)

    def largest(of: Plan) -> float:
        return float(np.linalg.norm(sag.at(of.samples.q).tool, axis=1).max())

    assert planned.objective.name == "sag"
    assert planned.objective.unit == "m"
    assert planned.objective.planned_peak == pytest.approx(largest(planned), rel=1e-6)
    assert planned.objective.planned_peak <= planned.objective.floor * 1.002
    assert largest(planned) <= largest(torque) * (1 + 1e-6)
    assert planned.gap_to_floor is None
    assert any("Minimised: the tool's sag" in remark and " mm" in remark for remark in remarks(planned))
    save(planned, tmp_path / "plan")
    assert load_plan(tmp_path / "plan", verify=True).objective == planned.objective


def test_sway_as_the_objective(tmp_path: Path) -> None:
    """No more by 1 m/s2 of the deck than the motion of least torque."""
    scene = least_sag().with_options(objective="sway", start="pinned")
    planned = plan(scene)
    torque = plan(scene.with_options(objective="torque", start="free"))
    arm = bending_arm(scene, planned.robot)
    assert arm is not None
    sway = DeckSway(arm)
    assert planned.objective.planned_peak == pytest.approx(sway.values(planned.samples.q).max(), rel=1e-3)
    assert planned.objective.planned_peak < sway.values(torque.samples.q).max() * (1 + 1e-3)
    assert any("Minimised: the tool's sway by 1 m/s2" in remark for remark in remarks(planned))
    save(planned, tmp_path / "plan")
    assert load_plan(tmp_path / "plan", verify=True).objective == planned.objective


def test_derivative_of_the_sags_length(rng: np.random.Generator) -> None:
    scene = load_scene("triangle")
    robot = robot_of(scene)
    sag = sag_of(scene, bending_arm(scene, robot), replace(scene.planner, objective="sag"))
    for q in scene.posture + rng.uniform(-0.3, 0.3, (4, robot.dof)):
        gradient = sag.length(q[None])[1][0]
        check_derivative(lambda x: sag.length(x[None])[0], q, gradient[None], rtol=1e-6)


def bent_near_the_triangle() -> tuple[BentTool, Sag]:
    scene = load_scene("triangle")
    robot = robot_of(scene)
    sag = Sag(bending_arm(scene, robot))
    t = np.linspace(0, 4.0, 41)
    q = scene.posture + 0.2 * np.sin(t)[:, None] * np.linspace(0.5, 1.0, robot.dof)
    at = sag.at(q)
    return BentTool(postures=Postures(robot), times=t, q=q, sag=at.tool, slope=at.d_tool), sag


def test_the_bent_tool_is_exact_on_its_motion_and_to_first_order_beside_it(rng: np.random.Generator) -> None:
    bent, sag = bent_near_the_triangle()
    np.testing.assert_allclose(bent.at(bent.times, bent.q).sag, sag.at(bent.q).tool, rtol=0, atol=1e-12)
    way = rng.uniform(-1, 1, bent.q.shape)

    def missed(step: float) -> float:
        q = bent.q + step * way
        return float(np.abs(bent.at(bent.times, q).sag - sag.at(q).tool).max())

    assert missed(0.1) < 2e-3
    assert missed(0.01) == pytest.approx(missed(0.02) / 4, rel=0.2)


def test_its_jacobian_is_its_derivative(rng: np.random.Generator) -> None:
    bent, _ = bent_near_the_triangle()
    t = rng.uniform(0, 4.0, 3)
    for time, q in zip(t, bent.q[::15] + rng.uniform(-0.2, 0.2, (3, 7)), strict=True):
        at = bent.at(np.array([time]), q[None])
        check_derivative(
            lambda x, time=time: bent.at(np.array([time]), x[None]).tool_point[0], q, at.jacobian[0, :3]
        )
        np.testing.assert_array_equal(at.jacobian[0, 3:], at.rigid.jacobian[0, 3:])


def test_via_points_slide_along_the_self_motion_of_the_bent_arm(rng: np.random.Generator) -> None:
    bent, _ = bent_near_the_triangle()
    asked = request_of(load_scene("triangle"))
    q, times = bent.q[::10], bent.times[::10]
    at = bent.at(times, q)
    goals = ToolPoses(point=at.tool_point, rotation=at.tool_rotation)
    manifold = TaskManifold(bent.postures, asked.task, goals, times, bent)
    tangents = manifold.tangents(q)
    which = np.array([1, 3])
    moved, slope = manifold.retract(q, tangents[which], np.full((2, tangents.shape[1]), 0.2), which)
    there = bent.at(times[which], moved)
    np.testing.assert_allclose(there.tool_point, goals.point[which], rtol=0, atol=1e-9)
    rigid = bent.postures.tool_at(moved).tool_point
    assert np.linalg.norm(rigid - bent.postures.tool_at(q[which]).tool_point, axis=1).max() > 1e-4
    held = np.einsum("kij,kaj->kia", there.jacobian, slope)
    np.testing.assert_allclose(held[:, :3], 0.0, atol=1e-9)


def test_a_soft_base_under_another_arm_settles(tmp_path: Path) -> None:
    """The tool of an arm on a thin mast sags by a centimetre, and elsewhere where the arm leans elsewhere."""
    stiffness = np.diag([1.15e4, 1.15e4, 3.8e6, 1.54e4, 1.54e4, 3e3])
    stiffness[0, 4] = stiffness[4, 0] = -1.15e4
    stiffness[1, 3] = stiffness[3, 1] = 1.15e4
    soft = {"bays": 0, "stiffness": stiffness.tolist()}
    planner = {"compensate": True, "max_tool_deviation_m": 0.001}
    scene = arm_scene(tmp_path, "panda").changed(guardrail=soft, planner=planner)
    made = plan(scene)
    assert made.compensation.largest_shift > 0.005
    assert made.figures.max_tool_deviation <= 0.001


@pytest.mark.parametrize(
    ("late", "words"),
    [
        (False, "the sag did not settle, linearized 8 times"),
        (True, "was over .* before the sag along the motion"),
    ],
)
def test_a_sag_that_is_never_what_it_was_taken_for_is_told(late: bool, words: str) -> None:
    """One that grows by a millimetre whenever it is computed; the time is over after the motion is solved."""

    class Growing(Sag):
        calls = 0

        def at(self, q: FloatArray) -> SagStates:
            self.calls += 1
            states = super().at(q)
            return replace(states, tool=states.tool + 0.001 * self.calls)

    asked = request_of(short_scene(), compensate=True)
    sag = Growing(asked.cell.sag.arm)
    clock = Deadline(-1.0, lambda: 2.0) if late else Deadline()
    with pytest.raises(OptimisationFailed, match=words) as caught:
        optimise_bent(replace(asked, deadline=clock), initial_guess(asked), sag)
    assert caught.value.stopped == late


def test_an_arm_that_topples_on_its_way_has_no_compensated_plan() -> None:
    """It stands where it starts; the reason says that it is too soft."""
    asked = request_of(short_scene(), compensate=True)

    class Toppling(Sag):
        def at(self, q: FloatArray) -> SagStates:
            raise TooSoftError("Sag.at", "q[3]", "a posture from which the arm topples", "a stiffer one")

    with pytest.raises(OptimisationFailed, match="too soft: a posture from which the arm topples"):
        optimise_bent(asked, initial_guess(asked), Toppling(asked.cell.sag.arm))


def test_compensation_is_the_default_wherever_something_bends(tmp_path: Path) -> None:
    """Left out it is on; on a rigid base off; where the arm topples at the start off, too."""
    assert PlannerOptions().compensate == "auto"
    auto = {"compensate": "auto"}
    for scene, expected in (
        (short_scene(planner=auto), True),
        (arm_scene(tmp_path, "panda", compensate="auto").changed(guardrail={"bays": 0}), False),
        (short_scene(planner=auto, guardrail={"stiffness_factor": 1e-3}, robot={"payload_kg": 100.0}), False),
    ):
        assert build_request(scene, scene.planner).cell.options.compensate is expected
    short = short_scene(planner=auto)
    made = plan(short, progress=False)
    assert (made.options.compensate, made.scene.planner.compensate) == (True, "auto")
    assert made.figures.max_tool_deviation <= ALLOWED
    save(made, tmp_path / "plan")
    load_plan(tmp_path / "plan", verify=True, scene=short)
    without = plan(short, options=replace(short.planner, compensate=False), progress=False)
    save(without, tmp_path / "without")
    with pytest.raises(ArchiveError, match=r"compensate False \(asked True\)"):
        load_plan(tmp_path / "without", verify=True, scene=short)


def test_a_better_start_that_no_approach_leads_to_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """The work begins where the arm is, and says why."""

    def fails(asked: StrokeRequest, *_: object, **__: object) -> None:
        raise asked.path_not_found("no collision-free approach was found", asked.state.posture)

    monkeypatch.setattr(motion, "plan_approach", fails)
    planned = plan(least_sag())
    assert planned.choice.free < 0.9 * planned.choice.pinned
    assert planned.start.moved == 0
    assert planned.approach is None
    assert "no collision-free approach" in planned.start.failures[0].reason
    assert any("A better start was found" in remark for remark in remarks(planned))


def test_fixed_knots_stay_where_it_goes_on_from_a_bent_arms_motion() -> None:
    """What bends is bent once more from there."""
    scene = short_scene(robot={"joints": "elastic"}, planner={"compensate": True, "baseline": "none"})
    request = build_request(scene, scene.planner)
    guess, sag = initial_guess(request), request.cell.sag
    assert sag is not None
    ended = optimise_bent(request, guess, sag)[0]
    again = guess_along(request, guess, ended.trajectory).problem.parametrization
    np.testing.assert_allclose(again.via_points, guess.problem.parametrization.via_points, rtol=0, atol=1e-12)
    assert np.abs(ended.via_points - again.via_points).max() > 1e-3
