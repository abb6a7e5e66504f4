"""The smallest change: against its optimality conditions, and where there is none."""

import numpy as np
import pytest
from scipy import optimize

from cmbot.optimization.least_distance import _ALIKE, least_distance


def problem_of(rng: np.random.Generator, unknowns: int, bounds: int) -> tuple[np.ndarray, ...]:
    """Return three equations and many bounds that some change keeps."""
    E, C = rng.normal(size=(3, unknowns)), rng.normal(size=(bounds, unknowns))
    inside = rng.normal(size=unknowns)
    return E, E @ inside, C, C @ inside + rng.uniform(0.0, 0.5, bounds)


@pytest.mark.parametrize("bounds", [0, 1, 12, 60])
def test_agrees_with_another_method(rng: np.random.Generator, bounds: int) -> None:
    """What softens the equations is an unknown as the others."""
    E, amounts, C, room = problem_of(rng, 15, bounds)
    found = least_distance(E, amounts, C, room)
    assert found.share == 1.0
    A = np.hstack([E, np.diag(np.sqrt(_ALIKE) * np.linalg.norm(E, axis=1))])
    D = np.pad(C, ((0, 0), (0, 3)))
    reference = optimize.minimize(
        lambda x: 0.5 * x @ x,
        np.zeros(18),
        jac=lambda x: x,
        method="SLSQP",
        constraints=[
            {"type": "eq", "fun": lambda x: A @ x - amounts, "jac": lambda _: A},
            {"type": "ineq", "fun": lambda x: room - D @ x, "jac": lambda _: -D},
        ],
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert reference.success
    np.testing.assert_allclose(found.x, reference.x[:15], atol=1e-6 * np.linalg.norm(found.x))


def test_thousands_of_bounds_on_few_unknowns(rng: np.random.Generator) -> None:
    """Bounds hold, and what is active pushes the change, alone, away from the least change."""
    E, amounts, C, room = problem_of(rng, 40, 3000)
    found = least_distance(E, amounts, C, room)
    left = room - C @ found.x
    assert left.min() > -1e-9
    active = left < 1e-8
    assert 0 < active.sum() <= 40
    np.testing.assert_allclose(E @ found.x, amounts, rtol=1e-3, atol=1e-3)
    rows = np.vstack([E, C[active]])
    multipliers, *_ = np.linalg.lstsq(rows.T, found.x, rcond=None)
    np.testing.assert_allclose(rows.T @ multipliers, found.x, atol=1e-6 * np.linalg.norm(found.x))
    assert multipliers[3:].max() < 1e-8


def test_equations_that_are_the_same_share_their_multiplier(rng: np.random.Generator) -> None:
    E, amounts, C, room = problem_of(rng, 15, 12)
    twice = least_distance(np.vstack([E, E]), np.tile(amounts, 2), C, room)
    once = least_distance(E, amounts, C, room)
    np.testing.assert_allclose(twice.x, once.x, atol=1e-3 * np.linalg.norm(once.x))


def test_the_share_that_the_bounds_leave(rng: np.random.Generator) -> None:
    E = rng.normal(size=(1, 6))
    found = least_distance(E, np.array([2.0]), E, np.array([0.5]))
    assert found.share == pytest.approx(0.25, abs=1e-3)
    assert float((E @ found.x)[0]) == pytest.approx(0.5, abs=1e-6)


def test_contradictions_end(rng: np.random.Generator) -> None:
    E, amounts, C, room = problem_of(rng, 20, 2000)
    assert least_distance(E, amounts, np.vstack([C, -C[:1]]), np.append(room, -room[0] - 1.0)) is None


def test_what_no_unknown_changes() -> None:
    E = np.array([[1.0, 0.0], [0.0, 0.0]])
    assert least_distance(E, np.ones(2), np.empty((0, 2)), np.empty(0)) is None
    kept = least_distance(E[:1], np.ones(1), np.zeros((1, 2)), np.array([-1.0]))
    np.testing.assert_allclose(kept.x, [1.0, 0.0], atol=1e-4)


def test_too_many_steps_are_no_change(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    full = optimize.nnls
    monkeypatch.setattr(optimize, "nnls", lambda A, b, maxiter: full(A, b, maxiter=min(maxiter, 1)))
    E, amounts, C, room = problem_of(rng, 15, 300)
    assert least_distance(E, amounts, C, room) is None


def test_nothing_to_change_and_no_room(rng: np.random.Generator) -> None:
    C = rng.normal(size=(1, 6))
    still = least_distance(C, np.zeros(1), np.vstack([C, -C]), np.zeros(2))
    np.testing.assert_allclose(still.x, 0.0, atol=1e-12)
    assert least_distance(C, np.zeros(1), np.vstack([C, -C]), np.array([1.0, -2.0])) is None
