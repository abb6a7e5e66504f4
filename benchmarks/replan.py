"""Plans again near earlier plans: a path that moved by 20 mm and turned by 1 degree, many times.

    python benchmarks/replan.py --seed 3925 --scenes 12

Jobs are the triangle, on its guardrail that bends, and scenes of the suite's generator drawn with the seed;
those that are not planned are left out. Each is planned, its path moved in a random direction and turned
about a random axis through its begin, and planned again, five times. Seconds are those of the processor.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation
from suite.scenes import make_scene

import cmbot
from cmbot.common.errors import CmbotError
from cmbot.planning import Plan
from cmbot.scene import Scene, scene_path

MOVED_M, TURNED_DEG, MOVES = 0.02, 1.0, 5


def jobs(seed: int, number: int) -> Iterator[tuple[str, dict[str, Any], Path]]:
    """Yield the triangle, then as many scenes of a seed: a name, the data, and the folder of their files."""
    data = yaml.safe_load(scene_path("triangle").read_text(encoding="utf-8"))
    yield "triangle", data | {"planner": {"baseline": "none"}}, Path(tempfile.mkdtemp())
    for k in range(number):
        folder = tempfile.mkdtemp()
        make_scene(seed, k, folder)
        data = yaml.safe_load((Path(folder) / "scene.yaml").read_text(encoding="utf-8"))
        yield data["name"], data, Path(folder)


def moved(data: dict[str, Any], plan: Plan, rng: np.random.Generator) -> dict[str, Any]:
    """Return the data of a scene whose path is moved and turned."""
    changed = json.loads(json.dumps(data))
    direction, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(np.radians(TURNED_DEG) * axis)
    begin = plan.task.path.poses(np.zeros(1))
    point, rotation = begin.point[0] + MOVED_M * direction, turn * Rotation.from_matrix(begin.rotation[0])
    path = changed["tool_path"]
    start: dict[str, Any] = {"xyz": point.tolist()}
    if path.get("keep", "pose") == "pose":
        start["rpy_deg"] = rotation.as_euler("xyz", degrees=True).tolist()
    elif path["keep"] == "axis":
        start["axis"] = rotation.as_matrix()[:, 2].tolist()
    path["from"] = start
    for leg in path["legs"]:
        leg["by"] = turn.apply(leg["by"]).tolist()
    return changed


def read(data: dict[str, Any], folder: Path) -> Scene:
    """Return the scene of some data, whose files are in a folder."""
    (folder / "job.yaml").write_text(json.dumps(data), encoding="utf-8")
    return cmbot.load_scene(folder / "job.yaml")


def main(words: list[str] | None = None) -> int:
    """Print the table; return 0 where every plan near an earlier one is certified."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=3925)
    parser.add_argument("--scenes", type=int, default=12)
    asked = parser.parse_args(words)
    table = Table(
        "job", "plan, s", "again, s", "most, s", "kept", "changed", "anew", "refused", "peak, of plan's"
    )
    whole = list[float]()
    for number, (name, data, folder) in enumerate(jobs(asked.seed, asked.scenes)):
        rng = np.random.default_rng([asked.seed, number])
        scene, begin = read(data, folder), time.process_time()
        try:
            plan = cmbot.plan(scene, progress=False)
        except CmbotError:
            continue
        took, seconds, kinds, peak = time.process_time() - begin, list[float](), list[str](), 0.0
        for _ in range(MOVES):
            other, begin = read(moved(data, plan, rng), folder), time.process_time()
            try:
                again = cmbot.replan(plan, other, progress=False)
            except CmbotError:
                kinds.append("refused")
                continue
            seconds.append(time.process_time() - begin)
            near = again.fallbacks[0].startswith("Planned near")
            kinds.append(("kept" if again.runs == 1 else "changed") if near else "anew")
            peak = max(peak, again.figures.peak_guardrail_torque / plan.figures.peak_guardrail_torque)
            again.job.certificate.require()
        whole += seconds
        counts = (str(kinds.count(kind)) for kind in ("kept", "changed", "anew", "refused"))
        told = (
            (f"{took:.2f}", f"{np.median(seconds):.2f}", f"{max(seconds):.2f}") if seconds else ("", "", "")
        )
        table.add_row(name, *told, *counts, f"{peak:.3f}")
    console = Console(width=130)
    console.print(table)
    most = np.quantile(whole, 0.9)
    console.print(f"{len(whole)} plans again, median {np.median(whole):.2f} s, 90 % within {most:.2f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
