"""Dynamic programming over the charts: the best sequence of postures that the joints can follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.postures.projection import null_space
from cmbot.planning.postures.sampler import PostureSampler
from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.charts import GraphLayer, best_nodes, charts_of, check_clearances
from cmbot.planning.selfmotion.reachability import out_of_reach
from cmbot.planning.selfmotion.sampler import Coverage
from cmbot.planning.workcell.diagnosis import most_often_near, out_of_range, weakest_joint

# Weight of the squared steps, in shares of what the joints may do between via-points, beside the squared
# objective.
_STEP_WEIGHT = 0.02
# Nodes beside one that is refused whose clearances are computed with it.
_CHECKED_BESIDE = 32
# A step in units of itself, with room for rounding.
_MAX_UNIT_STEP = 1 + 1e-9
# Of the refinement: postures drawn around each in every round, rounds, the factor of their distance from one
# round to the next, and the gap to the lower bound, as a share of it, that ends them.
_AROUND, _REFINEMENT_ROUNDS, _SPREAD_FACTOR, _BOUND_GAP_SHARE = 30, 24, 0.8, 1e-3


@dataclass(frozen=True, eq=False)
class Edges:
    """Which postures of one via-point can follow which of the one before, as a sparse list.

    Postures are given by their indices, ascending in `after`, then in `before`.
    """

    before: IntArray  # (E,)
    after: IntArray  # (E,)
    length: FloatArray  # (E,), sum of the joints' squared moves, in units of the longest they can make
    number: int  # of the postures after

    def smallest(self, value: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the smallest of the edges' values (E,) to each posture, and the first edge that has it.

        Infinite where no edge leads.
        """
        least, which = self.least(value), np.zeros(self.number, dtype=np.intp)
        best = np.flatnonzero(value == least[self.after])[::-1]
        which[self.after[best]] = best
        return least, which

    def least(self, value: FloatArray) -> FloatArray:
        """Return the smallest of the edges' values (E,) to each posture; infinite where no edge leads."""
        least = np.full(self.number, np.inf)
        if len(value):
            least[self.after[self._first]] = np.minimum.reduceat(value, self._first)
        return least

    def within(
        self, q_a: FloatArray, q_b: FloatArray, step: FloatArray, winding: BoolArray, usable: BoolArray
    ) -> Edges:
        """Return those of them that are `usable` (E,), within shorter steps (n,); see `edges`."""
        kept = np.flatnonzero(usable)
        moves = _moves(q_a[self.before[kept]], q_b[self.after[kept]], winding) / step
        short = (np.abs(moves) <= 1.0).all(axis=1)
        kept = kept[short]
        return Edges(self.before[kept], self.after[kept], (moves[short] ** 2).sum(axis=1), self.number)

    @cached_property
    def _first(self) -> IntArray:
        """The first edge to each posture with edges."""
        return np.flatnonzero(np.diff(self.after, prepend=-1))


def edges(q_a: FloatArray, q_b: FloatArray, step: FloatArray, winding: BoolArray) -> Edges:
    """Find which postures `q_b` (N, n) can follow which of `q_a` (M, n) by moves within `step` (n,), rad.

    Angles of the joints `winding` (n,), which can turn by more than a whole turn, count modulo a turn.
    """
    turn = np.where(winding, 2 * np.pi / step, 0.0)
    # A tree with a box is slower, also without periods.
    box = turn if winding.any() else None
    trees = (cKDTree(_in_steps(q, step, turn), boxsize=box) for q in (q_a, q_b))
    near = next(trees).sparse_distance_matrix(next(trees), _MAX_UNIT_STEP, p=np.inf, output_type="ndarray")
    before, after = near["i"], near["j"]
    moves = _moves(q_a[before], q_b[after], winding) / step
    reachable = (np.abs(moves) <= 1.0).all(axis=1)
    order = np.flatnonzero(reachable)
    order = order[np.lexsort((before[order], after[order]))]
    return Edges(before[order], after[order], (moves[order] ** 2).sum(axis=1), len(q_b))


def _moves(q_a: FloatArray, q_b: FloatArray, winding: BoolArray) -> FloatArray:
    """Moves (E, n) between postures, the shorter way round of joints that turn by more than a whole turn."""
    moves = q_a - q_b
    if winding.any():
        moves[:, winding] = nearest_turn(moves[:, winding])
    return moves


def edges_along(
    layers: Sequence[GraphLayer],
    steps: FloatArray,
    winding: BoolArray,
    known: Sequence[Edges] = (),
    longer: Sequence[Edges] = (),
) -> list[Edges]:
    """Find the edges between layers, `steps` (k, n) apart at most; see `edges`.

    Nodes that are known to be inadmissible have none, and from those to which none leads there are none.
    `known` are those between the first layers, `longer` such of longer steps between all.
    """
    found, reached = list[Edges](), layers[0].admissible
    for k, ((before, after), step) in enumerate(zip(pairwise(layers), steps, strict=True)):
        if k < len(known):
            found.append(known[k])
        elif longer:
            usable = (before.admissible & reached)[longer[k].before] & after.admissible[longer[k].after]
            found.append(longer[k].within(before.chart.q, after.chart.q, step, winding, usable))
        else:
            i, j = np.flatnonzero(before.admissible & reached), np.flatnonzero(after.admissible)
            few = edges(before.chart.q[i], after.chart.q[j], step, winding)
            found.append(Edges(i[few.before], j[few.after], few.length, len(after.chart.q)))
        reached = np.zeros(len(after.chart.q), dtype=np.bool_)
        reached[found[-1].after] = True
    return found


def _in_steps(q: FloatArray, step: FloatArray, turn: FloatArray) -> FloatArray:
    """Postures (N, n) in units of steps, on the circle where a turn has a length."""
    q = q / step
    round_ = turn > 0
    q[:, round_] %= turn[round_]
    # A tiny negative angle rounds up to a whole turn.
    return np.where(round_ & (q >= turn), 0.0, q)


def nearest_turn(angle: FloatArray) -> FloatArray:
    """Angles less whole turns, from half a turn back to half a turn forth, rad."""
    return np.asarray(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))


@dataclass(frozen=True, eq=False)
class BottleneckDynamicProgram:
    """Dynamic programming over the layers of all via-points.

    `starts` (M,) says in which nodes of the first layer a path may start.
    """

    request: StrokeRequest
    layers: Sequence[GraphLayer]
    edges: list[Edges]
    starts: BoolArray

    def best(self) -> list[int]:
        """Indices of the nodes with the smallest peak; among those, with the smallest sum of squares."""
        around, least = 0, self._least_peak()
        while True:
            peak = max(self._smallest_peak(), least)
            chosen = self._smallest_squares(peak)
            # Clearances cost most, so only those of the best path are computed at first. If they hold, no
            # path is better, whatever the clearances beside it.
            refused = np.flatnonzero(check_clearances(self.layers, chosen))
            if len(refused) == 0:
                return chosen
            # Neighbours of a refused node are likely to be refused, too. They reach further from round to
            # round, so that there are few rounds.
            distance = np.abs(np.arange(len(self.layers))[:, None] - refused).min(axis=1)
            near = np.flatnonzero(distance <= around).tolist()
            some = [_neighbours(self.layers[k], chosen[k], peak) for k in near]
            check_clearances([self.layers[k] for k in near], some)
            around = 2 * around + 1

    def _least_peak(self) -> float:
        """Largest of the smallest values of each via-point: no sequence has a smaller peak."""
        start = self.layers[0].admissible & self.starts
        least = self.layers[0].chart.value[start].min(initial=np.inf)
        for layer, best in zip(self.layers, best_nodes(self.layers), strict=True):
            least = max(least, np.inf if best is None else layer.chart.value[best])
        return float(least)

    def _smallest_peak(self) -> float:
        """Smallest peak of any sequence of nodes that are not known to be inadmissible."""
        reached, origins = np.empty(0), self.starts
        for k, layer in enumerate(self.layers):
            before = self.edges[k - 1].least(reached[self.edges[k - 1].before]) if k else -np.inf
            allowed = layer.admissible if k else layer.admissible & self.starts
            reached = np.where(allowed, np.maximum(before, layer.chart.value), np.inf)
            if not np.isfinite(reached).any():
                raise blocked(self.request, self.layers, k, origins=origins)
            origins = np.isfinite(reached)
        return float(reached.min())

    def _smallest_squares(self, peak: float) -> list[int]:
        """Nodes with no value above `peak` and the smallest sum of squared values and steps."""
        first = self.layers[0]
        allowed = first.admissible & (first.chart.value <= peak) & self.starts
        cost = np.where(allowed, first.chart.value**2, np.inf)
        came_from = []
        for layer, edge in zip(self.layers[1:], self.edges, strict=True):
            summed = cost[edge.before] + _STEP_WEIGHT * peak**2 * edge.length
            cost, which = edge.smallest(summed)
            came_from.append(edge.before[which] if len(summed) else which)
            allowed = layer.admissible & (layer.chart.value <= peak)
            cost = np.where(allowed, cost + layer.chart.value**2, np.inf)
        chosen = [int(cost.argmin())]
        for origin in reversed(came_from):
            chosen.append(int(origin[chosen[-1]]))
        return chosen[::-1]


def _neighbours(layer: GraphLayer, node: int, peak: float) -> IntArray:
    """The nodes nearest to one of a layer that may be admissible, with values up to `peak`."""
    nodes = layer.unchecked(layer.admissible & (layer.chart.value <= peak))
    away = np.abs(layer.chart.q[nodes] - layer.chart.q[node]).max(axis=1)
    return nodes[np.argsort(away, kind="stable")[:_CHECKED_BESIDE]]


def refine(
    request: StrokeRequest,
    q: FloatArray,
    steps: FloatArray,
    reach: float,
    lower_bound: float,
    winding: BoolArray,
    *,
    start_stays: bool,
) -> FloatArray:
    """Lower the peak of the objective at rest by iterative dynamic programming (Luus, 1990).

    Around the admissible postures `q` (k, n) others are drawn, at first up to `reach`, rad, from them, nearer
    ones in every round. Dynamic programming finds the best sequence of all these within `steps` (k - 1, n),
    rad; the joints `winding` (n,) count modulo a turn. The sequence before is among them, so the peak never
    rises; near `lower_bound` the rounds end.
    """
    rng = np.random.default_rng(0)
    for done in range(_REFINEMENT_ROUNDS):
        if request.deadline.expired():
            break
        request.reporter.part("refining the choice", done, _REFINEMENT_ROUNDS)
        each = _candidates(request, q, reach, rng)
        if start_stays:
            each[0] = q[:1]
        charts = charts_of(request.cell, each)
        layers = [GraphLayer(request.cell, chart) for chart in charts]
        links = edges_along(layers, steps, winding)
        starts = np.ones(len(each[0]), dtype=np.bool_)
        chosen = BottleneckDynamicProgram(request, layers, links, starts).best()
        q = np.stack([chart.q[k] for chart, k in zip(charts, chosen, strict=True)])
        peak = max(chart.value[k] for chart, k in zip(charts, chosen, strict=True))
        if peak <= lower_bound * (1 + _BOUND_GAP_SHARE):
            break
        reach *= _SPREAD_FACTOR
    return q


def _candidates(
    request: StrokeRequest, q: FloatArray, reach: float, rng: np.random.Generator
) -> list[FloatArray]:
    """Postures at every via-point: its own, those of its neighbours projected there, and others around."""
    n, d = q.shape
    null = null_space(request.cell.postures, request.task, q)
    directions = rng.normal(size=(n, _AROUND, null.shape[1]))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    # The square of the share draws more postures near by.
    length = reach * rng.uniform(0, 1, (n, _AROUND, 1)) ** 2
    around = q[:, None] + (length * directions) @ null
    neighbours = np.stack([np.vstack([q[:1], q[:-1]]), np.vstack([q[1:], q[-1:]])], axis=1)
    some = np.concatenate([neighbours, around], axis=1).reshape(-1, d)
    of = np.repeat(np.arange(n), _AROUND + 2)
    sampler = PostureSampler(cell=request.cell, task=request.task, steps=6)
    placed, reached = sampler.within_cone(some, request.goals[of])
    return [np.vstack([q[k : k + 1], placed[reached & (of == k)]]) for k in range(n)]


def blocked(
    request: StrokeRequest,
    layers: Sequence[GraphLayer],
    k: int,
    coverage: Coverage | None = None,
    origins: BoolArray | None = None,
) -> PathNotFound:
    """Return the error that says why no sequence leads to via-point `k`, or through it.

    `origins` (M,) are the postures from which one would lead there: of the via-point before, at the first
    those in which it may start.
    """
    layer, pair, pace, place = layers[k], None, 1.0, f"via-point {k + 1} of {len(layers)}"
    tried = "" if coverage is None else f" in {coverage.drawn} attempts"
    # Of what is not proven it is said that nothing was found.
    opening = f"no way was found through {place}"
    if not layer.chart.within.any():
        joint = out_of_range(request.cell, layer.chart.q)
        beyond = f" (beyond its range is most often {joint})" if joint else ""
        found = f"no posture within the joint ranges that holds the tool there was found{tried}{beyond}"
        proven = out_of_reach(request, k)
        if proven:
            opening = f"{place} is blocked"
        why = proven or found
    elif not layer.admissible.any():
        why, pair = _inadmissible(request, layer)
    elif k == 0:
        opening = f"{place} is blocked"
        why, pair = _no_start(request, layer, origins)
    else:
        joint, pace = _slowest(request, layers, k, origins)
        why = (
            f"its admissible postures, as far as they were found, are {pace:.3g} times too far from those "
            f"before for the velocity of {joint}"
        )
    q = layer.chart.q if len(layer.chart.q) else layers[k - 1].chart.q
    return request.path_not_found(f"{opening}: {why}", q[0], request.times[k], pair, pace)


def _inadmissible(request: StrokeRequest, layer: GraphLayer) -> tuple[str, tuple[str, str] | None]:
    """Why no posture of a chart is admissible, and the pair that most often comes too near."""
    weak = layer.chart.within & (layer.chart.joint_use > 1.0)
    near, feeble = int(layer.too_near.sum()), int(weak.sum())
    tried = f"of {int(layer.chart.within.sum())} postures that were tried there"
    holding = request.cell.robot.holding
    much = "too much of a joint or foot" if holding and holding.bounded else "too much of a joint's torque"
    if near >= feeble and (pair := most_often_near(request.cell, layer.chart.q[layer.too_near])) is not None:
        why = (
            f"{tried} {near} come within the safety margin, most often {pair[0]} and {pair[1]}, {feeble} "
            f"ask {much}"
        )
        return why, pair
    why = (
        f"{tried} {feeble} ask {much}, most often of {weakest_joint(request.cell, layer.chart.q[weak])} and "
        f"{layer.chart.joint_use[weak].min():.0%} at best, {near} come within the safety margin"
    )
    return why, None


def _no_start(
    request: StrokeRequest, layer: GraphLayer, starts: BoolArray | None
) -> tuple[str, tuple[str, str] | None]:
    """Why a path may start in none of the postures `starts` (M,), and the pair that is too near."""
    chosen = layer.chart.within if starts is None else starts
    near, weak = chosen & layer.too_near, chosen & (layer.chart.joint_use > 1.0)
    what = "the posture to start in"
    if weak.any():
        joint = weakest_joint(request.cell, layer.chart.q[weak])
        return f"{what} asks too much of {joint}", None
    if near.any() and (pair := most_often_near(request.cell, layer.chart.q[near])) is not None:
        why = f"in {what} {pair[0]} and {pair[1]} come within the safety margin"
        return why, pair
    return f"{what} is none of those that hold the tool there", None


def _slowest(
    request: StrokeRequest, layers: Sequence[GraphLayer], k: int, origins: BoolArray | None
) -> tuple[str, float]:
    """The joint that would have to be faster to reach via-point `k`, and by which factor, at least."""
    cell = request.cell
    limits, before = cell.robot.limits, layers[k - 1]
    spare = 0.5 * cell.options.chart_spacing / cell.robot.metric.weight
    seconds = float(request.times[k] - request.times[k - 1])
    by_velocity = cell.options.step_share * limits.velocity * seconds
    step = by_velocity + spare
    turn = np.where(limits.winding, 2 * np.pi / step, 0.0)
    some = before.chart.q[before.admissible if origins is None else origins]
    ahead = layers[k].chart.q[layers[k].admissible]
    tree = cKDTree(_in_steps(some, step, turn), boxsize=turn if turn.any() else None)
    distance, nearest = tree.query(_in_steps(ahead, step, turn), p=np.inf)
    best = int(distance.argmin())
    move = ahead[best] - some[nearest[best]]
    ratio = (np.abs(np.where(turn > 0, nearest_turn(move), move)) - spare) / by_velocity
    return cell.robot.joints[int(ratio.argmax())], float(max(ratio.max(), 1.0))
