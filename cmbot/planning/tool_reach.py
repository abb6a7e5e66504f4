"""Whether the arm is long enough for the ends of the legs: what is further away needs no search."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.common.errors import PathNotFound
from cmbot.planning.context import PlanningContext
from cmbot.robot import Robot
from cmbot.scene import ToolPath

__all__ = ["BeyondReach", "beyond_reach", "require_within_reach"]

# A stretched arm is not out of its own reach.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class BeyondReach:
    """A leg whose end no posture reaches.

    Attributes
    ----------
    key : str
        Of the leg in a scene file.
    distance : float, m
        Of its end from the arm's first joint.
    reach : float, m
        The largest that there can be: `Robot.reach`.
    """

    key: str
    distance: float
    reach: float


def beyond_reach(robot: Robot, path: ToolPath) -> Iterator[BeyondReach]:
    """Yield the legs that end further from the arm's first joint than the stretched arm reaches.

    What lies between two ends within reach is within reach.

    Parameters
    ----------
    robot : Robot
    path : ToolPath
    """
    reach = robot.reach
    distances = np.linalg.norm(path.corners[1:] - robot.base_point, axis=1)
    for k in np.flatnonzero(distances > reach * (1 + _ROUNDING)):
        yield BeyondReach(key=f"tool_path.legs[{k}].by", distance=float(distances[k]), reach=reach)


def require_within_reach(context: PlanningContext) -> None:
    """Refuse a tool path that leaves the reach of the stretched arm.

    Raises
    ------
    PathNotFound
        Naming the first leg that ends out of reach, and by how much.
    """
    path, robot = context.task.path, context.robot
    first = next(beyond_reach(robot, path), None)
    if first is None:
        return
    away = np.linalg.norm(path.position(context.times) - robot.base_point, axis=1)
    time = float(context.times[np.argmax(away > first.reach * (1 + _ROUNDING))])
    raise PathNotFound(
        f"{first.key} ends {first.distance:.3f} m from the arm's first joint, "
        f"{first.distance - first.reach:.3f} m out of reach (the arm with its tool stretched out is "
        f"{first.reach:.3f} m long); shorten the leg (lengths are in metres), or take another posture_deg",
        time=time,
        progress=path.progress(time),
        # The stretched arm cannot move further out.
        smallest_singular_value=0.0,
    )
