"""Mounts among which `cmbot stand` chooses: their poses, and what is refused."""

from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene

import cmbot
from cmbot.common.errors import SceneError

POSTURE = {"posture_deg": [0, -45, 0, -135, 0, 90, 45]}


def of(*mounts: dict[str, Any]) -> Any:
    data = short_scene().as_data() | {
        "robot": {"model": "panda", "base_frame": "panda_link0", "tool_frame": "panda_hand_tcp"},
        "guardrail": {"bays": 0},
        "start": POSTURE,
        "mounts": list(mounts),
    }
    return cmbot.load_scene(data)


def test_poses_over_an_area_and_along_a_rail() -> None:
    grid = {"origin": [1, 2, 0], "u": [1, 0, 0], "v": [0, 0, 2], "count": [3, 2]}
    rail = {"origin": [0, 0, 1], "along": [0, 3, 0], "count": 4}
    scene = of({"grid": grid, "rpy_deg": [0, 0, 90]}, {"rail": rail}, {"xyz": [5, 6, 7]})
    over, along, alone = ([*mounts.each] for mounts in scene.mounts)
    corners = {mount.xyz for mount in over}
    assert len(over) == len(corners) == 6
    assert {(1.0, 2.0, 0.0), (2.0, 2.0, 0.0), (1.0, 2.0, 2.0), (1.5, 2.0, 2.0)} < corners
    np.testing.assert_allclose(over[0].matrix[:3, 0], [0, 1, 0], atol=1e-12)
    assert [mount.xyz for mount in along] == [(0.0, float(k), 1.0) for k in range(4)]
    assert [mount.xyz for mount in alone] == [(5.0, 6.0, 7.0)]
    assert cmbot.load_scene(scene.as_data()) == scene


@pytest.mark.parametrize(
    ("mounts", "said"),
    [
        ({"rpy_deg": [0, 0, 0]}, "got none, expected exactly one of these keys"),
        ({"xyz": [0, 0, 0], "rail": {"origin": [0, 0, 0], "along": [1, 0, 0], "count": 2}}, "xyz and rail"),
        ({"xyz": [0, 0, 0], "stiffness": [1, 1, 1, 1, 1, -1]}, "symmetric positive definite"),
        ({"xyz": [0, 0, 0], "stiffness": [1, 1]}, "6 rows of 6 numbers"),
        ({"rail": {"origin": [0, 0, 0], "along": [0, 0, 0], "count": 2}}, "a leg longer than a micrometre"),
        ({"rail": {"origin": [0, 0, 0], "along": [1, 0, 0], "count": 0}}, "count"),
    ],
)
def test_what_is_no_mount(mounts: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        of(mounts)


def test_the_shipped_robot_has_feet() -> None:
    with pytest.raises(SceneError, match="no such key with model: cmbot"):
        short_scene(mounts=[{"xyz": [0, 0, 0]}])
