"""The approach: the motion from the scene's posture to the start of the work, with the tool off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import LimitViolation, PathNotFound
from cmbot.planning.context import PlanningContext
from cmbot.planning.task import ToolTask
from cmbot.planning.verification.certificate import Certificate, certify
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, SpeedProfile
from cmbot.trajectory import QuinticTrajectory, SplineSpace

__all__ = ["Approach", "FreeSpace", "certify_approach", "connect", "plan_approach", "reachable", "shorten"]

# Distance of the spline's knots along the path, rad; halved while the spline's certificate does not hold.
_KNOT_SPACING, _HALVINGS = 0.4, 4
# Share of the time limit by which the search for an approach may exceed it: no plan is complete without one.
_MORE_TIME = 0.2
# Share of the limits that the approach may use.
_LIMIT_SHARE = 0.95
# Postures of a chart are neighbours within this many spacings.
_NEIGHBOURS = 1.6
# Longest step of a tree, rad, and how often the trees are grown before the search is given up.
_STEP = 0.3
_MOST_GROWTHS = 4000
# Postures of the straight line to the start of the work that are looked at where nothing leads there.
_ON_THE_LINE = 50
# Pairs of points of a path between which a shortcut is tried.
_SHORTCUTS = 150
# Between two postures of a line that are checked no point of the arm moves further than this, m.
_CHECK_EVERY = 0.04
# Where the ends of a path spare less, this share of what they spare is required in between.
_SHARE_TO_SPARE = 0.5


@dataclass(frozen=True, kw_only=True)
class Approach:
    """A certified motion from the scene's posture to the start of the work.

    Attributes
    ----------
    trajectory : QuinticTrajectory
        From rest to rest, within the joint limits.
    certificate : Certificate
        Its tool deviation is the distance of the tool point from where the work starts; it is not bounded.
    task : ToolTask
        The tool held where the work starts, from where that distance is measured.
    along_self_motion : bool
        The path leads along the self-motion, so that the tool stays about where it is.
    """

    trajectory: QuinticTrajectory
    certificate: Certificate
    task: ToolTask
    along_self_motion: bool


def plan_approach(context: PlanningContext, end: FloatArray, chart: FloatArray) -> Approach:
    """Plan a motion from the scene's posture to another one, `end` (n,), with the same tool pose.

    Along the self-motion, whose postures are `chart` (M, n), where that connects them free of collisions;
    otherwise through joint space.

    Raises
    ------
    PathNotFound
        When neither leads there.
    """
    robot, clearances, options = context.robot, context.clearances, context.options
    start = context.posture
    whole = FreeSpace(robot, clearances, options.safety_margin_m)
    for place, q in (("the scene's posture", start), ("the start of the work", end)):
        if whole.around(q[None]) is None:
            nearest = clearances.smallest(q[None])
            why, pair = f"{context.out_of_range(q[None])} is out of its range", None
            if nearest.distance[0] < options.safety_margin_m:
                shapes = clearances.pairs[nearest.pair[0]]
                pair = (shapes.link, shapes.other)
                why = f"{shapes.link} and {shapes.other} come within the safety margin"
            reason = f"no collision-free approach: in {place} {why}; start: pinned needs none"
            raise context.path_not_found(reason, start, pair=pair)
    space = whole.around(np.stack([start, end])) or whole
    path = _along_chart(space, start, end, chart, options.chart_spacing)
    along_self_motion = path is not None
    if path is None:
        path = connect(space, start, end, partial(context.reporter.expired, _MORE_TIME))
        if path is None:
            raise _unconnected(context, space, end)
        path = shorten(space, path)
    held = context.task.held_at_start()
    for halving in range(_HALVINGS):
        trajectory = _timed(robot, path, _KNOT_SPACING / 2**halving)
        certificate = certify_approach(robot, held, trajectory, clearances, options, start, end)
        if certificate.holds:
            break
    try:
        certificate.require()
    except LimitViolation as violation:
        reason = f"no approach to the start of the work is certified: {violation}"
        raise context.path_not_found(reason, start) from violation
    return Approach(
        trajectory=trajectory, certificate=certificate, task=held, along_self_motion=along_self_motion
    )


def _unconnected(context: PlanningContext, space: FreeSpace, end: FloatArray) -> PathNotFound:
    """The error of an approach that was not found: what is in the way on the straight line."""
    start = context.posture
    line = start + np.linspace(0.0, 1.0, _ON_THE_LINE)[:, None] * (end - start)
    blocked = line[~space.holds(line)]
    pair = context.most_often_near(blocked) if len(blocked) else None
    way = "" if pair is None else f" (straight there {pair[0]} and {pair[1]} come too near)"
    over = ", the time was over" if context.reporter.expired() else ""
    reason = (
        f"no collision-free approach to the start of the work was found{way}{over}; take start: pinned, or a "
        "posture_deg from which one leads there"
    )
    return context.path_not_found(reason, start, pair=pair)


def reachable(context: PlanningContext, chart: FloatArray) -> BoolArray:
    """Which postures of the start's chart (M, n) self-motion leads to from the scene's posture."""
    space = FreeSpace(context.robot, context.clearances, context.options.safety_margin_m)
    space = space.around(context.posture[None]) or space
    graph = _neighbours(space, context.posture[None], chart, context.options.chart_spacing)[1]
    _, component = connected_components(graph, directed=False)
    return np.asarray(component[1:] == component[0])


def certify_approach(
    robot: Robot,
    task: ToolTask,
    trajectory: QuinticTrajectory,
    clearances: Clearances,
    options: PlannerOptions,
    start: FloatArray,
    end: FloatArray,
) -> Certificate:
    """Certify an approach: the tool is off, so its place is measured, not bounded.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
        The tool held where the work starts, from `ToolTask.held_at_start`.
    trajectory : QuinticTrajectory
    clearances : Clearances
    options : PlannerOptions
    start, end : (n,), rad
        The scene's posture, and that in which the work starts.

    Returns
    -------
    Certificate
        It may not hold, as with `certify`.
    """
    return certify(robot, task, trajectory, clearances, options, via_points=None, start=start, end=end)


def _along_chart(
    space: FreeSpace, start: FloatArray, end: FloatArray, chart: FloatArray, spacing: float
) -> FloatArray | None:
    """Shortest path (k, n) between neighbouring postures of a chart; None where none connects the ends."""
    nodes, graph = _neighbours(space, np.stack([start, end]), chart, spacing)
    distance, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
    if not np.isfinite(distance[1]):
        return None
    indices = [1]
    while indices[-1] != 0:
        indices.append(int(before[indices[-1]]))
    return nodes[indices[::-1]]


def _neighbours(
    space: FreeSpace, ends: FloatArray, chart: FloatArray, spacing: float
) -> tuple[FloatArray, sparse.csr_array]:
    """Postures, those of `ends` (k, n) first, and the graph of distances between free neighbours."""
    nodes = np.vstack([ends, chart])
    pairs = cKDTree(nodes).query_pairs(_NEIGHBOURS * spacing, output_type="ndarray")
    free = space.holds(nodes)
    pairs = pairs[free[pairs].all(axis=1)]
    lengths = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
    # A duplicate of an end in the chart is at distance zero, which a sparse graph takes for no edge.
    lengths = np.maximum(lengths, 1e-12)
    shape = (len(nodes), len(nodes))
    return nodes, sparse.csr_array((lengths, (pairs[:, 0], pairs[:, 1])), shape=shape)


def _timed(robot: Robot, path: FloatArray, spacing: float) -> QuinticTrajectory:
    """Put a C3 spline from rest to rest through a broken line, as fast as the limits allow."""
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    knots = max(int(np.ceil(along[-1] / spacing)) + 1, 8)
    u = np.linspace(0.0, 1.0, knots)
    share = SpeedProfile(kind="jerk_limited", ramp=0.5).share(u)
    q = np.stack([np.interp(share * along[-1], along, joint) for joint in path.T], axis=1)
    space = SplineSpace(u)
    trial = space.trajectory(space.least_jerk(q))
    limits = robot.limits
    # Slowing down by T divides derivative k by T^k.
    seconds = max(
        float((trial.extrema(order).largest()[0] / (_LIMIT_SHARE * bound)).max()) ** (1.0 / order)
        for order, bound in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1)
    )
    return QuinticTrajectory(t=u * seconds, q=q, v=trial.v / seconds, a=trial.a / seconds**2)


@dataclass(frozen=True)
class FreeSpace:
    """Postures within the joint ranges whose shapes keep a margin, m, from each other.

    Beyond the margin, `spare`, m, is kept for the neighbours of a posture that is checked. With the default a
    line is free all along; with less only where it is checked, and a certificate has to cover the rest.
    """

    robot: Robot
    clearances: Clearances
    margin: float
    spare: float = _CHECK_EVERY / 2

    def around(self, q: FloatArray) -> FreeSpace | None:
        """Return the space that spares at most what postures `q` (N, n) spare; None when one is not free.

        Neighbouring links of some arms are always near each other and never spare much.
        """
        limits = self.robot.limits
        if ((q < limits.lower) | (q > limits.upper)).any():
            return None
        left = float(self.clearances.smallest(q).distance.min()) - self.margin
        return None if left < 0 else replace(self, spare=min(self.spare, _SHARE_TO_SPARE * left))

    def holds(self, q: FloatArray) -> BoolArray:
        """Which of the postures `q` (N, n) are free, and spare enough for their neighbours."""
        within = self.robot.limits.contain(q)
        free = within.copy()
        free[within] = ~self.clearances.check_collision(q[within], self.margin + self.spare)
        return free

    def straight(self, start: FloatArray, end: FloatArray) -> bool:
        """Whether the postures checked on the line between two postures (n,) are free."""
        moved = float(np.abs(end - start) @ self.clearances.reach)
        shares = np.linspace(0.0, 1.0, int(np.ceil(moved / _CHECK_EVERY)) + 1)[1:, None]
        return bool(self.holds(start + shares * (end - start)).all())


def connect(
    space: FreeSpace, start: FloatArray, end: FloatArray, stop: Callable[[], bool] = lambda: False
) -> FloatArray | None:
    """Connect two free postures (n,) by a broken line of free ones, (k, n); None when none was found.

    Two trees grow from both ends towards random postures and towards each other (RRT-Connect; Kuffner and
    LaValle, 2000). The random numbers are the same in every run. The search is given up when `stop` says so.
    """
    if space.straight(start, end):
        return np.stack([start, end])
    rng = np.random.default_rng(0)
    limits = space.robot.limits
    lower, upper = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    trees = (_Tree(start), _Tree(end))
    for growth in range(_MOST_GROWTHS):
        if stop():
            break
        tree, other = trees[growth % 2], trees[1 - growth % 2]
        new = tree.grow(space, rng.uniform(lower, upper))
        if new is None:
            continue
        while True:
            met = other.grow(space, tree.q[new])
            if met is None:
                break
            if np.array_equal(other.q[met], tree.q[new]):
                first, second = (new, met) if tree is trees[0] else (met, new)
                return np.vstack([trees[0].to_root(first)[::-1], trees[1].to_root(second)[1:]])
    return None


def shorten(space: FreeSpace, path: FloatArray) -> FloatArray:
    """Cut corners of a broken line (k, n) where the straight line is free."""
    rng = np.random.default_rng(0)
    for _ in range(_SHORTCUTS):
        if len(path) < 3:
            break
        first, second = np.sort(rng.choice(len(path), 2, replace=False))
        if second - first > 1 and space.straight(path[first], path[second]):
            path = np.vstack([path[: first + 1], path[second:]])
    return path


class _Tree:
    """A tree of free postures."""

    def __init__(self, root: FloatArray) -> None:
        self.q = root[None]
        self._parent = [-1]

    def grow(self, space: FreeSpace, target: FloatArray) -> int | None:
        """Take one step from the nearest posture towards `target`; return the new posture's index."""
        nearest = int(np.linalg.norm(self.q - target, axis=1).argmin())
        move = target - self.q[nearest]
        length = float(np.linalg.norm(move))
        if length == 0.0:
            return nearest
        new = target if length <= _STEP else self.q[nearest] + move * (_STEP / length)
        if not space.straight(self.q[nearest], new):
            return None
        self.q = np.vstack([self.q, new])
        self._parent.append(nearest)
        return len(self._parent) - 1

    def to_root(self, index: int) -> FloatArray:
        """Postures from number `index` to the root."""
        indices = [index]
        while self._parent[indices[-1]] >= 0:
            indices.append(self._parent[indices[-1]])
        return self.q[indices]
