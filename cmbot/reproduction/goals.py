"""What a better plan is to gain against the baseline, and whether it does: computed from the figures."""

from __future__ import annotations

from collections.abc import Iterator

from cmbot.reproduction.compensation_goal import compensation_goal
from cmbot.reproduction.experiment import Experiment
from cmbot.reproduction.goal_table import GoalTable
from cmbot.reproduction.least_sag import least_sag
from cmbot.reproduction.posture_goal import posture_goal
from cmbot.reproduction.rest_goal import rest_goal

__all__ = ["goals"]


def goals(experiment: Experiment) -> Iterator[GoalTable]:
    """Yield the goals of one experiment, each with its figures and whether it holds.

    All of them are against the baseline in the same simulation: stiffness, damping and start are the same.
    """
    yield posture_goal(experiment.planned)
    yield compensation_goal(experiment.compensated)
    rest = rest_goal(experiment)
    if rest is not None:
        yield rest
    if experiment.least_sag is not None:
        yield least_sag(experiment.planned, experiment.least_sag)
