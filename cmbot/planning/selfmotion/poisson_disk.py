"""Poisson-disk sets: the postures of each keep a distance from each other.

Angles of endless joints lie on a circle.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray

__all__ = ["PoissonDiskSets", "without_neighbours"]

_TURN = 2 * np.pi


class PoissonDiskSets:
    """Several sets of postures, empty at first; each has its own k-d tree, which is quicker than one of all.

    Parameters
    ----------
    number : int
    apart : float, rad
        Smallest distance of two postures of a set.
    round_ : (n,)
        Which joints' angles lie on a circle.
    """

    def __init__(self, number: int, apart: float, round_: BoolArray) -> None:
        self._apart = apart
        self._round = round_
        self._circle = np.where(round_, _TURN, 0.0)
        self.postures = [np.empty((0, len(round_))) for _ in range(number)]
        self._turned = self.postures.copy()
        self._trees: list[cKDTree | None] = [None] * number

    @property
    def sizes(self) -> IntArray:
        """Number of postures in each."""
        return np.array([len(q) for q in self.postures])

    def far(self, q: FloatArray, of: IntArray) -> BoolArray:
        """Which of postures `q` (N, n) are apart from those in their sets, whose indices `of` (N,) ascend."""
        return self._far(self._on_circle(q), of)

    def take(self, q: FloatArray, of: IntArray) -> BoolArray:
        """Add those of `q` (N, n) that are apart from all others, in their order; return which.

        The indices `of` (N,) of their sets ascend.
        """
        turned = self._on_circle(q)
        taken = self._far(turned, of)
        candidates = np.flatnonzero(taken)
        for k, some in _groups(of[candidates]):
            mine = candidates[some]
            tree = cKDTree(turned[mine], boxsize=self._circle)
            pairs = tree.query_pairs(self._apart, output_type="ndarray")
            if len(pairs):
                keep = without_neighbours(len(mine), pairs)
                taken[mine] = keep
                mine = mine[keep]
            alone = len(pairs) == 0 and len(self.postures[k]) == 0
            self._trees[k] = tree if alone else None
            self.postures[k] = np.concatenate([self.postures[k], q[mine]])
            self._turned[k] = np.concatenate([self._turned[k], turned[mine]])
        return taken

    def _far(self, turned: FloatArray, of: IntArray) -> BoolArray:
        far = np.ones(len(turned), dtype=np.bool_)
        for k, some in _groups(of):
            if len(self.postures[k]):
                distance, _ = self._tree(k).query(turned[some], distance_upper_bound=self._apart)
                far[some] = distance >= self._apart
        return far

    def _tree(self, k: int) -> cKDTree:
        tree = self._trees[k]
        if tree is None:
            tree = self._trees[k] = cKDTree(self._turned[k], boxsize=self._circle)
        return tree

    def _on_circle(self, q: FloatArray) -> FloatArray:
        # The tree needs angles from 0 to below a whole turn; a tiny negative one would round up to it.
        turned: FloatArray = q - self._circle * np.floor(q / _TURN)
        turned[self._round & (turned >= _TURN)] = 0.0
        return turned


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
