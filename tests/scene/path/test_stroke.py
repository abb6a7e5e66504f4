"""``via_points: auto``: more where the path is longer, turns, bends, or has to be kept more exactly."""

import copy
from typing import Any

import numpy as np
import pytest
from small_scenes import SHORT, short_scene

from cmbot import load_scene
from cmbot.archive import load_plan, save
from cmbot.common.errors import SceneError
from cmbot.planning import plan
from cmbot.planning.precheck import precheck_scene
from cmbot.scene import PlannerOptions

POSE = np.eye(4)
POSE[:3, 3] = 1.8, 0.7, -2.0
LONG = {"by": [0, -1.0, 0], "seconds": 10}
TURNING = {"to": {"xyz": [1.8, 0.6, -2.0], "rpy_deg": [0, 170, 0]}, "seconds": 3}
CORNER = {"legs": [{"by": [0, -0.5, 0], "seconds": 5}, {"by": [0, 0, 0.5], "seconds": 5}]}
STEADY = {"legs": [LONG], "lead_in_m": 0.05, "lead_out_m": 0.05, "speed_tolerance": 0.02}


def count(planner: dict[str, Any] | None = None, **tool_path: Any) -> int:
    data = {**copy.deepcopy(SHORT), "planner": {"max_tool_deviation_m": 1e-3, **(planner or {})}}
    scene = load_scene(data | {"tool_path": {"via_points": "auto", **tool_path}})
    return len(scene.timed_strokes(POSE)[0].via_times)


def test_what_a_path_asks_for() -> None:
    # 20 pieces of 50 mm; of a fifth of a millimetre, more; of a shorter leg fewer, but three a ramp.
    assert count(legs=[LONG]) == 21
    assert count({"max_tool_deviation_m": PlannerOptions().max_tool_deviation_m}, legs=[LONG]) == 31
    assert count({"max_tool_deviation_m": 1e-3 / 16}, legs=[LONG]) == 41
    assert count(legs=[{"by": [0, -0.1, 0], "seconds": 3}]) == 13
    profile = {"kind": "jerk_limited", "ramp": 0.1}
    assert count(legs=[{"by": [0, -0.1, 0], "seconds": 3}], speed_profile=profile) == 31
    assert count(legs=[LONG, {"pause": 2.0}]) == 22
    assert count(legs=[LONG], passes=2) == 41
    assert count(legs=[LONG], seconds="auto") == 21
    assert count(legs=[{"by": [0, -1.0, 0]}], seconds="auto") == 31
    assert count({"max_tool_deviation_m": 1e-3 / 16}, legs=[TURNING]) == 24
    rounded = [count(blend_radius_m=radius, **CORNER) for radius in (0.2, 0.02)]
    assert 15 < rounded[0] < rounded[1]
    assert count(**STEADY) > 2 * count(legs=[LONG])


def test_of_all_strokes_without_a_number() -> None:
    strokes = [{"legs": [LONG], "via_points": 7}, {"from": {"xyz": [1.8, 0.7, -2.0]}, "legs": [LONG]}]
    tool_path = {"strokes": strokes, "via_points": "auto"}
    scene = load_scene({**copy.deepcopy(SHORT), "tool_path": tool_path})
    assert [stroke.via_points for stroke in scene.strokes] == [7, "auto"]
    assert load_scene(scene.as_data()).content_hash == scene.content_hash
    assert [len(stroke.via_times) for stroke in scene.timed_strokes(POSE)] == [7, 31]


def test_a_plan_has_the_number(tmp_path: Any) -> None:
    profile = {"kind": "jerk_limited", "ramp": 0.25}
    scene = short_scene(tool_path={"via_points": "auto", "speed_profile": profile})
    assert ("via-points", "13") in precheck_scene(scene).found
    planned = plan(scene)
    assert planned.scene.strokes[0].via_points == len(planned.trajectory.t) == 13
    assert load_plan(save(planned, tmp_path / "plan"), verify=True).scene.strokes[0].via_points == 13


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tool_path": {"via_points": "many"}}, "via_points: got 'many', expected a whole number"),
    ],
)
def test_refusals(change: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        short_scene(**change)
