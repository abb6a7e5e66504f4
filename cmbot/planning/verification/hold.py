"""What the feet bear, computed a second time from the formulas of the documents."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.hold import Foot
from cmbot.planning.certification.check import Check, largest_check
from cmbot.robot import Robot

# What two computations may differ by, as a share of the largest, and N; by what share a bound may be missed.
_SAME, _LEAST, _LIMIT = 1e-6, 1e-6, 1e-9
# Points along a quarter's edge by which distances from the centre are averaged.
_POINTS = 40


def hold_checks(robot: Robot, times: FloatArray, wrench: FloatArray) -> Iterator[Check]:
    """Yield what the package's adhesion differs by, and what feet bear against their bounds.

    How two feet share a wrench is the elastic frame's, which is not judged.

    Parameters
    ----------
    robot : Robot
    times : (N,), s
    wrench : (N, 6), N and Nm
        Of the moving arm on the guardrail, about O0 in W.
    """
    if robot.holding is None:
        return
    # The constant part is that of one body.
    rest = robot.model.inertias[0]
    weight = rest.mass * np.array(robot.model.gravity.linear)
    whole = wrench + np.hstack([weight, np.cross(rest.lever - np.array(robot.foot_point), weight)])
    for number, foot in enumerate(robot.feet):
        which = f" of foot {number + 1}" if len(robot.feet) > 1 else ""
        force, torque = np.split(whole @ foot.share.T, 2, axis=1)
        load = np.hstack([force @ foot.axes.T, (torque - np.cross(foot.centre, force)) @ foot.axes.T])
        if foot.half is not None:
            own = np.maximum(_adhesion(foot, load), 0.0)
            theirs = np.maximum(robot.holding.needed(number, wrench), 0.0)
            quantity = f"difference of the adhesion needed{which} from a second computation"
            yield largest_check(
                quantity, times, np.abs(own - theirs), max(_SAME * float(own.max()), _LEAST), "N"
            )
            if foot.adhesion is not None:
                bound = foot.adhesion / foot.safety * (1 + _LIMIT)
                quantity = f"adhesion needed{which} by a second computation"
                yield largest_check(quantity, times, own, bound, "N")
        if foot.force is not None and foot.moment is not None:
            use = foot.safety * (np.abs(load) / np.array([*foot.force, *foot.moment])).max(axis=1)
            quantity = f"load of the clamp{which} by a second computation"
            yield largest_check(quantity, times, use, 1 + _LIMIT, "of its bounds")


def _adhesion(foot: Foot, load: FloatArray) -> FloatArray:
    """What a flat contact needs (N,), N, under loads (N, 6): the mean distance by points of a quarter."""
    along, across = foot.half or (np.nan, np.nan)
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
    # Graded towards the centre, where the distance is not smooth.
    share, weight = (0.5 * (1 + nodes)) ** 3, weights * 1.5 * (0.5 * (1 + nodes)) ** 2
    radius = float(weight @ np.hypot(along * share[:, None], across * share) @ weight)
    slide_u, slide_w, pull, about_u, about_w, torsion = load.T
    rest = np.sqrt(slide_u**2 + slide_w**2) / foot.friction
    rest += np.sqrt((about_u / across) ** 2 + (about_w / along) ** 2)
    slip = (rest**1.25 + (np.abs(torsion) / (foot.friction * radius)) ** 1.25) ** 0.8
    tip = np.maximum(np.abs(about_u) / across, np.abs(about_w) / along)
    return np.asarray(pull + np.maximum(tip, slip))
