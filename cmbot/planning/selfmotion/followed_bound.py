"""What sequences of postures that the joints can follow ask at least: the charts' dynamic program with room.

The lower bound is that of one via-point. The postures of least value at several of them are often on
different branches of the self-motion, or too far from each other in the time that there is, so that any plan
asks much more. The bound here allows for that. It is an estimate, as charts may miss postures; for what lies
between their postures there is room: every posture of the self-motion is within a spacing of one of its
chart, so steps may be longer by two spacings than the velocity bounds say, and a posture counts half way to
the lowest one beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.charts import GraphLayer, best_nodes, charts_of
from cmbot.planning.selfmotion.dynamic_programming import BottleneckDynamicProgram, blocked, edges_along
from cmbot.planning.selfmotion.sampler import SelfMotionSampler

# Postures within this many spacings are beside each other.
_NEIGHBOUR_SPACINGS = 1.5


def followed_bound(request: StrokeRequest, layers: Sequence[GraphLayer], spacing: float) -> float:
    """Estimate what sequences of postures that the joints can follow ask at rest, at least.

    Parameters
    ----------
    request : StrokeRequest
    layers : sequence of GraphLayer
        Of all its via-points.
    spacing : float, rad
        Of the charts.

    Raises
    ------
    PathNotFound
        When no sequence leads along the path even so.
    """
    cell = request.cell
    room = 2 * spacing / cell.robot.metric.weight
    steps = cell.robot.limits.velocity * np.diff(request.times)[:, None] + room
    lower = [layer.between(_NEIGHBOUR_SPACINGS * spacing) for layer in layers]
    links = edges_along(lower, steps, cell.robot.limits.winding)
    starts = np.ones(len(lower[0].chart.q), dtype=np.bool_)
    chosen = BottleneckDynamicProgram(request, lower, links, starts).best()
    return max(float(layer.chart.value[k]) for layer, k in zip(lower, chosen, strict=True))


def quick_bound(request: StrokeRequest, via_points: int) -> float:
    """Return the followed bound of charts at few via-points, without a lower bound of each.

    Zero where the tool's axis may lean: charts hold it in the middle of its cone.

    Parameters
    ----------
    request : StrokeRequest
        Whose work starts in a posture that holds the tool.
    via_points : int

    Raises
    ------
    PathNotFound
        When some via-point has no admissible posture, or no sequence leads along the path.
    """
    if request.task.cone is not None:
        return 0.0
    request = replace(request, times=np.linspace(0.0, request.task.path.duration, via_points))
    sampler = SelfMotionSampler(request)
    each = sampler.along(request.goals, request.first[None])
    layers = [GraphLayer(request.cell, chart) for chart in charts_of(request.cell, each)]
    empty = next((k for k, best in enumerate(best_nodes(layers)) if best is None), None)
    if empty is not None:
        raise blocked(request, layers, empty, sampler.coverage)
    return followed_bound(request, layers, sampler.spacing)
