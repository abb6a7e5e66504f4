"""Robots and plans in other processes: what comes out of a pickle is what went in."""

import pickle
from collections.abc import Iterator

import coal
import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_array_equal
from small_scenes import short_scene

import cmbot
from cmbot.planning import robot_of
from cmbot.robot import Dynamics, Robot


def distances(robot: Robot, q: np.ndarray) -> Iterator[float]:
    """Of every pair of shapes that may collide, by coal."""
    data, shapes = robot.model.createData(), robot.collision_model.createData()
    pin.computeDistances(robot.model, data, robot.collision_model, shapes, q)
    return (each.min_distance for each in shapes.distanceResults)


@pytest.mark.parametrize("scene", ["panda_sanding", "triangle"])
def test_a_robot_is_the_same_in_another_process(scene: str) -> None:
    """Of hulls and boxes: the same torques and distances in random postures, and the same drawing."""
    robot = robot_of(cmbot.load_scene(scene))
    again = pickle.loads(pickle.dumps(robot))
    rng = np.random.default_rng(1)
    q = robot.limits.drawn(rng, 20)
    v, a = rng.normal(size=(2, *q.shape))
    first, second = (Dynamics(each).efforts(q, v, a) for each in (robot, again))
    assert_array_equal(first.joint_torque, second.joint_torque)
    assert_array_equal(first.guardrail_wrench, second.guardrail_wrench)
    for posture in q:
        np.testing.assert_allclose([*distances(robot, posture)], [*distances(again, posture)], atol=1e-9)
    shapes = ((each.collision_model, each.read_visual_model()) for each in (robot, again))
    for before, after in zip(*shapes, strict=True):
        for one, two in zip(before.geometryObjects, after.geometryObjects, strict=True):
            places = [(each.name, each.parentJoint, each.parentFrame) for each in (one, two)]
            assert places[0] == places[1]
            assert one.placement == two.placement
            same = isinstance(one.geometry, coal.ShapeBase) and not isinstance(one.geometry, coal.ConvexBase)
            assert one.geometry == two.geometry or not same


def test_a_plan_is_the_same_in_another_process() -> None:
    """With what is worked out of it later, as its accuracy and files are."""
    plan = cmbot.plan(short_scene(planner={"knots": "fixed"}), progress=False)
    again = pickle.loads(pickle.dumps(plan))
    assert repr(again) == repr(plan)
    assert again.scene == plan.scene
    assert_array_equal(again.job.trajectory.q, plan.job.trajectory.q)
    assert again.job.figures == plan.job.figures
    assert again.certificate.holds
    t = np.linspace(0.0, plan.job.duration, 50)
    assert_array_equal(again.job.trajectory.evaluate(t, 2), plan.job.trajectory.evaluate(t, 2))
