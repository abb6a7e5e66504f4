"""Charts of self-motion: the postures that hold the tool task at one point of the path.

A chart is grown by numerical continuation along the null space of the task, all postures at a time, from the
postures it is given and from random ones, so that it reaches every branch (shoulder, elbow and wrist flips).
It grows through postures beyond the joint ranges too, which connect the parts within them, in steps that get
longer with the distance from the ranges. Any two of its postures keep a distance, and every posture of the
self-motion within the ranges has one within its spacing.

Charts are carried along the path. Branches that open later are found by random postures at every point,
which are drawn until many in a row lie on the charts: `Coverage` says how many did.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import betaincinv

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.projection import TangentPredictor, null_space, project_onto_task
from cmbot.robot import PostureMetric

__all__ = [
    "Chart",
    "Coverage",
    "GraphLayer",
    "PoissonDiskSets",
    "SelfMotionSampler",
    "best_nodes",
    "charts_of",
    "check_clearances",
    "connected_parts",
    "without_neighbours",
]

# Newton steps that put random postures onto the task.
_RANDOM_STEPS = 40
# Accepted postures keep this share of the spacing from each other. One that is further than so many spacings
# from all of a chart is on a part of the self-motion that the chart misses.
_APART, _BESIDE = 0.7, 1.5
# Beyond the joint ranges the spacing is this share of how far a posture leaves them, up to the length, rad.
_FURTHER, _LONGEST_STEP = 0.7, 1.0
# Postures at most of the first chart, and of those along the path. Where there would be more, the spacing
# grows by this factor; where the self-motion has more than two dimensions, by one that thins charts as much.
# The search for the spacing of a wide self-motion begins with the last one, rad.
_MOST_POSTURES, _TOO_MANY, _COARSER, _COARSEST = 600, 1500, 1.6, np.pi
# Charts are carried to every point of this stride first, and between this many pairs of these at once: more
# only need memory.
_STRIDE, _PAIRS = 6, 4
# Charts that are evaluated at once: more only need memory, beyond the processor's cache.
_TOGETHER = 10
# Rounds of random postures along the path at most, and the factor of their number from one to the next.
_ROUNDS, _MORE = 6, 2
_ONE_TURN = 2 * np.pi


@dataclass(frozen=True)
class Coverage:
    """How many of the random postures that hold the task within the joint ranges lay on the charts.

    Attributes
    ----------
    drawn : int
        Random postures of the last rounds, from which Newton's method started.
    held : int
        How many of them came to hold the task within the joint ranges.
    missed : int
        How many of these lay beside the charts; the charts hold them now.
    """

    drawn: int
    held: int
    missed: int

    @property
    def share(self) -> float:
        """Share of such postures that the charts miss at most, by 95 % confidence (Clopper and Pearson)."""
        if self.held == self.missed:
            return 1.0
        return float(betaincinv(self.missed + 1, self.held - self.missed, 0.95))


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Postures that hold the tool task at one point.

    Angles of joints that can turn by more than a whole turn are given on one turn.
    """

    q: FloatArray  # (M, n), rad and m
    value: FloatArray  # (M,), the objective at rest
    joint_use: FloatArray  # (M,), largest static joint torque as a share of its bound
    within: BoolArray  # (M,), which lie within the joint ranges; the others only connect them


def charts_of(context: PlanningContext, each: Sequence[FloatArray]) -> list[Chart]:
    """Return charts of given postures, arrays (M, n)."""
    limits, charts = context.robot.limits, list[Chart]()
    for first in range(0, len(each), _TOGETHER):
        some = each[first : first + _TOGETHER]
        q = np.vstack(some)
        at = context.postures.at(q)
        value = context.objective.at_rest(at)
        use = (np.abs(at.joint_torque) / limits.torque).max(axis=1)
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
    pairs = tree.query_pairs(_BESIDE * spacing, output_type="ndarray")
    graph = sparse.csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=2 * (len(chosen),))
    label = np.full(len(q), -1, dtype=np.intp)
    label[chosen] = connected_components(graph, directed=False)[1]
    return label


class GraphLayer:
    """The postures (M, n) of one chart as nodes of a graph search, whose clearances are computed when needed.

    `admissible` (M,) are the nodes not known to be inadmissible, `too_near` (M,) those that are known to come
    within the safety margin.
    """

    def __init__(self, context: PlanningContext, chart: Chart) -> None:
        self.chart = chart
        self.admissible = chart.within & (chart.joint_use <= 1.0)
        self.too_near = np.zeros(len(chart.q), dtype=np.bool_)
        self._checked = ~self.admissible
        self.context = context

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


def check_clearances(layers: Sequence[GraphLayer], which: Sequence[BoolArray | IntArray | int]) -> BoolArray:
    """Compute clearances of the nodes `which` of each layer at once, which is quicker than one by one.

    Returns in which layers any turned out inadmissible.
    """
    new = [layer.unchecked(nodes) for layer, nodes in zip(layers, which, strict=True)]
    ends = np.cumsum([0, *(len(nodes) for nodes in new)])
    if ends[-1] == 0:
        return np.zeros(len(layers), dtype=np.bool_)
    context = layers[0].context
    q = np.vstack([layer.chart.q[nodes] for layer, nodes in zip(layers, new, strict=True)])
    near = context.clearances.check_collision(q, context.options.safety_margin_m)
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


class SelfMotionSampler:
    """Samples the postures (M, n) of charts along the tool path of a context.

    Attributes
    ----------
    coverage : Coverage
        Of the charts, by the random postures that were drawn last.
    """

    def __init__(self, context: PlanningContext) -> None:
        self._postures, self._task = context.postures, context.task
        # Every joint is charted on the circle, about the middle of its range.
        self._limits = context.robot.limits
        # Joints that slide do so within their ranges: beyond them some could go on for ever.
        slides, limits = self._limits.prismatic, self._limits
        self._lower = np.where(slides, limits.lower, -np.inf)
        self._upper = np.where(slides, limits.upper, np.inf)
        self._finest = context.options.chart_spacing
        # How often the spacing within and that beyond the joint ranges have grown.
        self._coarser = self._beyond = 0
        self._seeds = context.options.chart_seeds
        self._freedom = max(context.robot.dof - context.task.dimension, 0)
        self.coverage = Coverage(0, 0, 0)
        # The random numbers are the same in every run.
        self._rng = np.random.default_rng(0)

    @property
    def spacing(self) -> float:
        """Spacing that charts keep everywhere, rad; it grows where they would have too many postures."""
        return self._spacing_of(self._beyond)

    def first(self, point: FloatArray, known: FloatArray) -> FloatArray:
        """Chart the self-motion at `point` (3,) from the postures `known` (k, n) and from random ones."""
        seeds = np.vstack([known, self._random(point[None], self._seeds).q])
        least = self._coarser
        if self._freedom > 1:
            # From the coarsest chart on, as the finer ones cost more and more.
            while self._spacing_of(self._coarser) < _COARSEST:
                self._coarser += 1
        self._beyond = self._coarser
        q = self._grown_from(seeds, point)
        while len(q) > _MOST_POSTURES:
            self._coarser = self._beyond = self._coarser + 1
            q = self._grown_from(seeds, point)
        for finer_beyond in (True, False):
            while self._coarser > least:
                before = self._coarser, self._beyond
                self._coarser -= 1
                self._beyond -= finer_beyond
                finer = self._grown_from(seeds, point)
                if len(finer) > _MOST_POSTURES:
                    self._coarser, self._beyond = before
                    break
                q = finer
        return q

    def along(
        self, points: FloatArray, known: FloatArray, report: Callable[[int, int], None] | None = None
    ) -> list[FloatArray]:
        """Chart the self-motion at `points` (k, 3), each near the one before; `known` (s, n) is at the first.

        `report` is called with the number of points that are charted, and of all.
        """
        report = report or (lambda *_: None)
        while (each := self._each(points, known, report)) is None:
            self._coarser += 1
        return self.complete(each, points, range(len(points)), int(np.ceil(self._seeds / len(points))))

    def complete(
        self, charts: list[FloatArray], points: FloatArray, at: Sequence[int], number: int
    ) -> list[FloatArray]:
        """Add to charts at `points` (k, 3) what random postures at some of them show to be missing.

        Parameters
        ----------
        charts : list of (M, n)
        points : (k, 3)
        at : sequence of int
            Where random postures are drawn: `number` at each, and more and more, until none of a round lies
            beside its chart. `coverage` tells of the last round.
        """
        sets, chosen = self._sets(charts), np.asarray(at)
        for _ in range(_ROUNDS):
            before = sets.sizes
            some = self._random(points[chosen], number)
            some = _Postures(some.q, chosen[some.of])
            missing = self._far(some, sets, _BESIDE)
            held, missed = self._limits.contain(some.q).sum(), self._limits.contain(missing.q).sum()
            self.coverage = Coverage(len(chosen) * number, int(held), int(missed))
            if len(missing.q) == 0 or sets.sizes.max() > _TOO_MANY:
                break
            self._grow(self._take(missing, sets), points, sets)
            self._spread(sets, before, points)
            number *= _MORE
        return sets.postures

    def _random(self, points: FloatArray, number: int) -> _Postures:
        """Random postures that hold the tool at `points` (k, 3), from `number` at each."""
        of = np.repeat(np.arange(len(points)), number)
        middle, half = self._limits.range_middle, self._limits.sampled_half
        q = self._rng.uniform(middle - half, middle + half, (len(of), len(half)))
        q, reached = project_onto_task(self._postures, self._task, q, points[of], steps=_RANDOM_STEPS)
        return self._on_circle(_Postures(q, of)[reached & self._slid_within(q)])

    def _slid_within(self, q: FloatArray) -> BoolArray:
        """Which of postures (N, n) have the joints that slide within their ranges."""
        within: BoolArray = np.all((q >= self._lower) & (q <= self._upper), axis=1)
        return within

    def _spread(self, sets: PoissonDiskSets, before: IntArray, points: FloatArray) -> None:
        """Carry the postures of charts, but the first `before` (k,) of each, along the path both ways."""
        while sets.sizes.max() <= _TOO_MANY:
            new = _Postures.of_each([q[n:] for q, n in zip(sets.postures, before, strict=True)])
            if len(new.q) == 0:
                return
            before = sets.sizes
            predictor = self._predictor(new.q, points[new.of])
            both = []
            for way in (-1, 1):
                beside = new.of + way
                there = (beside >= 0) & (beside < len(points))
                ahead = predictor.towards(points[np.where(there, beside, new.of)])
                both.append(_Postures(ahead[there], beside[there]))
            some = _Postures.joined(both)
            self._grow(self._place(self._far(some, sets), points, sets), points, sets)

    def _each(
        self, points: FloatArray, known: FloatArray, report: Callable[[int, int], None]
    ) -> list[FloatArray] | None:
        """Postures of the charts at `points` (k, 3); None where one has too many."""
        last = len(points) - 1
        stations = list(pairwise([*range(0, last, _STRIDE), last]))
        charts: dict[int, FloatArray] = {0: self.first(points[0], known)}
        # To the stations one after the other, then to the points between from both sides at once.
        predictors = {0: self._predictor(charts[0], points[0])}
        report(1, len(points))
        for first in range(0, len(stations), _PAIRS):
            some = stations[first : first + _PAIRS]
            for before, here in some:
                charts[here] = self._carried([[predictors[before]]], points[[here]])[0]
                predictors[here] = self._predictor(charts[here], points[here])
                report(len(charts), len(points))
            # The stations on both sides of each point, the nearer one first.
            sides = {
                k: (before, after) if k - before <= after - k else (after, before)
                for before, after in some
                for k in range(before + 1, after)
            }
            if sides:
                beside = [[predictors[side] for side in each] for each in sides.values()]
                charts.update(zip(sides, self._carried(beside, points[list(sides)]), strict=True))
            if max(len(q) for q in charts.values()) > _TOO_MANY:
                return None
            predictors = {some[-1][1]: predictors[some[-1][1]]}
            report(len(charts), len(points))
        return [charts[k] for k in range(len(points))]

    def _predictor(self, q: FloatArray, point: FloatArray) -> TangentPredictor:
        return TangentPredictor.of(self._postures, self._task, q, point)

    def _carried(self, known: Sequence[Sequence[TangentPredictor]], points: FloatArray) -> list[FloatArray]:
        """Grow charts at `points` (k, 3), each from the `known` ones beside it, the nearer first."""
        sets = self._empty_sets(len(points))
        for charts in zip(*known, strict=True):
            some = _Postures.of_each([chart.towards(p) for chart, p in zip(charts, points, strict=True)])
            # Predictions beside a known posture need no projection.
            self._place(self._far(some, sets), points, sets)
        self._grow(_Postures.of_each(sets.postures), points, sets)
        return sets.postures

    def _grown_from(self, seeds: FloatArray, point: FloatArray) -> FloatArray:
        """Grow the chart at `point` (3,) from postures (N, n) on the task, unless it gets too large."""
        sets = self._empty_sets(1)
        some = self._take(_Postures(seeds, np.zeros(len(seeds), dtype=np.intp)), sets)
        self._grow(some, point[None], sets, most=_MOST_POSTURES)
        return sets.postures[0]

    def _sets(self, charts: Sequence[FloatArray]) -> PoissonDiskSets:
        return PoissonDiskSets(charts, self._postures.metric)

    def _empty_sets(self, number: int) -> PoissonDiskSets:
        return self._sets([np.empty((0, len(self._limits.lower)))] * number)

    def _grow(
        self, frontier: _Postures, points: FloatArray, sets: PoissonDiskSets, most: int = _TOO_MANY
    ) -> None:
        """Grow charts at `points` (k, 3) from postures of theirs until no new posture is far enough.

        Those of more than `most` postures grow no further.
        """
        while len(frontier.q):
            frontier = frontier[(sets.sizes <= most)[frontier.of]]
            steps = null_space(self._postures, self._task, frontier.q)
            steps *= self._steps(frontier.q)[:, None, None]
            ahead = np.concatenate([frontier.q[:, None] + steps, frontier.q[:, None] - steps], axis=1)
            some = _Postures(ahead.reshape(-1, frontier.q.shape[1]), np.repeat(frontier.of, ahead.shape[1]))
            frontier = self._place(self._far(some, sets), points, sets)

    def _place(self, some: _Postures, points: FloatArray, sets: PoissonDiskSets) -> _Postures:
        """Project postures onto the task at their points; take those far from others, and return them."""
        placed, reached = project_onto_task(self._postures, self._task, some.q, points[some.of])
        reached &= self._slid_within(placed)
        return self._take(_Postures(placed[reached], some.of[reached]), sets)

    def _take(self, some: _Postures, sets: PoissonDiskSets) -> _Postures:
        """Take postures that are far from others, and return them."""
        some = self._on_circle(some)
        return some[sets.take(some.q, some.of, _APART * self._steps(some.q))]

    def _steps(self, q: FloatArray) -> FloatArray:
        """Spacing (N,) of charts at postures `q` (N, n): the longer, the further these leave the ranges."""
        q = self._limits.turned_to_middle(q)
        beyond = np.maximum(np.maximum(self._limits.lower - q, q - self._limits.upper), 0.0)
        further = _FURTHER * self._postures.metric.lengths(beyond)
        steps = np.maximum(np.minimum(further, _LONGEST_STEP), self.spacing)
        return np.where(further > 0, steps, self._spacing_of(self._coarser))

    def _spacing_of(self, coarser: int) -> float:
        """Spacing that has grown so often, rad."""
        return float(self._finest * _COARSER ** (2 * coarser / max(self._freedom, 2)))

    def _far(self, some: _Postures, sets: PoissonDiskSets, share: float = _APART) -> _Postures:
        """Those of some postures that are apart from their charts by that share of the spacing."""
        return some[sets.far(some.q, some.of, share * self._steps(some.q))]

    def _on_circle(self, some: _Postures) -> _Postures:
        return _Postures(self._limits.turned_to_middle(some.q), some.of)


@dataclass(frozen=True)
class _Postures:
    """Postures (N, n) and the ascending indices (N,) of their charts."""

    q: FloatArray
    of: IntArray

    @staticmethod
    def of_each(charts: Sequence[FloatArray]) -> _Postures:
        """Stack the postures of charts."""
        return _Postures(np.vstack(charts), np.repeat(np.arange(len(charts)), [len(q) for q in charts]))

    @staticmethod
    def joined(some: Sequence[_Postures]) -> _Postures:
        """Postures of several such, sorted by their charts."""
        of = np.concatenate([each.of for each in some])
        order = np.argsort(of, kind="stable")
        return _Postures(np.concatenate([each.q for each in some])[order], of[order])

    def __getitem__(self, index: BoolArray) -> _Postures:
        return _Postures(self.q[index], self.of[index])


class PoissonDiskSets:
    """Sets of postures, which keep distances from those that were there before, in their set.

    Each has its own k-d tree, which is quicker than one of all. All angles lie on a circle. `first` are the
    postures at first, (M, n) of each. Distances are in rad, by `metric`, of each posture (N,) or of all;
    indices of sets `of` (N,) ascend.
    """

    def __init__(self, first: Sequence[FloatArray], metric: PostureMetric) -> None:
        self._metric = metric
        self.postures = list(first)
        self._turned = [metric.on_one_turn(q) for q in first]
        self._trees: list[cKDTree | None] = [None] * len(first)

    @property
    def sizes(self) -> IntArray:
        """Number of postures in each."""
        return np.array([len(q) for q in self.postures])

    def far(self, q: FloatArray, of: IntArray, apart: FloatArray | float) -> BoolArray:
        """Which of postures `q` (N, n) are at least `apart` from those in their sets."""
        return self._far(self._metric.on_one_turn(q), of, np.broadcast_to(apart, of.shape))

    def take(self, q: FloatArray, of: IntArray, apart: FloatArray | float) -> BoolArray:
        """Add those of `q` (N, n) that are at least `apart` from all others, in order, and return which."""
        turned, apart = self._metric.on_one_turn(q), np.broadcast_to(apart, of.shape)
        taken = self._far(turned, of, apart)
        candidates = np.flatnonzero(taken)
        for k, some in _groups(of[candidates]):
            mine = candidates[some]
            tree = cKDTree(turned[mine], boxsize=self._metric.period)
            near = tree.query_pairs(apart[mine].max(), output_type="ndarray")
            away = np.abs(turned[mine[near[:, 0]]] - turned[mine[near[:, 1]]])
            away = np.where(self._metric.prismatic, away, np.minimum(away, _ONE_TURN - away))
            pairs = near[(away * away).sum(axis=1) < apart[mine[near[:, 1]]] ** 2]
            if len(pairs):
                keep = without_neighbours(len(mine), pairs)
                taken[mine] = keep
                mine = mine[keep]
            alone = len(pairs) == 0 and len(self.postures[k]) == 0
            self._trees[k] = tree if alone else None
            self.postures[k] = np.concatenate([self.postures[k], q[mine]])
            self._turned[k] = np.concatenate([self._turned[k], turned[mine]])
        return taken

    def _far(self, turned: FloatArray, of: IntArray, apart: FloatArray) -> BoolArray:
        far = np.ones(len(turned), dtype=np.bool_)
        for k, some in _groups(of):
            if len(self.postures[k]):
                most = apart[some].max()
                distance, _ = self._tree(k).query(turned[some], distance_upper_bound=most)
                far[some] = distance >= apart[some]
        return far

    def _tree(self, k: int) -> cKDTree:
        tree = self._trees[k]
        if tree is None:
            tree = self._trees[k] = cKDTree(self._turned[k], boxsize=self._metric.period)
        return tree


def _groups(of: IntArray) -> Iterator[tuple[int, slice]]:
    """Yield the numbers in `of`, which ascend, and the slice of each."""
    ends = [0, *(np.flatnonzero(of[1:] != of[:-1]) + 1).tolist(), len(of)] if len(of) else []
    for start, end in pairwise(ends):
        yield int(of[start]), slice(start, end)


def without_neighbours(number: int, pairs: IntArray) -> BoolArray:
    """Which of `number` items remain when each in turn removes its later neighbours of `pairs` (k, 2)."""
    keep, open_ = np.ones(number, dtype=np.bool_), np.ones(number, dtype=np.bool_)
    while len(pairs):
        # Items without an earlier neighbour stay, and their neighbours go.
        waiting = np.zeros(number, dtype=np.bool_)
        waiting[pairs[:, 1]] = True
        settled = open_ & ~waiting
        keep[pairs[settled[pairs[:, 0]], 1]] = False
        open_ = keep & waiting
        pairs = pairs[open_[pairs].all(axis=1)]
    return keep
