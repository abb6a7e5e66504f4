"""Make the latest results those of the documentation: its tables, its figure, and the file they come from.

    python benchmarks/run.py --document     # or after a run, in benchmarks/: python -m report.document

Results become benchmarks/results/reference.json, tables go between their markers in docs/performance.md.
tests/benchmarks/test_benchmarks.py holds the page to that file.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from report.goals import goals
from report.tables import KEYS, goal_sheet, markdown, sheets

ROOT = Path(__file__).resolve().parent.parent.parent
RESULTS = ROOT / "benchmarks" / "results"
LATEST, REFERENCE = RESULTS / "latest.json", RESULTS / "reference.json"
# Tables that a page does not need.
PRINTED_ALONE = frozenset({"programs-each", "solvers", "formulations", "kernels"})
PAGE, FIGURE = ROOT / "docs" / "performance.md", ROOT / "docs" / "images" / "performance.png"


def blocks(results: Mapping[str, Any]) -> dict[str, str]:
    """Return what goes between the markers, by marker."""
    made = [goal_sheet(goals(results)), *sheets(results)]
    # A theme that was left out keeps its place.
    kept = dict.fromkeys(KEYS, "Not measured in this run.")
    texts = {**kept, **{sheet.key: markdown(sheet) for sheet in made}, "machine": _machine(results)}
    return {key: text for key, text in texts.items() if key not in PRINTED_ALONE}


def page(path: Path, found: Mapping[str, str]) -> str:
    """Return a page with blocks between ``<!-- key -->`` and ``<!-- end of key -->``.

    Raises
    ------
    SystemExit
        When a marker is missing: which one, on which page.
    """
    text = path.read_text(encoding="utf-8")
    for key, block in found.items():
        start, end = f"<!-- {key} -->\n", f"<!-- end of {key} -->"
        before, opened, rest = text.partition(start)
        _, closed, after = rest.partition(end)
        if not (opened and closed):
            sys.exit(f"{path}: no place marked {key}")
        text = f"{before}{start}{block}\n{end}{after}"
    return text


def _machine(results: Mapping[str, Any]) -> str:
    machine = results["machine"]
    packages = ", ".join(f"{name} {version}" for name, version in machine["packages"].items())
    system = f"Python {machine['python']} on {machine['system']}, {machine['cores']} cores"
    quick = " A quick run, which leaves out what takes long." if results["quick"] else ""
    return f"Measured with {system}; {packages}.{quick}"


def make_reference() -> None:
    """Make the latest results those of the documentation."""
    results = json.loads(LATEST.read_text(encoding="utf-8"))
    # Goals follow from the measurements, also where what a goal counts was changed since.
    results["goals"] = [asdict(goal) for goal in goals(results)]
    REFERENCE.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    shutil.copy(LATEST.with_suffix(".png"), FIGURE)
    PAGE.write_text(page(PAGE, blocks(results)), encoding="utf-8")
    print(f"Written: {REFERENCE}, {FIGURE}, {PAGE}.")


if __name__ == "__main__":
    make_reference()
