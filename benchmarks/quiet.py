"""How quiet plans are: sway at work and swing after the stop, beside the law that a scene would have without.

    python benchmarks/quiet.py --seed 7 [--count 20] [--mujoco 6]

Random scenes of the shipped arm on its guardrail and of three others on an elastic mast; every second one has
the paper's trapezoid as its other law, the others `jerk_limited`. Each is planned with ``quiet`` and with
the other law. What counts is the largest value over 0.7, 1 and 1.3 times the stiffness. Scenes without a plan
are named. The first few quiet plans are simulated by MuJoCo, too, whose model is made from the robot apart
from the package's.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from accuracy import EVERY, STEP, swayed
from rich.console import Console
from scipy.spatial.distance import pdist
from suite.arms import ARMS, arm_named
from suite.scenes import make_scene

from cmbot import PlanningError, load_scene, plan
from cmbot.accuracy.sway import SETTLE_S
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import arm_modes
from cmbot.planning import Plan, bending_arm

__all__ = ["Compared", "compared", "quiet_scene"]

_ARMS = ("cmbot", "panda", "ur10", "xarm7")
# A mast that moves and bends at its top: stiffness, N/m and Nm/rad, and the share by which it may differ.
_MAST, _FACTOR = (4e5, 4e5, 2e6, 4e4, 4e4, 4e4), (0.3, 3.0)
_OTHER = ({"kind": "trapezoidal", "ramp": 0.2}, {"kind": "jerk_limited", "ramp": 0.25})


@dataclass(frozen=True, kw_only=True)
class Compared:
    """A quiet plan beside one by another law.

    Attributes
    ----------
    periods : float
        Of the slowest mode, in the shortest leg.
    sway, swing, other_sway, other_swing : float
        mm.
    peak, mean : float
        Of the torque on the base, as ratios.
    mujoco : two floats or None
        Sway and swing of the quiet plan as MuJoCo has them, mm, where that was asked for.
    """

    periods: float
    sway: float
    swing: float
    other_sway: float
    other_swing: float
    peak: float
    mean: float
    mujoco: tuple[float, float] | None


def quiet_scene(seed: int, number: int, folder: str) -> dict[str, Any]:
    """Return the content of a scene, whose profile is still to be set."""
    rng = np.random.default_rng([seed, number])
    name = _ARMS[number % len(_ARMS)]
    place = next(k for k, arm in enumerate(ARMS) if arm is arm_named(name))
    make_scene(seed, place + len(ARMS) * number, folder)
    data: dict[str, Any] = yaml.safe_load((Path(folder) / "scene.yaml").read_text(encoding="utf-8"))
    if name == "cmbot":
        data.pop("guardrail", None)
    else:
        factor = float(np.exp(rng.uniform(*np.log(_FACTOR))))
        data["guardrail"] = {"bays": 0, "stiffness": np.diag(factor * np.array(_MAST)).tolist()}
    data["robot"].pop("joints", None)
    data["planner"] = {"time_limit_s": 600.0}
    return data


def _planned(data: dict[str, Any], source: Path, profile: dict[str, Any]) -> Plan:
    tool_path = {**data["tool_path"], "speed_profile": profile}
    file = source / f"{profile['kind']}.yaml"
    file.write_text(json.dumps({**data, "tool_path": tool_path}), encoding="utf-8")
    return plan(load_scene(file), progress=False)


def by_mujoco(planned: Plan, arm: ElasticArm) -> tuple[float, float]:
    """Sway at work and swing after it, mm, as MuJoCo has them: the largest over the interval."""
    share, stop = planned.options.quiet_stiffness_share, round(planned.trajectory.duration / (STEP * EVERY))
    tools = [swayed(planned, arm, factor, SETTLE_S) for factor in (1 - share, 1.0, 1 + share)]
    sway = max(float(np.linalg.norm(tool[:stop], axis=1).max()) for tool in tools)
    return 1e3 * sway, 1e3 * max(float(pdist(tool[stop:]).max()) for tool in tools)


def compared(seed: int, number: int, *, simulate: bool = False) -> Compared:
    """Plan a scene with both laws, and simulate the quiet plan by MuJoCo if that is asked for.

    Raises
    ------
    PlanningError
        Where one of them has no plan.
    """
    with tempfile.TemporaryDirectory() as folder:
        data = quiet_scene(seed, number, folder)
        other = _planned(data, Path(folder), _OTHER[number // len(_ARMS) % 2])
        quiet = _planned(data, Path(folder), {"kind": "quiet", "ramp": 0.3})
        arm = bending_arm(quiet.scene, quiet.robot)
        if arm is None or quiet.sway is None or other.sway is None:
            raise ValueError("nothing bends")
        first = float(arm_modes(arm, quiet.trajectory.q[len(quiet.trajectory.q) // 2]).frequencies[0])
        return Compared(
            periods=float(first * min(quiet.task.path.seconds)),
            sway=quiet.sway.sway_mm,
            swing=quiet.sway.swing_mm,
            other_sway=other.sway.sway_mm,
            other_swing=other.sway.swing_mm,
            peak=quiet.figures.peak_guardrail_torque / other.figures.peak_guardrail_torque,
            mean=quiet.figures.mean_guardrail_torque / other.figures.mean_guardrail_torque,
            mujoco=by_mujoco(quiet, arm) if simulate else None,
        )


def main() -> int:
    """Plan, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--mujoco", type=int, default=0, help="how many plans MuJoCo simulates")
    options = parser.parse_args()
    console, rows = Console(soft_wrap=True), list[Compared]()
    for number in range(options.first, options.first + options.count):
        name = f"{number} {_ARMS[number % len(_ARMS)]} {_OTHER[number // len(_ARMS) % 2]['kind']}"
        try:
            found = compared(options.seed, number, simulate=len(rows) < options.mujoco)
        except PlanningError as error:
            console.print(f"{name}: no plan: {str(error)[:200]}")
            continue
        rows.append(found)
        console.print(
            f"{name}: {found.periods:.1f} periods, sway {found.sway:.3g} of {found.other_sway:.3g} mm "
            f"({found.sway / found.other_sway:.2f}), swing {found.swing:.4f} of {found.other_swing:.4f} mm, "
            f"peak {found.peak:.4f}, mean {found.mean:.4f}"
            + (f"; by MuJoCo {found.mujoco[0]:.3g} and {found.mujoco[1]:.4f} mm" if found.mujoco else "")
        )
    ratios, swing, periods = np.array([(r.sway / r.other_sway, r.swing, r.periods) for r in rows]).T
    peak, mean = (max(getattr(row, name) for row in rows) for name in ("peak", "mean"))
    console.print(
        f"{len(rows)} planned: sway {np.median(ratios):.2f} of the other law's in the median, larger in "
        f"{(ratios > 1).sum()}; swing {np.median(swing):.4f} mm in the median, and at most "
        f"{swing[periods > 4].max():.4f} mm of {(periods > 4).sum()} with legs of more than four periods; "
        f"peak {peak:.4f}, mean {mean:.4f} of the other's at most"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
