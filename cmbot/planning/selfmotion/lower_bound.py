"""The lower bound: at one via-point no admissible posture has a smaller objective at rest.

Branch and bound over the self-motion: cells around the postures of a chart are halved wherever values below
the incumbent may lie. Values in a cell are bounded by differences of samples in it, so the bound is an
estimate, which gets sharp as the cells get small; it needs only values of the objective. It is one in two
ways: charts may miss postures (`Coverage`), and cells may hold smaller values than their samples tell.

For many arms `proof` then proves the bound, or a better one, without charts and samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cmbot.common.arrays import Batch, BoolArray, FloatArray, IntArray
from cmbot.common.reading.file_types import Count, NonNegative, Row, Share
from cmbot.common.representation import ShortRepr
from cmbot.planning.postures.projection import null_space, project_onto_task
from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.charts import GraphLayer
from cmbot.planning.selfmotion.proof import TorqueFloorProof
from cmbot.planning.selfmotion.sampler import Coverage

# What progress says of the search.
_PROGRESS_PHRASE = "finding the least torque at rest"
# Accuracy of the bound, as a share of it, and halvings of a cell at most along each edge.
_BOUND_ACCURACY_SHARE, _MAX_CELL_HALVINGS = 2e-6, 24
# Via-points that are searched together where the self-motion is a curve; where it is wider they are searched
# one by one, and this many cells are kept at most in two dimensions, the fewer the more there are: the error
# includes the cells that are left out.
_TOGETHER, _MOST_CELLS = 4, 200
# Random descent where cells had to be left out: steps, tries in each, factor of their length.
_DESCENT_STEPS, _TRIES_PER_STEP, _SHORTER = 60, 40, 0.87
# Factor of the length of halves, for the curvature of the self-motion.
_HALF_LENGTH_FACTOR = 1.1
# In cells in which the arm moves further than this, m, clearances are not computed.
_MAX_CLEARANCE_CELL_M = 0.3
# Where the tool's axis may lean, cells reach as far as it may, but no further than this, rad; and the slowest
# rate at which it counts as leaning, rad/rad.
_MAX_LEANING_CELL_RAD, _SLOWEST = 0.8, 1e-6
# Safety factor of the estimated change of joint torques within a cell.
_VARIATION_SAFETY = 1.5
# A bound counts as proven when the proof's error is at most this share of it; where a proof meets a posture
# that is lower by more than the other share, the bound is lowered to that.
_PROVEN, _LOWERED = 1e-3, 1e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class LowerBound(ShortRepr):
    """A lower bound of the peak of the objective at rest, over all admissible plans.

    Attributes
    ----------
    value : float
        The largest, over the via-points, of the smallest value at rest of any admissible posture there.
    error : float
        How far the true value may lie below it. Of a proven bound: no admissible plan rests below ``value -
        error``. Of an estimated one: by an estimate from samples, among the postures that were charted.
    via_point : int
        Index of the via-point that sets it.
    each : (n,)
        The smallest value found at every via-point; exact only where it may set the bound.
    kind : str
        ``proven`` or ``estimated``.
    missed : float or None
        Of an estimated bound: the share of the postures within the joint ranges that the charts may have
        missed at most, at 95 % confidence, among those that random restarts find (`Coverage.share`). None
        where it is proven or not known.
    """

    value: NonNegative
    error: NonNegative
    via_point: Count
    each: Row
    kind: Literal["proven", "estimated"] = "estimated"
    missed: Share | None = None

    def met(self, values: FloatArray) -> LowerBound:
        """Return it for a plan with `values` (n,) at rest at the via-points: no estimate is above them."""
        found = float(values[self.via_point])
        if self.kind == "proven" or found >= self.value:
            return self
        each = self.each.copy()
        each[self.via_point] = found
        return replace(self, value=found, error=max(self.error - (self.value - found), 0.0), each=each)

    @property
    def basis(self) -> str:
        """What it rests on, in words."""
        if self.kind == "proven":
            return "proven"
        if self.missed is None:
            return "estimate"
        return f"estimate; at most {100 * self.missed:.2f} % of the postures are missed, with 95 % confidence"


def find_lower_bound(
    request: StrokeRequest, layers: Sequence[GraphLayer], spacing: float
) -> tuple[LowerBound, FloatArray]:
    """Find the lower bound from charts of the self-motion at all via-points, each with an admissible posture.

    Returns it and an admissible posture (d,), rad, with that value at that via-point.
    """
    best = [layer.best() for layer in layers]
    each = np.array([layer.chart.value[k] for layer, k in zip(layers, best, strict=True)])
    postures = np.stack([layer.chart.q[k] for layer, k in zip(layers, best, strict=True)])
    is_wide = request.cell.robot.dof - request.task.dimension > 1
    if is_wide and not request.proves:
        # Of one plan of many: the charts' least, without a search that takes longer than they do.
        where = int(each.argmax())
        value = float(each[where])
        return LowerBound(value=value, error=value, via_point=where, each=each), postures[where]
    search = _BranchAndBound(request, layers, spacing)
    bound = (_searched_one_by_one if is_wide else _searched_together)(request, search, each, postures)
    searched = np.flatnonzero(np.isfinite(bound))
    # Where all is negligible nothing was searched.
    where = int(searched[each[searched].argmax()] if len(searched) else each.argmax())
    # No objective is negative, whatever samples of a wide self-motion leave open.
    error = float(each[where] - max(bound.max(), 0.0))
    return LowerBound(value=float(each[where]), error=error, via_point=where, each=each), postures[where]


def _searched_together(
    request: StrokeRequest, search: _BranchAndBound, each: FloatArray, postures: FloatArray
) -> FloatArray:
    """Lower the values `each` (n,) where they may set the bound, several at a time; bounds (n,) of them."""
    bound = np.full(len(each), -np.inf)
    order = np.argsort(-each)
    # From the largest down, until the incumbent exceeds the values of all that are left, which only decrease.
    incumbent = -np.inf
    for first in range(0, len(order), _TOGETHER):
        some = order[first : first + _TOGETHER]
        # The bound at each via-point is one of the whole path, so the search may end early.
        if each[some[0]] <= incumbent or (first > 0 and request.deadline.expired()):
            break
        # The search of these may close some of the others.
        open_ = int((each[order[first:]] > incumbent).sum())
        request.reporter.part(_PROGRESS_PHRASE, first, first + open_)
        each[some], bound[some] = search.minimise(some, each[some], incumbent, postures)
        incumbent = max(incumbent, float(each[some].max()))
    return bound


def _searched_one_by_one(
    request: StrokeRequest, search: _BranchAndBound, each: FloatArray, postures: FloatArray
) -> FloatArray:
    """The same where the self-motion is wide: by descent, and by search only where that leaves the largest.

    A descent costs a tenth of a search, and nearly always shows that a via-point does not set the bound.
    Values that are negligible are not searched.
    """
    least = request.negligible
    bound, descended = np.full(len(each), -np.inf), np.zeros(len(each), dtype=np.bool_)
    while True:
        k = int(each.argmax())
        searched = np.isfinite(bound)
        late = searched.any() and request.deadline.expired()
        if searched[k] or late or each[k] <= least:
            return bound
        request.reporter.part(_PROGRESS_PHRASE, int(descended.sum()), len(each))
        if not descended[k]:
            enough = float(each[descended].max(initial=least))
            each[k] = search.descend(k, each[k], enough, postures)
            descended[k] = each[k] > enough
            continue
        incumbent = float(each[searched].max(initial=least))
        each[[k]], bound[[k]] = search.minimise(np.array([k]), each[[k]], incumbent, postures)


def with_proof(
    request: StrokeRequest, bound: LowerBound, posture: FloatArray, coverage: Coverage
) -> tuple[LowerBound, FloatArray]:
    """Return a lower bound proven where that is possible, otherwise called an estimate.

    Parameters
    ----------
    request : StrokeRequest
    bound : LowerBound
    posture : (n,), rad
        Has its value at its via-point.
    coverage : Coverage
        Of the charts that it comes from.

    Returns
    -------
    bound : LowerBound
    posture : (n,), rad
        As before, or better: a proof may meet one that the charts missed.
    """
    estimate = replace(bound, kind="estimated", missed=coverage.share)
    prover = TorqueFloorProof.of(request) if request.proves else None
    if prover is None:
        return estimate, posture
    request.reporter.step("proving the lower bound")
    proof = prover.prove(bound.via_point, bound.value)
    value = bound.value
    if proof.posture is not None and proof.value < value * (1 - _LOWERED):
        # The charts missed this one.
        value, posture = proof.value, proof.posture
    each = bound.each.copy()
    each[bound.via_point] = value
    error = value - proof.lowest
    if error > _PROVEN * value:
        return replace(estimate, value=value, each=each), posture
    return replace(bound, value=value, error=error, each=each, kind="proven"), posture


@dataclass(frozen=True, eq=False)
class _Cells(Batch):
    """Boxes on the self-motion: centres (M, n), unit edges (M, d, n), half lengths (M, d), via-points."""

    q: FloatArray
    edges: FloatArray
    half: FloatArray
    of: IntArray


class _BranchAndBound:
    """Branch and bound at several via-points at a time."""

    def __init__(self, request: StrokeRequest, layers: Sequence[GraphLayer], spacing: float) -> None:
        self._request, self._cell, self._task = request, request.cell, request.task
        self._layers = layers
        self._spacing = spacing

    def minimise(
        self, some: IntArray, best: FloatArray, incumbent: float, postures: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Smallest admissible values (s,) at the via-points `some` (s,), and lower bounds of them.

        `best` (s,) are values known to be admissible there, `postures` (n, d) those of all via-points that
        have them; better ones replace them. A via-point with an admissible value down to `incumbent` cannot
        set the lower bound: its search ends, and its bound is minus infinity.
        """
        best, left_out = best.copy(), np.full(len(some), np.inf)
        self._some, self._goals = some, self._request.goals[some]
        charts = [self._layers[k].chart.q for k in some]
        q, of = np.concatenate(charts), np.repeat(np.arange(len(some)), [len(chart) for chart in charts])
        edges = self._null_space(q)
        half = np.full(edges.shape[:2], self._spacing)
        if self._task.cone is not None:
            edges, half = self._leaning(q, edges, of, self._task.cone)
        if edges.shape[1] == 0:
            # Without self-motion there are no other postures.
            return best, np.where(best > incumbent, best * (1 - _BOUND_ACCURACY_SHARE), -np.inf)
        cells, most = _Cells(q, edges, half, of), _MOST_CELLS // max(edges.shape[1] - 1, 1)
        for _ in range(_MAX_CELL_HALVINGS * edges.shape[1]):
            cells = cells[self._in_range_somewhere(cells)]
            if len(cells.q) == 0:
                break
            value, fall, possible = self._bounded(cells)
            lowest = value - fall.sum(axis=1)
            if self._request.deadline.expired():
                np.minimum.at(left_out, cells.of, lowest)
                break
            worth = possible & (lowest < best[cells.of] * (1 - _BOUND_ACCURACY_SHARE))
            cells, value, fall, lowest = cells[worth], value[worth], fall[worth], lowest[worth]
            best, possible = self._checked(cells, value, best, postures)
            worth = (
                possible
                & (lowest < best[cells.of] * (1 - _BOUND_ACCURACY_SHARE))
                & (best[cells.of] > incumbent)
            )
            keep = worth & _most_promising(cells.of, np.where(worth, lowest, np.inf), most)
            dropped = worth & ~keep
            np.minimum.at(left_out, cells.of[dropped], lowest[dropped])
            cells, lowest = cells[keep], lowest[keep]
            if len(cells.q) == 0:
                break
            cells = self._halved(cells, fall[keep])
        else:
            np.minimum.at(left_out, cells.of, np.tile(lowest, 2)[: len(cells.of)])
        if edges.shape[1] > 1:
            best = self._descended(best, postures, np.flatnonzero(best > incumbent))
        bound = np.minimum(left_out, best * (1 - _BOUND_ACCURACY_SHARE))
        return best, np.where(best > incumbent, bound, -np.inf)

    def descend(self, via_point: int, best: float, enough: float, postures: FloatArray) -> float:
        """Lower the admissible value `best` of a via-point by descent, to `enough` at most.

        From its own posture among `postures` (n, d), which is replaced, or those of its neighbours.
        """
        self._some = np.array([via_point])
        self._goals = self._request.goals[self._some]
        beside = postures[[k for k in (via_point - 1, via_point + 1) if 0 <= k < len(postures)]]
        near, reached = self._placed(beside, np.zeros(len(beside), dtype=np.intp))
        values = self._lowered(near[reached], 0, np.array([best]), postures)
        return float(self._descended(values, postures, np.zeros(1, dtype=np.intp), enough)[0])

    def _descended(
        self, best: FloatArray, postures: FloatArray, which: IntArray, enough: float = -np.inf
    ) -> FloatArray:
        """Values after random steps of decreasing length from the best postures known."""
        rng, best = np.random.default_rng(0), best.copy()
        for k in which:
            reach = self._spacing
            for _ in range(_DESCENT_STEPS):
                if self._request.deadline.expired() or best[k] <= enough:
                    break
                q = postures[self._some[k]]
                null = self._null_space(q[None])[0]
                moves = (
                    reach
                    * rng.uniform(size=(_TRIES_PER_STEP, 1))
                    * rng.normal(size=(_TRIES_PER_STEP, len(null)))
                    @ null
                )
                placed, reached = self._placed(q + moves, np.full(_TRIES_PER_STEP, k))
                best = self._lowered(placed[reached], int(k), best, postures)
                reach *= _SHORTER
        return best

    def _lowered(self, q: FloatArray, k: int, best: FloatArray, postures: FloatArray) -> FloatArray:
        """Values `best` (s,), that of `k` lowered to what admissible postures (N, d) have."""
        value = self._cell.objective.at_rest(self._cell.postures.at(q))
        better = np.flatnonzero(value < best[k])
        better = better[np.argsort(value[better], kind="stable")]
        best, first, count = best.copy(), 0, 4
        while first < len(better):
            some = better[first : first + count]
            some = some[self._admissible_but_for_clearance(q[some], np.full(len(some), k))]
            clear = some[self._cell.clear(q[some])]
            if len(clear):
                # The lowest that is admissible is all that counts.
                best[k], postures[self._some[k]] = value[clear[0]], q[clear[0]]
                break
            first, count = first + count, 2 * count
        return best

    def _leaning(
        self, q: FloatArray, edges: FloatArray, of: IntArray, cone: float
    ) -> tuple[FloatArray, FloatArray]:
        """Edges turned so that the last ones do not lean the tool's axis; half lengths that reach its cone.

        Postures `q` (M, n) at the via-points `of` (M,) are those of charts, which hold the axis somewhere in
        it.
        """
        task, at = self._task, self._cell.postures.tool_at(q)
        leans = task.on_axis.jacobian(at.tool_rotation, at.jacobian)[:, 3:] @ edges.transpose(0, 2, 1)
        _, rate, V = np.linalg.svd(leans)
        half = np.full(edges.shape[:2], self._spacing)
        away = cone + task.rotation(at.tool_rotation, self._goals[of])
        half[:, : rate.shape[1]] = np.minimum(
            away[:, None] / np.maximum(rate, _SLOWEST), _MAX_LEANING_CELL_RAD
        )
        return V @ edges, half

    def _null_space(self, q: FloatArray) -> FloatArray:
        return null_space(self._cell.postures, self._task, q)

    def _placed(self, q: FloatArray, of: IntArray) -> tuple[FloatArray, BoolArray]:
        """Postures projected onto the task at their via-points, and which of them lie on it."""
        return project_onto_task(self._cell.postures, self._task, q, self._goals[of])

    def _bounded(self, cells: _Cells) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Values at the centres, how far they may fall along each edge, and which cells may be admissible."""
        N, d, n = cells.edges.shape
        shifts = 0.5 * cells.half[:, :, None] * cells.edges
        around = np.stack([cells.q[:, None] + shifts, cells.q[:, None] - shifts], axis=2).reshape(-1, n)
        placed, reached = self._placed(around, np.repeat(cells.of, 2 * d))
        at = self._cell.postures.at(np.concatenate([cells.q, placed]))
        value, use = self._cell.objective.at_rest(at), self._cell.use_at_rest(at)
        centre, centre_use = value[:N], use[:N]
        # A sample outside the workspace counts as the centre of its cell.
        beside = np.where(reached, value[N:], np.repeat(centre, 2 * d)).reshape(N, d, 2)
        beside_use = np.where(reached, use[N:], np.repeat(centre_use, 2 * d)).reshape(N, d, 2)
        slope = np.abs(beside[:, :, 0] - beside[:, :, 1])
        bend = np.sqrt(4 * np.abs(beside.sum(axis=2) - 2 * centre[:, None]))
        # Mixed second differences are taken to be as large as the others allow.
        fall = slope + 0.5 * bend * bend.sum(axis=1, keepdims=True)
        change = 2 * np.abs(beside_use - centre_use[:, None, None]).max(axis=2).sum(axis=1)
        return centre, fall, centre_use - _VARIATION_SAFETY * change <= 1.0

    def _in_range_somewhere(self, cells: _Cells) -> BoolArray:
        """Which cells may reach into the joint ranges."""
        limits = self._cell.robot.limits
        extent = np.einsum("kd,kdn->kn", cells.half, np.abs(cells.edges))
        inside = (cells.q + extent >= limits.lower) & (cells.q - extent <= limits.upper)
        return np.asarray(inside.all(axis=1))

    def _checked(
        self, cells: _Cells, value: FloatArray, best: FloatArray, postures: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Compute clearances in cells: the best values then, and which cells may be clear somewhere."""
        limits, clearances = self._cell.robot.limits, self._cell.clearances
        hopeful = value < best[cells.of]
        hopeful[hopeful] = self._admissible_but_for_clearance(cells.q[hopeful], cells.of[hopeful])
        reach = np.einsum("kd,kdn,n->k", cells.half, np.abs(cells.edges), clearances.reach)
        # Cells that reach further are nearly always clear somewhere.
        check = np.flatnonzero(hopeful | (reach < _MAX_CLEARANCE_CELL_M))
        near = check[~self._cell.clear(cells.q[check])]
        blocked = np.zeros(len(value), dtype=np.bool_)
        least = self._cell.options.safety_margin_m - reach[near]
        blocked[near] = clearances.query(cells.q[near], least).distance < least
        best, hopeful[near] = best.copy(), False
        for k in np.flatnonzero(hopeful):
            if value[k] < best[cells.of[k]]:
                best[cells.of[k]], postures[self._some[cells.of[k]]] = value[k], cells.q[k]
        turn = np.einsum("kd,kdn,n->k", cells.half, np.abs(cells.edges), ~limits.prismatic)
        return best, ~blocked & (self._beyond_cone(cells.q, cells.of) <= turn)

    def _admissible_but_for_clearance(self, q: FloatArray, of: IntArray) -> BoolArray:
        """Which postures keep to joint ranges, joint torques and the cone of the tool's axis."""
        holds = self._cell.robot.limits.contain(q) & (self._beyond_cone(q, of) <= 0.0)
        holds[holds] = self._cell.strong(self._cell.postures.at(q[holds]))
        return np.asarray(holds)

    def _beyond_cone(self, q: FloatArray, of: IntArray) -> FloatArray:
        """By how much the tool's axis leans out of its cone, rad; negative within."""
        task = self._task
        if task.cone is None:
            return np.full(len(q), -np.inf)
        return task.rotation(self._cell.postures.tool_at(q).tool_rotation, self._goals[of]) - task.cone

    def _halved(self, cells: _Cells, fall: FloatArray) -> _Cells:
        """Halve every cell along the edge of the largest fall; where none falls, along the longest."""
        k = np.arange(len(cells.q))
        falls = fall.max(axis=1) > _BOUND_ACCURACY_SHARE * np.abs(fall).max()
        edge = np.where(falls, fall.argmax(axis=1), cells.half.argmax(axis=1))
        shift = 0.5 * cells.half[k, edge, None] * cells.edges[k, edge]
        half = cells.half.copy()
        half[k, edge] *= 0.5 * _HALF_LENGTH_FACTOR
        of = np.tile(cells.of, 2)
        q, reached = self._placed(np.concatenate([cells.q + shift, cells.q - shift]), of)
        # The parent's edges, turned the least way into the self-motion here.
        null, metric = self._null_space(q), self._cell.robot.metric
        both = metric.coordinates(np.tile(cells.edges, (2, 1, 1)))
        U, _, V = np.linalg.svd(both @ metric.coordinates(null).transpose(0, 2, 1))
        return _Cells(q, U @ V @ null, np.tile(half, (2, 1)), of)[reached]


def _most_promising(of: IntArray, lowest: FloatArray, most: int) -> BoolArray:
    """Which cells have one of the `most` smallest finite `lowest` values at their via-point."""
    keep = np.zeros(len(of), dtype=np.bool_)
    for k in np.unique(of):
        mine = np.flatnonzero((of == k) & np.isfinite(lowest))
        keep[mine[np.argsort(lowest[mine])[:most]]] = True
    return keep
