"""Both solvers from the same start, and how their answers are judged."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np
from quadrature import gauss_points

from cmbot.common.arrays import FloatArray
from cmbot.optimization.exchange import minimize_peak
from cmbot.optimization.program import StateSamples
from cmbot.planning.context import build_context
from cmbot.planning.initial_guess import initial_guess
from cmbot.planning.objectives import WrenchFunction
from cmbot.planning.torque.decomposition import exchange_options
from cmbot.planning.torque.problem import TorqueProblem, parametrization_through
from cmbot.scene import Scene
from cmbot.trajectory.quintic import QuinticTrajectory

Solver = Literal["sqp", "slsqp"]


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Where a solver ended."""

    # Half the mean square of the objective and the smoothing, from the trajectory alone.
    objective: float
    # Largest value of the objective, and what it was held below, in units of the problem's scale.
    peak: float
    bound: float
    # The largest of all constraints but the peak's, as a share.
    violation: float
    trajectory: QuinticTrajectory

    def away_from(self, other: Self) -> float:
        """Largest difference of a joint's angle between two answers, rad."""
        t = np.linspace(*self.trajectory.t[[0, -1]], 400)
        return float(np.abs(self.trajectory.evaluate(t) - other.trajectory.evaluate(t)).max())


class SameStart:
    """A scene's torque problem, for both solvers around the same via-points."""

    def __init__(self, scene: Scene, own: WrenchFunction | None = None) -> None:
        self._context = build_context(scene, scene.planner, own)
        self._sliding = scene.planner.knots == "sliding"
        guess = initial_guess(self._context)
        self._pinned, self._least = guess.pinned, guess.lower_bound.value
        self._via_points = guess.problem.parametrization.via_points

    @cached_property
    def problem(self) -> TorqueProblem:
        """The problem around the initial guess."""
        return self._around(self._via_points)

    def solve(self, solver: Solver, via_points: FloatArray | None = None) -> Answer:
        """Solve it around the via-points of its initial guess, or around those given."""
        problem = self.problem if via_points is None else self._around(via_points)
        found = minimize_peak(problem, replace(exchange_options(problem), solver=solver))
        scale = problem.scale / self.problem.scale
        return self.judged(found.parametrization.trajectory, found.peak_bound * scale)

    def judged(self, trajectory: QuinticTrajectory, bound: float) -> Answer:
        """Judge a trajectory whose peak is held below `bound`."""
        problem, limits = self.problem, self._context.robot.limits
        times, share = gauss_points(trajectory.t, 5)
        value = self._context.objective.values(StateSamples.along(trajectory, times)) / problem.scale
        jerk = ((trajectory.evaluate(times, 3) / limits.jerk) ** 2).mean(axis=1)
        fine = np.linspace(*trajectory.t[[0, -1]], 60 * len(trajectory.t))
        states = StateSamples.along(trajectory, fine)
        kept = [function.sample(states)[0].max() for function in problem.constraints]
        bounds = (limits.velocity, limits.acceleration, limits.jerk)
        kept += [
            float((trajectory.extrema(order).largest()[0] / bound).max()) - 1
            for order, bound in enumerate(bounds, start=1)
        ]
        q = trajectory.extrema(0).value
        outside = np.maximum(q - limits.upper[:, None], limits.lower[:, None] - q)
        return Answer(
            objective=0.5 * float(share @ (value**2 + self._context.options.smoothing_weight * jerk)),
            peak=float(self._context.objective.values(states).max()) / problem.scale,
            bound=bound,
            violation=max(*kept, float(outside.max())),
            trajectory=trajectory,
        )

    def _around(self, via_points: FloatArray) -> TorqueProblem:
        form = parametrization_through(self._context, via_points, sliding=self._sliding, pinned=self._pinned)
        return TorqueProblem(self._context, form, self._least)
