"""Functions of the arm's state that a trajectory has to keep at or below zero, with exact derivatives.

Each has components; `values` looks at all of them on a fine grid, `linearise` at chosen ones where the
optimiser works.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.planning.path.task import ToolTask
from cmbot.robot import Dynamics, Efforts, Kinematics, Robot

__all__ = [
    "ClearanceMargin",
    "JointTorque",
    "Linearisation",
    "StateConstraint",
    "StateSamples",
    "ToolDeviation",
]


# A norm has no derivative at zero; below this share of its bound it is taken as flat.
_FLAT = 1e-12
# Directions across a leg in which the tool is held near it, its own among them.
_FACES = 8


@dataclass(frozen=True)
class StateSamples:
    """Times (N,), and positions, velocities and accelerations (N, n) of the joints there."""

    t: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray
    _efforts: list[tuple[Robot, Efforts]] = field(default_factory=list, compare=False, repr=False)

    def __getitem__(self, index: IntArray | slice) -> StateSamples:
        return StateSamples(self.t[index], self.q[index], self.v[index], self.a[index])

    def efforts(self, dynamics: Dynamics) -> Efforts:
        """Return what the motion asks of a robot: worked out once, whichever functions ask for it."""
        for robot, efforts in self._efforts:
            if robot is dynamics.robot:
                return efforts
        efforts = dynamics.efforts(self.q, self.v, self.a)
        self._efforts.append((dynamics.robot, efforts))
        return efforts


@dataclass(frozen=True)
class Linearisation:
    """Values (N,) and their derivatives (N, n) with respect to position, velocity and acceleration."""

    value: FloatArray
    d_q: FloatArray
    d_v: FloatArray
    d_a: FloatArray


class StateConstraint(Protocol):
    """A constraint ``f(q, v, a) <= 0`` with one or more components."""

    @property
    def name(self) -> str:
        """What is constrained, for messages."""

    @property
    def components(self) -> int | None:
        """Number of components; None where they are too many to look at one by one."""

    def values(self, states: StateSamples) -> tuple[FloatArray, IntArray]:
        """Return values (N, c) and what tells their components apart (N, c), at N states."""

    def linearise(self, states: StateSamples, component: IntArray) -> Linearisation:
        """Linearise component number ``component[k]`` at state k."""


@dataclass(frozen=True)
class JointTorque:
    """Joint torques within their bounds (Chang 2021, Eq. (32)); components: +1..+n, then -1..-n."""

    dynamics: Dynamics
    bound: FloatArray
    name: str = "joint torque"

    @property
    def components(self) -> int:
        """Two a joint."""
        return 2 * len(self.bound)

    def values(self, states: StateSamples) -> tuple[FloatArray, IntArray]:
        """Return tau/tau_C - 1 and -tau/tau_C - 1, (N, 2n)."""
        share = states.efforts(self.dynamics).joint_torque / self.bound
        value = np.hstack([share - 1, -share - 1])
        return value, np.broadcast_to(np.arange(value.shape[1]), value.shape)

    def linearise(self, states: StateSamples, component: IntArray) -> Linearisation:
        """Linearise one signed joint torque at each state."""
        n = len(self.bound)
        rows = self.dynamics.derivatives(states.q, states.v, states.a)
        joint, k = component % n, np.arange(len(component))
        factor = np.where(component < n, 1.0, -1.0) / self.bound[joint]
        d_q, d_v, d_a = (factor[:, None] * d[k, 3 + joint] for d in (rows.d_q, rows.d_v, rows.d_a))
        return Linearisation(factor * rows.value[k, 3 + joint] - 1, d_q, d_v, d_a)


@dataclass(frozen=True)
class ToolDeviation:
    """Distance of the tool point from the leg of its time within its bound.

    That is never less than its distance from all the legs, and unlike that has no kink at a corner.
    """

    kinematics: Kinematics
    task: ToolTask
    bound: float
    name: str = "tool deviation"
    components: int = 1

    def values(self, states: StateSamples) -> tuple[FloatArray, IntArray]:
        """Return distance/bound - 1, (N, 1)."""
        offset = self.task.path.leg_offset(states.t, self.kinematics.tool_poses(states.q)[0])
        value = np.linalg.norm(offset, axis=1, keepdims=True) / self.bound - 1
        return value, np.zeros(value.shape, dtype=np.intp)

    def linearise(self, states: StateSamples, component: IntArray) -> Linearisation:
        """Linearise the distance."""
        del component
        return self._distance(*self._offsets(states))

    def faces(self, states: StateSamples) -> tuple[Linearisation, ...]:
        """Return what never exceeds the distance, smoothly: offsets across the leg in several directions.

        To first order a distance knows no direction but its own; a step could leave the leg in any other.
        """
        return self.linearise_with_faces(states)[1:]

    def linearise_with_faces(self, states: StateSamples) -> tuple[Linearisation, ...]:
        """Return the distance, and behind it what `faces` returns."""
        offset, J = self._offsets(states)
        leg = self.task.path.leg_directions(states.t)
        across = np.cross(leg, np.eye(3)[np.abs(leg).argmin(axis=1)])
        away = offset - np.einsum("ki,ki->k", offset, leg)[:, None] * leg
        u = np.where(np.linalg.norm(away, axis=1, keepdims=True) > _FLAT, away, across)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        angle = np.arange(1, _FACES) * (2 * np.pi / _FACES)
        directions = np.cos(angle)[:, None, None] * u + np.sin(angle)[:, None, None] * np.cross(leg, u)
        value = (directions * offset).sum(axis=2) - 1
        d_q = directions.transpose(1, 0, 2) @ J / self.bound
        still = np.zeros(d_q[:, 0].shape)
        faces = (Linearisation(value[k], d_q[:, k], still, still) for k in range(len(angle)))
        return self._distance(offset, J), *faces

    def _offsets(self, states: StateSamples) -> tuple[FloatArray, FloatArray]:
        """Offsets (N, 3) from the leg, the bound as their unit, and the tool's Jacobians (N, 3, n)."""
        p_WT, J = self.kinematics.tool_point_jacobians(states.q)
        return self.task.path.leg_offset(states.t, p_WT) / self.bound, J

    def _distance(self, offset: FloatArray, J: FloatArray) -> Linearisation:
        distance = np.linalg.norm(offset, axis=1)
        d_q = np.einsum("ki,kij->kj", offset / np.maximum(distance, _FLAT)[:, None] / self.bound, J)
        return Linearisation(distance - 1, d_q, np.zeros_like(d_q), np.zeros_like(d_q))


@dataclass(frozen=True)
class ClearanceMargin:
    """Distances stay above the margin, in units of `scale`; the component is the pair that is nearest."""

    clearances: Clearances
    margin: float
    scale: float = 0.1
    name: str = "clearance"
    components: None = None

    def values(self, states: StateSamples) -> tuple[FloatArray, IntArray]:
        """Return (margin - distance)/scale of the nearest pair, (N, 1), and the pair."""
        smallest = self.clearances.smallest(states.q)
        return ((self.margin - smallest.distance) / self.scale)[:, None], smallest.pair[:, None]

    def linearise(self, states: StateSamples, component: IntArray) -> Linearisation:
        """Linearise the distance of the given pair at each state."""
        nearest = [self.clearances.nearest(q, int(pair)) for q, pair in zip(states.q, component, strict=True)]
        value = np.array([(self.margin - near.distance) / self.scale for near in nearest])
        d_q = np.array([-near.gradient / self.scale for near in nearest]).reshape(states.q.shape)
        return Linearisation(value, d_q, np.zeros_like(d_q), np.zeros_like(d_q))
