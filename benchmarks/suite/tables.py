"""Results of the suite as tables, a figure, and a block of docs/performance.md."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measure import required
from report.document import PAGE, RESULTS, page
from report.tables import Sheet, markdown, print_sheets
from rich.console import Console

__all__ = ["REFERENCE", "blocks", "document", "failures", "sheets", "show"]

REFERENCE = RESULTS / "suite.json"

_PLANNED = "planned"
# Goals: of scenes with a path the share that is planned; processor times of plans, s.
_SHARE, _MEDIAN, _MOST = 0.97, 2.0, 8.0
# Printed by the command alone: too long for a page.
BY_ARM, _ENDS = "suite-arm", "suite-ends"


def sheets(results: Mapping[str, Any]) -> list[Sheet]:
    """Return the tables: goals, by set and keep, by arm, failures, false statements."""
    rows = results["scenes"]
    return [
        _goals(rows, results["tuning_seed"]),
        _success("suite-keep", "Success by what the path keeps", _by_keep(rows, results["tuning_seed"])),
        _success(BY_ARM, "Success by arm", _grouped(rows, lambda row: (row.get("arm", "?"),))),
        _kinds(rows),
    ]


def failures(results: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return every scene that something is wrong with: its name, what, and why."""
    found = []
    for row in results["scenes"]:
        plan, oracle = row.get("plan", {}), row.get("oracle", {})
        if "make_error" in row:
            found.append((row["name"], "no scene", row["make_error"]))
        if row.get("oracle") and "any" not in oracle:
            found.append((row["name"], f"oracle: {oracle.get('status')}", str(oracle.get("reason"))))
        if plan and plan["status"] != _PLANNED:
            path = _path(oracle)
            found.append((row["name"], f"{plan['status']} (path: {path})", str(plan.get("reason"))))
        if plan.get("false_claim"):
            found.append((row["name"], "false reason", plan["false_claim"]))
        if plan.get("false_bound"):
            found.append((row["name"], "false lower bound", plan["false_bound"]))
        found += [(row["name"], "false certificate", broken) for broken in plan.get("violations", ())]
    return found


def show(results: Mapping[str, Any], output: Path, console: Console) -> None:
    """Print the tables; write them, the failures and the figure into a folder."""
    made = sheets(results)
    print_sheets(made, console)
    lines = ["# Results", ""]
    for sheet in made:
        lines += [f"## {sheet.title}", "", markdown(sheet), ""]
    lines += ["## What failed, or is wrong", ""]
    for name, what, why in failures(results):
        lines += [f"- **{name}**: {what}: {why}", f"  `cmbot plan {output}/scenes/{name}/scene.yaml`"]
    (output / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    draw(results, output / "suite.png")
    console.print(f"Written to {output}.")


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Draw the share of planned scenes over processor time, by what the path keeps."""
    required("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.7, 3.2), layout="constrained", dpi=150)
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    colours = {"pose": "#0072B2", "axis": "#E69F00", "position": "#009E73"}
    for keep, colour in colours.items():
        rows = [row for row in results["scenes"] if row.get("keep") == keep and _exists(row)]
        seconds = np.sort([row["plan"]["cpu_seconds"] for row in rows if _is_planned(row)])
        if rows:
            shares = np.arange(1, len(seconds) + 1) / len(rows)
            axes.step(seconds, shares, where="post", color=colour, label=f"{keep} ({len(rows)} scenes)")
    axes.set_xscale("log")
    axes.set_ylim(0, 1)
    axes.set_xlabel("processor time, s")
    axes.set_ylabel("share planned of scenes with a path")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=7.5)
    figure.savefig(path, metadata={"Software": None})


def blocks(results: Mapping[str, Any]) -> dict[str, str]:
    """Return what goes between the markers of docs/performance.md, by marker."""
    return {sheet.key: markdown(sheet) for sheet in sheets(results) if sheet.key not in (BY_ARM, _ENDS)}


def document(path: Path) -> None:
    """Make the results in a file those of the documentation."""
    shutil.copy(path, REFERENCE)
    results = json.loads(REFERENCE.read_text(encoding="utf-8"))
    PAGE.write_text(page(PAGE, blocks(results)), encoding="utf-8")


def _path(oracle: Mapping[str, Any]) -> str:
    """From where the oracle found a path."""
    if oracle.get("scene"):
        return "from the scene's start"
    if oracle.get("connected"):
        return "from a start that self-motion leads to"
    return "from another start" if oracle.get("any") else "none found"


def _exists(row: Mapping[str, Any]) -> bool:
    return bool(row.get("oracle", {}).get("any")) or _is_planned(row)


def _is_planned(row: Mapping[str, Any]) -> bool:
    return bool(row.get("plan", {}).get("status") == _PLANNED)


Groups = Mapping[tuple[str, ...], Sequence[Mapping[str, Any]]]


def _by_keep(rows: Sequence[Mapping[str, Any]], tuning: int) -> Groups:
    def of(row: Mapping[str, Any]) -> tuple[str, ...]:
        return ("tuning" if row["seed"] == tuning else "fresh", row.get("keep", "?"))

    def whole(row: Mapping[str, Any]) -> tuple[str, ...]:
        return (of(row)[0], "all")

    return {**_grouped(rows, of), **_grouped(rows, whole)}


def _grouped(rows: Sequence[Mapping[str, Any]], of: Callable[[Mapping[str, Any]], tuple[str, ...]]) -> Groups:
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(of(row), []).append(row)
    return dict(sorted(groups.items()))


def _goals(rows: Sequence[Mapping[str, Any]], tuning: int) -> Sheet:
    """What was to be reached on each set, and what was."""
    sets = {
        name: some
        for name in ("fresh", "tuning")
        if (some := [row for row in rows if (row["seed"] == tuning) == (name == "tuning")])
    }

    def share(of: Callable[[Mapping[str, Any]], bool], goal: float | None) -> list[str]:
        cells = []
        for some in sets.values():
            those = [row for row in some if of(row)]
            done = sum(map(_is_planned, those))
            met = "" if goal is None else f", {'met' if done >= goal * len(those) else 'missed'}"
            cells.append(f"{done} of {len(those)}: {done / len(those):.1%}{met}" if those else "–")
        return cells

    def seconds(quantile: float, goal: float) -> list[str]:
        cells = []
        for some in sets.values():
            taken = [row["plan"]["cpu_seconds"] for row in some if _is_planned(row)]
            met = taken and np.quantile(taken, quantile) < goal
            cells.append(f"{_quantile(taken, quantile, '{:.2f}')} s, {'met' if met else 'missed'}")
        return cells

    from_start = share(lambda row: bool(row.get("oracle", {}).get("scene")), None)
    lines = [
        ("planned, of scenes with a path", f"at least {_SHARE:.0%}", *share(_exists, _SHARE)),
        ("planned, of those with a path from their own start", "–", *from_start),
        ("processor time, median", f"below {_MEDIAN:g} s", *seconds(0.5, _MEDIAN)),
        ("processor time, 95 % of plans", f"below {_MOST:g} s", *seconds(0.95, _MOST)),
    ]
    headings = ("goal", "to be reached", *sets)
    return Sheet(key="suite-goals", title="Goals on random scenes", headings=headings, rows=tuple(lines))


def _success(key: str, title: str, groups: Groups) -> Sheet:
    cells = []
    for name, rows in groups.items():
        with_path = [row for row in rows if _exists(row)]
        planned = [row for row in rows if _is_planned(row)]
        seconds = [row["plan"]["cpu_seconds"] for row in planned]
        answered = [row["plan"]["cpu_seconds"] for row in rows if "cpu_seconds" in row.get("plan", {})]
        gaps = [row["plan"]["gap"] for row in planned if row["plan"]["gap"] is not None]
        cells.append(
            (
                ", ".join(name),
                f"{len(rows)}",
                f"{len(with_path)}",
                f"{len(planned)}",
                f"{len(planned) / len(with_path):.1%}" if with_path else "–",
                _quantile(seconds, 0.5, "{:.2f}"),
                _quantile(seconds, 0.95, "{:.1f}"),
                _quantile(answered, 0.95, "{:.1f}"),
                _quantile(gaps, 0.5, "{:.1%}"),
                _quantile(gaps, 0.95, "{:.1%}"),
            )
        )
    headings = (
        "scenes",
        "number",
        "with a path",
        "planned",
        "share",
        "s, median",
        "s, 95 %",
        "with refusals",
        "gap, median",
        "gap, 95 %",
    )
    return Sheet(key=key, title=title, headings=headings, rows=tuple(cells))


def _quantile(values: Sequence[float], share: float, form: str) -> str:
    return form.format(np.quantile(values, share)) if values else "–"


def _kinds(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    """How scenes end, beside what the oracle found; then statements that are false."""
    counts = Counter((row["plan"]["status"], _path(row.get("oracle", {}))) for row in rows if row.get("plan"))
    cells = [(status, path, f"{number}") for (status, path), number in sorted(counts.items())]
    for what, key in (
        ("false reason", "false_claim"),
        ("false lower bound", "false_bound"),
        ("false certificate", "violations"),
    ):
        number = sum(bool(row.get("plan", {}).get(key)) for row in rows)
        cells.append((what, "", f"{number}"))
    headings = ("ended", "path by the oracle", "scenes")
    return Sheet(key=_ENDS, title="How planning ends", headings=headings, rows=tuple(cells))
