"""Sets of postures that keep a distance from each other: Poisson-disk sampling (Bridson, 2007)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.robot import PostureMetric

_ONE_TURN = 2 * np.pi


class PoissonDiskSets:
    """Sets of postures, which keep distances from those that were there before, in their set.

    Each has its own k-d tree, which is quicker than one of all. All angles lie on a circle, which is cut
    half a turn from `middle` (n,), rad: best where few postures are. `first` are the postures at first,
    (M, n) of each. Distances are in rad, by `metric`, of each posture (N,) or of all; indices of sets
    `of` (N,) ascend.
    """

    def __init__(self, first: Sequence[FloatArray], metric: PostureMetric, middle: FloatArray) -> None:
        self._metric, self._cut = metric, middle - 0.5 * _ONE_TURN
        # Sliding joints are on no circle.
        self._turn = np.where(metric.prismatic, np.inf, _ONE_TURN)
        self.postures = list(first)
        self._turned = [self._on_one_turn(q) for q in first]
        self._trees: list[cKDTree | None] = [None] * len(first)

    @property
    def sizes(self) -> IntArray:
        """Number of postures in each."""
        return np.array([len(q) for q in self.postures])

    def far(self, q: FloatArray, of: IntArray, apart: FloatArray | float) -> BoolArray:
        """Which of postures `q` (N, n) are at least `apart` from those in their sets."""
        return self._far(self._on_one_turn(q), of, np.broadcast_to(apart, of.shape))

    def take(self, q: FloatArray, of: IntArray, apart: FloatArray | float) -> BoolArray:
        """Add those of `q` (N, n) that are at least `apart` from all others, in order, and return which."""
        turned, apart = self._on_one_turn(q), np.broadcast_to(apart, of.shape)
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
            self._trees[k] = None
            self.postures[k] = np.concatenate([self.postures[k], q[mine]])
            self._turned[k] = np.concatenate([self._turned[k], turned[mine]])
        return taken

    def _on_one_turn(self, q: FloatArray) -> FloatArray:
        return self._metric.on_one_turn(q - self._cut)

    def _far(self, turned: FloatArray, of: IntArray, apart: FloatArray) -> BoolArray:
        far = np.ones(len(turned), dtype=np.bool_)
        for k, some in _groups(of):
            if len(self.postures[k]):
                here, least = turned[some], apart[some]
                tree, most = self._tree(k), least.max()
                # A tree with a box takes several times as long. What is far on this side of the cuts may be
                # near across them.
                away = tree.query(here, distance_upper_bound=most)[0] >= least
                images, number = self._across(here, away.nonzero()[0], tree, most)
                if len(images):
                    near = tree.query(images, distance_upper_bound=most)[0] < least[number]
                    away[number[near]] = False
                far[some] = away
        return far

    def _across(
        self, turned: FloatArray, which: IntArray, tree: cKDTree, most: float
    ) -> tuple[FloatArray, IntArray]:
        """Return postures (M, n) with some angles a whole turn further, of `which` of (N, n), and of which.

        Those that may be within `most` of any of the tree's.
        """
        images = turned[which]
        forth, back = tree.maxes + most - self._turn, tree.mins - most + self._turn
        across = (images <= forth) | (images >= back)
        chosen = across.any(axis=1)
        images, number = images[chosen], which[chosen]
        count = len(number)
        for j in across.any(axis=0).nonzero()[0]:
            angle, turn = images[:, j], np.where(np.arange(len(forth)) == j, _ONE_TURN, 0.0)
            low, high = angle <= forth[j], angle >= back[j]
            images = np.concatenate([images, images[low] + turn, images[high] - turn])
            number = np.concatenate([number, number[low], number[high]])
        return images[count:], number[count:]

    def _tree(self, k: int) -> cKDTree:
        tree = self._trees[k]
        if tree is None:
            # Made quickly, as each is asked a few times only.
            tree = self._trees[k] = cKDTree(self._turned[k], compact_nodes=False, balanced_tree=False)
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
