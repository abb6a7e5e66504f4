"""A path that is cut: its parts lead along the same way, as fast, with as many via-points."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation
from small_scenes import panda_scene

from cmbot.scene import Scene, Stroke
from cmbot.toolpath import ToolPath

START = np.eye(4)
START[:3, 3] = 0.3, -0.2, 0.5
LEGS = [
    {"by": [0.0, 0.3, 0.1], "seconds": 6.0},
    {"to": {"xyz": [0.5, 0.2, 0.5], "rpy_deg": [20.0, -50.0, 130.0]}, "speed_m_s": 0.05},
    {"arc": {"centre": [0.5, 0.1, 0.5], "axis": [1, 0, 0], "angle_deg": -120, "turns": True}, "seconds": 5.0},
    {"to": {"xyz": [0.4, 0.0, 0.4], "axis": [0.0, 0.6, 0.8]}, "seconds": 4.0},
    {"pause": 1.0},
    {"arc": {"via": [0.5, 0.1, 0.4], "to": [0.4, 0.2, 0.4]}, "seconds": 3.0},
]


def scene_of(**path: Any) -> Scene:
    given = {"legs": LEGS, "via_points": 60, "speed_profile": {"kind": "trapezoidal", "ramp": 0.2}} | path
    return panda_scene(given)


def way(stroke: Stroke) -> Any:
    """Where the tool is along each leg: places and orientations at even shares of its length."""
    shares = np.linspace(0.0, 1.0, 9)
    times = [stroke.path.times_at(leg, shares) for leg in range(len(stroke.path.segments))]
    return [(stroke.path.position(each), stroke.path.rotation(each)) for each in times]


def fastest(path: ToolPath, leg: int) -> tuple[float, float]:
    """Largest speed, m/s, and acceleration, m/s^2, of the tool along a leg."""
    times, middles = np.linspace(*path.leg_times[leg : leg + 2], 402), slice(1, -1)
    speed = np.linalg.norm(path.velocity(times[middles]), axis=1)
    return float(speed.max()), float(np.abs(np.diff(speed)).max() / (times[1] - times[0]))


@settings(max_examples=30)
@given(st.lists(st.floats(0.01, 3.99).map(lambda at: round(at, 3)), min_size=1, max_size=4, unique=True))
def test_parts_are_the_way_of_the_whole(ends: list[float]) -> None:
    scene = scene_of()
    (whole,) = scene.timed_strokes(START)
    cuts = sorted(ends)
    parts = scene.with_cuts({"work": cuts}, START).timed_strokes(START)
    assert [part.file.begins_at for part in parts] == [0.0, *cuts]
    seconds = np.zeros(len(LEGS))
    for part, begin, end in zip(parts, [0.0, *cuts], [*cuts, len(LEGS)], strict=True):
        first = int(begin)
        for k, (points, R) in enumerate(way(part)):
            low, high = max(begin, first + k) - first - k, min(end - first - k, 1.0)
            at = whole.path.times_at(first + k, np.linspace(low, high, 9))
            np.testing.assert_allclose(points, whole.path.position(at), rtol=0, atol=1e-7)
            angle = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ whole.path.rotation(at)).magnitude()
            assert np.max(angle) < 1e-6
            # As fast where a speed is given; in seconds no faster and no more suddenly.
            rates = [fastest(each, j) for each, j in ((part.path, k), (whole.path, first + k))]
            if first + k == 1:
                assert rates[0][0] == pytest.approx(rates[1][0], rel=1e-6)
            else:
                assert (np.array(rates[0]) <= np.array(rates[1]) * (1 + 1e-6) + 1e-9).all()
            seconds[first + k] += part.path.seconds[k]
    assert (seconds >= whole.path.seconds - 1e-9).all()


@pytest.mark.parametrize(
    ("path", "behind", "can"),
    [
        ({}, 1.0, True),
        ({}, 0.5, True),
        ({}, 2.5, True),
        ({}, 4.5, False),  # a pause
        ({}, 5.5, False),  # an arc through two points
        ({}, 5.0, True),
        ({}, 0.0, False),
        ({}, 6.0, False),
        ({"passes": 2}, 1.0, False),
        ({"legs": LEGS[:2], "lead_in_m": 0.05}, 1.0, False),
        ({"legs": [LEGS[0], LEGS[0]], "blend_radius_m": 0.01}, 1.0, False),
        ({"legs": [LEGS[0], {"to": {"xyz": [0, 0, 0.1], "frame": "tool"}, "seconds": 3.0}]}, 1.0, False),
        ({"legs": [], "waypoints": [[0.1 * k, 0, 0, 1, 0, 0, 0] for k in range(4)], "seconds": 5}, 2.0, True),
        (
            {"legs": [], "waypoints": [[0.1 * k, 0, 0, 1, 0, 0, 0] for k in range(4)], "seconds": 5},
            1.5,
            False,
        ),
    ],
)
def test_where_a_path_can_be_cut(path: dict[str, Any], behind: float, can: bool) -> None:
    (file,) = scene_of(**path).strokes
    assert file.can_be_cut(behind) == can
