"""Two trees of free postures that grow towards each other (RRT-Connect)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.robot import PostureMetric

# Longest step of a tree, rad, and how often the trees are grown before the search is given up: also so often
# one after the other without a new posture, as where the roots of a tree are shut in.
_MAX_TREE_STEP = 0.3
MOST_GROWTHS, _SHUT_IN = 4000, 300


def rrt_connect(
    space: FreeSpace,
    start: FloatArray,
    ends: FloatArray,
    stop: Callable[[], bool] = lambda: False,
    most: int = MOST_GROWTHS,
) -> FloatArray | None:
    """Connect a free posture (n,) to one of some others (m, n) by a broken line of free ones, (k, n).

    A tree grows from the start, and one with as many roots from the others, towards random postures and
    towards each other (RRT-Connect; Kuffner and LaValle, 2000). The random numbers are the same in every run.
    None when no connection was found; the search is given up when `stop` says so, after `most` growths, and
    where a tree finds no new posture any more.
    """
    nearest = np.argsort(space.robot.metric.lengths(ends - start), kind="stable")
    for end in ends[nearest]:
        if space.straight(start, end):
            return np.stack([start, end])
    rng = np.random.default_rng(0)
    lower, upper = space.robot.limits.within_a_turn
    trees = (_Tree(start[None], space.robot.metric), _Tree(ends, space.robot.metric))
    for growth in range(most):
        tree, other = trees[growth % 2], trees[1 - growth % 2]
        if tree.fruitless >= _SHUT_IN or stop():
            break
        new = tree.grow(space, rng.uniform(lower, upper))
        if new is None:
            continue
        while True:
            met = other.grow(space, tree.q[new])
            if met is None:
                break
            if np.array_equal(other.q[met], tree.q[new]):
                first, second = (new, met) if tree is trees[0] else (met, new)
                return np.vstack([trees[0].to_root(first)[::-1], trees[1].to_root(second)[1:]])
    return None


class _Tree:
    """A tree of free postures, or several, from their roots (m, n)."""

    def __init__(self, roots: FloatArray, metric: PostureMetric) -> None:
        self.q = roots
        self._parent, self._metric = [-1] * len(roots), metric
        # Steps since the last one to a new posture.
        self.fruitless = 0

    def grow(self, space: FreeSpace, target: FloatArray) -> int | None:
        """Take one step from the nearest posture towards `target`; return the new posture's index."""
        nearest = int(self._metric.lengths(self.q - target).argmin())
        move = target - self.q[nearest]
        length = float(self._metric.lengths(move))
        if length == 0.0:
            return nearest
        self.fruitless += 1
        new = target if length <= _MAX_TREE_STEP else self.q[nearest] + move * (_MAX_TREE_STEP / length)
        if not space.straight(self.q[nearest], new):
            return None
        self.q = np.vstack([self.q, new])
        self._parent.append(nearest)
        self.fruitless = 0
        return len(self._parent) - 1

    def to_root(self, index: int) -> FloatArray:
        """Postures from number `index` to its root."""
        indices = [index]
        while self._parent[indices[-1]] >= 0:
            indices.append(self._parent[indices[-1]])
        return self.q[indices]
