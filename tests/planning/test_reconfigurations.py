"""Paths that no branch of postures follows whole are cut, and the arm goes on from another posture."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import panda_scene, request_of

import cmbot
from cmbot.archive import Asked, load_plan, save, verified_motions
from cmbot.common.errors import ArchiveError, PathNotFound
from cmbot.planning import build_request, plan, with_cuts
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.attempts.failure import NoWay
from cmbot.planning.attempts.reconfigurations import Reconfigurations
from cmbot.scene import Scene, load_scene


def turning_scene(turn_deg: float, **keys: object) -> Scene:
    """A Panda whose tool turns about its axis along a line: its last joint turns by 332 degrees in all."""
    share = np.linspace(0.0, 1.0, 41)[:, None]
    points = np.array([0.5, -0.1, 0.5]) + share * [0.0, 0.2, 0.0]
    turns = Rotation.from_euler("z", turn_deg * share, degrees=True) * Rotation.from_euler("x", np.pi)
    poses = np.hstack([points, turns.as_quat(scalar_first=True)]).tolist()
    return followed(**({"seconds": 40, "waypoints": poses} | keys))


def turning_legs(turn_deg: float, legs: int = 3, **keys: object) -> Scene:
    """The same turn on legs."""
    ends = [
        {"xyz": [0.5, -0.1 + 0.2 * k / legs, 0.5], "rpy_deg": [180.0, 0.0, turn_deg * k / legs - 180.0]}
        for k in range(legs + 1)
    ]
    timed = [{"to": end, "seconds": 40 / legs} for end in ends[1:]]
    return followed(legs=timed, **{"from": ends[0]}, **keys)


def followed(**keys: object) -> Scene:
    """A Panda that follows a path, of which `keys` are more."""
    law = {"speed_profile": {"kind": "jerk_limited", "ramp": 0.3}, "via_points": "auto"}
    return panda_scene(law | keys, planner={"objective": "travel", "baseline": "none"})


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
    told = verified_motions(tmp_path, Asked(scenes=(asked,))).not_verified
    assert any("that it has to be done in 2 parts, cut and ordered like this" in claim for claim in told)
    # A scene that is planned near it is cut there, too.
    heavier = asked.with_payload(asked.robot.payload_kg + 0.2)
    again = cmbot.replan(made, heavier, progress=False)
    assert again.scene.strokes == made.scene.strokes and again.fallbacks[0].startswith("Planned near")
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


def test_legs_are_cut_where_no_posture_leads_on(tmp_path: Path) -> None:
    asked = turning_legs(500.0)
    made = plan(asked)
    first, second = made.scene.strokes
    assert made.certificate.holds
    assert (first.part_of, second.part_of, first.begins_at) == ("work", "work", 0.0)
    assert re.match(r"work is cut at \d+% of legs\[2\]: no posture was found", made.fallbacks[0])
    # The joint turns nearly as far as it can before the arm goes on from another posture.
    turned = np.ptp(made.job.strokes[0].trajectory.q[:, 6])
    assert np.degrees(turned) > 0.9 * 332
    # All poses of the path are kept, in one of the parts.
    whole = request_of(asked).stroke.path
    for stroke, part, begin in zip(made.scene.strokes, made.strokes, (0.0, second.begins_at), strict=True):
        path, share = part.task.path, begin % 1
        assert len(path.segments) == len(stroke.legs)
        at = whole.times_at(int(begin), np.array([share]))
        np.testing.assert_allclose(path.position([0.0]), whole.position(at), atol=1e-9)
        np.testing.assert_allclose(path.rotation([0.0]), whole.rotation(at), atol=1e-9)
    np.testing.assert_allclose(made.strokes[1].task.path.end_pose, whole.end_pose, atol=1e-9)
    save(made, tmp_path)
    load_plan(tmp_path, verify=True, scene=asked)
    for other in (turning_legs(500.0, reconfigurations=0), turning_legs(490.0)):
        with pytest.raises(ArchiveError, match="strokes"):
            load_plan(tmp_path, verify=True, scene=other)


def test_a_blocked_place_is_told_and_nothing_is_cut() -> None:
    """No other posture is clear of what is in the way of the tool itself."""
    ball = {"name": "ball", "sphere": 0.05, "xyz": [0.5, 0.1, 0.5]}
    scene = turning_legs(60.0)
    with pytest.raises(PathNotFound, match=r"is blocked at .* ball") as caught:
        plan(load_scene(scene.as_data() | {"obstacles": [ball]}))
    assert "work_" not in str(caught.value)


@pytest.mark.parametrize(
    ("cut", "part", "within"), [(0.7, 0, (0.0, 0.7)), (1.6, 0, (0.0, 1.6)), (0.7, 1, (0.7, 3))]
)
def test_a_part_is_cut_within_itself(cut: float, part: int, within: tuple[float, float]) -> None:
    """Where the tool was then: else cuts of a part within a leg lead to each other without an end."""
    asked = turning_legs(100.0)
    cuts = Reconfigurations(asked)
    cuts.ends["work"] = (cut,)
    robot = request_of(asked).cell.robot
    request = build_request(with_cuts(asked, robot, cuts.ends), asked.planner).at_stroke(part)
    whole = request_of(asked).stroke.path
    for time in request.times[2:-1]:
        cuts.ends["work"] = (cut,)
        failure = NoWay(error=request.path_not_found("none", request.first, time))
        assert cuts.cut(Attempt(request=request, guess=failure), failure)
        end = cuts.ends["work"][-1]
        assert within[0] < end < within[1]
        before = request.times[np.searchsorted(request.times, time - 1e-9) - 1]
        there = whole.position(whole.times_at(int(end), np.array([end % 1])))
        np.testing.assert_allclose(there, request.task.path.position([before]), rtol=0, atol=1e-4)


def test_parts_that_were_asked_are_not_cut() -> None:
    """As those of a raster, of which the arm reaches some rows: the whole is not among the strokes."""
    whole = turning_legs(100.0)
    asked = with_cuts(whole, request_of(whole).cell.robot, {"work": (1.6,)})
    request, cuts = build_request(asked, asked.planner).at_stroke(1), Reconfigurations(asked)
    failure = NoWay(error=request.path_not_found("none", request.first, request.times[5]))
    assert not cuts.cut(Attempt(request=request, guess=failure), failure)
    assert not cuts.ends


def test_parts_share_seconds_and_via_points() -> None:
    asked = turning_scene(300.0, via_points=50)
    scene = with_cuts(asked, request_of(asked).cell.robot, {"work": (10, 30)})
    assert [part.name for part in scene.strokes] == ["work_1", "work_2", "work_3"]
    np.testing.assert_allclose([part.seconds for part in scene.strokes], [10, 20, 10])
    assert [part.via_points for part in scene.strokes] == [12, 25, 12]
