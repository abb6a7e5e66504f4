"""Waypoints that repeat a place, nearly do, or turn the tool where it is."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small_scenes import short_scene
from timed_paths import check_path, scene_of

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, SceneError
from cmbot.planning import plan, precheck_scene, remarks, robot_of, strokes_of
from cmbot.scene import Scene
from cmbot.toolpath import ToolPath

DOWN = [0.0, 0, 1, 0]  # half a turn about y
WAY: dict[str, Any] = {"speed_m_s": 0.05, "via_points": 16}


def turned(*deg: float) -> list[float]:
    """The orientation `DOWN`, turned by Euler angles about the axes of the tool."""
    down = Rotation.from_quat(DOWN, scalar_first=True)
    return (down * Rotation.from_euler("xyz", deg, degrees=True)).as_quat(scalar_first=True).tolist()


def path_of(scene: Scene) -> ToolPath:
    return scene.timed_strokes(np.eye(4))[0].path


def way_of(rows: FloatArray | list[list[float]], **changes: Any) -> Scene:
    return scene_of(waypoints=np.asarray(rows).tolist(), **{"seconds": 4, **changes})


CLOSED = [[x, y, 0.1, *DOWN] for x, y in ((0, 0), (0.3, 0), (0.3, 0.2), (0, 0.3), (0, 0))]


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_what_repeats_a_place_changes_nothing(seed: int, exactly: bool, closed: bool) -> None:
    rng = np.random.default_rng(seed)
    rows = np.array(CLOSED if closed else [[0.1 * k, *rng.normal(0, 0.05, 2), *DOWN] for k in range(5)])
    times = rng.integers(1, 4, len(rows))
    again = np.repeat(rows, times, axis=0)
    first = np.concatenate([[0], np.cumsum(times)[:-1]])
    if not exactly:
        noise = rng.uniform(-5e-5, 5e-5, (len(again), 3)) / np.sqrt(3)
        noise[first] = 0
        again[:, :3] += noise
    alone, merged = way_of(rows), way_of(again)
    check_path(merged)
    one, other = path_of(alone), path_of(merged)
    assert other.lengths == pytest.approx(one.lengths, rel=1e-12)
    t = np.linspace(0, 4, 101)
    np.testing.assert_allclose(other.position(t), one.position(t), rtol=0, atol=1e-12)
    # What was given stays part of the scene.
    assert len(merged.strokes[0].waypoints or ()) == len(again)
    (stroke,) = merged.strokes
    assert stroke.merged == len(again) - len(rows)
    assert stroke.passed == alone.strokes[0].waypoints
    assert stroke.in_words.startswith("a spline through 5 waypoints")


def test_a_path_may_come_back_to_where_it_was() -> None:
    """Not to its neighbour: a closed path, one there and back, and one through the same place twice."""
    crossing = [[x, y, 0.1, *DOWN] for x, y in ((0, 0), (0.2, 0.2), (0.4, 0), (0.2, -0.2), (0, 0), (-0.2, 0))]
    for rows in (CLOSED, [CLOSED[0], CLOSED[1], CLOSED[0]], crossing):
        scene = way_of(rows)
        check_path(scene)
        assert scene.strokes[0].merged == 0
        assert np.isfinite(path_of(scene).position(np.linspace(0, 4, 101))).all()


def test_places_as_near_as_a_crawl_are_not_all_one() -> None:
    """Each is near to the one before; that they are merged does not shorten the way."""
    rows = [[4e-5 * k, 0, 0.1, *DOWN] for k in range(101)]
    scene = way_of(rows)
    assert 0 < scene.strokes[0].merged < 70
    assert float(path_of(scene).lengths.sum()) == pytest.approx(4e-3, abs=1e-4)


TURN = [*CLOSED[:2], [*CLOSED[1][:3], *turned(0, 20, 0)], [*CLOSED[2][:3], *turned(0, 20, 0)]]
ROLL = [*CLOSED[:2], [*CLOSED[1][:3], *turned(0, 0, 20)], [*CLOSED[2][:3], *turned(0, 0, 20)]]
CONE = {"axis_within_deg": 10}


@pytest.mark.parametrize(("rows", "keep"), [(TURN, "pose"), (TURN, "axis"), (TURN, CONE), (ROLL, "pose")])
def test_a_turn_in_place_is_refused(rows: list[list[float]], keep: Any) -> None:
    with pytest.raises(SceneError, match="got a turn by 20 deg at the place of the waypoint") as caught:
        way_of(rows, keep=keep)
    assert caught.value.key == "tool_path.waypoints[2]"
    assert "legs, of which one turns the tool where it is" in caught.value.expected


@pytest.mark.parametrize(("rows", "keep"), [(TURN, "position"), (ROLL, "axis"), (ROLL, CONE)])
def test_a_turn_that_is_not_prescribed_is_none(rows: list[list[float]], keep: Any) -> None:
    assert way_of(rows, keep=keep).strokes[0].merged == 1


def test_legs_turn_the_tool_where_it_is() -> None:
    """What the error about waypoints says to do."""
    scene = scene_of(
        legs=[
            {"by": [0.3, 0, 0], "seconds": 2},
            {"to": {"frame": "tool", "xyz": [0.3, 0, 0], "rpy_deg": [0, 20, 0]}, "seconds": 1},
            {"by": [0, 0.2, 0], "seconds": 2},
        ]
    )
    check_path(scene)
    path = path_of(scene)
    np.testing.assert_allclose(path.position([2.0]), path.position([3.0]), atol=1e-12)
    R = path.rotation([2.0, 3.0])
    angle = Rotation.from_matrix(R[0].T @ R[1]).magnitude()
    assert np.degrees(angle) == pytest.approx(20)


@pytest.mark.parametrize(
    ("rows", "got"),
    [
        ([CLOSED[0]] * 4, "4 waypoints at 1 place"),
        ([CLOSED[0], CLOSED[1], CLOSED[1]], "3 waypoints at 2 places"),
        ([CLOSED[0], CLOSED[0], CLOSED[1]], "3 waypoints at 2 places"),
    ],
)
def test_places_that_are_too_few(rows: list[list[float]], got: str) -> None:
    with pytest.raises(SceneError, match=f"tool_path.waypoints: got {got}, expected 3 places or more"):
        way_of(rows)
    scene = way_of(CLOSED)
    with pytest.raises(InputError, match=got):
        scene.with_path(waypoints=tuple(map(tuple, rows)))


def test_nothing_that_is_no_number() -> None:
    with pytest.raises(SceneError, match=r"waypoints\[1\]\[0\]: got nan, expected a finite number"):
        way_of([CLOSED[0], [np.nan, *CLOSED[1][1:]], CLOSED[2]])


def test_a_plan_says_how_many_were_merged() -> None:
    scene = short_scene()
    pose = strokes_of(scene, robot_of(scene))[0].path.poses([0.0])
    orientation = Rotation.from_matrix(pose.rotation.reshape(3, 3)).as_quat(scalar_first=True).tolist()
    steps = ([0, 0, 0], [0, 0, 0], [0, -0.05, 0], [0, -0.05, 3e-5], [0, -0.1, 0.02])
    rows = [[*(pose.point[0] + step).tolist(), *orientation] for step in steps]
    repeated = short_scene(tool_path={"legs": [], "waypoints": rows, **WAY})
    said = "2 waypoints are merged with the one before, less than 0.1 mm away."
    assert said in list(remarks(plan(repeated, progress=False)))
    found = dict(precheck_scene(repeated).found)
    assert found["tool path"].startswith("a spline through 3 waypoints (2 more at the place of the one")
