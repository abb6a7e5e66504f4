"""How far stationary Gaussian motions go: peaks, and the probability that they leave a region in a time.

The rate at which a vector leaves a region is Rice's, over its boundary (Belyaev, 1968). Motions with few
modes leave it in clumps; Vanmarcke's factor (1975) makes of the rate that of first departures.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from cmbot.common.arrays import FloatArray
from cmbot.excitation.response import Moments

_EULER = 0.5772156649
_BOUNDARY_ANGLES = 128
# Below this share of the largest variance a direction does not move.
_STILL_SHARE = 1e-12


def davenport_factor(rate: float, seconds: float) -> float:
    """Return the mean peak of a Gaussian motion in a time, in standard deviations (Davenport, 1964).

    Parameters
    ----------
    rate : float, 1/s
        Of crossings of the mean upwards.
    seconds : float
    """
    root = np.sqrt(2 * np.log(max(rate * seconds, np.e)))
    return float(root + _EULER / root)


def bandwidth(value: float, first: float, rate: float) -> float:
    """Return Vanmarcke's spread of a spectrum from its moments, 0 (one frequency) to 1."""
    return float(np.sqrt(max(1 - first**2 / (value * rate), 0.0))) if value * rate > 0 else 0.0


def departure_rate(moments: Moments, bound: float) -> tuple[float, float]:
    """Return at which rate outputs leave a ball about zero, 1/s, and the share of time outside at most.

    Parameters
    ----------
    moments : Moments
        Of one output, an interval, or of two, a circle.
    bound : float
        The radius.

    Notes
    -----
    Across the boundary's normal n at the point y the rate of y is Gaussian with the mean ``n' R C^-1 y`` and
    the variance ``n' (V - R C^-1 R') n``; only its positive part leaves.
    """
    C, V, R = moments.value, moments.rate, moments.cross
    values, axes = np.linalg.eigh(C)
    if values[-1] <= 0:
        return 0.0, 0.0
    main = axes[:, -1:].T
    along = moments.along(main)
    sigma = float(np.sqrt(values[-1]))
    q = bandwidth(float(along.value[0, 0]), float(along.first[0, 0]), float(along.rate[0, 0]))
    if len(C) == 1 or values[0] < _STILL_SHARE * values[-1]:
        rate = np.sqrt(float(along.rate[0, 0])) / (np.pi * sigma) * np.exp(-0.5 * (bound / sigma) ** 2)
    else:
        angle = 2 * np.pi * np.arange(_BOUNDARY_ANGLES) / _BOUNDARY_ANGLES
        # Denser where the motion reaches farthest: by the angle of the ellipse of equal density.
        n = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        inverse = np.linalg.inv(C)
        mean = bound * np.einsum("ai,ij,aj->a", n, R @ inverse, n)
        spread = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", n, V - R @ inverse @ R.T, n), 1e-300))
        outward = mean * ndtr(mean / spread) + spread * np.exp(-0.5 * (mean / spread) ** 2) / np.sqrt(
            2 * np.pi
        )
        density = np.exp(-0.5 * bound**2 * np.einsum("ai,ij,aj->a", n, inverse, n))
        density /= 2 * np.pi * np.sqrt(np.linalg.det(C))
        rate = float(np.sum(outward * density) * bound * 2 * np.pi / _BOUNDARY_ANGLES)
    outside = float(np.exp(-0.5 * (bound / sigma) ** 2))
    clumps = -np.expm1(-np.sqrt(np.pi / 2) * q**1.2 * bound / sigma)
    return float(rate) * clumps / max(1 - outside, 1e-12), outside


def probability_of_leaving(t: FloatArray, rate: FloatArray, outside: FloatArray) -> float:
    """Return the probability that a region is left at least once.

    Parameters
    ----------
    t : (N,), s
    rate, outside : (N,)
        From `departure_rate`, at these times; linear between them.
    """
    expected = float(np.sum((rate[1:] + rate[:-1]) / 2 * np.diff(t)))
    return float(1 - (1 - outside[0]) * np.exp(-expected))
