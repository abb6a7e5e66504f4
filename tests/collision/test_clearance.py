"""Clearances against closed forms and plain minimisation; their derivatives against finite differences."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from conftest import StateSamples
from finite_differences import check_derivative
from numpy.typing import NDArray
from oracles.distances import between_hulls, capsule_of, from_capsule
from scipy.spatial.transform import Rotation

from cmbot.collision import Clearances
from cmbot.robot import Robot
from cmbot.scene import Box, Capsule, Cylinder, Obstacle, Shape, Sphere

FloatArray = NDArray[np.float64]
LINKS = ("link_1", "link_2", "link_3", "link_5", "tool")
SHAPES: dict[str, tuple[Shape, Any]] = {
    "box": (Box(size=(0.3, 0.5, 0.9)), coal.Box(0.3, 0.5, 0.9)),
    "cylinder": (Cylinder(radius=0.2, length=0.7), coal.Cylinder(0.2, 0.7)),
    "capsule": (Capsule(radius=0.15, length=0.6), coal.Capsule(0.15, 0.6)),
    "sphere": (Sphere(radius=0.3), coal.Sphere(0.3)),
}
every_shape = pytest.mark.parametrize("kind", SHAPES)


def turned_pose(rng: np.random.Generator) -> Any:
    """Somewhere in the arm's reach, turned at random."""
    return pin.SE3(Rotation.random(rng=rng).as_matrix(), rng.uniform([-1.5, -1, -2.5], [1.5, 2, 0]))


def obstacle(shape: Shape, X_WO: Any, **options: Any) -> Obstacle:
    return Obstacle(name="thing", shape=shape, X_WO=X_WO.homogeneous, **options)


def pair_with(clearances: Clearances, link: str, other: str = "thing") -> int:
    (found,) = (k for k, pair in enumerate(clearances.pairs) if (pair.link, pair.other) == (link, other))
    return found


@every_shape
def test_distance_to_an_obstacle(
    cmbot_robot: Robot, rng: np.random.Generator, random_states: StateSamples, kind: str
) -> None:
    shape, geometry = SHAPES[kind]
    overlaps = 0
    for q in random_states(cmbot_robot, 30)[0]:
        # Beside one of the links, so that many pairs overlap a little.
        start, end, _ = capsule_of(cmbot_robot, q, rng.choice(LINKS))
        X_WO = turned_pose(rng)
        X_WO.translation = start + rng.uniform() * (end - start) + rng.normal(size=3) * 0.25
        clearances = Clearances(cmbot_robot, [obstacle(shape, X_WO)])
        for link in LINKS:
            expected = from_capsule(cmbot_robot, q, link, geometry, X_WO)
            if np.isnan(expected):
                continue
            near = clearances.nearest(q, pair_with(clearances, link))
            assert near.distance == pytest.approx(expected, abs=1e-7)
            overlaps += near.distance < 0
    assert overlaps > 3


def test_distances_of_the_arm_to_itself(cmbot_robot: Robot, random_states: StateSamples) -> None:
    clearances = Clearances(cmbot_robot, [])
    shapes = cmbot_robot.collision_model.geometryObjects
    data = cmbot_robot.model.createData()
    compared = set()
    for q in random_states(cmbot_robot, 8)[0]:
        pin.forwardKinematics(cmbot_robot.model, data, q)
        expected: dict[tuple[str, str], list[float]] = {}
        for pair in cmbot_robot.collision_model.collisionPairs:
            inner, outer = sorted(
                (shapes[pair.first], shapes[pair.second]), key=lambda shape: int(shape.parentJoint)
            )
            link, other = (cmbot_robot.model.frames[s.parentFrame].name for s in (outer, inner))
            if outer.parentJoint != inner.parentJoint:
                X_WS = data.oMi[inner.parentJoint] * inner.placement
                distance = from_capsule(cmbot_robot, q, link, inner.geometry, X_WS)
                expected.setdefault((link, other), []).append(distance)
        got: dict[tuple[str, str], list[float]] = {}
        for k, pair in enumerate(clearances.pairs):
            assert pair.self_collision
            got.setdefault((pair.link, pair.other), []).append(clearances.nearest(q, k).distance)
        assert {key: len(value) for key, value in got.items()} == {
            key: len(value) for key, value in expected.items()
        }
        for key, distances in got.items():
            if not np.isnan(expected[key]).any():
                np.testing.assert_allclose(sorted(distances), sorted(expected[key]), rtol=0, atol=1e-7)
                compared.add(key)
    assert {("link_5", "link_2"), ("tool", "link_1"), ("tool", "arm_base")} <= compared


def test_box_by_its_corners(
    cmbot_robot: Robot, rng: np.random.Generator, random_states: StateSamples
) -> None:
    """A second oracle, which knows nothing of closest features."""
    corners = np.array(np.meshgrid([-0.15, 0.15], [-0.25, 0.25], [-0.45, 0.45])).reshape(3, -1).T
    for q in random_states(cmbot_robot, 5)[0]:
        X_WO = turned_pose(rng)
        clearances = Clearances(cmbot_robot, [obstacle(Box(size=(0.3, 0.5, 0.9)), X_WO)])
        start, end, radius = capsule_of(cmbot_robot, q, "tool")
        apart = between_hulls(np.array([start, end]), np.array([X_WO.act(corner) for corner in corners]))
        got = clearances.nearest(q, pair_with(clearances, "tool")).distance
        assert got + radius == pytest.approx(apart, abs=1e-6)


@every_shape
def test_nearest_points(
    cmbot_robot: Robot, rng: np.random.Generator, random_states: StateSamples, kind: str
) -> None:
    """They are `distance` apart along `direction`, which leads from the obstacle to the arm."""
    shape, _ = SHAPES[kind]
    for q in random_states(cmbot_robot, 20)[0]:
        clearances = Clearances(cmbot_robot, [obstacle(shape, turned_pose(rng))])
        near = clearances.nearest(q, pair_with(clearances, "link_5"))
        assert np.linalg.norm(near.direction) == pytest.approx(1, abs=1e-12)
        apart = near.other_point + near.distance * near.direction
        np.testing.assert_allclose(near.point, apart, rtol=0, atol=1e-6)
        start, end, radius = capsule_of(cmbot_robot, q, "link_5")
        s = np.clip((near.point - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
        assert np.linalg.norm(near.point - start - s * (end - start)) == pytest.approx(radius, abs=1e-6)


def check_gradient(clearances: Clearances, q: FloatArray, pair: int) -> None:
    # GJK's rounding divided by the step bounds what can be seen.
    check_derivative(
        lambda x: clearances.nearest(x, pair).distance,
        q,
        clearances.nearest(q, pair).gradient,
        step=1e-4,
        rtol=1e-4,
        atol=1e-5,
    )


@every_shape
def test_gradient(
    cmbot_robot: Robot, rng: np.random.Generator, random_states: StateSamples, kind: str
) -> None:
    shape, _ = SHAPES[kind]
    checked = 0
    for q in random_states(cmbot_robot, 15)[0]:
        clearances = Clearances(cmbot_robot, [obstacle(shape, turned_pose(rng))])
        for pair, names in enumerate(clearances.pairs):
            # Deep inside, the way out jumps from face to face.
            if not names.self_collision and clearances.nearest(q, pair).distance > -0.02:
                check_gradient(clearances, q, pair)
                checked += 1
    assert checked > 50


def test_gradient_of_the_arm_to_itself(cmbot_robot: Robot, random_states: StateSamples) -> None:
    clearances = Clearances(cmbot_robot, [])
    for q in random_states(cmbot_robot, 3)[0]:
        for pair in range(len(clearances.pairs)):
            if clearances.nearest(q, pair).distance > 0:
                check_gradient(clearances, q, pair)


@every_shape
@pytest.mark.parametrize("target", [1e-6, 0.0, -1e-6, -0.005])
def test_gradient_where_shapes_nearly_touch_or_overlap(
    cmbot_robot: Robot, rng: np.random.Generator, random_states: StateSamples, kind: str, target: float
) -> None:
    shape, _ = SHAPES[kind]
    checked = 0
    for q in random_states(cmbot_robot, 6)[0]:
        clearances = Clearances(cmbot_robot, [obstacle(shape, turned_pose(rng))])
        pair = pair_with(clearances, "link_5")
        for _ in range(60):
            near = clearances.nearest(q, pair)
            miss = target - near.distance
            if abs(miss) < 1e-10 or near.gradient @ near.gradient < 1e-3:
                break
            q = q + np.clip(miss, -0.1, 0.1) * near.gradient / (near.gradient @ near.gradient)
        if abs(miss) < 1e-8:
            check_gradient(clearances, q, pair)
            checked += 1
    assert checked >= 3


def test_joints_that_move_both_shapes_alike_do_not_count(
    cmbot_robot: Robot, random_states: StateSamples
) -> None:
    clearances = Clearances(cmbot_robot, [])
    for q in random_states(cmbot_robot, 5)[0]:
        with_link, with_base = (
            clearances.nearest(q, pair_with(clearances, "tool", other)) for other in ("link_2", "foot_2")
        )
        np.testing.assert_allclose(with_link.gradient[:2], 0, rtol=0, atol=1e-12)
        assert np.abs(with_base.gradient[:2]).max() > 1e-3


def test_distances_do_not_depend_on_what_was_asked_before(
    cmbot_robot: Robot, random_states: StateSamples, rng: np.random.Generator
) -> None:
    """Bit by bit, also in overlaps: so a certificate can be made again."""
    shape, _ = SHAPES["cylinder"]
    clearances = Clearances(cmbot_robot, [obstacle(shape, turned_pose(rng))])
    q = random_states(cmbot_robot, 60)[0]
    pairs = range(len(clearances.pairs))

    def distances(order: range) -> FloatArray:
        found = np.empty((len(q), len(pairs)))
        for k in order:
            for pair in pairs:
                found[k, pair] = clearances.nearest(q[k], pair).distance
        return found

    once, again = distances(range(60)), distances(range(59, -1, -1))
    assert once.min() < 0
    np.testing.assert_array_equal(once, again)
    np.testing.assert_array_equal(clearances.smallest(q).distance, once.min(axis=1))
