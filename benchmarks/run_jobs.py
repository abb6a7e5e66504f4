"""Random jobs of several strokes on five arms: the oracle's verdict on each, plans, and what is wrong.

    python benchmarks/run_jobs.py                          # 100 jobs
    python benchmarks/run_jobs.py --jobs 20 --fresh 7      # also jobs that nothing was tuned on
    python benchmarks/run_jobs.py --fresh 7 --document     # what was found goes to docs/performance.md

Jobs go to OUTPUT/jobs, results to OUTPUT/results.json. What has not changed since the last run is not run
again. A job that fails is planned alone by ``cmbot plan OUTPUT/jobs/NAME/job.yaml``.
"""

from __future__ import annotations

import argparse
import json
import secrets
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from report.document import PAGE, RESULTS, ROOT, page
from report.tables import Sheet, markdown, print_sheets
from rich.console import Console
from run_suite import TUNING_SEED, hash_of, planner_files
from suite.jobs import job_name

from cmbot.campaigns import Task, TaskResult, run_tasks

REFERENCE = RESULTS / "jobs.json"
_SUITE = ROOT / "benchmarks" / "suite"
_SECONDS = {"make_job": 120.0, "find_way": 600.0, "plan_job": 900.0}


def jobs_run(
    seeds: Sequence[int], jobs: int, workers: int, output: Path, console: Console
) -> list[dict[str, Any]]:
    """Make, search and plan `jobs` jobs of each seed; return what is known of each."""
    numbered = {job_name(seed, k): (seed, k) for seed in seeds for k in range(jobs)}
    folders = {name: str(output.resolve() / "jobs" / name) for name in numbered}
    makers = hash_of(sorted(_SUITE.glob("*.py")))
    inputs = {"make_job": makers, "find_way": makers, "plan_job": makers + hash_of(planner_files())}

    def told(result: TaskResult) -> None:
        console.print(f"{result.name}: {result.error or result.value}", style="dim", soft_wrap=True)

    def run(kind: str, names: Sequence[str]) -> dict[str, TaskResult]:
        console.print(f"{kind}: {len(names)}")
        tasks = []
        for name in names:
            arguments: dict[str, Any] = {"folder": folders[name]}
            if kind == "make_job":
                arguments |= dict(zip(("seed", "number"), numbered[name], strict=True))
            tasks.append(
                Task(
                    name=name,
                    function=f"suite.jobs:{kind}",
                    arguments=arguments,
                    inputs={"files": inputs[kind]},
                    time_limit=_SECONDS[kind],
                )
            )
        found = run_tasks(tasks, output / kind, workers=workers, report=told)
        return {result.name: result for result in found}

    made = run("make_job", list(numbered))
    there = [name for name in numbered if made[name].status == "done"]
    searched, planned = run("find_way", there), run("plan_job", there)
    rows = []
    for name in there:
        plan = planned[name].value or {"status": planned[name].error or "no answer"}
        way = searched[name].value or {"way": False, "why": searched[name].error}
        rows.append(
            {"name": name, "seed": numbered[name][0], **made[name].value, "oracle": way, "plan": plan}
        )
    return rows


def success(rows: Sequence[dict[str, Any]]) -> Sheet:
    """Return the share of jobs that are planned where the oracle finds a way, by seed and arm."""
    lines = []
    for key in sorted({(row["seed"], row["arm"]) for row in rows}) + sorted({(row["seed"],) for row in rows}):
        some = [row for row in rows if (row["seed"], row["arm"])[: len(key)] == key]
        possible = [row for row in some if row["oracle"]["way"]]
        done = [row for row in possible if row["plan"]["status"] == "planned"]
        either = [row for row in some if row["plan"]["status"] == "planned"]
        share = f"{100 * len(done) / len(possible):.0f} %" if possible else "-"
        wrong = sum(bool(row["plan"].get("violations")) for row in some)
        seconds = [row["plan"]["cpu_seconds"] for row in either]
        lines.append(
            (
                " ".join(map(str, key)) if len(key) > 1 else f"{key[0]} all",
                f"{len(some)}",
                f"{len(possible)}",
                f"{len(done)} ({share})",
                f"{len(either)}",
                f"{wrong}",
                f"{statistics.median(seconds):.1f}" if seconds else "-",
            )
        )
    headings = ("seed, arm", "jobs", "with a way", "of them planned", "planned", "wrong", "s, median")
    title = "Random jobs of several strokes"
    return Sheet(key="jobs", title=title, headings=headings, rows=tuple(lines))


def failures(rows: Sequence[dict[str, Any]]) -> Sheet:
    """Return why jobs with a way were not planned, or what is wrong with their plans."""
    lines = []
    for row in rows:
        plan = row["plan"]
        if plan.get("violations"):
            lines.append((row["name"], f"wrong: {'; '.join(map(str, plan['violations']))}"))
        elif row["oracle"]["way"] and plan["status"] != "planned":
            lines.append((row["name"], plan.get("reason", plan["status"]).replace("|", "/")))
    title = "Jobs with a way that were not planned"
    return Sheet(
        key="jobs-failures", title=title, headings=("job", "reason"), rows=tuple(lines) or (("none", "-"),)
    )


def blocks(results: Mapping[str, Any]) -> dict[str, str]:
    """Return what goes between the markers of docs/performance.md, by marker."""
    sheet = success(results["jobs"])
    return {sheet.key: markdown(sheet)}


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description="Judge cmbot's planner on random jobs.")
    parser.add_argument("--jobs", type=int, default=100, help="of each set (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=TUNING_SEED, help="of the tuning set")
    parser.add_argument("--fresh", nargs="?", type=int, const=-1, metavar="SEED", help="also a fresh set")
    parser.add_argument("--workers", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "jobs", help="default: out/jobs")
    parser.add_argument("--document", action="store_true", help="put the tables into docs/performance.md")
    arguments = parser.parse_args()
    console, seeds = Console(width=max(150, Console().width)), [arguments.seed]
    if arguments.fresh is not None:
        seeds.append(arguments.fresh if arguments.fresh >= 0 else secrets.randbelow(10**6))
        console.print(f"fresh set: seed {seeds[1]}")
    rows = jobs_run(seeds, arguments.jobs, arguments.workers, arguments.output, console)
    results = {"format": "cmbot-jobs/1", "jobs": rows}
    text = json.dumps(results, indent=1) + "\n"
    (arguments.output / "results.json").write_text(text, encoding="utf-8")
    print_sheets([success(rows), failures(rows)], console)
    for row in rows:
        if row["plan"]["status"] != "planned" and not row["oracle"]["way"]:
            why = row["plan"].get("reason", row["plan"]["status"])
            console.print(f"{row['name']} (oracle: {row['oracle']}): {why}", style="dim", soft_wrap=True)
    if arguments.document:
        REFERENCE.write_text(text, encoding="utf-8")
        PAGE.write_text(page(PAGE, blocks(results)), encoding="utf-8")


if __name__ == "__main__":
    main()
