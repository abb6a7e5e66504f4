"""The two scenes of the paper carry its numbers and ours, and their geometry closes."""

import json
from itertools import pairwise

import build_schema
import jsonschema
import numpy as np
import pytest
from oracles import chang2021_arm

from cmbot.collision import Box
from cmbot.common.errors import SceneError
from cmbot.common.installation import scene_folder
from cmbot.common.reading.yaml_reader import read_yaml
from cmbot.elastic import AngleSection, BarSection, GuardrailMaterial
from cmbot.scene import load_scene, shipped_scenes


def tool_point(posture):
    """The tool point in W, straight from the paper's table, independent of any model file."""
    return chang2021_arm.tool_pose(posture[None])[0][0]


def box_of(scene, name):
    obstacle = next(obstacle for obstacle in scene.all_obstacles if obstacle.name == name)
    assert isinstance(obstacle.shape, Box)
    return obstacle


def test_the_shipped_scenes():
    names = (
        "angle_steel",
        "bracket_faces",
        "clamped_triangle",
        "gusset_plate",
        "line",
        "mast_inspection",
        "panda_sanding",
        "passing_train",
        "pipe",
        "triangle",
        "two_brackets",
    )
    assert shipped_scenes() == names
    with pytest.raises(SceneError, match=rf"no such file.*\(one of: {', '.join(names)}\)"):
        load_scene("traingle")


@pytest.mark.parametrize("name", ["triangle", "line"])
def test_name_path_and_string_give_the_same_scene(name):
    path = scene_folder() / f"{name}.yaml"
    scenes = [load_scene(name), load_scene(path), load_scene(str(path))]
    assert {scene.name for scene in scenes} == {name}
    assert len({scene.content_hash for scene in scenes}) == 1
    assert all(scene == scenes[0] for scene in scenes)


def test_triangle():
    scene = load_scene("triangle")
    np.testing.assert_allclose(np.degrees(scene.posture), [-10, -90, 90, 0, 10, 50, 0])
    assert (scene.robot.model, scene.robot.tool_length_m, scene.robot.payload_kg) == ("cmbot", 0.30, 0)
    assert [leg.seconds for leg in scene.strokes[0].legs] == [10, 2, 8]
    lengths = [np.linalg.norm(leg.by) for leg in scene.strokes[0].legs]
    np.testing.assert_allclose(lengths, [1.0, 0.2, 0.83], atol=1e-4)
    np.testing.assert_allclose(np.sum([leg.by for leg in scene.strokes[0].legs], axis=0), 0, atol=1e-12)
    assert (scene.strokes[0].keep, scene.strokes[0].via_points) == ("pose", 50)
    assert (scene.strokes[0].speed_profile.kind, scene.strokes[0].speed_profile.ramp) == ("quiet", 0.3)


def test_bracket_bars_lie_along_the_sides():
    scene = load_scene("triangle")
    corner = tool_point(scene.posture)
    np.testing.assert_allclose(corner, [1.815, 0.780, -2.063], atol=1e-3)
    corners = corner + np.cumsum([(0, 0, 0), *(leg.by for leg in scene.strokes[0].legs)], axis=0)
    for name, (start, end) in zip(("ab", "bc", "ca"), pairwise(corners), strict=True):
        bar = box_of(scene, f"bracket_{name}")
        side = end - start
        assert bar.workpiece
        np.testing.assert_allclose(bar.X_WO[:3, 3], (start + end) / 2 + [0.12, 0, 0], atol=1e-4)
        assert abs(bar.X_WO[:3, 1] @ side) / np.linalg.norm(side) == pytest.approx(1, abs=1e-9)
        np.testing.assert_allclose(bar.shape.size, [0.06, np.linalg.norm(side), 0.06], atol=1e-4)


def test_line():
    scene = load_scene("line")
    np.testing.assert_allclose(np.degrees(scene.posture), [-45, -90, 90, -10, 10, -55, 0])
    assert [(leg.by, leg.seconds) for leg in scene.strokes[0].legs] == [((0, 0, 0.94), 20)]
    steel = box_of(scene, "angle_steel")
    assert steel.workpiece
    np.testing.assert_allclose(steel.shape.size, [0.075, 0.075, 1.5])
    expected = tool_point(scene.posture)[:2] - [0.35, 0]
    np.testing.assert_allclose(steel.X_WO[:2, 3], expected, atol=1e-4)
    middle = steel.X_WO[2, 3]
    np.testing.assert_allclose([middle - 0.75, middle + 0.75], [-2.28, -0.78])


@pytest.mark.parametrize("name", ["triangle", "line"])
def test_slab_and_guardrail(name):
    scene = load_scene(name)
    boxes = {o.name: (o.shape.size, o.X_WO[:3, 3].tolist()) for o in scene.all_obstacles if not o.workpiece}
    slab_size, slab_centre = boxes.pop("slab")
    assert (slab_size, slab_centre) == ((6, 1.2, 0.12), [1, -0.8, -1.06])
    assert slab_centre[1] + slab_size[1] / 2 == pytest.approx(-0.2)
    assert list(boxes) == ["top_rail", "bar_1", "bar_2", "post_1", "post_2", "post_3", "post_4", "post_5"]
    for rail, width, z in [("top_rail", 0.06, 0.0), ("bar_1", 0.04, -0.45), ("bar_2", 0.04, -0.80)]:
        assert boxes[rail] == ((7.0, width, width), [0, 0, z])
    for number, x in enumerate([-3.5, -1.75, 0, 1.75, 3.5], start=1):
        size, centre = boxes[f"post_{number}"]
        np.testing.assert_allclose([*size, *centre], [0.075, 0.075, 1.15, x, 0, -0.525])


def test_guardrail_data_for_the_frame():
    guardrail = load_scene("triangle").elastic_guardrail
    assert guardrail.post_positions == (-3.5, -1.75, 0, 1.75, 3.5)
    assert guardrail.post.clamp == -1.05
    assert guardrail.post.section == AngleSection(leg=0.075, thickness=0.008)
    assert guardrail.rails[0].section == AngleSection(leg=0.063, thickness=0.006)
    assert [rail.section for rail in guardrail.rails[1:]] == [BarSection(diameter=0.02)] * 2
    assert guardrail.material == GuardrailMaterial(young=206e9, shear=79e9, density=7850)
    assert guardrail.stiffness is None
    assert guardrail.mass is None


def test_json_schema_is_up_to_date():
    written = build_schema.TARGET.read_text(encoding="utf-8")
    assert written == build_schema.schema_text(), "run tools/build_schema.py"
    page = build_schema.PAGE.read_text(encoding="utf-8")
    assert page == build_schema.page_text(), "run tools/build_schema.py"


@pytest.fixture(scope="module")
def json_schema():
    schema = json.loads((scene_folder() / "scene.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("name", ["triangle", "line"])
def test_shipped_scenes_meet_the_json_schema(json_schema, name):
    json_schema.validate(read_yaml(scene_folder() / f"{name}.yaml", SceneError))
    resolved = load_scene(name).as_data()
    json_schema.validate(resolved)


@pytest.mark.parametrize("change", [{"sphere": 1.0}, {"box": None}, {"colour": "red"}, {"box": [1, 1]}])
def test_json_schema_refuses_wrong_obstacles(json_schema, change):
    data = load_scene("line").as_data()
    data["obstacles"][0].update(change)
    assert not json_schema.is_valid(data)
    with pytest.raises(SceneError):
        load_scene(data)
