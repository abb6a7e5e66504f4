"""Both solvers from the same start, with the same smoothing, and how their answers are judged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from solvers.cases import Case, judged

from cmbot.optimization.exchange import optimise
from cmbot.optimization.program import StateSamples
from cmbot.planning.context import build_context
from cmbot.planning.initial_guess import fixed_guess, sliding_guess
from cmbot.planning.solvers import family_through
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.planning.wrench_functions import WrenchFunction
from cmbot.scene import Scene
from cmbot.trajectory.quintic import QuinticTrajectory

FloatArray = NDArray[np.float64]
Solver = Literal["sqp", "slsqp"]
# A peak this near to that of the resting ends counts as no higher.
_AT_REST = 1e-6


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Where a solver ended.

    Attributes
    ----------
    stage : str
        That ended it: ``peak`` or ``mean square``.
    objective : float
        What that stage makes small, with its smoothing, from the trajectory alone.
    violation : float
        The largest of all constraints, as a share.
    trajectory : QuinticTrajectory
    via_points : (n, d), rad
    """

    stage: str
    objective: float
    violation: float
    trajectory: QuinticTrajectory
    via_points: FloatArray

    def away_from(self, other: Answer) -> float:
        """Largest difference of a joint's angle between two answers, rad."""
        t = np.linspace(*self.trajectory.t[[0, -1]], 400)
        return float(np.abs(self.trajectory.evaluate(t) - other.trajectory.evaluate(t)).max())


class SameStart:
    """A scene's problem, posed for both solvers around the same via-points.

    A floor that every peak is below keeps the smoothing as it is.
    """

    def __init__(self, scene: Scene, own: WrenchFunction | None = None) -> None:
        self._setting = build_context(scene, replace(scene.planner, solver="slsqp"), own)
        self._sliding = scene.planner.knots == "sliding"
        self._way = sliding_guess(self._setting) if self._sliding else fixed_guess(self._setting)

    def solve(self, solver: Solver, start: FloatArray | None = None) -> Answer:
        """Solve it around the via-points of its way, or around those given; all are judged alike."""
        found = optimise(self._problem(solver, start))
        return replace(self.judged(found.trajectory, found.passes[-1].stage), via_points=found.via_points)

    def judged(self, trajectory: QuinticTrajectory, stage: str) -> Answer:
        """Judge a trajectory as the answer of that stage."""
        problem = self._judge
        q = self._way.problem.family.via_points
        judgement = judged(
            Case(name="", context=self._setting, via_points=q, sliding=self._sliding), problem, trajectory
        )
        objective, violation = judgement.objective, judgement.violation
        if stage == "mean square":
            peak, at_rest = judgement.peak / problem.scale, problem.peak_at_rest / problem.scale
            objective += _mean_square(problem, trajectory) - peak
            violation = max(violation, peak - at_rest * (1 + _AT_REST))
        return Answer(
            stage=stage,
            objective=objective,
            violation=violation,
            trajectory=trajectory,
            via_points=trajectory.q,
        )

    @cached_property
    def _judge(self) -> TorqueProblem:
        return self._problem("slsqp", None)

    def _problem(self, solver: Solver, via_points: FloatArray | None) -> TorqueProblem:
        context = replace(self._setting, options=replace(self._setting.options, solver=solver))
        q = self._way.problem.family.via_points if via_points is None else via_points
        pinned = self._sliding and 0 in self._way.resting
        return TorqueProblem(
            context.robot,
            context.task,
            family_through(context, q, sliding=self._sliding, pinned=pinned),
            context.clearances,
            context.options,
            resting=self._way.resting,
            floor=np.inf,
            objective=context.objective,
        )


def _mean_square(problem: TorqueProblem, trajectory: QuinticTrajectory) -> float:
    """Half the mean square of the objective, in units of the problem's scale."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    h = np.diff(trajectory.t)[:, None]
    times = (trajectory.t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
    share = (0.5 * h * weights).ravel() / trajectory.duration
    value = problem.objective.values(StateSamples(times, *trajectory.states(times))) / problem.scale
    return 0.5 * float(share @ value**2)
