"""The nearest point that inequalities allow: by its optimality conditions, and where there is none."""

import numpy as np
import pytest
from scipy.optimize import nnls

from cmbot.optimization import least_distance, nearest


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


def test_nonnegative_least_squares_are_those_of_scipy(rng: np.random.Generator) -> None:
    """Also where columns are the same, numbers are whole, so that steps end at several bounds at once."""
    for number in range(300):
        rows, columns = rng.integers(1, 30, 2)
        A, b = rng.normal(size=(rows, columns)), rng.normal(size=rows)
        if number % 3 == 0:
            A[:, columns // 2 :] = A[:, : columns - columns // 2]
        if number % 5 == 0:
            A = A.round()
        if number % 7 == 0:
            b = -np.abs(A).sum(axis=1)
        u = least_distance._nonnegative_least_squares(A, b)
        assert u is not None and u.min() >= 0
        assert np.linalg.norm(A @ u - b) == pytest.approx(nnls(A, b)[1], rel=1e-9, abs=1e-9)
