"""How time and memory grow with the path: 50 to 5,000 via-points of a sweep, as painting and derusting need.

    python benchmarks/growth.py                  # 50, 200 and 1,000 via-points
    python benchmarks/growth.py 50 200 5000

The tool goes up and down a plane patch in strokes a metre long; longer paths have more strokes, via-points
lie as close together as in the triangle. Every size runs in a process of its own. Times are process times of
this machine; only the exponents between sizes mean something elsewhere.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from math import log

from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from cmbot import Scene, load_scene
from cmbot.planning.certification.certificate import certify
from cmbot.planning.initial_guess import sliding_guess
from cmbot.planning.request import build_request
from cmbot.planning.torque.decomposition import optimise

SIZES = (50, 200, 1000)

# Strokes and steps from one to the next as the triangle's long and short sides, and its via-points' spacing.
STROKE_M, STROKE_S = 1.0, 10.0
STEP_M, STEP_S = 0.1, 2.0
SPACING_S = 20.0 / 49
ROWS = 5

_MEGABYTE = 1024 * (1024 if sys.platform == "darwin" else 1)


@dataclass(frozen=True, kw_only=True)
class Costs:
    """What one size costs: via-points and the path's duration, s; process times, s; peak memory, MiB."""

    via_points: int
    path: float
    global_stage: float
    optimisation: float
    certificate: float
    memory: float
    iterations: int
    peak: float


def sweep(via_points: int, **options: object) -> Scene:
    """Return the scene of a sweep with so many via-points: the arm's place and posture are the triangle's."""
    legs: list[dict[str, object]] = []
    seconds, row, side, up = 0.0, 0, -1, 1
    while seconds < (via_points - 1) * SPACING_S - 0.5 * STROKE_S:
        if not 0 <= row + up < ROWS:
            up = -up
        legs.append({"by": [0, side * STROKE_M, 0], "seconds": STROKE_S})
        legs.append({"by": [0, 0, up * STEP_M], "seconds": STEP_S})
        seconds, row, side = seconds + STROKE_S + STEP_S, row + up, -side
    return load_scene(
        {
            "format": "cmbot-scene/2",
            "name": "sweep",
            "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
            "tool_path": {"legs": legs, "via_points": via_points},
            "obstacles": [
                {"name": "slab", "box": [6, 1.2, 0.12], "xyz": [1, -0.8, -1.06]},
                {"name": "plate", "box": [0.06, 1.2, 0.6], "xyz": [1.9354, 0.3796, -1.9], "workpiece": True},
            ],
            "planner": {"solver": "sqp", **options},
        }
    )


def measured(via_points: int) -> Costs:
    """Plan a sweep in this process, without the comparison with the paper's motion and the approach."""
    scene = sweep(via_points)
    request = build_request(scene, scene.planner)
    laps = [time.process_time()]
    guess = sliding_guess(request)
    laps.append(time.process_time())
    optimised = optimise(guess.problem)
    laps.append(time.process_time())
    certificate = certify(
        request.cell.robot,
        request.task,
        optimised.trajectory,
        request.cell.clearances,
        request.cell.options,
        via_points=len(request.times),
    )
    laps.append(time.process_time())
    certificate.require()
    global_stage, optimisation, certifying = (after - start for start, after in pairwise(laps))
    return Costs(
        via_points=via_points,
        path=request.task.path.duration,
        global_stage=global_stage,
        optimisation=optimisation,
        certificate=certifying,
        memory=peak_memory(),
        iterations=sum(report.iterations for report in optimised.passes),
        peak=certificate.figures.peak_guardrail_torque,
    )


def peak_memory() -> float:
    """Largest memory that this process has had, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MEGABYTE


def in_a_process(via_points: int) -> Costs:
    """Measure one size in a fresh process."""
    call = [sys.executable, __file__, "--one", str(via_points)]
    done = subprocess.run(call, check=True, stdout=subprocess.PIPE, text=True)
    return Costs(**json.loads(done.stdout))


def exponent(some: Costs, more: Costs, name: str) -> float:
    """Power of the number of via-points by which a cost grows from one size to the next."""
    return log(getattr(more, name) / getattr(some, name)) / log(more.via_points / some.via_points)


def sentence(costs: Costs) -> str:
    """Say what one size costs."""
    return (
        f"{costs.via_points} via-points, {costs.path:.0f} s of path: "
        f"global stage {costs.global_stage:.2f} s, "
        f"optimisation {costs.optimisation:.2f} s, certificate {costs.certificate:.2f} s, "
        f"{costs.memory:.0f} MiB, peak {costs.peak:.2f} Nm"
    )


def table_of(costs: list[Costs]) -> Table:
    """Put sizes below each other, and below every one the exponents since the one before."""
    table = Table(title="Costs of a sweep, and exponents from size to size")
    names = [field.name for field in fields(Costs)]
    for name in names:
        table.add_column(name.replace("_", " "), justify="right")
    for k, each in enumerate(costs):
        if k > 0:
            table.add_row(
                *(
                    "" if name in ("via_points", "peak") else f"^{exponent(costs[k - 1], each, name):.2f}"
                    for name in names
                )
            )
        table.add_row(
            *(f"{value:g}" if isinstance(value, int) else f"{value:.2f}" for value in asdict(each).values())
        )
    return table


def main(words: list[str]) -> None:
    """Measure and print."""
    if words[:1] == ["--one"]:
        with threadpool_limits(limits=1, user_api="blas"):
            print(json.dumps(asdict(measured(int(words[1])))))
        return
    sizes = [int(word) for word in words] or list(SIZES)
    console, costs = Console(soft_wrap=True), []
    for size in sizes:
        costs.append(in_a_process(size))
        console.print(sentence(costs[-1]))
    console.print(table_of(costs))


if __name__ == "__main__":
    main(sys.argv[1:])
