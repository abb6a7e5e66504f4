"""Polynomials on the unit interval: all their real roots, all their extrema, many at a time."""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.polynomial import polynomial

from cmbot.arrays import FloatArray

__all__ = ["derivative", "hull", "roots_in_unit_interval", "values"]


# Halving [0, 1] this often leaves an interval below the spacing of doubles near 1.
_BISECTIONS = 54


def derivative(c: FloatArray, order: int = 1) -> FloatArray:
    """Differentiate polynomials `order` times.

    Parameters
    ----------
    c : (..., k + 1)
        Coefficients, lowest power first.

    Returns
    -------
    (..., k + 1 - order)
    """
    return np.asarray(polynomial.polyder(c, order, axis=-1))


def hull(c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bound polynomials on the unit interval by the least and the largest of their Bernstein coefficients.

    Farouki, "The Bernstein polynomial basis: a centennial retrospective", 2012, Section 5.1. Far cheaper than
    extrema, and for short segments of a smooth curve hardly wider.

    Parameters
    ----------
    c : (..., k + 1)
        Coefficients, lowest power first.

    Returns
    -------
    low, high : (...)
    """
    degree = c.shape[-1] - 1
    to_bernstein = np.array(
        [[comb(i, j) / comb(degree, j) for i in range(degree + 1)] for j in range(degree + 1)]
    )
    b = c @ to_bernstein
    return b.min(axis=-1), b.max(axis=-1)


def roots_in_unit_interval(c: FloatArray) -> FloatArray:
    """Find the real roots in [0, 1] of many polynomials of one degree.

    Between neighbouring roots of its derivative a polynomial is monotone, so bisection there finds every
    root, whether it changes sign there or only touches zero. No leading coefficient is divided by:
    degenerate polynomials are harmless.

    Parameters
    ----------
    c : (..., k + 1)
        Coefficients, lowest power first, k >= 1.

    Returns
    -------
    (..., k)
        Sorted roots. Where a polynomial has fewer than k, the missing ones repeat an end of the interval
        or a stationary point, which is what a search for extrema can bear.
    """
    degree = c.shape[-1] - 1
    ends = (np.zeros((*c.shape[:-1], 1)), np.ones((*c.shape[:-1], 1)))
    stationary = [roots_in_unit_interval(derivative(c))] if degree > 1 else []
    edges = np.concatenate([ends[0], *stationary, ends[1]], axis=-1)
    low, high = edges[..., :-1].copy(), edges[..., 1:].copy()
    sign_low = np.sign(values(c, low))
    crosses = sign_low * np.sign(values(c, high)) <= 0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        left = np.sign(values(c, middle)) == sign_low
        low, high = np.where(left, middle, low), np.where(left, high, middle)
    return np.where(crosses, 0.5 * (low + high), edges[..., :-1])


def values(c: FloatArray, u: FloatArray) -> FloatArray:
    """Evaluate each polynomial `c` (..., k + 1) at its own points `u` (..., m), by Horner's rule."""
    value = np.broadcast_to(c[..., -1:], np.broadcast_shapes(c[..., -1:].shape, u.shape))
    for power in range(c.shape[-1] - 2, -1, -1):
        value = value * u + c[..., power : power + 1]
    return np.asarray(value)
