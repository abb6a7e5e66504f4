"""The distances of all pairs of shapes, one by one."""

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray

# How well coal knows the depth of a deep overlap, m.
TOLERANCE = 2e-6


def all_distances(clearances: Clearances, q: FloatArray) -> FloatArray:
    """(P, N), m, in postures `q` (N, n)."""
    pairs = range(len(clearances.pairs))
    return np.array([[clearances.nearest(q_k, pair).distance for pair in pairs] for q_k in q]).T
