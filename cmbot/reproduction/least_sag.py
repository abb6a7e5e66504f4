"""The sag as what is made small, beside the torque."""

from __future__ import annotations

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan
from cmbot.planning.tool_sag import ToolSag
from cmbot.reproduction.experiment import Variant
from cmbot.reproduction.goal_table import GoalRow, GoalTable, values
from cmbot.simulation.metrics import statistics

__all__ = ["least_sag"]

_COLUMNS = ("without", "objective: torque", "objective: sag", "sag against torque, %")


def least_sag(torque: Plan, variant: Variant) -> GoalTable:
    """Compare a plan of least torque with one of least sag."""
    title = "Another objective: the sag made small in place of the torque"
    if variant.plan is None:
        remark = f"There is no plan: {variant.why_not}."
        return GoalTable(title=title, columns=_COLUMNS, rows=(), remarks=(remark,))
    plans = torque, variant.plan
    sag = ToolSag(Sag(elastic_arm(torque.robot, elastic_base(torque.scene.guardrail))))
    motions = [(plans[0].baseline.t, plans[0].baseline.q), *((x.samples.t, x.samples.q) for x in plans)]
    sags = [sag.along(t, q) for t, q in motions]
    lengths = [np.linalg.norm(found, axis=1) for found in sags]
    figures = [plans[0].baseline_figures, *(x.figures for x in plans)]
    means = [statistics(t, found).mean[3] for (t, _), found in zip(motions, sags, strict=True)]
    peaks = [float(length.max()) for length in lengths]
    torques = [found.peak_guardrail_torque for found in figures]
    rows = (
        _row("peak of the sag, mm", 1e3 * np.array(peaks)),
        _row("mean of the sag, mm", 1e3 * np.array(means)),
        _row("peak of the torque on the guardrail, Nm", np.array(torques)),
        _row("mean of the torque on the guardrail, Nm", np.array([x.mean_guardrail_torque for x in figures])),
    )
    told = (
        f"The sag's peak is {_change(peaks[1], peaks[2])}, the torque's {_change(torques[1], torques[2])} "
        "than with the torque made small."
    )
    return GoalTable(title=title, columns=_COLUMNS, rows=rows, remarks=(told,))


def _row(what: str, three: FloatArray) -> GoalRow:
    return GoalRow(setting="", what=what, values=values(three, 100 * (three[2] / three[1] - 1)))


def _change(before: float, after: float) -> str:
    change = 100 * (after / before - 1)
    return f"{abs(change):.2f} % {'higher' if change > 0 else 'lower'}"
