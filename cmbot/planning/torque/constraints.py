"""Functions of the arm's state that a trajectory has to keep at or below zero, with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cmbot.collision import Clearances, raise_bounds, travel
from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.optimization import Linearization, StateSamples
from cmbot.planning.objectives import efforts_of
from cmbot.planning.task import ToolTask
from cmbot.robot import Dynamics, Postures, ToolBatch

__all__ = ["ClearanceMargin", "JointTorque", "ToolDeviation", "ToolLag", "ToolRotation"]

# A norm has no derivative at zero; below this share of its bound it is taken as flat.
_FLAT = 1e-12
# Directions across a leg in which the tool is held near it, its own among them.
_DIRECTIONS = 8
# Samples from one measured clearance to the next, from coarse to fine.
_STRIDES = (16, 4, 1)


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

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return tau/tau_C - 1 and -tau/tau_C - 1, (N, 2n)."""
        share = efforts_of(self.dynamics, states).joint_torque / self.bound
        value = np.hstack([share - 1, -share - 1])
        return value, np.broadcast_to(np.arange(value.shape[1]), value.shape)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize one signed joint torque at each state."""
        n = len(self.bound)
        rows = self.dynamics.derivatives(states.q, states.v, states.a)
        joint, k = component % n, np.arange(len(component))
        factor = np.where(component < n, 1.0, -1.0) / self.bound[joint]
        d_q, d_v, d_a = (factor[:, None] * d[k, 3 + joint] for d in (rows.d_q, rows.d_v, rows.d_a))
        return Linearization(factor * rows.value[k, 3 + joint] - 1, d_q, d_v, d_a)


@dataclass(frozen=True)
class ToolDeviation:
    """Distance of the tool point from the leg of its time within its bound.

    That is never less than its distance from all the legs, and unlike that has no kink at a corner.
    """

    postures: Postures
    task: ToolTask
    bound: float
    name: str = "tool deviation"
    components: int = 1

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return distance/bound - 1, (N, 1)."""
        offset = self.task.path.leg_offset(states.t, _tool(self.postures, states).tool_point)
        value = np.linalg.norm(offset, axis=1, keepdims=True) / self.bound - 1
        return value, np.zeros(value.shape, dtype=np.intp)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the distance; its cuts are offsets across the leg in several directions.

        To first order a distance knows no direction but its own; a step could leave the leg in any other.
        """
        tool = _tool(self.postures, states)
        J = tool.jacobian[:, :3]
        offset = self.task.path.leg_offset(states.t, tool.tool_point) / self.bound
        distance = np.linalg.norm(offset, axis=1)
        d_q = np.einsum("ki,kij->kj", offset / np.maximum(distance, _FLAT)[:, None] / self.bound, J)
        still = np.zeros_like(d_q)
        leg = self.task.path.leg_directions(states.t)
        across = np.cross(leg, np.eye(3)[np.abs(leg).argmin(axis=1)])
        away = offset - np.einsum("ki,ki->k", offset, leg)[:, None] * leg
        u = np.where(np.linalg.norm(away, axis=1, keepdims=True) > _FLAT, away, across)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        angle = np.arange(1, _DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
        directions = np.cos(angle)[:, None, None] * u + np.sin(angle)[:, None, None] * np.cross(leg, u)
        value = (directions * offset).sum(axis=2) - 1
        by_q = directions.transpose(1, 0, 2) @ J / self.bound
        cuts = (Linearization(value[k], by_q[:, k], still, still) for k in range(len(angle)))
        return Linearization(distance - 1, d_q, still, still, tuple(cuts))


@dataclass(frozen=True)
class ToolLag:
    """Distance of the tool point along the leg from its timed place within its bound; ahead, then behind."""

    postures: Postures
    task: ToolTask
    bound: float
    name: str = "tool lag"
    components: int = 2

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return +lag/bound - 1 and -lag/bound - 1, (N, 2)."""
        path = self.task.path
        away = _tool(self.postures, states).tool_point - path.position(states.t)
        share = np.einsum("ki,ki->k", away, path.leg_directions(states.t))[:, None] / self.bound
        value = np.hstack([share - 1, -share - 1])
        return value, np.broadcast_to(np.arange(2), value.shape)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the lag of one sign at each state."""
        k, sign = np.arange(len(component)), np.where(component == 0, 1.0, -1.0)
        by_point = (sign / self.bound)[:, None] * self.task.path.leg_directions(states.t)
        d_q = np.einsum("ki,kij->kj", by_point, _tool(self.postures, states).jacobian[:, :3])
        return Linearization(
            self.sample(states)[0][k, component], d_q, np.zeros_like(d_q), np.zeros_like(d_q)
        )


@dataclass(frozen=True)
class ToolRotation:
    """Angle by which the tool misses its prescribed orientation or axis within its bound."""

    postures: Postures
    task: ToolTask
    bound: float
    name: str = "tool rotation"
    components: int = 1

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return angle/bound - 1, (N, 1)."""
        value = self.task.rotation(_tool(self.postures, states).tool_rotation)[:, None] / self.bound - 1
        return value, np.zeros(value.shape, dtype=np.intp)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the angle."""
        tool, task = _tool(self.postures, states), self.task
        turn = task.errors(tool.tool_point, tool.tool_rotation, tool.tool_point)[:, 3:] / self.bound
        # The errors lead to the goal: they fall as the tool turns towards it.
        J = -task.jacobian(tool.tool_rotation, tool.jacobian)[:, 3:] / self.bound
        angle = np.linalg.norm(turn, axis=1)
        d_q = np.einsum("ki,kij->kj", turn / np.maximum(angle, _FLAT)[:, None], J)
        still = np.zeros_like(d_q)
        return Linearization(angle - 1, d_q, still, still)


def _tool(postures: Postures, states: StateSamples) -> ToolBatch:
    """The tool at the states: computed once, whichever constraints need it."""
    return states.computed(id(postures), lambda s: postures.tool_at(s.q))


@dataclass
class _Memory:
    """Postures (N, n), and what the smallest distance is not below in them (N,)."""

    q: FloatArray
    at_least: FloatArray


@dataclass(frozen=True)
class ClearanceMargin:
    """Distances stay above the margin, in units of `scale`; the component is the pair that is nearest.

    No distance changes faster than the joints move times their reach. So what was measured bounds what is
    near it in time, and what was measured along one trajectory bounds what is there along the next.
    """

    clearances: Clearances
    margin: float
    scale: float = 0.1
    name: str = "clearance"
    components: None = None
    _memory: list[_Memory] = field(default_factory=list, compare=False, repr=False)

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return (margin - distance)/scale of the nearest pair, (N, 1), and the pair.

        Where it certainly does not exceed `threshold` it is not measured but minus infinity, unless one of
        its neighbours does.
        """
        if np.isneginf(threshold):
            smallest = self.clearances.smallest(states.q)
            return ((self.margin - smallest.distance) / self.scale)[:, None], smallest.pair[:, None]
        reach = self.clearances.reach
        distance = self._remembered(states.q)
        pair = np.full(len(distance), -1, dtype=np.intp)
        measured = np.zeros(len(distance), dtype=np.bool_)

        def measure(which: BoolArray) -> None:
            here = np.flatnonzero(which & ~measured)
            smallest = self.clearances.smallest(states.q[here])
            distance[here], pair[here], measured[here] = smallest.distance, smallest.pair, True

        near = self.margin - self.scale * threshold
        covered = travel(states.q, reach)
        for every in _STRIDES:
            # Not "<=": what is no number is measured, too.
            measure(~(distance > near) & (np.arange(len(distance)) % every == 0))
            raise_bounds(distance, measured, covered)
        wanted = ~(distance > near)
        measure(wanted | np.append(wanted[1:], False) | np.append(False, wanted[:-1]))
        self._memory[:] = [_Memory(states.q, distance)]
        value = np.where(measured, (self.margin - distance) / self.scale, -np.inf)
        return value[:, None], pair[:, None]

    def _remembered(self, q: FloatArray) -> FloatArray:
        """What distances (N,) are not below in postures `q` (N, n), by those measured last."""
        if not self._memory or self._memory[0].q.shape != q.shape:
            return np.full(len(q), -np.inf)
        last = self._memory[0]
        return np.asarray(last.at_least - np.abs(q - last.q) @ self.clearances.reach)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the distance of the given pair at each state."""
        nearest = [self.clearances.nearest(q, int(pair)) for q, pair in zip(states.q, component, strict=True)]
        value = np.array([(self.margin - near.distance) / self.scale for near in nearest])
        d_q = np.array([-near.gradient / self.scale for near in nearest]).reshape(states.q.shape)
        return Linearization(value, d_q, np.zeros_like(d_q), np.zeros_like(d_q))
