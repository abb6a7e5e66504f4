"""The global stage: best sequences through the charts, the floor below all of them, and honest failure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_scenes import short_scene

from cmbot.common.errors import PathNotFound, PlanningError
from cmbot.planning import GlobalSearch, plan
from cmbot.planning.context import PlanningContext, build_context
from cmbot.planning.selfmotion.dynamic_programming import refine
from cmbot.planning.selfmotion.global_search import sequences_beside
from cmbot.robot import Dynamics, Postures
from cmbot.scene import Scene


def setting_of(scene: Scene, **options: object) -> PlanningContext:
    return build_context(scene, replace(scene.planner, knots="sliding", **options))


@pytest.fixture(scope="module")
def context() -> PlanningContext:
    return setting_of(short_scene())


@pytest.fixture(scope="module")
def stage(context: PlanningContext) -> GlobalSearch:
    return GlobalSearch(context)


@pytest.mark.parametrize("pinned", [False, True])
def test_a_solution_is_admissible(context: PlanningContext, stage: GlobalSearch, pinned: bool) -> None:
    solution = stage.solve(pinned=pinned)
    robot, task, options = context.robot, context.task, context.options
    at = Postures(robot).at(solution.q)
    points = task.path.position(context.times)
    assert np.abs(task.errors(at.tool_point, at.tool_rotation, points)).max() < 1e-9
    assert ((solution.q >= robot.limits.lower) & (solution.q <= robot.limits.upper)).all()
    assert context.clearances.smallest(solution.q).distance.min() >= options.safety_margin_m
    assert (np.abs(at.joint_torque) <= robot.limits.torque).all()
    steps = options.step_share * robot.limits.velocity * np.diff(context.times)[:, None]
    assert (np.abs(np.diff(solution.q, axis=0)) <= steps + 0.5 * options.chart_spacing).all()
    np.testing.assert_allclose(solution.value, np.linalg.norm(at.guardrail_torque, axis=1))
    if pinned:
        np.testing.assert_allclose(solution.q[0], context.posture, atol=1e-12)


def test_freedom_never_costs_torque(stage: GlobalSearch) -> None:
    free, pinned = stage.solve(pinned=False).peak, stage.solve(pinned=True).peak
    assert stage.lower_bound.value - stage.lower_bound.error <= free <= pinned


def test_the_floor_is_below_what_random_postures_ask(context: PlanningContext, stage: GlobalSearch) -> None:
    """No admissible posture at the floor's via-point, found by other random seeds, is below the floor."""
    finer = GlobalSearch(
        replace(context, options=replace(context.options, chart_spacing=0.05, chart_seeds=500))
    )
    floor = stage.lower_bound
    assert finer.lower_bound.value >= floor.value - floor.error - 1e-9
    assert floor.value == pytest.approx(finer.lower_bound.value, rel=1e-4)
    assert floor.value == floor.each[floor.via_point] == floor.each.max()


@settings(max_examples=4)
@given(
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.3, 0.1), st.floats(-0.1, 0.15)).filter(
        lambda by: np.linalg.norm(by) > 0.05
    )
)
def test_no_plan_rests_below_the_floor(by: tuple[float, float, float]) -> None:
    """Whatever the tool path: the fixed-knot plan's via-points obey the floor of the sliding one."""
    scene = short_scene(tool_path={"legs": [{"by": list(by), "seconds": 6}], "via_points": 6})
    try:
        fixed = plan(scene)
    except PlanningError:
        return
    floor = GlobalSearch(setting_of(scene)).lower_bound
    static = Dynamics(fixed.robot).static_efforts(fixed.trajectory.q).guardrail_torque
    assert np.linalg.norm(static, axis=1).max() >= floor.value - floor.error


def test_a_blocked_via_point_is_named_with_its_reason() -> None:
    wall = {"name": "wall", "box": [2.5, 0.1, 2.5], "xyz": [1.85, 0.5, -2.06]}
    with pytest.raises(
        PathNotFound,
        match=r"via-point \d of 8 is blocked: \d+ postures come within.*lower planner\.safety_margin_m",
    ) as caught:
        GlobalSearch(setting_of(short_scene(obstacles=[wall])))
    assert 0 < caught.value.progress < 1


def test_a_via_point_out_of_reach_is_named() -> None:
    legs = [{"by": [0, 2.5, 0], "seconds": 60}]
    with pytest.raises(PathNotFound, match="blocked: out of reach: no posture within the joint ranges"):
        GlobalSearch(setting_of(short_scene(tool_path={"legs": legs})))


def test_joints_that_are_too_slow_are_named() -> None:
    legs = [{"by": [0, -0.6, 0], "seconds": 0.3}]
    with pytest.raises(PathNotFound, match=r"too far from those before .*give the leg more seconds"):
        GlobalSearch(
            setting_of(short_scene(tool_path={"legs": legs, "via_points": 5}), chart_spacing=0.1)
        ).solve(pinned=True)


def test_weak_joints_are_named() -> None:
    with pytest.raises(PathNotFound, match=r"ask too much of a joint's torque.* lighter payload"):
        GlobalSearch(setting_of(short_scene(robot={"payload_kg": 60.0})))


@pytest.mark.parametrize("keep", ["axis", "position"])
@pytest.mark.parametrize("pinned", [False, True])
def test_wide_self_motions(keep: str, pinned: bool) -> None:
    """More freedom costs nothing, and what is done about coarse charts keeps everything that was asked."""
    pose = setting_of(short_scene())
    context = setting_of(short_scene(tool_path={"keep": keep}))
    stage = GlobalSearch(context)
    solution = stage.solve(pinned=pinned)
    test_a_solution_is_admissible(context, stage, pinned)
    assert solution.peak <= GlobalSearch(pose).solve(pinned=pinned).peak + 1e-9
    if not pinned:
        assert solution.peak <= stage.lower_bound.value * (1 + 2e-3)


def test_refining_never_raises_the_peak() -> None:
    context = setting_of(short_scene(tool_path={"keep": "axis"}))
    postures, task = Postures(context.robot), context.task
    sequences = sequences_beside(context, context.posture, 0, 0.3)
    q = np.stack([each[0] for each in sequences])
    np.testing.assert_array_equal(q[0], context.posture)
    for each, point in zip(sequences, task.path.position(context.times), strict=True):
        at = postures.at(each)
        assert len(each) > 20
        assert np.abs(task.errors(at.tool_point, at.tool_rotation, point)).max() < 1e-9
    steps = np.full((len(q) - 1, 7), 0.3)
    before = context.objective.at_rest(postures.at(q)).max()
    for stays in (True, False):
        better = refine(context, q, steps, 0.3, 0.0, start_stays=stays)
        at = postures.at(better)
        points = task.path.position(context.times)
        assert np.abs(task.errors(at.tool_point, at.tool_rotation, points)).max() < 1e-9
        assert (np.abs(np.diff(better, axis=0)) <= steps).all()
        assert not context.clearances.check_collision(better, context.options.safety_margin_m).any()
        peak = context.objective.at_rest(at).max()
        assert peak <= before
        assert (peak < before - 10) != stays
        assert (better[0] == q[0]).all() == stays
