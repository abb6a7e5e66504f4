"""The global search: postures at all via-points that minimise the peak of the objective at rest.

Charts of self-motion at every via-point, and dynamic programming over them. The result is optimal up to the
charts' spacing, and comes with a lower bound: at the via-point that sets it, no admissible posture has a
smaller objective at rest, as far as the sampled self-motion is complete.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.context import PlanningContext, no_start_left
from cmbot.planning.path.projection import project_onto_task
from cmbot.planning.selfmotion.charts import GraphLayer, SelfMotionSampler, charts_of
from cmbot.planning.selfmotion.dynamic_programming import (
    BottleneckDynamicProgram,
    blocked,
    edges_along,
    nearest_turn,
    refine,
)
from cmbot.planning.selfmotion.lower_bound import find_lower_bound

__all__ = ["GlobalSearch", "GlobalSolution", "sequences_beside"]

# Two postures nearer than this in every joint are one, rad.
_SAME_POSTURE = 1e-9
# Task coordinates of a whole pose.
_POSE = 6
# Sequences beside one.
_BESIDE = 40


@dataclass(frozen=True, kw_only=True)
class GlobalSolution:
    """Postures at the via-points with the smallest peak of the objective at rest.

    Attributes
    ----------
    q : (n, d), rad
    value : (n,)
        The objective at rest in each.
    """

    q: FloatArray
    value: FloatArray

    @property
    def peak(self) -> float:
        """Largest value."""
        return float(self.value.max())


class GlobalSearch:
    """Charts of self-motion at all via-points, and the best sequences of their postures.

    Parameters
    ----------
    context : PlanningContext

    Attributes
    ----------
    lower_bound : LowerBound
    step_share : float
        Share of the joints' velocity bounds that steps between via-points may use.
    first_chart : Chart
        At the start of the path.

    Raises
    ------
    PathNotFound
        When a via-point has no admissible posture: which one, and what excluded most postures there.
    """

    def __init__(self, context: PlanningContext) -> None:
        self._context = context
        self._endless = np.isinf(context.robot.limits.lower)
        each, self._spacing = _sampled(context)
        charts = charts_of(context, each)
        self._layers = [GraphLayer(context, chart) for chart in charts]
        for k, layer in enumerate(self._layers):
            if layer.best() is None:
                raise blocked(context, self._layers, k)
        self.lower_bound, lowest = find_lower_bound(context, self._layers, self._spacing)
        self._wide = context.robot.dof - context.task.dimension > 1
        if self._wide:
            charts = charts_of(context, self._with_more(each, lowest))
            self._layers = [GraphLayer(context, chart) for chart in charts]
        self._allow(context.options.step_share)
        self.first_chart = charts[0]
        # The shorter way round for endless joints.
        moves = charts[0].q - context.posture
        moves[:, self._endless] = nearest_turn(moves[:, self._endless])
        self._away = np.abs(moves).max(axis=1)
        self._pinned = self._away < _SAME_POSTURE

    def halved(self) -> GlobalSearch:
        """Return the same charts with half the steps between via-points."""
        half = copy.copy(self)
        half._allow(0.5 * self.step_share)
        return half

    def solve(self, *, pinned: bool) -> GlobalSolution:
        """Find the sequence with the smallest peak, then mean square, of the objective at rest.

        Parameters
        ----------
        pinned : bool
            Start in the scene's posture; otherwise anywhere with its tool pose.

        Raises
        ------
        PathNotFound
            When no sequence of admissible postures can be followed to the end.
        """
        return self._solve(self._pinned if pinned else np.ones_like(self._pinned))

    def solve_elsewhere(self, failed: PathNotFound) -> tuple[GlobalSolution, tuple[PathNotFound, ...]]:
        """Start in the posture nearest to the scene's from which the path can be followed.

        Chang 2021, Section 3.1: the robot should then change its initial position.

        Parameters
        ----------
        failed : PathNotFound
            The failure of the scene's posture.

        Returns
        -------
        solution : GlobalSolution
        failures : tuple of PathNotFound
            That, then those of the postures that are nearer than the solution's.

        Raises
        ------
        PathNotFound
            When none of `PlannerOptions.other_starts` postures leads to the end.
        """
        others = np.flatnonzero(self._layers[0].chart.within & ~self._pinned)
        nearest = others[np.argsort(self._away[others], kind="stable")]
        failures = [failed]
        for k in nearest[: self._context.options.other_starts]:
            try:
                return self._solve(np.arange(len(self._away)) == k), tuple(failures)
            except PathNotFound as failure:
                failures.append(failure)
        raise no_start_left(failures) from failed

    def _allow(self, step_share: float) -> None:
        """Let joints use that share of their velocity bounds between via-points."""
        context = self._context
        self.step_share = step_share
        self._steps = (
            step_share * context.robot.limits.velocity * np.diff(context.times)[:, None]
            + 0.5 * context.options.chart_spacing
        )
        self._edges = edges_along(self._layers, self._steps, self._endless)

    def _solve(self, starts: BoolArray) -> GlobalSolution:
        context, layers = self._context, self._layers
        context.reporter.step("choosing the postures of least torque")
        chosen = BottleneckDynamicProgram(context, layers, self._edges, starts).best()
        q = np.stack([layer.chart.q[k] for layer, k in zip(layers, chosen, strict=True)])
        if self._wide:
            stays = not starts.all()
            # A start that stays is a lower bound as well.
            at_start = float(layers[0].chart.value[chosen[0]]) if stays else 0.0
            bound = max(self.lower_bound.value, at_start)
            q = refine(context, q, self._steps, self._spacing, bound, start_stays=stays)
        value = context.objective.at_rest(context.postures.at(q))
        return GlobalSolution(q=self._unwound(q), value=value)

    def _with_more(self, each: list[FloatArray], lowest: FloatArray) -> list[FloatArray]:
        """Add to coarse charts the finer ones of the whole pose, and sequences beside the posture `lowest`.

        So freedom never raises the peak, and a sequence leads on from the scene's own posture.
        """
        context = self._context
        more = [sequences_beside(context, lowest, self.lower_bound.via_point, self._spacing)]
        if context.robot.dof > _POSE:
            more.append(_sampled(replace(context, task=replace(context.task, keep="pose")))[0])
        return [np.vstack(of_point) for of_point in zip(each, *more, strict=True)]

    def _unwound(self, q: FloatArray) -> FloatArray:
        """The same postures (n, d) on the turns of endless joints that lie nearest to those before."""
        q, posture = q.copy(), self._context.posture
        before = np.vstack([posture, q[:-1]])[:, self._endless]
        steps = nearest_turn(q[:, self._endless] - before)
        q[:, self._endless] = posture[self._endless] + np.cumsum(steps, axis=0)
        return q


def _sampled(context: PlanningContext) -> tuple[list[FloatArray], float]:
    """Postures (M, d) of the charts at all via-points, and their spacing, rad."""
    sampler = SelfMotionSampler(context)
    report = partial(context.reporter.part, f"charting the postures that hold the tool's {context.task.keep}")
    each = sampler.along(context.points, context.posture[None], report)
    return each, sampler.spacing


def sequences_beside(
    context: PlanningContext, posture: FloatArray, via_point: int, spacing: float
) -> list[FloatArray]:
    """Carry a posture (d,) of a via-point, and others within `spacing`, along the path: (m, d) at each."""
    rng = np.random.default_rng(0)
    # The same offsets everywhere give sequences that run side by side.
    offsets = rng.normal(size=(_BESIDE, len(posture)))
    offsets *= spacing * rng.uniform(size=(_BESIDE, 1)) / np.linalg.norm(offsets, axis=1, keepdims=True)
    points = context.points
    each = [np.empty((0, len(posture))) for _ in points]
    for direction in (range(via_point, len(points)), range(via_point - 1, -1, -1)):
        q = posture
        for k in direction:
            near = np.vstack([q, q + offsets])
            placed, reached = project_onto_task(context.postures, context.task, near, points[k])
            if not reached[0]:
                break
            each[k], q = placed[reached], placed[0]
    return each
