"""The commands that simulate: `cmbot simulate` and `cmbot reproduce`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import cmbot
from cmbot.cli.console import (
    ConsoleProgress,
    FiguresOption,
    ForceOption,
    JsonOption,
    PlanArgument,
    QuietOption,
    err,
    flat,
    out,
    print_result,
    print_table,
)
from cmbot.cli.views import claimed_plan, plot_files, require_plots
from cmbot.common.errors import InputError

if TYPE_CHECKING:
    from chang2021 import Reproduction
    from cmbot.planning import Plan
    from cmbot.simulation import SimulationOptions, Tracking

__all__ = ["reproduce", "simulate"]

# Entries of the files that --json does not print.
_LEFT_OUT = ("format", "assumptions")

DetailsOption = Annotated[bool, typer.Option("--details", help="Print all figures, not only the answer.")]


DampingOption = Annotated[float, typer.Option("--damping", help="Share of critical damping of every mode.")]
InitialOption = Annotated[
    str, typer.Option("--initial", help="How the arm hangs at first: equilibrium, or undeformed.")
]
StiffnessOption = Annotated[
    float, typer.Option("--stiffness", help="Factor on the stiffness of guardrail, links and joints.")
]
ShareOption = Annotated[
    float | None,
    typer.Option(
        "--stiffness-share",
        help="Simulate with all stiffness less and more by this share, too: 0.3 is 30 % softer and 30 % "
        "stiffer, 0 neither. Left out: what the plan allows for (quiet_stiffness_share).",
    ),
]
SegmentsOption = Annotated[int, typer.Option("--segments", help="Elastic segments of each link.")]
RateOption = Annotated[
    float | None,
    typer.Option(
        "--rate",
        help="Positions a second that the controller is sent, such as 125; needs --servo. Left out: the "
        "whole motion is known to it.",
    ),
]
SetPointsOption = Annotated[
    str,
    typer.Option(
        "--set-points",
        help="With --rate: from one to the next the command goes along a line (interpolated) or jumps "
        "(held).",
    ),
]
ServoOption = Annotated[
    float | None,
    typer.Option(
        "--servo",
        help="How quickly joints follow: the bandwidth of their position control, Hz, such as 10. Left "
        "out: they follow exactly.",
    ),
]
DelayOption = Annotated[float, typer.Option("--delay", help="Seconds by which the joints follow late.")]


def simulate(
    directory: PlanArgument,
    damping: DampingOption = 0.01,
    initial: InitialOption = "equilibrium",
    stiffness: StiffnessOption = 1.0,
    stiffness_share: ShareOption = None,
    segments: SegmentsOption = 1,
    rate: RateOption = None,
    set_points: SetPointsOption = "interpolated",
    servo: ServoOption = None,
    delay: DelayOption = 0.0,
    force: ForceOption = False,
    figures: FiguresOption = False,
    details: DetailsOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Let guardrail and links bend under a plan's motion, and under the baseline's; add tracking errors.

    The plan's pages are written anew, with the tracking errors in them.

    Example: [bold]cmbot simulate out/triangle[/bold]
    """
    given = {
        "damping": damping,
        "initial": initial,
        "segments": segments,
        **dict.fromkeys(_FACTORS, stiffness),
        "set_point_rate_hz": rate,
        "set_points": set_points,
        "servo_bandwidth_hz": None if servo is None else [servo],
        "delay_s": delay,
    }
    if stiffness_share is not None:
        given["stiffness_share"] = stiffness_share
    options = _options(given)
    with claimed_plan(directory) as loaded:
        if stiffness_share is None:
            options = replace(options, stiffness_share=loaded.options.quiet_stiffness_share)
        from cmbot.archive import require_no_tracking

        require_no_tracking(directory, force=force)
        require_plots(figures)
        with ConsoleProgress(quiet=quiet) as progress:
            progress.stage("simulating", 0.0)
            tracking = cmbot.simulate(
                loaded, options, progress=lambda share: progress.stage("simulating", share)
            )
        if not quiet:
            err.show_sign("writing …")
        from cmbot.views import REPORT, pages

        added = pages(loaded, tracking) | plot_files(tracking, figures)
        written = cmbot.save_tracking(tracking, directory, force=force, added=added)
    if as_json:
        print_result("simulate", directory, _summary(loaded, tracking))
    elif not quiet:
        _print_summary(loaded, tracking)
        if details:
            _print_tracking(loaded, tracking)
        out.print(f"Written to {', '.join(map(flat, written))}.")
        if not details:
            page = directory / REPORT
            out.print(f"All figures: {flat(page)}, under Simulation; --details --force prints them.")


def reproduce(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")] = Path("out/reproduce"),
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Only the stiffnesses times 1, 0.7 and 1.3, and no plan of least sag."),
    ] = False,
    force: ForceOption = False,
    details: DetailsOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Plan and simulate both of the paper's experiments, and compare them with what it measured.

    Example: [bold]cmbot reproduce -o out/reproduce[/bold]
    """
    from chang2021 import FACTORS, QUICK_FACTORS, require_room, save_reproduction
    from chang2021 import as_json as numbers
    from chang2021 import reproduce as run
    from cmbot.archive import claim

    with claim(output):
        require_room(output, force=force)
        with ConsoleProgress(quiet=quiet) as progress:
            found = run(
                factors=QUICK_FACTORS if quick else FACTORS,
                least_sag=not quick,
                on_step=lambda scene, what, share: progress.stage(f"{scene}: {what}", share),
                progress=lambda scene, step: progress.update(step, f"{scene}: "),
            )
        written = save_reproduction(found, output, force=force)
    if as_json:
        entries = numbers(found)
        print_result("reproduce", output, {name: entries[name] for name in entries if name not in _LEFT_OUT})
    elif not quiet:
        _print_reproduction(found, details=details)
        out.print(f"Written to {' and '.join(map(flat, written))}, with every assumption.")
        if not details:
            out.print(f"All figures, and why: {flat(written[0])}; --details prints them.")


# What options of the command line are called in `SimulationOptions`.
_FACTORS = ("guardrail_factor", "link_factor", "joint_factor")
_CALLED = {
    **dict.fromkeys(_FACTORS, "--stiffness"),
    "stiffness_share": "--stiffness-share",
    "set_point_rate_hz": "--rate",
    "set_points": "--set-points",
    "servo_bandwidth_hz": "--servo",
    "delay_s": "--delay",
}


def _options(given: dict[str, Any]) -> SimulationOptions:
    """Check the options; errors name them as the command line does."""
    from cmbot.common.validation import validated

    try:
        return validated(cmbot.SimulationOptions, given, "cmbot simulate", InputError)
    except InputError as error:
        key = error.key.partition("[")[0]
        option, expected = _CALLED.get(key, f"--{key}"), error.expected
        for name, called in _CALLED.items():
            expected = expected.replace(name, called)
        raise InputError(error.source, option, error.got, expected, error.choices) from error


def _summary(plan: Plan, tracking: Tracking) -> dict[str, Any]:
    from cmbot.archive import tracking_json
    from cmbot.simulation import tracking_remarks

    entries = {name: entry for name, entry in tracking_json(tracking).items() if name not in _LEFT_OUT}
    return {
        "scene": plan.scene.name,
        **entries,
        "remarks": [*tracking_remarks(tracking, compensated=plan.options.compensate), *_rigid(plan)],
    }


def _rigid(plan: Plan) -> Iterator[str]:
    from cmbot.planning import rigid_arm_remark

    if said := rigid_arm_remark(plan.scene, plan.robot):
        yield said


def _print_reproduction(found: Reproduction, *, details: bool) -> None:
    from chang2021 import cells, comparison, findings, goals, reasons, verdict_rows

    headings, *rows = verdict_rows(found)
    print_table("Goals", headings, rows, text_columns=2)
    counts = []
    for experiment in found.experiments:
        agree = [finding.agrees for finding in findings(experiment)]
        counts.append(f"{sum(agree)} of {len(agree)} are found again for the {experiment.paper.scene}")
    out.print(f"Of the paper's own results {', '.join(counts)}.")
    for experiment in found.experiments if details else ():
        headings, *rows = comparison(experiment)
        print_table(experiment.paper.title, headings, rows, text_columns=2)
        for finding in findings(experiment):
            out.print(f"{'agrees' if finding.agrees else 'does not agree'}: {finding.text}")
        for reason in reasons(experiment):
            out.print(f"why: {reason}")
        for goal in goals(experiment):
            headings, *rows = cells(goal)
            title = f"{experiment.paper.scene}: {goal.title[0].lower()}{goal.title[1:]}"
            if rows:
                print_table(title, headings, rows, text_columns=2)
            else:
                out.print(title)
            for remark in goal.remarks:
                out.print(f"goal: {remark}")


def _print_summary(plan: Plan, tracking: Tracking) -> None:
    from cmbot.simulation import (
        INTERVAL_HEADINGS,
        base_movement,
        interval_rows,
        tracking_summary,
        tracking_verdict,
    )

    rows = list(tracking_summary(tracking, compensated=plan.options.compensate))
    print_table(f"{plan.scene.name}, mm", ("", "baseline", "planned"), rows, text_columns=1)
    if others := list(interval_rows(plan, tracking)):
        print_table("With another stiffness", INTERVAL_HEADINGS, others, text_columns=2)
    out.print(tracking_verdict(plan, tracking))
    if moved := base_movement(plan, tracking):
        out.print(moved)
    for said in _rigid(plan):
        out.print(said)


def _print_tracking(plan: Plan, tracking: Tracking) -> None:
    from cmbot.simulation import tracking_remarks, tracking_rows

    headings = ("", "", "x", "y", "z", "norm")
    print_table(f"{plan.scene.name}, mm", headings, list(tracking_rows(tracking)), text_columns=2)
    for remark in tracking_remarks(tracking, compensated=plan.options.compensate):
        out.print(remark)
