"""Sets of postures that keep a distance from each other: Poisson-disk sampling (Bridson, 2007)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.robot import PostureMetric

__all__ = ["PoissonDiskSets", "without_neighbours"]

_ONE_TURN = 2 * np.pi


class PoissonDiskSets:
    """Sets of postures, which keep distances from those that were there before, in their set.

    Each has its own k-d tree, which is quicker than one of all. All angles lie on a circle. `first` are the
    postures at first, (M, n) of each. Distances are in rad, by `metric`, of each posture (N,) or of all;
    indices of sets `of` (N,) ascend.
    """

    def __init__(self, first: Sequence[FloatArray], metric: PostureMetric) -> None:
        self._metric = metric
        self.postures = list(first)
        self._turned = [metric.on_one_turn(q) for q in first]
        self._trees: list[cKDTree | None] = [None] * len(first)

    @property
    def sizes(self) -> IntArray:
        """Number of postures in each."""
        return np.array([len(q) for q in self.postures])

    def far(self, q: FloatArray, of: IntArray, apart: FloatArray | float) -> BoolArray:
        """Which of postures `q` (N, n) are at least `apart` from those in their sets."""
        return self._far(self._metric.on_one_turn(q), of, np.broadcast_to(apart, of.shape))

    def take(self, q: FloatArray, of: IntArray, apart: FloatArray | float) -> BoolArray:
        """Add those of `q` (N, n) that are at least `apart` from all others, in order, and return which."""
        turned, apart = self._metric.on_one_turn(q), np.broadcast_to(apart, of.shape)
        taken = self._far(turned, of, apart)
        candidates = np.flatnonzero(taken)
        for k, some in _groups(of[candidates]):
            mine = candidates[some]
            tree = cKDTree(turned[mine], boxsize=self._metric.period)
            near = tree.query_pairs(apart[mine].max(), output_type="ndarray")
            away = np.abs(turned[mine[near[:, 0]]] - turned[mine[near[:, 1]]])
            away = np.where(self._metric.prismatic, away, np.minimum(away, _ONE_TURN - away))
            pairs = near[(away * away).sum(axis=1) < apart[mine[near[:, 1]]] ** 2]
            if len(pairs):
                keep = without_neighbours(len(mine), pairs)
                taken[mine] = keep
                mine = mine[keep]
            alone = len(pairs) == 0 and len(self.postures[k]) == 0
            self._trees[k] = tree if alone else None
            self.postures[k] = np.concatenate([self.postures[k], q[mine]])
            self._turned[k] = np.concatenate([self._turned[k], turned[mine]])
        return taken

    def _far(self, turned: FloatArray, of: IntArray, apart: FloatArray) -> BoolArray:
        far = np.ones(len(turned), dtype=np.bool_)
        for k, some in _groups(of):
            if len(self.postures[k]):
                most = apart[some].max()
                distance, _ = self._tree(k).query(turned[some], distance_upper_bound=most)
                far[some] = distance >= apart[some]
        return far

    def _tree(self, k: int) -> cKDTree:
        tree = self._trees[k]
        if tree is None:
            tree = self._trees[k] = cKDTree(self._turned[k], boxsize=self._metric.period)
        return tree


def _groups(of: IntArray) -> Iterator[tuple[int, slice]]:
    """Yield the numbers in `of`, which ascend, and the slice of each."""
    ends = [0, *(np.flatnonzero(of[1:] != of[:-1]) + 1).tolist(), len(of)] if len(of) else []
    for start, end in pairwise(ends):
        yield int(of[start]), slice(start, end)


def without_neighbours(number: int, pairs: IntArray) -> BoolArray:
    """Which of `number` items remain when each in turn removes its later neighbours of `pairs` (k, 2)."""
    keep, open_ = np.ones(number, dtype=np.bool_), np.ones(number, dtype=np.bool_)
    while len(pairs):
        # Items without an earlier neighbour stay, and their neighbours go.
        waiting = np.zeros(number, dtype=np.bool_)
        waiting[pairs[:, 1]] = True
        settled = open_ & ~waiting
        keep[pairs[settled[pairs[:, 0]], 1]] = False
        open_ = keep & waiting
        pairs = pairs[open_[pairs].all(axis=1)]
    return keep
