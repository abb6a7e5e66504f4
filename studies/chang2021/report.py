"""The comparison with the paper as Markdown and as JSON, and its folder with both plan directories."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from chang2021.agreement import findings, reasons
from chang2021.experiment import (
    Experiment,
    Reproduction,
    Run,
    axes,
    reduction,
    unoptimised,
    unoptimised_figures,
)
from chang2021.goals import goals
from chang2021.paper import PAPER, SOURCE, AxisErrors, assumption_tables
from chang2021.tables import Row, cells, decimals, markdown_table
from cmbot.archive import json_bytes, require_free, save, save_tracking, write_file
from cmbot.common.errors import ArchiveError
from cmbot.simulation import MotionTracking, Tracking, tracking_remarks
from cmbot.version import __version__
from cmbot.views import pages

FORMAT = "cmbot-reproduction/1"
_PAGE, _FIGURES = "reproduce.md", "reproduce.json"


def require_room(directory: str | Path, *, force: bool = False) -> None:
    """Refuse a folder in which files are in the way of `save_reproduction`.

    Parameters
    ----------
    directory : str or Path
    force : bool
        An earlier reproduction may be there.

    Raises
    ------
    ArchiveError
        When something is in the way.
    """
    folder = Path(directory)
    for paper in PAPER:
        require_free(folder / paper.scene, force=force)
    for name in (_PAGE, _FIGURES):
        if (folder / name).exists() and not force:
            expected = "a new folder; --force (in Python force=True) replaces a reproduction"
            raise ArchiveError(str(folder / name), "", "a file that is already there", expected)


def save_reproduction(
    reproduction: Reproduction, directory: str | Path, *, force: bool = False
) -> tuple[Path, Path]:
    """Write both plan directories with their tracking errors and pages, then the comparison.

    Each file and each plan directory appears whole or not at all.

    Parameters
    ----------
    reproduction : Reproduction
    directory : str or Path
        Made as needed.
    force : bool
        Replace an earlier reproduction.

    Returns
    -------
    tuple of Path
        Of ``reproduce.md`` and ``reproduce.json``.

    Raises
    ------
    ArchiveError
        When something is in the way, or the system refuses.
    """
    folder = Path(directory)
    require_room(folder, force=force)
    for experiment in reproduction.experiments:
        target, run = folder / experiment.paper.scene, experiment.planned
        save(run.plan, target, force=force)
        save_tracking(run.equilibrium, target, added=pages(run.plan, run.equilibrium))
    write_file(folder / _FIGURES, json_bytes(as_json(reproduction), indent=2))
    write_file(folder / _PAGE, markdown(reproduction).encode())
    return folder / _PAGE, folder / _FIGURES


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
    paper = experiment.paper
    compared = [(f"paper, {paper.table}", (paper.without, paper.planned))]
    for who, run in (("here", experiment.planned), ("here, fixed via-points", experiment.fixed)):
        if run is not None:
            compared.append((who, _errors(run.equilibrium)))
            compared.append((f"{who}, released undeformed", _errors(run.undeformed)))
    for who, pair in compared:
        for name in ("mean", "standard deviation"):
            without, planned = (getattr(errors, name.replace(" ", "_")) for errors in pair)
            yield who, f"{name} without, mm", *decimals(1e3 * without, 2)
            yield who, f"{name} with, mm", *decimals(1e3 * planned, 2)
            yield who, f"reduction of {name}, %", *decimals(reduction(without, planned), 1)


def markdown(reproduction: Reproduction) -> str:
    """Return the page."""
    lines = [
        "# The paper's experiments, reproduced",
        "",
        f"Written by `cmbot reproduce`, cmbot {__version__}. The paper: {SOURCE}, its rows in the order that "
        "agrees with its percentages. Nothing is tuned to agree.",
        "",
        "Error: the elastic arm's tool minus the rigid arm's at the same joint angles, in W, over the "
        "motion. Reduction: of the absolute mean, and of the standard deviation.",
        "",
        "## Goals",
        "",
        *markdown_table(verdict_rows(reproduction), text_columns=2),
    ]
    for experiment in reproduction.experiments:
        lines += _experiment_lines(experiment)
    lines += [
        "",
        "## Assumptions",
        "",
        "The paper gives neither the stiffness nor the mounting, the damping or the bridge: all are assumed.",
    ]
    heading = ""
    for table in assumption_tables():
        lines += ["", *([f"### {table.heading}", ""] if table.heading != heading else [])]
        heading = table.heading
        lines += markdown_table([table.columns, *table.rows], text_columns=len(table.columns))
    return "\n".join(lines) + "\n"


def as_json(reproduction: Reproduction) -> dict[str, Any]:
    """Return the same figures ready for JSON, in SI units; reductions in per cent."""
    return {
        "format": FORMAT,
        "cmbot": __version__,
        "options": asdict(reproduction.options),
        "experiments": [_experiment_json(experiment) for experiment in reproduction.experiments],
        "assumptions": [asdict(table) for table in assumption_tables()],
    }


def _errors(tracking: Tracking) -> tuple[AxisErrors, AxisErrors]:
    return axes(unoptimised(tracking)), axes(tracking.planned)


def _experiment_lines(experiment: Experiment) -> Iterator[str]:
    title = experiment.paper.title
    yield from ("", f"## {title[0].upper()}{title[1:]}", "")
    yield from markdown_table(comparison(experiment), text_columns=2)
    yield from ("", *markdown_table(_torques(experiment), text_columns=1))
    compared = list(findings(experiment))
    for heading, agrees in (("What agrees", True), ("What does not", False)):
        found = [finding.text for finding in compared if finding.agrees == agrees]
        yield from ("", f"### {heading}", "", *_bullets(found or ["Nothing."]))
    yield from ("", "### Why", "", *_bullets(reasons(experiment)), "", "### The goals", "")
    yield (
        "Against the baseline in the same simulation. The stiffness of guardrail and links is scaled "
        "together; the plan is the one for stiffness times 1."
    )
    for goal in goals(experiment):
        yield from ("", f"#### {goal.title}", "")
        if goal.rows:
            yield from (*markdown_table(cells(goal), text_columns=2), "")
        yield from _bullets(goal.remarks)
    yield from ("", "### The simulation", "", *_bullets(tracking_remarks(experiment.planned.equilibrium)))


def _bullets(sentences: Iterable[str]) -> Iterator[str]:
    return (f"- {sentence}" for sentence in sentences)


def _torques(experiment: Experiment) -> Iterator[Row]:
    yield "torque on the guardrail, Nm", "paper", "here", "here, fixed via-points"
    runs = [run for run in (experiment.planned, experiment.fixed) if run is not None]
    missing = [""] * (2 - len(runs))
    differences = decimals([run.torque_difference for run in runs], 2)
    theirs = f"{experiment.paper.torque_difference:g}"
    yield "largest difference, without less with", theirs, *differences, *missing
    for name in ("peak", "mean"):
        figures = {
            "without": [unoptimised_figures(run.plan) for run in runs],
            "with": [run.plan.figures for run in runs],
        }
        for which, each in figures.items():
            values = [getattr(of_run, f"{name}_guardrail_torque") for of_run in each]
            yield f"{name}, {which}", "", *decimals(values, 2), *missing


def _experiment_json(experiment: Experiment) -> dict[str, Any]:
    paper, fixed = experiment.paper, experiment.fixed
    return {
        "scene": paper.scene,
        "paper": {
            "table": paper.table,
            "without": _vectors(paper.without),
            "with": _vectors(paper.planned),
            "printed_reductions": paper.reductions.tolist(),
            "torque_difference": paper.torque_difference,
        },
        "sliding": _run_json(experiment.planned),
        "fixed": None if fixed is None else _run_json(fixed),
        "why_not_fixed": experiment.why_not,
        "findings": [asdict(finding) for finding in findings(experiment)],
        "reasons": list(reasons(experiment)),
        "goals": [asdict(goal) for goal in goals(experiment)],
    }


def _run_json(run: Run) -> dict[str, Any]:
    return {
        "torque_difference": run.torque_difference,
        "equilibrium": _tracking_json(run.equilibrium),
        "undeformed": _tracking_json(run.undeformed),
    }


def _tracking_json(tracking: Tracking) -> dict[str, Any]:
    without, planned = map(vars, _errors(tracking))
    return {
        "without": _motion_json(unoptimised(tracking)),
        "with": _motion_json(tracking.planned),
        "reductions": {name: reduction(without[name], planned[name]).tolist() for name in without},
    }


def _motion_json(motion: MotionTracking) -> dict[str, Any]:
    figures = motion.metrics
    return {
        **_vectors(axes(motion)),
        "rms_static": figures.static.rms.tolist(),
        "rms_dynamic": figures.dynamic.rms.tolist(),
        "residual_diameter": None if figures.residual is None else figures.residual.diameter,
    }


def _vectors(errors: AxisErrors) -> dict[str, list[float]]:
    return {name: values.tolist() for name, values in vars(errors).items()}
