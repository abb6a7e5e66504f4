"""Wide self-motions: charts of them are coarse, so there is more to look at beside the ways that matter.

`ways_beside` adds to the charts what lies beside the ways of given postures. `refined` makes a way better
round by round: around its postures others are taken, nearer ones in every round, and dynamic programming
picks the best way through all of these: iterative dynamic programming (Luus, 1990). The way before is always
among them, so its peak never rises.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.projection import null_space, project_onto_task
from cmbot.planning.selfmotion.charts import charts_of
from cmbot.planning.selfmotion.dynamic_programming import BottleneckDynamicProgram, edges_between
from cmbot.planning.selfmotion.graph_layer import GraphLayer
from cmbot.robot import Postures

__all__ = ["refined", "ways_beside"]

# Postures that are tried around each in every round, rounds, and by how much they come nearer from one to the
# next.
_AROUND, _ROUNDS, _NEARER = 30, 24, 0.8
# A peak this near the floor, as a share of it, needs no further round.
_NEAR_THE_FLOOR = 1e-3
# Ways beside one.
_BESIDE = 40


def ways_beside(
    context: PlanningContext, posture: FloatArray, via_point: int, spacing: float
) -> list[FloatArray]:
    """Return what a posture becomes at all via-points, as far as it gets, and what lies beside that.

    Parameters
    ----------
    setting : PlanningContext
    posture : (d,), rad
        At the via-point with that index.
    via_point : int
    spacing : float
        How far beside, rad.

    Returns
    -------
    list of (m, d), rad
        One for every via-point.
    """
    rng, postures = np.random.default_rng(0), Postures(context.robot)
    points = context.task.path.position(context.times)
    # The same offsets all along make ways that run side by side.
    offsets = rng.normal(size=(_BESIDE, len(posture)))
    offsets *= spacing * rng.uniform(size=(_BESIDE, 1)) / np.linalg.norm(offsets, axis=1, keepdims=True)
    each = [np.empty((0, len(posture))) for _ in points]
    for way in (range(via_point, len(points)), range(via_point - 1, -1, -1)):
        q = posture
        for k in way:
            placed, reached = project_onto_task(
                postures, context.task, np.vstack([q, q + offsets]), points[k]
            )
            if not reached[0]:
                break
            each[k], q = placed[reached], placed[0]
    return each


def refined(
    context: PlanningContext,
    q: FloatArray,
    steps: FloatArray,
    reach: float,
    floor: float,
    *,
    start_stays: bool,
) -> FloatArray:
    """Lower the peak of the objective at rest along a way.

    Parameters
    ----------
    setting : PlanningContext
    q : (k, n), rad
        Admissible postures at the via-points, one after the other within `steps`.
    steps : (k - 1, n), rad
        The longest that the joints may move between via-points.
    reach : float, rad
        How far from them others are tried at first.
    floor : float
        What the peak cannot fall below.
    start_stays : bool
        The first posture is not changed.

    Returns
    -------
    (k, n), rad
    """
    rng, postures = np.random.default_rng(0), Postures(context.robot)
    endless, margin = np.isinf(context.robot.limits.lower), context.options.safety_margin_m
    for done in range(_ROUNDS):
        context.reporter.part("refining the choice", done, _ROUNDS, at_most=True)
        each = _candidates(context, postures, q, reach, rng)
        if start_stays:
            each[0] = q[:1]
        charts = charts_of(postures, context.robot.limits, context.objective, each)
        nodes = [GraphLayer(chart, context.clearances, margin) for chart in charts]
        links = [
            edges_between(a, b, step, endless) for (a, b), step in zip(pairwise(nodes), steps, strict=True)
        ]
        starts = np.ones(len(each[0]), dtype=np.bool_)
        chosen = BottleneckDynamicProgram(context, nodes, links, starts).best()
        q = np.stack([chart.q[k] for chart, k in zip(charts, chosen, strict=True)])
        if max(chart.value[k] for chart, k in zip(charts, chosen, strict=True)) <= floor * (
            1 + _NEAR_THE_FLOOR
        ):
            break
        reach *= _NEARER
    return q


def _candidates(
    context: PlanningContext, postures: Postures, q: FloatArray, reach: float, rng: np.random.Generator
) -> list[FloatArray]:
    """Postures at every via-point: those of the way, what its neighbours become there, and others around."""
    n, d = q.shape
    points = context.task.path.position(context.times)
    null = null_space(postures, context.task, q)
    directions = rng.normal(size=(n, _AROUND, null.shape[1]))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    # As many far as near: the square of the share counts.
    length = reach * rng.uniform(0, 1, (n, _AROUND, 1)) ** 2
    around = q[:, None] + (length * directions) @ null
    neighbours = np.stack([np.vstack([q[:1], q[:-1]]), np.vstack([q[1:], q[-1:]])], axis=1)
    some = np.concatenate([neighbours, around], axis=1).reshape(-1, d)
    of = np.repeat(np.arange(n), _AROUND + 2)
    placed, reached = project_onto_task(postures, context.task, some, points[of])
    return [np.vstack([q[k : k + 1], placed[reached & (of == k)]]) for k in range(n)]
