"""The approach: the motion from the scene's posture to the start of the work, with the tool off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import LimitViolation, PathNotFound
from cmbot.optimization import StateSamples
from cmbot.planning.context import PlanningContext
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.planning.free_motion.graph import graph_of, path_between_ends
from cmbot.planning.free_motion.roadmap import lower_peak
from cmbot.planning.free_motion.rrt_connect import rrt_connect
from cmbot.planning.objectives import efforts_of
from cmbot.planning.task import ToolTask
from cmbot.planning.verification.certificate import Certificate, certify
from cmbot.robot import Dynamics, Robot
from cmbot.scene import PlannerOptions, SpeedProfile
from cmbot.trajectory import QuinticTrajectory, SplineSpace

__all__ = ["Approach", "certify_approach", "plan_approach", "reachable"]

# Distance of the spline's knots along the path, rad; halved while the spline's certificate does not hold.
_KNOT_SPACING, _HALVINGS = 0.4, 4
# Share of the time left that the search for an approach may take, as without one there are other starts, and
# share of the time limit that it has in any case: no plan is complete without one.
_TIME_SHARE, _MORE_TIME = 0.4, 0.2
# Share of the limits that the approach may use.
_LIMIT_SHARE = 0.95
# Postures of a chart are neighbours within this many spacings.
_NEIGHBOURS = 1.6
# Postures of the straight line to the start of the work that are looked at where nothing leads there.
_ON_THE_LINE = 50
# Values of the objective that differ by less are the same, relative.
_SAME = 1e-3
# Factors on the shortest duration, while the moving arm asks more than it may, and samples a segment to see.
_SLOWER, _SAMPLES = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0), 8
# An objective below this is nothing.
_NO_TORQUE = 1e-9


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


def plan_approach(
    context: PlanningContext, end: FloatArray, chart: FloatArray, *, allowed: float = 0.0
) -> Approach:
    """Plan a motion from the scene's posture to another one, `end` (n,), with the same tool pose.

    Along the self-motion, whose postures are `chart` (M, n), where that connects them free of collisions;
    else straight in joint space; else on any free path. Where the objective at rest would exceed both its
    value at the ends and `allowed`, a path is sought on which its largest value is least.

    Parameters
    ----------
    context : PlanningContext
    end : (n,), rad
    chart : (M, n), rad
    allowed : float
        Value of the objective that the work reaches anyway.

    Raises
    ------
    PathNotFound
        When nothing leads there.
    """
    context = context.tool_off
    robot, clearances, options = context.robot, context.clearances, context.options
    start = context.posture
    whole = _free_space(context)
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
    allowed = (1 + _SAME) * max(allowed, *space.cost(np.stack([start, end])))
    along = _along_chart(space, start, end, chart, options.chart_spacing)
    stop = context.reporter.part_expired(_TIME_SHARE, _MORE_TIME)
    path = _path(space, start, end, along, allowed, stop)
    if path is None:
        raise _unconnected(context, space, end)
    held = context.task.held_at_start()
    for halving in range(_HALVINGS):
        trajectory = _timed(context, path, _KNOT_SPACING / 2**halving, allowed)
        certificate = certify_approach(robot, held, trajectory, clearances, options, start, end)
        if certificate.holds:
            break
    try:
        certificate.require()
    except LimitViolation as violation:
        reason = f"no approach to the start of the work is certified: {violation}"
        raise context.path_not_found(reason, start) from violation
    return Approach(
        trajectory=trajectory, certificate=certificate, task=held, along_self_motion=path is along
    )


def _unconnected(context: PlanningContext, space: FreeSpace, end: FloatArray) -> PathNotFound:
    """The error of an approach that was not found: what is in the way on the straight line."""
    start = context.posture
    line = start + np.linspace(0.0, 1.0, _ON_THE_LINE)[:, None] * (end - start)
    blocked = line[~space.holds(line)]
    heavy = blocked[np.isinf(space.cost(blocked))]
    way, pair = "", None
    if 2 * len(heavy) > len(blocked):
        way = f" (straight there {context.weakest_joint(heavy)} cannot hold the arm)"
    elif len(blocked) and (pair := context.most_often_near(blocked)):
        way = f" (straight there {pair[0]} and {pair[1]} come too near)"
    over = ", the time was over" if context.reporter.expired() else ""
    reason = (
        f"no collision-free approach to the start of the work was found{way}{over}; take start: pinned, or a "
        "start posture from which one leads there"
    )
    return context.path_not_found(reason, start, pair=pair)


def _free_space(context: PlanningContext) -> FreeSpace:
    limit = context.robot.limits.torque

    def cost(q: FloatArray) -> FloatArray:
        at = context.postures.at(q)
        holds = (np.abs(at.joint_torque) <= limit).all(axis=1)
        return np.where(holds, context.objective.at_rest(at), np.inf)

    return FreeSpace(context.robot, context.clearances, context.options.safety_margin_m, cost)


def _path(
    space: FreeSpace,
    start: FloatArray,
    end: FloatArray,
    along: FloatArray | None,
    allowed: float,
    stop: Callable[[], bool],
) -> FloatArray | None:
    """A free path (k, n): the first whose peak is allowed, else one whose peak is as low as was found."""
    found = []
    if along is not None:
        found.append(along)
    straight = np.stack([start, end])
    if space.straight(start, end):
        found.append(straight)
    if not found and (path := rrt_connect(space, start, end, stop)) is not None:
        found.append(space.shorten(path))
    for path in found:
        if space.peak(path) <= allowed:
            return path
    if not found:
        return None
    path = lower_peak(space, min(found, key=space.peak), allowed, stop)
    return space.below(max(allowed, space.peak(path))).shorten(path)


def reachable(context: PlanningContext, chart: FloatArray) -> BoolArray:
    """Which postures of the start's chart (M, n) self-motion leads to from the scene's posture."""
    space = _free_space(context.tool_off)
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
    """Certify an approach: the tool is off, so no force acts on it, and its place is measured, not bounded.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
        The tool held where the work starts, from `ToolTask.held_at_start`.
    trajectory : QuinticTrajectory
    clearances : Clearances
    options : PlannerOptions
    start, end : (n,)
        The scene's posture, and that in which the work starts.

    Returns
    -------
    Certificate
        It may not hold, as with `certify`.
    """
    off = robot.tool_off
    return certify(off, task, trajectory, clearances, options, via_points=None, start=start, end=end)


def _along_chart(
    space: FreeSpace, start: FloatArray, end: FloatArray, chart: FloatArray, spacing: float
) -> FloatArray | None:
    """Shortest path (k, n) between neighbouring postures of a chart; None where none connects the ends."""
    nodes, graph = _neighbours(space, np.stack([start, end]), chart, spacing)
    path = path_between_ends(graph)
    return None if path is None else nodes[path]


def _neighbours(
    space: FreeSpace, ends: FloatArray, chart: FloatArray, spacing: float
) -> tuple[FloatArray, sparse.csr_array]:
    """Postures, those of `ends` (k, n) first, and the graph of distances between free neighbours."""
    nodes, metric = np.vstack([ends, chart]), space.robot.metric
    pairs = cKDTree(metric.coordinates(nodes)).query_pairs(_NEIGHBOURS * spacing, output_type="ndarray")
    free = space.holds(nodes)
    pairs = pairs[free[pairs].all(axis=1)]
    lengths = metric.lengths(nodes[pairs[:, 0]] - nodes[pairs[:, 1]])
    return nodes, graph_of(len(nodes), pairs, lengths)


def _timed(context: PlanningContext, path: FloatArray, spacing: float, allowed: float) -> QuinticTrajectory:
    """Put a C3 spline from rest to rest through a broken line, as fast as limits and objective allow."""
    lengths = context.robot.metric.lengths(np.diff(path, axis=0))
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    knots = max(int(np.ceil(along[-1] / spacing)) + 1, 8)
    u = np.linspace(0.0, 1.0, knots)
    share = SpeedProfile(kind="jerk_limited", ramp=0.5).share(u)
    q = np.stack([np.interp(share * along[-1], along, joint) for joint in path.T], axis=1)
    space = SplineSpace(u)
    trial = space.trajectory(space.least_jerk(q))
    limits = context.robot.limits
    # Slowing down by T divides derivative k by T^k.
    seconds = max(
        float((trial.extrema(order).largest()[0] / (_LIMIT_SHARE * bound)).max()) ** (1.0 / order)
        for order, bound in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1)
    )
    at_rest = _asked(context, StateSamples.at_rest(u, trial.q), allowed)
    for slower in _SLOWER:
        T = slower * seconds
        timed = QuinticTrajectory(t=u * T, q=q, v=trial.v / T, a=trial.a / T**2)
        if _asked(context, StateSamples.even(timed, _SAMPLES), allowed) <= (1 + _SAME) * max(at_rest, 1.0):
            break
    return timed


def _asked(context: PlanningContext, states: StateSamples, allowed: float) -> float:
    """The largest share of what is allowed that states ask of the objective and of the joints."""
    torque = efforts_of(Dynamics(context.robot), states).joint_torque
    use = float((np.abs(torque) / (_LIMIT_SHARE * context.robot.limits.torque)).max())
    return max(use, float(context.objective.values(states).max()) / max(allowed, _NO_TORQUE))
