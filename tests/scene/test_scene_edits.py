"""A scene is what its file says: it is read back from its content, and edits are those of the file."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from minimal_scenes import MINIMAL
from small_scenes import SHORT, short_scene, strokes_scene

from cmbot.archive import load_plan, save
from cmbot.common.errors import InputError, SceneError
from cmbot.elastic import elastic_base
from cmbot.planning import plan, robot_of
from cmbot.scene import (
    AxisCone,
    FootholdFile,
    GuardrailFile,
    MountFile,
    ObstacleFile,
    PlannerOptions,
    PostureFile,
    Scene,
    StanceFile,
    Tool,
    changed_content,
    load_scene,
    shipped_scenes,
)

STANCE = {"foot_1": {"member": "post_2", "along_m": 1.1}, "foot_2": "free"}
BLOCK: dict[str, Any] = {"name": "block", "box": [0.1, 0.2, 0.3], "xyz": [5, 5, 5], "rpy_deg": [10, 20, 30]}
FRAMES = {"b": {"xyz": [1, 2, 3], "rpy_deg": [0, 0, 17]}, "a": {"xyz": [0, 0, 0], "rpy_deg": [1, 2, 3]}}
CASES: dict[str, dict[str, Any]] = {
    "minimal": MINIMAL,
    "short": {**SHORT, "obstacles": [BLOCK], "frames": FRAMES, "base": {"name": "walkway"}},
    "stance": {**SHORT, "guardrail": {"stance": STANCE, "hold": {"kind": "magnet", "adhesion_n": 5000}}},
    "automatic": {
        **SHORT,
        "tool_path": {
            "strokes": [
                {"name": "there", "legs": [{"by": [0, -0.1, 0]}, {"pause": 1}]},
                {
                    "legs": [{"by": [0, 0.1, 0], "seconds": 3}],
                    "via_points": 12,
                    "keep": {"axis_within_deg": 9},
                },
            ],
            "seconds": "auto",
            "via_points": "auto",
            "order": "given",
        },
        "guardrail": {"bays": 0, "stiffness": [1e6, 2e6, 3e6, 1e3, 2e3, 3e3]},
    },
}


@pytest.fixture(params=[*shipped_scenes(), *CASES])
def read(request: pytest.FixtureRequest) -> Scene:
    return load_scene(CASES.get(request.param, request.param))


def test_a_scene_is_read_back_from_its_content(read: Scene) -> None:
    again = load_scene(read.as_data())
    assert again == read
    assert hash(again) == hash(read)
    assert again.content_hash == read.content_hash
    assert again.as_data() == read.as_data()


def test_copies_and_pickles_are_the_scene(read: Scene) -> None:
    read.posture  # noqa: B018  what was asked for before does not matter
    for other in (pickle.loads(pickle.dumps(read)), copy.copy(read), copy.deepcopy(read)):
        assert other == read
        assert hash(other) == hash(read)
        assert (other.source, other.content_hash) == (read.source, read.content_hash)
        np.testing.assert_array_equal(other.posture, read.posture)


def test_a_scene_is_more_than_one_stroke_or_one(read: Scene) -> None:
    assert len(read.strokes) >= 1
    assert all(stroke.name for stroke in read.strokes)


def test_scenes_that_say_something_else_are_others(read: Scene) -> None:
    other = read.with_payload(read.robot.payload_kg + 1)
    assert other != read
    assert other.content_hash != read.content_hash
    assert other.with_payload(read.robot.payload_kg) == read
    assert read.__eq__(1) is False
    assert read.with_source("elsewhere") == read


def edited(data: dict[str, Any], values: dict[str, Any]) -> Scene:
    return load_scene(changed_content(data, values))


EDITS: list[tuple[Callable[[Scene], Scene], dict[str, Any]]] = [
    (
        lambda s: s.with_options(knots="fixed", axis_weights=(1, 2, 0)),
        {"planner.knots": "fixed", "planner.axis_weights": [1, 2, 0]},
    ),
    (lambda s: s.with_options(PlannerOptions(max_passes=7)), {"planner": {"max_passes": 7}}),
    (lambda s: s.with_payload(2.5), {"robot.payload_kg": 2.5}),
    (lambda s: s.with_joints("elastic"), {"robot.joints": "elastic"}),
    (lambda s: s.with_posture(np.full(7, 0.1)), {"start": {"posture": [0.1] * 7}}),
    (
        lambda s: s.with_stance(StanceFile(foot_1=FootholdFile(member="post_2", along_m=1.1))),
        {"guardrail.stance": STANCE},
    ),
    (lambda s: s.with_path(via_points=9), {"tool_path.via_points": 9}),
    (lambda s: s.with_path(keep=AxisCone(axis_within_deg=7.5)), {"tool_path.keep": {"axis_within_deg": 7.5}}),
    (
        lambda s: s.with_path(legs=(replace(s.strokes[0].legs[0], by=np.array([0.0, -0.2, 0.1])),)),
        {"tool_path.legs[0].by": [0, -0.2, 0.1]},
    ),
    (lambda s: s.changed(return_to="start", base={"name": "deck"}), {"return": "start", "base.name": "deck"}),
    (lambda s: s.changed(tool=Tool(max_speed_m_s=0.1)), {"tool.max_speed_m_s": 0.1}),
    (lambda s: s.changed(start=PostureFile(stow=True)), {"start": {"stow": True}}),
    (lambda s: s.changed(start=None), {"start": None}),
    (
        lambda s: s.changed(obstacles=(*s.obstacles, ObstacleFile(name="ball", sphere=0.2, xyz=(4, 4, 4)))),
        {"obstacles": [BLOCK, {"name": "ball", "sphere": 0.2, "xyz": [4, 4, 4]}]},
    ),
    (lambda s: s.changed(guardrail=GuardrailFile(bays=0)), {"guardrail": {"bays": 0}}),
    (
        lambda s: s.changed(frames={"c": MountFile(xyz=(1, 1, 1), rpy_deg=(0, 0, 0))}),
        {"frames": {"c": {"xyz": [1, 1, 1], "rpy_deg": [0, 0, 0]}}},
    ),
]


@pytest.mark.parametrize(("edit", "values"), EDITS)
def test_an_edit_is_the_scene_of_the_edited_file(
    edit: Callable[[Scene], Scene], values: dict[str, Any]
) -> None:
    data = {**SHORT, "obstacles": [BLOCK]}
    before, after = load_scene(data), edit(load_scene(data))
    expected = edited(data, values)
    assert after == expected != before
    assert after.content_hash == expected.content_hash
    np.testing.assert_array_equal(after.posture, expected.posture)
    assert load_scene(data) == before


def test_other_strokes_are_those_of_the_edited_file() -> None:
    scene = strokes_scene()
    there, back = scene.strokes
    data = scene.as_data()["tool_path"]["strokes"]
    assert scene.with_strokes((back, there)) == edited(
        scene.as_data(), {"tool_path": {"strokes": data[::-1]}}
    )
    own = there.changed(start_pose=back.start_pose)
    path = {"strokes": [{**data[0], "from": data[1]["from"]}, data[1]], "order": "best"}
    assert scene.with_strokes((own, back), "best") == edited(scene.as_data(), {"tool_path": path})
    # A single one called work is written as a path without strokes.
    alone = short_scene().strokes
    assert "strokes" not in short_scene().as_data()["tool_path"]
    assert scene.with_strokes(alone).strokes == alone


def test_a_mount_is_that_of_the_edited_file(urdf_folder: Path) -> None:
    robot = {
        "model": str(urdf_folder / "cmbot.urdf"),
        "base_frame": "arm_base",
        "tool_frame": "tool0",
        "limits": str(urdf_folder / "joint_limits.yaml"),
        "mount": {"xyz": [0, 0.5, 0], "rpy_deg": [180, 0, 17]},
    }
    scene = short_scene(robot=robot)
    assert load_scene(scene.as_data()) == scene
    mount = MountFile(xyz=(0, 0, 1), rpy_deg=(180, 0, 30))
    expected = edited(scene.as_data(), {"robot.mount": {"xyz": [0, 0, 1], "rpy_deg": [180, 0, 30]}})
    assert scene.with_mount(mount) == expected
    assert scene.with_mount(None).robot.mount is None


def test_postures_are_kept_to_the_last_digit() -> None:
    scene, rng = short_scene(), np.random.default_rng(3)
    for q in rng.normal(size=(50, 7)):
        held = scene.with_posture(q)
        np.testing.assert_array_equal(held.posture, q)
        np.testing.assert_array_equal(load_scene(held.as_data()).posture, q)


def test_a_guardrail_has_one_truth() -> None:
    """Its stiffness, its feet and its obstacles are those of the same guardrail."""
    scene = short_scene(guardrail={"hold": {"kind": "magnet", "adhesion_n": 5000}})
    block = {"bays": 2, "post_spacing_m": 1.0, "hold": {"kind": "clamp"}}
    other = scene.changed(guardrail=GuardrailFile(bays=2, post_spacing_m=1.0, hold={"kind": "clamp"}))  # type: ignore[arg-type]
    expected = short_scene(guardrail=block)
    assert other == expected
    for mine, theirs in ((other, expected), (scene, scene)):
        np.testing.assert_array_equal(
            elastic_base(mine.elastic_guardrail).stiffness, elastic_base(theirs.elastic_guardrail).stiffness
        )
    assert [foot.kind for foot in other.feet] == [foot.kind for foot in robot_of(other).feet] == ["clamp"]
    assert [one.name for one in other.all_obstacles] == [*GuardrailFile(bays=2).member_names]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda s: s.changed(name="no name"), "name: got 'no name', expected 1 to 100 letters"),
        (lambda s: s.changed(return_to="home"), "return: got 'home', expected a known value"),
        (lambda s: s.changed(tool={"speed": 1}), "tool.speed: got an unknown key"),
        (
            lambda s: s.changed(obstacles=({"name": "post_1", "sphere": 1, "xyz": (0, 0, 9)},)),
            (r"obstacles\[0\].name: got 'post_1', expected a name that no other"),
        ),
        (lambda s: s.with_posture([np.nan]), r"start.posture\[0\]: got nan, expected a finite number"),
        (lambda s: s.with_strokes(()), "tool_path.strokes: got .*, expected a list of 1 or more items"),
        (
            lambda s: s.with_stance(StanceFile(foot_1=FootholdFile(member="post_1", along_m=0.01))),
            ("stance.foot_1.along_m: got 0.01, expected above clamp_m"),
        ),
        (lambda s: s.with_options({"knots": "fixed"}), "planner: got dict, expected PlannerOptions"),
        (lambda s: s.with_mount(MountFile(xyz=(0, 0, 0), rpy_deg=(0, 0, 0))), "mount: got .*model: cmbot"),
    ],
)
def test_an_edit_is_refused_as_the_edited_file_is(edit: Callable[[Scene], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        edit(short_scene())


def test_nothing_goes_past_the_checks() -> None:
    scene = short_scene()
    with pytest.raises(TypeError):
        replace(scene, name="other")  # type: ignore[type-var]
    with pytest.raises(ValueError, match="frozen"):
        scene.name = "other"
    with pytest.raises(InputError, match="no such option"):
        scene.with_options(no_such_option=1)


def test_a_plan_of_an_edited_scene_is_read_back(tmp_path: Path) -> None:
    scene = short_scene(obstacles=[BLOCK])
    legs = (replace(scene.strokes[0].legs[0], by=(0.0, -0.2, 0.0), seconds=3.0),)
    # Where the ball stands does not matter.
    ball = ObstacleFile(name="ball", sphere=0.2, xyz=(4.0, 4.0, 4.0))
    edited = scene.with_path(legs=legs, via_points=7).changed(obstacles=(ball,))
    save(plan(edited), tmp_path / "plan")
    again = load_plan(tmp_path / "plan", verify=True).scene
    assert again == edited != scene
    assert again.content_hash == edited.content_hash
    assert again.source == str(tmp_path / "plan" / "plan.json")


def test_files_count_as_they_were_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, rock = tmp_path / "rock.stl", {"name": "rock", "mesh": "rock.stl", "xyz": [9, 9, 9]}
    mesh.write_text("rock")
    monkeypatch.chdir(tmp_path)
    scene = load_scene({**SHORT, "obstacles": [rock]})
    before, loaded = scene.content_hash, scene.with_payload(1)
    mesh.write_text("another")
    assert (scene.content_hash, loaded.with_payload(0).content_hash) == (before, before)
    assert pickle.loads(pickle.dumps(scene)).content_hash == before
    assert load_scene({**SHORT, "obstacles": [rock]}).content_hash != before
    assert short_scene().changed(obstacles=[rock]) == scene
    with pytest.raises(SceneError) as caught:
        scene.with_source("mine.yaml").changed(obstacles=[{**rock, "mesh": "no.stl"}])
    assert (caught.value.source, caught.value.key) == ("mine.yaml", "obstacles[0].mesh")


def test_an_option_that_is_none_is_named() -> None:
    with pytest.raises(InputError, match=r"compensat: no such option, expected .*did you mean compensate\?"):
        load_scene("triangle").with_options(compensat=True)
