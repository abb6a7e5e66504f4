"""Planning with joints that slide: an arm of seven joints on a rail, with a link that is drawn out."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from finite_differences import check_derivative
from rail_arms import POSTURE, RAIL_JOINTS, rail_data, rail_scene
from small_scenes import off_task, problem_of, with_corners

import cmbot
from cmbot.common.errors import SceneError
from cmbot.planning import Plan, remarks, robot_of, strokes_of, task_of
from cmbot.planning.free_motion.approach import plan_approach
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.planning.free_motion.roadmap import lower_peak
from cmbot.planning.free_motion.rrt_connect import rrt_connect
from cmbot.planning.path.gradient_projection import follow_path, self_motion_postures
from cmbot.planning.postures.projection import null_space, project_onto_task
from cmbot.planning.request import StrokeRequest, build_request
from cmbot.planning.result.stroke_plan import Start
from cmbot.planning.selfmotion.reachability import out_of_reach
from cmbot.planning.selfmotion.sampler import SelfMotionSampler
from cmbot.planning.selfmotion.spherical_joint import wrist_chain
from cmbot.planning.torque.problem import TaskManifold
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Dynamics
from cmbot.scene import load_scene
from cmbot.views import report_page
from cmbot.views.charts import joint_charts

SLIDES = np.array([name in ("rail", "draw") for name in RAIL_JOINTS])


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> StrokeRequest:
    scene = rail_scene(tmp_path_factory.mktemp("rail"))
    return build_request(scene, scene.planner)


def test_a_plan_is_certified_and_read_back(rail_plan: Plan, tmp_path: Path) -> None:
    assert rail_plan.certificate.holds
    moved = np.ptp(rail_plan.samples.q, axis=0)
    # Both slides take part.
    assert (moved[SLIDES] > 5e-3).all()
    cmbot.save(rail_plan, tmp_path / "rail")
    read = cmbot.load_plan(tmp_path / "rail", verify=True)
    assert any("second computation" in check.quantity for check in read.certificate.checks)
    np.testing.assert_array_equal(read.trajectory.q, rail_plan.trajectory.q)
    np.testing.assert_allclose(read.start.posture, rail_plan.start.posture, rtol=0, atol=1e-12)
    assert "posture" in read.scene.as_data()["start"]


def test_forces_that_are_halved_are_noticed(rail_plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    right = Dynamics.efforts

    def halved(self: Dynamics, *given: Any) -> Any:
        found = right(self, *given)
        return replace(found, joint_torque=np.where(SLIDES, 0.5, 1.0) * found.joint_torque)

    def broken() -> set[str]:
        checks = second_opinion(
            rail_plan.scene, rail_plan.options, rail_plan.trajectory, robot=rail_plan.robot, stroke=0
        )
        return {check.quantity for check in checks if not check.holds}

    assert broken() == set()
    monkeypatch.setattr(Dynamics, "efforts", halved)
    assert broken() == {"difference of the joint torque from a second computation"}


def test_units_are_those_of_the_joints(rail_plan: Plan) -> None:
    units = {check.quantity: check.unit for check in rail_plan.certificate.checks}
    for quantity, unit in units.items():
        for name, (turning, sliding) in {
            "velocity": ("rad/s", "m/s"),
            "acceleration": ("rad/s2", "m/s2"),
            "jerk": ("rad/s3", "m/s3"),
            "torque": ("Nm", "N"),
        }.items():
            if quantity.startswith(f"{name} of ") and quantity.split()[-1] in RAIL_JOINTS:
                assert unit == (sliding if quantity.split()[-1] in ("rail", "draw") else turning)
    page = report_page(rail_plan)
    assert ">-0.5 to 0.7 m<" in page
    assert "0.8 m/s²" in page
    assert "900 N<" in page
    charts = list(joint_charts(rail_plan))
    assert [chart.unit for chart in charts[:2]] == ["m", "deg"]
    assert [chart.title for chart in charts[:2]] == ["position", "angle"]
    assert [chart.unit for chart in charts[-7:]] == ["N" if slides else "Nm" for slides in SLIDES]


def test_a_base_that_bends_the_same_wherever_the_arm_slides_is_told(rail_plan: Plan) -> None:
    (line,) = (line for line in remarks(rail_plan) if line.startswith("rail slides from "))
    moved = np.concatenate([segment.trajectory.q[:, 0] for segment in rail_plan.job.segments])
    assert f"from {moved.min():.3g} to {moved.max():.3g} m" in line
    assert "state how it bends where it is softest" in line
    rigid = replace(rail_plan, scene=rail_plan.scene.changed(guardrail={"bays": 0}))
    assert not any("slides from" in line for line in remarks(rigid))


def test_a_start_elsewhere_is_told_in_the_units_of_the_joints(rail_plan: Plan) -> None:
    posture = np.array(rail_plan.scene.posture)
    posture[:2] += 0.12, 0.5
    start = Start(posture=posture, moved=0.5, failures=())
    first = " ".join(remarks(replace(rail_plan, start=start)))
    where = "(0.220 m, 40.1 deg, 14.3 deg, 0.100 m, 17.2 deg, 45.8 deg, -11.5 deg)"
    assert f"{where}, up to 28.6 deg and 0.120 m a joint away" in first
    only = replace(start, posture=rail_plan.scene.posture + np.where(SLIDES, 0.01, 0.0))
    assert "up to 0.010 m a joint away" in " ".join(remarks(replace(rail_plan, start=only)))


def test_an_approach_is_certified(asked: StrokeRequest) -> None:
    found = self_motion_postures(asked)
    end = found[len(found) // 2]
    approach = plan_approach(asked, end, np.array(found))
    assert approach.certificate.holds
    np.testing.assert_allclose(approach.trajectory.q[[0, -1]], [asked.state.posture, end], rtol=0, atol=1e-12)
    assert (np.ptp(approach.trajectory.q, axis=0)[SLIDES] > 0.01).all()


def test_postures_in_degrees_are_refused(tmp_path: Path) -> None:
    degrees = np.rad2deg(POSTURE).tolist()
    scene = load_scene(rail_data(tmp_path, {"start": {"posture_deg": degrees}}))
    with pytest.raises(SceneError, match=r"posture_deg: got degrees, but rail slides, expected start: {po"):
        task_of(strokes_of(scene, robot_of(scene))[0], scene)
    with pytest.raises(SceneError, match="start: got posture_deg and posture, expected exactly one"):
        load_scene(rail_data(tmp_path, {"start": {"posture_deg": degrees, "posture": POSTURE}}))


def test_via_points_slide_with_exact_derivatives(tmp_path: Path, rng: np.random.Generator) -> None:
    problem = problem_of(rail_scene(tmp_path))
    asked, q = problem.request, problem.parametrization.via_points
    manifold, metric = (
        TaskManifold(asked.cell.postures, asked.task, asked.goals, asked.times),
        asked.cell.robot.metric,
    )
    tangents = metric.coordinates(manifold.tangents(q))
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=2), 1.0, rtol=0, atol=1e-12)
    u = 0.1 * rng.normal(size=tangents.shape[:2])
    moved, slope = manifold.retract(q, manifold.tangents(q), u, np.arange(len(q)))
    assert off_task(asked.cell.robot, asked.task, moved, asked.goals) < 1e-10
    along = np.einsum("kai,ki->ka", tangents, metric.coordinates(moved - q))
    np.testing.assert_allclose(along, u, rtol=0, atol=1e-10)
    check_derivative(
        lambda y: manifold.retract(q, manifold.tangents(q)[[3]], y[None], np.array([3]))[0][0],
        u[3],
        slope[3].T,
        step=3e-3,
        rtol=1e-6,
    )


def test_charts_hold_all_postures_in_range(asked: StrokeRequest, rng: np.random.Generator) -> None:
    """Random restarts of Newton's method find none that is further than a spacing from the chart."""
    sampler, limits, metric = SelfMotionSampler(asked), asked.cell.robot.limits, asked.cell.robot.metric
    chart = sampler.first(asked.goals[0], asked.state.posture[None])
    assert ((chart >= limits.lower) & (chart <= limits.upper))[:, SLIDES].all()
    assert off_task(asked.cell.robot, asked.task, chart, asked.goals[0]) < 1e-9
    start = rng.uniform(np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi), (300, 7))
    q, reached = project_onto_task(asked.cell.postures, asked.task, start, asked.goals[0], steps=50)
    q = limits.turned_to_middle(q[reached])
    q = q[limits.contain(q)]
    assert len(q) > 20
    moves = metric.coordinates(limits.turned_to_middle(chart)[:, None] - q)
    moves = np.where(SLIDES, moves, moves - 2 * np.pi * np.round(moves / (2 * np.pi)))
    assert np.linalg.norm(moves, axis=2).min(axis=0).max() < 1.5 * sampler.spacing


def test_least_norms_do_not_depend_on_the_unit_of_length(asked: StrokeRequest) -> None:
    """Moves along the null space are as long by the metric; by joints that slide and that turn."""
    null = null_space(asked.cell.postures, asked.task, asked.state.posture[None])[0]
    np.testing.assert_allclose(asked.cell.robot.metric.lengths(null), 1.0, rtol=0, atol=1e-12)
    found = self_motion_postures(asked)
    away = asked.cell.robot.metric.lengths(np.array(found) - asked.state.posture)
    assert (np.diff(away) >= 0).all()
    assert asked.cell.robot.limits.contain(np.array(found)).all()


def test_nothing_is_proven_by_angles_that_slide(asked: StrokeRequest) -> None:
    """Its last three axes meet, but what comes before them slides."""
    assert wrist_chain(asked) is None
    assert out_of_reach(asked, 0) == ""
    path = asked.task.path
    beyond = path.corners + np.array([0.0, 0.0, asked.cell.robot.reach])
    away = replace(asked, task=replace(asked.task, path=with_corners(path, beyond)))
    assert out_of_reach(away, 0).startswith("out of reach: the tool point is ")


def test_gradient_projection_follows_the_path(asked: StrokeRequest) -> None:
    path = follow_path(asked)
    assert path.drift.max() < 1e-4
    assert asked.cell.robot.limits.contain(path.q).all()
    assert (np.ptp(path.q, axis=0)[SLIDES] > 1e-3).all()


def test_free_postures_are_connected_within_the_ranges(asked: StrokeRequest) -> None:
    """By two trees, and by a roadmap on which the arm's own moment about the foot is less."""
    limits = asked.cell.robot.limits
    space = FreeSpace(
        asked.cell.robot,
        asked.cell.clearances,
        0.01,
        lambda q: asked.cell.objective.at_rest(asked.cell.postures.at(q)),
    )
    end = asked.state.posture.copy()
    end[RAIL_JOINTS.index("rail")] = limits.lower[0] + 0.01
    path = rrt_connect(space, asked.state.posture, end[None])
    assert path is not None
    lower = lower_peak(space, path, 0.0, iter([False, True, True, True, True, True]).__next__)
    assert limits.contain(np.vstack([path, lower])).all()
    assert space.peak(lower) <= space.peak(path)
