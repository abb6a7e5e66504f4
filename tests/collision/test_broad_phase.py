"""No distance is below what the broad phase says, and many postures at once are what each alone is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from conftest import StateSamples
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from seven_joint_arms import endless_scene, panda_scene

from cmbot.collision import Clearances, PairedShapes
from cmbot.collision.broad_phase import BroadPhase
from cmbot.planning import robot_of
from cmbot.robot import Robot, load_robot
from cmbot.scene import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere, load_scene, pose

FloatArray = NDArray[np.float64]
# How well coal knows the depth of a deep overlap, m.
TOLERANCE = 2e-6
# More postures than are looked at one by one, and more than a block of the broad phase.
MANY, BLOCKS = 60, 1200


@pytest.fixture(scope="module")
def triangle() -> tuple[Clearances, Clearances]:
    """One to be asked about many postures, one to ask about every pair."""
    robot, obstacles = load_robot(), load_scene("triangle").obstacles
    return Clearances(robot, obstacles), Clearances(robot, obstacles)


def all_distances(clearances: Clearances, q: FloatArray) -> FloatArray:
    """(P, N)."""
    pairs = range(len(clearances.pairs))
    return np.array([[clearances.nearest(q_k, pair).distance for pair in pairs] for q_k in q]).T


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


@settings(max_examples=10)
@given(q=paths | jumps, avoidable_only=st.booleans())
def test_smallest_of_many_is_the_smallest_of_all(
    triangle: tuple[Clearances, Clearances], q: FloatArray, avoidable_only: bool
) -> None:
    clearances, every = triangle
    got = clearances.smallest(q, avoidable_only=avoidable_only)
    left_out = [avoidable_only and not pair.avoidable for pair in every.pairs]
    distances = all_distances(every, q)
    distances[left_out] = np.inf
    np.testing.assert_allclose(got.distance, distances.min(axis=0), rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(distances[got.pair, np.arange(MANY)], got.distance, rtol=0, atol=TOLERANCE)


@settings(max_examples=10)
@given(q=paths | jumps, share=st.floats(0, 1))
def test_a_collision_is_any_distance_below_the_margin(
    triangle: tuple[Clearances, Clearances], q: FloatArray, share: float
) -> None:
    clearances, every = triangle
    smallest = every.smallest(q).distance
    # Between two of the postures, so that it parts them as it should; a margin is not negative.
    margin = max(float(np.quantile(smallest, share)) + 1e-5, 0.0)
    if np.abs(smallest - margin).min() > TOLERANCE:
        np.testing.assert_array_equal(clearances.check_collision(q, margin), smallest < margin)
        np.testing.assert_array_equal(clearances.check_collision(q[:3], margin), smallest[:3] < margin)


def test_one_by_one_and_many_in_any_order_agree(
    triangle: tuple[Clearances, Clearances], rng: np.random.Generator
) -> None:
    clearances, other = triangle
    q = smooth_path(1, 0.5, BLOCKS)
    got = clearances.smallest(q).distance
    assert np.ptp(got) > 0.1
    order = rng.permutation(BLOCKS)
    np.testing.assert_allclose(clearances.smallest(q[order]).distance, got[order], rtol=0, atol=TOLERANCE)
    some = order[:100]
    alone = [float(other.smallest(q[k : k + 1]).distance[0]) for k in some]
    np.testing.assert_allclose(alone, got[some], rtol=0, atol=TOLERANCE)


def test_among_many_postures_one_that_is_no_number(triangle: tuple[Clearances, Clearances]) -> None:
    clearances, _ = triangle
    q = smooth_path(2, 0.02, MANY)
    whole = clearances.smallest(q)
    for nothing in (np.nan, np.inf):
        q[7, 3] = nothing
        got = clearances.smallest(q)
        assert np.isnan(got.distance[7])
        assert got.pair[7] == -1
        known = np.arange(MANY) != 7
        np.testing.assert_allclose(got.distance[known], whole.distance[known], rtol=0, atol=TOLERANCE)
        # Of shapes that are nowhere coal says that they touch.
        np.testing.assert_array_equal(clearances.check_collision(q, 0.0), ~known)
        assert clearances.check_collision(q[7:8], 0.0).all()


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    length=st.sampled_from([0.005, 0.05, 0.3]),
    number=st.sampled_from([1, 2, 199, 200, 350]),
    spare=st.sampled_from([0.0, 1e-3, 0.05]),
)
def test_along_a_path_the_smallest_is_exact(
    triangle: tuple[Clearances, Clearances], seed: int, length: float, number: int, spare: float
) -> None:
    clearances, every = triangle
    q = smooth_path(seed, length, number)
    got, expected = clearances.along(q, spare), every.smallest(q).distance
    assert got.min() == pytest.approx(expected.min(), abs=TOLERANCE)
    assert abs(expected[got.argmin()] - expected.min()) < TOLERANCE
    near = expected <= expected.min() + spare
    np.testing.assert_allclose(got[near], expected[near], rtol=0, atol=TOLERANCE)
    assert (got <= expected + TOLERANCE).all()
    assert (got[~near] > expected.min() + spare - TOLERANCE).all()


def test_along_a_path_far_samples_are_not_looked_at(triangle: tuple[Clearances, Clearances]) -> None:
    clearances, every = triangle
    # Slow enough for a bound to reach from sample to sample.
    q = smooth_path(3, 0.05, 3000)
    got, expected = clearances.along(q, 0.0), every.smallest(q).distance
    assert (got < expected - TOLERANCE).mean() > 0.5


def test_along_a_path_that_is_partly_no_number(triangle: tuple[Clearances, Clearances]) -> None:
    q = smooth_path(4, 0.05, 300)
    q[20, 1] = np.nan
    assert np.isnan(triangle[0].along(q, 0.0).min())


def test_along_a_path_with_nothing_to_hit(cmbot_robot: Robot) -> None:
    bare = replace(cmbot_robot, collision_model=type(cmbot_robot.collision_model)())
    assert np.isposinf(Clearances(bare, []).along(smooth_path(5, 0.1, MANY), 0.01)).all()
    assert not Clearances(bare, []).check_collision(smooth_path(5, 0.1, MANY), 1.0).any()


SHAPES: dict[str, Shape] = {
    "box": Box(size=(0.3, 0.5, 0.9)),
    "cylinder": Cylinder(radius=0.2, length=0.7),
    "capsule": Capsule(radius=0.15, length=0.6),
    "sphere": Sphere(radius=0.3),
}


@pytest.fixture(scope="module", params=["cmbot", "panda", "endless"])
def crowded(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Robot, list[Obstacle]]:
    """Arms of capsules, of meshes and of cylinders among obstacles of every shape, turned at random."""
    folder = tmp_path_factory.mktemp(request.param)
    match request.param:
        case "panda":
            robot = robot_of(panda_scene(folder))
        case "endless":
            robot = robot_of(endless_scene(folder))
        case _:
            robot = load_robot()
    trimesh.creation.icosahedron().apply_scale([0.2, 0.3, 0.1]).export(folder / "rock.stl")
    rng = np.random.default_rng(5)
    obstacles = []
    for name, shape in (SHAPES | {"mesh": Mesh(path=folder / "rock.stl")}).items():
        point = robot.base_point + 0.4 * robot.reach * rng.normal(size=3)
        X_WO = pin.SE3(Rotation.random(rng=rng).as_matrix(), point)
        obstacles.append(Obstacle(name=name, shape=shape, X_WO=X_WO.homogeneous))
    return robot, obstacles


def looked(
    robot: Robot, obstacles: Sequence[Obstacle], q: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Bounds and better bounds (P, N) of all pairs."""
    paired = PairedShapes(robot, obstacles)
    for bounds in BroadPhase(robot, list(paired.geometry.geometryObjects), paired.shapes).lower_bounds(q):
        pair, posture = (index.ravel() for index in np.indices(bounds.value.shape))
        yield bounds.value, bounds.tightened(pair, posture).reshape(bounds.value.shape)


def test_no_distance_is_below_its_bound(
    crowded: tuple[Robot, list[Obstacle]], random_states: StateSamples
) -> None:
    robot, obstacles = crowded
    q = random_states(robot, 80)[0]
    distances = all_distances(Clearances(robot, obstacles), q)
    assert (distances < 0).mean() > 0.003
    ((bounds, better),) = looked(robot, obstacles, q)
    assert (bounds <= distances + TOLERANCE).all()
    assert (better <= distances + TOLERANCE).all()
    assert (better >= bounds).all()


def test_bounds_are_not_far_too_low(cmbot_robot: Robot, random_states: StateSamples) -> None:
    """Those of capsules beside boxes that do not move are nearly exact, and that is what most pairs are."""
    box = Obstacle(name="box", shape=SHAPES["box"], X_WO=pose([1, 0.5, -1], [0.3, 0.2, 0.1]))
    clearances = Clearances(cmbot_robot, [box])
    q = random_states(cmbot_robot, 200)[0]
    distances = all_distances(clearances, q)
    ((bounds, better),) = looked(cmbot_robot, [box], q)
    apart = (distances > 0) & np.array([not pair.self_collision for pair in clearances.pairs])[:, None]
    assert np.quantile((distances - better)[apart], 0.9) < 1e-3
    assert np.median((distances - bounds)[apart]) < 0.2


def test_bounds_of_several_blocks_are_in_order(cmbot_robot: Robot) -> None:
    obstacles = load_scene("line").obstacles
    q = smooth_path(6, 1.0, BLOCKS)
    blocks = [bounds for bounds, _ in looked(cmbot_robot, obstacles, q)]
    assert len(blocks) > 1
    for k in (0, 511, 512, BLOCKS - 1):
        ((alone, _),) = looked(cmbot_robot, obstacles, q[k : k + 1])
        np.testing.assert_allclose(np.hstack(blocks)[:, k], alone[:, 0], rtol=0, atol=1e-12)
