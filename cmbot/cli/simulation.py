"""The commands that simulate: `cmbot simulate`, `cmbot excite` and `cmbot reproduce`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cmbot
from cmbot.cli.command import Writing, argument, option
from cmbot.cli.console import ConsoleProgress, err, out, print_lines, print_table
from cmbot.cli.views import claimed_plan, plot_files, require_plots
from cmbot.common.errors import one_line

if TYPE_CHECKING:
    from chang2021 import Reproduction

# Entries of the files that --json does not print.
_NOT_IN_JSON = ("format", "assumptions")


@dataclass(frozen=True, kw_only=True)
class SimulateCommand(Writing):
    """Let guardrail and links bend under a plan's motion, and the baseline's if any; add tracking errors.

    The plan's pages are written anew, with the tracking errors in them.

    Example: cmbot simulate out/triangle
    """

    directory: Path = argument("A plan directory.", "DIR")
    damping: float | None = option(
        None, "Share of critical damping of every mode; as identified, or 0.01, if left out."
    )
    initial: str = option("equilibrium", "How the arm hangs at first: equilibrium, or undeformed.")
    stiffness: float = option(1.0, "Factor on the stiffness of guardrail, links and joints.")
    stiffness_share: float | None = option(
        None,
        "Simulate with all stiffness less and more by this share, too: 0.3 is 30 % softer and 30 % stiffer, "
        "0 neither. Left out: what the plan allows for (quiet_stiffness_share).",
    )
    segments: int = option(1, "Elastic segments of each link.")
    set_point_rate_hz: float | None = option(
        None,
        "Positions a second that the controller is sent, such as 125; needs --servo. Left out: the whole "
        "motion is known to it.",
        "--rate",
        metavar="RATE",
    )
    set_points: str = option(
        "interpolated",
        "With --rate: from one to the next the command goes along a line (interpolated) or jumps (held).",
    )
    servo: float | None = option(
        None,
        "How quickly joints follow: the bandwidth of their position control, Hz, such as 10. Left out: they "
        "follow exactly.",
    )
    delay_s: float = option(0.0, "Seconds by which the joints follow late.", "--delay", metavar="DELAY")
    figures: bool = option(False, "Draw plots as PNG, SVG and PDF into the plan directory, too.")
    details: bool = option(False, "Print all figures, not only the answer.")

    def __call__(self) -> None:
        servo = None if self.servo is None else [self.servo]
        given: dict[str, Any] = {"servo_bandwidth_hz": servo, **dict.fromkeys(_FACTORS, self.stiffness)}
        called = {"servo_bandwidth_hz": "--servo", **dict.fromkeys(_FACTORS, "--stiffness")}
        options = self.made(cmbot.SimulationOptions, called=called, **given)
        directory = self.directory
        with claimed_plan(directory) as loaded:
            if self.stiffness_share is None:
                options = replace(options, stiffness_share=loaded.options.quiet_stiffness_share)
            cmbot.archive.require_absent(directory, cmbot.archive.TRACKING_FILES, force=self.force)
            require_plots(self.figures)
            with ConsoleProgress(quiet=self.quiet) as progress:
                progress.stage("simulating", 0.0)
                tracking = cmbot.simulate(
                    loaded, options, progress=lambda share: progress.stage("simulating", share)
                )
            if not self.quiet:
                err.show_sign("writing …")
            added = cmbot.views.pages(loaded, tracking, cmbot.load_excitation(directory))
            added |= plot_files(tracking, self.figures)
            written = cmbot.save_tracking(tracking, directory, force=self.force, added=added)

        def say() -> None:
            _print_summary(loaded, tracking)
            if self.details:
                _print_tracking(loaded, tracking)
            out.print(f"Written to {', '.join(map(one_line, written))}.")
            if not self.details:
                page = one_line(directory / cmbot.views.REPORT)
                out.print(f"All figures: {page}, under Simulation; --details --force prints them.")

        self.answer(lambda: _summary(loaded, tracking), say, directory)


@dataclass(frozen=True, kw_only=True)
class ReproduceCommand(Writing):
    """Plan and simulate both of the paper's experiments, and compare them with what it measured.

    Example: cmbot reproduce -o out/reproduce
    """

    output: Path = option(Path("out/reproduce"), "Folder to write.", "--output", "-o")
    quick: bool = option(False, "Only the stiffnesses times 1, 0.7 and 1.3, and no plan of least sag.")
    details: bool = option(False, "Print all figures, not only the answer.")

    def __call__(self) -> None:
        import chang2021

        written: list[Path] = []

        def work(progress: ConsoleProgress) -> Reproduction:
            return chang2021.reproduce(
                factors=chang2021.QUICK_FACTORS if self.quick else chang2021.FACTORS,
                least_sag=not self.quick,
                on_step=lambda scene, what, share: progress.stage(f"{scene}: {what}", share),
                progress=lambda scene, step: progress.update(step, f"{scene}: "),
            )

        def say() -> None:
            _print_reproduction(found, details=self.details)
            out.print(f"Written to {' and '.join(map(one_line, written))}, with every assumption.")
            if not self.details:
                out.print(f"All figures, and why: {one_line(written[0])}; --details prints them.")

        found = self.work_in(
            self.output,
            lambda: chang2021.require_room(self.output, force=self.force),
            work,
            lambda found: written.extend(chang2021.save_reproduction(found, self.output, force=self.force)),
        )
        self.answer(lambda: _without(chang2021.as_json(found), _NOT_IN_JSON), say, self.output)


# Options of the simulation that one of the command line sets.
_FACTORS = ("guardrail_factor", "link_factor", "joint_factor")


def _without(entries: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    return {name: entry for name, entry in entries.items() if name not in names}


def _summary(plan: cmbot.Plan, tracking: cmbot.Tracking) -> dict[str, Any]:
    entries = _without(cmbot.archive.tracking_json(tracking), _NOT_IN_JSON)
    return {"scene": plan.scene.name, **entries, "remarks": [*_remarks(plan, tracking), *_left_out(plan)]}


def _remarks(plan: cmbot.Plan, tracking: cmbot.Tracking) -> Iterator[str]:
    yield from cmbot.simulation.tracking_remarks(tracking, compensated=plan.compensation is not None)


def _left_out(plan: cmbot.Plan) -> Iterator[str]:
    if said := cmbot.planning.rigid_parts_remark(plan.scene, plan.robot):
        yield said
    if plan.scene.excitation is not None or plan.scene.damper is not None:
        yield "Trains, wind and a damper are left out here; cmbot excite shakes the arm by them."


def _print_reproduction(found: Reproduction, *, details: bool) -> None:
    import chang2021

    headings, *rows = chang2021.verdict_rows(found)
    print_table("Goals", headings, rows, text_columns=2)
    counts = []
    for experiment in found.experiments:
        agree = [finding.agrees for finding in chang2021.findings(experiment)]
        counts.append(f"{sum(agree)} of {len(agree)} are found again for the {experiment.paper.scene}")
    out.print(f"Of the paper's own results {', '.join(counts)}.")
    for experiment in found.experiments if details else ():
        headings, *rows = chang2021.comparison(experiment)
        print_table(experiment.paper.title, headings, rows, text_columns=2)
        agrees = ("does not agree", "agrees")
        print_lines(f"{agrees[finding.agrees]}: {finding.text}" for finding in chang2021.findings(experiment))
        print_lines(f"why: {reason}" for reason in chang2021.reasons(experiment))
        for goal in chang2021.goals(experiment):
            headings, *rows = chang2021.cells(goal)
            title = f"{experiment.paper.scene}: {goal.title[0].lower()}{goal.title[1:]}"
            if not rows:
                out.print(title)
            print_table(title, headings, rows, text_columns=2)
            print_lines(f"goal: {remark}" for remark in goal.remarks)


def _print_summary(plan: cmbot.Plan, tracking: cmbot.Tracking) -> None:
    told = cmbot.simulation
    rows = told.tracking_summary(tracking, compensated=plan.compensation is not None)
    print_table(f"{plan.scene.name}, simulated, mm", tracking.headings, rows)
    others = told.interval_rows(tracking)
    print_table("With another stiffness", told.interval_headings(tracking), others, text_columns=2)
    out.print(told.tracking_verdict(plan, tracking))
    if moved := told.base_movement(plan, tracking):
        out.print(moved)
    print_lines(_left_out(plan))


def _print_tracking(plan: cmbot.Plan, tracking: cmbot.Tracking) -> None:
    headings, rows = ("", "", "x", "y", "z", "norm"), cmbot.simulation.tracking_rows(tracking)
    print_table(f"{plan.scene.name}, mm", headings, rows, text_columns=2)
    print_lines(_remarks(plan, tracking))


@dataclass(frozen=True, kw_only=True)
class ExciteCommand(Writing):
    """Shake a plan's arm by trains, records or wind, as its scene says; add how its tool sways, and a page.

    The plan's report is written anew, with these figures in it.

    Example: cmbot excite out/triangle
    """

    directory: Path = argument("A plan directory.", "DIR")

    def __call__(self) -> None:
        directory = self.directory
        with claimed_plan(directory) as plan:
            cmbot.archive.require_absent(directory, [cmbot.archive.EXCITATION_FILE], force=self.force)
            if not self.quiet:
                err.show_sign("shaking …")
            excitation, views = cmbot.excite(plan), cmbot.views
            report = views.report_page(plan, cmbot.load_tracking(plan, directory), excitation)
            added = {views.EXCITATION: views.excitation_page(plan, excitation), views.REPORT: report}
            written = cmbot.save_excitation(excitation, directory, force=self.force, added=added)

        def say() -> None:
            told = cmbot.excitation
            print_table(plan.scene.name, ("", ""), told.excitation_rows(excitation))
            print_table("Trains", told.PASSAGE_HEADINGS, told.passage_rows(excitation), text_columns=0)
            print_lines(told.excitation_sentences(excitation))
            out.print(f"Written to {', '.join(map(one_line, written))}.")

        self.answer(lambda: cmbot.archive.excitation_json(excitation), say, directory)
