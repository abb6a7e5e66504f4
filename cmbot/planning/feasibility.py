"""Whether via-points rule out every trajectory through them, whatever its torque on the guardrail."""

from __future__ import annotations

import numpy as np
from scipy import optimize, sparse

from cmbot.errors import OptimisationFailed
from cmbot.planning.problem import TorqueProblem
from cmbot.planning.state_functions import ClearanceMargin, States

__all__ = ["check_feasible"]

_SAMPLES_PER_SEGMENT = 6


def check_feasible(problem: TorqueProblem) -> None:
    """Say at once when no trajectory through the via-points keeps the bounds.

    At the ends, where the arm rests, joint torques and the clearance are given; at the other via-points the
    clearance is.

    A small linear program per joint minimises the largest share of velocity, acceleration and jerk bounds at
    samples. Above 1 no trajectory through the via-points exists, whatever the torque; an optimisation would
    find out slowly. Joints whose least-jerk spline keeps its bounds need no program.

    Raises
    ------
    OptimisationFailed
        Naming the constraint that cannot be met, and by how much.
    """
    _check_via_points(problem)
    least_jerk = problem.trajectory(problem.family, problem.family.start)
    t = problem.space.t
    grid = np.linspace(t[:-1], t[1:], _SAMPLES_PER_SEGMENT, endpoint=False, axis=1)
    times = np.append(grid.ravel(), t[-1])
    bounds = [bound for bound in problem.bounds if bound.order > 0]
    for joint, name in enumerate(problem.robot.joints):
        if all(least_jerk.extrema(b.order).largest()[0][joint] <= b.scale[joint] for b in bounds):
            continue
        A = sparse.vstack(
            [problem.space.design(times, b.order) @ problem.space.basis / b.scale[joint] for b in bounds]
        )
        c = np.concatenate([least_jerk.evaluate(times, b.order)[:, joint] / b.scale[joint] for b in bounds])
        share = -np.ones((len(c), 1))
        result = optimize.linprog(
            np.append(np.zeros(A.shape[1]), 1.0),
            A_ub=sparse.block_array([[A, share], [-A, share]], format="csr"),
            b_ub=np.concatenate([-c, c]),
            bounds=(None, None),
            method="highs",
        )
        if result.x is not None and result.x[-1] > 1.0:
            raise OptimisationFailed(
                "the via-points are too far apart for the time between them: give the legs more seconds",
                constraint=f"velocity, acceleration or jerk of {name}",
                violation=float(result.x[-1] - 1.0),
            )


def _check_via_points(problem: TorqueProblem) -> None:
    q = problem.family.via_points
    at_rest = States(problem.space.t, q, np.zeros_like(q), np.zeros_like(q))
    for function in problem.functions:
        value = function.values(at_rest)[0].max(axis=1)
        fixed = value if isinstance(function, ClearanceMargin) else value[[0, -1]]
        if fixed.max() > problem.options.constraint_tolerance:
            raise OptimisationFailed(
                "a via-point of the path breaks a bound, so every trajectory through it does",
                constraint=function.name,
                violation=float(fixed.max()),
            )
