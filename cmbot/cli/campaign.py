"""The command that plans many scenes: `cmbot campaign`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cmbot
from cmbot.cli.command import Reporting, argument, option
from cmbot.cli.console import ConsoleProgress, ExitStatus, err, out
from cmbot.common.errors import one_line

if TYPE_CHECKING:
    from cmbot.campaigns import Campaign, CampaignProgress

# Reasons that are printed at the end.
_MOST_REASONS = 5


@dataclass(frozen=True, kw_only=True)
class CampaignCommand(Reporting):
    """Plan many scenes on several processes; go on where an earlier call stopped.

    Exit status 3 where a job was not planned.

    Example: cmbot campaign bridge.yaml --workers 2
    """

    file: Path = argument("A campaign file, a CSV table of jobs, or a folder of scenes.", "FILE")
    output: Path | None = option(None, "Folder to write; out/NAME if left out.", "--output", "-o")
    workers: int = option(1, "Processes on this machine.", least=1)
    scheduler: str | None = option(None, "Use the workers of this dask scheduler.", metavar="ADDRESS")
    pages: bool = option(False, "Write replay and report of every plan.")
    again: bool = option(False, "Plan those again that were not planned before.")

    def __call__(self) -> int:
        from cmbot.campaigns import OVERVIEW, RESULTS

        with ConsoleProgress(quiet=self.quiet) as console:

            def told(progress: CampaignProgress) -> None:
                # What was up to date took no time.
                done, total = progress.done - progress.resumed, progress.total - progress.resumed
                console.stage(_sentence(progress), done / max(total, 1))

            try:
                done = cmbot.campaign(
                    self.file,
                    self.output,
                    workers=self.workers,
                    scheduler=self.scheduler,
                    pages=self.pages,
                    again=self.again,
                    progress=told,
                )
            except KeyboardInterrupt:
                if not self.quiet:
                    err.print("stopped; the same command goes on from here")
                raise
        failed = [row for row in done.rows if row["ended"] != "planned"]

        def data() -> dict[str, Any]:
            return {
                "directory": str(done.directory),
                "files": [str(done.directory / file) for file in (RESULTS, OVERVIEW)],
                "jobs": len(done.rows),
                "ends": dict(done.ends),
                "kept": dict(done.kept),
                "failed": [{name: row[name] for name in ("name", "ended", "reason")} for row in failed],
                "seconds": done.seconds,
            }

        self.answer(data, lambda: _print(done, failed))
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
        f"{one_line(done.name)}: {counted(len(done.rows), 'job')} in {done.seconds:.1f} s{before}: {counts}."
    )
    for row in failed[:_MOST_REASONS]:
        out.print(one_line(f"{row['name']}: {row['ended']}: {row['reason']}"))
    if len(failed) > _MOST_REASONS:
        out.print(f"… and {len(failed) - _MOST_REASONS} more.")
    if kept_failures:
        out.print(f"{kept_failures} of these ended so before; --again plans them again.")
    out.print(f"Table: {one_line(done.directory / RESULTS)}.")
    out.print(f"Look at it: open {one_line(done.directory / OVERVIEW)} in a browser.")
