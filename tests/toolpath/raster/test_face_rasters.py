"""Rasters over faces of a mesh: by distances from the mesh, known areas, and a second computation."""

import copy
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings, strategies as st
from raster_scenes import HOLE, OVERSCAN, RASTER, STAND_OFF, prism, raster_scene, wavy_sheet
from scipy.spatial.transform import Rotation
from timed_paths import check_path, vectors

from cmbot import load_scene
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import MissingExtra, SceneError
from cmbot.planning import Plan, precheck_scene, remarks
from cmbot.scene import Scene, Stroke, coverage_of
from cmbot.toolpath import Coverage


def bent_sheet(radius: float, span_deg: float, length: float, facets: int, thickness: float = 0.01) -> Any:
    """Part of a pipe along y, in the middle of whose outer face is z = 0."""
    angle = np.radians(np.linspace(-0.5 * span_deg, 0.5 * span_deg, facets + 1))
    y = np.linspace(-0.5 * length, 0.5 * length, 7)
    grids = []
    for r in (radius, radius - thickness):
        a, b = np.meshgrid(angle, y, indexing="ij")
        grids.append(np.stack([r * np.sin(a), b, r * np.cos(a) - radius], axis=-1))
    outer, inner = (grid.reshape(-1, 3) for grid in grids)
    index = np.arange(len(outer)).reshape(facets + 1, len(y))
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    up = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return trimesh.Trimesh(
        np.vstack([outer, inner]), np.vstack([up, up[:, ::-1] + len(outer)]), process=False
    )


def stroke_of(scene: Scene) -> Stroke:
    return scene.timed_strokes(np.eye(4))[0]


def covered(*strokes: Stroke) -> Coverage:
    (found,) = coverage_of(strokes).values()
    return found


def in_frame(scene: Scene, vectors: FloatArray) -> FloatArray:
    return (vectors - scene.frame_poses["bracket"][:3, 3]) @ scene.frame_poses["bracket"][:3, :3]


def test_rows_of_a_plate_are_those_of_its_rectangle(tmp_path: Path) -> None:
    plate = prism([(0, 0), (0.3, 0), (0.3, 0.2), (0, 0.2)])
    scene = raster_scene(tmp_path, plate)
    stroke = stroke_of(scene)
    rectangle = copy.deepcopy(scene.as_data())
    rectangle["tool_path"]["raster"] = {
        "origin": [0, 0.025, 0],
        "u": [0.3, 0, 0],
        "v": [0, 0.15, 0],
        **{key: RASTER[key] for key in ("spacing_m", "stand_off_m", "overscan_m", "frame")},
    }
    other = stroke_of(load_scene(rectangle))
    np.testing.assert_allclose(stroke.path.corners, other.path.corners, atol=1e-6)
    np.testing.assert_allclose(stroke.path.seconds, other.path.seconds, rtol=1e-5)
    np.testing.assert_allclose(stroke.path.orientation[:, 2], other.path.orientation[:, 2], atol=1e-9)
    assert covered(stroke) == Coverage(area=pytest.approx(0.06, rel=1e-5), left_out=0.0)
    found = dict(precheck_scene(scene).found)
    assert found["faces of part"] == "0.06 m2, left out of them none"
    assert found["tool path"].startswith("a raster over faces of part, ")


def test_what_is_left_out_of_a_triangle_is_known(tmp_path: Path) -> None:
    """Rows end where their middle does: of each strip a triangle is left at the slanting side."""
    stroke = stroke_of(raster_scene(tmp_path, prism([(0, 0), (0.4, 0), (0, 0.2)]), overscan_m=0.0))
    assert len(stroke.surface.pieces) == 4
    assert covered(stroke).area == pytest.approx(0.04, rel=1e-5)
    assert covered(stroke).left_out == pytest.approx(4 * 0.5 * 0.025 * 0.05, rel=1e-4)
    wider = stroke_of(raster_scene(tmp_path, prism([(0, 0), (0.4, 0), (0, 0.2)]), overscan_m=0.051))
    assert covered(wider).left_out == 0.0


@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.floats(0.2, 0.6), st.floats(20, 70), st.integers(8, 30), vectors(), st.sampled_from([None, 0.03]))
def test_on_a_bent_sheet_the_tool_is_square_to_it(
    tmp_path: Path, radius: float, span: float, facets: int, along: list[float], blend: float | None
) -> None:
    if np.hypot(along[0], along[1]) < 0.2:
        return
    sheet = bent_sheet(radius, span, 0.4, facets)
    more = {"speed_m_s": 0.1} | ({} if blend is None else {"blend_radius_m": blend})
    scene = raster_scene(
        tmp_path, sheet, more, faces={"normal": [0, 0, 1], "within_deg": 40}, along=along, overscan_m=0.0
    )
    check_path(scene)
    stroke = stroke_of(scene)
    assert stroke.surface.area == pytest.approx(sheet.area / 2, rel=0.1)
    path = stroke.path
    rows = [k for k, segment in enumerate(path.segments) if not segment.is_straight]
    times = np.concatenate([np.linspace(*path.leg_times[k : k + 2], 41) for k in rows])
    poses = path.poses(times)
    p = in_frame(scene, poses.point) + np.array([0, 0, radius])
    away = np.linalg.norm(p[:, [0, 2]], axis=1)
    # Facets are below the sheet that they stand for; splines are near their points.
    sagitta = radius * (1 - np.cos(np.radians(0.5 * span / facets)))
    np.testing.assert_allclose(away, radius + STAND_OFF, atol=2 * sagitta + 2e-4)
    z = poses.rotation[:, :, 2] @ scene.frame_poses["bracket"][:3, :3]
    towards = -np.einsum("nd,nd->n", z, p * [1, 0, 1] / away[:, None])
    assert np.degrees(np.arccos(np.clip(towards, -1, 1))).max() < 0.75 * span / facets
    # By the mesh itself, with the nearest point on it.
    mesh = trimesh.load_mesh(scene.all_obstacles[0].shape.path)
    at = in_frame(scene, poses.point)
    corners = mesh.triangles
    nearest = [
        np.linalg.norm(
            trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1))) - point, axis=1
        ).min()
        for point in at[::37]
    ]
    np.testing.assert_allclose(nearest, STAND_OFF, atol=2 * sagitta + 2e-4)


def test_a_tool_that_leans_meets_faces_on_the_rows_of_a_square_one(tmp_path: Path) -> None:
    sheet, faces = bent_sheet(0.4, 60, 0.3, 12), {"normal": [0, 0, 1], "within_deg": 40}
    more = {"speed_m_s": 0.1}
    for solid in (sheet, prism([(0, 0), (0.3, 0), (0.3, 0.2), (0, 0.2)])):
        square = stroke_of(raster_scene(tmp_path, solid, more, faces=faces, stand_off_m=0.0)).path
        scene = raster_scene(tmp_path, solid, more, faces=faces, lean_deg=[-20, 15])
        check_path(scene)
        path = stroke_of(scene).path
        ahead = path.poses(path.leg_times).rotation[:, :, 2]
        normals = -square.poses(square.leg_times).rotation[:, :, 2]
        meets = path.corners + STAND_OFF * ahead
        np.testing.assert_allclose(meets, square.corners, atol=1e-9)
        # The tangents of both angles are those of the whole one.
        tangent = np.linalg.norm(np.cross(ahead, normals), axis=1) / -(ahead * normals).sum(axis=1)
        np.testing.assert_allclose(tangent, np.hypot(*np.tan(np.radians([-20, 15]))), atol=1e-9)


def test_rows_through_the_vertices_of_a_mesh_are_those_of_a_second_computation(tmp_path: Path) -> None:
    sheet = bent_sheet(0.4, 60, 0.3, 12)
    more = {"speed_m_s": 0.1, "passes": 2}
    for off in (0.0, 3e-9, 3e-8):
        sheet.vertices += [off, off, 0]
        faces = {"normal": [0, 0, 1], "within_deg": 40}
        scene = raster_scene(tmp_path, sheet, more, faces=faces, spacing_m=0.06)
        check_path(scene)


@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    st.integers(0, 2**32 - 1),
    st.fixed_dictionaries({"kind": st.sampled_from(["trapezoidal", "jerk_limited"])}),
    st.booleans(),
)
def test_rows_over_any_plate_are_those_of_a_second_computation(
    tmp_path: Path, seed: int, profile: dict[str, Any], blended: bool
) -> None:
    rng = np.random.default_rng(seed)
    more: dict[str, Any] = {"seconds": 20.0, "speed_profile": profile}
    more |= {"blend_radius_m": 0.02} if blended else {}
    plate = prism((0.3 * rng.normal(size=(9, 2))).tolist())
    turn = Rotation.from_euler("x", float(rng.uniform(-15, 15)), degrees=True)
    plate.apply_transform(np.block([[turn.as_matrix(), np.zeros((3, 1))], [np.zeros(3), np.ones(1)]]))
    scene = raster_scene(tmp_path, plate, more, along=rng.normal(size=3).tolist())
    check_path(scene)
    p = in_frame(scene, stroke_of(scene).path.position(np.linspace(0, 20, 101))) @ turn.as_matrix()
    np.testing.assert_allclose(p[:, 2], STAND_OFF, atol=1e-6)


def test_a_gap_in_a_plane_is_passed(tmp_path: Path) -> None:
    stroke = stroke_of(raster_scene(tmp_path, HOLE))
    assert stroke.surface.area == pytest.approx(0.04, rel=1e-5)
    assert covered(stroke).left_out == 0.0
    lengths = np.linalg.norm(np.diff(stroke.path.corners, axis=0), axis=1)[::2]
    np.testing.assert_allclose(lengths, 0.23 + 2 * OVERSCAN, atol=1e-6)


def layers() -> trimesh.Trimesh:
    other = prism([(0, 0), (0.1, 0), (0.1, 0.2), (0, 0.2)])
    other.apply_translation([0, 0, 0.3])
    return trimesh.util.concatenate([HOLE, other])


def stairs() -> trimesh.Trimesh:
    """Treads that adjoin where they are looked at along their normal."""
    upper = prism([(0.1, 0), (0.2, 0), (0.2, 0.2), (0.1, 0.2)])
    upper.apply_translation([0, 0, 0.05])
    return trimesh.util.concatenate([prism([(0, 0), (0.1, 0), (0.1, 0.2), (0, 0.2)]), upper])


@pytest.mark.parametrize(
    ("mesh", "raster", "key", "got", "expected"),
    [
        (HOLE, {"mesh": "bolt"}, "mesh", "bolt", "an obstacle that is a mesh"),
        (HOLE, {"faces": {"normal": [0, 0.6, 0.8]}}, "faces", "nearest is 36.9 degrees away", "within_deg"),
        (
            HOLE,
            {"faces": {"normal": [0, 0, 1], "box": [[5, 5, 5], [6, 6, 6]]}},
            "faces",
            "no face",
            "inside of",
        ),
        (HOLE, {"spacing_m": 0.02}, "faces", "row 1 is in 2 pieces", "Scene.in_cells"),
        (HOLE, {"along": [0, 0, 1]}, "along", "the faces' normal", "a direction across it"),
        (HOLE, {"spacing_m": 1e-4}, "spacing_m", "0.0001", "at most 500 rows"),
        (layers(), {}, "faces", "behind each other", "a box around it"),
        (stairs(), {}, "faces", "a step of 0.05 m", "connected along the rows"),
        (HOLE, {"frame": "braket"}, "frame", "braket", "a frame of the scene"),
    ],
)
def test_faces_that_have_no_raster(
    tmp_path: Path, mesh: trimesh.Trimesh, raster: dict[str, Any], key: str, got: str, expected: str
) -> None:
    with pytest.raises(SceneError) as caught:
        stroke_of(raster_scene(tmp_path, mesh, **raster))
    assert caught.value.key == f"tool_path.raster.{key}"
    assert got in caught.value.got
    assert expected in caught.value.expected


def test_a_box_chooses_one_layer(tmp_path: Path) -> None:
    faces = {"normal": [0, 0, 1], "box": [[-1, -1, -0.1], [1, 1, 0.1]]}
    assert stroke_of(raster_scene(tmp_path, layers(), faces=faces)).surface.area == pytest.approx(
        0.04, rel=1e-5
    )


def test_the_scene_of_a_file_is_the_same_again(tmp_path: Path) -> None:
    scene = raster_scene(tmp_path, HOLE)
    assert load_scene(scene.as_data()) == scene
    # The mesh is part of it.
    assert raster_scene(tmp_path, layers()).content_hash != scene.content_hash


def test_without_shapely_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = raster_scene(tmp_path, HOLE)
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(MissingExtra, match="shapely is not installed"):
        stroke_of(scene)


def test_a_mesh_file_in_the_frame_is_as_the_obstacle_there(tmp_path: Path) -> None:
    sheet = bent_sheet(0.4, 40.0, 0.3, 12)
    named = raster_scene(tmp_path, sheet)
    data = named.as_data()
    data["obstacles"], data["tool_path"]["raster"]["mesh"] = [], "part.stl"
    (tmp_path / "scene.yaml").write_text(json.dumps(data), encoding="utf-8")
    scene = load_scene(tmp_path / "scene.yaml")
    assert scene.strokes[0].raster.mesh_file == tmp_path / "part.stl"
    np.testing.assert_allclose(stroke_of(scene).path.corners, stroke_of(named).path.corners, atol=1e-12)
    check_path(scene)
    found = dict(precheck_scene(scene).found)
    assert found["tool path"].startswith("a raster over faces of part.stl, ")
    # Another content is another scene; a missing file is named by its key.
    (tmp_path / "part.stl").write_bytes(bent_sheet(0.5, 40.0, 0.3, 12).export(file_type="stl"))
    assert load_scene(tmp_path / "scene.yaml").content_hash != scene.content_hash
    (tmp_path / "part.stl").unlink()
    with pytest.raises(
        SceneError, match=r"tool_path.raster.mesh: got 'part.stl', expected a file that exists"
    ):
        load_scene(tmp_path / "scene.yaml")


def test_normal_and_direction_are_those_of_the_sheet(tmp_path: Path, short_plan: Plan) -> None:
    turned = trimesh.transformations.euler_matrix(0.3, -0.2, 1.9)
    sheet = wavy_sheet().apply_transform(turned)
    lean = {"overscan_m": 0.0, "stand_off_m": 0.04}
    scene = raster_scene(tmp_path, sheet, faces=None, along=None, **lean)
    strokes = scene.in_cells(np.eye(4)).timed_strokes(np.eye(4))
    # The file has single precision.
    assert strokes[0].surface.area == pytest.approx(sheet.area, rel=1e-7)
    along, _, out = strokes[0].surface.axes @ scene.frame_poses["bracket"][:3, :3]
    assert np.abs(along @ turned[:3, 0]) == pytest.approx(1.0, abs=2e-3)
    assert out @ turned[:3, 2] == pytest.approx(1.0, abs=2e-3)
    told = remarks(replace(short_plan, scene=scene))
    assert any(each.startswith("Faces of work, found in W: normal [") for each in told)
    # They do for what was left out.
    faces = {"normal": out.tolist(), "within_deg": 80}
    other = raster_scene(tmp_path, sheet, faces=faces, along=along.tolist(), **lean)
    for one, same in zip(strokes, other.in_cells(np.eye(4)).timed_strokes(np.eye(4)), strict=True):
        np.testing.assert_allclose(one.path.corners, same.path.corners, atol=1e-6)
    # By the mesh itself: a facet turns by some degrees from the next one.
    at = in_frame(scene, np.concatenate([stroke.path.corners for stroke in strokes]))
    every = np.repeat(sheet.triangles, len(at), axis=0)
    nearest = trimesh.triangles.closest_point(every, np.tile(at, (len(sheet.faces), 1)))
    away = np.linalg.norm(nearest.reshape(-1, *at.shape) - at, axis=2).min(axis=0)
    np.testing.assert_allclose(away, 0.04, atol=1e-3)


def test_a_solid_has_no_normal_of_its_own(tmp_path: Path) -> None:
    scene = raster_scene(tmp_path, HOLE, faces=None)
    with pytest.raises(SceneError, match=r"raster.faces: got faces that are steep to each other"):
        scene.timed_strokes(np.eye(4))
