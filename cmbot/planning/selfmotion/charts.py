"""Charts of self-motion: the postures that hold the tool task at one point of the path, as graph layers."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.workcell.workcell import Workcell
from cmbot.robot import PostureMetric

# Postures within this many spacings of each other are on the same part of the self-motion.
_NEIGHBOUR_SPACINGS = 1.5
# Charts that are evaluated at once: more only need memory, beyond the processor's cache.
_CHARTS_PER_BATCH = 10


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """Postures that hold the tool task at one point.

    Angles of joints that can turn by more than a whole turn are given on one turn.
    """

    q: FloatArray  # (M, n), rad and m
    value: FloatArray  # (M,), the objective at rest
    joint_use: FloatArray  # (M,), largest share of their bounds used at rest; may be less where it is below 1
    within: BoolArray  # (M,), which lie within the joint ranges; the others only connect them


def charts_of(cell: Workcell, each: Sequence[FloatArray]) -> list[Chart]:
    """Return charts of given postures, arrays (M, n)."""
    limits, charts = cell.robot.limits, list[Chart]()
    for first in range(0, len(each), _CHARTS_PER_BATCH):
        some = each[first : first + _CHARTS_PER_BATCH]
        q = np.vstack(some)
        at = cell.postures.at(q)
        value = cell.objective.at_rest(at)
        use = cell.use_at_rest(at, 1.0)
        within = limits.contain(q)
        ends = np.cumsum([0, *(len(part) for part in some)])
        charts += [
            Chart(q=q[a:b], value=value[a:b], joint_use=use[a:b], within=within[a:b])
            for a, b in pairwise(ends)
        ]
    return charts


def connected_parts(q: FloatArray, within: BoolArray, spacing: float, metric: PostureMetric) -> IntArray:
    """Number the connected parts of a chart's postures `q` (M, n); -1 for those not `within` the ranges."""
    chosen = np.flatnonzero(within)
    tree = cKDTree(metric.on_one_turn(q[chosen]), boxsize=metric.period)
    pairs = tree.query_pairs(_NEIGHBOUR_SPACINGS * spacing, output_type="ndarray")
    graph = sparse.csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=2 * (len(chosen),))
    label = np.full(len(q), -1, dtype=np.intp)
    label[chosen] = connected_components(graph, directed=False)[1]
    return label


class GraphLayer:
    """The postures (M, n) of one chart as nodes of a graph search, whose clearances are computed when needed.

    `admissible` (M,) are the nodes not known to be inadmissible, `too_near` (M,) those that are known to come
    within the safety margin.
    """

    def __init__(self, cell: Workcell, chart: Chart) -> None:
        self.chart = chart
        self.admissible = chart.within & (chart.joint_use <= 1.0)
        self.too_near = np.zeros(len(chart.q), dtype=np.bool_)
        self._checked = ~self.admissible
        self.cell = cell

    def between(self, distance: float) -> GraphLayer:
        """Return the layer with each value half way to the lowest one within a distance, rad.

        What is known of clearances is shared with it.
        """
        chart, metric = self.chart, self.cell.robot.metric
        tree = cKDTree(metric.on_one_turn(chart.q), boxsize=metric.period)
        i, j = tree.query_pairs(distance, output_type="ndarray").T
        lowest = chart.value.copy()
        np.minimum.at(lowest, i, chart.value[j])
        np.minimum.at(lowest, j, chart.value[i])
        lower = copy.copy(self)
        lower.chart = replace(chart, value=0.5 * (chart.value + lowest))
        return lower

    def unchecked(self, which: BoolArray | IntArray | int) -> IntArray:
        """Return the nodes of `which` whose clearances are not known."""
        chosen = np.zeros_like(self._checked)
        chosen[which] = True
        return np.flatnonzero(chosen & ~self._checked)

    def note(self, nodes: IntArray, near: BoolArray) -> None:
        """Note which of `nodes` (k,) come within the safety margin."""
        self._checked[nodes] = True
        self.too_near[nodes] = near
        self.admissible[nodes] = ~near

    def most_promising(self, number: int) -> IntArray:
        """Return that many nodes of the smallest values, as far as these may be admissible."""
        nodes = np.flatnonzero(self.admissible)
        return nodes[np.argsort(self.chart.value[nodes], kind="stable")[:number]]

    def best(self) -> int | None:
        """Return the index of the admissible node with the smallest value; None when there is none."""
        return best_nodes([self])[0]


class LayerCache:
    """Layers of charts: those of charts that stay are kept, with what is known of their clearances."""

    def __init__(self, cell: Workcell) -> None:
        self._cell = cell
        # By the arrays' identities; the arrays are kept so that these stay theirs.
        self._known: dict[int, tuple[FloatArray, GraphLayer]] = {}

    def layers(self, each: Sequence[FloatArray]) -> list[GraphLayer]:
        """Return the layers of charts, arrays (M, n); those of other charts are forgotten."""
        new = [q for q in each if id(q) not in self._known]
        made = iter(charts_of(self._cell, new))
        all_ = [self._known.get(id(q)) or (q, GraphLayer(self._cell, next(made))) for q in each]
        self._known = {id(q): (q, layer) for q, layer in all_}
        return [layer for _, layer in all_]


def check_clearances(layers: Sequence[GraphLayer], which: Sequence[BoolArray | IntArray | int]) -> BoolArray:
    """Compute clearances of the nodes `which` of each layer at once, which is quicker than one by one.

    Returns in which layers any turned out inadmissible.
    """
    new = [layer.unchecked(nodes) for layer, nodes in zip(layers, which, strict=True)]
    ends = np.cumsum([0, *(len(nodes) for nodes in new)])
    if ends[-1] == 0:
        return np.zeros(len(layers), dtype=np.bool_)
    cell = layers[0].cell
    q = np.vstack([layer.chart.q[nodes] for layer, nodes in zip(layers, new, strict=True)])
    near = ~cell.clear(q)
    each = [near[a:b] for a, b in pairwise(ends)]
    for layer, nodes, of_layer in zip(layers, new, each, strict=True):
        layer.note(nodes, of_layer)
    return np.array([of_layer.any() for of_layer in each])


def best_nodes(layers: Sequence[GraphLayer]) -> list[int | None]:
    """Return the admissible node with the smallest value of each layer; None where there is none."""
    number = 1
    while True:
        first = [layer.most_promising(1) for layer in layers]
        unknown = [len(layer.unchecked(nodes)) > 0 for layer, nodes in zip(layers, first, strict=True)]
        if not any(unknown):
            return [int(nodes[0]) if len(nodes) else None for nodes in first]
        # Where the first one comes too near, those beside it are likely to, as well.
        number_of = [number if each else 0 for each in unknown]
        some = [layer.most_promising(n) for layer, n in zip(layers, number_of, strict=True)]
        check_clearances(layers, some)
        number *= 2
