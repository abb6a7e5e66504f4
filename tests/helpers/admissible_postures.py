"""Postures that a plan may pass a via-point in, found without charts."""

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.request import StrokeRequest


def values(asked: StrokeRequest, q: FloatArray) -> FloatArray:
    """The objective at rest."""
    return asked.cell.objective.at_rest(asked.cell.postures.at(q))


def admissible(asked: StrokeRequest, q: FloatArray) -> BoolArray:
    """Which postures are within joint ranges and torques, and clear."""
    limits, at = asked.cell.robot.limits, asked.cell.postures.at(q)
    holds = ((q >= limits.lower) & (q <= limits.upper)).all(axis=1)
    holds &= (np.abs(at.joint_torque) <= limits.torque).all(axis=1)
    holds[holds] = asked.cell.clear(q[holds])
    return holds


def restarts(asked: StrokeRequest, via_point: int, rng: np.random.Generator, number: int) -> FloatArray:
    """Admissible ones among random postures with the tool where it is at a via-point."""
    limits = asked.cell.robot.limits
    low, high = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    q = rng.uniform(low, high, (number, len(low)))
    placed, reached = project_onto_task(asked.cell.postures, asked.task, q, asked.goals[via_point], steps=40)
    placed = placed[reached]
    return placed[admissible(asked, placed)]
