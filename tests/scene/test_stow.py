"""A scene whose arm begins or ends stowed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_scenes import SHORT

from cmbot.common.errors import SceneError
from cmbot.robot import Robot
from cmbot.scene import Scene, load_scene

STOWED: dict[str, Any] = SHORT | {"start": {"stow": True}}


@pytest.fixture(scope="module")
def stowed() -> Scene:
    return load_scene(STOWED | {"return": "stow"})


def test_a_stowed_start_is_the_group_state(stowed: Scene, cmbot_robot: Robot) -> None:
    np.testing.assert_array_equal(stowed.posture, cmbot_robot.group_states["stow"])
    assert not stowed.posture.flags.writeable
    assert (stowed.posture_key, stowed.return_to) == ("start.stow", "stow")
    left_out = load_scene({key: STOWED[key] for key in STOWED if key != "start"})
    np.testing.assert_array_equal(left_out.posture, stowed.posture)
    assert left_out.return_to == "none"
    assert left_out.posture_key == "start"


def test_it_is_written_as_it_was_read_unless_python_changes_it(stowed: Scene) -> None:
    data = stowed.as_data()
    assert (data["start"], data["return"]) == ({"stow": True}, "stow")
    other = stowed.with_posture(stowed.posture + 0.01).changed(return_to="start")
    assert (other.start.posture, other.return_to) == (tuple(stowed.posture + 0.01), "start")
    np.testing.assert_array_equal(other.changed(start=None).posture, stowed.posture)


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
