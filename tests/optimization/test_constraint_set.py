"""Sets of constraints: nothing twice, the first stay the first, and only what matters is kept."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.optimization.constraint_set import OBJECTIVE, ConstraintSet

STEP = 4.0
Identities = tuple[IntArray, IntArray, FloatArray]


def drawn(rng: np.random.Generator, number: int, end: float = 1.0) -> Identities:
    """Families, components and times."""
    return rng.integers(0, 3, number), rng.integers(0, 4, number), rng.uniform(0, end, number)


def identities(constraints: ConstraintSet) -> Identities:
    return constraints.family, constraints.component, constraints.time


@pytest.mark.parametrize("sharper", [False, True])
@given(st.integers(0, 2**32 - 1), st.integers(0, 60), st.integers(0, 60))
def test_what_is_known_is_not_added(sharper: bool, seed: int, known: int, more: int) -> None:
    """Nearly the same in time, 0.005 sampling steps, and otherwise exactly; sharpened, a tenth of that."""
    rng = np.random.default_rng(seed)
    some = ConstraintSet(step=STEP).extended(*drawn(rng, known))
    some = some.sharpened() if sharper else some
    family, component, time = drawn(rng, more)
    near = np.abs(some.time - time[:, None]) < (0.002 if sharper else 0.02)
    same = near & (some.family == family[:, None]) & (some.component == component[:, None])
    new = ~same.any(axis=1)
    extended = some.extended(family, component, time)
    assert (extended is some) == (not new.any())
    for before, added, after in zip(
        identities(some), (family, component, time), identities(extended), strict=True
    ):
        np.testing.assert_array_equal(after, np.append(before, added[new]))
    assert extended.extended(family, component, time) is extended


def test_sets_begin_empty_and_hold_families_at_all_times() -> None:
    nothing = ConstraintSet(step=STEP)
    none = np.empty(0, dtype=np.intp)
    assert len(nothing) == 0
    assert nothing.extended(none, none, np.empty(0)) is nothing
    assert nothing.needed(np.empty(0), np.empty(0)).shape == (0,)
    everywhere = nothing.at_all([0, 2], np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(everywhere.family, [0, 0, 0, 2, 2, 2])
    np.testing.assert_array_equal(everywhere.time, [1, 2, 3, 1, 2, 3])
    assert not everywhere.component.any()
    assert everywhere.at_all([2], np.array([2.0, 2.5])).time[-1] == 2.5
    assert len(nothing) == 0


@given(st.integers(0, 2**32 - 1), st.integers(51, 300))
def test_what_is_needed(seed: int, number: int) -> None:
    """What has a multiplier; of the others the worst in two sampling steps, where it is near its bound."""
    rng = np.random.default_rng(seed)
    some = ConstraintSet(step=STEP).extended(*drawn(rng, number, end=10 * STEP))
    value, multipliers = rng.uniform(-1, 0.5, number), rng.uniform(0, 1, number) * (rng.random(number) < 0.1)
    needed = some.needed(value, multipliers)
    for k in range(number):
        alike = (some.family == some.family[k]) & (some.component == some.component[k])
        alike &= some.time // (2 * STEP) == some.time[k] // (2 * STEP)
        # One with a multiplier stands for those beside it.
        worst = value[k] == value[alike].max() and not multipliers[alike].any()
        near = value[k] >= -0.5 or some.family[k] == OBJECTIVE
        assert needed[k] == (multipliers[k] > 0 or (worst and near))
    kept = some.kept(needed)
    for before, after in zip(identities(some), identities(kept), strict=True):
        np.testing.assert_array_equal(after, before[needed])


def test_small_sets_are_left_alone() -> None:
    """And those that have hardly grown since some were dropped, or since growth is counted."""
    rng = np.random.default_rng(0)

    def all_needed(some: ConstraintSet) -> bool:
        return bool(some.needed(np.full(len(some), -1.0), np.zeros(len(some))).all())

    large = ConstraintSet(step=STEP).extended(*drawn(rng, 400))
    assert not all_needed(large)
    assert all_needed(ConstraintSet(step=STEP).extended(*drawn(rng, 49)))
    assert all_needed(large.rebased())
    assert all_needed(large.kept(np.ones(400, dtype=np.bool_)))
    grown = [large.rebased().extended(*drawn(rng, more, end=1e4)) for more in (100, 160)]
    assert [all_needed(each) for each in grown] == [True, False]
