"""Lower bounds against brute force: random inverse kinematics and descents at the via-points that set them.

    python benchmarks/bounds.py                            # the shipped scenes and 18 random ones
    python benchmarks/bounds.py --scenes 36 --seed 7 --tries 50000
    python benchmarks/bounds.py SCENE.yaml …               # these scenes alone

A bound is false when an admissible posture is below it by more than its error. Random scenes are those of the
suite, 18 arms in turn.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from suite.scenes import make_scene, scene_name
from threadpoolctl import threadpool_limits

from cmbot import load_scene
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import PlanningError
from cmbot.planning import GlobalSearch, LowerBound
from cmbot.planning.postures.projection import null_space, project_onto_task
from cmbot.planning.request import StrokeRequest, build_request
from cmbot.toolpath import ToolPoses

# Newton steps of restarts; descents: from so many of the best restarts, steps of so many tries.
_STEPS, _DESCENTS, _DESCENT_STEPS, _AROUND = 40, 6, 60, 20
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class Found:
    """What brute force found at one via-point: how many postures held the tool, and the least value."""

    postures: int
    least: float


def brute_force(request: StrokeRequest, bound: LowerBound, tries: int, seed: int) -> Found:
    """Look for an admissible posture below a bound less its error, at its via-point."""
    rng, limits = np.random.default_rng(seed), request.cell.robot.limits
    half = np.minimum(limits.range_half, np.pi)
    low, high = limits.range_middle - half, limits.range_middle + half
    goal = request.goals[bound.via_point]
    q = rng.uniform(low, high, (tries, len(low)))
    q, reached = project_onto_task(request.cell.postures, request.task, q, goal, steps=_STEPS)
    q = limits.turned_to_middle(q[reached])
    q, value = _allowed(request, q)
    order = np.argsort(value, kind="stable")
    best, number = np.inf, len(q)
    clear = []
    for k in order:
        if len(clear) == _DESCENTS:
            break
        if _clear(request, q[k : k + 1])[0]:
            clear.append(k)
            best = min(best, float(value[k]))
    for k in clear:
        least, tried = _descended(request, q[k], goal, rng)
        best, number = min(best, least), number + tried
    return Found(postures=number, least=best)


def _allowed(request: StrokeRequest, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Those of the postures (N, n) within ranges and static torques, and their values."""
    limits = request.cell.robot.limits
    q = q[limits.contain(q)]
    at = request.cell.postures.at(q)
    holds = (np.abs(at.joint_torque) <= limits.torque).all(axis=1)
    return q[holds], request.cell.objective.at_rest(at)[holds]


def _clear(request: StrokeRequest, q: FloatArray) -> BoolArray:
    return request.cell.clear(q)


def _descended(
    request: StrokeRequest, q: FloatArray, goal: ToolPoses, rng: np.random.Generator
) -> tuple[float, int]:
    """The least value that random steps along the self-motion lead to, and how many postures were tried."""
    value, length, number = _allowed(request, q[None])[1][0], 0.2, 0
    for _ in range(_DESCENT_STEPS):
        null = null_space(request.cell.postures, request.task, q[None])[0]
        moves = length * rng.normal(size=(_AROUND, len(null))) @ null
        near, reached = project_onto_task(request.cell.postures, request.task, q + moves, goal)
        near, values = _allowed(request, near[reached])
        number += len(near)
        length *= 0.85
        for k in np.argsort(values, kind="stable"):
            if values[k] >= value:
                break
            if _clear(request, near[k : k + 1])[0]:
                q, value = near[k], values[k]
                break
    return float(value), number


def main() -> None:
    """Run and print; the exit status is 1 when a bound is false."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="*", help="scene files, or names of shipped scenes")
    parser.add_argument("--scenes", type=int, default=18, help="random scenes (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the random scenes (default: %(default)s)")
    parser.add_argument("--tries", type=int, default=20_000, help="restarts a scene (default: %(default)s)")
    given = parser.parse_args()
    console, table = (
        Console(),
        Table("scene", "keep", "bound, Nm", "error", "kind", "least found", "postures"),
    )
    false, postures, scenes, proven = [], 0, 0, 0
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        names = given.scene or ["triangle", "line"]
        if not given.scene:
            for number in range(given.scenes):
                place = Path(folder, scene_name(given.seed, number))
                make_scene(given.seed, number, str(place))
                names.append(str(place / "scene.yaml"))
        for name in names:
            scene = load_scene(name)
            request = build_request(scene, scene.planner)
            started = time.process_time()
            try:
                bound = GlobalSearch(request).lower_bound
            except PlanningError as error:
                console.print(f"{scene.name}: {str(error)[:90]}", style="dim")
                continue
            took = time.process_time() - started
            found = brute_force(request, bound, given.tries, given.seed)
            scenes, postures, proven = (
                scenes + 1,
                postures + found.postures,
                proven + (bound.kind == "proven"),
            )
            if found.least < (bound.value - bound.error) * (1 - _ROUNDING):
                false.append(scene.name)
            row = [f"{bound.value:.4f}", f"{bound.error:.2g}", bound.kind, f"{found.least:.4f}"]
            table.add_row(scene.name, scene.strokes[0].keep, *row, str(found.postures))
            console.print(f"{scene.name}: {took:.1f} s, {bound.basis}", style="dim")
    console.print(table)
    console.print(
        f"{len(false)} false bounds in {postures} postures on {scenes} scenes, {proven} of them proven"
        + (f": {', '.join(false)}" if false else "")
    )
    sys.exit(1 if false else 0)


if __name__ == "__main__":
    main()
