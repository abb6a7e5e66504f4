"""Paths that no branch of postures follows whole are cut, and the arm goes on from another posture."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cmbot.archive import load_plan, save
from cmbot.common.errors import ArchiveError, PathNotFound
from cmbot.planning import plan
from cmbot.scene import Scene, load_scene


def turning_scene(turn_deg: float, **keys: object) -> Scene:
    """A Panda whose tool turns about its axis along a line: its last joint turns by 332 degrees in all."""
    share = np.linspace(0.0, 1.0, 41)[:, None]
    points = np.array([0.5, -0.1, 0.5]) + share * [0.0, 0.2, 0.0]
    turns = Rotation.from_euler("z", turn_deg * share, degrees=True) * Rotation.from_euler("x", np.pi)
    path = {"waypoints": np.hstack([points, turns.as_quat(scalar_first=True)]).tolist(), "via_points": "auto"}
    return load_scene(
        {
            "format": "cmbot-scene/2",
            "name": "turning",
            "robot": {"model": "panda", "tool_frame": "panda_hand"},
            "guardrail": {"bays": 0},
            "start": {"posture": [0.0, 0.2, 0.0, -1.8, 0.0, 2.0, 0.8]},
            "tool_path": {
                "seconds": 40,
                "speed_profile": {"kind": "jerk_limited", "ramp": 0.3},
                **path,
                **keys,
            },
            "planner": {"objective": "travel", "baseline": "none"},
        }
    )


def test_a_path_is_cut_where_no_posture_leads_on(tmp_path: Path) -> None:
    asked = turning_scene(500.0)
    made = plan(asked)
    first, second = made.scene.strokes
    assert made.certificate.holds
    assert (first.part_of, second.part_of) == ("work", "work")
    assert (*first.waypoints, *second.waypoints[1:]) == asked.strokes[0].waypoints
    assert made.fallbacks[0].startswith(f"work is cut at waypoint {len(first.waypoints)} of 41:")
    # Each of its poses is kept, in one of the parts.
    for stroke, part in zip(made.scene.strokes, made.strokes, strict=True):
        ends = part.task.path.poses([0.0, part.task.path.duration])
        np.testing.assert_allclose(ends.point, np.array(stroke.waypoints)[[0, -1], :3], atol=1e-9)
    save(made, tmp_path)
    load_plan(tmp_path, verify=True, scene=asked)
    with pytest.raises(ArchiveError, match="strokes"):
        load_plan(tmp_path, verify=True, scene=turning_scene(500.0, reconfigurations=0))
    with pytest.raises(ArchiveError, match="waypoints"):
        load_plan(tmp_path, verify=True, scene=turning_scene(490.0))


def test_a_path_that_must_not_be_cut_is_refused() -> None:
    """The tool need not turn about its axis: that less of it is kept would do, and does."""
    keys = {"reconfigurations": 0, "seconds": "auto"}
    with pytest.raises(PathNotFound, match=r"; tool_path\.keep axis instead of pose would do$"):
        plan(turning_scene(500.0, **keys))
    assert plan(turning_scene(500.0, **keys, keep="axis")).certificate.holds


def test_parts_share_seconds_and_via_points() -> None:
    scene = turning_scene(300.0, via_points=50).with_cuts({"work": (10, 30)})
    assert [part.name for part in scene.strokes] == ["work_1", "work_2", "work_3"]
    np.testing.assert_allclose([part.seconds for part in scene.strokes], [10, 20, 10])
    assert [part.via_points for part in scene.strokes] == [12, 25, 12]
