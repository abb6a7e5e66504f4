"""Distances as minimum-norm points: closed forms, and bounds that enclose them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oracles import convex_distance
from oracles.convex_distance import ConvexShape, Proven, hull, smallest_distances
from oracles.distances import between_hulls

FloatArray = NDArray[np.float64]
WIDTH = 1e-6


def box(*size: float) -> ConvexShape:
    return ConvexShape(half=0.5 * np.array(size))


def cylinder(radius: float, length: float) -> ConvexShape:
    return ConvexShape(half=np.array([0, 0, 0.5 * length]), disc=radius)


def capsule(radius: float, length: float) -> ConvexShape:
    return ConvexShape(half=np.array([0, 0, 0.5 * length]), radius=radius)


def sphere(radius: float) -> ConvexShape:
    return ConvexShape(radius=radius)


def between(one: ConvexShape, other: ConvexShape, R: FloatArray, p: FloatArray) -> Proven:
    """Of shapes at N poses: the first at the origin, the other at `p` (N, 3), turned by `R` (N, 3, 3)."""
    N = len(p)
    turns = np.stack([np.tile(np.eye(3), (N, 1, 1)), R])
    return smallest_distances([one, other], turns, np.stack([np.zeros((N, 3)), p]), [(0, 1)])


def at(one: ConvexShape, other: ConvexShape, *p: float) -> Proven:
    return between(one, other, np.eye(3)[None], np.array([p]))


@pytest.mark.parametrize(
    ("one", "other", "p", "expected"),
    [
        (sphere(0.1), sphere(0.2), (3, 4, 0), 4.7),
        (box(2, 2, 2), box(4, 4, 4), (10, 0, 0), 7),
        (box(2, 2, 2), box(2, 2, 2), (4, 5, 0), np.hypot(2, 3)),
        (box(2, 2, 2), sphere(0.5), (4, 4, 4), 3 * np.sqrt(3) - 0.5),
        (capsule(0.1, 2), capsule(0.2, 2), (3, 0, 1.5), 2.7),
        (capsule(0.1, 2), capsule(0.2, 2), (3, 0, 6), 5 - 0.3),
        (cylinder(0.5, 2), sphere(0.1), (4.5, 0, 4), 4.9),
        (cylinder(0.5, 2), cylinder(0.5, 2), (3, 4, 0.5), 4),
        (cylinder(0.5, 2), box(1, 1, 1), (0.3, 0.1, 3), 1.5),
        (cylinder(0.5, 2), capsule(0.25, 1), (0, 2, 3.5), np.hypot(1.5, 2) - 0.25),
    ],
)
def test_closed_forms(one: ConvexShape, other: ConvexShape, p: tuple[float, ...], expected: float) -> None:
    for got in (at(one, other, *p), at(other, one, *(-x for x in p))):
        assert got.lower[0] <= expected + 1e-12
        assert got.upper[0] >= expected - 1e-12
        assert got.upper[0] - got.lower[0] < WIDTH
        assert got.pair[0] == 0


def test_radii_are_kept_apart() -> None:
    """Where only the balls about two shapes meet, the depth is exact as well."""
    got = at(capsule(0.3, 2), capsule(0.4, 2), 0.5, 0, 0)
    np.testing.assert_allclose([got.lower, got.upper], -0.2, atol=WIDTH)


SHAPES = [box(0.4, 1.3, 0.2), cylinder(0.3, 1.1), capsule(0.2, 0.8), sphere(0.35)]
SHAPES.append(hull(np.random.default_rng(1).normal(size=(15, 3)) * [0.3, 0.5, 0.1])[1])


@pytest.mark.parametrize("one", SHAPES)
@pytest.mark.parametrize("other", SHAPES)
def test_overlaps_have_a_sign(one: ConvexShape, other: ConvexShape, rng: np.random.Generator) -> None:
    R = Rotation.random(50, random_state=1).as_matrix()
    got = between(one, other, R, rng.uniform(-0.01, 0.01, (50, 3)))
    assert (got.upper < 0).all()
    assert (got.lower <= got.upper).all()


def distance_on_a_grid(one: ConvexShape, other: ConvexShape, R: FloatArray, p: FloatArray) -> float:
    """Upper bound of a distance: between the hulls of points on the surfaces."""
    A, B = (_surface(shape) for shape in (one, other))
    return between_hulls(A, B @ R.T + p) - one.radius - other.radius


def _surface(shape: ConvexShape) -> FloatArray:
    if shape.points is not None:
        return shape.points
    corners = shape.half * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    if shape.disc == 0:
        return np.unique(corners, axis=0)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    rim = shape.disc * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return np.concatenate([np.unique(corners, axis=0)[:, None] + rim]).reshape(-1, 3)


@settings(max_examples=15)
@given(
    one=st.sampled_from(SHAPES),
    other=st.sampled_from(SHAPES),
    seed=st.integers(0, 2**31),
    away=st.floats(1.8, 4.0),
)
def test_a_quadratic_program_agrees(one: ConvexShape, other: ConvexShape, seed: int, away: float) -> None:
    R = Rotation.random(1, random_state=seed).as_matrix()
    direction = np.random.default_rng(seed).normal(size=3)
    p = away * direction / np.linalg.norm(direction)
    got = between(one, other, R, p[None])
    expected = distance_on_a_grid(one, other, R[0], p)
    assert got.upper[0] - got.lower[0] < WIDTH
    # A polygon of 12 corners lies within its circle by this share of the radius.
    inside = (one.disc + other.disc) * (1 - np.cos(np.pi / 12))
    assert expected - inside - 1e-6 <= got.upper[0]
    assert got.lower[0] <= expected + 1e-6


def test_a_flat_hull_keeps_all_its_points() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 0]])
    centre, shape = hull(square)
    np.testing.assert_allclose(centre, [0.5, 0.5, 0])
    assert at(shape, sphere(0.1), 0, 0, 3).upper[0] == pytest.approx(2.9)


@pytest.mark.parametrize("block", [1 << 17, 7])
def test_the_smallest_of_many(block: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convex_distance, "_BLOCK", block)
    N, S = 30, len(SHAPES)
    R = Rotation.random(S * N, random_state=2).as_matrix().reshape(S, N, 3, 3)
    p = rng.uniform(-3, 3, (S, N, 3))
    pairs = list(combinations(range(S), 2))
    got = smallest_distances(SHAPES, R, p, pairs)
    alone = [smallest_distances(SHAPES, R, p, [pair]) for pair in pairs]
    lower, upper = (np.array([getattr(one, name) for one in alone]) for name in ("lower", "upper"))
    np.testing.assert_allclose(got.upper, upper.min(axis=0), rtol=0, atol=WIDTH)
    np.testing.assert_allclose(got.lower, lower.min(axis=0), rtol=0, atol=WIDTH)
    np.testing.assert_allclose(upper[got.pair, np.arange(N)], got.upper, rtol=0, atol=WIDTH)
    assert len(np.unique(got.pair)) > 3


def test_nothing_is_infinitely_far() -> None:
    got = smallest_distances([], np.empty((0, 3, 3, 3)), np.empty((0, 3, 3)), [])
    assert np.isposinf([got.lower, got.upper]).all()
    assert (got.pair == -1).all()


@pytest.mark.parametrize("place", ["position", "orientation"])
def test_a_place_that_is_no_number_is_not_far_away(place: str) -> None:
    R, p = np.tile(np.eye(3), (3, 4, 1, 1)), np.zeros((3, 4, 3))
    p[1, :, 0], p[2, :, 0] = 5.0, 4.7
    (p if place == "position" else R)[2, 1] = np.nan
    proven = smallest_distances([box(1, 1, 1), box(1, 1, 1), cylinder(0.1, 1)], R, p, [(0, 1), (0, 2)])
    assert not proven.lower[1] >= 0.0
    np.testing.assert_allclose(proven.lower[[0, 2, 3]], 4.0, atol=WIDTH)
