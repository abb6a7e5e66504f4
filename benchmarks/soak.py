"""A soak: random knot sets through the certificate and random jobs through the planner, as campaigns.

    python benchmarks/soak.py                                  # 2,000 knot sets, 20 jobs
    python benchmarks/soak.py --knots 1000000 --jobs 10000 --workers 2
    python benchmarks/soak.py --document                       # what is there goes to docs/reliability.md
    python benchmarks/soak.py --job j4-007-xarm7               # that job alone: what was found, and its file

Knot sets: times, positions, velocities and accelerations of the shipped arm in four kinds (`KINDS`). Dense
samples may not lie outside what the certificate encloses. Jobs are those of `suite.jobs`, made small, judged
by the oracle's own kinematics, dynamics and distances. Everything is in OUTPUT; the same command again goes
on where it was stopped, and with larger numbers adds to what is there.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from enclosures import Case, case, outside
from report.document import ROOT
from report.reliability import document, sheets
from report.tables import print_sheets
from rich.console import Console
from run_suite import hash_of, planner_files
from suite.jobs import job_name, make_job, plan_job
from threadpoolctl import threadpool_limits

from cmbot import load_scene
from cmbot.campaigns import Task, TaskResult, TaskStatus, run_tasks
from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import CmbotError
from cmbot.planning import robot_of
from cmbot.robot import Robot
from cmbot.trajectory import QuinticTrajectory

__all__ = ["KINDS", "certified_knots", "knot_set", "planned_job"]

FORMAT = "cmbot-soak/1"
KINDS = ("C3, least jerk", "free velocities and accelerations", "nearly at rest", "uneven times")
# Knot sets in a task, and its time limit, s; of a job: making and planning.
_TOGETHER, _KNOT_SECONDS, _JOB_SECONDS = 250, 900.0, 600.0
_EVEN, _WINDOW = 200, 25
_NEARLY, _SHORTEST, _LONGEST = 1e-7, 0.02, 5.0
# Jobs are made small: what they do is what larger ones do.
_VIA_POINTS, _SAMPLES = 8, 10


@cache
def _arm() -> tuple[Robot, Clearances, FloatArray]:
    scene = load_scene("triangle")
    robot = robot_of(scene)
    return robot, Clearances(robot, scene.all_obstacles), np.array(scene.posture)


def knot_set(seed: int) -> tuple[str, Case]:
    """Return a random knot set's kind, and the case: its trajectory and the task of a random path beside."""
    robot, _, posture = _arm()
    made, kind = case(seed, robot, posture), KINDS[seed % len(KINDS)]
    x, rng = made.trajectory, np.random.default_rng([seed, 1])
    t, q, v, a = x.t, x.q, x.v, x.a
    if kind == KINDS[1]:
        size = rng.choice([0.1, 1.0, 5.0])
        v, a = rng.normal(scale=size, size=q.shape), rng.normal(scale=4 * size, size=q.shape)
    elif kind == KINDS[2]:
        q, v, a = q[0] + _NEARLY * (q - q[0]), _NEARLY * v, _NEARLY * a
    elif kind == KINDS[3]:
        h = np.exp(rng.uniform(np.log(_SHORTEST), np.log(_LONGEST), len(t) - 1))
        t = t[-1] * np.append(0.0, np.cumsum(h)) / h.sum()
        v, a = rng.normal(scale=0.3, size=q.shape), rng.normal(size=q.shape)
    return kind, replace(made, trajectory=QuinticTrajectory(t=t, q=q, v=v, a=a))


def certified_knots(first: int, number: int) -> dict[str, Any]:
    """Certify the knot sets of some seeds and sample them: counts by kind, and every failure by its seed."""
    robot, clearances, _ = _arm()
    sets, samples, failures = Counter[str](), 0, []
    with threadpool_limits(limits=1):
        for seed in range(first, first + number):
            kind, made = knot_set(seed)
            sets[kind] += 1
            try:
                wrong, size, widths = outside(robot, clearances, made, even=_EVEN, window=_WINDOW)
            except (CmbotError, ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError) as error:
                failures.append({"seed": seed, "kind": kind, "what": f"{type(error).__name__}: {error}"})
                continue
            samples += size
            if wrong:
                what = f"{wrong} samples outside, by at most {max(0.0, -widths.min()):.1e}"
                failures.append({"seed": seed, "kind": kind, "what": what})
            elif not np.isfinite(widths).all():
                failures.append({"seed": seed, "kind": kind, "what": "an enclosure that is not finite"})
    return {"sets": dict(sets), "samples": samples, "failures": failures}


def planned_job(seed: int, number: int) -> dict[str, Any]:
    """Make a small random job, plan it, and judge the plan."""
    with tempfile.TemporaryDirectory() as folder:
        return _small_job(seed, number, Path(folder))


def _small_job(seed: int, number: int, folder: Path) -> dict[str, Any]:
    made, file = make_job(seed, number, str(folder)), folder / "job.yaml"
    data = json.loads(file.read_text(encoding="utf-8"))
    for stroke in data["tool_path"]["strokes"]:
        stroke["via_points"] = _VIA_POINTS
    data["planner"] = data.get("planner", {}) | {"samples_per_segment": _SAMPLES}
    file.write_text(json.dumps(data), encoding="utf-8")
    return made | plan_job(str(folder))


def _run(arguments: argparse.Namespace, console: Console) -> dict[str, Any]:
    """Run what is not there yet; return what is."""
    here = [Path(__file__), ROOT / "benchmarks" / "enclosures.py"]
    certifying = hash_of([*here, *(file for file in planner_files() if "certification" in file.parts)])
    knots = [
        Task(
            name=f"k{first:08d}",
            function="soak:certified_knots",
            arguments={"first": first, "number": min(_TOGETHER, arguments.knots - first)},
            inputs={"files": certifying},
            time_limit=_KNOT_SECONDS,
        )
        for first in range(0, arguments.knots, _TOGETHER)
    ]
    planning = hash_of([*sorted((ROOT / "benchmarks" / "suite").glob("*.py")), *planner_files()])
    jobs = [
        Task(
            name=job_name(arguments.seed, number),
            function="soak:planned_job",
            arguments={"seed": arguments.seed, "number": number},
            inputs={"files": planning},
            time_limit=_JOB_SECONDS,
        )
        for number in range(arguments.jobs)
    ]

    def told(result: TaskResult) -> None:
        if not result.resumed:
            console.print(f"{result.name}: {result.error or result.status}", style="dim", soft_wrap=True)

    def run(kind: str, tasks: Sequence[Task]) -> tuple[TaskResult, ...]:
        console.print(f"{kind}: {len(tasks)} tasks")
        return run_tasks(tasks, arguments.output / kind, workers=arguments.workers, report=told)

    return {
        "format": FORMAT,
        "seed": arguments.seed,
        "knots": _knots_found(run("knots", knots) if knots else ()),
        "jobs": _jobs_found(run("jobs", jobs) if jobs else ()),
    }


def _knots_found(results: Sequence[TaskResult]) -> dict[str, Any]:
    sets, samples, failures = Counter[str](), 0, []
    for result in results:
        if result.status is TaskStatus.DONE:
            sets.update(result.value["sets"])
            samples += result.value["samples"]
            failures += result.value["failures"]
        else:
            failures.append({"seed": result.name, "kind": "a task", "what": result.error})
    seconds = sum(result.cpu_seconds for result in results)
    return {"sets": dict(sets), "samples": samples, "failures": failures, "cpu_seconds": seconds}


def _jobs_found(results: Sequence[TaskResult]) -> list[dict[str, Any]]:
    rows = []
    for result in results:
        value = result.value or {"status": str(result.status), "reason": result.error}
        rows.append({"name": result.name, "cpu_seconds": result.cpu_seconds} | value)
    return rows


def _alone(name: str, output: Path) -> dict[str, Any]:
    """Make, plan and judge the job of a name in a folder of its own, which is kept."""
    found = re.fullmatch(r"j(\d+)-(\d+)-\w+", name)
    seed, number = map(int, found.groups()) if found else (0, 0)
    if job_name(seed, number) != name:
        sys.exit(f"--job: got {name!r}, expected the name of a job, such as {job_name(4, 7)}")
    folder = output / "alone" / name
    folder.mkdir(parents=True, exist_ok=True)
    with threadpool_limits(limits=1):
        return {"file": str(folder / "job.yaml"), **_small_job(seed, number, folder)}


def main() -> int:
    """Run, print, write; 1 when anything lies outside an enclosure, or a certificate is false."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--knots", type=int, default=2000, help="random knot sets (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=20, help="random jobs (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=4, help="of the jobs (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "soak", help="default: out/soak")
    parser.add_argument("--document", action="store_true", help="put the results into docs/reliability.md")
    parser.add_argument(
        "--job", metavar="NAME", help="make, plan and judge this job alone, and keep its file"
    )
    arguments = parser.parse_args()
    if arguments.job is not None:
        found = _alone(arguments.job, arguments.output)
        print(json.dumps(found, indent=1))
        return int(bool(found.get("violations")))
    console = Console(width=max(150, Console().width))
    results = _run(arguments, console)
    text = json.dumps(results, indent=1) + "\n"
    (arguments.output / "results.json").write_text(text, encoding="utf-8")
    print_sheets(sheets(results), console)
    if arguments.document:
        document(results)
    broken = results["knots"]["failures"] or any(job.get("violations") for job in results["jobs"])
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
