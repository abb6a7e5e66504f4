"""The best sequence of postures, one of each via-point's chart, that the arm can follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.arrays import BoolArray, FloatArray
from cmbot.errors import PathNotFound
from cmbot.planning.chart_nodes import ChartNodes
from cmbot.planning.setting import Setting
from cmbot.robot import Kinematics

__all__ = ["WayThrough", "blocked", "edges", "nearest_turn"]

# Weight of the squared steps, in shares of what the joints may do between via-points, beside the squared
# objective.
_STEP_WEIGHT = 0.02


def edges(q_a: FloatArray, q_b: FloatArray, step: FloatArray, endless: BoolArray) -> BoolArray:
    """Which postures of `q_b` (N, n) can follow which of `q_a` (M, n), (M, N).

    Parameters
    ----------
    q_a, q_b : (M, n) and (N, n), rad
    step : (n,), rad
        The longest that each joint can make.
    endless : (n,)
        Which joints have no range: a turn more or less is the same to them.
    """
    reachable = np.ones((len(q_a), len(q_b)), dtype=np.bool_)
    for joint in range(q_a.shape[1]):
        move = q_a[:, None, joint] - q_b[None, :, joint]
        reachable &= np.abs(nearest_turn(move) if endless[joint] else move) <= step[joint]
    return reachable


def nearest_turn(angle: FloatArray) -> FloatArray:
    """Angles less whole turns, from half a turn back to half a turn forth, rad."""
    return np.asarray(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))


def _squared_moves(q_a: FloatArray, q_b: FloatArray, step: FloatArray, endless: BoolArray) -> FloatArray:
    """Squared distances (M, N) between postures (M, n) and (N, n), joints counted in steps."""
    a, b = (q[:, ~endless] / step[~endless] for q in (q_a, q_b))
    moves = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    for joint in np.flatnonzero(endless):
        moves += (nearest_turn(q_a[:, None, joint] - q_b[None, :, joint]) / step[joint]) ** 2
    return np.asarray(moves)


@dataclass(frozen=True)
class WayThrough:
    """Dynamic programming over the nodes of all via-points."""

    setting: Setting
    nodes: list[ChartNodes]
    edges: list[BoolArray]
    steps: FloatArray
    starts: BoolArray

    def best(self) -> list[int]:
        """Indices of the nodes with the smallest peak; among those, with the smallest sum of squares."""
        while True:
            peak = self._smallest_peak()
            # Clearances are looked at only where a way may pass; one that is too near sends it round again.
            refused = [node.look(node.admissible & (node.chart.value <= peak)) for node in self.nodes]
            if not any(refused):
                return self._smallest_squares(peak)

    def _smallest_peak(self) -> float:
        """Smallest peak of any sequence of nodes that are not known to be inadmissible."""
        first = self.nodes[0]
        reached = np.where(first.admissible & self.starts, first.chart.value, np.inf)
        if not np.isfinite(reached).any():
            raise blocked(self.setting, self.nodes, 0)
        for k, (node, edge) in enumerate(zip(self.nodes[1:], self.edges, strict=True), start=1):
            before = np.where(edge, reached[:, None], np.inf).min(axis=0, initial=np.inf)
            reached = np.where(node.admissible, np.maximum(before, node.chart.value), np.inf)
            if not np.isfinite(reached).any():
                raise blocked(self.setting, self.nodes, k)
        return float(reached.min())

    def _smallest_squares(self, peak: float) -> list[int]:
        """Nodes with no value above `peak` and the smallest sum of squared values and steps."""
        allowed = [node.admissible & (node.chart.value <= peak) for node in self.nodes]
        allowed[0] = allowed[0] & self.starts
        some = [np.flatnonzero(each) for each in allowed]
        cost = self.nodes[0].chart.value[some[0]] ** 2
        came_from = []
        for k, (edge, step) in enumerate(zip(self.edges, self.steps, strict=True)):
            before, after = (self.nodes[i].chart.q[some[i]] for i in (k, k + 1))
            moves = _squared_moves(before, after, step, np.isinf(self.setting.robot.limits.lower))
            way = cost[:, None] + _STEP_WEIGHT * peak**2 * moves
            total = np.where(edge[np.ix_(some[k], some[k + 1])], way, np.inf)
            origin = total.argmin(axis=0)
            came_from.append(origin)
            cost = total[origin, np.arange(len(origin))] + self.nodes[k + 1].chart.value[some[k + 1]] ** 2
        chosen = [int(cost.argmin())]
        for origin in reversed(came_from):
            chosen.insert(0, int(origin[chosen[0]]))
        return [int(nodes[i]) for nodes, i in zip(some, chosen, strict=True)]


def blocked(setting: Setting, nodes: list[ChartNodes], k: int) -> PathNotFound:
    """Say at which via-point the sequence ends, and what excluded most postures there."""
    task, times = setting.task, setting.times
    node = nodes[k]
    if not node.chart.within.any():
        why = "out of reach: no posture within the joint ranges holds the tool there"
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
    X_WT, J = Kinematics(setting.robot).tool_jacobian(q[0])
    return PathNotFound(
        f"via-point {k + 1} of {len(nodes)} is blocked: {why}",
        time=float(times[k]),
        progress=task.path.progress(float(times[k])),
        smallest_singular_value=task.smallest_singular_value(X_WT, J),
    )
