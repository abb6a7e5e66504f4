"""Calmer ways through the charts, for where no trajectory follows the way of least torque.

The global stage bounds the steps between via-points by the joints' velocities alone. Steps may so turn round
from one via-point to the next, faster than accelerations and jerks allow; the shorter the steps, the less.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cmbot.common.errors import OptimisationFailed, PathNotFound
from cmbot.planning.context import PlanningContext
from cmbot.planning.initial_guess import InitialGuess, sliding_guess
from cmbot.planning.torque.problem import TorqueProblem

__all__ = ["calmer_ways", "followed", "roughness"]

# Steps are halved so often at most, and so many other ways are tried. A way is worth another optimisation
# when it is rough by no more than this share of the one before.
_HALVINGS, _TRIES, _CALMER = 4, 2, 0.9

Work = TypeVar("Work")


def followed(
    context: PlanningContext, way: InitialGuess, work: Callable[[InitialGuess], Work]
) -> tuple[InitialGuess, Work]:
    """Return a way and the work along it: `way`, or where no trajectory follows that, a calmer one.

    Parameters
    ----------
    setting : PlanningContext
    way : InitialGuess
    work : callable
        What is to be done along a way.

    Raises
    ------
    OptimisationFailed
        Of `way`, when no calmer one is found that a trajectory follows.
    PathNotFound
        When no approach leads to where a way starts that may start elsewhere.
    """
    try:
        return way, work(way)
    except OptimisationFailed as failure:
        for calmer in calmer_ways(context, way, failure):
            try:
                return calmer, work(calmer)
            except OptimisationFailed:
                continue
            except PathNotFound:
                # No approach leads to where it starts; of a start that may be given up the caller knows more.
                if 0 not in calmer.resting:
                    raise
        raise


def calmer_ways(
    context: PlanningContext, way: InitialGuess, failure: OptimisationFailed
) -> Iterator[InitialGuess]:
    """Yield ways with ever shorter steps between via-points, each calmer than the one before.

    Their peak at rest may be higher. Where no path leads on from the scene's posture in shorter steps, they
    start elsewhere, as `sliding_guess` has it.

    Parameters
    ----------
    setting : PlanningContext
    way : InitialGuess
        That led to no trajectory; with fixed knots there is no other.
    failure : OptimisationFailed
        Why not.
    """
    if way.stage is None:
        return
    stage, rough, tries = way.stage, roughness(way.problem), 0
    for _ in range(_HALVINGS):
        if tries == _TRIES:
            return
        stage = stage.halved()
        context.reporter.step(f"no trajectory follows that way; trying step_share {stage.step_share:.3g}")
        try:
            calmer = sliding_guess(context, way.unreached, stage)
        except PathNotFound:
            return
        found = roughness(calmer.problem)
        if found <= _CALMER * rough:
            rough, tries = found, tries + 1
            instead_of = (
                f"With planner.step_share {context.options.step_share:g} no trajectory was found "
                f"({failure.reason}; {failure.constraint}): planned with {stage.step_share:.3g} instead, a "
                "calmer way through the postures."
            )
            yield replace(calmer, instead_of=instead_of)


def roughness(problem: TorqueProblem) -> float:
    """Largest velocity, acceleration or jerk where a problem starts, as a share of its bound."""
    start = problem.parametrization.trajectory
    shares = (
        np.abs(start.extrema(bound.order).value) / bound.scale[:, None]
        for bound in problem.bounds
        if bound.order > 0
    )
    return max(float(share.max()) for share in shares)
