"""The floor: at one via-point no admissible posture has a smaller objective at rest.

Branch and bound over the self-motion: cells around the postures of a chart are halved wherever something
below the best admissible posture may lie. What may lie in a cell is told by differences of samples in it, so
the bound is an estimate, which gets sharp as the cells get small; it needs nothing of the objective but
values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.projection import null_space, project_onto_task
from cmbot.planning.selfmotion.dynamic_programming import blocked
from cmbot.planning.selfmotion.graph_layer import GraphLayer
from cmbot.robot import Postures

__all__ = ["LowerBound", "find_lower_bound"]

# The floor is known well enough to this share of it; cells are halved at most so many times along each edge.
_ACCURACY, _MOST_HALVINGS = 2e-6, 24
# Via-points that are looked at together where the self-motion is a curve; where it is wider they are looked
# at one by one, and at most so many cells are kept: the error says what that cost.
_TOGETHER, _MOST_CELLS = 4, 200
# Where cells had to be left out the best posture is settled by so many steps, so many tries each.
_STEPS, _TRIES, _SHORTER = 60, 40, 0.87
# Halves are taken so much longer than they are, for the curvature of the self-motion.
_WIDER = 1.1
# Cells in which the arm moves further than this, m, are not searched for clearances.
_WIDE = 0.3
# Joint torques beyond what a cell can hold are told from samples with this much doubt.
_DOUBT = 1.5


@dataclass(frozen=True, kw_only=True)
class LowerBound:
    """What no admissible plan can go below.

    Attributes
    ----------
    value : float
        The largest, over the via-points, of the smallest value at rest of any admissible posture there.
    error : float
        The true value lies at most so far below it, by an estimate from samples, and as far as the charts are
        complete.
    via_point : int
        Index of the via-point that sets it.
    each : (n,)
        The smallest value found at every via-point; only those that may set the floor are looked at closely.
    """

    value: float
    error: float
    via_point: int
    each: FloatArray


def find_lower_bound(
    context: PlanningContext, nodes: list[GraphLayer], spacing: float
) -> tuple[LowerBound, FloatArray]:
    """Find the floor from charts of the self-motion at all via-points.

    Parameters
    ----------
    setting : PlanningContext
    nodes : list of GraphLayer
    spacing : float
        Of the charts, rad.

    Returns
    -------
    floor : LowerBound
    posture : (d,), rad
        Admissible, with that value at that via-point.

    Raises
    ------
    PathNotFound
        When no posture of a chart is admissible.
    """
    each = np.array([node.least() for node in nodes])
    for k, least in enumerate(each):
        if not np.isfinite(least):
            raise blocked(context, nodes, k)
    search = _Search(context, nodes, spacing)
    postures = np.stack([node.chart.q[node.best()] for node in nodes])
    together = _TOGETHER if context.robot.dof - context.task.dimension == 1 else 1
    bound = np.full(len(each), -np.inf)
    order = np.argsort(-each)
    # From the largest down, until those looked at exceed all that are left: what is left only gets smaller.
    enough = -np.inf
    for first in range(0, len(order), together):
        some = order[first : first + together]
        if each[some[0]] <= enough:
            break
        # Those still open, at most: those looked at may close some of them.
        open_ = int((each[order[first:]] > enough).sum())
        context.reporter.part("finding the least torque at rest", first, first + open_, at_most=True)
        each[some], bound[some] = search.least(some, each[some], enough, postures)
        enough = max(enough, float(each[some].max()))
    looked = np.flatnonzero(np.isfinite(bound))
    where = int(looked[each[looked].argmax()])
    # No objective is ever negative, whatever samples of a wide self-motion leave open.
    error = float(each[where] - max(bound.max(), 0.0))
    return LowerBound(value=float(each[where]), error=error, via_point=where, each=each), postures[where]


@dataclass(frozen=True)
class _Cells:
    """Boxes on the self-motion: centres (M, n), unit edges (M, d, n), half lengths (M, d), via-points."""

    q: FloatArray
    edges: FloatArray
    half: FloatArray
    of: IntArray

    def __getitem__(self, index: BoolArray | IntArray) -> _Cells:
        return _Cells(self.q[index], self.edges[index], self.half[index], self.of[index])


@dataclass(frozen=True)
class _Content:
    """What is known of cells: the objective at the centre (M,), how far it may fall along edges (M, d)."""

    value: FloatArray
    fall: FloatArray

    @property
    def lowest(self) -> FloatArray:
        return np.asarray(self.value - self.fall.sum(axis=1))

    def __getitem__(self, index: BoolArray | IntArray) -> _Content:
        return _Content(self.value[index], self.fall[index])


class _Search:
    """Branch and bound at several via-points at a time."""

    def __init__(self, context: PlanningContext, nodes: list[GraphLayer], spacing: float) -> None:
        self._setting = context
        self._nodes = nodes
        self._spacing = spacing
        self._postures = Postures(context.robot)
        self._points = context.task.path.position(context.times)

    def least(
        self, some: IntArray, best: FloatArray, enough: float, postures: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Smallest admissible values at the via-points `some`, and what they cannot go below.

        Parameters
        ----------
        some : (s,)
        best : (s,)
            Values that are known to be admissible there.
        enough : float
            A via-point with an admissible value down here cannot set the floor; it is not looked at any
            closer, and nothing is said of what it cannot go below.
        postures : (n, d), rad
            Of all via-points, with the values known; better ones are put there.
        """
        best, left_out = best.copy(), np.full(len(some), np.inf)
        self._some, self._point_of = some, self._points[some]
        q = np.concatenate([self._nodes[k].chart.q for k in some])
        of = np.repeat(np.arange(len(some)), [len(self._nodes[k].chart.q) for k in some])
        edges = self._null_spaces(q)
        if edges.shape[1] == 0:
            # Without self-motion the postures that are known are all there are.
            return best, np.where(best > enough, best * (1 - _ACCURACY), -np.inf)
        cells = _Cells(q, edges, np.full(edges.shape[:2], self._spacing), of)
        for _ in range(_MOST_HALVINGS * edges.shape[1]):
            content, possible = self._content(cells)
            worth = possible & (content.lowest < best[cells.of] * (1 - _ACCURACY))
            cells, content = cells[worth], content[worth]
            best, possible = self._looked(cells, content.value, best, postures)
            worth = possible & (content.lowest < best[cells.of] * (1 - _ACCURACY))
            worth &= best[cells.of] > enough
            keep = worth & _most_promising(cells.of, np.where(worth, content.lowest, np.inf))
            dropped = worth & ~keep
            np.minimum.at(left_out, cells.of[dropped], content.lowest[dropped])
            cells, content = cells[keep], content[keep]
            if len(cells.q) == 0:
                break
            cells = self._halved(cells, content.fall)
        else:
            np.minimum.at(left_out, cells.of, np.tile(content.lowest, 2)[: len(cells.of)])
        if edges.shape[1] > 1:
            best = self._settled(best, postures, np.flatnonzero(best > enough))
        bound = np.minimum(left_out, best * (1 - _ACCURACY))
        return best, np.where(best > enough, bound, -np.inf)

    def _settled(self, best: FloatArray, postures: FloatArray, which: IntArray) -> FloatArray:
        """Values after random steps downwards, ever shorter ones, from the best postures known."""
        rng, best = np.random.default_rng(0), best.copy()
        for k in which:
            reach = self._spacing
            for _ in range(_STEPS):
                q = postures[self._some[k]]
                null = self._null_spaces(q[None])[0]
                moves = reach * rng.uniform(size=(_TRIES, 1)) * rng.normal(size=(_TRIES, len(null))) @ null
                placed, reached = project_onto_task(
                    self._postures, self._setting.task, q + moves, self._point_of[k]
                )
                some = placed[reached]
                value, _ = self._measured(some)
                cells = _Cells(
                    some, np.zeros((len(some), 1, len(q))), np.zeros((len(some), 1)), np.full(len(some), k)
                )
                better = value < best[k]
                best, _ = self._looked(cells[better], value[better], best, postures)
                reach *= _SHORTER
        return best

    def _null_spaces(self, q: FloatArray) -> FloatArray:
        return null_space(self._postures, self._setting.task, q)

    def _content(self, cells: _Cells) -> tuple[_Content, BoolArray]:
        """What the objective may fall to in each cell, and whether anything admissible may be in it."""
        N, d, n = cells.edges.shape
        limits = self._setting.robot.limits
        extent = np.einsum("kd,kdn->kn", cells.half, np.abs(cells.edges))
        possible = ((cells.q + extent >= limits.lower) & (cells.q - extent <= limits.upper)).all(axis=1)
        shifts = 0.5 * cells.half[:, :, None] * cells.edges
        around = np.stack([cells.q[:, None] + shifts, cells.q[:, None] - shifts], axis=2).reshape(-1, n)
        points = np.repeat(self._point_of[cells.of], 2 * d, axis=0)
        placed, reached = project_onto_task(self._postures, self._setting.task, around, points)
        value, use = self._measured(np.concatenate([cells.q, placed]))
        centre, centre_use = value[:N], use[:N]
        # Where a sample leaves the workspace, its cell counts as if it were as the centre there.
        beside = np.where(reached, value[N:], np.repeat(centre, 2 * d)).reshape(N, d, 2)
        beside_use = np.where(reached, use[N:], np.repeat(centre_use, 2 * d)).reshape(N, d, 2)
        slope = np.abs(beside[:, :, 0] - beside[:, :, 1])
        bend = np.sqrt(4 * np.abs(beside.sum(axis=2) - 2 * centre[:, None]))
        # Mixed second differences are taken to be as large as the others allow.
        fall = slope + 0.5 * bend * bend.sum(axis=1, keepdims=True)
        change = 2 * np.abs(beside_use - centre_use[:, None, None]).max(axis=2).sum(axis=1)
        possible &= centre_use - _DOUBT * change <= 1.0
        return _Content(centre, fall), possible

    def _measured(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Objective at rest and largest share of a joint torque's bound, (N,) each."""
        at = self._postures.at(q)
        use = (np.abs(at.joint_torque) / self._setting.robot.limits.torque).max(axis=1)
        return self._setting.objective.at_rest(at), use

    def _looked(
        self, cells: _Cells, value: FloatArray, best: FloatArray, postures: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Look at the clearances of cells: the best values then, and which cells may be clear somewhere."""
        context, limits = self._setting, self._setting.robot.limits
        margin = context.options.safety_margin_m
        within = ((cells.q >= limits.lower) & (cells.q <= limits.upper)).all(axis=1)
        hopeful = within & (value < best[cells.of])
        hopeful[hopeful] = self._measured(cells.q[hopeful])[1] <= 1.0
        reach = np.einsum("kd,kdn,n->k", cells.half, np.abs(cells.edges), context.clearances.reach)
        # Cells that reach further hold something clear nearly always.
        look = np.flatnonzero(hopeful | (reach < _WIDE))
        # How much it is that is missing costs more to know than that something is.
        near = look[context.clearances.check_collision(cells.q[look], margin)]
        distance = np.full(len(value), np.inf)
        distance[near] = context.clearances.smallest(cells.q[near]).distance
        admissible = hopeful & (distance >= margin)
        best = best.copy()
        for k in np.flatnonzero(admissible):
            if value[k] < best[cells.of[k]]:
                best[cells.of[k]], postures[self._some[cells.of[k]]] = value[k], cells.q[k]
        return best, distance + reach >= margin

    def _halved(self, cells: _Cells, fall: FloatArray) -> _Cells:
        """Halve every cell along the edge that matters most; where none does, along the longest."""
        k = np.arange(len(cells.q))
        matters = fall.max(axis=1) > _ACCURACY * np.abs(fall).max()
        edge = np.where(matters, fall.argmax(axis=1), cells.half.argmax(axis=1))
        shift = 0.5 * cells.half[k, edge, None] * cells.edges[k, edge]
        half = cells.half.copy()
        half[k, edge] *= 0.5 * _WIDER
        of = np.tile(cells.of, 2)
        around = np.concatenate([cells.q + shift, cells.q - shift])
        q, reached = project_onto_task(self._postures, self._setting.task, around, self._point_of[of])
        # The parent's edges, turned the least way into the self-motion here.
        null = self._null_spaces(q)
        U, _, V = np.linalg.svd(np.tile(cells.edges, (2, 1, 1)) @ null.transpose(0, 2, 1))
        return _Cells(q, U @ V @ null, np.tile(half, (2, 1)), of)[reached]


def _most_promising(of: IntArray, lowest: FloatArray) -> BoolArray:
    """Which cells have one of the smallest finite `lowest` values at their via-point."""
    keep = np.zeros(len(of), dtype=np.bool_)
    for k in np.unique(of):
        mine = np.flatnonzero((of == k) & np.isfinite(lowest))
        keep[mine[np.argsort(lowest[mine])[:_MOST_CELLS]]] = True
    return keep
