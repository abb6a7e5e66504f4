"""What most postures lack: the pair that is too near, the joint that is too weak or out of its range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.common.reading.validation import counted
from cmbot.planning.workcell.workcell import Workcell

FEET = "a foot"
"""What `weakest_joint` returns where no joint is weakest."""


def most_often_near(cell: Workcell, q: FloatArray) -> tuple[str, str] | None:
    """Return the link and the obstacle, or second link, that are nearest in most of postures (N, n)."""
    nearest = cell.clearances.query(q).pair
    nearest = nearest[nearest >= 0]
    if not len(nearest):
        return None
    pair = cell.clearances.pairs[int(np.bincount(nearest).argmax())]
    return pair.link, pair.other


def weakest_joint(cell: Workcell, q: FloatArray) -> str:
    """Return the joint that at rest uses most of its torque in most of postures (N, n), or the feet.

    Joints that are locked below the arm are among them.
    """
    at, robot = cell.postures.at(q), cell.robot
    held = robot.holding_use(at.guardrail_wrench)
    use = np.hstack([np.abs(at.joint_torque) / robot.limits.torque, held])
    if (cell.use_at_rest(at) > use.max(axis=1)).mean() > 0.5:
        return FEET
    joints = [*robot.joints, *(f"the locked {joint.name}" for joint in robot.holding_joints)]
    return joints[int(np.bincount(use.argmax(axis=1)).argmax())]


def overload(cell: Workcell, q: FloatArray) -> str:
    """Return in words what a posture (n,) asks too much of at rest, a joint or a foot; else nothing."""
    at = cell.postures.at(q[None])
    use, holding = float(cell.use_at_rest(at)[0]), cell.robot.holding
    if use <= 1.0:
        return ""
    joint, limit = weakest_joint(cell, q[None]), "torque"
    if joint == FEET and holding is not None:
        most = holding.most_used(at.guardrail_wrench)
        limit = f"hold ({most.bound}{'' if most.bound == 'adhesion_n' else f'[{most.axis}]'})"
    return f"{joint} uses {ceil(100 * use)}% of its {limit}"


def out_of_range(cell: Workcell, q: FloatArray) -> str:
    """Return the joint that is out of its range in most of postures (N, n); empty where none is."""
    limits = cell.robot.limits
    number = ((q < limits.lower) | (q > limits.upper)).sum(axis=0)
    return cell.robot.joints[int(number.argmax())] if number.any() else ""


def nearest_to_end(cell: Workcell, q: FloatArray) -> str:
    """Return the joint that in a posture (n,) is nearest to an end of its range."""
    limits = cell.robot.limits
    room = cell.robot.metric.coordinates(np.minimum(q - limits.lower, limits.upper - q))
    return cell.robot.joints[int(room.argmin())]


def no_start_left(failures: Sequence[PathNotFound]) -> PathNotFound:
    """Return the first failure, with the number of the others."""
    first, others = failures[0], len(failures) - 1
    reason = first.reason
    if others:
        furthest = max(failure.progress for failure in failures)
        fail = "fails" if others == 1 else "fail"
        reason += (
            f"; {counted(others, 'other starting posture')} {fail} as well "
            f"(the best at {furthest:.0%} of the path)"
        )
    return replace(first, reason=reason, stopped=False, key="")
