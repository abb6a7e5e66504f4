"""The scale of obstacles: dimensions and mesh files in other units than metres."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from minimal_scenes import MINIMAL
from oracles.urdf_reader import mesh_parts
from raster_scenes import prism, raster_scene

from cmbot import load_scene
from cmbot.collision import Mesh, Obstacle, Sphere, extent_of, load_mesh
from cmbot.collision.shapes import coal_shapes
from cmbot.common.errors import InputError, SceneError
from cmbot.common.poses import pose
from cmbot.scene import Scene
from cmbot.views.drawing.surfaces import obstacle_surface

SHAPES: list[dict[str, Any]] = [
    {"box": [0.4, 0.5, 0.6]},
    {"cylinder": [0.4, 0.7]},
    {"capsule": [0.4, 0.7]},
    {"sphere": 0.3},
]


def scene_of(**entry: Any) -> Scene:
    return load_scene({**MINIMAL, "guardrail": {"bays": 0}, "obstacles": [{"name": "thing", **entry}]})


@pytest.mark.parametrize("scale", [1e-6, 0.001, 0.0254, 1, 1000])
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: next(iter(shape)))
def test_numbers_of_a_shape_are_multiplied_and_its_place_is_not(shape: dict[str, Any], scale: float) -> None:
    ((kind, numbers),) = shape.items()
    written = (np.array(numbers) / scale).tolist()
    scene = scene_of(**{kind: written}, scale=scale, xyz=[1, 2, 3], rpy_deg=[10, 20, 30])
    plain = scene_of(**shape, xyz=[1, 2, 3], rpy_deg=[10, 20, 30])
    np.testing.assert_allclose(
        extent_of(scene.all_obstacles[0]), extent_of(plain.all_obstacles[0]), rtol=1e-12
    )
    # Back to a file as it was written.
    (entry,) = scene.as_data()["obstacles"]
    assert (entry["scale"], entry[kind]) == (scale, written)


def test_a_mesh_in_millimetres_is_everywhere_the_one_in_metres(tmp_path: Path) -> None:
    block = trimesh.creation.icosphere(subdivisions=2, radius=0.3).apply_scale((1, 0.5, 2))
    block.export(tmp_path / "metres.stl")
    block.apply_scale(1000).export(tmp_path / "millimetres.stl")
    place = {"xyz": [1, 2, 3], "rpy_deg": [10, 20, 30]}
    (mine,), (theirs,) = (
        scene_of(mesh=str(tmp_path / f"{name}.stl"), **place, **more).all_obstacles
        for name, more in (("millimetres", {"scale": 0.001}), ("metres", {}))
    )
    np.testing.assert_allclose(extent_of(mine), extent_of(theirs), atol=1e-6)
    np.testing.assert_allclose(obstacle_surface(mine).vertices, obstacle_surface(theirs).vertices, atol=1e-6)
    # As an own reading of the files has them.
    (one,), (two,) = (mesh_parts(each.shape.path, each.shape.scale) for each in (mine, theirs))
    np.testing.assert_allclose(one, two, atol=1e-6)
    (hull,) = (geometry.points() for geometry in coal_shapes(mine.shape, mine.name))
    np.testing.assert_allclose(np.ptp(hull, axis=0), np.ptp(one, axis=0), atol=1e-6)


def test_a_mesh_is_kept_apart_from_the_same_file_in_other_units(tmp_path: Path) -> None:
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "box.stl")
    sizes = [load_mesh(tmp_path / "box.stl", scale=scale).extents for scale in (1.0, 0.5, 1.0)]
    np.testing.assert_allclose(sizes, [[1, 2, 3], [0.5, 1, 1.5], [1, 2, 3]])


def test_rows_over_a_mesh_in_millimetres_are_those_in_metres(tmp_path: Path) -> None:
    plate = prism([(0, 0), (0.3, 0), (0.3, 0.2), (0, 0.2)])
    (tmp_path / "mm").mkdir()
    scene = raster_scene(tmp_path, plate)
    small = raster_scene(tmp_path / "mm", plate.copy().apply_scale(1000))
    data = small.as_data()
    data["obstacles"][0] |= {"scale": 0.001, "mesh": str(small.all_obstacles[0].shape.path)}
    small = load_scene(json.loads(json.dumps(data)))
    one, two = (each.timed_strokes(np.eye(4))[0].path for each in (scene, small))
    np.testing.assert_allclose(one.corners, two.corners, atol=1e-6)


@pytest.mark.parametrize(
    ("entry", "key", "message"),
    [
        ({"box": [1, 2e4, 1]}, "obstacles[0].box[1]", "got 20000.0, expected at most 10000"),
        (
            {"box": [1, 2, 1e-5], "scale": 0.001},
            "obstacles[0].box[2]",
            "got 1e-05 times scale 0.001, expected",
        ),
        (
            {"sphere": 1e5, "scale": 1},
            "obstacles[0].sphere",
            "got 100000.0 times scale 1, expected at most",
        ),
        ({"sphere": 1, "scale": 0}, "obstacles[0].scale", "expected at least 1e-06"),
        ({"sphere": 1, "scale": -0.001}, "obstacles[0].scale", "expected at least 1e-06"),
    ],
)
def test_what_is_too_small_or_large_in_metres_is_refused(
    entry: dict[str, Any], key: str, message: str
) -> None:
    with pytest.raises(SceneError, match=message.replace("[", r"\[")) as caught:
        scene_of(**entry, xyz=[0, 0, 0])
    assert caught.value.key == key


@pytest.mark.parametrize("scale", [0.0, float("nan"), "0.001", True])
def test_a_wrong_scale_is_refused_in_python(scale: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^Mesh: scale: got .*, expected a number from 1e-06 to 1000"):
        Mesh(path=tmp_path / "a.stl", scale=scale)
    with pytest.raises(InputError, match=r"^Obstacle: scale: got "):
        Obstacle(name="ball", shape=Sphere(radius=1.0), X_WO=pose((0, 0, 0)), scale=scale)
