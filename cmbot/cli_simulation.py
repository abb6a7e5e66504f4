"""The verbs of the command line that simulate; `cmbot.cli` lists them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

import cmbot
from cmbot.console import Narrator, flat, out

if TYPE_CHECKING:
    from cmbot.reproduction import Experiment
    from cmbot.simulation import Tracking

__all__ = ["reproduce", "simulate"]

_HEADINGS = ("", "", "x", "y", "z", "norm")


def simulate(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="A plan directory.")],
    damping: Annotated[
        float, typer.Option("--damping", help="Share of critical damping of every mode.")
    ] = 0.01,
    initial: Annotated[
        str, typer.Option("--initial", help="How the arm hangs at first: equilibrium, or undeformed.")
    ] = "equilibrium",
    stiffness: Annotated[
        float, typer.Option("--stiffness", help="Factor on the stiffness of guardrail and links.")
    ] = 1.0,
    segments: Annotated[int, typer.Option("--segments", help="Elastic segments of each link.")] = 1,
    force: Annotated[bool, typer.Option("--force", help="Replace tracking errors that are there.")] = False,
) -> None:
    """Let guardrail and links bend under a plan's motion, and under the baseline's; add tracking errors.

    Example: [bold]cmbot simulate out/triangle[/bold]
    """
    loaded = cmbot.load_plan(directory)
    from cmbot.archive import require_no_tracking
    from cmbot.validation import validated

    require_no_tracking(directory, force=force)
    options = validated(
        cmbot.SimulationOptions,
        {
            "damping": damping,
            "initial": initial,
            "guardrail_factor": stiffness,
            "link_factor": stiffness,
            "segments": segments,
        },
        "cmbot simulate",
        cmbot.InputError,
    )
    with Narrator() as narrator:
        narrator.say("simulating")
        tracking = cmbot.simulate(loaded, options)
    written = cmbot.save_tracking(tracking, directory, force=force)
    print_tracking(loaded.scene.name, tracking)
    out.print(f"Written to {', '.join(flat(path) for path in written)}.")


def reproduce(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder to write; out/reproduce if left out.")
    ] = Path("out/reproduce"),
    force: Annotated[bool, typer.Option("--force", help="Replace a reproduction that is there.")] = False,
) -> None:
    """Plan and simulate both of the paper's experiments, and compare them with what it measured.

    Example: [bold]cmbot reproduce -o out/reproduce[/bold]
    """
    from cmbot.reproduction import findings, reasons, require_room, save_reproduction
    from cmbot.reproduction import reproduce as run

    require_room(output, force=force)
    with Narrator() as narrator:
        found = run(
            tell=lambda scene, what: narrator.say(f"{scene}: {what}"),
            progress=lambda scene, step: narrator.tell(step, about=f"{scene}: "),
        )
    written = save_reproduction(found, output, force=force)
    for experiment in found.experiments:
        _print_comparison(experiment)
        for finding in findings(experiment):
            out.print(f"{'agrees' if finding.agrees else 'does not agree'}: {finding.text}")
        for reason in reasons(experiment):
            out.print(f"why: {reason}")
    out.print(f"Written to {' and '.join(flat(path) for path in written)}, with every assumption.")


def _print_comparison(experiment: Experiment) -> None:
    from cmbot.reproduction import comparison

    headings, *rows = comparison(experiment)
    _print_table(experiment.paper.title, headings, rows)


def print_tracking(name: str, tracking: Tracking) -> None:
    """Print the figures of a simulation: a table on a terminal, aligned columns elsewhere."""
    from cmbot.simulation import tracking_remarks, tracking_rows

    _print_table(f"{name}, mm", _HEADINGS, list(tracking_rows(tracking)))
    for remark in tracking_remarks(tracking):
        out.print(remark)


def _print_table(title: str, headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print numbers behind two columns of text."""
    if out.is_terminal:
        table = Table(title=title, title_justify="left")
        for number, heading in enumerate(headings):
            table.add_column(heading, justify="left" if number < 2 else "right")
        for row in rows:
            table.add_row(*row)
        out.print(table)
    else:
        out.print(title)
        for line in _aligned([headings, *rows]):
            out.print(line)


def _aligned(rows: list[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for cells in rows:
        padded = (
            f"{cell:<{width}}" if number < 2 else f"{cell:>{width}}"
            for number, (cell, width) in enumerate(zip(cells, widths, strict=True))
        )
        yield "  ".join(padded).rstrip()
