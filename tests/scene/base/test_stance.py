"""Where the feet hold: the block guardrail.stance, the climber, and a world that is not O0."""

from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene

from cmbot.common.errors import SceneError
from cmbot.elastic.sag import Sag
from cmbot.planning import bending_arm, robot_of
from cmbot.robot import Climber, Dynamics, Postures
from cmbot.scene import Scene

HERE = {"member": "post_3", "along_m": 1.10}
THERE = {"member": "post_4", "along_m": 1.10}
BELOW = {"member": "post_3", "along_m": 0.35}


def standing(foot_1: dict[str, Any], **stance: Any) -> Scene:
    guardrail = {"stance": {"foot_1": foot_1, **stance}}
    return short_scene(guardrail=guardrail, tool={"process_force_n": [0, 10, -40]})


def test_the_post_in_the_middle_is_where_it_always_was() -> None:
    usual = short_scene()
    scene = standing(HERE)
    assert scene.stance.foot == pytest.approx((0, 0, 0), abs=1e-12)
    one, other = (robot_of(each).model.jointPlacements[1] for each in (usual, scene))
    assert one.isApprox(other, 1e-12)


def test_the_wrench_is_about_the_place_where_foot_1_holds(random_states, rng) -> None:
    here, there = (robot_of(standing(place)) for place in (HERE, THERE))
    assert there.foot_point == pytest.approx((1.75, 0, 0), abs=1e-12)
    states = random_states(here, 5)
    for name in ("efforts", "wrench_derivatives", "derivatives"):
        one, other = (vars(getattr(Dynamics(robot), name)(*states)) for robot in (here, there))
        for key in one:
            np.testing.assert_allclose(one[key], other[key], rtol=1e-9, atol=1e-9, err_msg=key)
    for name in ("guardrail_force", "guardrail_torque", "joint_torque"):
        one, other = (getattr(Postures(robot).at(states[0]), name) for robot in (here, there))
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(here.carrier_torque, there.carrier_torque, atol=1e-9)
    np.testing.assert_allclose(here.feet[0].from_wrench, there.feet[0].from_wrench, atol=1e-12)


def test_the_base_bends_where_it_is_held() -> None:
    usual = short_scene(guardrail={"foot": {"post": 4}})
    usual = usual.changed(tool=standing(HERE).tool)
    q = np.array(usual.posture)[None]
    sags = [Sag(bending_arm(scene, robot_of(scene))).at(q).tool[0] for scene in (usual, standing(THERE))]
    np.testing.assert_allclose(sags[0], sags[1], rtol=1e-6)


def test_a_foot_on_a_rail_hangs_the_base_as_on_a_post() -> None:
    scene = standing({"member": "top_rail", "along_m": 3.0, "turn_deg": 180})
    R = robot_of(scene).model.jointPlacements[1].rotation
    np.testing.assert_allclose(R, robot_of(standing(HERE)).model.jointPlacements[1].rotation, atol=1e-9)


def test_every_posture_of_the_climber_reaches_foot_2(rng) -> None:
    climber, found = Climber(), 0
    for _ in range(40):
        X = np.eye(4)
        X[:3, 3] = rng.uniform(-0.9, 0.9), rng.uniform(-0.02, 0.02), rng.uniform(-0.9, 0.9)
        for angles in climber.reaching(X):
            np.testing.assert_allclose(climber.poses(angles)[0], X, atol=1e-9)
            assert (climber.lower <= angles).all()
            assert (angles <= climber.upper).all()
            found += 1
    assert found > 20


def test_two_feet_share_what_one_would_bear() -> None:
    scene = standing(HERE, foot_2=BELOW)
    first, second = scene.feet
    np.testing.assert_allclose(first.share + second.share, np.eye(6), atol=1e-9)
    foot_2 = Climber().poses(np.array(scene.stance.climber))[0]
    np.testing.assert_allclose((scene.stance.root @ foot_2)[:3, 3], [0, 0, -0.75], atol=1e-9)
    assert scene.as_data()["guardrail"]["stance"]["foot_2"]["along_m"] == 0.35
    holding = robot_of(scene).holding
    assert holding.each(np.zeros((1, 6))).shape == (1, 2)


@pytest.mark.parametrize(
    ("stance", "message"),
    [
        ({"foot_1": {**HERE, "member": "post_9"}}, r"stance.foot_1.member: got 'post_9', expected a rail or"),
        ({"foot_1": {**HERE, "face": "top"}}, r"stance.foot_1.face: got 'top', expected a face of a post"),
        # No choice is close to it: all are named.
        (
            {"foot_1": {**HERE, "face": "under"}},
            r"got 'under', expected a known value \(one of: outer, .*bottom",
        ),
        ({"foot_1": {**HERE, "along_m": 3.0}}, r"stance.foot_1.along_m: got 3.0, expected at most the memb"),
        ({"foot_1": {**HERE, "along_m": 0.01}}, r"stance.foot_1.along_m: got 0.01, expected above clamp_m"),
        ({"foot_1": {**HERE, "turn_deg": 45.0}}, r"stance.foot_1.turn_deg: got 45.0, expected a multiple"),
        ({"foot_1": HERE, "foot_2": "off"}, r"stance.foot_2: got 'off', expected where the foot holds, or"),
        (
            {"foot_1": HERE, "foot_2": THERE},
            r"stance.foot_2: got 'post_4', expected a place that the",
        ),
        (
            {"foot_1": HERE, "climber_deg": [0, 0, 0, 0, 150]},
            r"climber_deg\[4\]: got 150.0, expected an angle",
        ),
        (
            {"foot_1": HERE, "foot_2": BELOW, "climber_deg": [-90, 0, 180, -45, 0]},
            r"climber_deg: got a posture that misses foot_2",
        ),
        (
            {"foot_1": {"member": "top_rail", "along_m": 3.0, "face": "top"}, "foot_2": "free"},
            r"stance.foot_1: .* a place for foot_2, too, or climber_deg: from a top or bottom no base hangs",
        ),
        ({"foot_1": {**HERE, "turn_deg": 90}}, r"stance.foot_1: .* a foot on which the arm's base can hang"),
    ],
)
def test_what_is_refused(stance: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        short_scene(guardrail={"stance": stance})
