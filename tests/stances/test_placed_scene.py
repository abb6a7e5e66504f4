"""Scenes elsewhere: the tool path stays where it is, and the jobs of several scenes in one."""

from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene

import cmbot
from cmbot.common.errors import SceneError
from cmbot.planning import robot_of, strokes_of
from cmbot.robot import Climber
from cmbot.scene import FootholdFile, Scene, foothold_pose
from cmbot.stances import candidate_at, in_world, joined, put_away, scene_at, stand

LEG = {"by": [0, -0.1, 0], "seconds": 3}
BEGIN = {"xyz": [1.8, 0.68, -1.96], "frame": "world"}
STROKES: dict[str, Any] = {
    "strokes": [
        {"name": "led", "legs": [LEG], "lead_in_m": 0.02, "lead_out_m": 0.03},
        {"name": "next", "legs": [{"by": [0, 0.05, 0], "seconds": 2}]},
        {"name": "back", "legs": [LEG], "backwards": True},
        {"name": "unturned", "from": BEGIN, "legs": [LEG], "passes": 2},
        {"name": "beside", "from": {"xyz": [0, 0, 0.05], "frame": "tool"}, "legs": [LEG]},
        {"name": "through", "waypoints": [[1.8, y, -2, 0, 0, 1, 0] for y in (0.3, 0.35, 0.4)], "seconds": 4},
    ]
}


def scene_of(path: dict[str, Any], **changes: Any) -> Scene:
    scene = short_scene(**changes)
    data = {**scene.as_data(), "tool_path": path}
    return cmbot.load_scene(data)


def places(scene: Scene) -> list[np.ndarray]:
    """Tool points and orientations of all strokes at seven times."""
    found = []
    for stroke in strokes_of(scene, robot_of(scene)):
        poses = stroke.path.poses(np.linspace(0, stroke.path.duration, 7))
        turned = np.broadcast_to(poses.rotation, (7, 3, 3)).reshape(7, 9)
        found.append(np.hstack([poses.point, turned]))
    return found


def test_the_tool_path_stays_where_it_is_wherever_the_robot_stands() -> None:
    scene, climber = scene_of(STROKES), Climber()
    place = FootholdFile(member="post_4", along_m=0.9)
    X = foothold_pose(scene.elastic_guardrail, place)
    moved = scene_at(in_world(scene), candidate_at(place, None, X, climber.hanging(X[:3, :3]), climber), None)
    assert moved.stance.foot[0] > 1
    for here, there in zip(places(scene), places(moved), strict=True):
        np.testing.assert_allclose(there, here, atol=1e-9)


def test_an_arm_comes_from_stow_unless_its_scene_returns_to_its_start() -> None:
    folded = {"posture_deg": [-71, -98, -60, 124, -10, -122, 64]}
    leaves, stays = (scene_of({"legs": [LEG]}, start=folded, **{"return": to}) for to in ("none", "start"))
    assert put_away(leaves).start.stow and put_away(leaves).return_to == "stow"
    assert put_away(stays).start.posture_deg == tuple(folded["posture_deg"])
    assert put_away(stays).return_to == "start"


def test_several_scenes_in_one() -> None:
    lamp = {"name": "lamp", "sphere": 0.1, "xyz": [3, 0, 0]}
    first = scene_of({"legs": [LEG]}, name="first")
    second = scene_of(STROKES, name="second", obstacles=[lamp])
    third = scene_of({"strokes": [{**STROKES["strokes"][3], "name": "led"}]}, name="third", obstacles=[lamp])
    whole = joined([first, second, third])
    names = [stroke.name for stroke in whole.strokes]
    assert names == ["first", "second_led", "next", "back", "unturned", "beside", "through", "third_led"]
    assert [one.name for one in whole.obstacles if one.name == "lamp"] == ["lamp"]
    apart = [place for scene in (first, second, third) for place in places(scene)]
    for here, there in zip(apart, places(whole), strict=True):
        np.testing.assert_allclose(there, here, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"robot": {"payload_kg": 2.0}}, "robot"),
        ({"guardrail": {"hold": {"kind": "clamp"}}}, "guardrail"),
        ({"tool": {"process_force_n": [0, 0, -9]}}, "tool"),
        ({"planner": {"objective": "hold"}}, "planner"),
        ({"obstacles": [{"name": "lamp", "sphere": 0.2, "xyz": [3, 0, 0]}]}, "obstacles.lamp"),
    ],
)
def test_what_scenes_of_a_bridge_have_in_common(changes: dict[str, Any], key: str) -> None:
    lamp = {"name": "lamp", "sphere": 0.1, "xyz": [3, 0, 0]}
    path = {"from": {**BEGIN, "rpy_deg": [0, 180, 0]}, "legs": [LEG]}
    first = scene_of(path, obstacles=[lamp])
    with pytest.raises(SceneError, match=f"{key}: got another one"):
        joined([first, scene_of(path, **{"obstacles": [lamp], **changes})])


def test_no_scene_is_none_to_join() -> None:
    for call in (joined, stand, cmbot.tour):
        with pytest.raises(SceneError, match="scenes: got none, expected one scene or more"):
            call([])
