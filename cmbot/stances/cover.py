"""The fewest stances from which all strokes can be done: a set cover, solved exactly."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp

from cmbot.common.arrays import BoolArray, FloatArray

_Group = frozenset[int]


def fewest_groups(bound: FloatArray, excluded: Collection[_Group] = ()) -> tuple[_Group, ...] | None:
    """Part strokes into the fewest groups of which each can be done from one stance.

    Among these partitions the largest bound over all strokes is the smallest. Both by integer programs over
    the sets of strokes that stances reach (HiGHS by `scipy.optimize.milp`).

    Parameters
    ----------
    bound : (S, C)
        Bound of each of C stances for each of S strokes; infinite where it does not reach it.
    excluded : collection of frozenset of int
        Strokes that no stance does together, whatever their bounds say.

    Returns
    -------
    tuple of frozenset of int, or None
        Numbers of the strokes, by the smallest of each; None where a stroke cannot be done at all.
    """
    sets = _sets(np.isfinite(bound), excluded)
    cover = _smallest_cover(sets)
    if cover is None:
        return None
    # The smallest value of the bound at which as few stances do: it is one of those in the table.
    values = np.unique(bound[np.isfinite(bound)])
    low, high = 0, len(values) - 1
    while low < high:
        middle = (low + high) // 2
        tried = _sets(bound <= values[middle], excluded)
        found = _smallest_cover(tried)
        if found is not None and len(found) == len(cover):
            high, sets, cover = middle, tried, found
        else:
            low = middle + 1
    return _parted(sets[:, cover], bound)


def _sets(reached: BoolArray, excluded: Collection[_Group]) -> BoolArray:
    """The sets (S, U) of strokes that stances reach together, each once, less what is excluded."""
    rows = np.unique(reached.T, axis=0)
    for group in excluded:
        members = sorted(group)
        whole = rows[:, members].all(axis=1)
        if whole.any():
            # Without one of its strokes each.
            less = np.repeat(rows[whole], len(members), axis=0)
            less[np.arange(len(less)), np.tile(members, int(whole.sum()))] = False
            rows = np.unique(np.vstack([rows[~whole], less]), axis=0)
    return np.asarray(rows[rows.any(axis=1)].T)


def _smallest_cover(sets: BoolArray) -> list[int] | None:
    """Numbers of the fewest sets (S, U) that have all strokes; None where one is in none."""
    if not sets.any(axis=1).all():
        return None
    U = sets.shape[1]
    every = LinearConstraint(sparse.csr_array(sets.astype(float)), lb=1.0)
    found = milp(np.ones(U), integrality=np.ones(U), bounds=Bounds(0, 1), constraints=every)
    return np.flatnonzero(found.x > 0.5).tolist()


def _parted(cover: BoolArray, bound: FloatArray) -> tuple[_Group, ...]:
    """Strokes of overlapping sets (S, k), each with that of the best stances whose bound is smallest."""
    stance = [int(bound[each].max(axis=0).argmin()) for each in cover.T]
    asked = np.where(cover, bound[:, stance], np.inf)
    group = asked.argmin(axis=1)
    return tuple(
        sorted((frozenset(np.flatnonzero(group == k).tolist()) for k in range(len(stance))), key=min)
    )
