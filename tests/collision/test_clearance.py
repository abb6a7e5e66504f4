"""Clearances against closed forms and all distances; their derivatives against finite differences."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from distance_tables import SHAPES, TOLERANCE, all_distances
from finite_differences import check_derivative
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from oracles.distances import capsule_of, from_capsule
from robot_files import load_copy
from scipy.spatial.transform import Rotation
from state_samples import StateSamples

from cmbot.collision import Box, Clearances, Obstacle, Shape, Sphere
from cmbot.collision.motion_bounds import DistanceCache, raise_bounds, shape_reach
from cmbot.collision.point_distances import PointDistances
from cmbot.collision.shapes import ShapePair
from cmbot.common.poses import pose
from cmbot.robot import Robot, load_robot, prismatic_joints
from cmbot.scene import load_scene

FloatArray = NDArray[np.float64]
LINKS = ("link_1", "link_2", "link_3", "link_5", "tool")
# More postures than are measured one by one, and more than a block of the broad phase.
MANY, BLOCKS = 60, 1200
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
def test_distance_and_nearest_points_to_an_obstacle(
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
            points = clearances.nearest_points(q, pair_with(clearances, link))
            np.testing.assert_array_equal(points, [*near.point, *near.other_point])
            overlaps += near.distance < 0
            # The points are `distance` apart along `direction`, which leads from the obstacle to the arm.
            assert np.linalg.norm(near.direction) == pytest.approx(1, abs=1e-12)
            apart = near.other_point + near.distance * near.direction
            np.testing.assert_allclose(near.point, apart, rtol=0, atol=1e-6)
            start, end, radius = capsule_of(cmbot_robot, q, link)
            s = np.clip((near.point - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
            assert np.linalg.norm(near.point - start - s * (end - start)) == pytest.approx(radius, abs=1e-6)
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
    # Joints that move both shapes alike do not count.
    for q in random_states(cmbot_robot, 5)[0]:
        with_link, with_base = (
            clearances.nearest(q, pair_with(clearances, "tool", other)) for other in ("link_2", "foot_2")
        )
        np.testing.assert_allclose(with_link.gradient[:2], 0, rtol=0, atol=1e-12)
        assert np.abs(with_base.gradient[:2]).max() > 1e-3


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


def test_distances_do_not_depend_on_what_was_asked_before(
    cmbot_robot: Robot, random_states: StateSamples, rng: np.random.Generator
) -> None:
    """Bit by bit, also in overlaps: so a certificate can be made again."""
    shape, _ = SHAPES["cylinder"]
    clearances = Clearances(cmbot_robot, [obstacle(shape, turned_pose(rng))])
    q = random_states(cmbot_robot, 60)[0]
    once, again = all_distances(clearances, q), all_distances(clearances, q[::-1])
    assert once.min() < 0
    np.testing.assert_array_equal(once, again[:, ::-1])
    np.testing.assert_array_equal(clearances.query(q).distance, once.min(axis=0))


@pytest.fixture(scope="module")
def triangle() -> tuple[Clearances, Clearances]:
    """Of the triangle: one to be tested, with its cache, one for the distances of every pair."""
    robot, obstacles = load_robot(), load_scene("triangle").all_obstacles
    return Clearances(robot, obstacles), Clearances(robot, obstacles)


def smooth_path(seed: int, length: float, number: int) -> FloatArray:
    """A path (N, 7) through the shipped arm's room that swings by about `length`, rad."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2 * np.pi, number)[:, None]
    swings = length * rng.uniform(-1, 1, 7) * np.sin(rng.integers(1, 4, 7) * t + rng.uniform(0, 6, 7))
    return np.deg2rad([-10, -90, 90, 0, 10, 50, 0]) + swings


paths = st.builds(smooth_path, st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.2, 1.0]), st.just(MANY))
jumps = st.builds(
    lambda seed: np.random.default_rng(seed).uniform(-2.8, 2.8, (MANY, 7)), st.integers(0, 2**32 - 1)
)


def walk(seed: int, jumps: list[float]) -> FloatArray:
    """Postures, each a random step of a given size from the one before."""
    rng = np.random.default_rng(seed)
    steps = [jump * rng.uniform(-1, 1, 7) for jump in jumps]
    return np.deg2rad([-10, -90, 90, 0, 10, 50, 0]) + np.cumsum(steps, axis=0)


walks = st.builds(
    walk,
    st.integers(0, 2**32 - 1),
    st.lists(st.sampled_from([0.0, 1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.3, 3.0]), min_size=1, max_size=8),
)


@settings(max_examples=50)
@given(q=walks | paths | jumps, avoidable_only=st.booleans())
def test_smallest_is_the_smallest_of_all(
    triangle: tuple[Clearances, Clearances], q: FloatArray, avoidable_only: bool
) -> None:
    clearances, every = triangle
    got = clearances.query(q, avoidable_only=avoidable_only)
    assert got.distance.shape == got.pair.shape == (len(q),)
    distances = all_distances(every, q)
    distances[[avoidable_only and not pair.avoidable for pair in every.pairs]] = np.inf
    np.testing.assert_allclose(got.distance, distances.min(axis=0), rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(distances[got.pair, np.arange(len(q))], got.distance, rtol=0, atol=TOLERANCE)


@settings(max_examples=20)
@given(q=walks | paths | jumps, share=st.floats(0, 1))
def test_a_collision_is_any_distance_below_the_margin(
    triangle: tuple[Clearances, Clearances], q: FloatArray, share: float
) -> None:
    clearances, every = triangle
    smallest = every.query(q).distance
    # Between two of the postures, so that it parts them as it should; a margin is not negative.
    margin = max(float(np.quantile(smallest, share)) + 1e-5, 0.0)
    if np.abs(smallest - margin).min() > TOLERANCE:
        np.testing.assert_array_equal(clearances.query(q, margin).distance < margin, smallest < margin)
        # One by one, with bounds from the postures before.
        few = clearances.query(q[:20], margin).distance < margin
        np.testing.assert_array_equal(few, smallest[:20] < margin)


def test_each_posture_may_have_a_bound_of_its_own(
    triangle: tuple[Clearances, Clearances], rng: np.random.Generator
) -> None:
    clearances, every = triangle
    q = np.concatenate([smooth_path(3, 0.5, 40), rng.uniform(-3, 3, (600, 7)), np.full((1, 7), np.nan)])
    smallest = every.query(q).distance
    # Just below the distance, just above it, and far off; negative ones, too.
    for off in (-1e-6, 1e-6, -0.1, 0.1, -10.0):
        below = np.where(np.isnan(smallest), True, off > 0)
        least = np.nan_to_num(smallest) + off
        np.testing.assert_array_equal(clearances.query(q, least).distance < least, below)
    assert (smallest < 0).any() and (smallest > 0.01).any()
    assert clearances.query(q[:0], np.empty(0)).distance.shape == (0,)


def test_one_by_one_and_many_in_any_order_agree(
    triangle: tuple[Clearances, Clearances], rng: np.random.Generator
) -> None:
    clearances, other = triangle
    q = smooth_path(3, 0.5, BLOCKS)
    got = clearances.query(q).distance
    assert np.ptp(got) > 0.1
    order = rng.permutation(BLOCKS)
    np.testing.assert_allclose(clearances.query(q[order]).distance, got[order], rtol=0, atol=TOLERANCE)
    some = order[:100]
    alone = [float(other.query(q[k : k + 1]).distance[0]) for k in some]
    np.testing.assert_allclose(alone, got[some], rtol=0, atol=TOLERANCE)
    none = clearances.query(q[:0])
    assert none.distance.shape == none.pair.shape == (0,)


@pytest.mark.parametrize("number", [3, MANY])
@pytest.mark.parametrize("nothing", [np.nan, np.inf])
def test_a_posture_that_is_not_finite_has_no_clearance(
    triangle: tuple[Clearances, Clearances], number: int, nothing: float
) -> None:
    clearances, _ = triangle
    q = smooth_path(2, 0.02, number)
    whole = clearances.query(q)
    q[1, 3] = nothing
    got = clearances.query(q)
    assert np.isnan(got.distance[1])
    assert got.pair[1] == -1
    known = np.arange(number) != 1
    np.testing.assert_allclose(got.distance[known], whole.distance[known], rtol=0, atol=TOLERANCE)
    # Of shapes that are nowhere coal says that they touch.
    np.testing.assert_array_equal(clearances.query(q, 0.0).distance < 0.0, ~known)
    assert (clearances.query(q[1:2], 0.0).distance < 0.0).all()


@settings(max_examples=30)
@given(q=walks, last=st.integers(0, 20))
def test_within_is_every_avoidable_pair_that_near(
    triangle: tuple[Clearances, Clearances], q: FloatArray, last: int
) -> None:
    clearances, every = triangle
    avoidable = [k for k, pair in enumerate(every.pairs) if pair.avoidable]
    for q_k in q:
        distances = np.sort([every.nearest(q_k, pair).distance for pair in avoidable])
        # Just beyond one of the pairs, so that nothing can be left out unnoticed.
        limit = distances[last] + 1e-5
        got = sorted(near.distance for near in clearances.within(q_k, limit))
        np.testing.assert_allclose(got, distances[distances < limit], rtol=0, atol=TOLERANCE)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([1e-3, 0.01, 0.1, 1.0]))
def test_no_distance_changes_faster_than_reach(
    triangle: tuple[Clearances, Clearances], seed: int, size: float
) -> None:
    _, every = triangle
    rng = np.random.default_rng(seed)
    # Alone or together, joints move no distance further.
    step = size * rng.uniform(-1, 1, 7) * (rng.uniform(size=7) < rng.choice([0.2, 1.0]))
    q = rng.uniform(-2.5, 2.5, 7)
    change = np.diff(all_distances(every, np.stack([q, q + step])))
    assert np.abs(change).max() <= np.abs(step) @ every.reach + 2 * TOLERANCE


def test_reach_is_not_far_too_long(cmbot_robot: Robot) -> None:
    """A ball far away feels most of it when the stretched arm turns towards it."""
    ball = Obstacle(name="ball", shape=Sphere(radius=0.1), X_WO=pose([0, 0, -50]))
    clearances = Clearances(cmbot_robot, [ball])
    pair = next(k for k, p in enumerate(clearances.pairs) if (p.link, p.other) == ("tool", "ball"))
    stretched = np.deg2rad([0, 0, 0, 90, 0, 0, 0])
    lever = abs(clearances.nearest(stretched, pair).gradient[1])
    assert 0.7 * clearances.reach[1] < lever <= clearances.reach[1]


def test_pairs_of_the_triangle(cmbot_robot: Robot) -> None:
    model, obstacles = cmbot_robot.collision_model, load_scene("triangle").all_obstacles
    before = len(model.geometryObjects), len(model.collisionPairs)
    pairs = Clearances(cmbot_robot, obstacles).pairs
    with_obstacles = [(pair.link, pair.other) for pair in pairs if not pair.self_collision]
    assert set(with_obstacles) == {(link, obstacle.name) for link in LINKS for obstacle in obstacles}
    assert len(with_obstacles) == len(set(with_obstacles))
    # Only what the last joint carries is at work, and only on a workpiece.
    at_work = {(pair.link, pair.other) for pair in pairs if pair.tool_at_work}
    assert at_work == {("tool", f"bracket_{side}") for side in ("ab", "bc", "ca")}
    # The further link comes first; what never moves against each other is left out.
    for pair in (pair for pair in pairs if pair.self_collision):
        assert pair.link in LINKS
        assert pair.other not in LINKS or LINKS.index(pair.link) > LINKS.index(pair.other)
    # The robot keeps its own.
    assert (len(model.geometryObjects), len(model.collisionPairs)) == before


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_bounds_of_all_pairs_are_never_above_their_distances(
    triangle: tuple[Clearances, Clearances], seed: int
) -> None:
    clearances, every = triangle
    q = smooth_path(seed, 0.3, 5)
    lower = clearances.lower_bounds(q)
    posture, pair = np.nonzero(np.ones_like(lower))
    distance = clearances.distances(q, posture, pair).reshape(lower.shape)
    assert (lower <= distance + TOLERANCE).all()
    np.testing.assert_allclose(distance.min(axis=1), every.query(q).distance, rtol=0, atol=TOLERANCE)
    # No distance changes by more than the joints' moves times the pair's reach.
    moved = np.abs(np.diff(q, axis=0)) @ clearances.pair_reach.T
    assert (np.abs(np.diff(distance, axis=0)) <= moved + TOLERANCE).all()


def test_nothing_counts_without_shapes(urdf_folder: Path) -> None:
    file = urdf_folder / "cmbot.urdf"
    text = file.read_text(encoding="utf-8")
    file.write_text(re.sub(r"<collision .*?</collision>", "", text, flags=re.DOTALL), encoding="utf-8")
    wall = Obstacle(name="wall", shape=Box(size=(1, 1, 1)), X_WO=pose([0, 0, 0]))
    clearances = Clearances(load_copy(urdf_folder), [wall])
    q = smooth_path(5, 0.1, MANY)
    for avoidable_only in (False, True):
        smallest = clearances.query(q, avoidable_only=avoidable_only)
        assert np.isposinf(smallest.distance).all()
        assert (smallest.pair == -1).all()
    assert clearances.lower_bounds(q).shape == (len(q), 0)
    assert (clearances.query(q, 1.0).distance >= 1.0).all()
    assert not clearances.pairs
    assert clearances.within(q[0], 1.0) == []


def test_nothing_to_avoid_without_obstacles(cmbot_robot: Robot, random_states: StateSamples) -> None:
    clearances = Clearances(cmbot_robot, [])
    q = random_states(cmbot_robot, 3)[0]
    assert np.isfinite(clearances.query(q).distance).all()
    assert np.isposinf(clearances.query(q, avoidable_only=True).distance).all()
    assert clearances.within(q[0], 10.0) == []


def test_deep_overlaps_have_a_depth(cmbot_robot: Robot) -> None:
    """EPA fails now and then when asked for more precision than it has, here with the free foot's ankle."""
    clearances = Clearances(cmbot_robot, [])
    pairs = [k for k, p in enumerate(clearances.pairs) if (p.link, p.other) == ("link_1", "ankle_2")]
    depths = [
        clearances.nearest(np.array([angle, 0, 0, 0, 0, 0, 0]), pair).distance
        for angle in np.linspace(1.02, 1.16, 141)
        for pair in pairs
    ]
    assert -0.1 < min(depths) < -0.09


def test_distances_beside_a_measured_one_are_enclosed(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    clearances = Clearances(cmbot_robot, ())
    geometry, data = cmbot_robot.collision_model, cmbot_robot.collision_model.createData()
    for request in data.distanceRequests:
        request.gjk_tolerance = 1e-9
    cache = DistanceCache(cmbot_robot, geometry, data, clearances.pair_reach)
    q = np.array([0.6, -1.2, 1.4, 0.7, 0.9, -0.8, 1.1]) + np.cumsum(rng.normal(size=(90, 7)) * 2e-3, axis=0)
    distance = all_distances(clearances, q).T
    seen = 0
    for here, lower, upper in cache.segments(q):
        assert (lower <= distance[here] + TOLERANCE).all()
        assert (distance[here] <= upper + TOLERANCE).all()
        seen += len(lower)
    assert seen == len(q)


def test_bounds_are_raised_by_measured_ones_on_both_sides() -> None:
    """By what the way in between leaves of them; what is better known stays."""
    distance = np.array([0.0, 0.0, 1.0, 0.0, 0.75, 0.0])
    measured = np.array([False, False, True, False, False, False])
    raise_bounds(distance, measured, np.array([0.0, 0.1, 0.3, 0.4, 0.6, 1.5]))
    np.testing.assert_allclose(distance, [0.7, 0.8, 1.0, 0.9, 0.75, 0.0])
    several = np.array([5.0, 0.0, 1.0, 0.0, 0.2])
    raise_bounds(several, several > 0, np.array([0.0, 1.0, 2.0, 2.1, 3.0]))
    np.testing.assert_allclose(several, [5.0, 4.0, 1.0, 0.9, 0.2])
    nothing = np.zeros(3)
    raise_bounds(nothing, np.zeros(3, dtype=bool), np.arange(3.0))
    assert not nothing.any()


def test_a_pair_too_near_in_words() -> None:
    pair = ShapePair(link="link_1", other="slab", self_collision=False, tool_at_work=False)
    assert pair.describe(0.01, 0.02) == "link_1 comes within 0.0100 m of slab, the safety margin is 0.02 m"
    assert pair.describe(-0.01, 0.02) == "link_1 reaches 0.0100 m into slab, the safety margin is 0.02 m"


def test_all_pairs_are_measured_in_the_second_of_two_near_postures(cmbot_robot: Robot) -> None:
    """In the first, and in one far from that before, too little is known for it to be worth that."""
    clearances = Clearances(cmbot_robot, ())
    geometry = cmbot_robot.collision_model
    cache = DistanceCache(cmbot_robot, geometry, geometry.createData(), clearances.pair_reach)
    q = np.array([0.6, -1.2, 1.4, 0.7, 0.9, -0.8, 1.1])
    assert cache.near(q, 0.1) is None
    assert cache.near(-q, 0.1) is None
    assert cache.near(q, 0.1) is None
    found = cache.near(q + 1e-3, 0.1)
    every = np.arange(len(clearances.pairs))
    distance = clearances.distances((q + 1e-3)[None], np.zeros_like(every), every)
    assert len(found or []) > 1
    assert found == [k for k in np.argsort(distance) if distance[k] <= 0.1]
    # What was measured there still says enough after a posture far away.
    assert cache.near(-q, 0.1) is None
    assert cache.near(q + 1e-3, 0.1) == found
    first, second = (here for here, _, _ in cache.segments(np.stack([q, -q])))
    assert (first, second) == (slice(0, 1), slice(1, 2))


def test_no_point_is_further_from_a_joint_than_its_reach(any_arm: Robot, random_states: StateSamples) -> None:
    """Stretched and drawn out, too; what slides beyond its range is not bounded."""
    model, shapes = any_arm.model, list(any_arm.collision_model.geometryObjects)
    reach, slides = shape_reach(model, shapes), prismatic_joints(model)
    stretched = np.where(slides, model.upperPositionLimit, 0.0)
    data = model.createData()
    for q in [stretched, *random_states(any_arm, 20)[0]]:
        pin.forwardKinematics(model, data, q)
        for shape, bounds in zip(shapes, reach, strict=True):
            shape.geometry.computeLocalAABB()
            X_WS = data.oMi[shape.parentJoint] * shape.placement
            centre = X_WS.act(shape.geometry.aabb_center)
            for joint in np.flatnonzero((bounds > 0) & ~slides) + 1:
                far = np.linalg.norm(centre - data.oMi[int(joint)].translation)
                assert far + shape.geometry.aabb_radius <= bounds[joint - 1] + 1e-9
    geometry = pin.GeometryModel(any_arm.collision_model)
    cache = DistanceCache(any_arm, geometry, geometry.createData(), Clearances(any_arm, ()).pair_reach)
    near = stretched + 1e-5 * np.arange(20)[:, None] * np.where(slides, -1, 1)
    assert cache.suits(near)
    assert not cache.suits(near[:1] + 0.1 * np.arange(20)[:, None] * np.where(slides, -1, 1))
    assert cache.suits(near + 2.0 * slides) == (not slides.any())


def test_distances_measured_one_by_one_are_the_same(
    cmbot_robot: Robot, random_states: StateSamples, rng: np.random.Generator
) -> None:
    obstacles = [
        Obstacle(name=kind, shape=shape, X_WO=turned_pose(rng).homogeneous)
        for kind, (shape, _) in SHAPES.items()
    ]
    clearances, q = Clearances(cmbot_robot, obstacles), random_states(cmbot_robot, 40)[0]
    one_by_one = PointDistances(cmbot_robot, obstacles)
    beside = {(pair.link, pair.other) for pair in clearances.pairs if not pair.self_collision}
    assert beside <= set(one_by_one.names)
    alone, names = one_by_one.smallest(q)
    smallest = clearances.query(q)
    np.testing.assert_allclose(alone, smallest.distance, rtol=0, atol=1e-5)
    other = [clearances.pairs[pair] for pair in smallest.pair]
    assert np.mean([name == (pair.link, pair.other) for name, pair in zip(names, other, strict=True)]) > 0.5
    # Neither the first posture need be asked for nor the last one.
    some = clearances.distances(q, np.array([1, 1]), np.array([0, smallest.pair[1]]))
    assert some[1] == pytest.approx(smallest.distance[1], abs=1e-7)
    assert some[0] == pytest.approx(clearances.nearest(q[1], 0).distance, abs=1e-7)
