"""The sag as what is made small, beside the torque."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.reproduction.experiment import Run, Variant
from cmbot.reproduction.goal_table import GoalRow, GoalTable, values

__all__ = ["least_sag"]

_COLUMNS = ("without", "objective: torque", "objective: sag", "sag against torque, %")


def least_sag(torque: Run, variant: Variant) -> GoalTable:
    """Compare a plan of least torque with one of least sag, both of them and the baseline simulated."""
    title = "Another objective: the sag made small in place of the torque"
    if variant.plan is None:
        remark = f"There is no plan: {variant.why_not}."
        return GoalTable(title=title, columns=_COLUMNS, rows=(), remarks=(remark,))
    motions = torque.equilibrium.baseline, torque.equilibrium.planned, variant.trackings[0].planned
    figures = torque.plan.baseline_figures, torque.plan.figures, variant.plan.figures
    # After the stop the sag stays what it is.
    peaks = np.array([np.linalg.norm(motion.static, axis=1).max() for motion in motions])
    means = np.array([motion.figures.static.mean[3] for motion in motions])
    peak_torques = np.array([found.peak_guardrail_torque for found in figures])
    mean_torques = np.array([found.mean_guardrail_torque for found in figures])
    rows = (
        _row("sag of the tool", "peak, mm", 1e3 * peaks),
        _row("sag of the tool", "mean, mm", 1e3 * means),
        _row("torque on the guardrail", "peak, Nm", peak_torques),
        _row("torque on the guardrail", "mean, Nm", mean_torques),
    )
    told = (
        f"The sag's peak is {_change(peaks)}, the torque's {_change(peak_torques)} than with the torque made "
        "small."
    )
    return GoalTable(title=title, columns=_COLUMNS, rows=rows, remarks=(told,))


def _row(setting: str, what: str, three: FloatArray) -> GoalRow:
    return GoalRow(setting=setting, what=what, values=values(three, 100 * (three[2] / three[1] - 1)))


def _change(three: FloatArray) -> str:
    change = 100 * (three[2] / three[1] - 1)
    return f"{abs(change):.2f} % {'higher' if change > 0 else 'lower'}"
