"""Solving the torque problem; long paths in segments, so that the cost grows in proportion to the path.

Steps of one large program are refused as a whole for what is violated anywhere, so the longer the path, the
smaller the steps. Where legs meet the tool rests, and the arm may rest as well: in the posture of the initial
guess, with no acceleration and no jerk. What lies between two such rests is a program of its own.

Before it is solved it is asked whether its via-points rule out every trajectory through them, whatever
its torque on the guardrail.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from cmbot.common.arrays import BoolArray, FloatArray, runs
from cmbot.common.errors import OptimisationFailed
from cmbot.common.limit import Limit
from cmbot.optimization import (
    ExchangeOptions,
    ExchangeReport,
    KinematicBound,
    SqpOptions,
    StateSamples,
    meet_constraints,
    minimize_peak,
)
from cmbot.planning.torque.constraints import ClearanceMargin
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.trajectory import QuinticTrajectory

LONGEST_WHOLE = 300
"""Paths of up to so many via-points are one segment."""

# Longer ones are parted at the first corner after so many via-points, or a better one soon after.
_MIN_PART_VIA_POINTS, _MAX_PART_VIA_POINTS = 100, 200
# Rest at a via-point matters up to so many from it: what splines do at a knot dies out from there.
_RESTING = 10
# The SQP meets known constraints so much better than they have to be met.
_SQP_TOLERANCE_SHARE = 0.5
# It ends where a step promises no more than this share of the objective, or so many steps gain no more than
# that share together: a plan's peak and mean matter to a thousandth.
_OPTIMALITY_SHARE, _STALL_STEPS, _STALL_GAIN = 5e-5, 4, 5e-4
# And where so many steps do not bring violations beyond this down to that share: hardly any trajectory near
# keeps the constraints.
_INFEASIBLE_STEPS, _INFEASIBLE_SHARE, _INFEASIBLE_VIOLATION = 6, 0.5, 0.3
# Its first trust region where the tool is held loosely: what holds it else keeps first steps from going far
# into obstacles, which are not known yet.
_LOOSE_RADIUS = 0.5
_SAMPLES_PER_SEGMENT = 6
# Segments beside one that breaks a bound: what is further away does nothing for it.
_NEIGHBOURS = 10


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimised:
    """An optimised trajectory and how it was found.

    Attributes
    ----------
    trajectory : QuinticTrajectory
    via_points : (n, d), rad
        What it was to pass through: those given, or where they moved to.
    passes : tuple of ExchangeReport
    whole_because : str
        Of a long path that had to be solved whole: why its segments could not be; else empty.
    complete : bool
        The time was not over before the optimum was found, and no stage failed.
    failure : OptimisationFailed, optional
        Why no trajectory met all constraints, where this one misses them by little.
    sway : two floats, optional
        Largest sway and swing, m, where they were integrated.
    """

    trajectory: QuinticTrajectory
    via_points: FloatArray
    passes: tuple[ExchangeReport, ...]
    whole_because: str = ""
    complete: bool = True
    failure: OptimisationFailed | None = None
    sway: tuple[float, float] | None = None

    @classmethod
    def start(cls, problem: TorqueProblem) -> Optimised:
        """Return the trajectory that a problem starts from, as it is."""
        form = problem.parametrization
        return cls(trajectory=form.trajectory, via_points=form.via_points, passes=())


def optimise(
    problem: TorqueProblem,
    progress: Callable[[ExchangeReport], None] | None = None,
    *,
    feasible: bool = False,
) -> Optimised:
    """Solve the torque problem.

    Parameters
    ----------
    problem : TorqueProblem
    progress : callable, optional
        Called with an `ExchangeReport` after every exchange iteration.
    feasible : bool
        The first motion that meets the constraints is enough.

    Raises
    ------
    OptimisationFailed
        When the via-points admit no trajectory within the limits, or none was found.
    """
    parts = segments(problem)
    because = ""
    if len(parts) > 1:
        try:
            return _in_segments(problem, parts, progress, feasible=feasible)
        except OptimisationFailed as failure:
            # To rest at every end of a segment may be too much to ask; the whole path does not ask it. Laws
            # that were sought along a joint path rest there anyway.
            if _is_timed(problem) or not _is_near_end(problem, parts, failure):
                raise
            because = failure.reason
    if problem.parametrization.retraction is None:
        check_feasible(problem)
    solve = meet_constraints if feasible else minimize_peak
    result = solve(problem, exchange_options(problem), progress)
    form = result.parametrization
    return Optimised(
        trajectory=form.trajectory,
        via_points=form.via_points,
        passes=result.passes,
        whole_because=because,
        complete=result.complete,
        failure=result.failure,
    )


def segments(problem: TorqueProblem) -> list[tuple[int, int]]:
    """Return the first and the last via-point of each segment of a problem's path; short paths are one.

    Of the corners in reach a segment ends at the one where the objective at rest is least.
    """
    t = problem.space.t
    last = len(t) - 1
    if last + 1 <= LONGEST_WHOLE or problem.request.cell.options.solver == "slsqp":
        return [(0, last)]
    # Inner via-points at which legs meet; `ToolPath.via_times` puts one exactly there.
    corners = np.flatnonzero(np.isin(t, problem.request.task.path.leg_times[1:-1]))
    parts, first = [], 0
    while last - first > _MAX_PART_VIA_POINTS:
        candidates = corners[
            (corners >= first + _MIN_PART_VIA_POINTS) & (corners <= last - _MIN_PART_VIA_POINTS)
        ]
        near = candidates[candidates <= first + _MAX_PART_VIA_POINTS]
        if len(candidates) == 0:
            break
        end = int(near[problem.at_via_points[near].argmin()] if len(near) else candidates[0])
        parts.append((first, end))
        first = end
    return [*parts, (first, last)]


def exchange_options(problem: TorqueProblem) -> ExchangeOptions:
    """Return how a problem's own options have it solved."""
    o = problem.request.cell.options
    return ExchangeOptions(
        solver=o.solver,
        smoothing=o.smoothing_weight,
        peak_tolerance=o.peak_tolerance,
        least_peak_tolerance=o.least_peak_tolerance,
        feasibility_tolerance=o.constraint_tolerance,
        max_passes=o.max_passes,
        max_iterations=o.max_iterations,
        sqp=SqpOptions(
            optimality_tolerance=_OPTIMALITY_SHARE,
            stall_steps=_STALL_STEPS,
            stay_steps=_STALL_STEPS,
            stall_tolerance=_STALL_GAIN,
            infeasible_steps=_INFEASIBLE_STEPS,
            infeasible_share=_INFEASIBLE_SHARE,
            infeasible_violation=_INFEASIBLE_VIOLATION,
            feasibility_tolerance=_SQP_TOLERANCE_SHARE * o.constraint_tolerance,
            max_iterations=min(SqpOptions.max_iterations, o.max_iterations),
            initial_radius=_LOOSE_RADIUS if problem.request.tool_share > 1.0 else SqpOptions.initial_radius,
        ),
        stop=problem.request.deadline.expired,
        stop_reason=lambda: problem.request.deadline.over_in_words,
    )


def _is_timed(problem: TorqueProblem) -> bool:
    """Whether all legs of the path have laws along a joint path."""
    stroke = problem.request.stroke
    return len(stroke.file.time_laws or ()) == len(stroke.path.segments)


def _is_near_end(problem: TorqueProblem, parts: list[tuple[int, int]], failure: OptimisationFailed) -> bool:
    """Whether a constraint is violated so near an end of a segment that rest there may be the reason."""
    if failure.time is None:
        return True
    t, ends = problem.space.t, np.array([last for _, last in parts[:-1]])
    first, last = t[np.maximum(ends - _RESTING, 0)], t[np.minimum(ends + _RESTING, len(t) - 1)]
    return bool(((first <= failure.time) & (failure.time <= last)).any())


def _in_segments(
    problem: TorqueProblem,
    parts: list[tuple[int, int]],
    progress: Callable[[ExchangeReport], None] | None,
    *,
    feasible: bool,
) -> Optimised:
    """Solve a long path's problem in parts; exchange iterations are counted through."""
    passes: list[ExchangeReport] = []

    def report(each: ExchangeReport) -> None:
        passes.append(replace(each, number=len(passes) + 1))
        if progress is not None:
            progress(passes[-1])

    done = [optimise(problem.segment(*part), report, feasible=feasible) for part in parts]
    trajectory = QuinticTrajectory.joined([each.trajectory for each in done])
    return Optimised(
        trajectory=trajectory,
        via_points=trajectory.q,
        passes=tuple(passes),
        complete=all(each.complete for each in done),
        failure=next((each.failure for each in done if each.failure is not None), None),
    )


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
    return runs(near)


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
