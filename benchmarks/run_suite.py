"""One run of the suite: random scenes, the oracle's verdict on each, plans and what they are worth.

    python benchmarks/run_suite.py                         # or: make suite
    python benchmarks/run_suite.py --scenes 40 --workers 2
    python benchmarks/run_suite.py --fresh 7               # also scenes that nothing was tuned on

Scenes go to OUTPUT/scenes, results to OUTPUT/results.json. What has not changed since the last run is not
run again. A scene that fails is planned alone by ``cmbot plan OUTPUT/scenes/NAME/scene.yaml``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import secrets
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from report.document import ROOT
from rich.console import Console
from suite import tables
from suite.scenes import scene_name

from cmbot.campaigns import Task, TaskResult, TaskStatus, run_tasks
from cmbot.common.errors import CmbotError

FORMAT = "cmbot-suite/1"
TUNING_SEED = 1
_SECONDS = {"make": 120.0, "oracle": 600.0, "plan": 900.0}
_SUITE = ROOT / "benchmarks" / "suite"
_MAKERS = ("arms.py", "scenes.py", "task.py", "world.py")
_PACKAGES = ("pin", "coal", "numpy", "scipy", "piqp")
# What planning does not run.
_NOT_PLANNING = ("archive", "campaigns", "cli", "simulation", "views")


def suite_run(
    seeds: Sequence[int], scenes: int, workers: int, output: Path, *, again: bool, console: Console
) -> dict[str, Any]:
    """Run the suite on `scenes` scenes of each seed; return the results."""
    numbered = [(seed, number) for seed in seeds for number in range(scenes)]
    names = [scene_name(seed, number) for seed, number in numbered]
    folders = {name: output.resolve() / "scenes" / name for name in names}

    def told(result: TaskResult) -> None:
        if not result.resumed:
            verdict = result.value.get("status", "") if isinstance(result.value, dict) else ""
            console.print(f"{result.name}: {result.error or verdict or result.status}", style="dim")

    def run(kind: str, tasks: list[Task]) -> dict[str, TaskResult]:
        console.print(f"{kind}: {len(tasks)}")
        found = run_tasks(tasks, output / kind, workers=workers, fresh=again, report=told)
        return {result.name: result for result in found}

    made = run(
        "make",
        [
            _task(
                "make",
                name,
                {"seed": seed, "number": number, "folder": str(folders[name])},
                hash_of(_makers()),
            )
            for name, (seed, number) in zip(names, numbered, strict=True)
        ],
    )
    there = [name for name in names if made[name].status == "done"]
    contents = {name: hash_of(sorted(folders[name].iterdir())) for name in there}
    oracle = hash_of([*_makers(), _SUITE / "oracle.py"])
    planner = hash_of(planner_files()) + "".join(map(metadata.version, _PACKAGES))
    judge = hash_of([_SUITE / "judge.py"])
    searched = run(
        "oracle",
        [_task("oracle", name, {"folder": str(folders[name])}, contents[name], oracle) for name in there],
    )
    planned = run(
        "plan",
        [
            _task("plan", name, {"folder": str(folders[name])}, contents[name], oracle, planner, judge)
            for name in there
        ],
    )
    rows = [
        {"name": name, "seed": seed, **_row(made[name], searched.get(name), planned.get(name))}
        for name, (seed, _) in zip(names, numbered, strict=True)
    ]
    return {"format": FORMAT, "tuning_seed": seeds[0], "scenes": rows}


# Of tasks without an answer.
_ENDS = {
    TaskStatus.RAISED: "untyped exception",
    TaskStatus.CRASHED: "crash",
    TaskStatus.TIMED_OUT: "hang",
    TaskStatus.DONE: "no answer",
}
_FUNCTIONS = {
    "make": "suite.scenes:make_scene",
    "oracle": "suite.oracle:find_paths",
    "plan": "suite.judge:plan_scene",
}


def _task(kind: str, name: str, arguments: dict[str, Any], *inputs: str) -> Task:
    return Task(
        name=name,
        function=_FUNCTIONS[kind],
        arguments=arguments,
        inputs={str(k): text for k, text in enumerate(inputs)},
        time_limit=_SECONDS[kind],
    )


def _row(made: TaskResult, searched: TaskResult | None, planned: TaskResult | None) -> dict[str, Any]:
    """Everything that is known of a scene."""
    row: dict[str, Any] = dict(made.value or {"make_error": made.error})
    for key, result in (("oracle", searched), ("plan", planned)):
        if result is None:
            continue
        # A plan that takes more processor time than it may is ended by this signal.
        status = "too slow" if result.error == "signal SIGXCPU" else _ENDS[result.status]
        value = dict(result.value or {"status": status, "reason": result.error})
        # They are for who repairs a failure, in the oracle's own result.
        value.pop("path_deg", None)
        value.pop("times", None)
        row[key] = value
    return row


def _makers() -> list[Path]:
    return [_SUITE / name for name in _MAKERS]


def planner_files() -> list[Path]:
    """Return the files that planning depends on."""
    package = ROOT / "cmbot"
    files = [
        path for path in package.rglob("*.py") if path.relative_to(package).parts[0] not in _NOT_PLANNING
    ]
    return sorted([*files, *(ROOT / "models" / "urdf").iterdir()])


def hash_of(files: Sequence[Path]) -> str:
    """Return the hash of files' contents."""
    total = hashlib.sha256()
    for path in files:
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description="Judge cmbot's planner on random scenes.")
    parser.add_argument("--scenes", type=int, default=120, help="of each set (default: %(default)s)")
    parser.add_argument(
        "--seed", type=int, default=TUNING_SEED, help="of the tuning set (default: %(default)s)"
    )
    parser.add_argument(
        "--fresh",
        nargs="?",
        type=int,
        const=-1,
        metavar="SEED",
        help="also a fresh set, of this seed or of a random one that is printed",
    )
    parser.add_argument("--workers", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "suite", help="default: out/suite")
    parser.add_argument("--again", action="store_true", help="run everything again")
    parser.add_argument("--document", action="store_true", help="put the tables into docs/performance.md")
    arguments = parser.parse_args()
    console = Console(width=max(150, Console().width))
    seeds = [arguments.seed]
    if arguments.fresh is not None:
        seeds.append(arguments.fresh if arguments.fresh >= 0 else secrets.randbelow(10**6))
        console.print(f"fresh set: seed {seeds[1]}")
    try:
        results = suite_run(
            seeds,
            arguments.scenes,
            arguments.workers,
            arguments.output,
            again=arguments.again,
            console=console,
        )
    except CmbotError as error:
        sys.exit(f"error: {error}")
    path = arguments.output / "results.json"
    path.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    tables.show(results, arguments.output, console)
    if arguments.document:
        tables.document(path)


if __name__ == "__main__":
    main()
