"""Collision-free paths through joint space: RRT-Connect and shortcuts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.robot import Robot

__all__ = ["FreeSpace", "connect", "shorten"]

# Longest step of a tree, rad, and how often the trees are grown before the search is given up.
_STEP = 0.3
_MOST_GROWTHS = 4000
# Pairs of points of a path between which a shortcut is tried.
_SHORTCUTS = 150
# Between two postures of a line that are checked no point of the arm moves further than this, m.
_CHECK_EVERY = 0.04
# Where the ends of a path spare less, this share of what they spare is required in between.
_SHARE_TO_SPARE = 0.5


@dataclass(frozen=True)
class FreeSpace:
    """Postures within the joint ranges whose shapes keep a margin from each other.

    Attributes
    ----------
    robot : Robot
    clearances : Clearances
    margin : float, m
    spare : float, m
        Kept beyond the margin for the neighbours of a posture that is checked. With the default a line is
        free all along; with less only where it is checked, and a certificate has to cover the rest.
    """

    robot: Robot
    clearances: Clearances
    margin: float
    spare: float = _CHECK_EVERY / 2

    def around(self, q: FloatArray) -> FreeSpace | None:
        """Return the space that spares at most what postures `q` (N, n) spare; None when one is not free.

        Neighbouring links of some arms are always near each other and never spare much.
        """
        limits = self.robot.limits
        if ((q < limits.lower) | (q > limits.upper)).any():
            return None
        left = float(self.clearances.smallest(q).distance.min()) - self.margin
        return None if left < 0 else replace(self, spare=min(self.spare, _SHARE_TO_SPARE * left))

    def holds(self, q: FloatArray) -> BoolArray:
        """Which of the postures `q` (N, n) are free, and spare enough for their neighbours."""
        limits = self.robot.limits
        within: BoolArray = np.all((q >= limits.lower) & (q <= limits.upper), axis=1)
        free = within.copy()
        free[within] = ~self.clearances.check_collision(q[within], self.margin + self.spare)
        return free

    def straight(self, start: FloatArray, end: FloatArray) -> bool:
        """Whether the postures checked on the line between two postures (n,) are free."""
        moved = float(np.abs(end - start) @ self.clearances.reach)
        shares = np.linspace(0.0, 1.0, int(np.ceil(moved / _CHECK_EVERY)) + 1)[1:, None]
        return bool(self.holds(start + shares * (end - start)).all())


def connect(space: FreeSpace, start: FloatArray, end: FloatArray) -> FloatArray | None:
    """Connect two free postures (n,) by a broken line of free ones, (k, n); None when none was found.

    Two trees grow from both ends towards random postures and towards each other (RRT-Connect; Kuffner and
    LaValle, 2000). The random numbers are the same in every run.
    """
    if space.straight(start, end):
        return np.stack([start, end])
    rng = np.random.default_rng(0)
    limits = space.robot.limits
    lower, upper = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    trees = (_Tree(start), _Tree(end))
    for growth in range(_MOST_GROWTHS):
        tree, other = trees[growth % 2], trees[1 - growth % 2]
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


def shorten(space: FreeSpace, path: FloatArray) -> FloatArray:
    """Cut corners of a broken line (k, n) where the straight line is free."""
    rng = np.random.default_rng(0)
    for _ in range(_SHORTCUTS):
        if len(path) < 3:
            break
        first, second = np.sort(rng.choice(len(path), 2, replace=False))
        if second - first > 1 and space.straight(path[first], path[second]):
            path = np.vstack([path[: first + 1], path[second:]])
    return path


class _Tree:
    """A tree of free postures."""

    def __init__(self, root: FloatArray) -> None:
        self.q = root[None]
        self._parent = [-1]

    def grow(self, space: FreeSpace, target: FloatArray) -> int | None:
        """Take one step from the nearest posture towards `target`; return the new posture's index."""
        nearest = int(np.linalg.norm(self.q - target, axis=1).argmin())
        move = target - self.q[nearest]
        length = float(np.linalg.norm(move))
        if length == 0.0:
            return nearest
        new = target if length <= _STEP else self.q[nearest] + move * (_STEP / length)
        if not space.straight(self.q[nearest], new):
            return None
        self.q = np.vstack([self.q, new])
        self._parent.append(nearest)
        return len(self._parent) - 1

    def to_root(self, index: int) -> FloatArray:
        """Postures from number `index` to the root."""
        indices = [index]
        while self._parent[indices[-1]] >= 0:
            indices.append(self._parent[indices[-1]])
        return self.q[indices]
