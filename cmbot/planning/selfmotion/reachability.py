"""Proofs that no posture holds the tool at a via-point.

The links alone bound how far from the first joint the tool may be, and how near: the polygon inequality.
Where a spherical joint decouples the arm, boxes of joint angles that cover all postures are dropped until
none is left, or until that takes too long.
"""

from __future__ import annotations

import numpy as np

from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.proof import TorqueFloorProof
from cmbot.planning.selfmotion.spherical_joint import wrist_chain
from cmbot.planning.workcell.objectives import WeightedMoment

REACH_TOLERANCE = 1e-9
"""A stretched or folded arm is not out of its own reach, by this share of it."""


def out_of_reach(request: StrokeRequest, via_point: int) -> str:
    """Return why no posture within the joint ranges holds the tool at a via-point; empty without a proof."""
    robot = request.cell.robot
    distance = float(np.linalg.norm(request.goals.point[via_point] - robot.base_point))
    where = f"out of reach: the tool point is {distance:.3f} m from the arm's first joint"
    # A fixed tool's point is none in W.
    if robot.fixed_tool is None and distance > robot.reach * (1 + REACH_TOLERANCE):
        return f"{where}, which the arm with its tool stretched out, {robot.reach:.3f} m, does not reach"
    if robot.fixed_tool is None and distance < robot.inner_reach * (1 - REACH_TOLERANCE):
        return f"{where}, nearer than {robot.inner_reach:.3f} m, as near as its links can bring it"
    chain = wrist_chain(request)
    # Any objective: none is bounded.
    norm = WeightedMoment(np.zeros(3), np.ones(3))
    if chain is not None and TorqueFloorProof(request, chain, norm).holds_nothing(via_point):
        return (
            f"out of reach: no posture within the joint ranges holds the tool's {request.task.keep} there "
            "(proven)"
        )
    return ""
