"""A scene whose arm begins or ends stowed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from minimal_scenes import MINIMAL
from small_scenes import SHORT

from cmbot.common.errors import InputError, SceneError
from cmbot.robot import Robot
from cmbot.scene import Scene, load_scene, scene_from_file, update_file

STOWED: dict[str, Any] = {key: SHORT[key] for key in SHORT if key != "posture_deg"}
STOWED |= {"format": "cmbot-scene/2", "start": {"stow": True}}


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
    older = load_scene(SHORT)
    assert update_file(replace(older, return_to="start")).file.format == "cmbot-scene/2"


@pytest.mark.parametrize(
    ("changes", "key", "expected"),
    [
        ({"start": {"stow": False}}, "start.stow", "True"),
        ({"start": {"stow": True, "posture_deg": [0.0]}}, "start", "exactly one of these keys"),
        ({"start": {}}, "start", "exactly one of these keys"),
        ({"return": "home"}, "return", ""),
        ({"return": True}, "return", ""),
        ({"format": "cmbot-scene/1", "posture_deg": [0.0], "return": "stow"}, "return", "no such key"),
    ],
)
def test_what_means_nothing_is_refused(changes: dict[str, Any], key: str, expected: str) -> None:
    given = STOWED | changes
    if "posture_deg" in changes:
        del given["start"]
    with pytest.raises(SceneError) as caught:
        load_scene(given)
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


def test_without_a_posture_the_first_format_is_refused() -> None:
    with pytest.raises(SceneError, match="posture_deg: got nothing"):
        load_scene({key: value for key, value in MINIMAL.items() if key != "posture_deg"})
