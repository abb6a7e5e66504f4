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
