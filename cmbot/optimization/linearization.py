"""What the constraints of a working set are, and how they change, where a trajectory passes their sites."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.optimization.working_set import WorkingSet, signed_bound
from cmbot.planning.torque.constraints import Linearisation, StateConstraint, StateSamples, ToolDeviation
from cmbot.planning.torque.problem import KinematicBound
from cmbot.trajectory.local_basis import LocalRows, SparseSplines
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["SiteValues", "Sites", "site_values"]

# Position, velocity, acceleration and jerk.
_ORDERS = (0, 1, 2, 3)

_Kind = StateConstraint | KinematicBound


class Sites:
    """The sites of a working set as they are now: of K constraints, kind after kind.

    Parameters
    ----------
    working : WorkingSet
    splines : SparseSplines

    Attributes
    ----------
    kinds : tuple of StateConstraint or KinematicBound
    times, component : tuple of (K_k,)
        Of each kind.
    sizes : tuple of int
        The numbers K_k.
    torques : int
        Number of the first kind: what is made small.
    """

    def __init__(self, working: WorkingSet, splines: SparseSplines) -> None:
        every: list[tuple[_Kind, FloatArray, IntArray]] = [*working.state_sites(), *working.bound_sites()]
        self._splines = splines
        self.kinds = tuple(kind for kind, _, _ in every)
        self.times = tuple(times for _, times, _ in every)
        self.component = tuple(component for _, _, component in every)
        self.sizes = tuple(len(times) for times in self.times)
        self.torques = self.sizes[0]

    @cached_property
    def kind(self) -> IntArray:
        """Number of each constraint's kind, (K,)."""
        return np.repeat(np.arange(len(self.sizes)), self.sizes)

    @cached_property
    def rows(self) -> LocalRows:
        """The splines there, K of them."""
        return self._splines.rows(np.concatenate(self.times))

    @cached_property
    def faced(self) -> IntArray:
        """Which of the constraints, (T,), have faces: see `ToolDeviation.faces`."""
        deviation = [isinstance(kind, ToolDeviation) for kind in self.kinds]
        return np.flatnonzero(np.repeat(deviation, self.sizes))


@dataclass(frozen=True, kw_only=True)
class SiteValues:
    """Constraints at their sites, kind after kind, along one trajectory.

    Attributes
    ----------
    sites : Sites
    value : tuple of (K_k,)
    derivative : tuple of (4, K_k, d)
        By position, velocity, acceleration and jerk.
    face_value : (F, T)
    face_derivative : (F, T, d)
        Of the faces by position.
    """

    sites: Sites
    value: tuple[FloatArray, ...]
    derivative: tuple[FloatArray, ...]
    face_value: FloatArray
    face_derivative: FloatArray

    @cached_property
    def all_values(self) -> FloatArray:
        """Values (K,)."""
        return np.concatenate(self.value)

    @cached_property
    def all_derivatives(self) -> FloatArray:
        """Derivatives (4, K, d)."""
        return np.concatenate(self.derivative, axis=1)

    def kept(self, which: BoolArray, sites: Sites) -> SiteValues:
        """Return those of the K constraints that are left in `sites`."""
        parts = np.split(which, np.cumsum(self.sites.sizes)[:-1])
        faced = which[self.sites.faced]
        return SiteValues(
            sites=sites,
            value=tuple(value[part] for value, part in zip(self.value, parts, strict=True)),
            derivative=tuple(d[:, part] for d, part in zip(self.derivative, parts, strict=True)),
            face_value=self.face_value[:, faced],
            face_derivative=self.face_derivative[:, faced],
        )


def site_values(sites: Sites, trajectory: QuinticTrajectory, before: SiteValues | None = None) -> SiteValues:
    """Evaluate constraints where a trajectory passes their sites.

    Parameters
    ----------
    sites : Sites
    trajectory : QuinticTrajectory
    before : SiteValues, optional
        Of the same trajectory at fewer of the sites, the first ones of each kind: not evaluated again.
    """
    known = (0,) * len(sites.sizes) if before is None else before.sites.sizes
    new = [times[first:] for times, first in zip(sites.times, known, strict=True)]
    ends = np.cumsum([len(times) for times in new])
    orders = trajectory.derivatives(np.concatenate(new), _ORDERS)
    values: list[FloatArray] = []
    derivatives: list[FloatArray] = []
    faces: tuple[Linearisation, ...] = ()
    for number, kind in enumerate(sites.kinds):
        if before is not None and len(new[number]) == 0:
            values.append(before.value[number])
            derivatives.append(before.derivative[number])
            continue
        here = slice(ends[number] - len(new[number]), ends[number])
        at = tuple(order[here] for order in orders)
        component = sites.component[number][known[number] :]
        if isinstance(kind, KinematicBound):
            value, derivative = _bound(kind, at, component)
        else:
            states = StateSamples(new[number], at[0], at[1], at[2])
            function, *more = _linearised(kind, states, component)
            faces = (*faces, *more)
            value = function.value
            derivative = np.stack([function.d_q, function.d_v, function.d_a, np.zeros(function.d_q.shape)])
        if before is not None:
            value = np.append(before.value[number], value)
            derivative = np.concatenate([before.derivative[number], derivative], axis=1)
        values.append(value)
        derivatives.append(derivative)
    face_value, face_derivative = _faces(faces, before)
    return SiteValues(
        sites=sites,
        value=tuple(values),
        derivative=tuple(derivatives),
        face_value=face_value,
        face_derivative=face_derivative,
    )


def _bound(
    bound: KinematicBound, at: tuple[FloatArray, ...], component: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Values (N,) and derivatives (4, N, d) of a joint's bound."""
    value, joint, factor = signed_bound(bound, at[bound.order], component)
    derivative = np.zeros((len(at), *at[0].shape))
    derivative[bound.order, np.arange(len(joint)), joint] = factor
    return value, derivative


def _faces(faces: tuple[Linearisation, ...], before: SiteValues | None) -> tuple[FloatArray, FloatArray]:
    """Values (F, T) and derivatives (F, T, d), those that were there before first."""
    if before is not None and not faces:
        return before.face_value, before.face_derivative
    value = np.stack([face.value for face in faces])
    derivative = np.stack([face.d_q for face in faces])
    if before is None:
        return value, derivative
    return (
        np.concatenate([before.face_value, value], axis=1),
        np.concatenate([before.face_derivative, derivative], axis=1),
    )


def _linearised(
    function: StateConstraint, states: StateSamples, component: IntArray
) -> tuple[Linearisation, ...]:
    """Linearise a function, and behind it its faces if it has some."""
    if isinstance(function, ToolDeviation):
        return function.linearise_with_faces(states)
    return (function.linearise(states, component),)
