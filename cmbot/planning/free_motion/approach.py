"""The approach: the free move from where the arm is to the start of a stroke."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning.budget import MORE_TIME
from cmbot.planning.free_motion.free_move import FreeMove, find_way, free_space, plan_move
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.planning.free_motion.graph import graph_of, path_between_ends
from cmbot.planning.free_motion.rrt_connect import MOST_GROWTHS, rrt_connect
from cmbot.planning.job import Segment, free_move_name, stands_of
from cmbot.planning.request import StrokeRequest

# Postures to which trees grow at once at most.
_MAX_GOALS = 40
# Growths of trees at most that seek the way to a better start. Of 12 ways in random scenes one took more than
# half of that, and asked more than the work.
_MAX_START_GROWTHS = 1500
# Postures of a chart are neighbours within this many spacings.
_NEAR_SPACINGS = 1.6


def plan_approach(
    request: StrokeRequest,
    end: FloatArray,
    chart: FloatArray,
    *,
    way: FloatArray | None = None,
    allowed: float = 0.0,
    dispensable: bool = False,
) -> Segment:
    """Plan the free move from the scene's posture to another one, `end` (n,), with the same tool pose.

    Along the self-motion, whose postures are `chart` (M, n), where that connects them free of collisions;
    else as `plan_move` does.

    Parameters
    ----------
    request : StrokeRequest
    end : (n,), rad
    chart : (M, n), rad
    way : (k, n), rad, optional
        A free broken line to a posture of the chart from which self-motion leads to `end`.
    allowed : float
        Value of the objective that the work reaches anyway.
    dispensable : bool
        The work can start in the scene's posture, too, or where trees lead to one of many starts: no long
        search for the way to this one.

    Raises
    ------
    PathNotFound
        When nothing leads there.
    """
    return plan_move(request, _move(request, end, chart, way, allowed, dispensable))


def approach_way(
    request: StrokeRequest, end: FloatArray, chart: FloatArray, *, dispensable: bool = False
) -> FloatArray:
    """Return a free broken line (k, n) on which an approach may lead to `end` (n,), as `plan_approach`."""
    return find_way(request, _move(request, end, chart, None, 0.0, dispensable))


def _move(
    request: StrokeRequest,
    end: FloatArray,
    chart: FloatArray,
    way: FloatArray | None,
    allowed: float,
    dispensable: bool,
) -> FreeMove:
    """An approach, its way along the self-motion first."""
    start, spacing = request.state.posture, request.cell.options.chart_spacing

    def along_chart(space: FreeSpace) -> FloatArray | None:
        return _along_chart(space, np.stack([start, end]), chart, spacing)

    def known(space: FreeSpace) -> FloatArray | None:
        if way is None:
            return None
        turned = request.cell.robot.limits.turned_towards(end, chart)
        rest = _along_chart(space, np.stack([way[-1], end]), turned, spacing)
        return None if rest is None else np.vstack([way, rest[1:]])

    name = free_move_name(request.number)
    return FreeMove(
        name=name,
        start=start,
        end=end,
        start_name=_before_in_words(request),
        end_name="the start of the work" if request.number == 0 else f"the start of {request.stroke.name}",
        begin=request.state.begin,
        allowed=max(allowed, request.state.reached),
        most_growths=_MAX_START_GROWTHS if dispensable else MOST_GROWTHS,
        first=along_chart,
        known=known,
        stands=stands_of(name, request.cell.robot.tool_ramp),
    )


def _before_in_words(request: StrokeRequest) -> str:
    """What messages call the posture in which the arm is before."""
    if request.number == 0:
        return "the scene's posture"
    return f"the end of stroke {request.strokes[request.number - 1].name}"


def reachable(request: StrokeRequest, chart: FloatArray) -> BoolArray:
    """Which postures of the start's chart (M, n) self-motion leads to from the scene's posture."""
    space = free_space(request.cell.tool_off)
    space = space.around(request.state.posture[None]) or space
    graph = _neighbours(space, request.state.posture[None], chart, request.cell.options.chart_spacing)[1]
    _, component = connected_components(graph, directed=False)
    return np.asarray(component[1:] == component[0])


def joined_starts(request: StrokeRequest, chart: FloatArray) -> Iterator[tuple[BoolArray, FloatArray]]:
    """Yield which postures of the start's chart (M, n) a free move leads to from the scene's posture.

    And the move: a broken line (k, n) to one of them.

    Trees grow to one posture of each part of the chart at once, in which self-motion leads everywhere, until
    one is joined; then to the others, where its postures have led nowhere.
    """
    cell = request.cell
    whole = free_space(cell.tool_off)
    space = whole.around(request.state.posture[None]) or whole
    chart = cell.robot.limits.turned_towards(request.state.posture, chart)
    free = np.flatnonzero(space.holds(chart))
    if not len(free):
        return
    nodes, graph = _neighbours(space, chart[free], chart[:0], cell.options.chart_spacing)
    number, part = connected_components(graph, directed=False)
    largest = np.argsort(-np.bincount(part, minlength=number), kind="stable")[:_MAX_GOALS]
    cost = space.cost(nodes)
    goals = [min(np.flatnonzero(part == k), key=lambda at: float(cost[at])) for k in largest]
    stop = partial(request.deadline.expired, MORE_TIME)
    while goals and not stop():
        path = rrt_connect(space, request.state.posture, nodes[goals], stop)
        if path is None:
            return
        joined = int(np.abs(nodes[goals] - path[-1]).max(axis=1).argmin())
        starts = np.zeros(len(chart), dtype=np.bool_)
        starts[free[part == part[goals.pop(joined)]]] = True
        yield starts, path


def _along_chart(space: FreeSpace, ends: FloatArray, chart: FloatArray, spacing: float) -> FloatArray | None:
    """Shortest path (k, n) between neighbouring postures of a chart; None where none connects the ends."""
    nodes, graph = _neighbours(space, ends, chart, spacing)
    path = path_between_ends(graph)
    return None if path is None else nodes[path]


def _neighbours(
    space: FreeSpace, ends: FloatArray, chart: FloatArray, spacing: float
) -> tuple[FloatArray, sparse.csr_array]:
    """Postures, those of `ends` (k, n) first, and the graph of distances between free neighbours."""
    nodes, metric = np.vstack([ends, chart]), space.robot.metric
    pairs = cKDTree(metric.coordinates(nodes)).query_pairs(_NEAR_SPACINGS * spacing, output_type="ndarray")
    free = space.holds(nodes)
    pairs = pairs[free[pairs].all(axis=1)]
    lengths = metric.lengths(nodes[pairs[:, 0]] - nodes[pairs[:, 1]])
    return nodes, graph_of(len(nodes), pairs, lengths)
