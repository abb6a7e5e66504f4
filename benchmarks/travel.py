"""How far the joints of a Panda travel on five loops of a circle, and what that costs.

    python benchmarks/travel.py

The tool keeps its place, or its axis, too: then four joints, or two, are free to move without moving it. What
is printed is the sum of their moves in degrees, on the approach and at work, and the peak and the mean of the
torque on the base at work. It needs the extra ``robots``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import cmbot

LIMITS = Path(__file__).resolve().parent.parent / "scenes" / "panda_sanding" / "limits.yaml"
LOOP = {"arc": {"centre": [0.45, 0.0, 0.35], "axis": [0, 0, 1], "angle_deg": 360}, "seconds": 8}


def loops(keep: str) -> cmbot.Scene:
    """Five loops, 0.12 m around a point in front of the arm."""
    start: dict[str, Any] = {"frame": "world", "xyz": [0.57, 0.0, 0.35], "axis": [0, 0, -1]}
    robot = {"model": "panda", "base_frame": "panda_link0", "tool_frame": "panda_hand_tcp"}
    scene = {
        "format": "cmbot-scene/2",
        "name": f"loops_{keep}",
        "robot": robot | {"limits": str(LIMITS)},
        "start": {"posture_deg": [0, -45, 0, -135, 0, 90, 45]},
        "tool_path": {"keep": keep, "from": start, "legs": [LOOP] * 5, "via_points": "auto"},
        "guardrail": {"bays": 0},
        "planner": {"time_limit_s": 300},
    }
    return cmbot.load_scene(scene)


def travelled(segment: Any) -> float:
    """Sum of the moves of all joints, degrees."""
    q = segment.trajectory.evaluate(np.linspace(0.0, segment.duration, 2000))
    return float(np.rad2deg(np.abs(np.diff(q, axis=0)).sum()))


def main() -> None:
    """Print the table."""
    print("| kept | approach, deg | work, deg | peak at work, Nm | mean at work, Nm |\n|---|---|---|---|---|")
    for keep in ("position", "axis"):
        plan = cmbot.plan(loops(keep), progress=False)
        approach = sum(travelled(each) for each in plan.job.segments if each.kind == "free")
        work, figures = sum(map(travelled, plan.job.strokes)), plan.figures
        peak, mean = figures.peak_guardrail_torque, figures.mean_guardrail_torque
        print(f"| {keep} | {approach:.0f} | {work:.0f} | {peak:.2f} | {mean:.2f} |", flush=True)


if __name__ == "__main__":
    main()
