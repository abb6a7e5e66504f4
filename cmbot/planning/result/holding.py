"""Whether the feet hold along a job: with what they have, with less, and in an emergency stop."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.hold import CLAMP_LOAD, AdhesionPeak, Foot, Holding
from cmbot.planning.result.plan import Plan
from cmbot.planning.result.verdict import during, tightest_check
from cmbot.robot import Dynamics, Robot

# States of a segment in which a stop is looked at.
_STATES = 200
# Arms with more joints are stopped with all of them at once alone.
_MOST_JOINTS = 8
# What a magnet is thought to lose to rust, paint and gaps.
_LESS = 0.2


def holding_remarks(plan: Plan) -> Iterator[str]:
    """Yield what is to be said of how the feet hold; nothing of a robot that has none.

    Parameters
    ----------
    plan : Plan
    """
    holding, needed = plan.robot.holding, plan.job.figures.adhesion_needed
    if holding is None:
        return
    if needed is not None:
        yield from _adhesion(plan, holding, needed)
    for number in holding.clamps:
        quantity = holding.named(CLAMP_LOAD, number)
        segment, check = tightest_check(plan.job, quantity)
        stop = max(float(holding.use(number, wrench).max()) for wrench, _ in _stops(plan))
        yield (
            f"Hold: the {quantity} included, uses {100 * check.value:.1f} % of its bounds at most, "
            f"{during(segment, plan.job)}, at {check.time:.1f} s. In an emergency stop, joints at their "
            f"bounds: {100 * stop:.1f} %."
        )
    if needed is None and not holding.bounded:
        yield "Hold: what the feet bear is not given, so nothing here says whether they hold."


def _adhesion(plan: Plan, holding: Holding, needed: AdhesionPeak) -> Iterator[str]:
    foot = holding.feet[needed.foot - 1]
    before = None if plan.baseline is None else plan.baseline.job_figures.adhesion_needed
    other = "" if before is None else f"; baseline {_kilonewtons(before.peak)}"
    of = f", foot {needed.foot}" if len(holding.feet) > 1 else ""
    most = f"{_kilonewtons(needed.peak)} ({needed.mode}, at {needed.time:.1f} s{of}{other})"
    stop = emergency_stop(plan)
    stopping = (
        ""
        if stop is None
        else f" In an emergency stop, joints at their bounds: {_stop(stop, holding.feet[stop.foot - 1])}."
    )
    if foot.kind == "welded":
        yield (
            "Hold: welded is assumed, so nothing here says whether the feet hold. As magnets they would need "
            f"an adhesion of {most} on {_contact(foot)}.{stopping}"
        )
    elif foot.adhesion is None:
        yield f"Hold: the {foot.kind} needs an adhesion of {most} on {_contact(foot)}.{stopping}"
    else:
        less = (1 - _LESS) * foot.adhesion
        factor = less / needed.peak if needed.peak > 0 else np.inf
        holds = (
            "it holds without the safety factor"
            if 1 <= factor < foot.safety
            else ("it holds" if factor >= foot.safety else "it does not hold")
        )
        yield (
            f"Hold: needs an adhesion of {most} on {_contact(foot)}, safety {foot.safety:g}, and has "
            f"{_kilonewtons(foot.adhesion)}; with {100 * _LESS:.0f} % less, {_kilonewtons(less)}, {holds}."
            f"{stopping}"
        )


def emergency_stop(plan: Plan) -> AdhesionPeak | None:
    """Return the largest adhesion needed where joints stop with their largest accelerations.

    At states along the job, whichever of the moving joints stop at that moment; the tool's force acts on
    while the tool is on.

    Parameters
    ----------
    plan : Plan
    """
    holding = plan.robot.holding
    if holding is None or not holding.adhesive:
        return None
    return max((holding.worst(*stops) for stops in _stops(plan)), key=lambda each: each.peak)


def _stops(plan: Plan) -> Iterator[tuple[FloatArray, FloatArray]]:
    """The wrenches (N, 6) of stops along each segment of the job, and when on its clock, (N,), s."""
    for segment in plan.job.segments:
        robot: Robot = plan.robot if segment.kind == "stroke" else plan.robot.tool_off
        t = np.linspace(segment.trajectory.t[0], segment.trajectory.t[-1], _STATES)
        q, v, _ = segment.trajectory.states(t)
        at = Dynamics(robot).wrench_derivatives(q, v, np.zeros_like(q))
        stops = -np.sign(v) * robot.limits.acceleration
        each = np.einsum("kin,kn->kni", at.d_a, stops)
        wrench = at.value[:, None] + _which(robot.dof) @ each
        yield wrench.reshape(-1, 6), np.repeat(segment.begin + t, wrench.shape[1])


def _which(joints: int) -> FloatArray:
    """Which joints stop, (k, n): every combination, or all of very many."""
    if joints > _MOST_JOINTS:
        return np.ones((1, joints))
    return np.array(list(product((0.0, 1.0), repeat=joints)))


def _stop(stop: AdhesionPeak, foot: Foot) -> str:
    text = f"{_kilonewtons(stop.peak)} ({stop.mode})"
    if foot.adhesion is None:
        return text
    return f"{text}, {'less' if stop.peak <= foot.adhesion else 'more'} than it has"


def _contact(foot: Foot) -> str:
    along, across = foot.half or (0.0, 0.0)
    return f"{2 * along:.3f} x {2 * across:.3f} m of steel (friction {foot.friction:g})"


def _kilonewtons(force: float) -> str:
    return f"{force / 1e3:.2f} kN"
