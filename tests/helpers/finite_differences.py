"""One checker for every derivative of the package."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from cmbot.common.arrays import FloatArray
from cmbot.optimization.program import Linearization, StateSamples


def finite_difference(
    function: Callable[[FloatArray], ArrayLike], x: FloatArray, step: float = 1e-3
) -> FloatArray:
    """Derivative of `function` at `x` (n,), shape (*value, n): fourth-order central (one Richardson step).

    Truncation is f'''''(x) step^4 / 480, rounding about 3 eps |f| / step. For the sines and cosines of a
    robot (angles in rad) the default step of 1e-3 puts both near 1e-12 of the function's scale.
    """
    columns = []
    for i in range(len(x)):
        shift = np.zeros(len(x))
        shift[i] = step
        wide = np.asarray(function(x + shift)) - np.asarray(function(x - shift))
        narrow = np.asarray(function(x + shift / 2)) - np.asarray(function(x - shift / 2))
        columns.append((8 * narrow - wide) / (6 * step))
    return np.stack(columns, axis=-1)


def check_derivative(
    function: Callable[[FloatArray], ArrayLike],
    x: ArrayLike,
    jacobian: ArrayLike,
    *,
    step: float = 1e-3,
    rtol: float = 1e-8,
    atol: float = 0.0,
) -> None:
    """Assert that `jacobian` (*value, n) is the derivative of `function` at `x` (n,).

    `rtol` is the largest error as a share of the Jacobian's largest entry, `atol` on top of it, in its unit:
    needed only where the derivative may be zero.
    """
    x = np.asarray(x, dtype=float)
    expected = finite_difference(function, x, step)
    got = np.asarray(jacobian, dtype=float)
    assert got.shape == expected.shape, f"shape {got.shape}, expected {expected.shape}"
    error = np.abs(got - expected)
    allowed = rtol * np.abs(expected).max(initial=0.0) + atol
    worst = np.unravel_index(np.argmax(np.where(np.isnan(error), np.inf, error)), error.shape)
    # Written so that NaN fails.
    assert error.max(initial=0.0) <= allowed, (
        f"entry {tuple(map(int, worst))}: got {got[worst]:.12g}, finite difference {expected[worst]:.12g}, "
        f"error {error[worst]:.3g} > {allowed:.3g}"
    )


def check_curvature(
    function: Callable[[FloatArray], float],
    hessian: Any,
    directions: FloatArray,
    *,
    step: float,
    rtol: float,
    atol: float = 0.0,
) -> None:
    """Assert that `hessian` (n, n) is that of `function` at zero, along each of `directions` (K, n).

    By differences of fourth order; `atol` is in the Hessian's unit.
    """
    for d in directions:
        near, far = (function(k * step * d) + function(-k * step * d) - 2 * function(0 * d) for k in (1, 2))
        expected = (16 * near - far) / (12 * step**2)
        assert d @ (hessian @ d) == pytest.approx(expected, rel=rtol, abs=atol * d @ d)


def check_state_derivatives(
    values: Callable[[StateSamples], FloatArray], states: StateSamples, got: Linearization, **accuracy: float
) -> None:
    """Assert that `got` holds the derivatives of a function of the state (N,) by each state's q, v and a."""
    for k, t in enumerate(states.t):
        for name, derivative in zip("qva", got.derivatives[:, k], strict=True):

            def value(x: FloatArray, k: int = k, t: float = t, name: str = name) -> float:
                changed = {"q": states.q[k], "v": states.v[k], "a": states.a[k]} | {name: x}
                at = StateSamples(np.array([t]), *(y[None] for y in changed.values()))
                return float(values(at)[0])

            check_derivative(value, getattr(states, name)[k], derivative, **accuracy)
