"""A Panda that holds a block to a tool that stands in W, its tip on the block's face."""

from typing import Any

from cmbot.scene import Scene, load_scene

POSTURE = [0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.785]
# The part's frame on the flange, and how high its face is in that: m.
OFFSET, FACE = 0.1, 0.025
# Where the tool stands, its axis up, the block above it: the flange's axis is nearly down in that posture.
TOOL = {"xyz": [0.5, 0.0, 0.3], "rpy_deg": [0, 0, 0]}


def held_scene(keep: Any = "pose", stand_off: float = 0.02, tool: Any = None, **blocks: Any) -> Scene:
    """The scene: a line and a quarter circle over the face; `blocks` are other ones of its file."""
    shape = {"box": [0.12, 0.12, 2 * FACE]}
    path = {
        "keep": keep,
        "from": {"xyz": [-0.03, -0.03, FACE + stand_off], "rpy_deg": [180, 0, 0]},
        "legs": [
            {"by": [0.06, 0, 0], "seconds": 3},
            {"arc": {"centre": [0, 0, FACE + stand_off], "axis": [0, 0, 1], "angle_deg": 90}, "seconds": 3},
        ],
        "via_points": 13,
    }
    nozzle = {"cylinder": [0.01, 0.1], "xyz": [0.5, 0, 0.25], "workpiece": True}
    return load_scene(
        {
            "format": "cmbot-scene/2",
            "name": "held",
            "robot": {
                "model": "panda",
                "tool_frame": "panda_hand_tcp",
                "tool": {"xyz": [0, 0, OFFSET], "mass_kg": 1.0, "shapes": [{**shape, "xyz": [0, 0, OFFSET]}]},
            },
            "start": {"posture": POSTURE},
            "tool": {"fixed": TOOL, **(tool or {})},
            "tool_path": path,
            "obstacles": [{"name": "nozzle", **nozzle}],
            "planner": {"baseline": "none", "safety_margin_m": 0.01, "objective": "travel"},
            "guardrail": {"bays": 0},
            **blocks,
        }
    )
