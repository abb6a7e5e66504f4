"""What charts say of a stance in which postures of least torque at several via-points are far apart."""

from typing import Any

import numpy as np
import pytest

import cmbot
from cmbot.collision import Clearances
from cmbot.common.errors import PathNotFound, PlanningError
from cmbot.planning import FEET, build_request, robot_of
from cmbot.robot import Dynamics
from cmbot.scene import Scene
from cmbot.stances import (
    Rejection,
    StanceRanking,
    StanceResult,
    candidates_of,
    in_words,
    in_world,
    own_candidate,
    require_planned,
    scene_at,
)
from cmbot.stances.charting import CannotBePutAway, bounded_quickly, chart


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
    with pytest.raises(CannotBePutAway, match="joint_2 cannot hold the arm in its stow posture") as caught:
        bounded_quickly(stowed)
    robot = robot_of(stowed)
    torque = Dynamics(robot.tool_off).static_efforts(robot.group_states["stow"][None]).joint_torque
    use = float((np.abs(torque) / robot.limits.torque).max())
    assert caught.value.use == pytest.approx(use)
    # Another posture does.
    drawn = robot.limits.drawn(np.random.default_rng(0), 300)
    each = np.abs(Dynamics(robot.tool_off).static_efforts(drawn).joint_torque) / robot.limits.torque
    clear = Clearances(robot, stowed.all_obstacles)
    holds = (q for q in drawn[each.max(axis=1) < 0.9] if clear.query(q[None]).distance[0] > 0.05)
    other = {"start": {"posture": next(holds).tolist()}, "return": "start"}
    assert bounded_quickly(cmbot.load_scene({**scene.as_data(), **other})) > 0
    # Many stances are left out for that: it is one cause, and what would do is told.
    heavier = CannotBePutAway(caught.value.reason, time=0.0, progress=0.0, smallest_singular_value=1.0)
    heavier.use, heavier.weakest = 9.0, "joint_2"
    own = own_candidate(scene)
    left_out = tuple(
        StanceResult(candidate=own, stage="obstacles", bound=1.0, rejection=Rejection.of("blocked", error))
        for error in (heavier, caught.value)
    )
    ranking = StanceRanking(scene=scene, ranked=left_out)
    cause = "joint_2 cannot hold the arm in its stow posture"
    assert ranking.reasons == [(cause, 2)]
    assert ranking.nearest is left_out[1]
    remedy = (
        f"here {cause}, {use + 0.005:.2f} times what it bears would do, or another start with return: start"
    )
    assert f"W{remedy}." in in_words(ranking)
    with pytest.raises(PlanningError, match=f"; w{remedy}"):
        require_planned([ranking])
    data = {**scene.as_data(), "return": "stow", "guardrail": {"bays": 4}}
    asked = build_request(cmbot.load_scene(data), scene.planner)
    at = asked.cell.postures.tool_at(asked.end_posture[None]).tool_point[0]
    box = {"name": "box", "box": [0.1, 0.1, 0.1], "xyz": at.tolist()}
    with pytest.raises(PathNotFound, match="in its stow posture comes too near to something"):
        bounded_quickly(cmbot.load_scene({**data, "obstacles": [*data["obstacles"], box]}))


def test_of_feet_that_cannot_hold_the_arm_no_least_factor_is_told(scene: Scene) -> None:
    """Others ask little more than the least: half of them ask at least as much as is told."""
    own, each = own_candidate(scene), [Rejection.unheld("they let go", use, FEET) for use in (2.5, 1.01, 2.0)]
    left_out = tuple(StanceResult(candidate=own, stage="obstacles", bound=1.0, rejection=why) for why in each)
    (remedy,) = StanceRanking(scene=scene, ranked=left_out).remedies
    assert (
        remedy == "where they let go, half of 3 stances ask at least 2.00 times what it bears for that alone"
    )
