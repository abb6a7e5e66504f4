"""The fewest groups of strokes: against all partitions of a few strokes, and what may not go together."""

from collections.abc import Iterator

import numpy as np
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays

from cmbot.stances.ranking import fewest_groups

# Few values, so that ties occur; infinite: not reached.
values = st.sampled_from([1.0, 2.0, 3.0, np.inf])
bounds = st.integers(1, 4).flatmap(
    lambda strokes: arrays(float, st.tuples(st.just(strokes), st.integers(1, 6)), elements=values)
)


def partitions(of: list[int]) -> Iterator[list[list[int]]]:
    if not of:
        yield []
        return
    first, others = of[0], of[1:]
    for parts in partitions(others):
        yield [[first], *parts]
        for k, part in enumerate(parts):
            yield [*parts[:k], [first, *part], *parts[k + 1 :]]


def asked(bound: np.ndarray, groups: list[list[int]], excluded: list[frozenset[int]]) -> float:
    """The largest bound, each group in the stance that asks least of it; infinite where one has none."""
    if any(other <= set(group) for group in groups for other in excluded):
        return np.inf
    return max(float(bound[group].max(axis=0).min()) for group in groups)


@settings(max_examples=150, deadline=None)
@given(bound=bounds, pairs=st.sets(st.frozensets(st.integers(0, 3), min_size=2, max_size=3), max_size=3))
def test_as_few_groups_as_of_all_partitions_and_the_least_bound(
    bound: np.ndarray, pairs: set[frozenset[int]]
) -> None:
    strokes = list(range(len(bound)))
    excluded = [pair for pair in pairs if pair <= set(strokes)]
    each = [(len(groups), asked(bound, groups, excluded)) for groups in partitions(strokes)]
    possible = [pair for pair in each if np.isfinite(pair[1])]
    found = fewest_groups(bound, excluded)
    if not possible:
        assert found is None
        return
    groups = [sorted(group) for group in found]
    assert sorted(number for group in groups for number in group) == strokes
    assert (len(groups), asked(bound, groups, excluded)) == min(possible)
