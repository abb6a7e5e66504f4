"""Both solvers on the same problems, one table: what the sparse one costs as a share of SLSQP.

    python benchmarks/solvers.py

Times are process times of this machine; only their ratios mean something elsewhere.
"""

from __future__ import annotations

import time
from dataclasses import replace

from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from cmbot import load_scene
from cmbot.planning.optimiser import optimise
from cmbot.planning.setting import prepare
from cmbot.planning.ways import fixed_way, sliding_way

CASES = [
    (scene, knots, start)
    for scene in ("triangle", "line")
    for knots, start in (("sliding", "free"), ("sliding", "pinned"), ("fixed", "free"))
]


def measured(scene: str, solver: str, knots: str, start: str) -> tuple[float, float, int]:
    """Seconds of optimisation, peak torque in Nm, and iterations."""
    loaded = load_scene(scene)
    setting = prepare(loaded, replace(loaded.planner, solver=solver, knots=knots, start=start))
    way = sliding_way(setting) if knots == "sliding" else fixed_way(setting, lambda _: None)
    begin = time.process_time()
    optimised = optimise(way.problem)
    seconds = time.process_time() - begin
    return seconds, optimised.passes[-1].peak_torque, sum(report.iterations for report in optimised.passes)


def main() -> None:
    """Measure and print."""
    table = Table(title="sqp beside slsqp")
    for heading in ("problem", "time ratio", "sqp, s", "iterations", "peak, Nm", "slsqp, s", "peak, Nm"):
        table.add_column(heading, justify="left" if heading == "problem" else "right")
    with threadpool_limits(limits=1, user_api="blas"):
        for scene, knots, start in CASES:
            fast, peak, iterations = measured(scene, "sqp", knots, start)
            slow, other, _ = measured(scene, "slsqp", knots, start)
            name = f"{scene}, {knots}" + (f", {start}" if knots == "sliding" else "")
            cells = (f"{fast / slow:.2f}", f"{fast:.2f}", str(iterations), f"{peak:.3f}", f"{slow:.2f}")
            table.add_row(name, *cells, f"{other:.3f}")
    Console(soft_wrap=True).print(table)


if __name__ == "__main__":
    main()
