"""The results of the soak as tables, and the page docs/reliability.md.

    cd benchmarks && python -m report.reliability    # writes the page anew from benchmarks/results/soak.json

They stand apart from the soak, so that another table is no reason to run it again.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from report.document import RESULTS, ROOT, page
from report.tables import Sheet, markdown

__all__ = ["PAGE", "REFERENCE", "blocks", "document", "sheets"]

PAGE, REFERENCE = ROOT / "docs" / "reliability.md", RESULTS / "soak.json"
# How jobs end; the page says what each means, so each has a column.
_ENDS = ("planned", "no plan", "refused", "raised", "crashed", "timed out")
# Numbers, and names of joints and links: what reasons of one kind differ in.
_PARTICULAR = re.compile(r"[-+]?\d[\d.,e+-]*|\b(?!tool_path\b)\w*_\w+")
# How far planning came, with which most reasons begin.
_SO_FAR = re.compile(r"^no path beyond [^:]*: ")
_LONGEST_REASON = 80


def sheets(results: Mapping[str, Any]) -> list[Sheet]:
    """Return the tables: knot sets, what went wrong with them, jobs, why they were not planned."""
    knots, jobs = results["knots"], results["jobs"]
    failed = Counter(failure["kind"] for failure in knots["failures"])
    rows = [(kind, f"{number:,}", f"{failed[kind]:,}") for kind, number in sorted(knots["sets"].items())]
    total = sum(knots["sets"].values())
    rows.append(("all", f"{total:,}", f"{len(knots['failures']):,}"))
    ends = [*_ENDS, *sorted({job["status"] for job in jobs} - set(_ENDS))]
    by_arm = []
    for arm in [*sorted({job.get("arm", "?") for job in jobs}), "all"]:
        some = [job for job in jobs if arm in (job.get("arm", "?"), "all")]
        here = Counter(job["status"] for job in some)
        broken = sum(bool(job.get("violations")) for job in some)
        by_arm.append((arm, f"{len(some):,}", *(f"{here[end]:,}" for end in ends), f"{broken:,}"))
    why = Counter((job["status"], _kind_of(job["reason"])) for job in jobs if job.get("reason"))
    why.update(("false certificate", _kind_of(each)) for job in jobs for each in job.get("violations", ()))
    cost = _cost(knots["cpu_seconds"], total, "knot set")
    return [
        Sheet(
            key="soak-knots",
            title=f"{total:,} knot sets with {knots['samples']:,} samples: {cost}",
            headings=("knot sets", "number", "failures"),
            rows=tuple(rows),
        ),
        Sheet(
            key="soak-knots-failures",
            title="Failures of knot sets",
            headings=("kind", "what", "number", "first seed"),
            rows=tuple(_failures(knots["failures"])) or (("none", "–", "0", "–"),),
        ),
        Sheet(
            key="soak-jobs",
            title=f"{len(jobs):,} jobs: {_cost(sum(job['cpu_seconds'] for job in jobs), len(jobs), 'job')}",
            headings=("arm", "jobs", *ends, "false certificate"),
            rows=tuple(by_arm),
        ),
        Sheet(
            key="soak-jobs-failures",
            title="Why jobs were not planned",
            headings=("ended", "reason", "jobs"),
            rows=tuple((end, kind, f"{n}") for (end, kind), n in why.most_common()) or (("–", "–", "0"),),
        ),
    ]


def _cost(seconds: float, number: int, what: str) -> str:
    """What a number of them took, and what each did."""
    return f"{seconds / 60:,.0f} min of processor time, {seconds / max(number, 1):.2g} s a {what}"


def _failures(failures: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str, str]]:
    alike: dict[tuple[str, str], list[Any]] = {}
    for failure in failures:
        alike.setdefault((failure["kind"], _kind_of(failure["what"])), []).append(failure["seed"])
    return [(kind, what, f"{len(seeds)}", str(seeds[0])) for (kind, what), seeds in alike.items()]


def _kind_of(text: str) -> str:
    """A reason without its place, numbers and names, and what follows on from it; cut between words."""
    kind = _PARTICULAR.sub("…", _SO_FAR.sub("", text).split(";")[0].replace("|", "/"))
    return textwrap.shorten(kind, _LONGEST_REASON, placeholder=" …")


def blocks(results: Mapping[str, Any]) -> dict[str, str]:
    """Return what goes between the markers of docs/reliability.md: the reasons are too long for it."""
    shown = (sheet for sheet in sheets(results) if not sheet.key.endswith("-failures"))
    return {sheet.key: f"{sheet.title}.\n\n{markdown(sheet)}" for sheet in shown}


def document(results: Mapping[str, Any]) -> None:
    """Make results those of the documentation."""
    REFERENCE.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(PAGE, blocks(results)), encoding="utf-8")


if __name__ == "__main__":
    document(json.loads(REFERENCE.read_text(encoding="utf-8")))
