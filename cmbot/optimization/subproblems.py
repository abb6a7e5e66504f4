"""What SLSQP is given in a pass: the peak's or the mean square's problem on the working set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cmbot.common.arrays import FloatArray
from cmbot.optimization.continuation import Effort
from cmbot.optimization.slsqp import Subproblem
from cmbot.optimization.working_set import WorkingSet
from cmbot.planning.torque.families import FixedKnots
from cmbot.planning.torque.problem import TorqueProblem

__all__ = ["Posed", "mean_square_subproblem", "peak_subproblem"]

# Unknowns without any effect, such as the slide of a pinned via-point, keep the Hessian regular.
_LEAST_CURVATURE = 1e-6
# Weight of the worst violation beside the objective when both are compared.
_PENALTY = 10.0


@dataclass(frozen=True)
class Posed:
    """A subproblem, and how its unknowns become the family's."""

    problem: Subproblem
    unknowns: Callable[[FloatArray], FloatArray]

    def merit(self, x: FloatArray) -> float:
        """Objective and what the worst violation adds; infinite where it cannot be said."""
        value = self.problem.objective(x)[0] + _PENALTY * max(0.0, -self.problem.constraints(x)[0].min())
        return value if np.isfinite(value) else np.inf


def peak_subproblem(working: WorkingSet, family: FixedKnots, bound: float, effort: Effort) -> Posed:
    """Pose the peak stage's subproblem in epigraph form: unknowns are (x, b), or slides alone and b."""
    full = family.start
    free = family.slides if effort.slides_only else len(full)

    def unknowns(x: FloatArray) -> FloatArray:
        return np.concatenate([x[:-1], full[free:]])

    def objective(x: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = family.smoothing(unknowns(x))
        return float(x[-1]) + value, np.append(gradient[:free], 1.0)

    def constraints(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, jacobian, torques = working.values(family, unknowns(x))
        value[:torques] -= x[-1]
        d_bound = np.zeros((len(value), 1))
        d_bound[:torques] = -1.0
        return -value, -np.hstack([jacobian[:, :free], d_bound])

    start = np.append(full[:free], bound)
    return Posed(Subproblem(start=start, objective=objective, constraints=constraints), unknowns)


def mean_square_subproblem(
    problem: TorqueProblem, working: WorkingSet, family: FixedKnots, bound: float
) -> Posed:
    """Pose the mean-square stage's subproblem, the torque's norm held below `bound`.

    Unknowns are u with ``x = C u``, where C whitens the objective's Gauss-Newton Hessian: SLSQP then
    starts with nearly the right curvature.
    """
    H = problem.mean_square_curvature(family, family.start) + family.smoothing_curvature()
    L = np.linalg.cholesky(H + _LEAST_CURVATURE * np.eye(len(H)))
    C = linalg.solve_triangular(L, np.eye(len(L)), lower=True).T

    def unknowns(u: FloatArray) -> FloatArray:
        return np.asarray(C @ u)

    def objective(u: FloatArray) -> tuple[float, FloatArray]:
        x = unknowns(u)
        value, gradient = problem.mean_square(family, x)
        smoothing, pull = family.smoothing(x)
        return value + smoothing, C.T @ (gradient + pull)

    def constraints(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, jacobian, torques = working.values(family, unknowns(u))
        value[:torques] -= bound
        return -value, -(jacobian @ C)

    start = L.T @ family.start
    return Posed(Subproblem(start=start, objective=objective, constraints=constraints), unknowns)
