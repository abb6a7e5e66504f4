"""The nearest point that inequalities allow: by its optimality conditions, and where there is none."""

import numpy as np
import pytest

from cmbot.optimization import nearest


def problem_of(rng: np.random.Generator, unknowns: int, bounds: int) -> tuple[np.ndarray, ...]:
    """Return a point, a metric's factor, and many bounds that some point keeps."""
    factor = np.linalg.cholesky(np.cov(rng.normal(size=(unknowns, 3 * unknowns))))
    C, inside = rng.normal(size=(bounds, unknowns)), rng.normal(size=unknowns)
    return 3 * rng.normal(size=unknowns), factor, C, C @ inside + rng.uniform(0.0, 0.5, bounds)


@pytest.mark.parametrize(("unknowns", "bounds"), [(15, 1), (15, 12), (15, 60), (40, 3000)])
def test_only_active_bounds_push(rng: np.random.Generator, unknowns: int, bounds: int) -> None:
    """Bounds hold, and those that are active, alone, push the point away from the given one."""
    point, factor, C, room = problem_of(rng, unknowns, bounds)
    found = nearest(point, factor, C, room)
    left = room - C @ found
    assert left.min() > -1e-9
    active = left < 1e-8
    assert active.sum() <= unknowns
    gradient = factor @ factor.T @ (found - point)
    multipliers, *_ = np.linalg.lstsq(C[active].T, gradient, rcond=None)
    np.testing.assert_allclose(C[active].T @ multipliers, gradient, atol=1e-6 * np.linalg.norm(gradient))
    assert multipliers.max(initial=-1.0) < 1e-8
    assert active.any() or (found == point).all()


def test_what_is_impossible_is_none(rng: np.random.Generator) -> None:
    point, factor, C, room = problem_of(rng, 15, 12)
    assert nearest(point, factor, np.vstack([C, -C[:1]]), np.append(room, -room[0] - 1.0)) is None


def test_what_bounds_nothing_is_left_out(rng: np.random.Generator) -> None:
    point, factor, _, _ = problem_of(rng, 2, 0)
    np.testing.assert_array_equal(nearest(point, factor, np.empty((0, 2)), np.empty(0)), point)
    np.testing.assert_array_equal(nearest(point, factor, np.zeros((1, 2)), np.array([-1.0])), point)
    held = nearest(point, factor, np.vstack([np.zeros(2), np.eye(2)]), np.append(-1.0, point - 1.0))
    np.testing.assert_allclose(held, point - 1.0, atol=1e-9)


@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-8, 1e-9, 1e-11])
@pytest.mark.parametrize("unknowns", [3, 12, 28])
def test_bounds_that_hardly_agree(rng: np.random.Generator, unknowns: int, gap: float) -> None:
    """Pairs of opposite bounds about one point: with a gap it is found, overlapping there is none.

    Multipliers are large then, and as many bounds as there are unknowns seem not to be enough.
    """
    for _ in range(10):
        point, factor, half, _ = problem_of(rng, unknowns, 20 * unknowns)
        inside = rng.normal(size=unknowns)
        C, room = np.vstack([half, -half]), np.append(half @ inside, -half @ inside)
        found = nearest(point, factor, C, room + gap)
        assert found is not None
        assert (C @ found - room).max() < gap + 1e-9
        none = nearest(point, factor, C, room - gap)
        # What contradicts itself by less than round-off may be met to round-off.
        assert none is None or (C @ none - room).max() < 1e-4
