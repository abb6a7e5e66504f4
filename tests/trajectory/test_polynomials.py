"""Roots on the unit interval: against numpy.roots, known roots and degenerate polynomials."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from numpy.polynomial import Polynomial, chebyshev
from numpy.polynomial.polynomial import polyval

from cmbot.common.arrays import FloatArray
from cmbot.trajectory.polynomials import derivative, roots_in_unit_interval

DEGREES = range(1, 6)

coefficients = st.integers(2, 6).flatmap(
    lambda size: hnp.arrays(float, size, elements=st.floats(-1, 1).map(lambda x: round(x, 6)))
)
# Eighths: the coefficients of their polynomials are exact, so a root at an end is one in floating point too.
known_roots = st.lists(st.integers(0, 8).map(lambda k: k / 8), min_size=1, max_size=5, unique=True)


def from_roots(roots: list[float], leading: float = 1.0) -> FloatArray:
    return leading * Polynomial.fromroots(roots).coef


def distance(x: float, roots: FloatArray) -> float:
    return float(np.abs(roots - x).min())


@pytest.mark.parametrize("order", range(1, 4))
def test_derivative_is_that_of_every_polynomial_in_the_stack(order: int) -> None:
    c = np.random.default_rng(1).normal(size=(3, 2, 6))
    got = derivative(c, order)
    assert got.shape == (3, 2, 6 - order)
    for index in np.ndindex(3, 2):
        np.testing.assert_allclose(got[index], Polynomial(c[index]).deriv(order).coef)


@pytest.mark.parametrize("degree", DEGREES)
def test_every_simple_root_of_numpy_is_found(degree: int) -> None:
    rng = np.random.default_rng(degree)
    stack = rng.normal(size=(300, degree + 1))
    found = roots_in_unit_interval(stack)
    assert found.shape == (300, degree)
    checked = 0
    for c, mine in zip(stack, found, strict=True):
        p, slope = Polynomial(c), Polynomial(c).deriv()
        roots = np.roots(c[::-1])
        real = roots[np.abs(roots.imag) < 1e-12].real
        for root in real[(real >= 0) & (real <= 1) & (np.abs(slope(real)) > 1e-3)]:
            assert distance(root, mine) < 1e-10
            assert abs(p(mine[np.abs(mine - root).argmin()])) < 1e-13
            checked += 1
    assert checked > 50


@given(coefficients)
def test_roots_are_sorted_and_each_is_a_root_an_end_or_a_stationary_point(c: FloatArray) -> None:
    roots = roots_in_unit_interval(c)
    assert roots.shape == (len(c) - 1,)
    assert np.all(np.diff(roots) >= 0)
    assert roots[0] >= 0
    assert roots[-1] <= 1
    slope = polyval(roots, derivative(c))
    value = polyval(roots, c)
    tiny = 1e-12 * (np.abs(c).max() + np.finfo(float).tiny)
    # A stationary point may itself be a stand-in, namely a stationary point of the slope.
    bends = (polyval(roots, derivative(c, order)) for order in range(2, max(len(c) - 1, 2)))
    explained = (np.abs(value) <= tiny) | (np.abs(slope) <= tiny) | np.isin(roots, [0.0, 1.0])
    for bend in bends:
        explained |= np.abs(bend) <= tiny
    assert explained.all()


@given(coefficients)
def test_every_change_of_sign_on_a_grid_is_a_root(c: FloatArray) -> None:
    u = np.linspace(0, 1, 201)
    value = polyval(u, c)
    clear = np.abs(value) > 1e-12 * max(np.abs(c).max(), 1e-300)
    roots = roots_in_unit_interval(c)
    for low, high in zip(*(np.flatnonzero(clear)[part] for part in (slice(-1), slice(1, None))), strict=True):
        if value[low] * value[high] < 0:
            assert np.any((roots >= u[low]) & (roots <= u[high]))


@given(known_roots, st.sampled_from([-(2.0**20), -1.0, 2.0**-20, 3.0]))
def test_known_distinct_roots_are_found_the_ends_included(roots: list[float], leading: float) -> None:
    found = roots_in_unit_interval(from_roots(roots, leading))
    np.testing.assert_allclose(found, np.sort(roots), rtol=0, atol=1e-11)


@given(known_roots, st.integers(1, 3))
def test_vanishing_leading_coefficients_do_no_harm(roots: list[float], zeros: int) -> None:
    found = roots_in_unit_interval(np.concatenate([from_roots(roots), np.zeros(zeros)]))
    assert found.shape == (len(roots) + zeros,)
    assert all(distance(root, found) < 1e-8 for root in roots)


@pytest.mark.parametrize("tail", [1e-15, -1e-15, 1e-300])
def test_nearly_vanishing_leading_coefficients_do_no_harm(tail: float) -> None:
    assert distance(0.5, roots_in_unit_interval(np.array([-0.5, 1.0, tail, -tail, tail]))) < 1e-14


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("others", [[], [0.8], [2.0, -1.0], [0.8, 0.8]])
def test_a_double_root_without_a_change_of_sign_is_found(sign: float, others: list[float]) -> None:
    found = roots_in_unit_interval(from_roots([0.3, 0.3, *others], sign))
    # Rounding may split a double root by the square root of the precision.
    assert all(distance(root, found) < 1e-7 for root in [0.3, *others] if 0 <= root <= 1)


@pytest.mark.parametrize("end", [0.0, 1.0])
@pytest.mark.parametrize("multiplicity", [1, 2, 3])
def test_roots_at_the_ends(end: float, multiplicity: int) -> None:
    found = roots_in_unit_interval(from_roots([end] * multiplicity + [0.5]))
    assert distance(end, found) < 1e-15
    assert distance(0.5, found) < 1e-14


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("constant", [0.0, 2.0, -1e-12])
def test_constants_give_finite_numbers_in_the_interval(degree: int, constant: float) -> None:
    found = roots_in_unit_interval(np.concatenate([[constant], np.zeros(degree)]))
    assert found.shape == (degree,)
    assert np.all((found >= 0) & (found <= 1))


def test_all_five_roots_of_a_chebyshev_polynomial() -> None:
    inner = Polynomial([-1.0, 2.0])
    c = Polynomial(chebyshev.cheb2poly([0, 0, 0, 0, 0, 1]))(inner).coef
    expected = np.sort((1 + np.cos((2 * np.arange(5) + 1) * np.pi / 10)) / 2)
    np.testing.assert_allclose(roots_in_unit_interval(c), expected, rtol=0, atol=1e-13)


def test_a_stack_gives_what_its_members_give() -> None:
    stack = np.random.default_rng(3).normal(size=(4, 7, 5))
    stack[0, 0] = 0.0
    found = roots_in_unit_interval(stack)
    for index in np.ndindex(4, 7):
        np.testing.assert_array_equal(found[index], roots_in_unit_interval(stack[index]))
