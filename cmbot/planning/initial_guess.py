"""The two ways to via-points: on the path of gradient projection, or sliding to where the torque is least."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.context import PlanningContext
from cmbot.planning.path.initial_postures import find_path
from cmbot.planning.path.projection import project_onto_task
from cmbot.planning.selfmotion.charts import Chart
from cmbot.planning.selfmotion.global_search import GlobalSearch, GlobalSolution
from cmbot.planning.selfmotion.lower_bound import LowerBound
from cmbot.planning.torque.problem import TorqueProblem, parametrization_through

__all__ = ["Choice", "InitialGuess", "fixed_guess", "shifted_problem", "sliding_guess"]


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What the global stage found for each choice of the start.

    Attributes
    ----------
    free, pinned : float or None
        Peak of the objective at rest over the via-points; None where there is no way.
    """

    free: float | None
    pinned: float | None


@dataclass(frozen=True, kw_only=True)
class InitialGuess:
    """Where the optimisation starts, and what is known of it.

    Attributes
    ----------
    problem : TorqueProblem
    resting : tuple of int
        Via-points where the arm rests in a posture that does not slide.
    least : float
        What the objective's peak cannot fall below, but for what motion takes off.
    failures : tuple of PathNotFound
        Starts that led nowhere, the scene's posture first.
    floor : LowerBound or None
        With sliding knots only.
    choice : Choice or None
        With sliding knots only.
    chart : Chart or None
        Of the self-motion at the start; with sliding knots only.
    stage : GlobalSearch or None
        Where it comes from; with sliding knots only.
    unreached : PathNotFound or None
        Why no approach leads to where ``start: free`` would have the arm start, if that was tried.
    instead_of : str
        Where the steps between via-points had to be shorter than asked for: why; else empty.
    """

    problem: TorqueProblem
    resting: tuple[int, ...]
    least: float
    failures: tuple[PathNotFound, ...] = ()
    floor: LowerBound | None = None
    choice: Choice | None = None
    chart: Chart | None = None
    stage: GlobalSearch | None = None
    unreached: PathNotFound | None = None
    instead_of: str = ""


def fixed_guess(context: PlanningContext) -> InitialGuess:
    """Take via-points from the path of gradient projection, to stay there (Chang 2021, Eqs. (15)-(30)).

    Raises
    ------
    PathNotFound
        When no start leads to the end of the path.
    """
    path, failures = find_path(context)
    rough = np.stack([np.interp(context.times, path.t, joint) for joint in path.q.T], axis=1)
    form = parametrization_through(context, _placed(context, rough), sliding=False)
    least = float(context.objective.at_rest(context.postures.at(form.via_points)).max())
    problem = TorqueProblem(context, form, least)
    return InitialGuess(problem=problem, resting=(0, -1), least=least, failures=failures)


def sliding_guess(
    context: PlanningContext, unreached: PathNotFound | None = None, stage: GlobalSearch | None = None
) -> InitialGuess:
    """Take via-points from the global stage, to slide along the self-motion.

    With ``start: free`` the arm starts wherever the tool is the same, if that is worth leaving the scene's
    posture; with ``pinned`` in the scene's posture, or, where no path leads on from there, in the nearest one
    from which a path does.

    Parameters
    ----------
    setting : PlanningContext
    unreached : PathNotFound, optional
        Why no approach leads to where ``start: free`` would have the arm start: it is treated as pinned.
    stage : GlobalSearch, optional
        Of the same setting, where its charts are known already.

    Raises
    ------
    PathNotFound
        When the scene's posture is in collision or within the safety margin, a via-point is blocked, or
        nothing leads from one to the next.
    """
    options = context.options
    if stage is None:
        _require_clear_start(context)
        stage = GlobalSearch(context)
    free, pinned = (_tried(stage, pinned=choice) for choice in (False, True))
    failures: tuple[PathNotFound, ...] = () if unreached is None else (unreached,)
    if isinstance(free, PathNotFound):
        raise free
    may_leave = options.start == "free" and unreached is None
    if isinstance(pinned, GlobalSolution):
        worth_leaving = pinned.peak > free.peak * (1 + options.gap_target)
        solution = free if may_leave and worth_leaving else pinned
    elif may_leave:
        solution = free
    else:
        solution, failures = stage.solve_elsewhere(pinned)
    stays = solution is not free
    form = parametrization_through(context, solution.q, sliding=True, pinned=stays)
    return InitialGuess(
        problem=TorqueProblem(context, form, stage.lower_bound.value),
        resting=(0,) if stays else (),
        least=stage.lower_bound.value,
        failures=failures,
        floor=stage.lower_bound,
        choice=Choice(free=free.peak, pinned=pinned.peak if isinstance(pinned, GlobalSolution) else None),
        chart=stage.first_chart,
        stage=stage,
        unreached=unreached,
    )


def shifted_problem(context: PlanningContext, way: InitialGuess, via_points: FloatArray) -> TorqueProblem:
    """Return the problem of a way once more, along a tool path that lies a little beside.

    Parameters
    ----------
    setting : PlanningContext
        With the tool path as it is now.
    way : InitialGuess
        Along the tool path as it was.
    via_points : (n, d), rad
        Near those to start from.

    Raises
    ------
    PathNotFound
        When a via-point cannot be put onto the tool path.
    """
    sliding = way.floor is not None
    pinned = sliding and 0 in way.resting
    placed = _placed(context, via_points)
    form = parametrization_through(context, placed, sliding=sliding, pinned=pinned)
    return TorqueProblem(context, form, way.least)


def _require_clear_start(context: PlanningContext) -> None:
    """Refuse a scene's posture that nothing can lead out of: neither the work nor an approach."""
    margin, q = context.options.safety_margin_m, context.posture
    smallest = context.clearances.smallest(q[None])
    distance = float(smallest.distance[0])
    if distance >= margin:
        return
    shapes = context.clearances.pairs[smallest.pair[0]]
    other = (
        "where they are always that near, let robot.srdf disable the pair"
        if context.robot.model.existFrame(shapes.other)
        else "move the obstacle"
    )
    raise context.path_not_found(
        f"in the scene's posture {shapes.describe(distance, margin)}; take another posture_deg, lower "
        f"planner.safety_margin_m, or {other}",
        q,
        pair=(shapes.link, shapes.other),
    )


def _tried(stage: GlobalSearch, *, pinned: bool) -> GlobalSolution | PathNotFound:
    try:
        return stage.solve(pinned=pinned)
    except PathNotFound as failure:
        return failure


def _placed(context: PlanningContext, rough: FloatArray) -> FloatArray:
    """Project postures (n, d) near the via-points onto the tool task."""
    q, reached = project_onto_task(
        context.postures, context.task, rough, context.points, steps=50, tolerance=1e-12
    )
    for k in np.flatnonzero(~reached)[:1]:
        raise context.path_not_found(
            f"via-point {k + 1} cannot be put onto the tool path exactly: out of reach or singular",
            rough[k],
            context.times[k],
        )
    return q
