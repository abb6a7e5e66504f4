"""The best sequence of postures, one of each via-point's chart, that the arm can follow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.context import PlanningContext
from cmbot.planning.selfmotion.graph_layer import GraphLayer

__all__ = ["BottleneckDynamicProgram", "Edges", "blocked", "edges", "edges_between", "nearest_turn"]

# Weight of the squared steps, in shares of what the joints may do between via-points, beside the squared
# objective.
_STEP_WEIGHT = 0.02
# A step in units of itself, a little more for rounding.
_A_STEP = 1 + 1e-9


@dataclass(frozen=True)
class Edges:
    """Which postures of one via-point can follow which of the one before, few of all pairs.

    Attributes
    ----------
    before, after : (E,)
        Indices of the postures; ascending in `after`, then in `before`.
    length : (E,)
        Sum of the squared joints' moves, in units of the longest they can make.
    number : int
        Of the postures after.
    """

    before: IntArray
    after: IntArray
    length: FloatArray
    number: int

    def smallest(self, value: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the smallest of the edges' values (E,) that leads to each posture, and which edge it is.

        Infinite where none does; of equal ones the first.
        """
        least, which = self.least(value), np.zeros(self.number, dtype=np.intp)
        best = np.flatnonzero(value == least[self.after])[::-1]
        which[self.after[best]] = best
        return least, which

    def least(self, value: FloatArray) -> FloatArray:
        """Return the smallest of the edges' values (E,) to each posture; infinite where no edge leads."""
        least = np.full(self.number, np.inf)
        if len(value):
            least[self.after[self._first]] = np.minimum.reduceat(value, self._first)
        return least

    @cached_property
    def _first(self) -> IntArray:
        """The first edge to each posture that any leads to."""
        return np.flatnonzero(np.diff(self.after, prepend=-1))


def edges(q_a: FloatArray, q_b: FloatArray, step: FloatArray, endless: BoolArray) -> Edges:
    """Find which postures of `q_b` (N, n) can follow which of `q_a` (M, n).

    Parameters
    ----------
    q_a, q_b : (M, n) and (N, n), rad
    step : (n,), rad
        The longest that each joint can make.
    endless : (n,)
        Which joints have no range: a turn more or less is the same to them.
    """
    turn = np.where(endless, 2 * np.pi / step, 0.0)
    # A box without periods is searched through more slowly than none.
    box = turn if endless.any() else None
    trees = (cKDTree(_in_steps(q, step, turn), boxsize=box) for q in (q_a, q_b))
    near = next(trees).sparse_distance_matrix(next(trees), _A_STEP, p=np.inf, output_type="ndarray")
    before, after = near["i"], near["j"]
    moves = q_a[before] - q_b[after]
    if box is not None:
        moves[:, endless] = nearest_turn(moves[:, endless])
    moves /= step
    reachable = (np.abs(moves) <= 1.0).all(axis=1)
    order = np.flatnonzero(reachable)
    order = order[np.lexsort((before[order], after[order]))]
    return Edges(before[order], after[order], (moves[order] ** 2).sum(axis=1), len(q_b))


def edges_between(before: GraphLayer, after: GraphLayer, step: FloatArray, endless: BoolArray) -> Edges:
    """Find which nodes of one via-point can follow which of the one before; see `edges`.

    Those that are known to be inadmissible lead nowhere.
    """
    i, j = np.flatnonzero(before.admissible), np.flatnonzero(after.admissible)
    found = edges(before.chart.q[i], after.chart.q[j], step, endless)
    return Edges(i[found.before], j[found.after], found.length, len(after.chart.q))


def _in_steps(q: FloatArray, step: FloatArray, turn: FloatArray) -> FloatArray:
    """Postures (N, n) in units of steps, on the circle where a turn has a length."""
    q = q / step
    round_ = turn > 0
    q[:, round_] %= turn[round_]
    # A tiny negative angle rounds up to a whole turn.
    return np.where(round_ & (q >= turn), 0.0, q)


def nearest_turn(angle: FloatArray) -> FloatArray:
    """Angles less whole turns, from half a turn back to half a turn forth, rad."""
    return np.asarray(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))


@dataclass(frozen=True)
class BottleneckDynamicProgram:
    """Dynamic programming over the nodes of all via-points."""

    context: PlanningContext
    nodes: list[GraphLayer]
    edges: list[Edges]
    starts: BoolArray

    def best(self) -> list[int]:
        """Indices of the nodes with the smallest peak; among those, with the smallest sum of squares."""
        around = 0
        while True:
            peak = self._smallest_peak()
            chosen = self._smallest_squares(peak)
            # Clearances cost most: at first only those of the best way are looked at. If they hold, no way
            # is better, whatever the clearances beside it.
            refused = [k for k, node in enumerate(self.nodes) if node.look_at(chosen[k])]
            if not refused:
                return chosen
            # Where one was refused its neighbours will be, too. Going further in every round, there are few.
            for k in _neighbourhood(refused, around, len(self.nodes)):
                node = self.nodes[k]
                node.look(node.admissible & (node.chart.value <= peak))
            around = 2 * around + 1

    def _smallest_peak(self) -> float:
        """Smallest peak of any sequence of nodes that are not known to be inadmissible."""
        first = self.nodes[0]
        reached = np.where(first.admissible & self.starts, first.chart.value, np.inf)
        if not np.isfinite(reached).any():
            raise blocked(self.context, self.nodes, 0)
        for k, (node, edge) in enumerate(zip(self.nodes[1:], self.edges, strict=True), start=1):
            before = edge.least(reached[edge.before])
            reached = np.where(node.admissible, np.maximum(before, node.chart.value), np.inf)
            if not np.isfinite(reached).any():
                raise blocked(self.context, self.nodes, k)
        return float(reached.min())

    def _smallest_squares(self, peak: float) -> list[int]:
        """Nodes with no value above `peak` and the smallest sum of squared values and steps."""
        first = self.nodes[0]
        cost = np.where(
            first.admissible & (first.chart.value <= peak) & self.starts, first.chart.value**2, np.inf
        )
        came_from = []
        for node, edge in zip(self.nodes[1:], self.edges, strict=True):
            way = cost[edge.before] + _STEP_WEIGHT * peak**2 * edge.length
            cost, which = edge.smallest(way)
            came_from.append(edge.before[which] if len(way) else which)
            allowed = node.admissible & (node.chart.value <= peak)
            cost = np.where(allowed, cost + node.chart.value**2, np.inf)
        chosen = [int(cost.argmin())]
        for origin in reversed(came_from):
            chosen.append(int(origin[chosen[-1]]))
        return chosen[::-1]


def _neighbourhood(some: list[int], around: int, number: int) -> IntArray:
    """Those of `number` things in a row that are at most `around` places from one of `some`."""
    near = np.zeros(number, dtype=np.bool_)
    for k in some:
        near[max(k - around, 0) : k + around + 1] = True
    return np.flatnonzero(near)


def blocked(context: PlanningContext, nodes: list[GraphLayer], k: int) -> PathNotFound:
    """Say at which via-point the sequence ends, and what excluded most postures there."""
    node = nodes[k]
    if not node.chart.within.any():
        why = (
            "out of reach: no posture within the joint ranges holds the tool there; "
            "take another posture_deg, move the tool path, or keep less of the pose (tool_path.keep)"
        )
    elif not node.admissible.any():
        weak = int((node.chart.within & (node.chart.joint_use > 1.0)).sum())
        near = int(node.too_near.sum())
        why = (
            f"{near} postures come within the safety margin, {weak} ask too much of a joint's torque; "
            "move obstacles or tool path, or lower planner.safety_margin_m"
            if near >= weak
            else f"{weak} postures ask too much of a joint's torque, {near} come within the safety margin; "
            "move the tool path, or take a lighter payload"
        )
    elif k == 0:
        why = "the posture to start in asks too much of a joint's torque or comes within the safety margin"
    else:
        why = (
            "its admissible postures are too far from those before for the joints' velocities; "
            "give the leg more seconds"
        )
    q = node.chart.q[:1] if len(node.chart.q) else nodes[k - 1].chart.q[:1]
    return context.path_not_found(
        f"via-point {k + 1} of {len(nodes)} is blocked: {why}", q[0], context.times[k]
    )
