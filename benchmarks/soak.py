"""A soak: random knot sets through the certificate and random jobs through the planner, as campaigns.

    python benchmarks/soak.py                                  # 2,000 knot sets, 20 jobs
    python benchmarks/soak.py --knots 1000000 --jobs 10000 --workers 2
    python benchmarks/soak.py --document                       # what is there goes to docs/reliability.md

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
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from enclosures import Case, case, outside
from report.document import RESULTS, ROOT, page
from report.tables import Sheet, markdown, print_sheets
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

__all__ = ["KINDS", "REFERENCE", "blocks", "certified_knots", "knot_set", "planned_job", "sheets"]

FORMAT = "cmbot-soak/1"
PAGE, REFERENCE = ROOT / "docs" / "reliability.md", RESULTS / "soak.json"
KINDS = ("C3, least jerk", "free velocities and accelerations", "nearly at rest", "uneven times")
# Knot sets in a task, and its time limit, s; of a job: making and planning.
_TOGETHER, _KNOT_SECONDS, _JOB_SECONDS = 250, 900.0, 600.0
_EVEN, _WINDOW = 200, 25
_NEARLY, _SHORTEST, _LONGEST = 1e-7, 0.02, 5.0
# Jobs are made small: what they do is what larger ones do.
_VIA_POINTS, _SAMPLES = 8, 10
_NUMBER = re.compile(r"[-+]?\d[\d.,e+-]*")


@cache
def _arm() -> tuple[Robot, Clearances, FloatArray]:
    scene = load_scene("triangle")
    robot = robot_of(scene)
    return robot, Clearances(robot, scene.obstacles), np.array(scene.posture)


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
        made = make_job(seed, number, folder)
        file = Path(folder, "job.yaml")
        data = json.loads(file.read_text(encoding="utf-8"))
        for stroke in data["tool_path"]["strokes"]:
            stroke["via_points"] = _VIA_POINTS
        data["planner"] = data.get("planner", {}) | {"samples_per_segment": _SAMPLES}
        file.write_text(json.dumps(data), encoding="utf-8")
        return made | plan_job(folder)


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


def sheets(results: Mapping[str, Any]) -> list[Sheet]:
    """Return the tables: knot sets, what went wrong with them, jobs, why they were not planned."""
    knots, jobs = results["knots"], results["jobs"]
    failed = Counter(failure["kind"] for failure in knots["failures"])
    rows = [(kind, f"{number:,}", f"{failed[kind]:,}") for kind, number in sorted(knots["sets"].items())]
    total = sum(knots["sets"].values())
    rows.append(("all", f"{total:,}", f"{len(knots['failures']):,}"))
    each = 1e3 * knots["cpu_seconds"] / max(total, 1)
    title = f"Knot sets: {knots['samples']:,} samples, {each:.0f} ms of processor time each"
    ends, wrong = Counter(job["status"] for job in jobs), [job for job in jobs if job.get("violations")]
    arms = sorted({job.get("arm", "?") for job in jobs})
    by_arm = []
    for arm in [*arms, "all"]:
        some = [job for job in jobs if arm in (job.get("arm", "?"), "all")]
        here = Counter(job["status"] for job in some)
        broken = sum(bool(job.get("violations")) for job in some)
        by_arm.append((arm, f"{len(some)}", *(f"{here[end]}" for end in sorted(ends)), f"{broken}"))
    why = Counter((job["status"], _kind_of(job["reason"])) for job in jobs if job.get("reason"))
    why.update(("false certificate", _kind_of(broken)) for job in wrong for broken in job["violations"])
    return [
        Sheet(key="soak-knots", title=title, headings=("knot sets", "number", "failures"), rows=tuple(rows)),
        Sheet(
            key="soak-knots-failures",
            title="Failures of knot sets",
            headings=("kind", "what", "number", "first seed"),
            rows=tuple(_failures(knots["failures"])) or (("none", "–", "0", "–"),),
        ),
        Sheet(
            key="soak-jobs",
            title="Jobs",
            headings=("arm", "jobs", *sorted(ends), "false certificate"),
            rows=tuple(by_arm),
        ),
        Sheet(
            key="soak-jobs-failures",
            title="Why jobs were not planned",
            headings=("ended", "reason", "jobs"),
            rows=tuple((end, kind, f"{n}") for (end, kind), n in why.most_common()) or (("–", "–", "0"),),
        ),
    ]


def _failures(failures: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str, str]]:
    alike: dict[tuple[str, str], list[Any]] = {}
    for failure in failures:
        alike.setdefault((failure["kind"], _kind_of(failure["what"])), []).append(failure["seed"])
    return [(kind, what, f"{len(seeds)}", str(seeds[0])) for (kind, what), seeds in alike.items()]


def _kind_of(text: str) -> str:
    """A reason without its numbers, and without what follows on from it."""
    return _NUMBER.sub("…", text.split(";")[0].replace("|", "/"))[:160]


def blocks(results: Mapping[str, Any]) -> dict[str, str]:
    """Return what goes between the markers of docs/reliability.md."""
    made = sheets(results)
    return {sheet.key: f"{sheet.title}.\n\n{markdown(sheet)}" for sheet in made}


def main() -> int:
    """Run, print, write; 1 when anything lies outside an enclosure, or a certificate is false."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--knots", type=int, default=2000, help="random knot sets (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=20, help="random jobs (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=4, help="of the jobs (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "soak", help="default: out/soak")
    parser.add_argument("--document", action="store_true", help="put the results into docs/reliability.md")
    arguments = parser.parse_args()
    console = Console(width=max(150, Console().width))
    results = _run(arguments, console)
    text = json.dumps(results, indent=1) + "\n"
    (arguments.output / "results.json").write_text(text, encoding="utf-8")
    print_sheets(sheets(results), console)
    if arguments.document:
        REFERENCE.write_text(text, encoding="utf-8")
        PAGE.write_text(page(PAGE, blocks(results)), encoding="utf-8")
    broken = results["knots"]["failures"] or any(job.get("violations") for job in results["jobs"])
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
