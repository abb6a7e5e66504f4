"""Legs, poses and waypoints of scene files: against a second computation, and their refusals."""

import copy
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation
from timed_paths import SECOND, WHERE, check_path, scene_of, vectors

from cmbot import load_scene
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, SceneError
from cmbot.toolpath import ArcTo, Goal, Leg, Segment, SpeedProfile, ToolPath
from cmbot.toolpath.curves import Spline


def unit(v: list[float]) -> list[float]:
    return (np.array(v) / np.linalg.norm(v)).tolist()


frames = st.sampled_from(["world", "tool", "bracket"])
durations = st.one_of(
    st.fixed_dictionaries({"seconds": st.floats(0.5, 5)}),
    st.fixed_dictionaries({"speed_m_s": st.floats(0.05, 0.5)}),
)
turns = st.one_of(
    st.just({}),
    st.fixed_dictionaries({"rpy_deg": vectors(180.0)}),
    st.fixed_dictionaries({"axis": vectors().map(unit)}),
)
goals = st.builds(lambda xyz, frame, turn: {"xyz": xyz, "frame": frame, **turn}, vectors(), frames, turns)
arcs = st.one_of(
    st.fixed_dictionaries({"via": vectors(), "to": vectors(), "turns": st.booleans(), "frame": frames}),
    st.fixed_dictionaries(
        {
            "centre": vectors(),
            "axis": vectors().map(unit),
            "angle_deg": st.floats(5, 350),
            "turns": st.booleans(),
            "frame": frames,
        }
    ),
)
legs = st.one_of(
    st.builds(lambda by, time: {"by": by, **time}, vectors(), durations),
    st.builds(lambda goal, time: {"to": goal, **time}, goals, durations),
    st.builds(lambda arc, time: {"arc": arc, **time}, arcs, durations),
    st.builds(lambda seconds: {"pause": seconds}, st.floats(0.1, 3)),
)
profiles = st.fixed_dictionaries(
    {"kind": st.sampled_from(["trapezoidal", "jerk_limited", "quiet"]), "ramp": st.floats(0.05, 0.5)}
)


@settings(max_examples=60)
@given(
    st.lists(legs, min_size=1, max_size=5),
    st.one_of(st.none(), goals),
    st.one_of(st.none(), st.floats(0.01, 0.3)),
    profiles,
)
def test_timed_poses_are_those_of_a_second_computation(
    each: list[dict[str, Any]], begin: dict[str, Any] | None, radius: float | None, profile: dict[str, Any]
) -> None:
    more: dict[str, Any] = {} if begin is None else {"from": begin}
    more |= {} if radius is None else {"blend_radius_m": radius}
    try:
        check_path(scene_of(legs=each, speed_profile=profile, **more))
    except SceneError as refused:
        assert "three points on a line" in refused.got or "no length" in refused.expected


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0.6, -0.8]])
def test_half_a_turn_of_the_axis_goes_the_same_way_in_a_second_computation(axis: list[float]) -> None:
    there = {"xyz": [0, 0, 0], "frame": "world", "axis": axis}
    back = {"xyz": [0, 0, 1], "frame": "world", "axis": [-each for each in axis]}
    check_path(scene_of(legs=[{"to": back, "seconds": 2}], **{"from": there}))


@settings(max_examples=20)
@given(
    legs,
    goals,
    st.sampled_from([{"lead_in_m": 0.07}, {"lead_out_m": 0.05}, {"lead_in_m": 0.04, "lead_out_m": 0.1}]),
    profiles,
    st.integers(1, 2),
)
def test_leads_are_those_of_a_second_computation(
    leg: dict[str, Any], begin: dict[str, Any], leads: dict[str, Any], profile: dict[str, Any], passes: int
) -> None:
    try:
        check_path(scene_of(legs=[leg], speed_profile=profile, passes=passes, **{"from": begin}, **leads))
    except SceneError as refused:
        assert (
            "three points on a line" in refused.got
            or "length" in refused.expected
            or "moves" in refused.expected
        )


strokes = st.fixed_dictionaries(
    {
        "legs": st.lists(legs, min_size=1, max_size=3),
        "backwards": st.booleans(),
        "passes": st.integers(1, 3),
        "speed_profile": profiles,
        "via_points": st.just(60),
    }
)


@settings(max_examples=30)
@given(st.lists(strokes, min_size=1, max_size=3), goals, st.floats(0.01, 0.3))
def test_strokes_follow_on_each_other_backwards_and_in_passes(
    each: list[dict[str, Any]], begin: dict[str, Any], radius: float
) -> None:
    each[0] = {"from": begin, "blend_radius_m": radius, **each[0]}
    data: dict[str, Any] = {**copy.deepcopy(SECOND), "tool_path": {"strokes": each}}
    try:
        scene = load_scene(data)
        check_path(scene)
    except SceneError as refused:
        assert "three points on a line" in refused.got or "no length" in refused.expected
        return
    timed = scene.timed_strokes(np.eye(4))
    assert [stroke.name for stroke in timed] == [f"stroke_{k + 1}" for k in range(len(each))]
    for before, after in pairwise(timed):
        # Without a start of its own a path begins where the one before ended: a stroke that is followed
        # backwards is there after its first pass.
        at = after.path.duration / (after.file.passes or 1) if after.file.backwards else 0.0
        np.testing.assert_allclose(after.path.position([at])[0], before.path.end_pose[:3, 3], atol=1e-9)


def test_a_path_back_is_the_path_in_reverse() -> None:
    data: dict[str, Any] = copy.deepcopy(SECOND)
    arc = {"arc": {"centre": [1.8, 0.9, -2], "axis": [1, 0, 0], "angle_deg": 70, "turns": True}, "seconds": 3}
    line = {"by": [0, 0.2, 0.1], "seconds": 2}
    data["tool_path"] = {"strokes": [{"legs": [arc, line]}, {"legs": [arc, line], "passes": 2}]}
    X_WT = np.eye(4)
    X_WT[:3, 3] = WHERE
    once, twice = (stroke.path for stroke in load_scene(data).timed_strokes(X_WT))
    t = np.linspace(0, once.duration, 200)
    forth, back = once.poses(t), once.reversed().poses(once.duration - t)
    np.testing.assert_allclose(back.point, forth.point, atol=1e-12)
    np.testing.assert_allclose(back.rotation, forth.rotation, atol=1e-12)
    assert twice.duration == pytest.approx(2 * once.duration)
    np.testing.assert_allclose(twice.end_pose, once.end_pose, atol=1e-12)


def waypoint_rows(rng: np.random.Generator, number: int = 7) -> FloatArray:
    points = np.cumsum(0.03 * rng.normal(size=(number, 3)) + [0.1, 0, 0], axis=0)
    quaternions = Rotation.from_rotvec(np.cumsum(0.2 * rng.normal(size=(number, 3)), axis=0)).as_quat()
    return np.hstack([points, quaternions[:, [3, 0, 1, 2]]])


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), durations, profiles)
def test_waypoints_are_passed(seed: int, time: dict[str, float], profile: dict[str, Any]) -> None:
    rows = waypoint_rows(np.random.default_rng(seed))
    scene = scene_of(waypoints=rows.tolist(), speed_profile=profile, corner_deg=180, **time)
    check_path(scene)
    path = scene.timed_strokes(np.eye(4))[0].path
    times = np.linspace(0, path.duration, 20_001)
    points = path.position(times)
    for row in rows:
        assert np.linalg.norm(points - row[:3], axis=1).min() < 1e-4
    ends = path.poses([0.0, path.duration]).rotation
    np.testing.assert_allclose(
        ends, Rotation.from_quat(rows[[0, -1]][:, [4, 5, 6, 3]]).as_matrix(), atol=1e-9
    )


@settings(max_examples=20)
@given(vectors(), vectors(), st.floats(0.05, 0.5), st.floats(0, 0.3), frames, durations, st.booleans())
def test_rasters_cover_their_rectangle(
    u: list[float],
    v: list[float],
    spacing: float,
    stand_off: float,
    frame: str,
    time: dict[str, float],
    blended: bool,
) -> None:
    across = np.cross(u, v)
    if np.linalg.norm(across) < 0.05:
        return
    v = np.cross(across, u).tolist()
    v = (np.array(v) / np.linalg.norm(v) * 0.7).tolist()
    raster = {"origin": [0.1, 0.2, 0.3], "u": u, "v": v, "spacing_m": spacing, "stand_off_m": stand_off}
    raster |= {"overscan_m": 0.02, "frame": frame}
    scene = scene_of(raster=raster, **time, **({"blend_radius_m": 0.02} if blended else {}))
    check_path(scene)
    path = scene.timed_strokes(np.eye(4))[0].path
    if blended:
        assert len(path.seconds) == 1
        return
    X = {"world": np.eye(4), "tool": np.eye(4), "bracket": scene.frame_poses["bracket"]}[frame]
    corner = X[:3, :3] @ [0.1, 0.2, 0.3] + X[:3, 3]
    e_u, e_v = (X[:3, :3] @ np.array(x) / np.linalg.norm(x) for x in (u, v))
    out = np.cross(e_u, e_v)
    p = path.corners - corner
    np.testing.assert_allclose(p @ out, stand_off, atol=1e-9)
    np.testing.assert_allclose(path.orientation[:, 2], -out, atol=1e-9)
    along, rows = p @ e_u, np.unique(np.round(p @ e_v, 9))
    np.testing.assert_allclose([along.min(), along.max()], [-0.02, np.linalg.norm(u) + 0.02], atol=1e-9)
    np.testing.assert_allclose([rows[0], rows[-1]], [0, 0.7], atol=1e-8)
    assert np.diff(rows).max() <= spacing + 1e-6
    assert len(rows) == scene.strokes[0].raster.rows


pipes = st.fixed_dictionaries(
    {
        "centre": vectors(),
        "axis": st.one_of(st.just([0, 0, 1]), st.just([0, 1, 0]), vectors().map(unit)),
        "radius": st.floats(0.05, 0.5),
        "from_deg": st.floats(-170, 170).map(round),
        "to_deg": st.floats(-170, 170).map(lambda x: round(x) + 0.5),
        "length": st.floats(0.1, 1),
        "rows": st.sampled_from(["along", "around"]),
    }
)


@settings(max_examples=12)
@given(pipes, st.floats(0.05, 0.5), st.floats(0, 0.3), frames, durations, st.booleans())
def test_rasters_cover_their_cylinder(
    pipe: dict[str, Any], spacing: float, stand_off: float, frame: str, time: dict[str, float], blended: bool
) -> None:
    raster = {"cylinder": pipe, "spacing_m": spacing, "stand_off_m": stand_off, "overscan_m": 0.02}
    more = {"blend_radius_m": 0.02} if blended else {}
    scene = scene_of(raster={**raster, "frame": frame}, **time, **more)
    check_path(scene)
    path = scene.timed_strokes(np.eye(4))[0].path
    assert (len(path.seconds) == 1) == (blended or scene.strokes[0].raster.rows == 1)
    X = {"world": np.eye(4), "tool": np.eye(4), "bracket": scene.frame_poses["bracket"]}[frame]
    axis, outer = np.array(pipe["axis"]) / np.linalg.norm(pipe["axis"]), pipe["radius"] + stand_off
    fine = path.poses(np.unique(np.concatenate([path.leg_times, np.linspace(0, path.duration, 2001)])))
    p = (fine.point - X[:3, 3]) @ X[:3, :3] - pipe["centre"]
    z = p @ axis
    across = p - z[:, None] * axis
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), outer, atol=1e-9)
    np.testing.assert_allclose(fine.rotation[:, :, 2] @ X[:3, :3], -across / outer, atol=1e-9)
    # The tool turns about the cylinder's axis alone, which keeps its place in the tool.
    along = np.einsum("nji,j->ni", fine.rotation, X[:3, :3] @ axis)
    np.testing.assert_allclose(along, np.tile(along[0], (len(along), 1)), atol=1e-9)
    beyond = (0.02, 0.0) if pipe["rows"] == "along" else (0.0, 0.02)
    np.testing.assert_allclose([z.min(), z.max()], [-0.5 * pipe["length"] - beyond[0], -z.min()], atol=1e-9)
    zero = np.eye(3)[0 if np.degrees(np.arccos(min(abs(axis[2]), 1.0))) < 10 else 2]
    zero = zero - (zero @ axis) * axis
    angle = np.unwrap(np.arctan2(across @ np.cross(axis, zero), across @ zero))
    angle += 2 * np.pi * np.round((np.radians(pipe["from_deg"]) - angle[0]) / (2 * np.pi))
    ends = np.sort(np.radians([pipe["from_deg"], pipe["to_deg"]]))
    ends += np.array([-1, 1]) * beyond[1] / pipe["radius"]
    np.testing.assert_allclose([angle.min(), angle.max()], ends, atol=1e-9)
    if not blended:
        corners = (path.corners - X[:3, 3]) @ X[:3, :3] - pipe["centre"]
        if pipe["rows"] == "around":
            steps = np.abs(np.diff(corners @ axis)[1::2])
        else:
            steps = np.linalg.norm([segment.turn for segment in path.segments[1::2]], axis=1) * pipe["radius"]
        assert steps.max(initial=0.0) <= spacing + 1e-6


@pytest.mark.parametrize("more", [{}, {"blend_radius_m": 0.02}])
@pytest.mark.parametrize("rows", ["along", "around"])
def test_a_pipe_is_worked_on_to_and_fro(rows: str, more: dict[str, Any]) -> None:
    raster = {**PIPE, "cylinder": {**PIPE["cylinder"], "rows": rows}}
    scene = scene_of(raster=raster, speed_m_s=0.1, passes=2, **more)
    check_path(scene)
    path = scene.timed_strokes(np.eye(4))[0].path
    np.testing.assert_allclose(path.end_pose[:3, 3], path.corners[0], atol=1e-9)
    np.testing.assert_allclose(path.end_pose[:3, :3], path.orientation, atol=1e-9)


@pytest.mark.parametrize("more", [{}, {"blend_radius_m": 0.02}])
@pytest.mark.parametrize("frame", ["world", "bracket"])
@pytest.mark.parametrize("surface", ["rectangle", "along", "around"])
def test_a_tool_that_leans_points_at_its_rows(surface: str, frame: str, more: dict[str, Any]) -> None:
    cylinder = {**CYLINDER, "from_deg": 150, "to_deg": 90, "rows": surface}
    raster = {**(RASTER if surface == "rectangle" else PIPE | {"cylinder": cylinder}), "frame": frame}
    square = scene_of(raster={**raster, "stand_off_m": 0.0}, speed_m_s=0.1)
    scene = scene_of(raster={**raster, "lean_deg": [10, -25]}, speed_m_s=0.1, **more)
    check_path(scene)
    if more:
        return
    rows, path = (each.timed_strokes(np.eye(4))[0].path for each in (square, scene))
    ahead, normals = (
        path.poses(path.leg_times).rotation[:, :, 2],
        -rows.poses(rows.leg_times).rotation[:, :, 2],
    )
    # The point of the axis 0.1 m ahead of the tool is where a tool on the surface would be.
    np.testing.assert_allclose(path.corners + 0.1 * ahead, rows.corners, atol=1e-9)
    # In a short while from where a row begins, and from there to where the next one ends.
    ways = rows.position(np.array([0.01, 1.0]))[0] - rows.corners[0], rows.corners[3] - rows.corners[0]
    for way, angle in zip(ways, (10, -25), strict=True):
        way -= (way @ normals[0]) * normals[0]
        leaning = np.arctan2(-ahead[0] @ way / np.linalg.norm(way), -ahead[0] @ normals[0])
        assert np.degrees(leaning) == pytest.approx(angle, abs=1e-3)
    # It is as askew to the surface everywhere.
    np.testing.assert_allclose((ahead * normals).sum(axis=1), (ahead[0] @ normals[0]), atol=1e-9)


def test_a_pipe_is_worked_on_all_round_without_a_row_twice() -> None:
    scene = scene_of(
        raster={**PIPE, "cylinder": {**PIPE["cylinder"], "from_deg": -90, "to_deg": 270}}, speed_m_s=0.1
    )
    path = scene.timed_strokes(np.eye(4))[0].path
    rows = path.corners[::2] - path.corners[::2, 1:2] * [0, 1, 0]
    assert scene.strokes[0].raster.rows == len(rows) == 13  # of 0.628 m around
    assert len(np.unique(np.round(rows, 6), axis=0)) == 13
    assert "13 rows over 0.188 m2 of a cylinder" in scene.strokes[0].in_words


@pytest.mark.parametrize(
    "leg", [{"by": [0, 0.4, 0]}, {"arc": {"centre": [1.8, 0.9, -2], "axis": [1, 0, 0], "angle_deg": 70}}]
)
def test_the_tool_cruises_at_the_speed_that_is_asked(leg: dict[str, Any]) -> None:
    for ramp in (0.1, 0.5):
        scene = scene_of(legs=[{**leg, "speed_m_s": 0.07}], speed_profile={"ramp": ramp})
        X_WT = np.eye(4)
        X_WT[:3, 3] = WHERE
        path = scene.timed_strokes(X_WT)[0].path
        speed = np.linalg.norm(path.velocity(np.linspace(0, path.duration, 1001)), axis=1)
        assert speed.max() == pytest.approx(0.07, rel=1e-9)


@pytest.mark.parametrize("radius", [None, 0.05])
@pytest.mark.parametrize("surface", ["rectangle", "along", "around"])
def test_a_raster_is_covered_at_its_speed(radius: float | None, surface: str) -> None:
    more = {} if radius is None else {"blend_radius_m": radius}
    raster = {**PIPE, "cylinder": {**PIPE["cylinder"], "rows": surface}}
    raster = RASTER if surface == "rectangle" else raster
    path = scene_of(raster=raster, speed_m_s=0.1, **more).timed_strokes(np.eye(4))[0].path
    speed = np.linalg.norm(path.velocity(np.linspace(0, path.duration, 4001)), axis=1)
    assert speed.max() == pytest.approx(0.1, rel=1e-6)


def test_a_tool_path_is_read_back_from_its_content(rng: np.random.Generator) -> None:
    scene = scene_of(
        legs=[{"to": {"frame": "bracket", "xyz": [0, 0.1, 0], "axis": [0, 0, 1]}, "speed_m_s": 0.1}],
        **{"from": {"frame": "tool", "xyz": [0, 0, 0.1]}},
    )
    assert load_scene(scene.as_data()) == scene
    assert scene.strokes[0].start_pose == Goal(frame="tool", xyz=(0, 0, 0.1))
    splined = scene_of(waypoints=waypoint_rows(rng).tolist(), seconds=4)
    assert load_scene(splined.as_data()) == splined
    assert splined.begins_elsewhere
    assert not scene_of(legs=[{"pause": 1}]).begins_elsewhere


WAYPOINTS = [[0, 0, k, 1, 0, 0, 0] for k in range(3)]
RASTER = {"origin": [0, 0, 0], "u": [0, 0.2, 0], "v": [0.1, 0, 0], "spacing_m": 0.05, "stand_off_m": 0.1}
CYLINDER = {"centre": [0, 0, 0], "axis": [0, 1, 0], "radius": 0.1, "length": 0.3}
PIPE: dict[str, Any] = {
    "cylinder": {**CYLINDER, "from_deg": 90, "to_deg": 150},
    "spacing_m": 0.05,
    "stand_off_m": 0.1,
}
BY = {"by": [0, 0.1, 0], "seconds": 1}


@pytest.mark.parametrize(
    ("tool_path", "key", "expected"),
    [
        ({"legs": [{"by": [0, 1, 0]}]}, "tool_path.legs[0]", "exactly one of these keys"),
        ({"legs": [{"seconds": 1}]}, "tool_path.legs[0]", "exactly one of these keys"),
        ({"legs": [{**BY, "speed_m_s": 1}]}, "tool_path.legs[0]", "exactly one of these keys"),
        ({"legs": [{**BY, "pause": 1}]}, "tool_path.legs[0]", "exactly one of these keys"),
        ({"legs": [{"pause": 1, "seconds": 1}]}, "tool_path.legs[0].seconds", "no such key beside pause"),
        ({"legs": [{"arc": {"via": [0, 0, 1]}, "seconds": 1}]}, "tool_path.legs[0].arc", "via and to, or"),
        (
            {"legs": [{"arc": {"centre": [0, 0, 1], "axis": [0, 0, 1], "angle_deg": 0}, "seconds": 1}]},
            "tool_path.legs[0].arc.angle_deg",
            "an angle other than 0",
        ),
        (
            {"legs": [{"to": {"xyz": [0, 0, 1], "axis": [0, 0, 2]}, "seconds": 1}]},
            "tool_path.legs[0].to.axis",
            "a unit vector",
        ),
        (
            {"legs": [{"to": {"xyz": [0, 0, 1], "axis": [0, 0, 1], "rpy_deg": [0, 0, 0]}, "seconds": 1}]},
            "tool_path.legs[0].to",
            "at most one of these keys",
        ),
        (
            {"legs": [BY], "waypoints": [[0, 0, 0, 1, 0, 0, 0]] * 3},
            "tool_path.legs",
            "either legs, waypoints or",
        ),
        (
            {"raster": {**RASTER, "v": [0.1, 0.1, 0]}, "speed_m_s": 0.1},
            "tool_path.raster.v",
            "at right angles",
        ),
        ({"raster": {**RASTER, "spacing_m": 1e-5}, "speed_m_s": 0.1}, "tool_path.raster.spacing_m", "500"),
        ({"raster": RASTER}, "tool_path", "exactly one of these"),
        ({"raster": {**RASTER, **PIPE}, "speed_m_s": 0.1}, "tool_path.raster", "either origin, u and v, or"),
        (
            {"raster": {"spacing_m": 0.1, "stand_off_m": 0}, "speed_m_s": 0.1},
            "tool_path.raster",
            "or cylinder, or mesh",
        ),
        (
            {"raster": {**RASTER, "v": None}, "speed_m_s": 0.1},
            "tool_path.raster.v",
            "a value beside origin and u",
        ),
        (
            {"raster": {**PIPE, "cylinder": {**CYLINDER, "from_deg": 90, "to_deg": 90}}, "seconds": 9},
            "tool_path.raster.cylinder.to_deg",
            "another angle than from_deg 90",
        ),
        (
            {"raster": {**PIPE, "cylinder": {**CYLINDER, "from_deg": -90, "to_deg": 300}}, "seconds": 9},
            "tool_path.raster.cylinder.to_deg",
            "at most 360 from it",
        ),
        ({"raster": {**PIPE, "spacing_m": 1e-5}, "speed_m_s": 0.1}, "tool_path.raster.spacing_m", "500"),
        ({"legs": [BY], "speed_m_s": 0.1}, "tool_path.speed_m_s", "no such key beside legs"),
        ({"legs": [BY], "seconds": 3}, "tool_path.seconds", "no such key beside legs"),
        ({}, "tool_path.legs", "either legs, waypoints or"),
        ({"waypoints": [[0, 0, k, 1, 0, 0, 0] for k in range(3)]}, "tool_path", "exactly one of these"),
        ({"waypoints": [[0, 0, 0, 2, 0, 0, 0]] * 3}, "tool_path.waypoints[0]", "a unit quaternion"),
        (
            {
                "waypoints": [[0, 0, k, 1, 0, 0, 0] for k in range(3)],
                "seconds": 1,
                "from": {"xyz": [0, 0, 0]},
            },
            "tool_path.from",
            "no such key beside waypoints or",
        ),
    ],
)
def test_what_a_tool_path_cannot_be(tool_path: dict[str, Any], key: str, expected: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_of(**tool_path)
    assert caught.value.key == key
    assert expected in caught.value.expected


@pytest.mark.parametrize(
    ("leg", "key", "expected"),
    [
        ({"to": {"xyz": [0, 0, 1], "frame": "braket"}, "seconds": 1}, "legs[0].to.frame", "a frame of the"),
        ({"to": {"xyz": [0, 0, 0], "frame": "tool"}, "speed_m_s": 1}, "legs[0].speed_m_s", "has no length"),
        (
            {"arc": {"via": [0, 0.1, 0], "to": [0, 0.2, 0], "frame": "tool"}, "seconds": 1},
            "legs[0].arc",
            "a point beside the line",
        ),
    ],
)
def test_what_a_leg_cannot_do(leg: dict[str, Any], key: str, expected: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_of(legs=[leg]).timed_strokes(np.eye(4))
    assert caught.value.key == f"tool_path.{key}"
    assert expected in caught.value.expected


def test_frames_have_names_of_their_own() -> None:
    data = copy.deepcopy(SECOND) | {"frames": {"tool": {"xyz": [0, 0, 0], "rpy_deg": [0, 0, 0]}}}
    with pytest.raises(SceneError, match="a name that no frame has"):
        load_scene(data)


def test_in_python_too() -> None:
    with pytest.raises(InputError, match="exactly one of these keys"):
        Leg(by=(0, 1, 0), seconds=1.0, speed_m_s=0.1)
    with pytest.raises(InputError, match="via and to"):
        ArcTo(via=(0, 0, 1))
    with pytest.raises(InputError, match="at most one"):
        Goal(xyz=(0, 0, 0), axis=(0, 0, 1), rpy_deg=(0, 0, 0))


HEADING = "x,y,z,qw,qx,qy,qz"
ROW = "0.1,0.2,0.3,1,0,0,0"


def written(folder: Path, rows: list[str] | bytes) -> Path:
    csv = folder / "way.csv"
    csv.write_bytes(rows if isinstance(rows, bytes) else "\n".join(rows).encode())
    data = copy.deepcopy(SECOND) | {"tool_path": {"waypoints": "way.csv", "seconds": 5}}
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_waypoints_of_a_csv_file_are_part_of_the_scene(tmp_path: Path, rng: np.random.Generator) -> None:
    rows = waypoint_rows(rng)
    lines = [HEADING, *(",".join(map(repr, row)) for row in rows.tolist())]
    scene = load_scene(written(tmp_path, lines))
    np.testing.assert_array_equal(scene.strokes[0].waypoints, rows)
    (tmp_path / "way.csv").unlink()
    assert load_scene(scene.as_data()).content_hash == scene.content_hash


@pytest.mark.parametrize(
    ("rows", "key", "expected"),
    [
        (
            ["x,y,z", ROW[:11]],
            "line 1",
            "qw,qx,qy,qz or roll,pitch,yaw; or with keep: axis nx,ny,nz or i,j,k, with keep: position none",
        ),
        (["x,y,z,A,B,C,nr", "1,2,3,0,0,0,1"], "line 1", "A,B,C of a KUKA are yaw_deg,pitch_deg,roll_deg"),
        (["x,y", "1,2"], "line 1", "the columns x,y,z"),
        ([], "", "a table of waypoints"),
        ([HEADING, ROW, "1,2,3"], "line 3", "7 cells"),
        ([HEADING, ROW, "1,2,3,one,0,0,0"], "line 3, qw", "a finite number"),
        ([HEADING, ROW, "1,2,nan,1,0,0,0"], "line 3, z", "a finite number"),
        ([HEADING, ROW, "1,2,3,1,1,0,0"], "line 3", "a unit one"),
        ([HEADING], "", "a table of waypoints"),
        (["x,y,z,roll,pitch,yaw", "1,2,3,0,0,0", "1,2,3,180,0,0"], "line 3", "in degrees"),
        (["x (furlong),y,z,qw,qx,qy,qz", ROW], "line 1, x", "m, cm, mm, um or in"),
        (["x,y,z,nx,ny,nz", "0,0,0,0,0,1"], "line 1", "keep: axis"),
        (b"\xff\xfe\x00", "", "a table of waypoints"),
    ],
)
def test_a_csv_file_that_is_none(tmp_path: Path, rows: list[str] | bytes, key: str, expected: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene(written(tmp_path, rows))
    assert caught.value.key == key
    assert expected in caught.value.expected
    assert Path(caught.value.source).name == "way.csv"


def test_a_csv_file_that_is_missing(tmp_path: Path) -> None:
    path = written(tmp_path, [HEADING])
    (tmp_path / "way.csv").unlink()
    with pytest.raises(SceneError, match="a file that exists") as caught:
        load_scene(path)
    assert caught.value.key == "tool_path.waypoints"


@pytest.mark.parametrize("back", [(0.3, 1e-4, 0.0), (0.1, 1e-4, 0.0), (0.0, 1e-2, 0.0), (1.2, 0.9, 0.5)])
def test_tangents_stay_within_their_bound_where_a_spline_is_slow(back: tuple[float, float, float]) -> None:
    """Where it turns back it nearly stops, between the points at which its rate would be sampled."""
    points = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), back])
    spline = Spline(points)
    leg = Segment(curve=spline, seconds=1.0, law=SpeedProfile().law)
    path = ToolPath(segments=(leg,), orientation=np.eye(3))
    shares = np.linspace(0, 1, 20_001)
    slowest = shares[np.linalg.norm(spline.slope(shares), axis=1).argmin()]
    middle = path.times_at(0, np.array([slowest, 0.2, 0.8]))
    for half in (1e-5, 1e-4, 1e-3, 1e-2):
        start, end = middle - half, middle + half
        bound = path.bend(start, end)
        for k, t in enumerate(np.linspace(start, end, 101, axis=1)):
            away = path.leg_directions(t) - path.leg_directions([0.5 * (start[k] + end[k])])
            assert np.linalg.norm(away, axis=1).max() <= bound[k] * (1 + 1e-9) + 1e-12


PLACES = np.array([[0.1, 0.2, 0.3], [0.2, 0.2, 0.35], [0.3, 0.25, 0.3]])
QUATERNIONS = Rotation.from_euler("xyz", [[170, 0, 10], [175, 5, 20], [178, 0, 30]], degrees=True)


@pytest.mark.parametrize(
    ("heading", "columns", "keep"),
    [
        ("qz;qy;qx;qw;x;y;z", [QUATERNIONS.as_quat()[:, [2, 1, 0, 3]], PLACES], "pose"),
        ("index,x (mm),y (mm),z (mm),roll_deg,pitch_deg,yaw_deg", None, "pose"),
        (
            "pose.position.x,target-pos_y,position_z,"
            + ",".join(f"pose.orientation.{axis}" for axis in "xyzw"),
            [PLACES, QUATERNIONS.as_quat()],
            "pose",
        ),
        ("x y z roll pitch yaw", [PLACES, QUATERNIONS.as_euler("xyz")], "pose"),
        ("x,y,z,i,j,k", [PLACES, -QUATERNIONS.as_matrix()[:, :, 2]], "axis"),
        ("nx,ny,nz,x,y,z", [-3 * QUATERNIONS.as_matrix()[:, :, 2], PLACES], "axis"),
        ("x,y,z", [PLACES], "position"),
    ],
)
def test_columns_by_their_names(heading: str, columns: Any, keep: str, tmp_path: Path) -> None:
    if columns is None:
        columns = [[[0], [1], [2]], 1e3 * PLACES, QUATERNIONS.as_euler("xyz", degrees=True)]
    separator = next(mark for mark in ";, " if mark in heading)
    rows = [separator.join(map(repr, row)) for row in np.hstack(columns).tolist()]
    file = written(tmp_path, [heading, *rows])
    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    data["tool_path"]["keep"] = keep
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    found = np.array(load_scene(file).strokes[0].waypoints)
    np.testing.assert_allclose(found[:, :3], PLACES, atol=1e-12)
    R = Rotation.from_quat(found[:, 3:], scalar_first=True).as_matrix()
    if keep == "pose":
        np.testing.assert_allclose(R, QUATERNIONS.as_matrix(), atol=1e-9)
    if keep == "axis":
        np.testing.assert_allclose(R[:, :, 2], QUATERNIONS.as_matrix()[:, :, 2], atol=1e-9)


def test_a_file_with_units_a_pose_times_and_what_is_not_read(tmp_path: Path) -> None:
    lines = ["t,x,y,z,qw,qx,qy,qz,force", "1,100,0,0,1,0,0,0,5", "4,100,50,0,1,0,0,0,5"]
    file = written(tmp_path, lines)
    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    place = {"file": "way.csv", "units": "mm", "xyz": [1, 2, 3], "rpy_deg": [0, 0, 90]}
    data["tool_path"] = {"waypoints": place}
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.warns(UserWarning, match=r"1 column of way\.csv is not read: force"):
        (stroke,) = load_scene(file).strokes
    np.testing.assert_allclose(np.array(stroke.waypoints)[:, :3], [[1, 2.1, 3], [0.95, 2.1, 3]], atol=1e-12)
    assert stroke.seconds == 3
    file.write_text(
        yaml.safe_dump(data | {"tool_path": {"waypoints": place, "keep": "position"}}), encoding="utf-8"
    )
    with pytest.warns(UserWarning) as told:
        load_scene(file)
    assert "keep: position keeps nothing of qw,qx,qy,qz of way.csv" in [str(each.message) for each in told]
    data["tool_path"]["waypoints"] = place | {"frame": "part"}
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(SceneError, match=r"\.waypoints\.frame: .*, expected xyz and rpy_deg of that frame"):
        load_scene(file)
    data["tool_path"]["waypoints"] = place | {"units": "furlong"}
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(SceneError, match=r"tool_path\.waypoints\.units: got 'furlong'"):
        load_scene(file)
