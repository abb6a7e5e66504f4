"""The comparison with the paper as Markdown and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.reproduction.agreement import findings, reasons
from cmbot.reproduction.assumptions import assumption_tables
from cmbot.reproduction.experiment import Experiment, Reproduction, Run, axes, reduction
from cmbot.reproduction.goal_table import cells
from cmbot.reproduction.goals import goals
from cmbot.reproduction.paper import SOURCE, PaperError
from cmbot.simulation import MotionTracking, Tracking, tracking_remarks
from cmbot.version import __version__

__all__ = ["FORMAT", "as_json", "comparison", "markdown", "verdict_rows"]

FORMAT = "cmbot-reproduction/1"

Row = tuple[str, ...]
Pair = tuple[FloatArray, FloatArray]


def verdict_rows(reproduction: Reproduction) -> Iterator[Row]:
    """Yield all goals in short: scene, what is asked, what was found, whether it is met."""
    yield "", "goal, against the baseline", "found", "met"
    for experiment in reproduction.experiments:
        for goal in goals(experiment):
            for verdict in goal.verdicts:
                met = "yes" if verdict.holds else "no"
                yield experiment.paper.scene, verdict.asked, verdict.found, met


def comparison(experiment: Experiment) -> Iterator[Row]:
    """Yield the comparison of one experiment: who, what, x, y, z; first the headings; mm and per cent."""
    yield "", "", "x", "y", "z"
    paper, run, fixed = experiment.paper, experiment.planned, experiment.fixed
    yield from _block(
        f"paper, {paper.table}", *(_of_paper(error) for error in (paper.without, paper.planned))
    )
    yield from _block("here", *_of_run(run.equilibrium))
    yield from _block("here, let go undeformed", *_of_run(run.undeformed))
    if fixed is not None:
        yield from _block("here, via-points fixed", *_of_run(fixed.equilibrium))
        yield from _block("here, via-points fixed, let go undeformed", *_of_run(fixed.undeformed))


def markdown(reproduction: Reproduction) -> str:
    """Return the page."""
    lines = [
        "# The paper's experiments, reproduced",
        "",
        f"Written by `cmbot reproduce`, cmbot {__version__}. The paper: {SOURCE}, its rows in the order that "
        "its percentages prove. Nothing is tuned to agree.",
        "",
        "Error: the bent tool from where the same joint angles put the rigid one, in W, over the motion. "
        "Reduction: of the absolute mean, and of the standard deviation.",
        "",
        "## Goals",
        "",
        *_table(verdict_rows(reproduction), text_columns=2),
    ]
    for experiment in reproduction.experiments:
        lines += ["", f"## {experiment.paper.title[0].upper()}{experiment.paper.title[1:]}", ""]
        lines += _table(comparison(experiment), text_columns=2)
        lines += ["", *_table(_torques(experiment), text_columns=1)]
        compared = list(findings(experiment))
        for heading, agrees in (("What agrees", True), ("What does not", False)):
            told = [f"- {finding.text}" for finding in compared if finding.agrees == agrees]
            lines += ["", f"### {heading}", "", *(told or ["- Nothing."])]
        lines += ["", "### Why", "", *(f"- {reason}" for reason in reasons(experiment))]
        lines += ["", "### The goals", ""]
        lines += [
            "Against the baseline in the same simulation; guardrail and links are made softer or stiffer "
            "together, the plan stays the one made with stiffness 1.",
        ]
        for goal in goals(experiment):
            lines += ["", f"#### {goal.title}", ""]
            if goal.rows:
                lines += [*_table(cells(goal), text_columns=2), ""]
            lines += [f"- {remark}" for remark in goal.remarks]
        lines += ["", "### The simulation", ""]
        lines += [f"- {remark}" for remark in tracking_remarks(experiment.planned.equilibrium)]
    lines += ["", "## Assumptions", ""]
    lines += [
        "The paper gives neither the stiffness nor the mounting, the damping or the bridge; every number "
        "that stands in for them is one of these.",
    ]
    heading = ""
    for table in assumption_tables():
        lines += ["", *([f"### {table.heading}", ""] if table.heading != heading else [])]
        heading = table.heading
        lines += _table(iter([table.columns, *table.rows]), text_columns=len(table.columns))
    return "\n".join(lines) + "\n"


def as_json(reproduction: Reproduction) -> dict[str, Any]:
    """Return the same figures as JSON can hold them, in SI units; reductions in per cent."""
    return {
        "format": FORMAT,
        "cmbot": __version__,
        "options": asdict(reproduction.options),
        "experiments": [_experiment(experiment) for experiment in reproduction.experiments],
        "assumptions": [asdict(table) for table in assumption_tables()],
    }


def _block(who: str, without: Pair, planned: Pair) -> Iterator[Row]:
    for name, before, after in zip(("mean", "standard deviation"), without, planned, strict=True):
        yield who, f"{name} without, mm", *_cells(1e3 * before, 2)
        yield who, f"{name} with, mm", *_cells(1e3 * after, 2)
        yield who, f"reduction of {name}, %", *_cells(reduction(before, after), 1)


def _of_paper(error: PaperError) -> Pair:
    return error.mean, error.standard_deviation


def _of_run(tracking: Tracking) -> tuple[Pair, Pair]:
    return axes(tracking.baseline), axes(tracking.planned)


def _torques(experiment: Experiment) -> Iterator[Row]:
    yield "torque on the guardrail, Nm", "paper", "here", "here, via-points fixed"
    runs = [run for run in (experiment.planned, experiment.fixed) if run is not None]
    missing = [""] * (2 - len(runs))
    differences = [f"{run.torque_difference:.2f}" for run in runs]
    yield (
        "largest difference, without less with",
        f"{experiment.paper.torque_difference:g}",
        *differences,
        *missing,
    )
    for name, attribute in (("peak", "peak_guardrail_torque"), ("mean", "mean_guardrail_torque")):
        for which in ("baseline_figures", "figures"):
            values = [f"{getattr(getattr(run.plan, which), attribute):.2f}" for run in runs]
            yield f"{name}, {'without' if which == 'baseline_figures' else 'with'}", "", *values, *missing


def _experiment(experiment: Experiment) -> dict[str, Any]:
    paper, fixed = experiment.paper, experiment.fixed
    return {
        "scene": paper.scene,
        "paper": {
            "table": paper.table,
            "without": _vectors(_of_paper(paper.without)),
            "with": _vectors(_of_paper(paper.planned)),
            "printed_reductions": paper.reductions.tolist(),
            "torque_difference": paper.torque_difference,
        },
        "sliding": _run(experiment.planned),
        "fixed": None if fixed is None else _run(fixed),
        "why_not_fixed": experiment.why_not,
        "findings": [asdict(finding) for finding in findings(experiment)],
        "reasons": list(reasons(experiment)),
        "goals": [asdict(goal) for goal in goals(experiment)],
    }


def _run(run: Run) -> dict[str, Any]:
    simulated = {"equilibrium": run.equilibrium, "undeformed": run.undeformed}
    return {
        "torque_difference": run.torque_difference,
        **{
            name: {
                "without": _motion(tracking.baseline),
                "with": _motion(tracking.planned),
                "reductions": dict(
                    zip(
                        ("mean", "standard_deviation"),
                        (reduction(*pair).tolist() for pair in zip(*_of_run(tracking), strict=True)),
                        strict=True,
                    )
                ),
            }
            for name, tracking in simulated.items()
        },
    }


def _motion(motion: MotionTracking) -> dict[str, Any]:
    figures = motion.figures
    return {
        **_vectors(axes(motion)),
        "rms_static": figures.static.rms.tolist(),
        "rms_dynamic": figures.dynamic.rms.tolist(),
        "residual_diameter": None if figures.residual is None else figures.residual.diameter,
    }


def _vectors(pair: Pair) -> dict[str, list[float]]:
    return {"mean": pair[0].tolist(), "standard_deviation": pair[1].tolist()}


def _table(rows: Iterator[Row], *, text_columns: int) -> Iterator[str]:
    """Yield a Markdown table; columns after the first few are numbers."""
    head = next(rows)
    yield f"| {' | '.join(head)} |"
    yield f"|{'|'.join('---' if number < text_columns else '--:' for number in range(len(head)))}|"
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _cells(values: FloatArray, digits: int) -> Row:
    return tuple(f"{round(float(value), digits) + 0.0:.{digits}f}" for value in np.asarray(values))
