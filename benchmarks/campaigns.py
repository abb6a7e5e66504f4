"""How many jobs a campaign plans in a minute, and what a second process adds.

    python benchmarks/campaigns.py                     # 40 jobs, with one process and with two
    python benchmarks/campaigns.py --jobs 1000 --workers 2
    python benchmarks/campaigns.py --tiny 10000        # memory, as tiny jobs go by

The jobs are variants of the triangle and the line with other payloads and first legs, from a seed. Each is
planned with its certificate for all times and written as a plan directory, without pages. Wall times are
those of this machine; what a second process adds is a ratio of one run. Tiny jobs are legs of 0.1 m with
eight via-points; memory is what is resident, in this process and in the largest of its
workers.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import psutil
from measure import machine
from rich.console import Console
from rich.table import Table

import cmbot
from cmbot.campaigns import CampaignProgress

FORMAT = "cmbot-campaign/1"
_TINY = {
    "tool_path.legs": [{"by": [0, -0.1, 0], "seconds": 3}],
    "tool_path.via_points": 8,
    "planner.path_step_s": 0.02,
    "planner.samples_per_segment": 6,
}
_MEGABYTE = 1e6


def variants(jobs: int, seed: int) -> dict[str, object]:
    """Return a campaign file's content: every other job is a line."""
    rng = np.random.default_rng(seed)
    entries = []
    for k in range(jobs):
        payload, longer = rng.uniform(0.0, 3.0), rng.uniform(1.0, 1.3)
        scene, seconds = ("triangle", 10.0) if k % 2 == 0 else ("line", 20.0)
        values = {
            "robot.payload_kg": round(payload, 3),
            "tool_path.legs[0].seconds": round(seconds * longer, 2),
        }
        entries.append({"name": f"job_{k:05}", "at_m": 0.5 * k, "scene": scene, "set": values})
    return {"format": FORMAT, "name": "benchmark", "jobs": entries}


def tiny(jobs: int, seed: int) -> dict[str, object]:
    """Return a campaign file's content: small jobs that differ in their payload."""
    payloads = np.random.default_rng(seed).uniform(0.0, 1.0, jobs)
    entries = [
        {"name": f"job_{k:05}", "set": {"robot.payload_kg": round(payload, 6)}}
        for k, payload in enumerate(payloads)
    ]
    return {"format": FORMAT, "name": "tiny", "scene": "triangle", "set": _TINY, "jobs": entries}


def memory(jobs: int, seed: int, workers: int) -> Table:
    """Run a campaign of tiny jobs: the memory, MB, of this process and of the largest below it."""
    here, rows = psutil.Process(), list[tuple[int, float, float]]()
    marks = {max(1, round(jobs * share)) for share in (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)}

    def resident(process: psutil.Process) -> float:
        try:
            return float(process.memory_info().rss) / _MEGABYTE
        except psutil.NoSuchProcess:
            return 0.0

    def look(progress: CampaignProgress) -> None:
        if progress.done in marks:
            below = [resident(process) for process in here.children(recursive=True)]
            rows.append((progress.done, resident(here), max(below)))

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "campaign.yaml")
        file.write_text(json.dumps(tiny(jobs, seed)), encoding="utf-8")
        done = cmbot.campaign(file, Path(folder, "out"), workers=workers, progress=look)
    table = Table("tiny jobs", "this process, MB", "the largest worker, MB")
    for number, own, largest in rows:
        table.add_row(str(number), f"{own:.0f}", f"{largest:.0f}")
    planned, rate = done.ends["planned"], 60 * jobs / done.seconds
    table.caption = f"{planned} planned on {workers} workers, {rate:.0f} a minute"
    return table


def main() -> None:
    """Run the campaign with each number of processes; print rates and what more of them add."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--tiny", type=int, default=0, help="tiny jobs, whose memory is watched, instead")
    arguments = parser.parse_args()
    console, first = Console(), None
    system = machine()
    console.print(f"{system}")
    if arguments.tiny:
        console.print(memory(arguments.tiny, arguments.seed, arguments.workers[-1]))
        return
    table = Table(
        "processes", "jobs", "planned", "s", "jobs a minute", "cpu s a job", "of the first, a process"
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "campaign.yaml")
        # JSON is YAML.
        file.write_text(json.dumps(variants(arguments.jobs, arguments.seed)), encoding="utf-8")
        for workers in arguments.workers:
            done = cmbot.campaign(file, Path(folder, f"with_{workers}"), workers=workers)
            rate = 60 * len(done.rows) / done.seconds
            first = first or rate / workers
            cpu = np.mean([row["cpu_seconds"] for row in done.rows])
            table.add_row(
                *(str(workers), str(len(done.rows)), str(done.ends["planned"]), f"{done.seconds:.1f}"),
                *(f"{rate:.1f}", f"{cpu:.2f}", f"{rate / workers / first:.0%}"),
            )
    console.print(table)


if __name__ == "__main__":
    main()
