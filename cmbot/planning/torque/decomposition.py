"""Solving the torque problem; long paths in segments, so that the cost grows in proportion to the path.

Steps of one large program are refused as a whole for what is violated anywhere, so the longer the path, the
smaller the steps. Where legs meet the tool rests, and the arm may rest as well: in the posture of the initial
guess, with no acceleration and no jerk. What lies between two such rests is a program of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed
from cmbot.optimization import ExchangeOptions, ExchangeReport, SqpOptions, minimize_peak
from cmbot.planning.torque.feasibility import check_feasible
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


def optimise(problem: TorqueProblem, progress: Callable[[ExchangeReport], None] | None = None) -> Optimised:
    """Solve the torque problem.

    Parameters
    ----------
    problem : TorqueProblem
    progress : callable, optional
        Called with an `ExchangeReport` after every exchange iteration.

    Raises
    ------
    OptimisationFailed
        When the via-points admit no trajectory within the limits, or none was found.
    """
    parts = segments(problem)
    because = ""
    if len(parts) > 1:
        try:
            return _in_segments(problem, parts, progress)
        except OptimisationFailed as failure:
            # To rest at every end of a segment may be too much to ask; the whole path does not ask it. Laws
            # that were sought along a joint path rest there anyway.
            if _is_timed(problem) or not _is_near_end(problem, parts, failure):
                raise
            because = failure.reason
    if problem.parametrization.retraction is None:
        check_feasible(problem)
    result = minimize_peak(problem, exchange_options(problem), progress)
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


def joined(trajectories: list[QuinticTrajectory]) -> QuinticTrajectory:
    """Put trajectories one behind the other; each begins at rest where and when the one before ends."""
    *some, last = trajectories

    def all_of(name: str) -> FloatArray:
        return np.concatenate([*(getattr(each, name)[:-1] for each in some), getattr(last, name)])

    return QuinticTrajectory(t=all_of("t"), q=all_of("q"), v=all_of("v"), a=all_of("a"))


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
) -> Optimised:
    """Solve a long path's problem in parts; exchange iterations are counted through."""
    passes: list[ExchangeReport] = []

    def report(each: ExchangeReport) -> None:
        passes.append(replace(each, number=len(passes) + 1))
        if progress is not None:
            progress(passes[-1])

    done = [optimise(problem.segment(first, last), report) for first, last in parts]
    trajectory = joined([each.trajectory for each in done])
    return Optimised(
        trajectory=trajectory,
        via_points=trajectory.q,
        passes=tuple(passes),
        complete=all(each.complete for each in done),
        failure=next((each.failure for each in done if each.failure is not None), None),
    )
