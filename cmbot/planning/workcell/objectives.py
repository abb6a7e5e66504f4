"""Objectives: functions of the wrench on the guardrail, or of the posture alone, whose peak is minimised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import CmbotError, InputError
from cmbot.elastic.first_order import DeckSway
from cmbot.elastic.sag import Sag
from cmbot.hold import Holding
from cmbot.optimization import Linearization, StateSamples
from cmbot.robot import Dynamics, Efforts, PostureBatch, Postures, Robot
from cmbot.scene import PlannerOptions

ZERO_NORM = 1e-12
"""A norm has no derivative at zero; below this share of its bound, or largest value, it is taken as flat."""

# A function is tried at this share of a step to each side, and its gradient is believed to this accuracy.
_DIFFERENCE_STEP_SHARE, _GRADIENT_TOLERANCE = 1e-5, 1e-3


def efforts_of(dynamics: Dynamics, states: StateSamples) -> Efforts:
    """Return what a motion asks of a robot: computed once, whichever functions of the states need it."""
    return states.computed(id(dynamics.robot), partial(dynamics.efforts, states.q, states.v, states.a))


class WrenchFunction(Protocol):
    """What is minimised: a function of the wrench on the guardrail, such as a plain Python function.

    It is never negative and has a gradient nearly everywhere.
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
        From O0 along the axes of W: zero for n_0, the origin of the arm's base frame for n_1.
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
        unit = moment / np.maximum(value, ZERO_NORM * value.max(initial=1.0))[:, None]
        return np.asarray(value), np.asarray(unit @ self.matrix)


class WrenchObjective:
    """A function of the wrench that the moving arm exerts on the guardrail.

    Parameters
    ----------
    robot : Robot
    function : WrenchFunction
    name, unit : str
    """

    def __init__(self, robot: Robot, function: WrenchFunction, *, name: str, unit: str) -> None:
        self._dynamics = Dynamics(robot)
        self.function = function
        self.name = name
        self.unit = unit

    @property
    def reported(self) -> bool:
        """Whether it is the norm of the torque about O0."""
        f = self.function
        return isinstance(f, WeightedMoment) and bool((f.point == 0).all() and (f.weights == 1).all())

    def at_rest(self, postures: PostureBatch) -> FloatArray:
        """Return its values (N,) at rest in N postures."""
        return self.function(postures.guardrail_wrench)[0]

    def values(self, states: StateSamples, above: float = -np.inf) -> FloatArray:
        """Return its values (N,) at N states; what is not above `above` may be given lower."""
        wrench, function = efforts_of(self._dynamics, states).guardrail_wrench, self.function
        return (function(wrench, above) if isinstance(function, Holding) else function(wrench))[0]

    def linearize(self, states: StateSamples) -> Linearization:
        """Return its values and derivatives at N states."""
        at = self._dynamics.wrench_derivatives(states.q, states.v, states.a)
        value, gradient = self.function(at.value)
        return Linearization(value, *(np.einsum("ki,kij->kj", gradient, d) for d in (at.d_q, at.d_v, at.d_a)))

    def residuals(self, states: StateSamples) -> tuple[Linearization, ...]:
        """Return the components of a moment, and of anything else its value."""
        if not isinstance(self.function, WeightedMoment):
            return (self.linearize(states),)
        A = self.function.matrix
        at = self._dynamics.wrench_derivatives(states.q, states.v, states.a)
        return tuple(
            Linearization(at.value @ row, *(np.einsum("i,kij->kj", row, d) for d in (at.d_q, at.d_v, at.d_a)))
            for row in A
        )


PostureFunction = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""A function of the posture alone: from postures (N, n), rad, to values (N,) and gradients (N, n)."""


@dataclass(frozen=True, kw_only=True)
class PostureObjective:
    """A function of the posture alone, moving or at rest.

    `value`: the same without its gradient, from postures and what it need not be exact below.
    """

    function: PostureFunction
    name: str
    unit: str
    value: Callable[[FloatArray, float], FloatArray] | None = None
    reported: bool = False

    def _value(self, q: FloatArray, above: float = -np.inf) -> FloatArray:
        return self.function(q)[0] if self.value is None else self.value(q, above)

    def at_rest(self, postures: PostureBatch) -> FloatArray:
        """Return its values (N,) in N postures."""
        return self._value(postures.q)

    def values(self, states: StateSamples, above: float = -np.inf) -> FloatArray:
        """Return its values (N,) at N states; what is not above `above` need not be exact."""
        return self._value(states.q, above)

    def linearize(self, states: StateSamples) -> Linearization:
        """Return its values and derivatives at N states."""
        return Linearization.by_position(*self.function(states.q))

    def residuals(self, states: StateSamples) -> tuple[Linearization, ...]:
        """Return its value."""
        return (self.linearize(states),)


Objective = WrenchObjective | PostureObjective
"""A quantity, never negative, whose largest value over a motion is minimised.

It has values at rest in postures and at states, derivatives, and residuals for Gauss-Newton: quantities whose
squares sum to its own, as smooth as there are.
"""


def objective_of(
    robot: Robot,
    options: PlannerOptions,
    own: WrenchFunction | None = None,
    posture: FloatArray | None = None,
    sag: Sag | None = None,
) -> Objective:
    """Return the objective that the options name, or that of a custom function.

    Parameters
    ----------
    robot : Robot
    options : PlannerOptions
    own : WrenchFunction, optional
        In place of what the options say.
    posture : (n,), rad, optional
        Where `own` is tried.
    sag : Sag, optional
        Needed for ``objective: sag`` and ``sway``.

    Raises
    ------
    InputError
        When `own` is no such function.
    """
    if own is not None:
        name = str(getattr(own, "__qualname__", None) or type(own).__qualname__)
        q = np.zeros((1, robot.dof)) if posture is None else posture[None]
        at = Postures(robot).at(q)
        checked = _CheckedFunction(own, name)
        checked.require_gradient(at.guardrail_wrench)
        # A moment is known to be fine, and its components are used.
        function = own if isinstance(own, WeightedMoment) else checked
        return WrenchObjective(robot, function, name=name, unit="")
    if options.objective in ("sag", "sway"):
        if sag is None:
            expected = f"the predicted sag, for objective: {options.objective}"
            raise InputError("objective_of", "sag", "nothing", expected)
        if options.objective == "sag":
            return PostureObjective(function=sag.length, value=sag.distance, name="sag", unit="m")
        sway = DeckSway(sag.arm)
        return PostureObjective(function=sway, value=sway.values, name="sway", unit="m")
    if options.objective == "hold":
        if robot.holding is None or not robot.holding.flat:
            raise InputError("objective_of", "robot.feet", "none on flat steel", "feet, for objective: hold")
        return WrenchObjective(robot, robot.holding, name="hold", unit="N")
    if options.objective == TRAVEL.name:
        return TRAVEL
    point = np.zeros(3)
    if options.moment_about == "base":
        model = robot.model
        base = np.array(model.frames[model.getFrameId(robot.base_frame)].placement.translation)
        point = base - np.array(robot.foot_point)
    moment = WeightedMoment(point, np.array(options.axis_weights))
    return WrenchObjective(robot, moment, name=options.objective, unit="Nm")


def _nothing(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One in all postures (N, n): what is left to minimise is the joints' travel and their jerk."""
    return np.ones(len(q)), np.zeros_like(q)


TRAVEL = PostureObjective(function=_nothing, name="travel", unit="")


class _FailuresNamed:
    """Turns whatever a custom function raises into what `refused` makes of it."""

    def __init__(self, refused: Callable[[str, str], InputError]) -> None:
        self._refused = refused

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, Exception) and not isinstance(error, CmbotError):
            got = f"{type(error).__name__}: {error}"
            raise self._refused(got, "an answer without an error") from error


class _CheckedFunction:
    """A custom function of the wrench whose every answer is checked: an `InputError` names it."""

    def __init__(self, function: WrenchFunction, name: str) -> None:
        self._function, self._name = function, name

    def __call__(self, wrench: FloatArray, /) -> tuple[FloatArray, FloatArray]:
        # The function may keep or change what it is given.
        own = wrench.copy()
        with _FailuresNamed(self._refused):
            answer = self._function(own)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise self._refused(f"a {type(answer).__name__}", "a pair: values (N,) and gradients (N, 6)")
        try:
            # Copies: the function may keep what it returns.
            value, gradient = (np.array(part, dtype=float) for part in answer)
        except (TypeError, ValueError) as error:
            raise self._refused(
                f"something else ({error})", "values and gradients that are numbers"
            ) from error
        N = len(wrench)
        if value.shape != (N,) or gradient.shape != (N, 6):
            shapes = f"shapes {value.shape} and {gradient.shape}"
            raise self._refused(shapes, f"shapes ({N},) and ({N}, 6)")
        finite = np.isfinite(value) & np.isfinite(gradient).all(axis=1)
        # A wrench that is not finite is not the function's fault.
        wrong = np.isfinite(wrench).all(axis=1) & ~(finite & (value >= 0))
        for k in np.flatnonzero(wrong)[:1]:
            at = ", ".join(f"{component:.6g}" for component in wrench[k])
            got = f"value {value[k]:.6g}, gradient {np.round(gradient[k], 6).tolist()} at the wrench ({at})"
            raise self._refused(got, "finite numbers, the value zero or more")
        return value, gradient

    def require_gradient(self, wrench: FloatArray) -> None:
        """Refuse a gradient at wrenches (N, 6) that is not the derivative of the value."""
        _, gradient = self(wrench)
        for axis in range(6):
            step = _DIFFERENCE_STEP_SHARE * max(1.0, float(np.abs(wrench[:, axis]).max()))
            shift = step * np.eye(6)[axis]
            slope = (self(wrench + shift)[0] - self(wrench - shift)[0]) / (2 * step)
            off = np.abs(slope - gradient[:, axis])
            if (off > _GRADIENT_TOLERANCE * np.maximum(np.abs(gradient).max(axis=1), 1e-9)).any():
                k = int(off.argmax())
                got = f"gradient[{axis}] = {gradient[k, axis]:.6g}"
                raise self._refused(got, f"the derivative of the value, {slope[k]:.6g}")

    def _refused(self, got: str, expected: str) -> InputError:
        return InputError(f"objective {self._name}", "", got, expected)
