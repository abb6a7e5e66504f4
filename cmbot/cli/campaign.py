"""The command that plans many scenes: `cmbot campaign`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cmbot.cli.console import (
    ConsoleProgress,
    ExitStatus,
    JsonOption,
    QuietOption,
    err,
    flat,
    out,
    print_json,
)
from cmbot.common.errors import InputError

if TYPE_CHECKING:
    from cmbot.campaigns import Campaign, CampaignProgress

__all__ = ["campaign"]

# Reasons that are printed at the end.
_MOST_REASONS = 5


FileArgument = Annotated[
    Path,
    typer.Argument(metavar="FILE", help="A campaign file, a CSV table of jobs, or a folder of scenes."),
]
OutputOption = Annotated[
    Path | None, typer.Option("--output", "-o", help="Folder to write; out/NAME if left out.")
]
WorkersOption = Annotated[int, typer.Option("--workers", help="Processes on this machine.")]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Use the workers of this dask scheduler."),
]
PagesOption = Annotated[bool, typer.Option("--pages", help="Write replay and report of every plan.")]
AgainOption = Annotated[bool, typer.Option("--again", help="Plan those again that were not planned before.")]


def campaign(
    file: FileArgument,
    output: OutputOption = None,
    workers: WorkersOption = 1,
    scheduler: SchedulerOption = None,
    pages: PagesOption = False,
    again: AgainOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> ExitStatus:
    """Plan many scenes on several processes; go on where an earlier call stopped.

    Exit status 3 where a job was not planned.

    Example: [bold]cmbot campaign bridge.yaml --workers 2[/bold]
    """
    if not workers >= 1:
        raise InputError("--workers", "", workers, "a whole number from 1 on")
    import cmbot
    from cmbot.campaigns import OVERVIEW, RESULTS

    with ConsoleProgress(quiet=quiet) as console:

        def told(progress: CampaignProgress) -> None:
            # What was up to date took no time.
            done, total = progress.done - progress.resumed, progress.total - progress.resumed
            console.stage(_sentence(progress), done / max(total, 1))

        try:
            done = cmbot.campaign(
                file,
                output,
                workers=workers,
                scheduler=scheduler,
                pages=pages,
                again=again,
                progress=told,
            )
        except KeyboardInterrupt:
            if not quiet:
                err.print("stopped; the same command goes on from here")
            raise
    failed = [row for row in done.rows if row["ended"] != "planned"]
    if as_json:
        print_json(
            {
                "verb": "campaign",
                "directory": str(done.directory),
                "files": [str(done.directory / file) for file in (RESULTS, OVERVIEW)],
                "jobs": len(done.rows),
                "ends": dict(done.ends),
                "kept": dict(done.kept),
                "failed": [{name: row[name] for name in ("name", "ended", "reason")} for row in failed],
                "seconds": done.seconds,
            }
        )
    elif not quiet:
        _print(done, failed)
    return ExitStatus.NO_PLAN if failed else ExitStatus.DONE


def _sentence(progress: CampaignProgress) -> str:
    others = [f"{number} {end}" for end, number in progress.ends.items() if end != "planned"]
    before = [f"{progress.resumed} before"] if progress.resumed else []
    return ", ".join([f"planning: {progress.done} of {progress.total}", *before, *others])


def _print(done: Campaign, failed: Sequence[Mapping[str, Any]]) -> None:
    from cmbot.campaigns import OVERVIEW, RESULTS
    from cmbot.common.validation import counted

    counts = ", ".join(f"{number} {end}" for end, number in done.ends.items())
    kept, kept_failures = done.kept.total(), done.kept.total() - done.kept["planned"]
    before = f", {kept} of them before" if kept else ""
    out.print(
        f"{flat(done.name)}: {counted(len(done.rows), 'job')} in {done.seconds:.1f} s{before}: {counts}."
    )
    for row in failed[:_MOST_REASONS]:
        out.print(flat(f"{row['name']}: {row['ended']}: {row['reason']}"))
    if len(failed) > _MOST_REASONS:
        out.print(f"… and {len(failed) - _MOST_REASONS} more.")
    if kept_failures:
        out.print(f"{kept_failures} of these ended so before; --again plans them again.")
    out.print(f"Table: {flat(done.directory / RESULTS)}.")
    out.print(f"Look at it: open {flat(done.directory / OVERVIEW)} in a browser.")
