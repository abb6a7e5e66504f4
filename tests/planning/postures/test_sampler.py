"""Samples of postures that hold the tool: what is true of every one of them, by other means."""

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import off_task, request_of, short_scene, tool_points

from cmbot.planning.postures.sampler import PostureSampler, axis_leans
from cmbot.planning.request import StrokeRequest
from cmbot.robot import Dynamics


@pytest.fixture(scope="module")
def asked() -> StrokeRequest:
    return request_of(short_scene())


@pytest.fixture
def sampler(asked: StrokeRequest) -> PostureSampler:
    return PostureSampler(cell=asked.cell, task=asked.task)


def test_what_is_drawn_is_within_the_ranges_and_the_same_again(sampler: PostureSampler) -> None:
    q, limits = sampler.drawn(500), sampler.cell.robot.limits
    assert q.shape == (500, 7)
    assert limits.contain(q).all()
    assert (np.abs(q - limits.range_middle) <= np.pi).all()
    # All of the ranges is drawn from, and the next postures are others.
    assert (np.ptp(q, axis=0) > 1.9 * limits.sampled_half).all()
    np.testing.assert_array_equal(q, replace(sampler, rng=np.random.default_rng(0)).drawn(500))
    assert not np.isclose(sampler.drawn(500), q).all(axis=1).any()


def test_postures_at_goals_hold_the_tool_and_are_admissible(
    asked: StrokeRequest, sampler: PostureSampler
) -> None:
    some, robot = asked.goals[np.array([0, 5])], asked.cell.robot
    each = sampler.at_each(some, 60, asked.state.posture)
    assert len(each) == 2
    margin = asked.cell.options.safety_margin_m
    for number, q in enumerate(each):
        assert len(q) > 0
        assert off_task(robot, asked.task, q, some[number]) < 1e-9
        np.testing.assert_allclose(tool_points(robot, q) - some.point[number], 0.0, atol=1e-9)
        assert ((q >= robot.limits.lower) & (q <= robot.limits.upper)).all()
        torque = np.array([Dynamics(robot).static_efforts(q_k[None]).joint_torque[0] for q_k in q])
        assert (np.abs(torque) <= robot.limits.torque).all()
        alone = [asked.cell.clearances.query(q_k[None]).distance[0] for q_k in q]
        assert min(alone) >= margin


def test_what_is_left_out_is_not_admissible(asked: StrokeRequest, sampler: PostureSampler) -> None:
    """Each posture that is left out breaks one of the conditions, judged alone."""
    q, cell = sampler.drawn(200), asked.cell
    bounds = np.hstack([cell.robot.limits.torque, [joint.limit for joint in cell.robot.holding_joints]])
    holds = cell.admissible(q)
    assert 0 < holds.sum() < 200
    for q_k, admissible in zip(q, holds, strict=True):
        efforts = Dynamics(cell.robot).static_efforts(q_k[None])
        held = cell.robot.holding_torque(efforts.guardrail_wrench)
        strong = bool((np.abs(np.hstack([efforts.joint_torque, held])) <= bounds).all())
        clear = bool(cell.clearances.query(q_k[None]).distance[0] >= cell.options.safety_margin_m)
        assert admissible == (strong and clear)
    beyond = q[holds] + 2 * (cell.robot.limits.upper - cell.robot.limits.lower)
    assert not cell.admissible(beyond).any()


def test_less_may_be_used_where_that_is_asked(asked: StrokeRequest, sampler: PostureSampler) -> None:
    q = sampler.admissible(sampler.drawn(400))
    use = asked.cell.use_at_rest(asked.cell.postures.at(q))
    some = float(np.median(use))
    np.testing.assert_array_equal(replace(sampler, most_use=some).admissible(q), q[use <= some])


def test_empty_batches_stay_empty(asked: StrokeRequest, sampler: PostureSampler) -> None:
    none = np.empty((0, 7))
    assert sampler.near(none, asked.goals[0]).shape == (0, 7)
    assert sampler.admissible(none).shape == (0, 7)
    assert asked.cell.clear(none).shape == asked.cell.admissible(none).shape == (0,)


def test_an_axis_stays_within_its_cone() -> None:
    cone = np.radians(15.0)
    asked = request_of(short_scene(tool_path={"keep": {"axis_within_deg": 15.0}}))
    sampler = PostureSampler(cell=asked.cell, task=asked.task, steps=40)
    start = asked.state.posture + np.random.default_rng(1).normal(0.0, 0.3, (200, 7))
    goal = asked.goals[0]
    tilted, held = sampler.within_cone(start, goal)
    rotation = asked.cell.postures.tool_at(tilted[held]).tool_rotation
    angle = np.arccos(np.clip(rotation[:, :, 2] @ goal.rotation[0][:, 2], -1.0, 1.0))
    assert held.any()
    assert angle.max() <= cone + 1e-9
    # In the middle of the cone, where the axis would be out of it.
    either, also = sampler.within_cone(start, goal, or_middle=True)
    assert also.sum() > held.sum()
    np.testing.assert_array_equal(either[held], tilted[held])


def test_leans_are_to_all_sides_by_the_same_angle() -> None:
    axes = np.array([lean[:, 2] for lean in axis_leans(0.2, 6)])
    np.testing.assert_allclose(axes[:, 2], np.cos(0.2), atol=1e-12)
    np.testing.assert_allclose(axes.sum(axis=0)[:2], 0.0, atol=1e-12)
