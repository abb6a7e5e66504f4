"""Print what the figures of a shipped scene are sensitive to: one assumption changed at a time.

The table of docs/assumptions.md is its output. Run it with ``python tools/sensitivity.py [triangle | line]``.
"""

from __future__ import annotations

import math
import re
import sys
from copy import deepcopy
from typing import Any

import cmbot

# Keys of the scene file and the values that replace theirs.
CHANGES: list[dict[str, object]] = [
    {"planner.start": "pinned"},
    {"robot.tool_length_m": 0.25},
    {"robot.tool_length_m": 0.35},
    {"robot.payload_kg": 5.0},
    {"tool_path.via_points": 30},
    {"planner.max_tool_deviation_m": 0.001},
    {"planner.knots": "fixed"},
    {"planner.knots": "fixed", "planner.avoidance_gain": 0.0},
]
HEADER = "| changed | gravity's peak, baseline, Nm | planned, Nm | its clearance, mm | start moved, deg |"


def changed(data: dict[str, Any], key: str, value: object) -> dict[str, Any]:
    """Return a copy of a scene's content with one value changed."""
    data = deepcopy(data)
    *above, last = key.split(".")
    node = data
    for step in above:
        node = node.setdefault(step, {})
    node[last] = value
    return data


def row(name: str, content: dict[str, Any]) -> str:
    """Return a line of the table: a plan's figures, or why there is none."""
    try:
        plan = cmbot.plan(cmbot.load_scene(content))
    except cmbot.PlanningError as error:
        # After line and key.
        why = next(part for part in re.split("[;:] ", str(error)) if re.search(r" \D", part))
        return f"| {name} | no plan: {why} | | | |"
    figures = (
        "-" if plan.baseline is None else f"{plan.baseline.figures.peak_static_guardrail_torque:.2f}",
        f"{plan.figures.peak_static_guardrail_torque:.2f}",
        f"{1e3 * plan.figures.min_clearance:.1f}",
        f"{math.degrees(plan.start.moved):.1f}",
    )
    return f"| {name} | {' | '.join(figures)} |"


def main() -> None:
    """Plan the scene as it is, then with every change."""
    scene = cmbot.load_scene(sys.argv[1] if len(sys.argv) > 1 else "triangle")
    data = scene.as_data()
    print(HEADER)
    print("|---|---|---|---|---|")
    print(row("nothing", data), flush=True)
    for change in CHANGES:
        content = data
        for key, value in change.items():
            content = changed(content, key, value)
        print(row(", ".join(f"`{key}: {value}`" for key, value in change.items()), content), flush=True)


if __name__ == "__main__":
    main()
