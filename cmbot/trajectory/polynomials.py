"""Polynomials on the unit interval: all their real roots, all their extrema, many at a time."""

from __future__ import annotations

from functools import cache
from math import comb, perm

import numpy as np

from cmbot.common.arrays import FloatArray

# A root is found once the next step is no longer than this; so many steps are enough, even if every other one
# only halves what is left of [0, 1].
_NEXT, _MAX_ROOT_STEPS = 2.0**-51, 110


def derivative(c: FloatArray, order: int = 1) -> FloatArray:
    """Differentiate polynomials `c` (..., k + 1), lowest power first, `order` times: (..., k + 1 - order).

    At least one coefficient is left: zero, where there is nothing else.
    """
    if order >= c.shape[-1]:
        return np.zeros((*c.shape[:-1], 1))
    return np.asarray(c[..., order:] * _factors(order, c.shape[-1]))


@cache
def _factors(order: int, number: int) -> FloatArray:
    """Factors that powers get when they are differentiated."""
    return np.array([perm(k, order) for k in range(order, number)], dtype=float)


def hull(c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bound polynomials `c` (..., k + 1), lowest power first, on the unit interval: low and high (...).

    By the least and the largest of their Bernstein coefficients: Farouki, "The Bernstein polynomial basis: a
    centennial retrospective", 2012, Section 5.1. Far cheaper than extrema, and for short segments of a smooth
    curve hardly wider.
    """
    b = bernstein_coefficients(c)
    return b.min(axis=-1), b.max(axis=-1)


def bernstein_coefficients(c: FloatArray) -> FloatArray:
    """Return the Bernstein coefficients (..., k + 1) on the unit interval of polynomials `c` (..., k + 1)."""
    return np.asarray(c @ _to_bernstein(c.shape[-1] - 1))


def halves(b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Bernstein coefficients (..., k + 1) on either half of the interval (de Casteljau)."""
    left = _to_left_half(b.shape[-1] - 1)
    return np.asarray(b @ left), np.asarray(b @ left[::-1, ::-1])


@cache
def _to_bernstein(degree: int) -> FloatArray:
    every = range(degree + 1)
    return np.array([[comb(i, j) / comb(degree, j) for i in every] for j in every])


@cache
def _to_left_half(degree: int) -> FloatArray:
    every = range(degree + 1)
    return np.array([[comb(j, i) / 2.0**j for j in every] for i in every])


def roots_in_unit_interval(c: FloatArray) -> FloatArray:
    """Find the real roots in [0, 1], sorted (..., k), of polynomials `c` (..., k + 1), k >= 1.

    Coefficients are lowest power first. Where a polynomial has fewer than k roots, the missing ones repeat an
    end of the interval or a stationary point, which is what a search for extrema can bear.

    Between neighbouring roots of its derivative a polynomial is monotone, so Newton's method, kept within an
    interval that halves where it is slow, finds every root there, whether the polynomial changes sign or only
    touches zero. Quadratic polynomials have a formula. Degenerate polynomials are harmless.
    """
    degree = c.shape[-1] - 1
    if degree == 2:
        return _roots_of_quadratics(c)
    ends = (np.zeros((*c.shape[:-1], 1)), np.ones((*c.shape[:-1], 1)))
    stationary = [roots_in_unit_interval(derivative(c))] if degree > 1 else []
    edges = np.concatenate([ends[0], *stationary, ends[1]], axis=-1)
    sign = np.sign(values(c, edges))
    low, high = edges[..., :-1], edges[..., 1:]
    roots = np.where((sign[..., :-1] != 0) & (sign[..., 1:] == 0), high, low)
    crossed = sign[..., :-1] * sign[..., 1:] < 0
    of = np.broadcast_to(c[..., None, :], (*crossed.shape, degree + 1))[crossed]
    roots[crossed] = _crossings(of, low[crossed], high[crossed], sign[..., :-1][crossed])
    return roots


def _roots_of_quadratics(c: FloatArray) -> FloatArray:
    """Roots (..., 2) in [0, 1] of quadratic polynomials (..., 3) without cancellation, sorted.

    Press et al., "Numerical Recipes", 2007, Section 5.6. Where there is none, the stationary point or an end.
    """
    constant, slope, bend = c[..., 0], c[..., 1], c[..., 2]
    root = np.sqrt(np.maximum(slope**2 - 4 * bend * constant, 0.0))
    larger = -0.5 * (slope + np.copysign(root, slope))
    with np.errstate(divide="ignore", invalid="ignore"):
        both = np.stack([larger / bend, np.where(root > 0, constant / larger, larger / bend)], axis=-1)
    return np.sort(np.clip(np.nan_to_num(both, nan=0.0), 0.0, 1.0), axis=-1)


def _crossings(c: FloatArray, low: FloatArray, high: FloatArray, sign: FloatArray) -> FloatArray:
    """Roots (K,) of polynomials (K, k + 1) that are monotone from `low` to `high` and change `sign` there.

    Press et al., "Numerical Recipes", 2007, Section 9.4: Newton's method with bisection.
    """
    slope = derivative(c)
    u, last, before = 0.5 * (low + high), high - low, high - low
    roots, left = u.copy(), np.arange(len(u))
    for _ in range(_MAX_ROOT_STEPS):
        if len(left) == 0:
            break
        value, rate = values(c, u[:, None])[:, 0], values(slope, u[:, None])[:, 0]
        lower = np.sign(value) == sign
        low, high = np.where(lower, u, low), np.where(lower, high, u)
        # Where the slope vanishes a step of Newton's leads nowhere.
        step = -value / np.where(rate == 0.0, np.nan, rate)
        quick = (low <= u + step) & (u + step <= high) & (2 * np.abs(step) <= before)
        step = np.where(quick, step, 0.5 * (low + high) - u)
        u, last, before = u + step, np.abs(step), last
        roots[left] = u
        on = (last > _NEXT) & (value != 0)
        c, slope, u, low, high, sign, last, before, left = (
            each[on] for each in (c, slope, u, low, high, sign, last, before, left)
        )
    return roots


def values(c: FloatArray, u: FloatArray) -> FloatArray:
    """Evaluate each polynomial `c` (..., k + 1) at its own points `u` (..., m), by Horner's rule."""
    if c.shape[-1] == 1:
        return np.asarray(c + np.zeros_like(u))
    value = c[..., -1:] * u
    for power in range(c.shape[-1] - 2, 0, -1):
        value += c[..., power : power + 1]
        value *= u
    value += c[..., :1]
    return np.asarray(value)
