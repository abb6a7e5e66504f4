"""Windows in which splines are changed: small however long the path, and quiet at their ends."""

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from cmbot.planning.flexibility.vibration_suppression import Window, legs_by_window
from cmbot.trajectory.quintic import QuinticTrajectory
from cmbot.trajectory.spline_space import SplineSpace


def spaced(segments: int) -> SplineSpace:
    return SplineSpace(np.linspace(0.0, 0.4 * segments, segments + 1))


def torque_problem(segments: int) -> Any:
    robot = SimpleNamespace(limits=SimpleNamespace(jerk=np.array([1.0, 2.0])))
    return SimpleNamespace(space=spaced(segments), context=SimpleNamespace(robot=robot))


@pytest.mark.parametrize("legs", [10, 40, 160])
def test_windows_do_not_grow_with_the_path(legs: int) -> None:
    lengths = np.tile([25, 5], legs // 2)
    knots = np.append(0, np.cumsum(lengths))
    problem = torque_problem(int(knots[-1]))
    windows = legs_by_window(problem.space, problem.space.t[knots])
    assert [leg for window in windows for leg in window] == list(pairwise(knots))
    numbers = [Window(problem, window).coefficients for window in windows]
    assert max(map(len, numbers)) <= 64 + 12
    for window, own in zip(windows, numbers, strict=True):
        assert own.min() >= window[0][0]
        assert own.max() + 4 <= window[-1][1]


def test_a_long_leg_is_changed_near_its_end() -> None:
    problem = torque_problem(1000)
    (window,) = legs_by_window(problem.space, np.array([0.0, 400.0]))
    np.testing.assert_array_equal(Window(problem, window).coefficients, np.arange(936, 997))


def test_short_legs_find_company() -> None:
    space = spaced(140)
    assert legs_by_window(space, space.t[[0, 3, 70, 135, 140]]) == [
        [(0, 3), (3, 70)],
        [(70, 135), (135, 140)],
    ]


def test_a_window_takes_its_vibration_away(rng: np.random.Generator) -> None:
    """With the least jerk, and within bounds: against the normal equations of all its numbers."""
    problem = torque_problem(20)
    space, d = problem.space, 2
    z = rng.normal(size=(3 * len(space.t), d))
    times = np.linspace(0.01, space.t[-1] - 0.01, 200)
    weights = rng.normal(size=(len(times), 2, d))

    def vibration(of: QuinticTrajectory) -> np.ndarray:
        return np.asarray(np.einsum("kcj,kj->c", weights, of.evaluate(times, 4)))

    leg: Any = SimpleNamespace(times=times, weights=weights, vibration=vibration)
    window = Window(problem, [(0, 20)])
    window.bring_to_rest(leg, space.trajectory(z))
    middle = sparse.csr_array(
        sparse.kron(space.design(space.t[[10]] + 0.1, 0) @ space.basis, np.array([[1.0, 0.0]]))
    )
    free = window.change(middle, np.array([np.inf]))
    moved = float((middle @ free.x.ravel())[0])
    held = window.change(middle * np.sign(moved), np.array([0.5 * abs(moved)]))

    def jerk(X: np.ndarray) -> float:
        shares = space.basis @ X / problem.context.robot.limits.jerk
        return float(np.trace(space.jerk_product(shares, shares)))

    before = vibration(space.trajectory(z))
    for found in (free, held):
        after = vibration(space.trajectory(z + space.basis @ found.x))
        assert np.abs(after).max() < 1e-3 * np.abs(before).max()
    assert float((middle @ held.x.ravel())[0]) == pytest.approx(0.5 * moved, rel=1e-6)
    assert jerk(free.x) < jerk(held.x)
