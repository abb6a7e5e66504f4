"""Obstacles from mesh files: what they count as, and which are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from distance_tables import all_distances
from numpy.typing import NDArray
from oracles.distances import between_hulls, capsule_of
from raster_scenes import wavy_sheet
from robot_files import FLAT, pose as pose_of, write_flat_obj
from state_samples import StateSamples

from cmbot.collision import (
    Box,
    Capsule,
    Clearances,
    Cylinder,
    Mesh,
    Obstacle,
    Shape,
    Sphere,
    extent_of,
    load_mesh,
)
from cmbot.collision.shapes import coal_shapes, touched_by
from cmbot.common.errors import InputError, SceneError
from cmbot.common.poses import pose
from cmbot.robot import Robot, convex_hull, encloses_volume

FloatArray = NDArray[np.float64]
X_WO = pose([0.6, 0.7, -1.2], [0.4, -0.8, 1.1])
FORMATS = ("glb", "obj", "off", "ply", "stl")


def box_mesh(
    size: tuple[float, float, float], centre: tuple[float, float, float] = (0, 0, 0)
) -> trimesh.Trimesh:
    return trimesh.creation.box(size).apply_translation(centre)


def saved(mesh: trimesh.Trimesh, file: Path) -> Mesh:
    mesh.export(file)
    return Mesh(path=file)


def distances(robot: Robot, shapes: list[Shape], q: FloatArray) -> FloatArray:
    """Smallest distance of every link to any of the shapes, all at `X_WO`, (N, 5)."""
    obstacles = [Obstacle(name=f"o{k}", shape=shape, X_WO=X_WO) for k, shape in enumerate(shapes)]
    clearances = Clearances(robot, obstacles)
    of_link: dict[str, list[FloatArray]] = {}
    for pair, row in zip(clearances.pairs, all_distances(clearances, q), strict=True):
        if not pair.self_collision:
            of_link.setdefault(pair.link, []).append(row)
    return np.stack([np.min(of_link[link], axis=0) for link in sorted(of_link)], axis=1)


@pytest.mark.parametrize("ending", [*FORMATS, "STL"])
def test_mesh_of_a_box_is_the_box(
    cmbot_robot: Robot, random_states: StateSamples, tmp_path: Path, ending: str
) -> None:
    size = (0.3, 0.5, 0.9)
    q = random_states(cmbot_robot, 10)[0]
    mesh = saved(box_mesh(size), tmp_path / f"box.{ending}")
    got, expected = distances(cmbot_robot, [mesh], q), distances(cmbot_robot, [Box(size=size)], q)
    # Formats with single precision round the corners.
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-7)


def test_every_connected_part_counts_as_its_hull(
    cmbot_robot: Robot, random_states: StateSamples, tmp_path: Path
) -> None:
    parts = [box_mesh((0.2, 0.2, 0.2)), box_mesh((0.1, 0.3, 0.2), (0.6, 0, 0))]
    both = saved(trimesh.util.concatenate(parts), tmp_path / "both.stl")
    each = [saved(part, tmp_path / f"{k}.stl") for k, part in enumerate(parts)]
    hull = saved(trimesh.util.concatenate(parts).convex_hull, tmp_path / "hull.stl")
    q = random_states(cmbot_robot, 15)[0]
    got = distances(cmbot_robot, [both], q)
    np.testing.assert_allclose(got, distances(cmbot_robot, list(each), q), rtol=0, atol=1e-8)
    assert (got - distances(cmbot_robot, [hull], q)).max() > 0.01


def test_a_connected_part_with_a_notch_counts_as_its_hull(
    cmbot_robot: Robot, random_states: StateSamples, tmp_path: Path
) -> None:
    outline = np.array([[0, 0], [0.6, 0], [0.6, 0.1], [0.1, 0.1], [0.1, 0.6], [0, 0.6]])
    triangles = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    notched = trimesh.creation.extrude_triangulation(outline, np.array(triangles), 0.2)
    file = saved(notched, tmp_path / "notched.ply")
    assert not notched.is_convex
    q = random_states(cmbot_robot, 10)[0]
    clearances = Clearances(cmbot_robot, [Obstacle(name="angle", shape=file, X_WO=X_WO)])
    pair = next(k for k, p in enumerate(clearances.pairs) if (p.link, p.other) == ("tool", "angle"))
    corners = notched.vertices @ X_WO[:3, :3].T + X_WO[:3, 3]
    for q_k in q:
        start, end, radius = capsule_of(cmbot_robot, q_k, "tool")
        apart = between_hulls(np.array([start, end]), corners)
        assert clearances.nearest(q_k, pair).distance == pytest.approx(apart - radius, abs=1e-6)


def test_normals_and_textures_do_not_take_a_mesh_apart(tmp_path: Path) -> None:
    box = box_mesh((1, 1, 1))
    lines = ["v {} {} {}".format(*vertex) for vertex in box.vertices]
    lines += ["vn {} {} {}".format(*normal) for normal in box.face_normals]
    lines += [f"vt {k / 36} {k % 7 / 7}" for k in range(36)]
    for i, face in enumerate(box.faces):
        lines.append("f " + " ".join(f"{v + 1}/{3 * i + j + 1}/{i + 1}" for j, v in enumerate(face)))
    (tmp_path / "box.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    mesh = load_mesh(tmp_path / "box.obj", "thing")
    assert (len(mesh.vertices), len(mesh.split(only_watertight=False))) == (8, 1)


def test_a_mesh_is_read_once_and_anew_when_its_file_changes(tmp_path: Path) -> None:
    for folder, size in (("a", 1.0), ("b", 1.0), ("c", 2.0)):
        (tmp_path / folder).mkdir()
        box_mesh((size, 1, 1)).export(tmp_path / folder / "box.stl")
    meshes = {folder: load_mesh(tmp_path / folder / "box.stl") for folder in "abc"}
    assert meshes["a"] is meshes["b"]
    assert np.ptp(meshes["c"].vertices[:, 0]) == pytest.approx(2.0)
    (tmp_path / "c" / "box.stl").replace(tmp_path / "a" / "box.stl")
    assert load_mesh(tmp_path / "a" / "box.stl") is meshes["c"]
    # Neither are its hulls made again.
    hulls = [coal_shapes(Mesh(path=tmp_path / "b" / "box.stl"), "thing") for _ in range(2)]
    assert hulls[0][0] is hulls[1][0]


def clearances_with(robot: Robot, file: Path) -> Clearances:
    return Clearances(robot, [Obstacle(name="thing", shape=Mesh(path=file), X_WO=X_WO)])


@pytest.mark.parametrize("vertices", [*FLAT.values(), [[1, 2, 3]] * 3], ids=[*FLAT, "one point"])
def test_mesh_without_volume(cmbot_robot: Robot, tmp_path: Path, vertices: list[list[float]]) -> None:
    file = tmp_path / "flat.obj"
    write_flat_obj(file, vertices)
    with pytest.raises(SceneError, match=r"flat.obj: obstacles\[thing\].mesh: got no volume") as caught:
        clearances_with(cmbot_robot, file)
    assert caught.value.source == str(file)


def test_one_flat_part_is_enough_to_refuse_a_mesh(cmbot_robot: Robot, tmp_path: Path) -> None:
    box = box_mesh((1, 1, 1), (0, 0, 5))
    flap = trimesh.Trimesh([[2, 0, 0], [3, 0, 0.5], [2, 1, 0.5]], [[0, 1, 2]])
    file = saved(trimesh.util.concatenate([box, flap]), tmp_path / "flap.stl").path
    with pytest.raises(SceneError, match=r"a connected part without volume near \[2.333, 0.333, 0.333\]"):
        clearances_with(cmbot_robot, file)


@pytest.mark.parametrize(
    ("name", "content", "got"),
    [
        ("gone.stl", None, "no such file"),
        ("empty.stl", b"", "no volume|unreadable"),
        ("text.stl", b"no mesh at all", "no volume|unreadable"),
        ("text.obj", b"no mesh at all", "no volume"),
        ("text.ply", b"no mesh at all", "unreadable"),
        ("text.off", b"no mesh at all", "unreadable"),
        ("text.glb", b"no mesh at all", "unreadable"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n", "no volume"),
        (
            "nan.obj",
            b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 2 3 4\nf 1 3 4\nf 1 2 4\n",
            "no volume",
        ),
        ("short.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "vertices of shape"),
        ("far.obj", b"v 0 0 0\nv 1e200 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 2 3 4\n", "a mesh that is larger"),
        ("huge.obj", b"v 0 0 0\nf 1 2 99999999999999999999999\n", "unreadable"),
        ("part.step", b"ISO-10303-21;", "the format '.step'"),
        ("robot.dae", b"<COLLADA/>", "the format '.dae'"),
        ("bare", b"v 0 0 0", "the format ''"),
    ],
)
def test_files_that_hold_no_mesh(tmp_path: Path, name: str, content: bytes | None, got: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError, match=rf"{name}: obstacles\[thing\].mesh: (got )?({got})"):
        load_mesh(tmp_path / name, "thing")


@pytest.mark.parametrize("ending", FORMATS)
def test_a_damaged_file_is_a_scene_error_or_a_mesh(
    tmp_path: Path, rng: np.random.Generator, ending: str
) -> None:
    data = box_mesh((1, 1, 1)).export(file_type=ending)
    data = data if isinstance(data, bytes) else data.encode()
    file = tmp_path / f"damaged.{ending}"
    refused = 0
    for _ in range(40):
        damaged = bytearray(data[: rng.integers(len(data) // 2, len(data))])
        damaged[rng.integers(len(damaged))] = rng.integers(256)
        file.write_bytes(damaged)
        try:
            load_mesh(file, "thing")
        except SceneError:
            refused += 1
    assert refused > 10


@pytest.mark.parametrize("thickness", [1e-2, 1e-3, 1e-4])
def test_thin_is_not_flat(thickness: float) -> None:
    X: Any = pose_of((0.3, 0.8, -0.5), (3, -2, 1))
    corners = np.array(np.meshgrid([0, 1], [0, 0.5], [0, thickness])).reshape(3, -1).T
    points = np.array([X.act(corner) for corner in corners])
    assert encloses_volume(points)
    hull = convex_hull(points)
    assert hull.num_points == 8
    assert not encloses_volume(points * [1, 1, np.nan])
    assert not encloses_volume(points[:3])


@pytest.mark.parametrize(
    ("shape", "half"),
    [
        # Turned by a quarter about z: the first two sides change places.
        (Box(size=(0.2, 0.4, 0.6)), (0.2, 0.1, 0.3)),
        (Sphere(radius=0.3), (0.3, 0.3, 0.3)),
        (Cylinder(radius=0.1, length=0.6), (0.1, 0.1, 0.3)),
        (Capsule(radius=0.1, length=0.6), (0.1, 0.1, 0.4)),
    ],
)
def test_extent_of_obstacles(shape: Shape, half: tuple[float, float, float]) -> None:
    placed = Obstacle(name="lamp", shape=shape, X_WO=pose([1.0, -2.0, 0.5], [0, 0, np.pi / 2]))
    expected = np.array([1.0, -2.0, 0.5]) + np.outer([-1, 1], half)
    np.testing.assert_allclose(extent_of(placed), expected, atol=1e-9)


def test_extent_of_a_turned_mesh_has_all_its_corners(tmp_path: Path) -> None:
    mesh = saved(box_mesh((0.3, 0.5, 0.9)), tmp_path / "box.stl")
    corners = trimesh.creation.box((0.3, 0.5, 0.9)).apply_transform(X_WO).bounds
    np.testing.assert_allclose(
        extent_of(Obstacle(name="o", shape=mesh, X_WO=X_WO)), corners, rtol=0, atol=1e-6
    )


@pytest.mark.parametrize("X", [np.full((4, 4), np.nan), np.eye(3), np.eye(4).tolist(), np.full((4, 4), "1")])
def test_a_pose_is_an_array_of_finite_numbers(X: Any) -> None:
    with pytest.raises(InputError, match=r"Obstacle: X_WO: got .*, expected a pose"):
        Obstacle(name="o", shape=Sphere(radius=1.0), X_WO=X)


@pytest.mark.parametrize("scale", [True, "1", 0.0, 1e-7, 2e3, np.nan])
def test_a_scale_is_a_number_from_micrometres_to_kilometres(scale: Any) -> None:
    with pytest.raises(InputError, match=r"Mesh: scale: got .*, expected a number from 1e-06 to 1000"):
        Mesh(path=Path("box.stl"), scale=scale)
    with pytest.raises(InputError, match="Obstacle: scale"):
        Obstacle(name="o", shape=Sphere(radius=1.0), X_WO=X_WO, scale=scale)


def test_a_mesh_in_millimetres_that_a_box_touches(tmp_path: Path) -> None:
    file = saved(box_mesh((300, 500, 900)), tmp_path / "box.stl").path
    placed = Obstacle(name="o", shape=Mesh(path=file, scale=1e-3), X_WO=pose([1.0, 0, 0]))
    np.testing.assert_allclose(extent_of(placed), [[0.85, -0.25, -0.45], [1.15, 0.25, 0.45]], atol=1e-6)
    ball = Obstacle(name="ball", shape=Sphere(radius=0.1), X_WO=pose([5.0, 0, 0]))
    touching, apart = pose([0.7, 0, 0], [0, 0, np.pi / 2]), pose([0.7, 0, 0])
    box = Box(size=(0.2, 0.4, 0.1))
    assert touched_by(box, touching, [ball, placed]) == "o"
    assert touched_by(box, apart, [ball, placed]) is None


def test_a_sheet_counts_as_it_is_within_one_per_cent_of_its_size(
    cmbot_robot: Robot, random_states: StateSamples, tmp_path: Path
) -> None:
    """Distances of a capsule from all triangles one by one; of its hull they are far off."""
    sheet = wavy_sheet()
    file = saved(sheet, tmp_path / "sheet.ply")
    clearances = Clearances(cmbot_robot, [Obstacle(name="sheet", shape=file, X_WO=X_WO)])
    own = [k for k, pair in enumerate(clearances.pairs) if (pair.link, pair.other) == ("tool", "sheet")]
    size = np.linalg.norm(np.ptp(sheet.vertices, axis=0))
    assert 10 < len(own) < 160
    corners = sheet.triangles @ X_WO[:3, :3].T + X_WO[:3, 3]
    for q_k in random_states(cmbot_robot, 6)[0]:
        start, end, radius = capsule_of(cmbot_robot, q_k, "tool")
        line = start + np.linspace(0, 1, 400)[:, None] * (end - start)
        apart = min(
            np.linalg.norm(
                trimesh.triangles.closest_point(corners, np.tile(p, (len(corners), 1))) - p, axis=1
            ).min()
            for p in line
        )
        got = min(clearances.nearest(q_k, pair).distance for pair in own)
        step = np.linalg.norm(end - start) / 800
        assert apart - radius - 0.01 * size - step <= got <= apart - radius + 1e-6


def test_hulls_of_a_sheet_have_all_of_it_and_leave_its_hole_open(tmp_path: Path) -> None:
    sheet, rng = wavy_sheet(), np.random.default_rng(3)
    obstacle = [Obstacle(name="sheet", shape=saved(sheet, tmp_path / "sheet.ply"), X_WO=X_WO)]

    def touched(points: FloatArray, size: float) -> list[bool]:
        box = Box(size=(size, size, size))
        return [touched_by(box, X_WO @ pose(p, [0, 0, 0]), obstacle) == "sheet" for p in points]

    weights = rng.dirichlet(np.ones(3), size=300)
    chosen = sheet.triangles[rng.integers(len(sheet.faces), size=300)]
    assert all(touched(np.einsum("nk,nkd->nd", weights, chosen), 1e-5))
    # A rod of 50 mm goes through the hole, and a box into the bottom of a wave.
    assert not any(touched(np.array([[0, 0, z] for z in (-0.03, 0.0, 0.03)]), 0.035))
    bottom = np.array([-np.pi / 24, 0.0, -0.02])
    assert touched(bottom[None], 0.02) == [True]
    assert touched(bottom[None] + [0, 0, 0.02], 0.01) == [False]


def test_a_sheet_of_flat_patches_counts_as_these(tmp_path: Path) -> None:
    """Each gets a thickness of 1 mm; of its hull an angle would fill the inside."""
    points = [[0, 0, 0], [0.3, 0, 0.3], [0.3, 0.5, 0.3], [0, 0.5, 0], [-0.3, 0, 0.3], [-0.3, 0.5, 0.3]]
    angle = trimesh.Trimesh(points, [[0, 1, 2], [0, 2, 3], [0, 3, 5], [0, 5, 4]])
    obstacle = [Obstacle(name="angle", shape=saved(angle, tmp_path / "angle.stl"), X_WO=np.eye(4))]
    small = Box(size=(0.01, 0.01, 0.01))
    for height, name in ((0.0, "angle"), (0.03, None), (0.2, None), (-0.02, None)):
        assert touched_by(small, pose([0, 0.2, height], [0, 0, 0]), obstacle) == name
    assert touched_by(small, pose([0.15, 0.2, 0.15], [0, 0, 0]), obstacle) == "angle"
