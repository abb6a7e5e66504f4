"""A scene whose arm begins or ends stowed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_scenes import SHORT

from cmbot.common.errors import InputError, SceneError
from cmbot.robot import Robot
from cmbot.scene import Scene, load_scene, scene_from_file, update_file

STOWED: dict[str, Any] = SHORT | {"start": {"stow": True}}


@pytest.fixture(scope="module")
def stowed() -> Scene:
    return load_scene(STOWED | {"return": "stow"})


def test_a_stowed_start_is_the_group_state(stowed: Scene, cmbot_robot: Robot) -> None:
    np.testing.assert_array_equal(stowed.posture, cmbot_robot.group_states["stow"])
    assert not stowed.posture.flags.writeable
    assert (stowed.file.posture_key, stowed.return_to) == ("start.stow", "stow")
    left_out = load_scene({key: STOWED[key] for key in STOWED if key != "start"})
    np.testing.assert_array_equal(left_out.posture, stowed.posture)
    assert left_out.return_to == "none"
    assert left_out.file.posture_key == "start"


def test_it_is_written_as_it_was_read_unless_python_changes_it(stowed: Scene) -> None:
    assert update_file(stowed).content_hash == stowed.content_hash
    data = stowed.file.as_data()
    assert (data["start"], data["return"]) == ({"stow": True}, "stow")
    again = scene_from_file(type(stowed.file).model_validate_json(stowed.file.model_dump_json()), Path(), "x")
    assert again.content_hash == stowed.content_hash
    other = update_file(replace(stowed, posture=stowed.posture + 0.01, return_to="start"))
    assert (other.file.start.posture, other.file.return_) == (tuple(stowed.posture + 0.01), "start")
    with pytest.raises(InputError, match="return_to"):
        replace(stowed, return_to="home")


@pytest.mark.parametrize(
    ("changes", "key", "expected"),
    [
        ({"start": {"stow": False}}, "start.stow", "True"),
        ({"start": {"stow": True, "posture_deg": [0.0]}}, "start", "exactly one of these keys"),
        ({"start": {}}, "start", "exactly one of these keys"),
        ({"return": "home"}, "return", ""),
        ({"return": True}, "return", ""),
    ],
)
def test_what_means_nothing_is_refused(changes: dict[str, Any], key: str, expected: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene(STOWED | changes)
    assert caught.value.key == key
    assert expected in caught.value.expected


@pytest.mark.parametrize(("start", "key"), [({"start": {"stow": True}}, "start.stow"), ({}, "start")])
def test_an_arm_without_the_group_state(urdf_folder: Path, start: dict[str, Any], key: str) -> None:
    (urdf_folder / "cmbot.srdf").unlink()
    robot = {"model": str(urdf_folder / "cmbot.urdf"), "base_frame": "arm_base", "tool_frame": "tool0"}
    data = {name: STOWED[name] for name in STOWED if name != "start"} | start | {"robot": robot}
    with pytest.raises(SceneError) as caught:
        load_scene(data)
    assert caught.value.key == key
    assert "the arm cmbot, whose SRDF has no group state stow" in str(caught.value)
    assert "start: {posture_deg: [...]}" in str(caught.value)
