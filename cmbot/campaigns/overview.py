"""The overview of a campaign as one offline page: counts, a map along the rail, histograms, a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from cmbot.common.errors import whole_sentences
from cmbot.version import __version__
from cmbot.views import REPORT, assemble_plain

# Of a reason of more characters the first sentences are shown; the table of results has it whole.
_MAX_REASON_CHARACTERS = 600
# Significant digits of a figure.
_FIGURE_DIGITS = 6


def overview_page(name: str, rows: Sequence[Mapping[str, Any]], directory: Path) -> str:
    """Return the page.

    Parameters
    ----------
    name : str
        Of the campaign.
    rows : sequence of mapping
        As `result_row` returns them.
    directory : Path
        The campaign's folder: reports that are there are linked.
    """
    ends = Counter(row["ended"] for row in rows)
    counts = ", ".join(f"{number:,} {escape(end)}" for end, number in ends.most_common())
    jobs = f"{len(rows):,} {'job' if len(rows) == 1 else 'jobs'}"
    return assemble_plain(
        "overview.html",
        styles=("common.css", "overview.css"),
        scripts=("overview.js", "sideways.js"),
        data=_columns(rows, directory),
        texts={
            "title": escape(name),
            "counts": f"{jobs}: {counts}",
            "made": f"Made by cmbot {__version__}.",
        },
    )


def _columns(rows: Sequence[Mapping[str, Any]], directory: Path) -> dict[str, list[Any]]:
    """What the page shows of each job, column by column: that is shorter than row by row."""
    return {
        "name": [row["name"] for row in rows],
        "at": [_short(row["at_m"]) for row in rows],
        "ended": [row["ended"] for row in rows],
        "reason": [whole_sentences(str(row["reason"]), _MAX_REASON_CHARACTERS) for row in rows],
        "baseline": [_short(row.get("baseline_job.peak_guardrail_torque")) for row in rows],
        "planned": [_short(row.get("planned_job.peak_guardrail_torque")) for row in rows],
        "workBaseline": [_short(row.get("baseline_work.peak_guardrail_torque")) for row in rows],
        "faults": [row.get("baseline_job_faults") or "" for row in rows],
        "workFaults": [row.get("baseline_work_faults") or "" for row in rows],
        "workPlanned": [_short(row.get("planned_work.peak_guardrail_torque")) for row in rows],
        "clearance": [_short(row.get("planned_job.min_clearance")) for row in rows],
        "duration": [_short(row.get("duration")) for row in rows],
        "seconds": [_short(row["seconds"]) for row in rows],
        "plan": [row["plan"] for row in rows],
        "report": [_report(row["plan"], directory) for row in rows],
    }


def _report(place: str | None, directory: Path) -> str | None:
    """The page in a plan directory that the job's name leads to, where it is there."""
    return REPORT if place is not None and (directory / place / REPORT).is_file() else None


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.{_FIGURE_DIGITS}g}")
