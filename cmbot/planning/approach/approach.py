"""The approach: the motion from the scene's posture to the start of the work, with the tool off."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.planning.approach.joint_paths import FreeSpace, connect, shorten
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.task import ToolTask
from cmbot.planning.verification.certificate import Certificate, certify
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, SpeedProfile
from cmbot.trajectory import QuinticTrajectory, SplineSpace

__all__ = ["Approach", "certify_approach", "plan_approach"]

# Distance of the spline's knots along the path, rad; halved while the spline's certificate does not hold.
_KNOT_SPACING, _HALVINGS = 0.4, 4
# Share of the limits that the approach may use.
_LIMIT_SHARE = 0.95
# Postures of a chart are neighbours within this many spacings.
_NEIGHBOURS = 1.6
# Of the certificate: the tool is off and the motion slow, so a coarser grid than the work's suffices.
_SAMPLES_PER_SEGMENT = 10


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
    """Plan a motion from the scene's posture to another one with the same tool pose.

    Along the self-motion where that connects them, free of collisions; otherwise through joint space.

    Parameters
    ----------
    context : PlanningContext
    end : (n,), rad
    chart : (M, n), rad
        Postures of the self-motion there.

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
            raise context.path_not_found(
                f"no collision-free approach: {place} is out of range or within the safety margin", start
            )
    space = whole.around(np.stack([start, end])) or whole
    path = _along_chart(space, start, end, chart, options.chart_spacing)
    along_self_motion = path is not None
    if path is None:
        path = connect(space, start, end)
        if path is None:
            raise context.path_not_found(
                "no collision-free approach to the start of the work was found", start
            )
        path = shorten(space, path)
    held = context.task.held_at_start()
    for halving in range(_HALVINGS):
        trajectory = _timed(robot, path, _KNOT_SPACING / 2**halving)
        certificate = certify_approach(robot, held, trajectory, clearances, options)
        if certificate.holds:
            break
    certificate.require()
    return Approach(
        trajectory=trajectory, certificate=certificate, task=held, along_self_motion=along_self_motion
    )


def certify_approach(
    robot: Robot,
    task: ToolTask,
    trajectory: QuinticTrajectory,
    clearances: Clearances,
    options: PlannerOptions,
) -> Certificate:
    """Certify an approach on the grid of approaches.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
        The tool held where the work starts, from `ToolTask.held_at_start`.
    trajectory : QuinticTrajectory
    clearances : Clearances
    options : PlannerOptions

    Returns
    -------
    Certificate
        It may not hold, as with `certify`.
    """
    coarse = replace(options, samples_per_segment=_SAMPLES_PER_SEGMENT)
    return certify(robot, task, trajectory, trajectory.q, clearances, coarse, at_work=False)


def _along_chart(
    space: FreeSpace, start: FloatArray, end: FloatArray, chart: FloatArray, spacing: float
) -> FloatArray | None:
    """Shortest path (k, n) between neighbouring postures of a chart; None where none connects the ends."""
    nodes = np.vstack([start, end, chart])
    pairs = cKDTree(nodes).query_pairs(_NEIGHBOURS * spacing, output_type="ndarray")
    free = space.holds(nodes)
    pairs = pairs[free[pairs].all(axis=1)]
    lengths = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
    # A duplicate of an end in the chart is at distance zero, which a sparse graph takes for no edge.
    graph = sparse.csr_array(
        (np.maximum(lengths, 1e-12), (pairs[:, 0], pairs[:, 1])), shape=(len(nodes), len(nodes))
    )
    distance, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
    if not np.isfinite(distance[1]):
        return None
    indices = [1]
    while indices[-1] != 0:
        indices.append(int(before[indices[-1]]))
    return nodes[indices[::-1]]


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
