"""One table, one run: what planning and simulating cost, ratios first.

    python benchmarks/run.py            # or: make bench

Times are wall times of this machine; only their ratios mean something elsewhere. Results go to
benchmarks/results/latest.json.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from cmbot import load_scene
from cmbot.planning import Plan, plan, robot_of
from cmbot.robot import Dynamics
from cmbot.simulation import simulate

RESULTS = Path(__file__).parent / "results" / "latest.json"
SCENES = ("triangle", "line")
STATES = 2000


def best_of(action: Callable[[], object], repeats: int = 3) -> float:
    """Shortest of several wall times, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def command(*words: str) -> Callable[[], object]:
    """Return a call that runs Python with `words` in a fresh process."""
    return lambda: subprocess.run([sys.executable, *words], check=True, capture_output=True)


def whole_command(scene: str) -> float:
    """From command to finished plan directory, imports and replay page included, s."""
    with tempfile.TemporaryDirectory() as folder:
        call = "from cmbot.cli import main; main()"
        return best_of(command("-c", call, "plan", scene, "-o", f"{folder}/{scene}", "--force"), repeats=2)


def kernels() -> dict[str, float]:
    """Seconds per state of the guardrail wrench, and of all its derivatives."""
    robot = robot_of(load_scene("triangle"))
    dynamics = Dynamics(robot)
    q, v, a = np.random.default_rng(0).normal(size=(3, STATES, robot.dof))
    return {
        "values": best_of(lambda: dynamics.efforts(q, v, a)) / STATES,
        "derivatives": best_of(lambda: dynamics.derivatives(q, v, a)) / STATES,
    }


def simulation(planned: Plan) -> dict[str, float]:
    """Seconds that the elastic simulation of both motions takes, and how many it simulates."""
    tracking = simulate(planned)
    return {
        "simulate": best_of(lambda: simulate(planned)),
        "simulated": float(tracking.baseline.t[-1] + tracking.planned.t[-1]),
    }


def main() -> None:
    """Measure, print, write."""
    results: dict[str, dict[str, float]] = {"kernels": kernels()}
    results["start-up"] = {
        "python": best_of(command("-c", "pass")),
        "import cmbot": best_of(command("-c", "import cmbot")),
        "import cmbot.planning": best_of(command("-c", "import cmbot.planning")),
    }
    for name in SCENES:
        scene = load_scene(name)
        planned = plan(scene)
        seconds = planned.seconds
        results[name] = {
            "motion": planned.trajectory.duration,
            "command": whole_command(name),
            "path": seconds.path,
            "optimise": seconds.optimise,
            "certify": seconds.certify,
            "passes": float(len(planned.passes)),
            "peak_guardrail_torque": planned.figures.peak_guardrail_torque,
            **simulation(planned),
        }
    results_text = {
        "machine": {
            "python": platform.python_version(),
            "cores": os.cpu_count(),
            "system": platform.machine(),
        },
        "seconds": results,
    }
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(results_text, indent=2) + "\n")
    _print(results)


def _print(results: dict[str, dict[str, float]]) -> None:
    console = Console(soft_wrap=True)
    table = Table(title="Planning, as a share of the time the motion takes")
    for heading in ("scene", "command / motion", "path", "optimise", "certify", "command, s"):
        table.add_column(heading, justify="left" if heading == "scene" else "right")
    for name in SCENES:
        r = results[name]
        shares = (f"{r[key] / r['motion']:.3f}" for key in ("command", "path", "optimise", "certify"))
        table.add_row(name, *shares, f"{r['command']:.2f}")
    console.print(table)
    table = Table(title="Simulating, wall time per second simulated")
    for heading in ("scene", "seconds per second", "both motions, s"):
        table.add_column(heading, justify="left" if heading == "scene" else "right")
    for name in SCENES:
        r = results[name]
        table.add_row(name, f"{r['simulate'] / r['simulated']:.4f}", f"{r['simulate']:.2f}")
    console.print(table)
    kernel, start = results["kernels"], results["start-up"]
    console.print(
        f"Derivatives of the wrench cost {kernel['derivatives'] / kernel['values']:.1f} times its value "
        f"({1e6 * kernel['derivatives']:.1f} and {1e6 * kernel['values']:.1f} us a state)."
    )
    console.print(
        f"import cmbot takes {start['import cmbot'] / start['python']:.1f} times as long as Python alone, "
        f"import cmbot.planning {start['import cmbot.planning'] / start['python']:.1f} times "
        f"({start['import cmbot.planning']:.2f} s)."
    )
    console.print(f"Written to {RESULTS}.")


if __name__ == "__main__":
    main()
