"""Graphs of postures that are joined to their neighbours."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from cmbot.common.arrays import FloatArray, IntArray

# Weight of an edge that has none, such as between two postures that are the same: a sparse graph would take
# it for no edge.
_MIN_EDGE_WEIGHT = 1e-12


def graph_of(number: int, pairs: IntArray, weight: FloatArray) -> sparse.csr_array:
    """Return the graph of so many postures whose edges are `pairs` (E, 2), of weights (E,)."""
    ends = (pairs[:, 0], pairs[:, 1])
    return sparse.csr_array((np.maximum(weight, _MIN_EDGE_WEIGHT), ends), shape=(number, number))


def path_between_ends(graph: sparse.csr_array) -> IntArray | None:
    """Return the shortest path from the first posture to the second, as indices; None without one."""
    distance, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
    if not np.isfinite(distance[1]):
        return None
    nodes = [1]
    while nodes[-1] != 0:
        nodes.append(int(before[nodes[-1]]))
    return np.array(nodes[::-1])
