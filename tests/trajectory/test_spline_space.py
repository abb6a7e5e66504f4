"""The space of C3 splines at rest at both ends: complete, least in jerk, well scaled.

Oracles: SciPy's B-splines with double inner knots, Gauss quadrature of the evaluated jerk.
"""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from quadrature import gauss_points
from scipy import linalg
from scipy.interpolate import BSpline

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.trajectory.quintic import QuinticTrajectory
from cmbot.trajectory.spline_space import SplineSpace

SIZES = (5, 6, 50, 300)


def uneven_times(n: int, seed: int) -> FloatArray:
    """Knots whose neighbouring segments differ in length by up to 1:20, the first two by exactly that."""
    h = 20.0 ** np.random.default_rng(seed).uniform(-1, 0, size=n - 1)
    h[:2] = 1.0, 0.05
    return np.concatenate([[0.0], np.cumsum(h)])


@cache
def space_of(kind: str, n: int) -> SplineSpace:
    if kind == "uniform":
        return SplineSpace(np.linspace(0.0, 20.0, n))
    return SplineSpace(uneven_times(n, n))


SPACES = [(kind, n) for kind in ("uniform", "uneven") for n in SIZES]
every_space = pytest.mark.parametrize(("kind", "n"), SPACES)
small_spaces = st.builds(
    lambda n, seed: SplineSpace(uneven_times(n, seed)), st.integers(5, 12), st.integers(0, 2**32 - 1)
)


def unit_free(space: SplineSpace, z: FloatArray) -> FloatArray:
    """Knot vectors with time counted in mean segments, so that all rows are of one size."""
    step = (space.t[-1] - space.t[0]) / (len(space.t) - 1)
    return z * np.tile([1.0, step, step**2], len(space.t))[:, None]


def whitened_basis(space: SplineSpace) -> FloatArray:
    """B with columns of mean squared jerk 1."""
    return space.basis.toarray() / np.sqrt(space.jerk_gram.diagonal())


def random_member(space: SplineSpace, seed: int, d: int = 2) -> tuple[FloatArray, FloatArray]:
    """Via-points and the knot vector of some P q + B x, both of its parts of one size."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(len(space.t), d))
    z = space.least_jerk(q)
    size = np.sqrt(mean_squared_jerk(space.trajectory(z))).max() / np.sqrt(space.dimension)
    return q, z + whitened_basis(space) @ rng.normal(size=(space.dimension, d)) * size


def mean_squared_jerk(trajectory: QuinticTrajectory) -> FloatArray:
    # Three points a segment are exact for products of two jerks.
    times, weights = gauss_points(trajectory.t, 3)
    return weights @ trajectory.evaluate(times, 3) ** 2


def b_splines(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """All C3 quintic splines on knots t by double inner knots; then a basis of those at rest at both ends."""
    knots = np.concatenate([[t[0]] * 6, np.repeat(t[1:-1], 2), [t[-1]] * 6])
    count = len(knots) - 6
    # At a clamped end, equal first four coefficients mean zero velocity, acceleration and jerk.
    rest = np.zeros((count, count - 6))
    rest[:4, 0] = rest[-4:, -1] = 1.0
    rest[4:-4, 1:-1] = np.eye(count - 8)
    return knots, rest


@every_space
def test_the_dimension_is_the_papers_count(kind: str, n: int) -> None:
    space = space_of(kind, n)
    # 7 joints on the paper's 50 knots: 7 * 48 * 2 - 7 * (48 + 2) = 322 = 7 * 46 free numbers.
    assert space.dimension == n - 4
    assert space.basis.shape == (3 * n, n - 4)
    assert np.linalg.matrix_rank(unit_free(space, whitened_basis(space))) == n - 4


def assert_is_member(space: SplineSpace, q: FloatArray, z: FloatArray) -> None:
    trajectory = space.trajectory(z)
    size = [trajectory.extrema(order).largest()[0].max() for order in range(4)]
    np.testing.assert_array_equal(trajectory.q, q)
    np.testing.assert_allclose(trajectory.evaluate(space.t), q, rtol=0, atol=1e-12 * size[0])
    for order in range(4):
        assert np.abs(trajectory.jumps(order)).max() < 1e-9 * size[order]
    for order in range(1, 4):
        assert np.abs(trajectory.evaluate(space.t[[0, -1]], order)).max() < 1e-9 * size[order]
    assert not any(knots[[0, -1]].any() for knots in (trajectory.v, trajectory.a))


@every_space
def test_members_are_c3_at_rest_and_pass_the_via_points(kind: str, n: int) -> None:
    space = space_of(kind, n)
    q, z = random_member(space, n)
    assert_is_member(space, q, z)
    assert_is_member(space, q, space.least_jerk(q))


@settings(max_examples=40)
@given(small_spaces, st.integers(0, 2**32 - 1))
def test_members_are_c3_on_any_knots(space: SplineSpace, seed: int) -> None:
    assert_is_member(space, *random_member(space, seed))


@settings(max_examples=20)
@given(st.integers(12, 60), st.floats(1.0, 2.0), st.integers(0, 2**32 - 1))
def test_short_segments_among_long_ones_lose_no_digits(n: int, decades: float, seed: int) -> None:
    """Jumps of the jerk at a knot beside the jerk around it, whatever that is elsewhere."""
    rng = np.random.default_rng(seed)
    place = np.arange(n - 1)
    h = 10.0 ** (-decades * np.exp(-(((place - n / 2) / (n / 8)) ** 2)))
    space = SplineSpace(np.append(0.0, np.cumsum(h)))
    trajectory = space.trajectory(space.basis @ rng.normal(size=(n - 4, 1)))
    jerk = np.abs(trajectory.hull(3)).max(axis=(0, 2))
    assert (np.abs(trajectory.jumps(3)[:, 0]) <= 1e-13 * np.maximum(jerk[1:], jerk[:-1])).all()


@pytest.mark.parametrize("seed", [0, 4, 7])
def test_splines_of_one_knot_jump_by_the_last_digits_of_positions_alone(seed: int) -> None:
    """A position that is off by one digit moves the jerk by 60 of them in the units of its segments."""
    t = np.cumsum(np.repeat(10.0 ** np.random.default_rng(seed).uniform(-2, -0.5, size=20), 5))
    space = SplineSpace(t)
    jumps = np.abs(space.trajectory(space.cardinal.toarray()).jumps(3)).max(axis=1)
    shorter = np.minimum(np.diff(t)[:-1], np.diff(t)[1:])
    assert (jumps * shorter**3 / (60 * np.finfo(float).eps)).max() < 500


@every_space
def test_basis_splines_vanish_at_knots_and_live_on_four_segments(kind: str, n: int) -> None:
    space = space_of(kind, n)
    B = space.basis.toarray()
    assert not B[0::3].any()
    np.testing.assert_array_equal([B.max(axis=0), np.abs(B).max(axis=0)], 1.0)
    for k in range(space.dimension):
        knots = np.unique(np.flatnonzero(B[:, k]) // 3)
        # Zero with all derivatives at the knots around: nothing lies outside the four segments.
        assert {k + 1, k + 3} <= set(knots) <= {k + 1, k + 2, k + 3}


@pytest.mark.parametrize(("kind", "n"), [(kind, n) for kind, n in SPACES if n <= 50])
def test_every_c3_spline_at_rest_is_in_the_space_and_that_of_least_jerk_is_found(kind: str, n: int) -> None:
    space = space_of(kind, n)
    t = space.t
    knots, rest = b_splines(t)
    assert len(rest) == 2 * n + 2
    rng = np.random.default_rng(n)
    spline = BSpline(knots, rest @ rng.normal(size=(rest.shape[1], 4)), 5)
    z = np.zeros((3 * n, 4))
    for order in range(3):
        z[order::3] = spline(t, nu=order)
    remainder = unit_free(space, z - space.least_jerk(z[0::3]))
    B = unit_free(space, whitened_basis(space))
    x = np.linalg.lstsq(B, remainder, rcond=None)[0]
    np.testing.assert_allclose(B @ x, remainder, rtol=0, atol=1e-9 * np.abs(unit_free(space, z)).max())
    # The knot vector is the whole spline, so the space is neither smaller nor larger: 2n - 4 = n + (n - 4).
    times = np.linspace(t[0], t[-1], 333)
    for order in range(4):
        got = space.trajectory(z).evaluate(times, order)
        expected = spline(times, nu=order)
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert rest.shape[1] == n + space.dimension
    # Least jerk by constrained least squares.
    design = BSpline(knots, rest, 5)
    q = rng.normal(size=(n, 1))
    gauss, weights = gauss_points(t, 3)
    A, values = np.sqrt(weights)[:, None] * design(gauss, nu=3), design(t)
    particular = np.linalg.lstsq(values, q, rcond=None)[0]
    N = linalg.null_space(values)
    s = particular - N @ np.linalg.lstsq(A @ N, A @ particular, rcond=None)[0]
    got = space.trajectory(space.least_jerk(q)).evaluate(times)
    np.testing.assert_allclose(got, design(times) @ s, rtol=0, atol=1e-7 * np.abs(q).max())


def check_least_jerk(space: SplineSpace, seed: int) -> None:
    """Orthogonal to the basis, so that any change adds its own square to the jerk's."""
    z = space.least_jerk(np.random.default_rng(seed).normal(size=(len(space.t), 3)))
    times, weights = gauss_points(space.t, 3)
    jerk = space.trajectory(z).evaluate(times, 3)
    basis_jerk = space.trajectory(whitened_basis(space)).evaluate(times, 3)
    cosines = basis_jerk.T @ (weights[:, None] * jerk) / np.sqrt(weights @ jerk**2)
    assert np.abs(cosines).max() < 1e-8


@every_space
def test_least_jerk_is_orthogonal_to_the_basis(kind: str, n: int) -> None:
    check_least_jerk(space_of(kind, n), n)


@settings(max_examples=40)
@given(small_spaces, st.integers(0, 2**32 - 1))
def test_least_jerk_is_orthogonal_on_any_knots(space: SplineSpace, seed: int) -> None:
    check_least_jerk(space, seed)


def test_least_jerk_is_linear_and_treats_each_joint_alone() -> None:
    space = space_of("uneven", 50)
    q = np.random.default_rng(0).normal(size=(50, 3))
    z = space.least_jerk(q)
    alone = np.hstack([space.least_jerk(q[:, [i]]) for i in range(3)])
    np.testing.assert_allclose(z, alone, rtol=0, atol=1e-11 * np.abs(z).max())
    np.testing.assert_allclose(space.least_jerk(2 * q), 2 * z, rtol=0, atol=1e-11 * np.abs(z).max())


@pytest.mark.parametrize("n", SIZES)
def test_a_joint_that_does_not_move_stays_at_rest(n: int) -> None:
    z = space_of("uniform", n).least_jerk(np.full((n, 1), 0.7))
    np.testing.assert_allclose(z[:, 0], np.tile([0.7, 0.0, 0.0], n), rtol=0, atol=1e-10)


@every_space
def test_jerk_gram_is_the_mean_product_of_jerks(kind: str, n: int) -> None:
    space = space_of(kind, n)
    times, weights = gauss_points(space.t, 3)
    jerk = space.trajectory(space.basis.toarray()).evaluate(times, 3)
    expected = jerk.T @ (weights[:, None] * jerk)
    scale = np.sqrt(np.diag(expected))
    got = space.jerk_gram.toarray() / np.outer(scale, scale)
    np.testing.assert_allclose(got, expected / np.outer(scale, scale), rtol=0, atol=1e-10)
    np.testing.assert_array_equal(got[np.abs(np.subtract.outer(range(n - 4), range(n - 4))) > 3], 0.0)
    if kind == "uniform":
        assert np.linalg.cond(got) < 10


@every_space
@pytest.mark.parametrize("order", range(5))
def test_design_times_knot_vector_is_the_evaluated_trajectory(kind: str, n: int, order: int) -> None:
    space = space_of(kind, n)
    _, z = random_member(space, 1)
    times = np.concatenate([space.t, np.random.default_rng(2).uniform(space.t[0], space.t[-1], 200)])
    design = space.design(times, order)
    assert design.shape == (len(times), 3 * n)
    assert np.diff(design.indptr).max() <= 6
    expected = space.trajectory(z).evaluate(times, order)
    np.testing.assert_allclose(design @ z, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@settings(max_examples=40)
@given(small_spaces, st.floats(-3, 3), st.integers(0, 2**32 - 1))
def test_a_slower_clock_scales_the_derivatives_only(space: SplineSpace, exponent: float, seed: int) -> None:
    c = 10.0**exponent
    slow = SplineSpace(c * space.t)
    q, z = random_member(space, seed, d=1)
    scale = np.tile([1.0, 1 / c, 1 / c**2], len(q))[:, None]
    expected = space.least_jerk(q) * scale
    got = slow.least_jerk(q)
    for order in range(3):
        size = np.abs(expected[order::3]).max()
        np.testing.assert_allclose(got[order::3], expected[order::3], rtol=0, atol=1e-9 * size)
    # The same splines, so z at the slower clock lies in the slow space.
    assert_is_member(slow, q, z * scale)
    angles = linalg.subspace_angles(*(unit_free(s, s.basis.toarray()) for s in (slow, space)))
    assert angles.max() < 1e-8


@pytest.mark.parametrize(
    "t",
    [
        np.arange(4.0),
        np.array([]),
        np.array(1.0),
        np.ones((5, 5)),
        np.array([0.0, 1.0, 1.0, 2.0, 3.0]),
        np.array([0.0, 2.0, 1.0, 3.0, 4.0]),
        np.array([0.0, 1.0, np.nan, 3.0, 4.0]),
    ],
)
def test_too_few_or_unordered_knots_are_refused(t: FloatArray) -> None:
    with pytest.raises(InputError, match="5 or more increasing times") as caught:
        SplineSpace(t)
    assert (caught.value.source, caught.value.key) == ("SplineSpace", "t")
