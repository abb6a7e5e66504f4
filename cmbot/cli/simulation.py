"""The verbs of the command line that simulate; `cmbot.cli` lists them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import cmbot
from cmbot.cli.console import ConsoleProgress, JsonOption, QuietOption, flat, out, print_json, print_table
from cmbot.cli.views import add_figures, add_pages

if TYPE_CHECKING:
    from cmbot.planning import Plan
    from cmbot.reproduction import Experiment, Reproduction
    from cmbot.simulation import SimulationOptions, Tracking

__all__ = ["reproduce", "simulate"]

_HEADINGS = ("", "", "x", "y", "z", "norm")
_REPORT = "report.html"

DetailsOption = Annotated[bool, typer.Option("--details", help="Print all figures, not only the answer.")]


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
    figures: Annotated[
        bool, typer.Option("--figures", help="Draw plots as PNG and SVG into the plan directory, too.")
    ] = False,
    details: DetailsOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Let guardrail and links bend under a plan's motion, and under the baseline's; add tracking errors.

    The plan's pages are written anew, with the tracking errors in them.

    Example: [bold]cmbot simulate out/triangle[/bold]
    """
    options = _options(damping=damping, initial=initial, stiffness=stiffness, segments=segments)
    loaded = cmbot.load_plan(directory)
    from cmbot.archive import require_no_tracking

    require_no_tracking(directory, force=force)
    if figures:
        from cmbot.views import require_matplotlib

        require_matplotlib()
    with ConsoleProgress(quiet=quiet) as console_progress:
        console_progress.say("simulating", 0.0)
        tracking = cmbot.simulate(
            loaded, options, progress=lambda share: console_progress.say("simulating", share)
        )
    written = cmbot.save_tracking(tracking, directory, force=force)
    written += add_pages(loaded, tracking, directory)
    if figures:
        written += add_figures(tracking, directory)
    if as_json:
        print_json(_tracking_summary(loaded.scene.name, directory, tracking))
    elif not quiet:
        _print_answer(loaded, tracking)
        if details:
            _print_tracking(loaded.scene.name, tracking)
        out.print(f"Written to {', '.join(flat(path) for path in written)}.")
        if not details:
            page = flat(directory / _REPORT)
            out.print(f"All figures: {page}, under Simulation; --details --force prints them.")


def reproduce(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder to write; out/reproduce if left out.")
    ] = Path("out/reproduce"),
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Only the stiffnesses times 1, 0.7 and 1.3, and no plan of least sag."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a reproduction that is there.")] = False,
    details: DetailsOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Plan and simulate both of the paper's experiments, and compare them with what it measured.

    Example: [bold]cmbot reproduce -o out/reproduce[/bold]
    """
    from cmbot.reproduction import FACTORS, QUICK_FACTORS, require_room, save_reproduction
    from cmbot.reproduction import reproduce as run

    require_room(output, force=force)
    with ConsoleProgress(quiet=quiet) as console_progress:
        found = run(
            factors=QUICK_FACTORS if quick else FACTORS,
            least_sag=not quick,
            on_step=lambda scene, what, share: console_progress.say(f"{scene}: {what}", share),
            progress=lambda scene, step: console_progress.tell(step, about=f"{scene}: "),
        )
    written = save_reproduction(found, output, force=force)
    if as_json:
        print_json(_reproduction_summary(output, found))
        return
    if quiet:
        return
    _print_verdicts(found)
    for experiment in found.experiments if details else ():
        _print_comparison(experiment)
        _print_goals(experiment)
    out.print(f"Written to {' and '.join(flat(path) for path in written)}, with every assumption.")
    if not details:
        out.print(f"All figures, and why: {flat(written[0])}; --details prints them.")


def _options(*, damping: float, initial: str, stiffness: float, segments: int) -> SimulationOptions:
    """Check the words of the command line; what is wrong is named as it is there."""
    from cmbot.common.validation import validated

    given = {"damping": damping, "initial": initial, "segments": segments}
    factors = dict.fromkeys(("guardrail_factor", "link_factor"), stiffness)
    try:
        return validated(cmbot.SimulationOptions, given | factors, "cmbot simulate", cmbot.InputError)
    except cmbot.InputError as error:
        word = (
            "--stiffness" if error.key in factors else f"--{error.key}" if error.key in given else error.key
        )
        raise cmbot.InputError(error.source, word, error.got, error.expected, error.choices) from error


def _tracking_summary(name: str, directory: Path, tracking: Tracking) -> dict[str, Any]:
    from cmbot.archive import tracking_json
    from cmbot.simulation import tracking_remarks

    figures = tracking_json(tracking)
    return {
        "verb": "simulate",
        "scene": name,
        "directory": str(directory),
        "files": sorted(path.name for path in directory.iterdir()),
        **{key: value for key, value in figures.items() if key != "format"},
        "remarks": list(tracking_remarks(tracking)),
    }


def _reproduction_summary(folder: Path, found: Reproduction) -> dict[str, Any]:
    from cmbot.reproduction import as_json

    figures = as_json(found)
    return {
        "verb": "reproduce",
        "directory": str(folder),
        "files": sorted(path.name for path in folder.iterdir()),
        **{key: value for key, value in figures.items() if key not in ("format", "assumptions")},
    }


def _print_verdicts(found: Reproduction) -> None:
    from cmbot.reproduction import findings, verdict_rows

    headings, *rows = verdict_rows(found)
    print_table("Goals", headings, rows, text_columns=2)
    told = []
    for experiment in found.experiments:
        compared = list(findings(experiment))
        agrees = sum(finding.agrees for finding in compared)
        told.append(f"{agrees} of {len(compared)} are found again for the {experiment.paper.scene}")
    out.print(f"Of the paper's own results {', '.join(told)}.")


def _print_comparison(experiment: Experiment) -> None:
    from cmbot.reproduction import comparison, findings, reasons

    headings, *rows = comparison(experiment)
    print_table(experiment.paper.title, headings, rows, text_columns=2)
    for finding in findings(experiment):
        out.print(f"{'agrees' if finding.agrees else 'does not agree'}: {finding.text}")
    for reason in reasons(experiment):
        out.print(f"why: {reason}")


def _print_goals(experiment: Experiment) -> None:
    from cmbot.reproduction import cells, goals

    for goal in goals(experiment):
        headings, *rows = cells(goal)
        title = f"{experiment.paper.scene}: {goal.title[0].lower()}{goal.title[1:]}"
        if rows:
            print_table(title, headings, rows, text_columns=2)
        else:
            out.print(title)
        for remark in goal.remarks:
            out.print(f"goal: {remark}")


def _print_answer(planned: Plan, tracking: Tracking) -> None:
    from cmbot.simulation import tracking_summary, tracking_verdict

    rows = list(tracking_summary(tracking, compensated=planned.options.compensate))
    print_table(f"{planned.scene.name}, mm", ("", "baseline", "planned"), rows, text_columns=1)
    out.print(tracking_verdict(planned, tracking))


def _print_tracking(name: str, tracking: Tracking) -> None:
    from cmbot.simulation import tracking_remarks, tracking_rows

    print_table(f"{name}, mm", _HEADINGS, list(tracking_rows(tracking)), text_columns=2)
    for remark in tracking_remarks(tracking):
        out.print(remark)
