"""Which pairs count, what is remembered of far ones, how fast a distance can change."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import StateSamples
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from robot_files import load_copy

from cmbot.collision import Clearances
from cmbot.robot import Robot, load_robot
from cmbot.scene import Box, Obstacle, Sphere, load_scene, pose

FloatArray = NDArray[np.float64]
# How well coal knows the depth of a deep overlap, m.
TOLERANCE = 2e-6
MOVING = ("link_1", "link_2", "link_3", "link_5", "tool")


@pytest.fixture(scope="module")
def pair_of_clearances() -> tuple[Clearances, Clearances]:
    """Of the triangle: one to be tested, with its memory, one to ask about every pair."""
    robot, obstacles = load_robot(), load_scene("triangle").obstacles
    return Clearances(robot, obstacles), Clearances(robot, obstacles)


def all_distances(clearances: Clearances, q: FloatArray) -> FloatArray:
    return np.array([clearances.nearest(q, pair).distance for pair in range(len(clearances.pairs))])


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


@settings(max_examples=40)
@given(q=walks, avoidable_only=st.booleans())
def test_smallest_is_the_smallest_of_all(
    pair_of_clearances: tuple[Clearances, Clearances], q: FloatArray, avoidable_only: bool
) -> None:
    clearances, every = pair_of_clearances
    counted = [not avoidable_only or pair.avoidable for pair in every.pairs]
    got = clearances.smallest(q, avoidable_only=avoidable_only)
    assert got.distance.shape == got.pair.shape == (len(q),)
    for k in range(len(q)):
        distances = np.where(counted, all_distances(every, q[k]), np.inf)
        assert got.distance[k] == pytest.approx(distances.min(), abs=TOLERANCE)
        assert distances[got.pair[k]] == pytest.approx(got.distance[k], abs=TOLERANCE)


@settings(max_examples=30)
@given(q=walks, last=st.integers(0, 20))
def test_within_is_every_avoidable_pair_that_near(
    pair_of_clearances: tuple[Clearances, Clearances], q: FloatArray, last: int
) -> None:
    clearances, every = pair_of_clearances
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
    pair_of_clearances: tuple[Clearances, Clearances], seed: int, size: float
) -> None:
    _, every = pair_of_clearances
    rng = np.random.default_rng(seed)
    # Alone or together, joints move no distance further.
    step = size * rng.uniform(-1, 1, 7) * (rng.uniform(size=7) < rng.choice([0.2, 1.0]))
    q = rng.uniform(-2.5, 2.5, 7)
    change = all_distances(every, q + step) - all_distances(every, q)
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
    obstacles = load_scene("triangle").obstacles
    pairs = Clearances(cmbot_robot, obstacles).pairs
    with_obstacles = [(pair.link, pair.other) for pair in pairs if not pair.self_collision]
    assert set(with_obstacles) == {(link, obstacle.name) for link in MOVING for obstacle in obstacles}
    assert len(with_obstacles) == len(set(with_obstacles))
    # Only what the last joint carries is at work, and only on a workpiece.
    at_work = {(pair.link, pair.other) for pair in pairs if pair.tool_at_work}
    assert at_work == {("tool", f"bracket_{side}") for side in ("ab", "bc", "ca")}
    # The further link comes first; what never moves against each other is left out.
    for pair in (pair for pair in pairs if pair.self_collision):
        assert pair.link in MOVING
        assert pair.other not in MOVING or MOVING.index(pair.link) > MOVING.index(pair.other)


def test_the_robot_keeps_its_own_pairs(cmbot_robot: Robot) -> None:
    before = (
        len(cmbot_robot.collision_model.geometryObjects),
        len(cmbot_robot.collision_model.collisionPairs),
    )
    Clearances(cmbot_robot, load_scene("line").obstacles)
    after = (
        len(cmbot_robot.collision_model.geometryObjects),
        len(cmbot_robot.collision_model.collisionPairs),
    )
    assert before == after


@pytest.fixture
def shapeless(urdf_folder: Path) -> Robot:
    """The shipped arm without any collision shape."""
    file = urdf_folder / "cmbot.urdf"
    text = file.read_text(encoding="utf-8")
    file.write_text(re.sub(r"<collision .*?</collision>", "", text, flags=re.DOTALL), encoding="utf-8")
    return load_copy(urdf_folder)


def test_nothing_counts_without_shapes(shapeless: Robot, random_states: StateSamples) -> None:
    wall = Obstacle(name="wall", shape=Box(size=(1, 1, 1)), X_WO=pose([0, 0, 0]))
    clearances = Clearances(shapeless, [wall])
    q = random_states(shapeless, 3)[0]
    for avoidable_only in (False, True):
        smallest = clearances.smallest(q, avoidable_only=avoidable_only)
        assert np.isposinf(smallest.distance).all()
        assert (smallest.pair == -1).all()
    assert not clearances.pairs
    assert clearances.within(q[0], 1.0) == []


def test_nothing_to_avoid_without_obstacles(cmbot_robot: Robot, random_states: StateSamples) -> None:
    clearances = Clearances(cmbot_robot, [])
    q = random_states(cmbot_robot, 3)[0]
    assert np.isfinite(clearances.smallest(q).distance).all()
    assert np.isposinf(clearances.smallest(q, avoidable_only=True).distance).all()
    assert clearances.within(q[0], 10.0) == []


def test_no_postures(pair_of_clearances: tuple[Clearances, Clearances]) -> None:
    smallest = pair_of_clearances[0].smallest(np.empty((0, 7)))
    assert smallest.distance.shape == smallest.pair.shape == (0,)


def test_a_posture_that_is_no_number_has_no_clearance(
    pair_of_clearances: tuple[Clearances, Clearances],
) -> None:
    clearances, every = pair_of_clearances
    q = np.vstack([walk(0, [0.0]), np.full((1, 7), np.nan), walk(0, [0.0])])
    got = clearances.smallest(q)
    assert np.isnan(got.distance[1])
    assert got.pair[1] == -1
    expected = all_distances(every, q[0]).min()
    np.testing.assert_allclose(got.distance[[0, 2]], expected, rtol=0, atol=TOLERANCE)


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
