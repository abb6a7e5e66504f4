"""Gauss quadrature of what is smooth between knots."""

import numpy as np

from cmbot.common.arrays import FloatArray


def gauss_points(t: FloatArray, number: int) -> tuple[FloatArray, FloatArray]:
    """Times and weights of the mean over time between knots `t`, with `number` points a segment."""
    nodes, weights = np.polynomial.legendre.leggauss(number)
    h = np.diff(t)[:, None]
    return (t[:-1, None] + h * (1 + nodes) / 2).ravel(), (h * weights / 2).ravel() / (t[-1] - t[0])
