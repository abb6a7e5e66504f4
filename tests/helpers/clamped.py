"""Jobs whose feet are clamps: three short strokes, planned in a moment."""

import copy
from typing import Any

from shared_plans import planned
from small_scenes import SHORT

from cmbot.planning import Plan
from cmbot.scene import Scene, load_scene

CLAMP = {"kind": "clamp", "force_n": [8000.0] * 3, "moment_nm": [3000.0] * 3}
MAGNET = {"kind": "magnet", "adhesion_n": 14.9e3, "friction": 10.0}
HOLDS = {"clamp": CLAMP, "safe": {**CLAMP, "safety": 1.2}, "unknown": {"kind": "clamp"}, "magnet": MAGNET}


def clamped_scene(hold: Any = None, **changes: Any) -> Scene:
    """Scene of three strokes, of which the last one reaches furthest out, and a return."""
    strokes = [
        {"name": "near", "legs": [{"by": [0, -0.05, 0], "seconds": 3}]},
        {"name": "middle", "legs": [{"by": [0, 0.05, 0], "seconds": 3}]},
        {"name": "far", "legs": [{"by": [0.2, 0.0, 0.1], "seconds": 3}]},
    ]
    data: dict[str, Any] = {
        "format": "cmbot-scene/2",
        "name": "clamped",
        "guardrail": {"hold": hold or CLAMP},
        "tool": {"process_force_n": [0, 0, -40]},
        "tool_path": {"strokes": [{**each, "via_points": 8} for each in strokes]},
        "return": "start",
    }
    return load_scene({**copy.deepcopy(SHORT), **data, **changes})


def clamped_plan(hold: str) -> Plan:
    """The scene's plan on one of `HOLDS`."""
    return planned(clamped_scene(HOLDS[hold]))
