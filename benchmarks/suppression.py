"""How far the tool swings after the stop, with vibration suppression and without, whatever the stiffness is.

    python benchmarks/suppression.py [--scenes triangle line] [--steps 13]
    python benchmarks/suppression.py --variants 20 --seed 2

The second command plans variants of the triangle with random payloads and times instead. Both plans are
simulated with all stiffness times 0.7 to 1.3, in equal steps; what counts is the largest swing over them.
Swings are of the motion, not of this machine.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from campaigns import variants
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from cmbot import load_scene, plan
from cmbot.campaigns.campaign_file import read_campaign
from cmbot.common.arrays import FloatArray
from cmbot.planning import Plan
from cmbot.scene import Scene
from cmbot.simulation import PrescribedWork, SimulationOptions, elastic_arm_of, track_work

__all__ = ["Swings", "compared", "swings"]

_LEAST, _MOST, _STEPS = 0.7, 1.3, 13
# Plans are the same however busy the machine is.
_TIME_LIMIT = 600.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Swings:
    """Largest distances between two places of the tool after the stop (k,), m, for each factor (k,)."""

    factors: FloatArray
    without: FloatArray
    suppressed: FloatArray

    @property
    def ratio(self) -> float:
        """Largest with suppression over the largest without."""
        return float(self.suppressed.max() / self.without.max())


def swings(planned: Plan, factors: FloatArray) -> FloatArray:
    """Simulate a plan with all stiffness times each of `factors` (k,)."""
    work, found = PrescribedWork.planned(planned), []
    for factor in factors:
        options = SimulationOptions(guardrail_factor=factor, link_factor=factor, joint_factor=factor)
        tracked = track_work(elastic_arm_of(planned, options), work, options)
        residual = tracked.metrics.residual
        found.append(0.0 if residual is None else residual.diameter)
    return np.array(found)


def compared(scene: Scene, steps: int) -> Swings:
    """Plan a scene with suppression as its options say and without it, and simulate both."""
    factors = np.linspace(_LEAST, _MOST, steps)
    unlimited = replace(scene.planner, time_limit_s=_TIME_LIMIT)
    plans = [
        plan(scene.with_options(unlimited, quiet_modes=modes), progress=False)
        for modes in (0, unlimited.quiet_modes)
    ]
    with threadpool_limits(limits=1, user_api="blas"):
        without, suppressed = (swings(each, factors) for each in plans)
    return Swings(factors=factors, without=without, suppressed=suppressed)


def triangles(count: int, seed: int) -> dict[str, Scene]:
    """Return variants of the triangle by their names: payload 0 to 3 kg, first leg 10 to 13 s."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "campaign.yaml")
        # JSON is YAML.
        file.write_text(json.dumps(variants(2 * count, seed)), encoding="utf-8")
        entries = islice(read_campaign(file)[1], 0, None, 2)
        return {entry.name: entry.scene for entry in entries}


def tell_of(scenes: dict[str, Scene], steps: int, console: Console) -> None:
    """Print the largest swings of each scene, and how the ratios are spread."""
    table, ratios = Table("scene", "without, mm", "suppressed, mm", "ratio"), list[float]()
    for name, scene in scenes.items():
        found = compared(scene, steps)
        ratios.append(found.ratio)
        largest = (f"{1e3 * each.max():.3f}" for each in (found.without, found.suppressed))
        table.add_row(name, *largest, f"{found.ratio:.2f}")
    console.print(table)
    console.print(
        f"{len(ratios)} variants: ratio {np.median(ratios):.2f} in the median, {max(ratios):.2f} at most; "
        f"at most 0.40 in {sum(ratio <= 0.4 for ratio in ratios)}"
    )


def main() -> int:
    """Plan, simulate, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenes", nargs="+", default=["triangle", "line"])
    parser.add_argument("--steps", type=int, default=_STEPS)
    parser.add_argument("--variants", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    console = Console()
    if options.variants:
        tell_of(triangles(options.variants, options.seed), options.steps, console)
        return 0
    for name in options.scenes:
        found = compared(load_scene(name), options.steps)
        table = Table("stiffness times", "without, mm", "suppressed, mm", title=name)
        for factor, without, suppressed in zip(found.factors, found.without, found.suppressed, strict=True):
            table.add_row(f"{factor:.2f}", f"{1e3 * without:.3f}", f"{1e3 * suppressed:.3f}")
        console.print(table)
        largest = 1e3 * found.suppressed.max(), 1e3 * found.without.max()
        console.print(
            f"{name}: largest swing {largest[0]:.3f} mm of {largest[1]:.3f} without, ratio {found.ratio:.2f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
