"""The first goal: better postures alone make the mean error smaller."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.reproduction.experiment import Run, axes, reduction
from cmbot.reproduction.goal_table import GoalRow, GoalTable, Verdict, axes_where, values

__all__ = ["posture_goal"]


def posture_goal(run: Run) -> GoalTable:
    """Compare the norms of the mean errors, and say along which axis the mean grows."""
    before, after = (axes(motion)[0] for motion in (run.equilibrium.baseline, run.equilibrium.planned))
    norms = np.array([np.linalg.norm(mean) for mean in (before, after)])
    cut = 100 * (1 - norms[1] / norms[0])
    rows = (
        GoalRow(setting="without", what="mean, mm", values=values(1e3 * before, 1e3 * norms[0])),
        GoalRow(setting="with", what="mean, mm", values=values(1e3 * after, 1e3 * norms[1])),
        GoalRow(
            setting="with",
            what="reduction, %",
            values=values(reduction(before, after), cut),
            goal="norm: above 0",
            holds=bool(cut > 0),
        ),
    )
    verdict = "holds" if cut > 0 else "does not hold"
    text = (
        f"The norm of the mean error goes from {1e3 * norms[0]:.2f} to {1e3 * norms[1]:.2f} mm, {cut:.1f} % "
        f"less: the goal {verdict}."
    )
    return GoalTable(
        title="Postures: via-points that slide, a free start, no compensation",
        columns=("x", "y", "z", "norm"),
        rows=rows,
        remarks=(text, *_rising(run)),
        verdicts=(
            Verdict(
                asked="better postures: a smaller mean error",
                found=f"{1e3 * norms[0]:.2f} -> {1e3 * norms[1]:.2f} mm",
                holds=bool(cut > 0),
            ),
        ),
    )


def _rising(run: Run) -> Iterator[str]:
    figures = [motion.figures for motion in (run.equilibrium.baseline, run.equilibrium.planned)]
    means, sags = (
        np.array([1e3 * np.abs(getattr(found, part).mean[:3]) for found in figures])
        for part in ("total", "static")
    )
    for axis in axes_where(means[1] > means[0]):
        yield (
            f"Along {'xyz'[axis]} the absolute mean grows from {means[0, axis]:.2f} to {means[1, axis]:.2f} "
            f"mm. That of the postures' sag is {sags[0, axis]:.2f} and {sags[1, axis]:.2f} mm there: what is "
            "made small is the torque on the guardrail, not the sag along an axis."
        )
