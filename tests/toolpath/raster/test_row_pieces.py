"""Rasters in pieces: cells of rows, the strokes that they become, and what these cover."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from raster_scenes import HOLE, prism, raster_scene
from timed_paths import SECOND, check_path, scene_of

from cmbot import load_scene
from cmbot.common.errors import InputError, SceneError
from cmbot.scene import Scene, coverage_of, pieces_left_out
from cmbot.toolpath import RowPiece
from cmbot.toolpath.raster.raster import cells_of, united, without

RECTANGLE = {"origin": [0, 0, 0], "u": [0.4, 0, 0], "v": [0, 0.2, 0], "spacing_m": 0.1, "stand_off_m": 0.1}
CYLINDER = {
    "cylinder": {
        "centre": [0, 0, 0],
        "axis": [0, 1, 0],
        "radius": 0.1,
        "from_deg": 20,
        "to_deg": -100,
        "length": 0.4,
    },
    "spacing_m": 0.1,
    "stand_off_m": 0.12,
}
AROUND = {**CYLINDER, "cylinder": {**CYLINDER["cylinder"], "rows": "around"}}
PIECES = [
    {"row": 0, "begin_m": 0.05, "end_m": 0.2},
    {"row": 1, "begin_m": 0.0, "end_m": 0.15},
    {"row": 2, "begin_m": 0.1, "end_m": 0.18},
]


def rows(cells: list[tuple[RowPiece, ...]]) -> list[list[int]]:
    return [[piece.row for piece in cell] for cell in cells]


@pytest.mark.parametrize(
    ("spans", "expected"),
    [
        ([[(0, 1)], [(0, 1)], [(0, 1)]], [[0, 1, 2]]),
        # One after the other, though they do not overlap: rows of one piece go on.
        ([[(0, 1)], [(2, 3)]], [[0, 1]]),
        # A hole in the middle, and a notch at the end.
        ([[(0, 9)], [(0, 3), (6, 9)], [(0, 3), (6, 9)], [(0, 9)]], [[0], [1, 2], [1, 2], [3]]),
        ([[(0, 9)], [(0, 3), (6, 9)], [(0, 2), (7, 9)]], [[0], [1, 2], [1, 2]]),
        # Nothing on a row: what follows is apart.
        ([[(0, 1)], [], [(0, 1)]], [[0], [2]]),
        ([[(0, 1), (2, 3)], [(0, 1)]], [[0, 1], [0]]),
    ],
)
def test_rows_that_split_or_join_end_cells(
    spans: list[list[tuple[float, float]]], expected: list[list[int]]
) -> None:
    cells = cells_of(spans)
    assert rows(cells) == expected
    assert sorted((one.row, one.begin_m) for cell in cells for one in cell) == sorted(
        (row, begin) for row, pieces in enumerate(spans) for begin, _ in pieces
    )


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(1, 20)), max_size=5), st.integers(0, 2**32 - 1))
def test_intervals_without_others_are_the_places_in_them_alone(
    sizes: list[tuple[int, int]], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    intervals = united([(float(begin), float(begin + size)) for begin, size in sizes])
    others = [(float(begin), float(begin + 1 + rng.integers(9))) for begin in rng.integers(0, 50, 4)]
    places = np.arange(0.5, 80)

    def inside(each: list[tuple[float, float]]) -> list[float]:
        return [x for x in places if any(begin <= x <= end for begin, end in each)]

    expected = [x for x in inside(intervals) if x not in inside(others)]
    assert inside(without(intervals, others)) == expected


@settings(max_examples=4)
@given(
    st.sampled_from([RECTANGLE, CYLINDER, AROUND]),
    st.sampled_from(["world", "bracket"]),
    st.sampled_from([{}, {"blend_radius_m": 0.03}]),
)
def test_pieces_are_where_a_second_computation_has_them(
    raster: dict[str, Any], frame: str, more: dict[str, Any]
) -> None:
    raster = {**raster, "frame": frame, "overscan_m": 0.02, "pieces": PIECES}
    scene = scene_of(raster=raster, speed_m_s=0.1, **more)
    check_path(scene)
    (stroke,) = scene.timed_strokes(np.eye(4))
    assert len(stroke.path.seconds) == (1 if more else 5)


def test_pieces_of_faces_are_where_a_second_computation_has_them(tmp_path: Path) -> None:
    plate = prism([(0, 0), (0.3, 0), (0.3, 0.2), (0, 0.2)])
    pieces = [{"row": 1, "begin_m": 0.1, "end_m": 0.3}, {"row": 2, "begin_m": 0.05, "end_m": 0.2}]
    scene = raster_scene(tmp_path, plate, pieces=pieces)
    check_path(scene)
    (found,) = coverage_of(scene.timed_strokes(np.eye(4))).values()
    # Overscan covers, too, as far as there is a surface: 0.02 m at three of the four ends.
    assert found.covered == pytest.approx(0.05 * (0.2 + 0.02 + 0.15 + 0.04), rel=1e-4)
    assert found.unreached == pytest.approx(found.left_out)


def test_a_face_with_a_hole_becomes_strokes_that_cover_it(tmp_path: Path) -> None:
    """Two plates with a gap wider than the rows' distance are as a face with a notch all through."""
    scene = raster_scene(tmp_path, HOLE, {"seconds": 20.0, "blend_radius_m": 0.01}, spacing_m=0.02)
    apart = scene.in_cells(np.eye(4))
    assert [(file.name, file.part_of) for file in apart.strokes] == [
        ("work_1", "work"),
        ("work_2", "work"),
    ]
    check_path(apart)
    strokes = apart.timed_strokes(np.eye(4))
    # Half of the way each, in half the time; ramps as long as before.
    np.testing.assert_allclose([stroke.path.duration for stroke in strokes], 10.0, rtol=0.02)
    assert [stroke.file.speed_profile.ramp for stroke in strokes] == [0.5, 0.5]
    ((name, found),) = coverage_of(strokes).items()
    assert name == "work"
    assert (found.area, found.left_out) == (pytest.approx(0.04, rel=1e-4), 0.0)
    # The strokes are in the file that a plan holds.
    again = load_scene(apart.as_data())
    assert again.strokes == apart.strokes
    assert again.in_cells(np.eye(4)) is again


def test_what_is_left_out_of_a_rectangle_is_known() -> None:
    scene = scene_of(raster={**RECTANGLE, "pieces": PIECES}, speed_m_s=0.1)
    strokes = scene.timed_strokes(np.eye(4))
    (found,) = coverage_of(strokes).values()
    covered = 0.05 * 0.15 + 0.1 * 0.15 + 0.05 * 0.08
    assert (found.area, found.covered) == (pytest.approx(0.08), pytest.approx(covered))
    assert found.unreached == pytest.approx(found.left_out)
    left = [(piece.row, piece.begin_m, piece.end_m) for _, piece in pieces_left_out(strokes)]
    assert left == [(0, 0.0, 0.05), (0, 0.2, 0.4), (1, 0.15, 0.4), (2, 0.0, 0.1), (2, 0.18, 0.4)]


def in_parts(*strokes: dict[str, Any]) -> Scene:
    data: dict[str, Any] = copy.deepcopy(SECOND)
    data["tool_path"] = {"strokes": list(strokes)}
    scene = load_scene(data)
    cells = cells_of([[(0.0, 0.1), (0.3, 0.4)]] * 3)
    return scene.with_cells({0: cells}, {0: [piece for cell in cells for piece in cell]})


def test_keys_are_those_of_the_file_whatever_the_parts_and_the_order() -> None:
    edge = {"name": "edge", "from": {"xyz": [0.0, 0.0, 0.0]}, "legs": [{"by": [0.1, 0, 0], "seconds": 1.0}]}
    parts = in_parts({"name": "rows", "raster": RECTANGLE, "speed_m_s": 0.1}, edge)
    strokes = parts.timed_strokes(np.eye(4))
    rows = [stroke.key for stroke in strokes if stroke.file.part_of == "rows"]
    assert len(rows) == len(strokes) - 1 > 1 and set(rows) == {"tool_path.strokes[0]"}
    assert strokes[-1].key == "tool_path.strokes[1]"
    # The best order may be another one than that of the file.
    turned = parts.with_strokes(parts.strokes[::-1]).timed_strokes(np.eye(4))
    assert [stroke.key for stroke in turned] == [stroke.key for stroke in strokes[::-1]]


def test_the_key_of_a_file_with_one_path_is_that_of_all_its_parts(tmp_path: Path) -> None:
    apart = raster_scene(tmp_path, HOLE, {"seconds": 20.0}, spacing_m=0.02).in_cells(np.eye(4))
    assert [stroke.key for stroke in apart.timed_strokes(np.eye(4))] == ["tool_path"] * 2


def test_more_parts_than_can_be_ordered_are_as_given() -> None:
    data: dict[str, Any] = copy.deepcopy(SECOND)
    stroke = {"raster": {**RECTANGLE, "spacing_m": 0.01}, "speed_m_s": 0.1}
    data["tool_path"] = {"strokes": [stroke], "order": "best"}
    scene, piece = load_scene(data), {"begin_m": 0.0, "end_m": 0.4}
    rows_alone = [(RowPiece(row=2 * k, **piece),) for k in range(10)]
    assert scene.with_cells({0: rows_alone}, {0: [RowPiece(row=0, **piece)]}).order == "best"
    single = [(RowPiece(row=k, **piece),) for k in range(13)]
    assert scene.with_cells({0: single}, {0: [RowPiece(row=0, **piece)]}).order is None


def test_a_name_that_is_taken_is_none_of_a_part() -> None:
    raster = {"raster": RECTANGLE, "speed_m_s": 0.1}
    found = in_parts({**raster, "name": "face"}, {**raster, "name": "face_2"})
    assert [file.name for file in found.strokes] == ["face_1", "face_part_2", "face_2"]


@pytest.mark.parametrize(
    ("strokes", "key"),
    [
        ([{"raster": {**RECTANGLE, "frame": "tool"}, "speed_m_s": 0.1}], "strokes[0].raster.frame"),
        (
            [{"raster": RECTANGLE, "speed_m_s": 0.1}, {"legs": [{"by": [0.1, 0, 0], "seconds": 2}]}],
            "strokes[1].from",
        ),
    ],
)
def test_rasters_that_others_depend_on_are_in_one_part(strokes: list[dict[str, Any]], key: str) -> None:
    with pytest.raises(SceneError) as caught:
        in_parts(*strokes)
    assert caught.value.key == f"tool_path.{key}"


@pytest.mark.parametrize(
    ("pieces", "key"),
    [
        ([{"row": 3, "begin_m": 0, "end_m": 0.1}], "pieces[0].row"),
        ([{"row": 0, "begin_m": 0.3, "end_m": 0.5}], "pieces[0]"),
        ([{"row": 0, "begin_m": 0.3, "end_m": 0.3}], "end_m"),
        ([{"row": 0, "begin_m": 0, "end_m": 0.1}, {"row": 0, "begin_m": 0.2, "end_m": 0.3}], "pieces[1].row"),
    ],
)
def test_pieces_that_no_row_has(pieces: list[dict[str, Any]], key: str) -> None:
    with pytest.raises((SceneError, InputError)) as caught:
        scene_of(raster={**RECTANGLE, "pieces": pieces}, speed_m_s=0.1)
    assert key in str(caught.value)
