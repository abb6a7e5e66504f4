"""Scenes that plan in a moment, and changes of them that leave them feasible."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import trimesh
from small_scenes import SHORT

__all__ = ["ASKED", "BASES", "DOUBLED", "FURTHER", "GOAL", "HONEST", "SMALL", "WALK", "changed"]

Data = dict[str, Any]

_WAY = {"via_points": 12, "speed_profile": {"kind": "jerk_limited", "ramp": 0.4}}
_BAR = {"name": "bar", "box": [0.06, 1.0, 0.06], "xyz": [1.9354, 0.63, -2.0628]}
_NEAR = {"name": "bar", "box": [0.06, 1.0, 0.06], "xyz": [1.87, 0.63, -2.0628]}
_FLOOR = {"name": "floor", "box": [6, 6, 0.1], "xyz": [1.0, 1.0, -3.2]}


def changed(data: Data, changes: Mapping[str, Any]) -> Data:
    """Return a scene's data with other values by their keys, ``a.b[0].c``; None takes one away."""
    data = copy.deepcopy(data)
    for key, value in changes.items():
        at: Any = data
        *path, last = key.replace("[", ".").replace("]", "").split(".")
        for name in path:
            at = at[int(name)] if name.isdigit() else at.setdefault(name, {})
        name = int(last) if last.isdigit() else last
        if value is not None:
            at[name] = value
        elif name in at or isinstance(name, int):
            del at[name]
    return data


def _of(name: str, changes: Mapping[str, Any], base: Data = SHORT) -> Data:
    return changed(base, {"name": name, **changes})


BASES: dict[str, Data] = {
    "short": _of("short", {}),
    "sliding": _of("sliding", {"planner.knots": "sliding", "tool_path.via_points": 10}),
    "bar": _of("bar", {"obstacles": [_BAR, _FLOOR]}),
    "heavy": _of("heavy", {"robot.payload_kg": 2.0}),
    "strokes": _of(
        "strokes",
        {
            "tool.process_force_n": [0, 0, -40],
            "tool_path": {
                "strokes": [
                    {"name": "there", "legs": [{"by": [0, -0.1, 0], "seconds": 3}], **_WAY},
                    {
                        "name": "back",
                        "from": {"frame": "world", "xyz": [1.8154, 0.6796, -1.9628]},
                        "legs": [{"by": [0, 0.1, 0], "seconds": 3}],
                        **_WAY,
                    },
                ]
            },
            "return": "start",
        },
    ),
    "rows": _of(
        "rows",
        {
            "frames": {"plate": {"xyz": [1.9354, 0.55, -2.2], "rpy_deg": [0, 0, 0]}},
            "tool_path": {
                "keep": "axis",
                "raster": {
                    "frame": "plate",
                    "origin": [0, 0, 0.1],
                    "u": [0, 0.2, 0],
                    "v": [0, 0, -0.1],
                    "spacing_m": 0.05,
                    "stand_off_m": 0.12,
                },
                "seconds": 12,
                **_WAY,
            },
            "planner.knots": "sliding",
        },
    ),
    "magnet": _of(
        "magnet",
        {"guardrail.hold": {"kind": "magnet", "adhesion_n": 14000.0, "friction": 0.96, "safety": 1.0}},
    ),
    "bent": _of("bent", {"robot.joints": "elastic", "planner.compensate": True, "planner.baseline": "none"}),
    "alone": _of(
        "alone",
        {
            "planner": {"baseline": "none", "compensate": False},
            "tool_path.via_points": 10,
            "tool_path.from": {"frame": "world", "xyz": [1.8154, 0.7796, -2.0628]},
        },
    ),
    "turns": _of(
        "turns",
        {
            "tool_path.legs": [
                {"by": [0, -0.15, 0], "seconds": 5},
                {"pause": 1.0},
                {"by": [0, 0.05, 0.1], "seconds": 5},
            ],
            "tool_path.via_points": 14,
        },
    ),
}
BASES["ramp"] = _of("ramp", {"tool.process_ramp_s": 0.4}, BASES["strokes"])
"""Scenes that are asked for and can be planned, by their names."""
ROOM = Path(tempfile.gettempdir()) / "cmbot_forgeries"
ROOM.mkdir(exist_ok=True)
SMALL, DOUBLED, _LARGE, _GIVEN = (str(ROOM / name) for name in ("small.stl", "doubled", "large.stl", "given"))
for _file, _size in ((SMALL, (0.01, 1.0, 0.01)), (_LARGE, (0.06, 1.0, 0.06))):
    trimesh.creation.box(_size).export(_file)
for _file, _factor in ((_GIVEN, 1), (DOUBLED, 2)):
    _every = f"all: {{acceleration_deg: {150 * _factor}, jerk_deg: {3000 * _factor}}}"
    Path(_file).write_text(f"format: cmbot-joint-limits/1\n{_every}\n", encoding="utf-8")
_PANDA = {"model": "panda", "base_frame": "panda_link0", "tool_frame": "panda_hand_tcp", "limits": _GIVEN}

ASKED: dict[str, Data] = {
    **BASES,
    "near": _of("near", {"obstacles": [_NEAR]}),
    "mesh": _of("mesh", {"obstacles": [{**_NEAR, "box": None, "mesh": _LARGE}]}),
    "panda": _of(
        "panda",
        {
            "robot": _PANDA,
            "guardrail": {"bays": 0},
            "start.posture_deg": [0, -45, 0, -135, 0, 90, 45],
            "tool_path.legs[0].seconds": 1.35,
            "planner.start": "pinned",
        },
    ),
}
"""These, and some that nobody can do: a bar is nearer than the margin, a leg is too quick."""

HONEST: tuple[tuple[str, dict[str, Any]], ...] = (
    *((base, {}) for base in BASES),
    *(
        ("short", {key: value})
        for key, value in (
            ("tool_path.via_points", 12),
            ("tool_path.via_points", "auto"),
            ("tool_path.legs[0].seconds", 5),
            ("tool_path.legs[0].seconds", "auto"),
            ("tool_path.legs[0].by", [0, -0.2, 0.1]),
            ("tool_path.keep", "axis"),
            ("tool_path.keep", "position"),
            ("tool_path.keep", {"axis_within_deg": 10}),
            ("tool_path.passes", 2),
            ("tool_path.speed_profile", {"kind": "quiet", "ramp": 0.4}),
            ("tool_path.speed_profile", {"kind": "jerk_limited", "ramp": 0.3}),
            ("robot.payload_kg", 1.5),
            ("robot.tool_length_m", 0.25),
            ("tool", {"process_force_n": [0, 0, -15], "max_speed_m_s": 0.2}),
            ("guardrail", {"stiffness_factor": 0.5}),
            ("guardrail", {"foot": {"offset_m": 0.3}}),
            ("guardrail", {"bays": 0}),
            ("uncertainty", "none"),
            ("planner.baseline", "none"),
            ("planner.objective", "hold"),
            ("planner.objective", "sag"),
            ("planner.max_tool_deviation_m", 0.002),
            ("planner.max_tool_rotation_deg", 0.5),
            ("planner.max_tool_lag_m", 0.01),
            ("planner.safety_margin_m", 0.03),
            ("planner.compensate", True),
            ("planner.deviation_sigmas", 1.0),
            ("planner.samples_per_segment", 20),
            ("return", "start"),
            ("return", "stow"),
            ("planner.objective", "travel"),
        )
    ),
    *(
        ("sliding", {key: value})
        for key, value in (
            ("planner.start", "pinned"),
            ("planner.moment_about", "base"),
            ("planner.axis_weights", [1, 0, 0]),
            ("planner.compensate", "auto"),
            ("tool_path.keep", "axis"),
            ("return", "start"),
        )
    ),
    ("bar", {"planner.knots": "sliding"}),
    ("bar", {"obstacles[0].xyz": [1.95, 0.63, -2.06]}),
    ("strokes", {"tool_path.order": "best", "tool_path.strokes[0].from": {"xyz": [1.8154, 0.7796, -2.0628]}}),
    ("strokes", {"tool_path.strokes[1].backwards": True}),
    ("strokes", {"planner.knots": "sliding"}),
    ("strokes", {"return": None}),
    ("rows", {"tool_path.seconds": 16}),
    ("rows", {"tool_path.seconds": None, "tool_path.speed_m_s": 0.05}),
    ("rows", {"tool_path.raster.overscan_m": 0.02}),
    ("rows", {"planner.compensate": "auto"}),
    ("magnet", {"guardrail.hold.plate_m": [0.15, 0.14], "guardrail.hold.adhesion_n": 14500.0}),
    ("bent", {"tool_path.keep": "axis"}),
    ("bent", {"planner.compensate": False}),
    ("turns", {"tool_path.legs[1].pause": 0.5}),
    ("turns", {"planner.knots": "sliding"}),
)
"""Honest plans: a scene that is asked for, and what is changed of it."""

WALK: Data = {
    "format": "cmbot-scene/2",
    "name": "walk",
    "robot": {"model": "cmbot", "joints": "rigid"},
    "start": {"posture_deg": [3.1, -93.2, 148.1, 133.6, 54.8, 78.7, 5.7]},
    "tool_path": {
        "from": {"frame": "world", "xyz": [1.8, 0.78, -2.06], "rpy_deg": [0, 180, 0]},
        "legs": [{"by": [0, -0.3, 0], "seconds": 4}],
        "via_points": 8,
    },
    "guardrail": {
        "hold": {"kind": "clamp", "force_n": [2e4] * 3, "moment_nm": [2e3] * 3},
        "stance": {
            "foot_1": {"member": "top_rail", "along_m": 4.04, "turn_deg": 180},
            "foot_2": {"member": "top_rail", "along_m": 4.44, "turn_deg": 180},
        },
    },
    "planner": SHORT["planner"],
}
"""A stance from which a step leads to the next one."""
BASES["stands"] = changed(WALK, {"planner.baseline": "none"})
ASKED |= {"walk": WALK, "tour": changed(WALK, {"return": "start"}), "stands": BASES["stands"]}
FURTHER = {f"guardrail.stance.foot_{foot}.along_m": x for foot, x in ((1, 4.045), (2, 4.445))}
GOAL: Data = changed(WALK, {"guardrail.stance.foot_1.along_m": 4.09})["guardrail"]["stance"]
