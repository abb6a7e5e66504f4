"""The global stage: which postures, via-point by via-point, ask the least of the guardrail.

Charts of self-motion at every via-point, and dynamic programming over them. The result is the best there is
up to the charts' spacing, and it carries a floor: whatever the arm does, at the via-point named it cannot
rest in an admissible posture with less torque on the guardrail.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbot.arrays import BoolArray, FloatArray
from cmbot.errors import PathNotFound
from cmbot.planning.chart_nodes import ChartNodes
from cmbot.planning.self_motion import ChartMaker, project
from cmbot.planning.task import ToolTask
from cmbot.robot import Kinematics, Postures, Robot
from cmbot.scene.clearance import Clearances
from cmbot.scene.options import PlannerOptions

__all__ = ["Floor", "GlobalSolution", "GlobalStage"]

# Around the best postures of a chart the floor is looked for this many times finer.
_FINER = 20
# Bound of the second derivative of the static torque along a unit step of self-motion, as a multiple of
# weight times reach: no centre of mass is moved on a tighter curve.
_CURVATURE = 1.0
# Weight of the squared steps, in shares of what the joints may do between via-points, beside the squared
# torque.
_STEP_WEIGHT = 0.02
# Two postures nearer than this in every joint are one, rad.
_SAME_POSTURE = 1e-9


@dataclass(frozen=True, kw_only=True)
class Floor:
    """What no admissible plan can go below.

    Attributes
    ----------
    torque : float, Nm
        The largest, over the via-points, of the smallest static torque of any admissible posture there.
    error : float, Nm
        The true value lies at most so far below it, as far as the charts are complete.
    via_point : int
        Index of the via-point that sets it.
    each : (n,), Nm
        The smallest static torque at every via-point.
    """

    torque: float
    error: float
    via_point: int
    each: FloatArray


@dataclass(frozen=True, kw_only=True)
class GlobalSolution:
    """Postures at the via-points with the smallest peak of the static torque on the guardrail.

    Attributes
    ----------
    q : (n, d), rad
    torque : (n,), Nm
        Static torque of each.
    """

    q: FloatArray
    torque: FloatArray

    @property
    def peak(self) -> float:
        """Largest static torque, Nm."""
        return float(self.torque.max())


class GlobalStage:
    """Charts of self-motion at all via-points, what is admissible in them, and the best ways through.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
    times : (n,), s
        Of the via-points.
    posture : (d,), rad
        The scene's.
    clearances : Clearances
    options : PlannerOptions

    Raises
    ------
    PathNotFound
        When a via-point has no admissible posture: which one, and what excluded most postures there.
    """

    def __init__(
        self,
        robot: Robot,
        task: ToolTask,
        times: FloatArray,
        posture: FloatArray,
        clearances: Clearances,
        options: PlannerOptions,
    ) -> None:
        self._robot, self._task, self._times = robot, task, times
        postures = Postures(robot)
        maker = ChartMaker(
            postures, task, robot.limits, spacing=options.chart_spacing, seeds=options.chart_seeds
        )
        points = task.path.position(times)
        charts = [maker.first(points[0], posture[None])]
        for point in points[1:]:
            charts.append(maker.next(charts[-1], point))
        self._nodes = [ChartNodes(chart, clearances, options.safety_margin_m) for chart in charts]
        self.floor = _floor(
            robot,
            postures,
            task,
            times,
            self._nodes,
            clearances,
            replace(options, chart_spacing=maker.spacing),
        )
        self._steps = (
            options.step_share * robot.limits.velocity * np.diff(times)[:, None] + 0.5 * options.chart_spacing
        )
        self._edges = [
            _edges(a.chart.q, b.chart.q, step)
            for a, b, step in zip(self._nodes, self._nodes[1:], self._steps, strict=False)
        ]
        self.first_chart = charts[0]
        self._pinned = np.abs(charts[0].q - posture).max(axis=1) < _SAME_POSTURE

    def solve(self, *, pinned: bool) -> GlobalSolution:
        """Find the sequence with the smallest peak, then mean square, of the static torque.

        Parameters
        ----------
        pinned : bool
            Start in the scene's posture; otherwise anywhere with its tool pose.

        Raises
        ------
        PathNotFound
            When no sequence of admissible postures can be followed to the end.
        """
        starts = self._pinned if pinned else np.ones_like(self._pinned)
        way = _Way(self._robot, self._task, self._times, self._nodes, self._edges, self._steps, starts)
        chosen = way.best()
        q = np.stack([node.chart.q[k] for node, k in zip(self._nodes, chosen, strict=True)])
        torque = np.array([node.chart.torque[k] for node, k in zip(self._nodes, chosen, strict=True)])
        return GlobalSolution(q=q, torque=torque)


def _edges(q_a: FloatArray, q_b: FloatArray, step: FloatArray) -> BoolArray:
    """Which postures of `q_b` (N, d) can follow which of `q_a` (M, d), (M, N)."""
    reachable = np.ones((len(q_a), len(q_b)), dtype=np.bool_)
    for joint in range(q_a.shape[1]):
        reachable &= np.abs(q_a[:, None, joint] - q_b[None, :, joint]) <= step[joint]
    return reachable


@dataclass(frozen=True)
class _Way:
    """Dynamic programming over the nodes of all via-points."""

    robot: Robot
    task: ToolTask
    times: FloatArray
    nodes: list[ChartNodes]
    edges: list[BoolArray]
    steps: FloatArray
    starts: BoolArray

    def best(self) -> list[int]:
        """Indices of the nodes with the smallest peak; among those, with the smallest sum of squares."""
        while True:
            peak = self._smallest_peak()
            # Clearances are looked at only where a way may pass; one that is too near sends it round again.
            refused = [node.look(node.admissible & (node.chart.torque <= peak)) for node in self.nodes]
            if not any(refused):
                return self._smallest_squares(peak)

    def _smallest_peak(self) -> float:
        """Smallest peak torque of any sequence of nodes that are not known to be inadmissible."""
        first = self.nodes[0]
        reached = np.where(first.admissible & self.starts, first.chart.torque, np.inf)
        for k, (node, edge) in enumerate(zip(self.nodes[1:], self.edges, strict=True), start=1):
            before = np.where(edge, reached[:, None], np.inf).min(axis=0, initial=np.inf)
            reached = np.where(node.admissible, np.maximum(before, node.chart.torque), np.inf)
            if not np.isfinite(reached).any():
                raise _blocked(self.robot, self.task, self.times, self.nodes, k)
        return float(reached.min())

    def _smallest_squares(self, peak: float) -> list[int]:
        first = self.nodes[0]
        allowed = first.admissible & self.starts & (first.chart.torque <= peak)
        cost = np.where(allowed, first.chart.torque**2, np.inf)
        came_from = []
        for before, node, edge, step in zip(self.nodes, self.nodes[1:], self.edges, self.steps, strict=False):
            moves = (before.chart.q[:, None] - node.chart.q[None]) / step
            way = cost[:, None] + _STEP_WEIGHT * peak**2 * np.einsum("abi,abi->ab", moves, moves)
            total = np.where(edge, way, np.inf)
            origin = total.argmin(axis=0)
            came_from.append(origin)
            best = total[origin, np.arange(len(origin))] + node.chart.torque**2
            cost = np.where(node.admissible & (node.chart.torque <= peak), best, np.inf)
        chosen = [int(cost.argmin())]
        for origin in reversed(came_from):
            chosen.insert(0, int(origin[chosen[0]]))
        return chosen


def _blocked(
    robot: Robot, task: ToolTask, times: FloatArray, nodes: list[ChartNodes], k: int
) -> PathNotFound:
    """Say at which via-point the sequence ends, and what excluded most postures there."""
    node = nodes[k]
    if len(node.chart.q) == 0:
        why = "no posture within the joint ranges holds the tool there"
    elif not node.admissible.any():
        weak = int((node.chart.joint_use > 1.0).sum())
        near = int(node.too_near.sum())
        why = (
            f"{near} postures come within the safety margin, {weak} ask too much of a joint's torque"
            if near >= weak
            else f"{weak} postures ask too much of a joint's torque, {near} come within the safety margin"
        )
    else:
        why = "its admissible postures are too far from those before for the joints' velocities"
    q = node.chart.q[:1] if len(node.chart.q) else nodes[k - 1].chart.q[:1]
    X_WT, J = Kinematics(robot).tool_jacobian(q[0])
    return PathNotFound(
        f"via-point {k + 1} of {len(nodes)} is blocked: {why}",
        time=float(times[k]),
        progress=task.path.progress(float(times[k])),
        smallest_singular_value=float(np.linalg.svd(task.jacobian(X_WT, J), compute_uv=False)[-1]),
    )


def _floor(
    robot: Robot,
    postures: Postures,
    task: ToolTask,
    times: FloatArray,
    nodes: list[ChartNodes],
    clearances: Clearances,
    options: PlannerOptions,
) -> Floor:
    """Refine the smallest torque at every via-point that may set the floor."""
    points = task.path.position(times)
    rough = np.array([node.least() for node in nodes])
    for k, least in enumerate(rough):
        if not np.isfinite(least):
            raise _blocked(robot, task, times, nodes, k)
    curvature = _CURVATURE * robot.arm_mass * 9.81 * float(clearances.reach.max())
    # Between two postures of a chart the torque dips below both by no more than this.
    dip = curvature * options.chart_spacing**2 / 8
    each = rough.copy()
    # From the largest down, until the refined ones exceed all that are left: only those can set the maximum.
    for k in np.argsort(-rough):
        if rough[k] < each.max() - dip:
            break
        each[k] = _refined(postures, task, points[k], nodes[k], rough[k] + dip, robot, clearances, options)
    fine = options.chart_spacing / _FINER
    where = int(each.argmax())
    return Floor(torque=float(each[where]), error=float(curvature * fine**2 / 8), via_point=where, each=each)


def _refined(
    postures: Postures,
    task: ToolTask,
    point: FloatArray,
    node: ChartNodes,
    worth: float,
    robot: Robot,
    clearances: Clearances,
    options: PlannerOptions,
) -> float:
    """Smallest admissible torque around the postures of a chart with less than `worth`."""
    centres = node.chart.q[(node.chart.torque <= worth) & (node.chart.joint_use <= 1.1)]
    at = postures.at(centres)
    J = task.jacobians(at.tool_rotation, at.jacobian)
    tangents = np.linalg.svd(J)[2][:, J.shape[1] :]
    fractions = np.linspace(-1.0, 1.0, 2 * _FINER + 1) * options.chart_spacing
    around = (centres[:, None, None] + fractions[:, None] * tangents[:, :, None]).reshape(-1, robot.dof)
    q, reached = project(postures, task, around, point)
    limits = robot.limits
    q = q[reached & ((q >= limits.lower) & (q <= limits.upper)).all(axis=1)]
    at = postures.at(q)
    use = (np.abs(at.joint_torque) / limits.torque).max(axis=1)
    torque = np.where(use <= 1.0, np.linalg.norm(at.guardrail_torque, axis=1), np.inf)
    for k in np.argsort(torque):
        if clearances.smallest(q[k : k + 1]).distance[0] >= options.safety_margin_m:
            return min(float(torque[k]), node.least())
    return node.least()
