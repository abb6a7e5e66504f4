"""Charts of self-motion: the postures that hold the tool task at one point of the path.

A chart is grown by numerical continuation along the null space of the task, all postures at a time, from the
postures it is given and from random ones, so that it reaches every branch (shoulder, elbow and wrist flips).
It grows through postures beyond the joint ranges too, which connect the parts within them. Any two of its
postures keep a distance, and every posture of the self-motion has one within its spacing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.objectives import Objective
from cmbot.planning.path.projection import TangentPredictor, null_space, project_onto_task
from cmbot.planning.path.task import ToolTask
from cmbot.planning.selfmotion.poisson_disk import PoissonDiskSets
from cmbot.robot import JointLimits, Postures

__all__ = ["Chart", "GraphLayer", "SelfMotionSampler", "charts_of"]

# Newton steps that put random postures onto the task.
_RANDOM_STEPS = 40
# Accepted postures keep this share of the spacing from each other.
_APART = 0.7
# Postures at most of the first chart, and of those along the path; where the self-motion has two dimensions
# or more, there are more at first, and the spacing grows by this factor.
_MOST_POSTURES, _TOO_MANY, _COARSER = 600, 1500, 1.6
# Charts are carried to every point of this stride first, and between this many pairs of these at once: more
# only need memory.
_STRIDE, _PAIRS = 6, 4
# Charts that are evaluated at once: more only need memory, beyond the processor's cache.
_TOGETHER = 10
# A joint that passes half a turn is charted within one turn either way, rad.
_ONE_TURN = 2 * np.pi


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Postures that hold the tool task at one point.

    Attributes
    ----------
    q : (M, n), rad
    value : (M,)
        The objective at rest.
    joint_use : (M,)
        Largest static joint torque as a share of its bound.
    within : (M,)
        Which postures lie within the joint ranges; the others only connect them.
    """

    q: FloatArray
    value: FloatArray
    joint_use: FloatArray
    within: BoolArray


def charts_of(
    postures: Postures, limits: JointLimits, objective: Objective, each: Sequence[FloatArray]
) -> list[Chart]:
    """Return charts of given postures, arrays (M, n)."""
    charts: list[Chart] = []
    for first in range(0, len(each), _TOGETHER):
        some = each[first : first + _TOGETHER]
        q = np.vstack(some)
        at = postures.at(q)
        value = objective.at_rest(at)
        use = (np.abs(at.joint_torque) / limits.torque).max(axis=1)
        within: BoolArray = np.all((q >= limits.lower) & (q <= limits.upper), axis=1)
        ends = np.cumsum([0, *(len(part) for part in some)])
        charts += [
            Chart(q=q[a:b], value=value[a:b], joint_use=use[a:b], within=within[a:b])
            for a, b in pairwise(ends)
        ]
    return charts


class GraphLayer:
    """The postures of one chart as nodes of a graph search, whose clearances are computed when needed.

    Attributes
    ----------
    chart : Chart
    admissible : (M,)
        Which nodes are not known to be inadmissible.
    too_near : (M,)
        Which are known to come within the safety margin.
    """

    def __init__(self, chart: Chart, clearances: Clearances, margin: float) -> None:
        self.chart = chart
        self.admissible = chart.within & (chart.joint_use <= 1.0)
        self.too_near = np.zeros(len(chart.q), dtype=np.bool_)
        self._checked = ~self.admissible
        self._clearances = clearances
        self._margin = margin

    def check_clearance(self, which: BoolArray | int) -> bool:
        """Compute the clearance of the nodes `which`; return whether any turned out inadmissible."""
        chosen = np.zeros_like(self._checked)
        chosen[which] = True
        new = np.flatnonzero(chosen & ~self._checked)
        if len(new) == 0:
            return False
        near = self._clearances.check_collision(self.chart.q[new], self._margin)
        self._checked[new] = True
        self.too_near[new] = near
        self.admissible[new] = ~near
        return bool(near.any())

    def best(self) -> int | None:
        """Return the index of the admissible node with the smallest value; None when there is none."""
        while self.admissible.any():
            best = int(np.where(self.admissible, self.chart.value, np.inf).argmin())
            if not self.check_clearance(best):
                return best
        return None


class SelfMotionSampler:
    """Samples charts along one tool path.

    Parameters
    ----------
    postures : Postures
    task : ToolTask
    limits : JointLimits
    objective : Objective
    spacing : float
        Length of the steps of continuation, rad; the attribute of that name holds the final one.
    seeds : int
        Random postures from which the first chart is grown.
    """

    def __init__(
        self,
        postures: Postures,
        task: ToolTask,
        limits: JointLimits,
        objective: Objective,
        *,
        spacing: float,
        seeds: int,
    ) -> None:
        self._postures = postures
        self._task = task
        self._limits = limits
        self._objective = objective
        # Joints without a range, or within half a turn, are charted on the circle, others within their
        # ranges.
        within_half_a_turn = (limits.lower >= -np.pi) & (limits.upper <= np.pi)
        self._round = np.isinf(limits.lower) | within_half_a_turn
        self._lower = np.where(self._round, -np.pi, np.maximum(limits.lower, -_ONE_TURN))
        self._upper = np.where(self._round, np.pi, np.minimum(limits.upper, _ONE_TURN))
        self.spacing = spacing
        self._seeds = seeds
        self._wide = max(len(limits.lower) - task.dimension, 2)

    def first(self, point: FloatArray, known: FloatArray) -> Chart:
        """Chart the self-motion at `point` (3,) from the postures `known` (k, n) and from random ones."""
        rng = np.random.default_rng(0)
        random = rng.uniform(self._lower, self._upper, (self._seeds, len(self._lower)))
        placed, reached = project_onto_task(self._postures, self._task, random, point, steps=_RANDOM_STEPS)
        seeds = np.vstack([known, placed[reached]])
        q = self._grown_from(seeds, point)
        while len(q) > _MOST_POSTURES:
            self._coarsen()
            q = self._grown_from(seeds, point)
        return self._charts([q])[0]

    def along(
        self, points: FloatArray, known: FloatArray, report: Callable[[int, int], None] | None = None
    ) -> list[Chart]:
        """Chart the self-motion at points, each near the one before.

        Parameters
        ----------
        points : (k, 3), m
        known : (s, n), rad
            Postures at the first of them.
        report : callable, optional
            Called with the number of points that are charted, and of all.
        """
        report = report or (lambda *_: None)
        each = self._each(points, known, report)
        while max(len(q) for q in each) > _TOO_MANY:
            self._coarsen()
            each = self._each(points, known, report)
        return self._charts(each)

    def _coarsen(self) -> None:
        self.spacing *= _COARSER ** (2 / self._wide)

    def _each(
        self, points: FloatArray, known: FloatArray, report: Callable[[int, int], None]
    ) -> list[FloatArray]:
        """Postures of the charts at `points` (k, 3)."""
        last = len(points) - 1
        stations = list(pairwise([*range(0, last, _STRIDE), last]))
        charts: dict[int, FloatArray] = {0: self.first(points[0], known).q}
        # To the stations one after the other, then to the points between from both sides at once.
        predictors = {0: self._predictor(charts[0], points[0])}
        report(1, len(points))
        for first in range(0, len(stations), _PAIRS):
            some = stations[first : first + _PAIRS]
            for before, here in some:
                charts[here] = self._carried([[predictors[before]]], points[[here]])[0]
                predictors[here] = self._predictor(charts[here], points[here])
                report(len(charts), len(points))
            sides = {k: _sides(k, *pair) for pair in some for k in range(pair[0] + 1, pair[1])}
            if sides:
                beside = [[predictors[side] for side in each] for each in sides.values()]
                charts.update(zip(sides, self._carried(beside, points[list(sides)]), strict=True))
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
            self._place(some[sets.far(some.q, some.of)], points, sets)
        return self._grown(sets, points)

    def _grown_from(self, seeds: FloatArray, point: FloatArray) -> FloatArray:
        """Grow the chart at `point` (3,) from postures (N, n) on the task."""
        sets = self._empty_sets(1)
        self._take(_Postures(seeds, np.zeros(len(seeds), dtype=np.intp)), sets)
        return self._grown(sets, point[None])[0]

    def _charts(self, each: Sequence[FloatArray]) -> list[Chart]:
        return charts_of(self._postures, self._limits, self._objective, each)

    def _empty_sets(self, number: int) -> PoissonDiskSets:
        return PoissonDiskSets(number, _APART * self.spacing, self._round)

    def _grown(self, sets: PoissonDiskSets, points: FloatArray) -> list[FloatArray]:
        """Grow charts at `points` (k, 3) from postures on the task until no new posture is far enough."""
        frontier = _Postures.of_each(sets.postures)
        while len(frontier.q):
            frontier = frontier[(sets.sizes <= _TOO_MANY)[frontier.of]]
            steps = self.spacing * null_space(self._postures, self._task, frontier.q)
            ahead = np.concatenate([frontier.q[:, None] + steps, frontier.q[:, None] - steps], axis=1)
            some = _Postures(ahead.reshape(-1, frontier.q.shape[1]), np.repeat(frontier.of, ahead.shape[1]))
            frontier = self._place(some[sets.far(some.q, some.of)], points, sets)
        return sets.postures

    def _place(self, some: _Postures, points: FloatArray, sets: PoissonDiskSets) -> _Postures:
        """Project postures onto the task at their points; take those far from others, and return them."""
        placed, reached = project_onto_task(self._postures, self._task, some.q, points[some.of])
        return self._take(_Postures(placed[reached], some.of[reached]), sets)

    def _take(self, some: _Postures, sets: PoissonDiskSets) -> _Postures:
        """Take postures in the chart's range that are far from others, and return them."""
        q = np.where(self._round, (some.q + np.pi) % (2 * np.pi) - np.pi, some.q)
        some = _Postures(q, some.of)[np.all((q >= self._lower) & (q <= self._upper), axis=1)]
        return some[sets.take(some.q, some.of)]


def _sides(k: int, before: int, after: int) -> tuple[int, int]:
    """The stations on both sides of via-point `k`, the nearer one first."""
    return (before, after) if k - before <= after - k else (after, before)


@dataclass(frozen=True)
class _Postures:
    """Postures (N, n) and the ascending indices (N,) of their charts."""

    q: FloatArray
    of: IntArray

    @staticmethod
    def of_each(charts: Sequence[FloatArray]) -> _Postures:
        """Stack the postures of charts."""
        return _Postures(np.vstack(charts), np.repeat(np.arange(len(charts)), [len(q) for q in charts]))

    def __getitem__(self, index: BoolArray) -> _Postures:
        return _Postures(self.q[index], self.of[index])
