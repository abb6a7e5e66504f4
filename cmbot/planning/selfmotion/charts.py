"""Charts of self-motion: the postures that hold the tool task at one point of the path.

A chart is grown by numerical continuation along the null space of the task, all postures at a time, from the
postures it is given and from random ones, so that it reaches every branch (shoulder, elbow and wrist flips).
It grows through postures beyond the joint ranges too: what the ranges cut into pieces hangs together there.
Any two of its postures keep a distance, and every posture of the self-motion has one within its spacing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.objectives import Objective
from cmbot.planning.path.projection import TangentPredictor, null_space, project_onto_task
from cmbot.planning.path.task import ToolTask
from cmbot.planning.selfmotion.poisson_disk import PoissonDiskSets
from cmbot.robot import JointLimits, Postures

__all__ = ["Chart", "SelfMotionSampler", "charts_of"]

# Newton steps that put random postures onto the task.
_MANY_STEPS = 40
# Accepted postures keep this share of the spacing from each other.
_APART = 0.7
# The first chart has at most so many postures, those along the path at most so many: where the self-motion
# has two dimensions or more, the spacing grows.
_MOST_POSTURES, _TOO_MANY, _COARSER = 600, 1500, 1.6
# Charts are carried to every so-manieth point first, and between so many pairs of these at once: more only
# ask for memory.
_STRIDE, _PAIRS = 6, 4
# So many charts are evaluated at once: more only ask for memory, and lose its nearness.
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
        Which postures lie within the joint ranges; the others only hold the chart together.
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
        within = np.all((q >= limits.lower) & (q <= limits.upper), axis=1)
        ends = np.cumsum([0, *(len(part) for part in some)])
        charts += [
            Chart(q=q[a:b], value=value[a:b], joint_use=use[a:b], within=within[a:b])
            for a, b in pairwise(ends)
        ]
    return charts


class SelfMotionSampler:
    """Makes charts along one tool path.

    Parameters
    ----------
    postures : Postures
    task : ToolTask
    limits : JointLimits
    objective : Objective
    spacing : float
        Length of the steps of continuation, rad; the attribute of that name says what it has become.
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
        # A joint without a range, or one that cannot pass half a turn, is charted on the circle, others
        # within their ranges.
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
        placed, reached = project_onto_task(self._postures, self._task, random, point, steps=_MANY_STEPS)
        seeds = np.vstack([known, placed[reached]])
        q = self._grown_from(seeds, point)
        while len(q) > _MOST_POSTURES:
            self._coarsen()
            q = self._grown_from(seeds, point)
        return self._charts([q])[0]

    def along(
        self, points: FloatArray, known: FloatArray, tell: Callable[[int, int], None] | None = None
    ) -> list[Chart]:
        """Chart the self-motion at every one of `points` (k, 3), each near the one before.

        Parameters
        ----------
        points : (k, 3), m
        known : (s, n), rad
            Postures at the first of them.
        tell : callable, optional
            Called with the number of points that are charted, and of all.
        """
        tell = tell or (lambda *_: None)
        each = self._each(points, known, tell)
        while max(len(q) for q in each) > _TOO_MANY:
            self._coarsen()
            each = self._each(points, known, tell)
        return self._charts(each)

    def _coarsen(self) -> None:
        self.spacing *= _COARSER ** (2 / self._wide)

    def _each(
        self, points: FloatArray, known: FloatArray, tell: Callable[[int, int], None]
    ) -> list[FloatArray]:
        """Postures of the charts at `points` (k, 3)."""
        last = len(points) - 1
        stations = list(pairwise([*range(0, last, _STRIDE), last]))
        charts: dict[int, FloatArray] = {0: self.first(points[0], known).q}
        # To every so-manieth point one after the other, then to those between from both sides at once.
        leaning = {0: self._leaning(charts[0], points[0])}
        tell(1, len(points))
        for first in range(0, len(stations), _PAIRS):
            some = stations[first : first + _PAIRS]
            for before, here in some:
                charts[here] = self._carried([[leaning[before]]], points[[here]])[0]
                leaning[here] = self._leaning(charts[here], points[here])
                tell(len(charts), len(points))
            sides = {k: _sides(k, *pair) for pair in some for k in range(pair[0] + 1, pair[1])}
            if sides:
                beside = [[leaning[side] for side in each] for each in sides.values()]
                charts.update(zip(sides, self._carried(beside, points[list(sides)]), strict=True))
            leaning = {some[-1][1]: leaning[some[-1][1]]}
            tell(len(charts), len(points))
        return [charts[k] for k in range(len(points))]

    def _leaning(self, q: FloatArray, point: FloatArray) -> TangentPredictor:
        return TangentPredictor.of(self._postures, self._task, q, point)

    def _carried(self, known: Sequence[Sequence[TangentPredictor]], points: FloatArray) -> list[FloatArray]:
        """Grow charts at `points` (k, 3), each from the `known` ones beside it, the nearer first."""
        crowds = self._crowds(len(points))
        for charts in zip(*known, strict=True):
            some = _Postures.of_each([chart.towards(p) for chart, p in zip(charts, points, strict=True)])
            # What leads to where there is a posture already need not be placed.
            some = some[crowds.far(some.q, some.of)]
            self._place(some, points, crowds)
        return self._grown(crowds, points)

    def _grown_from(self, seeds: FloatArray, point: FloatArray) -> FloatArray:
        """Grow the chart at `point` (3,) from postures (N, n) on the task."""
        crowds = self._crowds(1)
        self._take(_Postures(seeds, np.zeros(len(seeds), dtype=np.intp)), crowds)
        return self._grown(crowds, point[None])[0]

    def _charts(self, each: Sequence[FloatArray]) -> list[Chart]:
        return charts_of(self._postures, self._limits, self._objective, each)

    def _crowds(self, number: int) -> PoissonDiskSets:
        return PoissonDiskSets(number, _APART * self.spacing, self._round)

    def _grown(self, crowds: PoissonDiskSets, points: FloatArray) -> list[FloatArray]:
        """Grow charts at `points` (k, 3) from postures on the task until they have nowhere to grow."""
        frontier = _Postures.of_each(crowds.postures)
        while len(frontier.q):
            frontier = frontier[(crowds.sizes <= _TOO_MANY)[frontier.of]]
            steps = self.spacing * self._tangents(frontier.q)
            ahead = np.concatenate([frontier.q[:, None] + steps, frontier.q[:, None] - steps], axis=1)
            some = _Postures(ahead.reshape(-1, frontier.q.shape[1]), np.repeat(frontier.of, ahead.shape[1]))
            # Where there is a posture already nothing has to be placed.
            frontier = self._place(some[crowds.far(some.q, some.of)], points, crowds)
        return crowds.postures

    def _place(self, some: _Postures, points: FloatArray, crowds: PoissonDiskSets) -> _Postures:
        """Put postures onto the task at their points and take in what is apart there; return that."""
        placed, reached = project_onto_task(self._postures, self._task, some.q, points[some.of])
        return self._take(_Postures(placed[reached], some.of[reached]), crowds)

    def _take(self, some: _Postures, crowds: PoissonDiskSets) -> _Postures:
        """Take in what is in the chart's range and apart from others; return that."""
        q = np.where(self._round, (some.q + np.pi) % (2 * np.pi) - np.pi, some.q)
        some = _Postures(q, some.of)[np.all((q >= self._lower) & (q <= self._upper), axis=1)]
        return some[crowds.take(some.q, some.of)]

    def _tangents(self, q: FloatArray) -> FloatArray:
        """Orthonormal directions (N, d, n) that leave the task alone."""
        return null_space(self._postures, self._task, q)


def _sides(k: int, before: int, after: int) -> tuple[int, int]:
    """The stations on both sides of via-point `k`, the nearer one first."""
    return (before, after) if k - before <= after - k else (after, before)


@dataclass(frozen=True)
class _Postures:
    """Postures (N, n), and to which of several charts each belongs (N,); that ascends."""

    q: FloatArray
    of: IntArray

    @staticmethod
    def of_each(charts: Sequence[FloatArray]) -> _Postures:
        """Put together the postures of charts."""
        return _Postures(np.vstack(charts), np.repeat(np.arange(len(charts)), [len(q) for q in charts]))

    def __getitem__(self, index: BoolArray) -> _Postures:
        return _Postures(self.q[index], self.of[index])
