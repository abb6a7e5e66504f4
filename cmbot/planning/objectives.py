"""What a plan makes small: a function of the wrench on the guardrail, or of the posture alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.elastic.sag import Sag
from cmbot.optimization import Linearization, StateSamples
from cmbot.planning.wrench_functions import WeightedMoment, WrenchFunction, check_wrench_function
from cmbot.robot import Dynamics, Efforts, PostureBatch, Postures, Robot
from cmbot.scene import PlannerOptions

__all__ = [
    "Objective",
    "PostureFunction",
    "PostureObjective",
    "WrenchObjective",
    "efforts_of",
    "objective_of",
]


def efforts_of(dynamics: Dynamics, states: StateSamples) -> Efforts:
    """Return what a motion asks of a robot: computed once, whichever functions of the states need it."""
    return states.computed(id(dynamics.robot), lambda s: dynamics.efforts(s.q, s.v, s.a))


class Objective(Protocol):
    """A quantity, never negative, whose largest value over a motion is minimised."""

    @property
    def name(self) -> str:
        """How it is called in options, files and sentences."""

    @property
    def unit(self) -> str:
        """Of its values; empty when nobody said."""

    @property
    def reported(self) -> bool:
        """Whether it is the norm of the torque on the guardrail about O0, which figures report anyway."""

    def at_rest(self, postures: PostureBatch) -> FloatArray:
        """Return its values (N,) at rest in N postures."""

    def values(self, states: StateSamples) -> FloatArray:
        """Return its values (N,) at N states."""

    def linearize(self, states: StateSamples) -> Linearization:
        """Return its values and derivatives at N states."""

    def residuals(self, states: StateSamples) -> tuple[Linearization, ...]:
        """Return quantities whose squares sum to its own, for Gauss-Newton: as smooth as there are."""


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
        return self.function(np.hstack([postures.guardrail_force, postures.guardrail_torque]))[0]

    def values(self, states: StateSamples) -> FloatArray:
        """Return its values (N,) at N states."""
        efforts = efforts_of(self._dynamics, states)
        return self.function(np.hstack([efforts.guardrail_force, efforts.guardrail_torque]))[0]

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


class PostureFunction(Protocol):
    """A function of the posture alone: values (N,) and gradients (N, n) at postures (N, n), rad."""

    def __call__(self, q: FloatArray, /) -> tuple[FloatArray, FloatArray]:
        """Evaluate it."""


@dataclass(frozen=True, kw_only=True)
class PostureObjective:
    """A function of the posture alone, moving or at rest."""

    function: PostureFunction
    name: str
    unit: str
    reported: bool = False

    def at_rest(self, postures: PostureBatch) -> FloatArray:
        """Return its values (N,) in N postures."""
        return self.function(postures.q)[0]

    def values(self, states: StateSamples) -> FloatArray:
        """Return its values (N,) at N states."""
        return self.function(states.q)[0]

    def linearize(self, states: StateSamples) -> Linearization:
        """Return its values and derivatives at N states."""
        value, gradient = self.function(states.q)
        return Linearization(value, gradient, np.zeros_like(gradient), np.zeros_like(gradient))

    def residuals(self, states: StateSamples) -> tuple[Linearization, ...]:
        """Return its value."""
        return (self.linearize(states),)


def objective_of(
    robot: Robot,
    options: PlannerOptions,
    own: WrenchFunction | None = None,
    posture: FloatArray | None = None,
    sag: Sag | None = None,
) -> Objective:
    """Return what the options ask for, or the objective of a function of someone's own.

    Parameters
    ----------
    robot : Robot
    options : PlannerOptions
    own : WrenchFunction, optional
        In place of what the options say.
    posture : (n,), rad, optional
        Where `own` is tried.
    sag : Sag, optional
        Needed for ``objective: sag``.

    Raises
    ------
    InputError
        When `own` is no such function.
    """
    if own is not None:
        name = _name_of(own)
        q = np.zeros((1, robot.dof)) if posture is None else posture[None]
        at = Postures(robot).at(q)
        check_wrench_function(own, np.hstack([at.guardrail_force, at.guardrail_torque]), name)
        return WrenchObjective(robot, own, name=name, unit="")
    if options.objective == "sag":
        if sag is None:
            raise InputError("objective_of", "sag", "nothing", "the predicted sag, for objective: sag")
        return PostureObjective(function=sag.length, name="sag", unit="m")
    point = np.zeros(3)
    if options.moment_about == "base":
        model = robot.model
        point = np.array(model.frames[model.getFrameId(robot.base_frame)].placement.translation)
    function = WeightedMoment(point, np.array(options.axis_weights))
    return WrenchObjective(robot, function, name=options.objective, unit="Nm")


def _name_of(own: WrenchFunction) -> str:
    name = getattr(own, "__qualname__", None) or type(own).__qualname__
    return str(name)
