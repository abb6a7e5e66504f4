"""The results as tables, ratios first; the same cells on a terminal and in Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table

from report.goals import MEGABYTE, SAME_OPTIMUM, Goal, beside, ratio, total

# Of an optimum, as a share of it, and of a violation. How solvers end that found an optimum.
_MET, _ENDED = 1e-5, ("solved", "converged", "stalled")

__all__ = ["KEYS", "Sheet", "console_table", "goal_sheet", "markdown", "print_sheets", "sheets"]

KEYS = (
    "goals",
    "solvers",
    "planning",
    "simulating",
    "start-up",
    "kernels",
    "growth",
    "formulations",
    "programs",
    "programs-each",
)


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """One table.

    Attributes
    ----------
    key : str
        What documents know it by.
    title : str
    headings : tuple of str
    rows : tuple of tuple of str
    """

    key: str
    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def sheets(results: Mapping[str, Any]) -> list[Sheet]:
    """Return every theme's table that the results have something for."""
    made = [
        _solvers(results["solvers"]),
        _planning(results["planned"]),
        _simulating(results["planned"]),
        _start_up(results["start_up"]),
        _kernels(results["kernels"]),
        _growth(results["growth"]),
        _formulations(results.get("formulations", [])),
        _programs(results.get("programs", [])),
        _each_program(results.get("programs", [])),
    ]
    return [sheet for sheet in made if sheet.rows]


def goal_sheet(goals: Sequence[Goal]) -> Sheet:
    """Return the table of goals."""
    rows = []
    for goal in goals:
        measured = "–" if goal.measured is None else f"{_digits(goal.measured)} {goal.unit}"
        met = {True: "met", False: "missed", None: "–"}[goal.met]
        rows.append((goal.what, goal.bound, measured, met, goal.remark))
    headings = ("goal", "to be reached", "measured", "", "remark")
    return Sheet(key="goals", title="Goals", headings=headings, rows=tuple(rows))


def _solvers(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    cells = []
    for row in rows:
        fast = beside(rows, row)
        worse = row["objective"] / fast["objective"] - 1
        cells.append(
            (
                f"{row['problem']}, {row['knots']}",
                row["solver"],
                _digits(ratio(rows, row)),
                f"{row['seconds']:.3g}",
                f"{row['peak']:.3f}",
                f"{worse:+.0e}" if abs(worse) >= 1e-9 else "0",
                f"{row['violation']:.0e}" if row["violation"] > 1e-9 else "0",
                f"{row['rows']}",
                f"{row['iterations']}",
                row["status"],
            )
        )
    headings = (
        "problem, via-points",
        "solver",
        "times sqp",
        "s",
        "peak, Nm",
        "objective, to sqp's",
        "violation",
        "rows",
        "iterations",
        "ended",
    )
    return Sheet(key="solvers", title="Solvers on the same problems", headings=headings, rows=tuple(cells))


def _planning(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    cells = tuple(
        (
            row["scene"],
            f"{row['command'] / row['motion']:.3f}",
            f"{row['polish_slsqp'] / row['polish']:.2f}",
            f"{row['command']:.2f}",
            f"{row['plan']:.2f}",
            f"{row['way']:.2f}",
            f"{row['polish']:.3f}",
            f"{row['polish_slsqp']:.3f}",
            f"{row['peak']:.3f}",
            f"{row['peak_slsqp']:.3f}",
            "–" if row["core"] is None else f"{row['core']:.3f}",
        )
        for row in rows
    )
    headings = (
        "scene",
        "command / motion",
        "polish, slsqp / sqp",
        "command, s",
        "cmbot.plan, s",
        "path, s",
        "polish by sqp, s",
        "by slsqp, s",
        "peak by sqp, Nm",
        "by slsqp, Nm",
        "fixed via-points by sqp, s",
    )
    return Sheet(key="planning", title="Planning the shipped scenes", headings=headings, rows=cells)


def _simulating(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    cells = tuple(
        (row["scene"], f"{row['simulate'] / row['simulated']:.4f}", f"{row['simulate']:.2f}") for row in rows
    )
    headings = ("scene", "seconds per second", "both motions, s")
    return Sheet(key="simulating", title="Simulating", headings=headings, rows=cells)


def _start_up(seconds: Mapping[str, float]) -> Sheet:
    cells = tuple(
        (name, f"{taken / seconds['python']:.1f}", f"{1e3 * taken:.0f}") for name, taken in seconds.items()
    )
    headings = ("fresh process", "times Python alone", "ms")
    return Sheet(key="start-up", title="Start-up", headings=headings, rows=cells)


def _kernels(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    """All ways of doing it; the first of a kind is what the others are compared with."""
    first: dict[str, float] = {}
    cells = []
    for row in rows:
        unit = first.setdefault(row["what"], row["microseconds"])
        share, each = _digits(row["microseconds"] / unit), _digits(row["microseconds"])
        cells.append((row["what"], row["way"], share, each, "used" if row["used"] else ""))
    together = rows[0]["number"] if rows else 0
    return Sheet(
        key="kernels",
        title=f"Kernels, {together} states in a call",
        headings=("of a state", "way", "times the first", "us", ""),
        rows=tuple(cells),
    )


def _growth(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    cells, last = [], None
    for row in rows:
        n, seconds = row["via_points"], total(row)
        power = "–" if last is None else f"{log(seconds / last[1]) / log(n / last[0]):.2f}"
        stages = (f"{row[stage]:.2f}" for stage in ("global_stage", "optimisation", "certificate"))
        each = f"{1e3 * seconds / n:.1f}"
        cells.append(
            (f"{n}", power, each, f"{seconds:.2f}", *stages, f"{row['memory'] * MEGABYTE / 1e6:.0f}")
        )
        last = n, seconds
    headings = (
        "via-points",
        "power since the last",
        "ms each",
        "s",
        "global stage, s",
        "optimisation, s",
        "certificate, s",
        "memory, MB",
    )
    return Sheet(key="growth", title="Growth", headings=headings, rows=tuple(cells))


def _formulations(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    """A row for each formulation and solver, a column for each problem: times in units of sqp's."""
    problems = list(dict.fromkeys((row["problem"], row["knots"]) for row in rows))
    ways = list(dict.fromkeys((row["rows"], row["samples"], row["solver"]) for row in rows))
    found = {(row["problem"], row["knots"], row["rows"], row["samples"], row["solver"]): row for row in rows}
    cells = []
    for way in sorted(ways, key=lambda way: way[2] == "ipopt"):
        line = [way[2], "exchange" if way[0] == "exchange" else f"{way[0]}, {way[1]}"]
        for problem in problems:
            row, fast = found[*problem, *way], next(r for r in rows if (r["problem"], r["knots"]) == problem)
            line.append(_formulated(row, fast))
        cells.append(tuple(line))
    headings = ("solver", "rows, samples", *(f"{name}, {knots}" for name, knots in problems))
    return Sheet(key="formulations", title="Times sqp, iterations", headings=headings, rows=tuple(cells))


def _formulated(row: Mapping[str, Any], fast: Mapping[str, Any]) -> str:
    """Times sqp and iterations; what is not within 1e-4 of its optimum or of the bounds."""
    times = _digits(row["seconds"] / fast["seconds"])
    if row["objective"] is None:
        return {"cut after": f"> {times}", "cut with ": "–"}.get(row["status"][:9], "failed")
    cell, worse = f"{times} ({row['iterations']})", row["objective"] / fast["objective"] - 1
    if abs(worse) > SAME_OPTIMUM:
        cell += f", {worse:+.0e}"
    if row["violation"] > SAME_OPTIMUM:
        cell += f", violated by {row['violation']:.0e}"
    return cell


def _programs(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    """A row for each solver: of problems with a published optimum how many end there, and what they take."""
    published, random = ([row for row in rows if (row["optimum"] is None) == new] for new in (False, True))
    cells = []
    for k, solver in enumerate(each["solver"] for each in rows[0]["outcomes"]) if rows else ():
        ends = Counter(_end(row, row["outcomes"][k]) for row in published)
        there = [row["outcomes"][k] for row in published if not _end(row, row["outcomes"][k])]
        medians = [median(o[key] for o in there) for key in ("iterations", "evaluations", "seconds")]
        sums = [sum(row["outcomes"][k][key] for row in random) for key in ("iterations", "seconds")]
        missed = sum(bool(_end(row, row["outcomes"][k])) for row in random)
        cells.append(
            (
                solver,
                *(f"{ends[end]}" for end in ("", "elsewhere", "not solved")),
                f"{medians[0]:g}",
                f"{medians[1]:g}",
                f"{1e3 * medians[2]:.3g}",
                f"{len(random) - missed} of {len(random)}",
                f"{sums[0] / len(random):.3g}",
                f"{sums[1] / len(random):.3g}",
            )
        )
    headings = (
        "solver",
        "at the published optimum",
        "elsewhere",
        "not solved",
        "iterations, median",
        "evaluations, median",
        "ms, median",
        "random: at the best",
        "iterations, mean",
        "s, mean",
    )
    title = f"{len(published)} problems of Hock and Schittkowski, {len(random)} random ones"
    return Sheet(key="programs", title=title, headings=headings, rows=tuple(cells))


def _each_program(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    cells = []
    for row in rows:
        line = [row["problem"], f"{row['unknowns']}", f"{row['rows']}"]
        for outcome in row["outcomes"]:
            end = _end(row, outcome)
            took = f"{outcome['iterations']} / {outcome['evaluations']} / {1e3 * outcome['seconds']:.3g}"
            line.append(took + (f", {end}: {outcome['objective']:.5g}" if end else ""))
        cells.append((*line, row["remark"] or "–"))
    solvers = tuple(each["solver"] for each in rows[0]["outcomes"]) if rows else ()
    headings = ("problem", "unknowns", "rows", *solvers, "remark")
    title = "Iterations / evaluations of derivatives / ms"
    return Sheet(key="programs-each", title=title, headings=headings, rows=tuple(cells))


def _end(row: Mapping[str, Any], outcome: Mapping[str, Any]) -> str:
    """Nothing where a solver ended at the published optimum, or the best of all; otherwise how it ended."""
    met = [other["objective"] for other in row["outcomes"] if other["violation"] <= _MET]
    optimum = row["optimum"] if row["optimum"] is not None else min(met)
    far = abs(outcome["objective"] - optimum) > _MET * max(1.0, abs(optimum))
    if outcome["violation"] > _MET:
        return "not solved"
    if not far:
        return ""
    return "elsewhere" if outcome["status"] in _ENDED else "not solved"


def _digits(value: float) -> str:
    """Three digits, without an exponent."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def print_sheets(made: Sequence[Sheet], console: Console) -> None:
    """Print tables on a terminal."""
    for sheet in made:
        console.print(console_table(sheet))


def console_table(sheet: Sheet) -> Table:
    """Return a table for a terminal; the first column is words, the others mostly numbers."""
    table = Table(title=sheet.title)
    for number, heading in enumerate(sheet.headings):
        table.add_column(heading, justify="left" if number == 0 or _wordy(sheet, number) else "right")
    for row in sheet.rows:
        table.add_row(*row)
    return table


def markdown(sheet: Sheet) -> str:
    """Return a table for a document."""
    lines = [f"| {' | '.join(sheet.headings)} |", f"|{'---|' * len(sheet.headings)}"]
    lines += [f"| {' | '.join(row)} |" for row in sheet.rows]
    return "\n".join(lines)


def _wordy(sheet: Sheet, column: int) -> bool:
    return any(row[column][:1].isalpha() for row in sheet.rows)
