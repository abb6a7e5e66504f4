"""Waypoints that repeat a place, nearly do, or turn the tool where it is."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation
from small_scenes import short_scene
from timed_paths import check_described, check_path, scene_of

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, SceneError
from cmbot.planning import plan, precheck_scene, remarks, robot_of, strokes_of
from cmbot.scene import Scene
from cmbot.toolpath import Line, Spline, ToolPath

DOWN = [0.0, 0, 1, 0]  # half a turn about y
WAY: dict[str, Any] = {"speed_m_s": 0.05, "via_points": 16}


def turned(*deg: float) -> list[float]:
    """The orientation `DOWN`, turned by Euler angles about the axes of the tool."""
    down = Rotation.from_quat(DOWN, scalar_first=True)
    return (down * Rotation.from_euler("xyz", deg, degrees=True)).as_quat(scalar_first=True).tolist()


def path_of(scene: Scene) -> ToolPath:
    return scene.timed_strokes(np.eye(4))[0].path


def way_of(rows: FloatArray | list[list[float]], **changes: Any) -> Scene:
    smooth = {"seconds": 4, "corner_deg": 180}
    scene = scene_of(waypoints=np.asarray(rows).tolist(), **{**smooth, **changes})
    return scene.with_options(max_tool_deviation_m=1e-3)


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
    assert stroke.in_words.startswith("a path through 5 waypoints")


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
def test_a_turn_in_place_is_a_leg(rows: list[list[float]], keep: Any) -> None:
    scene = way_of(rows, keep=keep, corner_deg=15)
    check_described(scene, scene.timed_strokes(np.eye(4))[0], np.eye(4))
    path = path_of(scene)
    assert len(path.seconds) == 3 and scene.strokes[0].merged == 0
    begin, end = path.leg_times[1:3]
    np.testing.assert_allclose(path.position([begin, end]), np.array(rows)[[1, 2], :3], atol=1e-12)
    R = path.rotation([begin, end])
    angle = np.degrees(Rotation.from_matrix(R[0].T @ R[1]).magnitude())
    assert angle == pytest.approx(20)
    np.testing.assert_allclose(path.velocity([begin, end]), 0, atol=1e-12)


@pytest.mark.parametrize(("rows", "keep"), [(TURN, "position"), (ROLL, "axis"), (ROLL, CONE)])
def test_a_turn_that_is_not_prescribed_is_none(rows: list[list[float]], keep: Any) -> None:
    assert way_of(rows, keep=keep).strokes[0].merged == 1


def test_legs_turn_the_tool_where_it_is() -> None:
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


@pytest.mark.parametrize("rows", [[CLOSED[0]] * 4, [CLOSED[0], [*CLOSED[0][:2], 0.10005, *DOWN]]])
def test_places_that_are_too_few(rows: list[list[float]]) -> None:
    got = f"{len(rows)} waypoints at one place"
    with pytest.raises(SceneError, match=f"tool_path.waypoints: got {got}, expected places 0.1 mm apart"):
        way_of(rows)
    scene = way_of(CLOSED)
    with pytest.raises(InputError, match=got):
        scene.with_path(waypoints=tuple(map(tuple, rows)))


def test_nothing_that_is_no_number() -> None:
    with pytest.raises(SceneError, match=r"waypoints\[1\]\[0\]: got nan, expected a finite number"):
        way_of([CLOSED[0], [np.nan, *CLOSED[1][1:]], CLOSED[2]])


def test_a_plan_says_how_many_were_merged_and_where_it_rests() -> None:
    scene = short_scene()
    pose = strokes_of(scene, robot_of(scene))[0].path.poses([0.0])
    orientation = Rotation.from_matrix(pose.rotation.reshape(3, 3)).as_quat(scalar_first=True).tolist()
    steps = ([0, 0, 0], [0, 0, 0], [0, -0.05, 0], [0, -0.05, 3e-5], [0, -0.1, 0.02])
    rows = [[*(pose.point[0] + step).tolist(), *orientation] for step in steps]
    repeated = short_scene(tool_path={"legs": [], "waypoints": rows, **WAY})
    said = "2 waypoints are merged with the one before, less than 0.1 mm away."
    assert said in list(remarks(plan(repeated, progress=False)))
    last = [*(pose.point[0] + [0, -0.1, 0.1]).tolist(), *orientation]
    square = [rows[0], rows[2], [*(pose.point[0] + [0, -0.1, 0]).tolist(), *orientation], last]
    cornered = short_scene(tool_path={"legs": [], "waypoints": square, "seconds": 8, "via_points": 16})
    told = list(remarks(plan(cornered, progress=False)))
    assert "It rests at 1 waypoint, corners and turns in place (corner_deg)." in told
    found = dict(precheck_scene(repeated).found)
    assert found["tool path"].startswith("a path through 3 waypoints (2 more at the place of the one")


# Corners


def rounded_square(rng: np.random.Generator, noise: float) -> FloatArray:
    """A square of dense waypoints, each off by `noise` at most."""
    corners = np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3], [0, 0]])
    steps = np.linspace(0, 1, 41)[:-1, None]
    sides = [a + steps * (b - a) for a, b in pairwise(corners)]
    xy = np.concatenate([*sides, corners[-1:]])
    xy[1:-1] += rng.uniform(-noise, noise, xy[1:-1].shape) / np.sqrt(2)
    rows = np.tile([0.0, 0, 0.1, *DOWN], (len(xy), 1))
    rows[:, :2] = xy
    return rows


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_corners_of_dense_waypoints_are_rested_at(noise: float, rng: np.random.Generator) -> None:
    """Noise below a quarter of the tolerance, 1 mm, makes none; sides are lines."""
    rows = rounded_square(rng, noise)
    path = path_of(way_of(rows, corner_deg=15))
    assert [type(segment.curve) for segment in path.segments] == [Line] * 4
    np.testing.assert_allclose(path.corners, rows[[0, 40, 80, 120, 160], :3], atol=1e-12)
    np.testing.assert_allclose(path.velocity(path.leg_times), 0, atol=1e-9)
    t = np.linspace(0, path.duration, 4001)
    away = np.linalg.norm(path.position(t)[:, None] - rows[None, :, :3], axis=2).min(axis=0)
    assert away.max() < 0.25e-3


def test_what_bends_evenly_is_no_corner() -> None:
    """A circle of 12 waypoints bends by 30 degrees at each; with one that is moved it has corners."""
    angle = np.radians(np.arange(0, 361, 30))
    rows = np.tile([0.0, 0, 0.1, *DOWN], (len(angle), 1))
    rows[:, 0], rows[:, 1] = 0.2 * np.cos(angle), 0.2 * np.sin(angle)
    (segment,) = path_of(way_of(rows, corner_deg=15)).segments
    assert isinstance(segment.curve, Spline) and len(segment.curve.points) == len(rows)
    rows[6, :2] *= 0.2
    assert len(path_of(way_of(rows, corner_deg=15)).seconds) > 1


@pytest.mark.parametrize(("radius", "legs"), [(0.007, 2), (0.012, 1), (0.1, 1)])
def test_in_the_shortest_time_a_tight_bend_is_rested_in(radius: float, legs: int) -> None:
    """Half a turn between two straight ways; where seconds are given the tool goes on, as round circles."""
    angle = np.linspace(0.0, np.pi, 16)
    bend = radius * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)
    x = np.linspace(-0.3, 0.0, 61)[:-1, None] * [1.0, 0.0]
    xy = np.concatenate([x, bend, x[::-1] + np.array([0.0, 2 * radius])])
    rows = np.tile([0.0, 0, 0.1, *DOWN], (len(xy), 1))
    rows[:, :2] = xy
    auto = path_of(way_of(rows, corner_deg=15, seconds="auto"))
    assert len(auto.segments) == legs
    if legs == 2:
        assert auto.corners[1, 0] > 0.9 * radius
    assert len(path_of(way_of(rows, corner_deg=15, seconds=8)).segments) == 1
    round_ = np.tile([0.0, 0, 0.1, *DOWN], (61, 1))
    turn = np.linspace(0.0, 2 * np.pi, 61)
    round_[:, 0], round_[:, 1] = radius * np.cos(turn), radius * np.sin(turn)
    assert len(path_of(way_of(round_, corner_deg=15, seconds="auto")).segments) == 1


def test_corners_between_lines_are_blended(rng: np.random.Generator) -> None:
    scene = way_of(rounded_square(rng, 0.0), corner_deg=15, blend_radius_m=0.03)
    path = path_of(scene)
    assert len(path.seconds) == 1
    assert float(path.lengths[0]) == pytest.approx(1.2 - 3 * (2 - np.pi / 2) * 0.03, rel=1e-6)


def test_of_dense_waypoints_on_a_curve_some_are_passed_and_all_are_near(rng: np.random.Generator) -> None:
    u = np.linspace(0, 1, 400)
    rows = np.tile([0.0, 0, 0.1, *DOWN], (len(u), 1))
    rows[:, 0], rows[:, 1] = u, 0.1 * np.sin(2 * np.pi * u)
    rows[1:-1, :3] += rng.uniform(-1e-4, 1e-4, (398, 3))
    scene = way_of(rows, corner_deg=15)
    path = path_of(scene)
    (segment,) = path.segments
    assert isinstance(segment.curve, Spline) and len(segment.curve.points) < 60
    points = path.position(np.linspace(0, path.duration, 40_001))
    for row in rows[::7]:
        assert np.linalg.norm(points - row[:3], axis=1).min() < 0.26e-3
    check_described(scene, scene.timed_strokes(np.eye(4))[0], np.eye(4))


@pytest.mark.parametrize(("deviation", "legs"), [(7e-5, 24), (3e-3, 1)])
def test_a_polygon_that_no_spline_keeps_is_rested_at_its_vertices(deviation: float, legs: int) -> None:
    """Sides of 6 waypoints that bend by 7.5 degrees, as TORM's circle: its arc is 0.5 mm away."""
    angle = np.radians(7.5 * np.arange(25))
    vertices = 0.25 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    steps = np.linspace(0, 1, 7)[:-1, None]
    xy = np.concatenate([*(a + steps * (b - a) for a, b in pairwise(vertices)), vertices[-1:]])
    rows = np.tile([0.0, 0, 0.1, *DOWN], (len(xy), 1))
    rows[:, :2] = xy.round(6)
    scene = way_of(rows, corner_deg=15)
    path = path_of(scene.with_options(max_tool_deviation_m=deviation))
    assert len(path.segments) == legs
    points = path.position(np.linspace(0, path.duration, 40_001))
    for row in rows:
        assert np.linalg.norm(points - row[:3], axis=1).min() < 0.26 * deviation
    if legs > 1:
        np.testing.assert_allclose(path.corners[:, :2], vertices, rtol=0, atol=1e-6)


def test_turns_in_place_to_and_fro_about_two_axes() -> None:
    """As TORM's `rot_yz`: fixed axes one after the other, each as one leg."""
    angles = np.concatenate(
        [np.linspace(0, 45, 10), np.linspace(45, -45, 19)[1:], np.linspace(-45, 0, 10)[1:]]
    )
    turns = [(0, angle, 0) for angle in angles] + [(0, 0, angle) for angle in angles[1:]]
    rows = [[0.1, 0.2, 0.3, *turned(*turn)] for turn in turns]
    path = path_of(way_of(rows, corner_deg=15))
    assert len(path.seconds) == 6
    sizes = np.degrees([np.linalg.norm(segment.turn) for segment in path.segments])
    np.testing.assert_allclose(sizes, [45, 90, 45, 45, 90, 45], atol=1e-6)
    np.testing.assert_allclose(path.seconds / path.seconds.sum(), np.array(sizes) / 360, atol=1e-9)
