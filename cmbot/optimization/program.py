"""Semi-infinite programs over splines: what is minimised, what holds at all times, as data.

A program has an objective f(t) >= 0 of the joints' state, whose peak and mean square are minimised, functions
of the state that may not exceed zero at any time, and bounds on the derivatives of the splines. It knows
nothing of solvers.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Protocol, Self, TypeVar, cast

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.limit import Limit
from cmbot.trajectory import Parametrization, QuinticTrajectory

Computed = TypeVar("Computed")
_ALL_UNKNOWNS = slice(None)


@dataclass(frozen=True, eq=False)
class StateSamples:
    """Times (N,), and positions, velocities and accelerations (N, n) of the joints there."""

    t: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray
    _computed: dict[Hashable, object] = field(default_factory=dict, compare=False, repr=False)

    @staticmethod
    def along(trajectory: QuinticTrajectory, times: FloatArray) -> StateSamples:
        """Return a trajectory's states at `times` (N,)."""
        return StateSamples(times, *trajectory.states(times))

    @staticmethod
    def even(trajectory: QuinticTrajectory, samples: int) -> StateSamples:
        """Return a trajectory's states at so many even times of every segment, and at its end."""
        t = trajectory.t
        inner = np.linspace(t[:-1], t[1:], samples, endpoint=False, axis=1)
        return StateSamples(np.append(inner.ravel(), t[-1]), *trajectory.sampled(samples))

    @staticmethod
    def at_rest(t: FloatArray, q: FloatArray) -> StateSamples:
        """Return postures `q` (N, n) without any motion."""
        return StateSamples(t, q, np.zeros_like(q), np.zeros_like(q))

    def __getitem__(self, index: IntArray | slice) -> StateSamples:
        return StateSamples(self.t[index], self.q[index], self.v[index], self.a[index])

    def computed(self, key: Hashable, compute: Callable[[], Computed]) -> Computed:
        """Return what `compute` makes of these states; functions that share a key share the result."""
        if key not in self._computed:
            self._computed[key] = compute()
        return cast(Computed, self._computed[key])


@dataclass(frozen=True, eq=False)
class Linearization:
    """Values (N,) and their derivatives (N, n) by position, velocity and acceleration.

    `cuts` are linearizations of functions that never exceed this one, but reach what it overlooks to first
    order: a distance has no derivative across its own direction.
    """

    value: FloatArray
    d_q: FloatArray
    d_v: FloatArray
    d_a: FloatArray
    cuts: tuple[Linearization, ...] = ()

    @classmethod
    def by_position(cls, value: FloatArray, d_q: FloatArray, cuts: tuple[Self, ...] = ()) -> Self:
        """Return that of a function of the position alone."""
        return cls(value, d_q, np.zeros_like(d_q), np.zeros_like(d_q), cuts)

    def scaled(self, factor: FloatArray | float) -> Linearization:
        """Return it times `factor`, a number or (N,)."""
        column = np.reshape(factor, (-1, 1))
        return Linearization(factor * self.value, column * self.d_q, column * self.d_v, column * self.d_a)

    @property
    def derivatives(self) -> FloatArray:
        """Derivatives (3, N, n)."""
        return np.stack([self.d_q, self.d_v, self.d_a])


class StateFunction(Protocol):
    """A function of the state with one or more components; as a constraint it may not exceed zero."""

    @property
    def name(self) -> str:
        """What it is, for messages."""

    @property
    def limit(self) -> Limit:
        """What it limits."""

    @property
    def components(self) -> int | None:
        """Number of components; None where they are not counted one by one."""

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return values (N, c) and what identifies their components (N, c), at N states.

        A value that certainly lies below `threshold` may be given lower; as minus infinity only where its
        neighbours in time lie below, too.
        """

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize component number ``component[k]`` at state k."""


@dataclass(frozen=True, eq=False)
class KinematicBound:
    """``low <= derivative of the joint's position <= high`` at all times (Chang 2021, Eq. (31)).

    Component 2 j is the upper bound of joint j, 2 j + 1 the lower one; values are shares of `scale`.
    """

    order: int
    low: FloatArray
    high: FloatArray
    scale: FloatArray
    name: str

    @property
    def limit(self) -> Limit:
        """What is bounded, by the order of the derivative."""
        return (Limit.POSITION, Limit.VELOCITY, Limit.ACCELERATION, Limit.JERK)[self.order]

    def above(self, value: FloatArray, joint: IntArray | slice = _ALL_UNKNOWNS) -> FloatArray:
        """How far values (..., n), or those of some joints, exceed the upper bound, as shares."""
        return np.asarray((value - self.high[joint]) / self.scale[joint])

    def below(self, value: FloatArray, joint: IntArray | slice = _ALL_UNKNOWNS) -> FloatArray:
        """How far values (..., n), or those of some joints, fall short of the lower bound, as shares."""
        return np.asarray((self.low[joint] - value) / self.scale[joint])

    def values(self, derivative: FloatArray, component: IntArray) -> tuple[FloatArray, FloatArray]:
        """Values (N,) of some components, and their slopes (N, n), from the bounded derivative (N, n)."""
        joint, upper, row = component // 2, component % 2 == 0, np.arange(len(component))
        own = derivative[row, joint]
        slope = np.zeros(derivative.shape)
        slope[row, joint] = np.where(upper, 1.0, -1.0) / self.scale[joint]
        return np.where(upper, self.above(own, joint), self.below(own, joint)), slope


class Program(Protocol):
    """``min max_t f(t)`` or ``min mean_t f(t)^2`` over C3 splines, subject to constraints at all times.

    All its numbers are dimensionless: f is counted in units of `scale`.
    """

    @property
    def parametrization(self) -> Parametrization:
        """Splines around the initial guess."""

    @property
    def objective(self) -> StateFunction:
        """f, with one component."""

    @property
    def constraints(self) -> tuple[StateFunction, ...]:
        """Functions that may not exceed zero."""

    @property
    def bounds(self) -> tuple[KinematicBound, ...]:
        """Bounds on the splines' derivatives."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""

    @property
    def scale(self) -> float:
        """Unit of f."""

    @property
    def samples_per_segment(self) -> int:
        """Even times of every segment at which functions of the state are sampled."""

    @property
    def lower_bound(self) -> float:
        """What the peak of f cannot fall below, but for what motion takes off; 0 where nothing is known."""

    def mean_residuals(self, trajectory: QuinticTrajectory) -> tuple[Linearization, ...]:
        """Return weighted parts of f at `mean_times`: their squares sum to the time mean of f^2."""

    @property
    def mean_times(self) -> FloatArray:
        """Quadrature points (G,) of the time mean."""
