"""What a simulation says in short: how much the tool sags and sways, and whether that is allowed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning import Plan
from cmbot.simulation.tracking import MotionTracking, Tracking

__all__ = ["off_path", "tracking_answer", "tracking_verdict"]


def tracking_answer(tracking: Tracking, *, compensated: bool) -> Iterator[tuple[str, str, str]]:
    """Yield a few figures in mm, each as its name, the baseline's and the planned motion's.

    Parameters
    ----------
    tracking : Tracking
    compensated : bool
        The plan compensates the predicted sag.
    """
    both = tracking.baseline, tracking.planned
    sag = "tool sags beyond what was foreseen, mean" if compensated else "tool sags, mean"
    yield _row(sag, [motion.figures.static.mean[3] for motion in both])
    yield _row("tool sways beside its sag, at most", [_largest(motion.dynamic, motion) for motion in both])
    yield _row("bent tool off its path, at most", [off_path(motion) for motion in both])
    swings = [motion.figures.residual.diameter for motion in both if motion.figures.residual is not None]
    if len(swings) == len(both):
        yield _row("tool swings after the stop", swings)


def tracking_verdict(plan: Plan, tracking: Tracking) -> str:
    """Return whether the bent tool keeps to the path as the plan's option asks, and what to do if not.

    Parameters
    ----------
    plan : Plan
    tracking : Tracking
        Of that plan.
    """
    allowed, off = plan.options.max_tool_deviation_m, off_path(tracking.planned)
    bound = f"{1e3 * allowed:g} mm (max_tool_deviation_m)"
    if off <= allowed:
        return f"Within the margin: bent as it is, the tool stays within {bound} of its path."
    text = f"Not within the margin: bent as it is, the tool leaves its path by more than {bound}"
    if plan.options.compensate:
        return (
            f"{text}, though the foreseen sag is compensated: what bends here is not what was planned with."
        )
    if _largest(tracking.planned.dynamic, tracking.planned) <= allowed:
        return f"{text}. That is sag, which can be foreseen: with compensate: true the plan makes up for it."
    return f"{text}. With compensate: true the plan makes up for the sag, not for the swaying."


def off_path(motion: MotionTracking) -> float:
    """Largest distance of the bent tool from its path while the joints move, m."""
    return _largest(motion.path_error, motion)


def _largest(error: FloatArray, motion: MotionTracking) -> float:
    """Largest norm of an error (N, 3) while the joints move, m."""
    moving = motion.t <= motion.stop * (1 + 1e-12)
    return float(np.linalg.norm(error[moving], axis=1).max())


def _row(name: str, pair: list[float]) -> tuple[str, str, str]:
    return name, f"{1e3 * pair[0]:.3f}", f"{1e3 * pair[1]:.3f}"
