"""The distances of all pairs of shapes, one by one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cmbot.collision import Clearances

# How well coal knows the depth of a deep overlap, m.
TOLERANCE = 2e-6


def all_distances(clearances: Clearances, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P, N), m, in postures `q` (N, n)."""
    pairs = range(len(clearances.pairs))
    return np.array([[clearances.nearest(q_k, pair).distance for pair in pairs] for q_k in q]).T
