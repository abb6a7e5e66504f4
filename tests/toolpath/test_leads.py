"""Leads: a process at constant speed between two ramps, on every kind of path."""

import copy
from typing import Any

import numpy as np
import pytest
from oracles.scene_path import ScenePath
from small_scenes import SHORT
from timed_paths import check_described

from cmbot import load_scene
from cmbot.common.errors import SceneError
from cmbot.scene import Scene
from cmbot.toolpath import SpeedProfile, ToolPath
from cmbot.toolpath.time_law import law_with_leads

SPEED, LEADS = 0.1, {"lead_in_m": 0.05, "lead_out_m": 0.08, "speed_tolerance": 0.05}
WAVE = [
    [0.1 * k, 0.02 * np.sin(k), 0.1, *np.array([1, 0.02 * k, 0, 0]) / np.hypot(1, 0.02 * k)] for k in range(8)
]
PATCH = {"origin": [0, 0, 0], "u": [0.6, 0, 0], "v": [0, 0.2, 0], "spacing_m": 0.1, "stand_off_m": 0.1}
PIPE = {"centre": [0, 0, 0], "axis": [0, 0, 1], "radius": 0.3, "from_deg": 0, "to_deg": 90, "length": 0.3}
AROUND = {"cylinder": {**PIPE, "rows": "around"}, "spacing_m": 0.1, "stand_off_m": 0.1, "overscan_m": 0.04}
LINE = {"by": [0.5, 0, 0], "speed_m_s": SPEED}
PATHS: dict[str, dict[str, Any]] = {
    "line": {"legs": [LINE], **LEADS},
    "trapezoid": {"legs": [LINE], "speed_profile": {"kind": "trapezoidal"}, **LEADS},
    "corner": {"legs": [LINE, {"by": [0, 0.4, 0], "speed_m_s": SPEED}], "blend_radius_m": 0.05, **LEADS},
    "turning": {
        "legs": [{"to": {"xyz": [0.8, 0.2, 0.1], "rpy_deg": [0, 30, 9]}, "speed_m_s": SPEED}],
        **LEADS,
    },
    "arc": {
        "legs": [{"arc": {"via": [2, 1, -2], "to": [2, 1.2, -2], "turns": True}, "speed_m_s": SPEED}],
        **LEADS,
    },
    "waypoints": {"waypoints": WAVE, "speed_m_s": SPEED, **LEADS},
    "rows": {"raster": {**PATCH, "overscan_m": 0.04}, "speed_m_s": SPEED, "speed_tolerance": 0.05},
    "joined rows": {"raster": PATCH, "speed_m_s": SPEED, "blend_radius_m": 0.05, **LEADS},
    "pipe": {"raster": AROUND, "speed_m_s": SPEED, "speed_tolerance": 0.05},
    "joined pipe": {"raster": AROUND, "speed_m_s": SPEED, "blend_radius_m": 0.05, **LEADS},
    "backwards, twice": {"strokes": [{"legs": [LINE], "backwards": True, "passes": 2, **LEADS}]},
}
POSE = np.eye(4)
POSE[:3, 3] = 1.8, 0.7, -2.0


def scene_of(**tool_path: Any) -> Scene:
    many = {"via_points": 60}
    for stroke in tool_path.get("strokes", ()):
        stroke |= many
    own = tool_path if "strokes" in tool_path else many | tool_path
    return load_scene({**copy.deepcopy(SHORT), "tool_path": own})


def path_of(**tool_path: Any) -> ToolPath:
    (stroke,) = scene_of(**copy.deepcopy(tool_path)).timed_strokes(POSE)
    return stroke.path


@pytest.mark.parametrize("name", PATHS)
def test_the_process_has_its_speed(name: str) -> None:
    path = path_of(**PATHS[name])
    t = np.linspace(0, path.duration, 20_001)
    p, v = path.position(t), path.velocity(t)
    speed, asked = np.linalg.norm(v, axis=1), path.process_speed(t)
    np.testing.assert_allclose(np.gradient(p, t, axis=0)[2:-2], v[2:-2], rtol=0, atol=5e-4)
    np.testing.assert_allclose(speed[[0, -1]], 0.0, atol=1e-12)
    # Waypoints are passed at a speed that is only nearly even.
    even = 0.03 if name == "waypoints" else 1e-9
    np.testing.assert_allclose(speed[asked > 0], SPEED, rtol=even)
    np.testing.assert_allclose(path.process_parts[:, 2], SPEED, rtol=1e-9)
    assert (asked > 0).mean() > 0.5
    # Via-points are at the ends of leads, so that the process is whole segments.
    via = path.via_times(60)
    assert np.abs(via[:, None] - path.process_parts[:, :2].ravel()).min(axis=0).max() < 1e-9
    turned = np.linalg.norm(np.diff(np.broadcast_to(path.rotation(t), (len(t), 3, 3)), axis=0), axis=(1, 2))
    assert turned.max() < 1e-3


@pytest.mark.parametrize("name", PATHS)
def test_a_second_computation_agrees(name: str) -> None:
    scene = scene_of(**copy.deepcopy(PATHS[name]))
    second = ScenePath(scene, POSE[:3, 3], POSE[:3, :3])
    (stroke,) = scene.timed_strokes(POSE)
    t = np.linspace(0, stroke.path.duration, 1001)
    (p, R), poses = second.poses(t), stroke.path.poses(t)
    np.testing.assert_allclose(poses.point, p, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.broadcast_to(poses.rotation, R.shape), R, rtol=0, atol=1e-9)
    np.testing.assert_allclose(stroke.via_times, second.via_times(), rtol=1e-9)
    check_described(scene, stroke, POSE)
    inside = np.abs(t[:, None] - stroke.path.process_parts[:, :2].ravel()).min(axis=1) > 1e-6
    np.testing.assert_allclose(
        second.process_speeds(t)[inside], stroke.path.process_speed(t)[inside], rtol=1e-9
    )


@pytest.mark.parametrize("kind", ["trapezoidal", "jerk_limited", "quiet"])
def test_the_law_of_the_way_back(kind: Any) -> None:
    law, (begin, end), _ = law_with_leads(SpeedProfile(kind=kind, ramp=0.3), 0.1, 0.2, (0.0, 0.0))
    u = np.linspace(0, 1, 501)
    np.testing.assert_allclose(law.reversed().share(u), 1 - law.share(1 - u), rtol=0, atol=1e-14)
    np.testing.assert_allclose(law.share(np.array([begin, end])), [0.1, 0.8], atol=1e-14)
    np.testing.assert_allclose(law.share(law.time_share(u)), u, atol=1e-14)
    profile = SpeedProfile(kind=kind, ramp=0.3)
    same, _, whole = law_with_leads(profile, 0.0, 0.0, (0.3, 0.3))
    np.testing.assert_allclose(same.share(u), profile.law.share(u), rtol=0, atol=1e-14)
    assert whole == pytest.approx(1 / 0.7)


def test_with_one_lead_the_tool_slows_down_on_the_path() -> None:
    path = path_of(legs=[LINE], lead_in_m=0.05, speed_profile={"kind": "jerk_limited", "ramp": 0.25})
    # 0.5 m at 0.1 m/s with a ramp of a quarter of that time, and a second for the lead.
    assert path.duration == pytest.approx(1 + 5 / (1 - 0.125))
    np.testing.assert_allclose(path.corners[0], POSE[:3, 3] - [0.05, 0, 0])
    # Seconds are those of the path between two leads.
    path = path_of(legs=[{"by": [0.5, 0, 0], "seconds": 5}], lead_in_m=0.05, lead_out_m=0.1)
    assert path.duration == pytest.approx(8)


@pytest.mark.parametrize(
    ("tool_path", "words"),
    [
        ({"legs": [LINE, LINE], **LEADS}, "a path of 2 pieces, at whose ends the tool rests"),
        ({"legs": [LINE], "speed_tolerance": 0.1}, "lead_in_m: got nothing"),
        ({"raster": PATCH, "speed_m_s": 0.1, "speed_tolerance": 0.1}, "raster.overscan_m: got nothing"),
        ({"raster": PATCH, "speed_m_s": 0.1, "lead_in_m": 0.1}, "overscan_m is the lead of rows"),
        ({"legs": [{"pause": 1.0}], "lead_in_m": 0.1}, "a leg on which the tool point stays"),
        ({"legs": [LINE], "lead_in_m": 0}, "lead_in_m: got 0"),
    ],
)
def test_refusals(tool_path: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        path_of(**tool_path)
