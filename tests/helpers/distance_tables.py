"""The distances of all pairs of shapes, one by one, and obstacles of every shape."""

from typing import Any

import coal
import numpy as np

from cmbot.collision import Box, Capsule, Clearances, Cylinder, Shape, Sphere
from cmbot.common.arrays import FloatArray

# How well coal knows the depth of a deep overlap, m.
TOLERANCE = 2e-6
SHAPES: dict[str, tuple[Shape, Any]] = {
    "box": (Box(size=(0.3, 0.5, 0.9)), coal.Box(0.3, 0.5, 0.9)),
    "cylinder": (Cylinder(radius=0.2, length=0.7), coal.Cylinder(0.2, 0.7)),
    "capsule": (Capsule(radius=0.15, length=0.6), coal.Capsule(0.15, 0.6)),
    "sphere": (Sphere(radius=0.3), coal.Sphere(0.3)),
}


def all_distances(clearances: Clearances, q: FloatArray) -> FloatArray:
    """(P, N), m, in postures `q` (N, n)."""
    pairs = range(len(clearances.pairs))
    return np.array([[clearances.nearest(q_k, pair).distance for pair in pairs] for q_k in q]).T
