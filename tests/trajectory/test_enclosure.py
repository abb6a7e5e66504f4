"""Enclosures hold at every time that is tried, and lie no further out than asked for."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from small_motions import wild

from cmbot.common.arrays import FloatArray
from cmbot.trajectory import (
    Pieces,
    bernstein_coefficients,
    clenshaw_curtis,
    halves,
    highest,
)
from cmbot.trajectory.enclosure import DEGREE

SEEDS = st.integers(min_value=0, max_value=2**32 - 1)


def dense(pieces: Pieces, each: int = 301) -> FloatArray:
    """Times (K, each) in all pieces, s."""
    return np.linspace(pieces.start, pieces.end, each, axis=1)


def size_of_sines(pieces: Pieces) -> FloatArray:
    """What the vector of sines of all joints does not exceed on the ellipses."""
    turn = np.minimum(pieces.ellipses.turn.max(axis=2), 700.0)  # beyond it no remainder is of use
    return np.asarray(np.sqrt(pieces.ellipses.turn.shape[2]) * np.exp(turn))


@given(seed=SEEDS)
def test_sines_of_the_joints_lie_in_their_enclosure(seed: int) -> None:
    x = wild(seed)
    pieces = Pieces.between(x, np.array([0.5]))
    pieces = pieces.refined(lambda some: some.remainder(size_of_sines(some)) / 1e-6, 10_000)
    remainder = pieces.remainder(size_of_sines(pieces))
    assert (remainder <= 1e-6).all()
    control = pieces.control_points(np.sin(pieces.states[0]))
    for resolution in (1e-2, 1e-5):
        peak = highest(pieces, control, lambda p, _: np.linalg.norm(p, axis=1), remainder, resolution)
        sampled = np.linalg.norm(np.sin(x.evaluate(dense(pieces).ravel())), axis=1).max()
        assert sampled <= peak.bound <= sampled + resolution + 1e-4
        assert peak.value <= peak.bound
        there = np.linalg.norm(np.sin(x.evaluate([peak.time])))
        assert there == pytest.approx(peak.value, abs=3e-6)


@given(seed=SEEDS)
def test_interpolants_miss_no_more_than_the_remainder(seed: int) -> None:
    """At random times, by Bernstein's polynomials."""
    x = wild(seed)
    pieces = Pieces.between(x, np.empty(0))
    control = pieces.control_points(np.sin(pieces.states[0]))
    u = np.random.default_rng(seed).uniform(0, 1, 50)
    k = np.arange(DEGREE + 1)
    binomial = np.cumprod(np.concatenate([[1.0], (DEGREE - k[:-1]) / (k[:-1] + 1)]))
    basis = binomial * u[:, None] ** k * (1 - u[:, None]) ** (DEGREE - k)
    got = np.einsum("kmd,ud->kum", control, basis)
    times = pieces.start[:, None] + u * (pieces.end - pieces.start)[:, None]
    expected = np.sin(x.evaluate(times.ravel())).reshape(got.shape)
    missed = np.linalg.norm(got - expected, axis=2).max(axis=1)
    assert (missed <= pieces.remainder(size_of_sines(pieces)) + 1e-13).all()


@given(seed=SEEDS)
def test_ellipses_bound_the_state_at_complex_times(seed: int) -> None:
    from cmbot.trajectory.enclosure import _ELLIPSE_SUMS

    x = wild(seed)
    pieces = Pieces.between(x, np.empty(0))
    on = pieces.ellipses
    angle = np.exp(1j * np.linspace(0, 2 * np.pi, 40, endpoint=False))
    for r, rho in enumerate(_ELLIPSE_SUMS):
        u = 0.5 + 0.25 * (rho * angle + 1 / (rho * angle))  # of the unit interval
        for order, bound in enumerate((on.turn, on.v, on.a)):
            c = np.polynomial.polynomial.polyder(x.coefficients.transpose(2, 0, 1), order)
            h = np.diff(x.t)[:, None, None] ** order
            value = np.polynomial.polynomial.polyval(u, c) / h
            value = np.abs(value.imag if order == 0 else value).max(axis=2)
            assert (value <= bound[:, r] * (1 + 1e-9)).all()


def test_breaks_part_pieces_but_not_at_knots() -> None:
    x = wild(1)
    breaks = np.array([-1.0, 0.0, x.t[2], x.t[2] + 1e-13, 0.5 * (x.t[3] + x.t[4]), x.t[-1], 99.0])
    pieces = Pieces.between(x, breaks)
    np.testing.assert_array_equal(pieces.start, np.sort([*x.t[:-1], breaks[4]]))
    np.testing.assert_array_equal(pieces.end[:-1], pieces.start[1:])
    assert pieces.times.shape == (6, DEGREE + 1)
    np.testing.assert_array_equal(pieces.times[:, [0, -1]].T, [pieces.start, pieces.end])


def test_halved_pieces_cover_the_same_time() -> None:
    pieces = Pieces.between(wild(2), np.empty(0))
    which = np.array([True, False, False, True, False])
    halved = pieces.halved(which)
    assert len(halved.start) == 7
    np.testing.assert_array_equal(halved.end[:-1], halved.start[1:])
    assert (halved.start[0], halved.end[-1]) == (pieces.start[0], pieces.end[-1])
    # Where no more pieces may be made, the remainder stays what it is.
    assert len(pieces.refined(lambda some: np.full(len(some.start), 2.0), 6).start) == 5


@given(seed=SEEDS, degree=st.integers(min_value=0, max_value=8))
def test_halves_are_the_same_polynomial(seed: int, degree: int) -> None:
    c = np.random.default_rng(seed).normal(size=(3, degree + 1))
    b = bernstein_coefficients(c)
    u = np.linspace(0, 1, 7)
    for part, start in zip(halves(b), (0.0, 0.5), strict=True):
        moved = np.array([np.poly1d(row[::-1])(np.poly1d([0.5, start])).c[::-1] for row in c])
        np.testing.assert_allclose(part, bernstein_coefficients(moved), atol=1e-12)
    np.testing.assert_allclose(b[:, [0, -1]], np.polynomial.polynomial.polyval([0, 1], c.T), atol=1e-13)
    value = np.polynomial.polynomial.polyval(u, c.T)
    assert (value <= b.max(axis=1, keepdims=True) + 1e-12).all()


def test_the_mean_of_polynomials_is_exact() -> None:
    points = 0.5 * (1 + np.cos(np.pi * np.arange(DEGREE, -1, -1) / DEGREE))
    for power in range(DEGREE + 1):
        assert clenshaw_curtis() @ points**power == pytest.approx(1 / (power + 1), rel=1e-13)


def test_what_is_no_number_has_no_bound() -> None:
    pieces = Pieces.between(wild(3), np.empty(0))
    values = np.sin(pieces.states[0])
    values[7] = np.nan
    peak = highest(pieces, pieces.control_points(values), lambda p, _: p[:, 0], np.zeros(5), 1e-3)
    assert np.isnan([peak.value, peak.bound]).all()
    assert (~(pieces.remainder(np.full((5, 17), np.inf)) < np.inf)).all()
    estimated = pieces.estimated_remainder(np.sin(pieces.states[0]))
    assert ((estimated > 0) & (estimated < 0.1)).all()


@given(seed=SEEDS)
def test_a_remainder_that_is_no_number_is_infinite(seed: int) -> None:
    """Wherever it is among those of the pieces: the peak is bounded by nothing then."""
    x, rng = wild(seed), np.random.default_rng(seed)
    pieces = Pieces.between(x, np.empty(0))
    remainder = np.where(np.arange(len(pieces.start)) == rng.integers(len(pieces.start)), np.nan, 1e-3)
    control = pieces.control_points(np.sin(pieces.states[0]))
    peak = highest(pieces, control, lambda p, _: p.max(axis=1), remainder, 1e-3)
    assert np.isfinite(peak.value)
    assert peak.bound == np.inf
    size = np.ones((len(pieces.start), 17))
    size[2, rng.integers(17) :] = np.nan
    size[3] = np.nan
    missed = pieces.remainder(size)
    assert missed[3] == np.inf
    assert (missed[2] == np.inf) == bool(np.isnan(size[2, 0]))
    assert np.isfinite(missed[[0, 1, 4]]).all()
