"""Whether via-points rule out every trajectory through them, whatever its torque on the guardrail."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from cmbot.common.arrays import BoolArray
from cmbot.common.errors import OptimisationFailed
from cmbot.common.limit import Limit
from cmbot.optimization import KinematicBound, StateSamples
from cmbot.planning.torque.constraints import ClearanceMargin
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.trajectory import QuinticTrajectory

_SAMPLES_PER_SEGMENT = 6
# Segments beside one that breaks a bound: what is further away does nothing for it.
_NEIGHBOURS = 10


def check_feasible(problem: TorqueProblem) -> None:
    """Say at once when no trajectory through the via-points keeps the bounds.

    At the ends, where the arm rests, joint torques and the clearance are given; at the other via-points the
    clearance is.

    Where a joint's least-jerk spline breaks its velocity, acceleration or jerk bounds, a small linear program
    minimises the largest share of them at samples, there and a little around. Above 1 no trajectory through
    the via-points exists, whatever the torque; an optimisation would find out slowly.

    Raises
    ------
    OptimisationFailed
        Naming the constraint that cannot be met, and by how much.
    """
    _check_via_points(problem)
    least_jerk = problem.parametrization.trajectory
    bounds = [bound for bound in problem.bounds if bound.order > 0]
    for joint, broken in enumerate(_broken_segments(least_jerk, bounds).T):
        for first, last in _stretches(broken):
            share = _least_share(problem, least_jerk, bounds, joint, first, last)
            if share > 1.0:
                raise OptimisationFailed(
                    "the via-points are too far apart for the time between them",
                    constraint=f"velocity, acceleration or jerk of {problem.joints[joint]}",
                    violation=share - 1.0,
                    limit=Limit.RATES,
                    time=float(problem.space.t[(first + last + 1) // 2]),
                    trajectory=least_jerk,
                )


def _broken_segments(trajectory: QuinticTrajectory, bounds: Sequence[KinematicBound]) -> BoolArray:
    """On which segments joints exceed one of their bounds, (m, n)."""
    broken = np.zeros(trajectory.coefficients.shape[:2], dtype=np.bool_)
    for bound in bounds:
        low, high = trajectory.hull(bound.order)
        # What keeps the bound by the hull keeps it; elsewhere extrema have to say so.
        segment, joint = np.nonzero(np.maximum(high, -low) > bound.scale)
        largest = np.abs(trajectory.extrema_at(bound.order, segment, joint).value).max(axis=1, initial=0.0)
        over = largest > bound.scale[joint]
        broken[segment[over], joint[over]] = True
    return broken


def _stretches(broken: BoolArray) -> list[tuple[int, int]]:
    """First and last segments of stretches around the `broken` ones (m,), which do not touch each other."""
    near = np.convolve(broken, np.ones(2 * _NEIGHBOURS + 1))[_NEIGHBOURS : _NEIGHBOURS + len(broken)] > 0
    edges = np.flatnonzero(np.diff(near.astype(int), prepend=0, append=0))
    return [(int(first), int(end) - 1) for first, end in edges.reshape(-1, 2)]


def _least_share(
    problem: TorqueProblem,
    least_jerk: QuinticTrajectory,
    bounds: Sequence[KinematicBound],
    joint: int,
    first: int,
    last: int,
) -> float:
    """Smallest possible largest share of a joint's bounds on the segments `first` to `last`."""
    # Rarely needed.
    from scipy.optimize import linprog

    t = problem.space.t[first : last + 2]
    grid = np.linspace(t[:-1], t[1:], _SAMPLES_PER_SEGMENT, endpoint=False, axis=1)
    times = np.append(grid.ravel(), t[-1])
    A = sparse.csc_array(
        sparse.vstack(
            [problem.space.design(times, b.order) @ problem.space.basis / b.scale[joint] for b in bounds]
        )
    )
    A = A[:, np.flatnonzero(np.diff(A.indptr))]
    c = np.concatenate([least_jerk.evaluate(times, b.order)[:, joint] / b.scale[joint] for b in bounds])
    share = -np.ones((len(c), 1))
    result = linprog(
        np.append(np.zeros(A.shape[1]), 1.0),
        A_ub=sparse.block_array([[A, share], [-A, share]], format="csr"),
        b_ub=np.concatenate([-c, c]),
        bounds=(None, None),
        method="highs",
    )
    return -np.inf if result.x is None else float(result.x[-1])


def _check_via_points(problem: TorqueProblem) -> None:
    at_rest = StateSamples.at_rest(problem.space.t, problem.parametrization.via_points)
    for function in problem.constraints:
        value = function.sample(at_rest)[0].max(axis=1)
        which = slice(None) if isinstance(function, ClearanceMargin) else [0, -1]
        fixed = value[which]
        if fixed.max() > problem.request.cell.options.constraint_tolerance:
            raise OptimisationFailed(
                "a via-point of the path breaks a bound, so every trajectory through it does",
                constraint=function.name,
                violation=float(fixed.max()),
                limit=function.limit,
                time=float(problem.space.t[which][fixed.argmax()]),
                trajectory=problem.parametrization.trajectory,
            )
