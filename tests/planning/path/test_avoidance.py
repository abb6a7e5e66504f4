"""Avoidance: self-motion alone, Eq. (17) to the letter or faded in, and what it gains."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_scenes import context_of, short_scene

from cmbot.common.arrays import FloatArray
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.gradient_projection import JointPath, follow_path
from cmbot.robot import Dynamics, Kinematics
from cmbot.scene import Scene, load_scene

Followed = tuple[PlanningContext, JointPath]
OPTIONS = {"path_step_s": 0.04}


@pytest.fixture(scope="module")
def triangle_path() -> Followed:
    context = context_of(load_scene("triangle"), **OPTIONS)
    return context, follow_path(context)


@pytest.fixture(scope="module")
def near_postures(triangle_path: Followed) -> FloatArray:
    """Postures beside the triangle's path where something is near."""
    context, path = triangle_path
    q = path.q[::10] + np.random.default_rng(3).uniform(-0.1, 0.1, path.q[::10].shape)
    near = context.clearances.smallest(q, avoidable_only=True).distance
    return q[(near > 0.005) & (near < 0.14)]


def self_motion(context: PlanningContext, q: FloatArray, **options: Any) -> FloatArray:
    """Joint rates at `q` when the tool is to stay where it is."""
    X_WT = Kinematics(context.robot).tool_pose(q)
    # A leg of no length to speak of.
    corners = np.array([X_WT.translation, X_WT.translation + np.array([0, 0, 1e-12])])
    path = replace(context.task.path, corners=corners, orientation=X_WT.rotation, seconds=np.array([0.02]))
    chosen = replace(context.options, path_step_s=0.02, **options)
    still = replace(context, task=replace(context.task, path=path), options=chosen)
    return follow_path(still, q, stop_at_obstacles=False).v[0]


@pytest.mark.parametrize("avoidance", ["smooth", "switch"])
def test_self_motion_leaves_the_tool_alone(
    triangle_path: Followed, near_postures: FloatArray, avoidance: str
) -> None:
    context, _ = triangle_path
    kinematics = Kinematics(context.robot)
    fastest = 0.0
    for q in near_postures:
        v = self_motion(context, q, avoidance=avoidance)
        assert np.abs(kinematics.tool_jacobian(q)[1] @ v).max() < 1e-9
        fastest = max(fastest, np.abs(v).max())
    assert fastest > 0.1


def test_switch_is_equation_17_to_the_letter(triangle_path: Followed, near_postures: FloatArray) -> None:
    context, path = triangle_path
    kinematics, clearances = Kinematics(context.robot), context.clearances
    avoidable = [k for k, pair in enumerate(clearances.pairs) if pair.avoidable]
    far = path.q[clearances.smallest(path.q, avoidable_only=True).distance > 0.16][:3]
    assert len(far) == 3
    assert len(near_postures) > 5
    for q in (*near_postures, *far):
        near = min((clearances.nearest(q, k) for k in avoidable), key=lambda found: found.distance)
        u = (near.point - near.other_point) / near.distance
        gradient = np.linalg.pinv(near.jacobian) @ u if near.distance <= 0.15 else np.zeros(7)
        J = kinematics.tool_jacobian(q)[1]
        expected = 2.0 * (np.eye(7) - np.linalg.pinv(J) @ J) @ gradient
        got = self_motion(context, q, avoidance="switch")
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6)


def test_smooth_avoidance_of_one_pair_fades_in(triangle_path: Followed, near_postures: FloatArray) -> None:
    """With one near pair it is Eq. (17) times 1 - d/d_s."""
    context, _ = triangle_path
    compared = 0
    for q in near_postures:
        # d_s just beyond the nearest pair, short of the next.
        distances = sorted(near.distance for near in context.clearances.within(q, 0.5))
        d_s = 0.5 * (distances[0] + distances[1])
        got, switched = (
            self_motion(context, q, avoidance=kind, avoidance_distance_m=d_s) for kind in ("smooth", "switch")
        )
        np.testing.assert_allclose(got, (1 - distances[0] / d_s) * switched, rtol=0, atol=1e-9)
        compared += np.abs(got).max() > 1e-3
    assert compared > 3


def largest_jump(scene: Scene, step: float, avoidance: Any) -> float:
    path = follow_path(context_of(scene, path_step_s=step, avoidance=avoidance))
    return float(np.abs(np.diff(path.v, axis=0)).max())


def test_smooth_rates_are_continuous_and_switched_ones_are_not() -> None:
    """Jumps from step to step shrink with the step, or do not."""
    scene = short_scene(
        tool_path={"legs": [{"by": [0, -0.6, 0], "seconds": 8}]},
        obstacles=[{"name": "slab", "box": [6, 1.2, 0.12], "xyz": [1, -0.8, -1.06]}],
    )
    smooth = [largest_jump(scene, step, "smooth") for step in (0.08, 0.04, 0.02)]
    assert smooth[1] < 0.65 * smooth[0]
    assert smooth[2] < 0.65 * smooth[1]
    switch = [largest_jump(scene, step, "switch") for step in (0.04, 0.02)]
    assert switch[1] > 0.8 * switch[0]
    assert switch[1] > 50 * smooth[2]


def with_options(followed: Followed, **options: Any) -> JointPath:
    """The triangle's path again, with other options, whatever is in the way."""
    context, path = followed
    other = replace(context, options=replace(context.options, **options))
    return follow_path(other, path.q[0], stop_at_obstacles=False)


def test_avoidance_gains_clearance(triangle_path: Followed) -> None:
    context, path = triangle_path
    clearances = context.clearances
    without = with_options(triangle_path, avoidance_gain=0.0)
    assert path.clearance.min() > without.clearance.min() + 0.01
    ours, theirs = (clearances.smallest(x.q, avoidable_only=True).distance.min() for x in (path, without))
    assert ours > theirs + 0.01


def test_pulling_the_centre_of_gravity_lowers_the_torque(triangle_path: Followed) -> None:
    context, path = triangle_path
    pulled = with_options(triangle_path, centre_of_gravity_weight=0.2)
    dynamics = Dynamics(context.robot)
    mean, mean_without = (
        np.linalg.norm(dynamics.static_efforts(x.q).guardrail_torque, axis=1).mean() for x in (pulled, path)
    )
    assert mean < 0.98 * mean_without
    assert pulled.drift.max() < 1e-3
