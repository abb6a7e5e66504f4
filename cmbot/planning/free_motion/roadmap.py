"""A roadmap of free postures, for the path on which the largest cost is least (a bottleneck path)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray, interpolated
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.planning.free_motion.graph import graph_of, path_between_ends
from cmbot.robot import PostureMetric

# Random postures that are drawn in each round: half anywhere, half about the best path so far, at these
# standard deviations of a joint, rad.
_POSTURES_PER_ROUND, _SPREAD = 4000, (0.1, 0.3, 0.6)
_MAX_ROADMAP_ROUNDS = 6
# Nearest postures with which a new one is joined.
_NEIGHBOUR_COUNT = 12
# Edges that are checked in a round before the rest is left: where nearly all are blocked, more postures help
# more than more checks.
_MAX_CHECKED_EDGES = 400
# So many rounds in a row that lower the peak by no more than this share end it, and a few more where no path
# was found yet: where there is one, the first round nearly always finds it.
_FRUITLESS, _FRUITLESS_AT_FIRST, _LITTLE = 2, 3, 1e-3
# Bounds are compared with this tolerance, relative.
_BOUND_TOLERANCE = 1e-9


def lower_peak(
    space: FreeSpace, path: FloatArray, enough: float, stop: Callable[[], bool] = lambda: False
) -> FloatArray:
    """Return a path between the same postures as `path` on which the largest cost is lower, if one is found.

    A probabilistic roadmap (Kavraki et al., 1996) grows by postures whose cost is below the best path's peak,
    anywhere and about that path. On it the path whose largest cost is least is the one in the minimum
    spanning tree; the cost along edges is computed, and they are checked for collisions, when a path leads
    over them (lazy PRM; Bohlin and Kavraki, 2000). It grows as long as that lowers the peak. The random
    numbers are the same in every run.

    Parameters
    ----------
    space : FreeSpace
    path : (k, n), rad
        A free broken line.
    enough : float
        Peak from which on nothing is sought.
    stop : callable
        The search is given up when it says so.

    Returns
    -------
    (m, n) array, rad
        Free; `path` itself where nothing better was found.
    """
    roadmap, rng, given = _Roadmap(space, path[[0, -1]]), np.random.default_rng(0), path
    peak, rounds, fruitless = space.peak(path), 0, 0
    while peak > enough and rounds < _MAX_ROADMAP_ROUNDS and not stop():
        if fruitless >= (_FRUITLESS_AT_FIRST if path is given else _FRUITLESS):
            break
        rounds, before = rounds + 1, peak
        drawn = np.vstack([_anywhere(space, rng), _about(path, rng, space.robot.metric)])
        roadmap.add(drawn, peak)
        found = roadmap.bottleneck_path(peak, stop)
        if found is not None:
            path, peak = found, space.peak(found)
        fruitless = fruitless + 1 if peak > (1 - _LITTLE) * before else 0
    return path


def _anywhere(space: FreeSpace, rng: np.random.Generator) -> FloatArray:
    lower, upper = space.robot.limits.within_a_turn
    return rng.uniform(lower, upper, (_POSTURES_PER_ROUND // 2, len(lower)))


def _about(path: FloatArray, rng: np.random.Generator, metric: PostureMetric) -> FloatArray:
    """Random postures about a broken line (k, n)."""
    along = np.concatenate([[0.0], np.cumsum(metric.lengths(np.diff(path, axis=0)))])
    at = rng.uniform(0.0, along[-1], _POSTURES_PER_ROUND // 2)
    middle = interpolated(at, along, path)
    offsets = rng.normal(0.0, rng.choice(_SPREAD, (len(at), 1)), middle.shape)
    return middle + metric.positions(offsets)


class _Roadmap:
    """Free postures, the first two of which are to be joined, and the edges between neighbours."""

    def __init__(self, space: FreeSpace, ends: FloatArray) -> None:
        self._space = space
        self._q, self._at_nodes = ends, space.cost(ends)
        self._pairs = np.empty((0, 2), dtype=np.intp)
        # Edges in the order of their keys, one number for both ends.
        self._order, self._keys = np.empty((2, 0), dtype=np.intp)
        # Of an edge: the largest cost at its ends and, once it is computed, along it.
        self._cost = np.empty(0)
        self._length = np.empty(0)
        self._computed, self._checked = np.empty((2, 0), dtype=np.bool_)

    def add(self, q: FloatArray, bound: float) -> None:
        """Add those of the postures `q` (N, n) that are free and cost less than a bound, and their edges."""
        known = len(self._q)
        free = q[self._space.below(bound * (1 - _BOUND_TOLERANCE)).holds(q)]
        self._q = np.vstack([self._q, free])
        self._at_nodes = np.concatenate([self._at_nodes, self._space.cost(free)])
        new = np.arange(known if len(self._pairs) else 0, len(self._q))
        number = min(_NEIGHBOUR_COUNT + 1, len(self._q))
        x = self._space.robot.metric.coordinates(self._q)
        nearest = cKDTree(x).query(x[new], number)[1].reshape(len(new), number)
        pairs = np.stack([np.repeat(new, number), nearest.ravel()], axis=1)
        pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
        self._pairs = np.vstack([self._pairs, pairs])
        keys = self._key(self._pairs)
        self._order = np.argsort(keys, kind="stable")
        self._keys = keys[self._order]
        self._cost = np.concatenate([self._cost, self._at_nodes[pairs].max(axis=1)])
        length = self._space.robot.metric.lengths(np.diff(self._q[pairs], axis=1)[:, 0])
        self._length = np.concatenate([self._length, length])
        unknown = np.zeros(len(pairs), dtype=np.bool_)
        self._computed = np.concatenate([self._computed, unknown])
        self._checked = np.concatenate([self._checked, unknown])

    def bottleneck_path(self, bound: float, stop: Callable[[], bool]) -> FloatArray | None:
        """Return the shortest of the free paths (k, n) whose largest cost is least, if below a bound."""
        checks, least = 0, -np.inf
        while checks < _MAX_CHECKED_EDGES and not stop():
            # Costs only rise, so what is least stays so as long as a path is left below it.
            nodes = self._shortest(least)
            if nodes is None:
                usable = self._cost < bound * (1 - _BOUND_TOLERANCE)
                nodes = path_between_ends(minimum_spanning_tree(self._graph(self._cost, usable)))
                if nodes is None:
                    return None
                least = float(self._cost[self._edges(nodes)].max())
                shortest = self._shortest(least)
                nodes = nodes if shortest is None else shortest
            edges = self._edges(nodes)
            self._compute(edges[~self._computed[edges]])
            if self._cost[edges].max() > least:
                continue
            unknown = edges[~self._checked[edges]]
            checks += len(unknown)
            free = [self._space.straight(*self._q[self._pairs[edge]]) for edge in unknown]
            self._checked[unknown] = True
            if all(free):
                return np.asarray(self._q[nodes])
            # No path leads over them any more.
            self._cost[unknown[~np.array(free)]] = np.inf
        return None

    def _shortest(self, most: float) -> IntArray | None:
        """Indices of the shortest path on edges that cost no more than `most`; None without one."""
        return path_between_ends(self._graph(self._length, self._cost <= most))

    def _compute(self, edges: IntArray) -> None:
        """Compute the largest costs along edges."""
        if len(edges):
            self._cost[edges] = self._space.highest(*np.swapaxes(self._q[self._pairs[edges]], 0, 1))
            self._computed[edges] = True

    def _graph(self, weight: FloatArray, usable: BoolArray) -> sparse.csr_array:
        return graph_of(len(self._q), self._pairs[usable], weight[usable])

    def _edges(self, nodes: IntArray) -> IntArray:
        """Indices of the edges between the postures of a path."""
        ends = np.sort(np.stack([nodes[:-1], nodes[1:]], axis=1), axis=1)
        return np.asarray(self._order[np.searchsorted(self._keys, self._key(ends))])

    def _key(self, pairs: IntArray) -> IntArray:
        return np.asarray(pairs[:, 0] * len(self._q) + pairs[:, 1])
