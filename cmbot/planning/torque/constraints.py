"""Functions of the arm's state that a trajectory has to keep at or below zero, with exact derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar

import numpy as np

from cmbot.collision import Clearances, raise_bounds, travel
from cmbot.common.arrays import BoolArray, FloatArray, IntArray, cross
from cmbot.common.limit import Limit
from cmbot.hold import Holding
from cmbot.optimization import Linearization, StateSamples
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.bent_tool import BentTool
from cmbot.planning.workcell.objectives import ZERO_NORM, efforts_of
from cmbot.robot import Dynamics, Efforts, Postures, ToolBatch
from cmbot.toolpath import ToolPoses

# Directions across a leg in which the tool is held near it, or in which its axis may lean.
_DIRECTION_COUNT = 8
# Samples from one bounded or measured clearance to the next, from coarse to fine.
_CLEARANCE_STRIDES = (16, 4, 1)
# Pairs that are measured sooner than bounded in a posture.
_MEASURED_PAIRS = 8


@dataclass(frozen=True, eq=False)
class _SignedTorque(ABC):
    """Torques of n joints within bounds of both signs; components: +1..+n, then -1..-n."""

    dynamics: Dynamics
    bound: FloatArray

    @property
    def components(self) -> int:
        """Two a joint."""
        return 2 * len(self.bound)

    @abstractmethod
    def _torque(self, efforts: Efforts) -> FloatArray:
        """The torques (N, n)."""

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return torque/bound - 1 and -torque/bound - 1, (N, 2n)."""
        share = self._torque(efforts_of(self.dynamics, states)) / self.bound
        return numbered(np.hstack([share - 1, -share - 1]))

    def _signed(self, component: IntArray) -> tuple[IntArray, FloatArray]:
        """The joints of components, and the factors that make shares of their torques."""
        n = len(self.bound)
        joint = component % n
        return joint, np.where(component < n, 1.0, -1.0) / self.bound[joint]


@dataclass(frozen=True, eq=False)
class JointTorque(_SignedTorque):
    """Joint torques within their bounds (Chang 2021, Eq. (32))."""

    name: str = "joint torque"
    limit: Limit = Limit.JOINT_TORQUE

    def _torque(self, efforts: Efforts) -> FloatArray:
        return efforts.joint_torque

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize one signed joint torque at each state."""
        rows = self.dynamics.derivatives(states.q, states.v, states.a)
        (joint, factor), k = self._signed(component), np.arange(len(component))
        d_q, d_v, d_a = (factor[:, None] * d[k, 3 + joint] for d in (rows.d_q, rows.d_v, rows.d_a))
        return Linearization(factor * rows.value[k, 3 + joint] - 1, d_q, d_v, d_a)


@dataclass(frozen=True)
class FootHold:
    """What the feet bear within their bounds; without bounds nothing."""

    dynamics: Dynamics
    holding: Holding
    inside: float
    name: str = "hold of the feet"
    limit: Limit = Limit.HOLD
    components: int = 1

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return share/bound - 1, (N, 1)."""
        wrench = efforts_of(self.dynamics, states).guardrail_wrench
        share, _ = self.holding.share(wrench, self.inside * (1 + threshold))
        return numbered(share[:, None] / self.inside - 1)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the share."""
        at = self.dynamics.wrench_derivatives(states.q, states.v, states.a)
        share, gradient = self.holding.share(at.value)
        by = (np.einsum("ki,kij->kj", gradient, d) / self.inside for d in (at.d_q, at.d_v, at.d_a))
        return Linearization(share / self.inside - 1, *by)


@dataclass(frozen=True, eq=False)
class HoldingTorque(_SignedTorque):
    """Torques of the locked joints between feet and arm within their bounds."""

    name: str = "torque that locked joints hold"
    limit: Limit = Limit.HOLDING_TORQUE

    def _torque(self, efforts: Efforts) -> FloatArray:
        return self.dynamics.robot.holding_torque(efforts.guardrail_wrench)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize one signed torque at each state."""
        robot, (joint, factor) = self.dynamics.robot, self._signed(component)
        at = self.dynamics.wrench_derivatives(states.q, states.v, states.a)
        rows = factor[:, None] * robot.holding_rows[0][joint]
        share = factor * robot.holding_torque(at.value)[np.arange(len(joint)), joint]
        by = (np.einsum("ki,kij->kj", rows, d) for d in (at.d_q, at.d_v, at.d_a))
        return Linearization(share - 1, *by)


@dataclass(frozen=True)
class _OfTool:
    """A bound on the tool."""

    components: ClassVar[int] = 1
    postures: Postures | BentTool

    def _tool(self, states: StateSamples) -> ToolBatch:
        """The tool at the states: computed once, whichever constraints need it."""
        if isinstance(self.postures, BentTool):
            return states.computed(id(self.postures), partial(self.postures.at, states.t, states.q))
        return states.computed(id(self.postures), partial(self.postures.tool_at, states.q))


@dataclass(frozen=True)
class _OfTask(_OfTool):
    """A bound on the tool beside its task."""

    task: ToolTask
    bound: float


@dataclass(frozen=True)
class ToolDeviation(_OfTask):
    """Distance of the tool point from the leg of its time within its bound.

    That is never less than its distance from all the legs, and unlike that has no kink at a corner.
    """

    name: str = "tool deviation"
    limit: Limit = Limit.TOOL_DEVIATION

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return distance/bound - 1, (N, 1)."""
        offset = self.task.path.leg_offset(states.t, self._tool(states).tool_point)
        return numbered(np.linalg.norm(offset, axis=1, keepdims=True) / self.bound - 1)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the distance; its cuts are offsets across the leg in several directions.

        To first order a distance knows no direction but its own; a step could leave the leg in any other.
        """
        tool = self._tool(states)
        J = tool.jacobian[:, :3]
        offset = self.task.path.leg_offset(states.t, tool.tool_point) / self.bound
        distance = np.linalg.norm(offset, axis=1)
        d_q = np.einsum("ki,kij->kj", offset / np.maximum(distance, ZERO_NORM)[:, None] / self.bound, J)
        leg = self.task.path.leg_directions(states.t)
        # The first direction is the distance's own.
        directions = _directions_across(leg, offset)[1:]
        value = (directions * offset).sum(axis=2) - 1
        by_q = directions.transpose(1, 0, 2) @ J / self.bound
        cuts = (Linearization.by_position(value[k], by_q[:, k]) for k in range(len(directions)))
        return Linearization.by_position(distance - 1, d_q, tuple(cuts))


@dataclass(frozen=True)
class ToolLag(_OfTask):
    """Distance of the tool point along the leg from its timed place within its bound; ahead, then behind."""

    name: str = "tool lag"
    limit: Limit = Limit.TOOL_LAG
    components: ClassVar[int] = 2

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return +lag/bound - 1 and -lag/bound - 1, (N, 2)."""
        path = self.task.path
        away = self._tool(states).tool_point - path.position(states.t)
        share = np.einsum("ki,ki->k", away, path.leg_directions(states.t))[:, None] / self.bound
        return numbered(np.hstack([share - 1, -share - 1]))

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the lag of one sign at each state."""
        k, sign = np.arange(len(component)), np.where(component == 0, 1.0, -1.0)
        by_point = (sign / self.bound)[:, None] * self.task.path.leg_directions(states.t)
        d_q = np.einsum("ki,kij->kj", by_point, self._tool(states).jacobian[:, :3])
        return Linearization.by_position(self.sample(states)[0][k, component], d_q)


@dataclass(frozen=True)
class ToolRotation(_OfTask):
    """Angle by which the tool misses its prescribed orientation or axis within its bound."""

    name: str = "tool rotation"
    limit: Limit = Limit.TOOL_ROTATION

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return angle/bound - 1, (N, 1)."""
        tool = self._tool(states)
        value = self.task.rotation(tool.tool_rotation, self._goals(tool, states))[:, None] / self.bound - 1
        return numbered(value)

    def _goals(self, tool: ToolBatch, states: StateSamples) -> ToolPoses:
        """The timed orientations where the tool is: its point plays no part."""
        return ToolPoses(point=tool.tool_point, rotation=self.task.path.rotation(states.t))

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the angle."""
        tool, task = self._tool(states), self.task
        goals = self._goals(tool, states)
        turn = task.errors(tool.tool_point, tool.tool_rotation, goals)[:, 3:] / self.bound
        # The errors lead to the goal: they fall as the tool turns towards it.
        J = -task.jacobian(tool.tool_rotation, tool.jacobian)[:, 3:] / self.bound
        angle = np.linalg.norm(turn, axis=1)
        d_q = np.einsum("ki,kij->kj", turn / np.maximum(angle, ZERO_NORM)[:, None], J)
        return Linearization.by_position(angle - 1, d_q)


@dataclass(frozen=True)
class ToolTilt(_OfTask):
    """Angle between the tool's axis and that of the path within its cone, by the squared chord.

    Between unit vectors at an angle the chord is 2 sin(angle/2); unlike the angle its square is smooth where
    the axes agree.
    """

    name: str = "tool tilt"
    limit: Limit = Limit.TOOL_TILT

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return (chord/largest chord)^2 - 1, (N, 1)."""
        z, z_goal = self._axes(states)
        return numbered(((z - z_goal) ** 2).sum(axis=1, keepdims=True) / self._chord**2 - 1)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the squared chord; its cuts are tangents where the tool would lean in several directions.

        In the middle of the cone the squared chord has no slope: a step could leave the cone anywhere.
        """
        z, z_goal = self._axes(states)
        turns, away = self._tool(states).jacobian[:, 3:] / self._chord, (z - z_goal) / self._chord
        square = (away**2).sum(axis=1)
        # An axis z moves by (rates of turn) x z.
        d_q = 2 * np.einsum("ki,kij->kj", cross(z, away), turns)
        u = _directions_across(z_goal, away)
        # Of a paraboloid: |x|^2 >= 2 u x - |u|^2.
        value = 2 * (u * away).sum(axis=2) - 2
        by_q = 2 * np.einsum("cki,kij->ckj", cross(z, u), turns)
        cuts = (Linearization.by_position(value[k], by_q[k]) for k in range(len(u)))
        return Linearization.by_position(square - 1, d_q, tuple(cuts))

    @property
    def _chord(self) -> float:
        return 2 * float(np.sin(self.bound / 2))

    def _axes(self, states: StateSamples) -> tuple[FloatArray, FloatArray]:
        """The tool's axes and those of the path, (N, 3) each."""
        rotation = self.task.path.rotation(states.t)
        z = self._tool(states).tool_rotation[:, :, 2]
        return z, np.broadcast_to(rotation[:, :, 2], z.shape)


@dataclass(frozen=True)
class ToolSpeed(_OfTool):
    """Speed of the tool point within its bound."""

    bound: float
    name: str = "tool speed"
    limit: Limit = Limit.TOOL_SPEED

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return speed/bound - 1, (N, 1)."""
        velocity = np.einsum("ijk,kj->ki", self._tool(states).leading_jacobian[:3], states.v)
        return numbered(np.linalg.norm(velocity, axis=1, keepdims=True) / self.bound - 1)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the speed."""
        tool = self._tool(states)
        velocity, by_q = tool.point_velocity(states.v)
        speed = np.linalg.norm(velocity, axis=1) / self.bound
        along = velocity / np.maximum(speed, ZERO_NORM)[:, None] / self.bound**2
        d_q, d_v = (np.einsum("ki,kij->kj", along, by) for by in (by_q, tool.jacobian[:, :3]))
        return Linearization(speed - 1, d_q, d_v, np.zeros_like(d_q))


@dataclass(frozen=True)
class ProcessSpeed(_OfTask):
    """Speed of the tool point within its bound of the process speed, as a share of that; above, then below.

    Along the path it is not below, which is no weaker than that the speed is not, and linear in the rates.
    """

    name: str = "process speed"
    limit: Limit = Limit.PROCESS_SPEED
    components: ClassVar[int] = 2

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return (speed/asked - 1)/bound - 1 and (1 - speed along the path/asked)/bound - 1, (N, 2)."""
        velocity = np.einsum("ijk,kj->ki", self._tool(states).leading_jacobian[:3], states.v)
        per_speed, along = self._asked(states)
        fast = np.linalg.norm(velocity, axis=1) * per_speed - 1
        slow = 1 - np.einsum("ki,ki->k", velocity, along) * per_speed
        value = np.where(per_speed[:, None] > 0, np.stack([fast, slow], axis=1) / self.bound, 0.0) - 1
        return numbered(value)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize one of the two at each state."""
        tool = self._tool(states)
        velocity, by_q = tool.point_velocity(states.v)
        per_speed, along = self._asked(states)
        speed = np.maximum(np.linalg.norm(velocity, axis=1), ZERO_NORM)[:, None]
        factor = (per_speed / self.bound)[:, None]
        direction = factor * np.where((component == 0)[:, None], velocity / speed, -along)
        d_q, d_v = (np.einsum("ki,kij->kj", direction, by) for by in (by_q, tool.jacobian[:, :3]))
        value = self.sample(states)[0][np.arange(len(component)), component]
        return Linearization(value, d_q, d_v, np.zeros_like(d_q))

    def _asked(self, states: StateSamples) -> tuple[FloatArray, FloatArray]:
        """One over the process speed (N,), zero where there is none, and directions (N, 3) along the path."""
        asked = self.task.path.process_speed(states.t)
        per_speed = np.divide(1.0, asked, out=np.zeros_like(asked), where=asked > 0)
        return per_speed, self.task.path.leg_directions(states.t)


def numbered(value: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return values (N, c) with the numbers of their components."""
    return value, np.broadcast_to(np.arange(value.shape[1]), value.shape)


def _directions_across(axis: FloatArray, away: FloatArray) -> FloatArray:
    """Unit vectors (8, N, 3) across unit vectors `axis` (N, 3), all round; the first along `away` (N, 3)."""
    # A leg of no length has no direction.
    axis = np.where(axis.any(axis=1, keepdims=True), axis, np.eye(3)[np.abs(away).argmin(axis=1)])
    across = cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    own = away - np.einsum("ki,ki->k", away, axis)[:, None] * axis
    u = np.where(np.linalg.norm(own, axis=1, keepdims=True) > ZERO_NORM, own, across)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    angle = np.arange(_DIRECTION_COUNT)[:, None, None] * (2 * np.pi / _DIRECTION_COUNT)
    return np.asarray(np.cos(angle) * u + np.sin(angle) * cross(axis, u))


@dataclass(eq=False)
class _Memory:
    """Postures (N, n), and what the distances of all pairs are not below in them (N, P)."""

    q: FloatArray
    at_least: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class _Bounds:
    """Lower bounds (N, P) of the distances of all pairs in N postures, and which are these distances."""

    near: float
    lower: FloatArray
    known: BoolArray

    def of(self, which: BoolArray) -> _Bounds:
        """Copy those of some postures."""
        return _Bounds(near=self.near, lower=self.lower[which], known=self.known[which])


@dataclass(frozen=True)
class ClearanceMargin:
    """Distances stay above the margin, in units of `scale`; the component is the pair that is nearest.

    No pair's distance changes faster than the joints move times its reach. So what was measured bounds what
    is near it in time, and what was measured along one trajectory bounds what is there along the next.
    """

    clearances: Clearances
    margin: float
    scale: float = 0.1
    name: str = "clearance"
    limit: Limit = Limit.CLEARANCE
    components: None = None
    _memory: list[_Memory] = field(default_factory=list, compare=False, repr=False)

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return (margin - distance)/scale of the nearest pair, (N, 1), and the pair.

        Where it certainly does not exceed `threshold` it is not measured but minus infinity, unless one of
        its neighbours does.
        """
        if np.isneginf(threshold):
            smallest = self.clearances.query(states.q)
            return ((self.margin - smallest.distance) / self.scale)[:, None], smallest.pair[:, None]
        finite: BoolArray = np.all(np.isfinite(states.q), axis=1)
        value, pair = np.where(finite, -np.inf, np.nan), np.full(len(finite), -1, dtype=np.intp)
        bounds = self._bounds(states.q, self.margin - self.scale * threshold)
        near = (bounds.known & (bounds.lower <= bounds.near)).any(axis=1) | ~finite
        wanted = (near | np.append(near[1:], False) | np.append(False, near[:-1])) & finite
        if len(self.clearances.pairs):
            distance, pair[wanted] = self._smallest(states.q[wanted], bounds.of(wanted))
            value[wanted] = (self.margin - distance) / self.scale
        return value[:, None], pair[:, None]

    def _bounds(self, q: FloatArray, near: float) -> _Bounds:
        """Bounds in postures `q` (N, n) of a motion; in each some pair is known that is `near`, if any is."""
        lower = self._remembered(q)
        # Not "<=": what is no number is doubtful, too.
        rows = np.flatnonzero((~(lower > near)).sum(axis=1) > _MEASURED_PAIRS)
        for every in _CLEARANCE_STRIDES:
            # What is bounded in one posture bounds those near it.
            rows = rows[(~(lower[rows] > near)).sum(axis=1) > _MEASURED_PAIRS]
            if len(some := rows[every // 2 :: every]):
                place = np.minimum(np.arange(len(rows)) // every, len(some) - 1)
                moved = np.abs(q[rows] - q[some[place]]) @ self.clearances.pair_reach.T
                lower[rows] = np.fmax(lower[rows], self.clearances.lower_bounds(q[some])[place] - moved)
        known, found = np.zeros(lower.shape, dtype=np.bool_), np.zeros(len(q), dtype=np.bool_)
        pairs = np.flatnonzero(~(lower > near).all(axis=0))
        covered = {pair: travel(q, self.clearances.pair_reach[pair]) for pair in pairs.tolist()}
        for every in _CLEARANCE_STRIDES:
            here = ~found & (np.arange(len(q)) % every == 0)
            row, column = np.nonzero((~(lower[:, pairs] > near) & ~known[:, pairs])[here])
            row, pair = np.flatnonzero(here)[row], pairs[column]
            lower[row, pair], known[row, pair] = self.clearances.distances(q, row, pair), True
            found[row[lower[row, pair] <= near]] = True
            for each in np.unique(pair).tolist():
                raise_bounds(lower[:, each], known[:, each], covered[each])
        self._memory[:] = [_Memory(q, lower)]
        return _Bounds(near=near, lower=lower, known=known)

    def _smallest(self, q: FloatArray, bounds: _Bounds) -> tuple[FloatArray, IntArray]:
        """Smallest distances (N,) and their pairs in postures `q` (N, n), by bounds on all of them."""
        lower, known, every = bounds.lower, bounds.known, np.arange(len(q))

        def measure(wanted: BoolArray) -> None:
            row, pair = np.nonzero(wanted & ~known)
            lower[row, pair], known[row, pair] = self.clearances.distances(q, row, pair), True

        measure(lower == lower.min(axis=1, keepdims=True))
        measure(lower <= np.where(known, lower, np.inf).min(axis=1, keepdims=True))
        pair = np.where(known, lower, np.inf).argmin(axis=1)
        return lower[every, pair], pair

    def _remembered(self, q: FloatArray) -> FloatArray:
        """What distances (N, P) are not below in postures `q` (N, n), by those measured last."""
        reach = self.clearances.pair_reach
        if not self._memory or self._memory[0].q.shape != q.shape:
            return np.full((len(q), len(reach)), -np.inf)
        last = self._memory[0]
        return np.asarray(last.at_least - np.abs(q - last.q) @ reach.T)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the distance of the given pair at each state."""
        nearest = [self.clearances.nearest(q, int(pair)) for q, pair in zip(states.q, component, strict=True)]
        value = np.array([(self.margin - near.distance) / self.scale for near in nearest])
        d_q = np.array([-near.gradient / self.scale for near in nearest]).reshape(states.q.shape)
        return Linearization.by_position(value, d_q)
