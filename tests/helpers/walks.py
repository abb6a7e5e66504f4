"""A walk of one certified step, shared by tests of what is done with walks."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from small_scenes import short_scene

from cmbot.planning import Plan
from cmbot.scene import Scene
from cmbot.stances.walking import Step, Walk, part_data, stance_of
from cmbot.stances.walking.steps import plan_step

CLAMP = {"kind": "clamp", "force_n": [2e4] * 3, "moment_nm": [2e3] * 3}
ARM_DEG = (-83.0, -166.0, 120.0, 30.0, 73.0, 62.0, -10.0)
COUNTERWEIGHT_DEG = (3.1, -93.2, 148.1, 133.6, 54.8, 78.7, 5.7)


def feet(first: float, second: float) -> dict[str, Any]:
    """Both feet on the top rail."""
    ends = {"foot_1": first, "foot_2": second}
    return {foot: {"member": "top_rail", "along_m": x, "turn_deg": 180} for foot, x in ends.items()}


def scene_on_two_feet(
    first: float, second: float, hold: dict[str, Any], posture: Any = ARM_DEG, **changes: Any
) -> Scene:
    """A short scene with both feet on the top rail."""
    begin = {"frame": "world", "xyz": [1.8, 0.78, -2.06], "rpy_deg": [0, 180, 0]}
    return short_scene(
        posture_deg=list(posture),
        tool_path={"from": begin},
        guardrail={"hold": hold, "stance": feet(first, second)},
        **changes,
    )


def tour_record(parts: Mapping[str, Plan | Walk]) -> dict[str, Any]:
    """What tour.json says of its parts."""
    begin, entries = 0.0, list[dict[str, Any]]()
    for name, part in parts.items():
        entries.append(part_data(name, begin, part))
        begin += entries[-1]["seconds"]
    return {"cmbot": "0", "seconds": begin, "parts": entries, "words": []}


@cache
def one_step() -> Walk:
    """A walk of one step of foot 1, from where the arm is the counterweight."""
    scene = scene_on_two_feet(4.04, 4.44, CLAMP, COUNTERWEIGHT_DEG)
    before, after = stance_of(scene), stance_of(scene_on_two_feet(4.09, 4.44, CLAMP))
    moves = plan_step(scene, before, after, 1, np.radians(COUNTERWEIGHT_DEG), 0.03, straight=True)
    step = Step(foot=1, before=before, after=after, moves=moves)
    return Walk(scene=scene, goal=after, steps=(step,), last=None, failures=(), speed=0.03)
