"""Functions of the wrench on the guardrail that may be made small: the weighted moment, and anyone's own."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError

__all__ = ["WeightedMoment", "WrenchFunction", "check_wrench_function"]

# A norm has no derivative at zero; below this share of its largest value it is taken as flat.
_FLAT = 1e-12
# A function is tried at this share of a step to each side, and its gradient is believed to this accuracy.
_STEP, _GRADIENT_TOLERANCE = 1e-5, 1e-3


class WrenchFunction(Protocol):
    """What is to be small all along a motion, as a function of the wrench on the guardrail.

    It is never negative and has a gradient nearly everywhere; a plain Python function will do.
    """

    def __call__(self, wrench: FloatArray, /) -> tuple[FloatArray, FloatArray]:
        """Evaluate it.

        Parameters
        ----------
        wrench : (N, 6), N and Nm
            Force and torque that the arm exerts on the guardrail, about O0, in W.

        Returns
        -------
        value : (N,)
        gradient : (N, 6)
        """


class WeightedMoment:
    """Norm of the moment about a point, its components weighted: Chang 2021, Eq. (12), by default.

    Parameters
    ----------
    point : (3,), m
        In W: O0 for n_0, the origin of the arm's base frame for n_1.
    weights : (3,)
        Of the components along x, y and z of W; none negative, one at least positive.
    """

    def __init__(self, point: FloatArray, weights: FloatArray) -> None:
        if np.min(weights) < 0 or np.max(weights) <= 0 or not np.isfinite([*point, *weights]).all():
            got = f"point {np.asarray(point).tolist()}, weights {np.asarray(weights).tolist()}"
            raise InputError("WeightedMoment", "", got, "finite numbers, no weight negative, one positive")
        self.point = np.asarray(point, dtype=float)
        self.weights = np.asarray(weights, dtype=float)
        # The moment about another point is n_0 - p x f.
        x, y, z = self.point
        lever = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        self.matrix = self.weights[:, None] * np.hstack([lever, np.eye(3)])
        """Takes a wrench to the weighted components, (3, 6)."""

    def __call__(self, wrench: FloatArray, /) -> tuple[FloatArray, FloatArray]:
        """Return the norms (N,), Nm, and their gradients (N, 6)."""
        moment = wrench @ self.matrix.T
        value = np.linalg.norm(moment, axis=1)
        unit = moment / np.maximum(value, _FLAT * value.max(initial=1.0))[:, None]
        return np.asarray(value), np.asarray(unit @ self.matrix)


def check_wrench_function(function: WrenchFunction, wrench: FloatArray, name: str) -> None:
    """Try a function of someone's own before a plan leans on it.

    Parameters
    ----------
    function : WrenchFunction
    wrench : (N, 6)
        Where it is tried.
    name : str
        For the message.

    Raises
    ------
    InputError
        When its value or gradient has another shape, is not finite or negative, or when the gradient is not
        the derivative of the value.
    """

    def refuse(got: object, expected: str) -> InputError:
        return InputError(f"objective {name}", "", got, expected)

    answer = function(wrench)
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise refuse(f"a {type(answer).__name__}", "a pair: values (N,) and gradients (N, 6)")
    value, gradient = (np.asarray(part, dtype=float) for part in answer)
    N = len(wrench)
    if value.shape != (N,) or gradient.shape != (N, 6):
        raise refuse(f"shapes {value.shape} and {gradient.shape}", f"shapes ({N},) and ({N}, 6)")
    if not (np.isfinite(value).all() and np.isfinite(gradient).all() and (value >= 0).all()):
        raise refuse("values that are negative or not finite", "finite values of zero or more")
    for axis in range(6):
        step = _STEP * max(1.0, float(np.abs(wrench[:, axis]).max()))
        shift = step * np.eye(6)[axis]
        slope = (np.asarray(function(wrench + shift)[0]) - np.asarray(function(wrench - shift)[0])) / (
            2 * step
        )
        off = np.abs(slope - gradient[:, axis])
        if (off > _GRADIENT_TOLERANCE * np.maximum(np.abs(gradient).max(axis=1), 1e-9)).any():
            k = int(off.argmax())
            raise refuse(
                f"gradient[{axis}] = {gradient[k, axis]:.6g}", f"the derivative of the value, {slope[k]:.6g}"
            )
