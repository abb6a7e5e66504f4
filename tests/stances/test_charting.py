"""What charts say of a stance in which postures of least torque at several via-points are far apart."""

from typing import Any

import pytest

import cmbot
from cmbot.common.errors import PathNotFound
from cmbot.planning import build_request
from cmbot.scene import Scene
from cmbot.stances import candidates_of, in_world, scene_at
from cmbot.stances.charting import bounded_quickly, chart


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The triangle from two places of the top rail; no posture by itself asks more than 120 Nm."""
    triangle = cmbot.load_scene("triangle").as_data()
    triangle["tool_path"]["speed_profile"] = {"kind": "trapezoidal", "ramp": 0.2}
    scene = in_world(cmbot.load_scene(triangle))

    def holds(stance: Any) -> bool:
        return (stance.foot_1.along_m, stance.foot_2.along_m) == (5.59, 6.34)

    (candidate, *_) = (
        each
        for each in candidates_of(scene, 9.0, 0.15, ("top_rail",))
        if each.stance.foot_2 is not None and holds(each.stance)
    )
    return scene_at(scene, candidate, None)


def test_what_charts_say_is_what_denser_charts_find(scene: Scene) -> None:
    quickly, charted = bounded_quickly(scene), chart(scene)
    assert 180 < charted.bound <= charted.expected
    assert quickly == pytest.approx(charted.bound, rel=0.02)
    dense = scene.with_options(chart_spacing=0.1, step_share=1.0)
    assert max(quickly, charted.bound) <= chart(dense).expected <= 1.05 * charted.expected


def test_a_stance_in_the_way_of_something_has_none(scene: Scene) -> None:
    wall = {"name": "wall", "box": [3.0, 0.05, 1.0], "xyz": [2.0, 0.2, -1.9]}
    data = scene.as_data()
    walled = cmbot.load_scene({**data, "obstacles": [*data["obstacles"], wall]})
    for charted in (bounded_quickly, lambda walled: chart(walled)):
        with pytest.raises(PathNotFound, match="wall"):
            charted(walled)


def test_a_stance_in_which_the_arm_cannot_be_put_away(scene: Scene) -> None:
    stowed = cmbot.load_scene({**scene.as_data(), "return": "stow"})
    with pytest.raises(PathNotFound, match="joint_2 cannot hold the arm in its stow posture"):
        bounded_quickly(stowed)
    data = {**scene.as_data(), "return": "stow", "guardrail": {"bays": 4}}
    asked = build_request(cmbot.load_scene(data), scene.planner)
    at = asked.cell.postures.tool_at(asked.end_posture[None]).tool_point[0]
    box = {"name": "box", "box": [0.1, 0.1, 0.1], "xyz": at.tolist()}
    with pytest.raises(PathNotFound, match="in its stow posture comes too near to something"):
        bounded_quickly(cmbot.load_scene({**data, "obstacles": [*data["obstacles"], box]}))
