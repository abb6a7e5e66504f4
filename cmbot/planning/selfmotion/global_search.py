"""The global stage: which postures, via-point by via-point, make the objective smallest at rest.

Charts of self-motion at every via-point, and dynamic programming over them. The result is the best there is
up to the charts' spacing, and it carries a floor: whatever the arm does, at the via-point named it cannot
rest in an admissible posture with a smaller objective.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.initial_postures import no_start_left
from cmbot.planning.path.task import ToolTask
from cmbot.planning.selfmotion.charts import Chart, SelfMotionSampler, charts_of
from cmbot.planning.selfmotion.dynamic_programming import (
    BottleneckDynamicProgram,
    edges_between,
    nearest_turn,
)
from cmbot.planning.selfmotion.graph_layer import GraphLayer
from cmbot.planning.selfmotion.lower_bound import find_lower_bound
from cmbot.planning.selfmotion.refinement import refined, ways_beside
from cmbot.robot import Postures

__all__ = ["GlobalSearch", "GlobalSolution"]

# Two postures nearer than this in every joint are one, rad.
_SAME_POSTURE = 1e-9
# Task coordinates of a whole pose.
_POSE = 6


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
    """Charts of self-motion at all via-points, what is admissible in them, and the best ways through.

    Parameters
    ----------
    setting : PlanningContext

    Raises
    ------
    PathNotFound
        When a via-point has no admissible posture: which one, and what excluded most postures there.
    """

    def __init__(self, context: PlanningContext) -> None:
        self._setting = context
        options, limits = context.options, context.robot.limits
        maker, charts = self._charts(context.task)
        self._nodes = [GraphLayer(chart, context.clearances, options.safety_margin_m) for chart in charts]
        self.floor, lowest = find_lower_bound(context, self._nodes, maker.spacing)
        self._spacing = maker.spacing
        self._wide = context.robot.dof - context.task.dimension > 1
        if self._wide:
            charts = self._with_more(charts, lowest)
            self._nodes = [GraphLayer(chart, context.clearances, options.safety_margin_m) for chart in charts]
        self._endless = np.isinf(limits.lower)
        self._allow(options.step_share)
        self.first_chart = charts[0]
        self._away = np.abs(self._from_the_scenes(charts[0].q)).max(axis=1)
        self._pinned = self._away < _SAME_POSTURE

    def halved(self) -> GlobalSearch:
        """Return the same charts with half the steps between via-points: its ways are calmer."""
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
            What happened from the scene's posture.

        Returns
        -------
        solution : GlobalSolution
        failures : tuple of PathNotFound
            That, then where the postures led that are nearer than the solution's.

        Raises
        ------
        PathNotFound
            When none of `PlannerOptions.other_starts` postures leads to the end.
        """
        others = np.flatnonzero(self._nodes[0].chart.within & ~self._pinned)
        nearest = others[np.argsort(self._away[others], kind="stable")]
        failures = [failed]
        for k in nearest[: self._setting.options.other_starts]:
            try:
                return self._solve(np.arange(len(self._away)) == k), tuple(failures)
            except PathNotFound as failure:
                failures.append(failure)
        raise no_start_left(failures) from failed

    def _allow(self, step_share: float) -> None:
        """Let joints use that share of their velocity bounds between via-points."""
        context = self._setting
        self.step_share = step_share
        self._steps = (
            step_share * context.robot.limits.velocity * np.diff(context.times)[:, None]
            + 0.5 * context.options.chart_spacing
        )
        self._edges = [
            edges_between(a, b, step, self._endless)
            for (a, b), step in zip(pairwise(self._nodes), self._steps, strict=True)
        ]

    def _solve(self, starts: BoolArray) -> GlobalSolution:
        self._setting.reporter.step("choosing the postures of least torque")
        way = BottleneckDynamicProgram(self._setting, self._nodes, self._edges, starts)
        chosen = way.best()
        q = np.stack([node.chart.q[k] for node, k in zip(self._nodes, chosen, strict=True)])
        if self._wide:
            stays = not starts.all()
            # A start that stays is a floor of its own.
            floor = max(self.floor.value, float(self._nodes[0].chart.value[chosen[0]]) if stays else 0.0)
            q = refined(self._setting, q, self._steps, self._spacing, floor, start_stays=stays)
        value = self._setting.objective.at_rest(Postures(self._setting.robot).at(q))
        return GlobalSolution(q=self._unwound(q), value=value)

    def _charts(self, task: ToolTask) -> tuple[SelfMotionSampler, list[Chart]]:
        context, options = self._setting, self._setting.options
        maker = SelfMotionSampler(
            Postures(context.robot),
            task,
            context.robot.limits,
            context.objective,
            spacing=options.chart_spacing,
            seeds=options.chart_seeds,
        )
        tell = partial(context.reporter.part, f"charting the postures that hold the tool's {task.keep}")
        return maker, maker.along(task.path.position(context.times), context.posture[None], tell)

    def _with_more(self, charts: list[Chart], lowest: FloatArray) -> list[Chart]:
        """Add to coarse charts the finer ones of the whole pose, and what lies along the way of `lowest`.

        So freedom never costs anything, and the scene's own posture leads somewhere.
        """
        context = self._setting
        each = [chart.q for chart in charts]
        more = [ways_beside(context, lowest, self.floor.via_point, self._spacing)]
        if context.robot.dof > _POSE:
            more.append([chart.q for chart in self._charts(replace(context.task, keep="pose"))[1]])
        for some in more:
            each = [np.vstack([q, others]) for q, others in zip(each, some, strict=True)]
        return charts_of(Postures(context.robot), context.robot.limits, context.objective, each)

    def _from_the_scenes(self, q: FloatArray) -> FloatArray:
        """Moves (N, n) from the scene's posture to `q` (N, n), the shorter way round for endless joints."""
        moves = q - self._setting.posture
        moves[:, self._endless] = nearest_turn(moves[:, self._endless])
        return moves

    def _unwound(self, q: FloatArray) -> FloatArray:
        """The same postures (n, d) on the turns of endless joints that lie nearest to those before."""
        q = q.copy()
        before = np.vstack([self._setting.posture, q[:-1]])[:, self._endless]
        steps = nearest_turn(q[:, self._endless] - before)
        q[:, self._endless] = self._setting.posture[self._endless] + np.cumsum(steps, axis=0)
        return q
