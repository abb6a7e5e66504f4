"""The smallest clearance over all times: never below what the bound says, found to the resolution."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from cmbot.collision import Box, Capsule, Clearances, Cylinder, Obstacle, Shape, Sphere
from cmbot.common.arrays import FloatArray
from cmbot.common.poses import pose
from cmbot.planning.certification.nearest_approach import nearest_approach
from cmbot.robot import Robot
from cmbot.trajectory import QuinticTrajectory, SplineSpace

SHAPES: tuple[Shape, ...] = (
    Box(size=(0.4, 0.002, 0.002)),
    Box(size=(0.3, 0.2, 0.1)),
    Sphere(radius=0.1),
    Cylinder(radius=0.05, length=0.5),
    Capsule(radius=0.03, length=0.4),
)


def motion(seed: int, robot: Robot, knots: int = 5, scale: float = 0.4) -> QuinticTrajectory:
    """A smooth motion from rest to rest through random postures near the start of the shipped scenes."""
    rng = np.random.default_rng(seed)
    q = np.radians([-10, -90, 90, 0, 10, 50, 0]) + rng.normal(scale=scale, size=(knots, robot.dof))
    space = SplineSpace(np.linspace(0, 2.0 * (knots - 1), knots))
    return space.trajectory(space.least_jerk(q))


@settings(max_examples=15)
@given(seed=st.integers(min_value=0, max_value=2**32 - 1), resolution=st.sampled_from([1e-2, 1e-3, 1e-4]))
def test_the_bound_holds_wherever_it_is_tried(cmbot_robot: Robot, seed: int, resolution: float) -> None:
    rng = np.random.default_rng(seed)
    x = motion(seed, cmbot_robot)
    obstacles = [
        Obstacle(name=f"o{k}", shape=shape, X_WO=pose(rng.normal(size=3), 90 * rng.normal(size=3)))
        for k, shape in enumerate(SHAPES)
    ]
    clearances = Clearances(cmbot_robot, obstacles)
    found = nearest_approach(x, clearances, resolution)
    t = np.linspace(0, x.t[-1], 801)
    near = np.clip(found.time + np.linspace(-0.02, 0.02, 101), 0, x.t[-1])
    smallest = clearances.query(x.evaluate(np.append(t, near))).distance.min()
    assert found.bound <= smallest
    assert found.distance - found.bound <= resolution + 2e-6
    assert found.distance <= smallest + resolution
    there = clearances.query(x.evaluate([found.time]))
    assert there.distance[0] == pytest.approx(found.distance, abs=1e-8)
    first, second = clearances.pairs[found.pair], clearances.pairs[there.pair[0]]
    assert first == second or clearances.nearest(x.evaluate([found.time])[0], found.pair).distance == (
        pytest.approx(found.distance, abs=1e-8)
    )


@pytest.mark.parametrize("share", [0.5, 0.1, 0.999])
def test_a_margin_that_a_coarse_bound_misses_is_looked_at_more_closely(
    cmbot_robot: Robot, share: float
) -> None:
    x, clearances = motion(3, cmbot_robot), Clearances(cmbot_robot, [])
    coarse, fine = (nearest_approach(x, clearances, resolution) for resolution in (1e-2, 1e-6))
    margin = coarse.bound + share * (fine.bound - coarse.bound)
    assert coarse.bound < margin < fine.bound
    closer = nearest_approach(x, clearances, 1e-2, margin)
    assert margin <= closer.bound <= fine.distance
    # Where the distance itself is too small no look helps.
    missed = nearest_approach(x, clearances, 1e-2, fine.distance + 1e-4)
    assert missed.bound < fine.distance + 1e-4


@pytest.mark.parametrize("samples", [4, 40])
def test_a_thin_bar_is_met_between_samples(cmbot_robot: Robot, samples: int) -> None:
    """Where the last joint passes, as far as can be from the times at which a grid would have asked."""
    x = motion(3, cmbot_robot, scale=0.1)
    grid = np.linspace(0, x.t[-1], 4 * samples + 1)
    middle = 0.5 * (grid[:-1] + grid[1:])
    data = cmbot_robot.model.createData()

    def last_joint(time: float) -> FloatArray:
        pin.forwardKinematics(cmbot_robot.model, data, x.evaluate([time])[0])
        return np.array(data.oMi[cmbot_robot.dof].translation)

    speed = [np.linalg.norm(last_joint(t + 1e-4) - last_joint(t)) for t in middle]
    time = float(middle[int(np.argmax(speed))])
    bar = Obstacle(name="bar", shape=Sphere(radius=0.001), X_WO=pose(last_joint(time)))
    clearances = Clearances(cmbot_robot, [bar])
    found = nearest_approach(x, clearances, 1e-4)
    assert found.distance < 0
    assert clearances.pairs[found.pair].other == "bar"


def test_an_arm_without_shapes_meets_nothing(cmbot_robot: Robot) -> None:
    bare = replace(cmbot_robot, collision_model=type(cmbot_robot.collision_model)())
    found = nearest_approach(motion(1, cmbot_robot), Clearances(bare, ()), 1e-4)
    assert (found.distance, found.bound, found.pair) == (np.inf, np.inf, -1)


def test_the_number_of_queries_grows_with_the_motion_not_with_the_knots(
    cmbot_robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same motion on four times the knots: less than four times the queries."""
    asked = []
    distances = Clearances.distances

    def counting(self: Clearances, q, posture, pair):  # type: ignore[no-untyped-def]
        asked[-1] += len(pair)
        return distances(self, q, posture, pair)

    monkeypatch.setattr(Clearances, "distances", counting)
    x = motion(5, cmbot_robot)
    obstacles = [Obstacle(name="slab", shape=Box(size=(6, 1.2, 0.12)), X_WO=pose([1, -0.8, -1.06]))]
    for knots in (9, 33):
        t = np.linspace(0, x.t[-1], knots)
        q, v, a = x.states(t)
        asked.append(0)
        nearest_approach(QuinticTrajectory(t=t, q=q, v=v, a=a), Clearances(cmbot_robot, obstacles), 1e-4)
    assert asked[1] < 4 * asked[0]
    # Of an arm at rest hardly any pair is measured: by what was found first the others are far enough.
    asked.append(0)
    still, clearances = np.tile(x.q[:1], (5, 1)), Clearances(cmbot_robot, obstacles)
    nearest_approach(QuinticTrajectory(t=x.t, q=still, v=0 * still, a=0 * still), clearances, 1e-4)
    assert asked[2] < 0.5 * 4 * len(clearances.pairs)


def passing(robot: Robot) -> tuple[QuinticTrajectory, Clearances]:
    """A motion whose tool, alone, comes by a ball."""
    whole = robot.collision_model
    (shape,) = (each for each in whole.geometryObjects if each.parentJoint == robot.dof)
    alone = type(whole)()
    alone.addGeometryObject(shape)
    ball = Obstacle(name="ball", shape=Sphere(radius=0.05), X_WO=pose([1, -0.8, -1.06]))
    return motion(5, robot), Clearances(replace(robot, collision_model=alone), [ball])


def test_a_bound_may_be_asked_for_closely(cmbot_robot: Robot) -> None:
    """To a tenth of what distances may be off by."""
    found = nearest_approach(*passing(cmbot_robot), 1e-7)
    assert found.distance - found.bound <= 1e-6 + 1.01e-7


def test_where_nothing_can_be_told_apart_the_search_ends(
    cmbot_robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Asked for no resolution at all the bound stays lower, and holds."""
    most, distances = 100, Clearances.distances

    def counting(self: Clearances, q, posture, pair):  # type: ignore[no-untyped-def]
        assert len(q) <= most
        return distances(self, q, posture, pair)

    monkeypatch.setattr("cmbot.planning.certification.nearest_approach._MOST_INTERVALS", most)
    monkeypatch.setattr(Clearances, "distances", counting)
    x, clearances = passing(cmbot_robot)
    found = nearest_approach(x, clearances, 0.0)
    smallest = clearances.query(x.evaluate(np.linspace(0, x.t[-1], 801))).distance.min()
    assert found.bound <= smallest
    assert found.distance - 1e-2 <= found.bound < found.distance
