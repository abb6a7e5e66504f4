"""Sampling of the self-motion: postures that hold the tool task, at one point of the path and along it.

A chart is grown by numerical continuation along the null space of the task, all postures at a time, from the
postures it is given and from random ones, so that it reaches every branch (shoulder, elbow and wrist flips).
It grows through postures beyond the joint ranges too, which connect the parts within them, in steps that get
longer with the distance from the ranges. Any two of its postures keep a distance, and every posture of the
self-motion within the ranges has one within its spacing.

Charts are carried along the path. Branches that open later are found by random postures at every point,
which are drawn until many in a row lie on the charts: `Coverage` says how many did.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import betaincinv

from cmbot.common.arrays import Batch, BoolArray, FloatArray, IntArray
from cmbot.planning.postures.projection import TangentPredictor, null_space, project_onto_task
from cmbot.planning.postures.sampler import PostureSampler
from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.poisson_disk import PoissonDiskSets
from cmbot.toolpath import ToolPoses

# Accepted postures keep this share of the spacing from each other. One that is further than so many spacings
# from all of a chart is on a part of the self-motion that the chart misses.
_APART, _MISSED_PART_SPACINGS = 0.7, 1.5
# Beyond the joint ranges the spacing is this share of how far a posture leaves them, up to the length, rad.
_OUTSIDE_SPACING_SHARE, _MAX_OUTSIDE_RAD = 0.7, 1.0
# Postures at most of the first chart, and of those along the path. Where there would be more, the spacing
# grows by this factor; where the self-motion has more than two dimensions, by one that thins charts as much.
# The search for the spacing of a wide self-motion begins with the last one, rad.
_MAX_CHART_POSTURES, _TOO_MANY, _COARSER, _COARSEST = 600, 1500, 1.6, np.pi
# Charts are carried to every point of this stride first, and between this many pairs of these at once: more
# only need memory.
_FIRST_STRIDE, _PAIRS = 6, 4
# How often as many postures a refined chart has, and how many it may have at most.
_DENSER, _MOST_REFINED = 4, 6000
# Rounds of random postures along the path at most, and the factor of their number from one to the next.
_MAX_SEED_ROUNDS, _SEED_GROWTH = 6, 2
# Charts of so many tool paths and arms at most are kept, by what they depend on, with their samplers; not
# those of a path with more postures than the second number. Decimals of the poses that they hold: far below
# the tolerance with which they do.
_MAX_KEPT_CHARTS, _MOST_KEPT, _POSE_DECIMALS = 4, 100_000, 12
_SAMPLER_CACHE: dict[tuple[object, ...], tuple[SelfMotionSampler, tuple[FloatArray, ...]]] = {}


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


class SelfMotionSampler:
    """Samples the postures (M, n) of charts along the tool path of a request.

    Attributes
    ----------
    coverage : Coverage
        Of the charts, by the random postures that were drawn last.
    """

    def __init__(self, request: StrokeRequest) -> None:
        cell = request.cell
        self._postures, self._task = cell.postures, request.task
        self._sampler = PostureSampler(cell=cell, task=request.task)
        # Every joint is charted on the circle, about the middle of its range.
        self._limits = cell.robot.limits
        # Joints that slide do so within their ranges: beyond them some could go on for ever.
        slides, limits = self._limits.prismatic, self._limits
        self._lower = np.where(slides, limits.lower, -np.inf)
        self._upper = np.where(slides, limits.upper, np.inf)
        self._finest = cell.options.chart_spacing
        # How often the spacing within and that beyond the joint ranges have grown.
        self._coarser = self._beyond = 0
        # By how much it is finer while charts are refined.
        self._denser = 1.0
        self._seeds = cell.options.chart_seeds
        self._freedom = max(cell.robot.dof - request.task.dimension, 0)
        self.coverage = Coverage(0, 0, 0)
        # The random numbers are the same in every run.
        self._rng = np.random.default_rng(0)

    @property
    def spacing(self) -> float:
        """Spacing that charts keep everywhere, rad; it grows where they would have too many postures."""
        return self._spacing_of(self._beyond)

    def spacing_after(self, rounds: int) -> float:
        """Spacing of charts that were made denser in so many rounds, rad."""
        return float(self.spacing / _DENSER ** (rounds / max(self._freedom, 1)))

    def copied(self) -> SelfMotionSampler:
        """Return one that goes on as this one would, random numbers included."""
        other = copy.copy(self)
        other._rng = copy.deepcopy(self._rng)
        return other

    def first(self, goal: ToolPoses, known: FloatArray) -> FloatArray:
        """Chart the self-motion at `goal` from the postures `known` (k, n) and from random ones."""
        seeds = np.vstack([known, self._random(goal, self._seeds).q])
        least = self._coarser
        if self._freedom > 1:
            # From the coarsest chart on, as the finer ones cost more and more.
            while self._spacing_of(self._coarser) < _COARSEST:
                self._coarser += 1
        self._beyond = self._coarser
        q = self._grown_from(seeds, goal)
        while len(q) > _MAX_CHART_POSTURES:
            self._coarser = self._beyond = self._coarser + 1
            q = self._grown_from(seeds, goal)
        for finer_beyond in (True, False):
            while self._coarser > least:
                before = self._coarser, self._beyond
                self._coarser -= 1
                self._beyond -= finer_beyond
                finer = self._grown_from(seeds, goal)
                if len(finer) > _MAX_CHART_POSTURES:
                    self._coarser, self._beyond = before
                    break
                q = finer
        return q

    def along(
        self, goals: ToolPoses, known: FloatArray, report: Callable[[int, int], None] | None = None
    ) -> list[FloatArray]:
        """Chart the self-motion at `goals`, each near the one before; `known` (s, n) is at the first.

        `report` is called with the number of goals that are charted, and of all.
        """
        report = report or (lambda *_: None)
        while (each := self._each(goals, known, report)) is None:
            self._coarser += 1
        return self.complete(each, goals, range(len(goals)), int(np.ceil(self._seeds / len(goals))))

    def complete(
        self, charts: list[FloatArray], goals: ToolPoses, at: Sequence[int], number: int
    ) -> list[FloatArray]:
        """Add to charts at `goals` what random postures at some of them show to be missing.

        Parameters
        ----------
        charts : list of (M, n)
        goals : ToolPoses, (k,)
        at : sequence of int
            Where random postures are drawn: `number` at each, and more and more, until none of a round lies
            beside its chart. `coverage` tells of the last round.
        """
        sets, chosen = self._sets(charts), np.asarray(at)
        for _ in range(_MAX_SEED_ROUNDS):
            before = sets.sizes
            some = self._random(goals[chosen], number)
            some = _Postures(some.q, chosen[some.of])
            missing = self._far(some, sets, _MISSED_PART_SPACINGS)
            held, missed = self._limits.contain(some.q).sum(), self._limits.contain(missing.q).sum()
            self.coverage = Coverage(len(chosen) * number, int(held), int(missed))
            if len(missing.q) == 0 or sets.sizes.max() > _TOO_MANY:
                break
            self._grow(self._take(missing, sets), goals, sets)
            self._spread(sets, before, goals)
            number *= _SEED_GROWTH
        return sets.postures

    def refined(
        self, charts: list[FloatArray], goals: ToolPoses, at: Sequence[int], rounds: int
    ) -> list[FloatArray]:
        """Return charts at `goals` that are several times as dense at some of them.

        Between the postures of a chart there may be a way that is narrower than its spacing.

        Parameters
        ----------
        charts : list of (M, n)
        goals : ToolPoses, (k,)
        at : sequence of int
            Where they get denser, ascending. Charts that are large already stay.
        rounds : int
            In so many rounds, counted from those of `along`.
        """
        some = [k for k in at if len(charts[k]) <= _MOST_REFINED // _DENSER]
        if not some:
            return charts
        self._denser = self.spacing / self.spacing_after(rounds)
        sets = self._sets([charts[k] for k in some])
        self._grow(_Postures.of_each(sets.postures), goals[np.asarray(some)], sets, most=_MOST_REFINED)
        self._denser = 1.0
        refined = dict(zip(some, sets.postures, strict=True))
        return [refined.get(k, q) for k, q in enumerate(charts)]

    def _random(self, goals: ToolPoses, number: int) -> _Postures:
        """Random postures that hold the tool at `goals`, from `number` at each."""
        of = np.repeat(np.arange(len(goals)), number)
        q, reached = self._sampler.held(self._limits.drawn(self._rng, len(of)), goals[of])
        return _Postures(q, of)[reached & self._slid_within(q)]

    def _slid_within(self, q: FloatArray) -> BoolArray:
        """Which of postures (N, n) have the joints that slide within their ranges."""
        within: BoolArray = np.all((q >= self._lower) & (q <= self._upper), axis=1)
        return within

    def _spread(self, sets: PoissonDiskSets, before: IntArray, goals: ToolPoses) -> None:
        """Carry the postures of charts, but the first `before` (k,) of each, along the path both ways."""
        while sets.sizes.max() <= _TOO_MANY:
            new = _Postures.of_each([q[n:] for q, n in zip(sets.postures, before, strict=True)])
            if len(new.q) == 0:
                return
            before = sets.sizes
            predictor = self._predictor(new.q, goals[new.of])
            both = []
            for way in (-1, 1):
                beside = new.of + way
                there = (beside >= 0) & (beside < len(goals))
                ahead = predictor.towards(goals[np.where(there, beside, new.of)])
                both.append(_Postures(ahead[there], beside[there]))
            some = _Postures.joined(*both).by_chart()
            self._grow(self._place(self._far(some, sets), goals, sets), goals, sets)

    def _each(
        self, goals: ToolPoses, known: FloatArray, report: Callable[[int, int], None]
    ) -> list[FloatArray] | None:
        """Postures of the charts at `goals`; None where one has too many."""
        last = len(goals) - 1
        stations = list(pairwise([*range(0, last, _FIRST_STRIDE), last]))
        charts: dict[int, FloatArray] = {0: self.first(goals[0], known)}
        # To the stations one after the other, then to the points between from both sides at once.
        predictors = {0: self._predictor(charts[0], goals[0])}
        report(1, len(goals))
        for first in range(0, len(stations), _PAIRS):
            some = stations[first : first + _PAIRS]
            for before, here in some:
                charts[here] = self._carried([[predictors[before]]], goals[here])[0]
                predictors[here] = self._predictor(charts[here], goals[here])
                report(len(charts), len(goals))
            # The stations on both sides of each point, the nearer one first.
            sides = {
                k: (before, after) if k - before <= after - k else (after, before)
                for before, after in some
                for k in range(before + 1, after)
            }
            if sides:
                beside = [[predictors[side] for side in each] for each in sides.values()]
                charts.update(zip(sides, self._carried(beside, goals[np.array(list(sides))]), strict=True))
            if max(len(q) for q in charts.values()) > _TOO_MANY:
                return None
            predictors = {some[-1][1]: predictors[some[-1][1]]}
            report(len(charts), len(goals))
        return [charts[k] for k in range(len(goals))]

    def _predictor(self, q: FloatArray, goal: ToolPoses) -> TangentPredictor:
        return TangentPredictor.of(self._postures, self._task, q, goal)

    def _carried(self, known: Sequence[Sequence[TangentPredictor]], goals: ToolPoses) -> list[FloatArray]:
        """Grow charts at `goals`, each from the `known` ones beside it, the nearer first."""
        sets = self._empty_sets(len(goals))
        for charts in zip(*known, strict=True):
            some = _Postures.of_each([chart.towards(goal) for chart, goal in zip(charts, goals, strict=True)])
            # Predictions beside a known posture need no projection.
            self._place(self._far(some, sets), goals, sets)
        self._grow(_Postures.of_each(sets.postures), goals, sets)
        return sets.postures

    def _grown_from(self, seeds: FloatArray, goal: ToolPoses) -> FloatArray:
        """Grow the chart at `goal` from postures (N, n) on the task, unless it gets too large."""
        sets = self._empty_sets(1)
        some = self._take(_Postures(seeds, np.zeros(len(seeds), dtype=np.intp)), sets)
        self._grow(some, goal, sets, most=_MAX_CHART_POSTURES)
        return sets.postures[0]

    def _sets(self, charts: Sequence[FloatArray]) -> PoissonDiskSets:
        return PoissonDiskSets(charts, self._postures.metric, self._limits.range_middle)

    def _empty_sets(self, number: int) -> PoissonDiskSets:
        return self._sets([np.empty((0, len(self._limits.lower)))] * number)

    def _grow(
        self, frontier: _Postures, goals: ToolPoses, sets: PoissonDiskSets, most: int = _TOO_MANY
    ) -> None:
        """Grow charts at `goals` from postures of theirs until no new posture is far enough.

        Those of more than `most` postures grow no further.
        """
        while len(frontier.q):
            frontier = frontier[(sets.sizes <= most)[frontier.of]]
            steps = null_space(self._postures, self._task, frontier.q)
            steps *= self._steps(frontier.q)[:, None, None]
            ahead = np.concatenate([frontier.q[:, None] + steps, frontier.q[:, None] - steps], axis=1)
            some = _Postures(ahead.reshape(-1, frontier.q.shape[1]), np.repeat(frontier.of, ahead.shape[1]))
            frontier = self._place(self._far(some, sets), goals, sets)

    def _place(self, some: _Postures, goals: ToolPoses, sets: PoissonDiskSets) -> _Postures:
        """Project postures onto the task at their goals; take those far from others, and return them."""
        placed, reached = project_onto_task(self._postures, self._task, some.q, goals[some.of])
        reached &= self._slid_within(placed)
        return self._take(_Postures(placed[reached], some.of[reached]), sets)

    def _take(self, some: _Postures, sets: PoissonDiskSets) -> _Postures:
        """Take postures that are far from others, and return them."""
        some = _Postures(self._limits.turned_to_middle(some.q), some.of)
        return some[sets.take(some.q, some.of, _APART * self._steps(some.q))]

    def _steps(self, q: FloatArray) -> FloatArray:
        """Spacing (N,) of charts at postures `q` (N, n): the longer, the further these leave the ranges."""
        q = self._limits.turned_to_middle(q)
        beyond = np.maximum(np.maximum(self._limits.lower - q, q - self._limits.upper), 0.0)
        further = _OUTSIDE_SPACING_SHARE * self._postures.metric.lengths(beyond)
        steps = np.maximum(np.minimum(further, _MAX_OUTSIDE_RAD), self.spacing)
        return np.where(further > 0, steps, self._spacing_of(self._coarser))

    def _spacing_of(self, coarser: int) -> float:
        """Spacing that has grown so often, rad."""
        return float(self._finest / self._denser * _COARSER ** (2 * coarser / max(self._freedom, 2)))

    def _far(self, some: _Postures, sets: PoissonDiskSets, share: float = _APART) -> _Postures:
        """Those of some postures that are apart from their charts by that share of the spacing."""
        return some[sets.far(some.q, some.of, share * self._steps(some.q))]


@dataclass(frozen=True, eq=False)
class _Postures(Batch):
    """Postures (N, n) and the ascending indices (N,) of their charts."""

    q: FloatArray
    of: IntArray

    @staticmethod
    def of_each(charts: Sequence[FloatArray]) -> _Postures:
        """Stack the postures of charts."""
        return _Postures(np.vstack(charts), np.repeat(np.arange(len(charts)), [len(q) for q in charts]))

    def by_chart(self) -> _Postures:
        """Sort them by their charts."""
        return self[np.argsort(self.of, kind="stable")]


def sampled_charts(request: StrokeRequest) -> tuple[SelfMotionSampler, list[FloatArray]]:
    """Postures (M, d) of the charts at all via-points, and the sampler that goes on from there.

    Jobs of a campaign often have the tool path and the arm in common, and differ in what it carries or how
    fast it moves.
    """
    cell = request.cell
    goals, limits, task, options = (
        request.goals,
        cell.robot.limits,
        request.task,
        cell.options,
    )
    # So that they do not depend on how the via-points' times were rounded.
    goals = replace(
        goals, point=goals.point.round(_POSE_DECIMALS), rotation=goals.rotation.round(_POSE_DECIMALS)
    )
    lean = np.zeros(0) if task.lean is None else task.lean
    arrays = (limits.lower, limits.upper, goals.point, goals.rotation, request.first, lean)
    asked = (task.keep, task.path.turns, options.chart_spacing, options.chart_seeds)
    known = (*asked, *(array.tobytes() for array in arrays), *cell.postures.geometry)
    if known not in _SAMPLER_CACHE:
        sampler = SelfMotionSampler(request)
        drawn = _charted(sampler, request, goals)
        if sum(map(len, drawn)) > _MOST_KEPT:
            return sampler, drawn
        _SAMPLER_CACHE[known] = sampler, tuple(drawn)
        for earlier in list(_SAMPLER_CACHE)[:-_MAX_KEPT_CHARTS]:
            _SAMPLER_CACHE.pop(earlier, None)
    sampler, charts = _SAMPLER_CACHE[known]
    return sampler.copied(), list(charts)


def _charted(sampler: SelfMotionSampler, request: StrokeRequest, goals: ToolPoses) -> list[FloatArray]:
    step = f"charting the postures that hold the tool's {request.task.keep}"

    def report(done: int, total: int) -> None:
        request.reporter.part(step, done, total)
        if request.deadline.expired():
            reason = (
                f"{request.deadline.in_words}, was over when {done} of {total} via-points had been charted"
            )
            raise request.path_not_found(reason, request.first, stopped=True)

    return sampler.along(goals, request.first[None], report)
