"""Robots that hold no guardrail: a link on pads, such as a cart on three toes or a plate on a wall."""

import re
from typing import Any

import numpy as np
import pytest
from shared_plans import planned

import cmbot
from cmbot.common.errors import SceneError
from cmbot.planning import precheck_scene, robot_of, verdict
from cmbot.planning.verification.hold import hold_checks
from cmbot.robot import Dynamics
from cmbot.scene import Scene

ANGLES = np.radians([90.0, 210.0, 330.0])
TOES = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)]) * 0.2
PADS = [{"disc_m": 0.04, "at_m": toe} for toe in TOES.tolist()]


def held(**hold: Any) -> Scene:
    data = cmbot.load_scene("panda_sanding").as_data()
    return cmbot.load_scene(data | {"base": {"name": "cart", "hold": {"kind": "magnet"} | hold}})


def held_beside(**hold: Any) -> Scene:
    """Of it a little way of the tool, where what is asked is only how it stands."""
    way = {"legs": [{"by": [0, 0.02, 0], "seconds": 2}], "via_points": 5}
    return cmbot.load_scene(held(**hold).as_data() | {"tool_path": way})


def postures(scene: Scene, rng: np.random.Generator) -> Any:
    robot = robot_of(scene).tool_off
    q = rng.uniform(robot.limits.lower, robot.limits.upper, (20, robot.dof))
    return robot, Dynamics(robot).static_efforts(q).guardrail_wrench


def test_the_load_is_that_of_the_whole_robot_about_the_pads(rng: np.random.Generator) -> None:
    robot, wrench = postures(held(pads=PADS, xyz=[0.05, 0.0, -0.1]), rng)
    weight = robot.mass * 9.81
    load = robot.holding.load(0, wrench)
    np.testing.assert_allclose(load[:, :3], np.tile([0, 0, -weight], (20, 1)), atol=1e-6)
    about_base = wrench[:, 3:] + robot.carrier_torque
    np.testing.assert_allclose(
        load[:, 3:], about_base - np.cross([0.05, 0, -0.1], [0, 0, -weight]), atol=1e-6
    )


def test_three_toes_tip_about_the_lines_between_them(rng: np.random.Generator) -> None:
    """As three points, with a little more for their size: the pressing force so that none lifts."""
    robot, wrench = postures(held(pads=PADS), rng)
    load = robot.holding.load(0, wrench)
    shares = np.linalg.inv(np.vstack([np.ones(3), TOES.T]))  # of force and its moments on the toes
    E = np.column_stack([np.zeros(20), load[:, 4], -load[:, 3]])
    points = 3 * -(E @ shares.T).min(axis=1)
    tip = robot.holding.modes(0, wrench)[:, 1] - load[:, 2]
    assert (tip <= points + 1e-9).all()
    assert (tip >= 0.8 * points).all()


@pytest.mark.parametrize("pads", [PADS, [{"rectangle_m": [0.3, 0.1], "turn_deg": 30}]])
def test_a_second_computation_agrees(pads: Any, rng: np.random.Generator) -> None:
    robot, wrench = postures(held(pads=pads, adhesion_n=500, rpy_deg=[90, 0, 0]), rng)
    for check in hold_checks(robot, np.arange(20.0), wrench):
        if check.quantity.startswith("difference"):
            assert check.holds, check


@pytest.mark.parametrize(
    "hold",
    [
        {"pads": [{**pad, "disc_m": 0.06} for pad in PADS], "adhesion_n": 900},
        {
            "kind": "clamp",
            "force_n": [4000] * 3,
            "moment_nm": [800] * 3,
            "pads": [{"rectangle_m": [0.3, 0.2]}],
        },
    ],
)
def test_a_panda_that_stands_on_something_is_planned_and_judged_a_second_time(hold: dict[str, Any]) -> None:
    """It is pressed on by its weight, so that the adhesion that it needs is next to nothing."""
    scene = held_beside(**hold).changed(return_to="none")
    made = planned(scene.with_options(knots="fixed"))
    said = "adhesion needed, safety 2" if "adhesion_n" in hold else "load of the clamp, safety 2"
    assert f"Hold: {said} included, uses " in verdict(made)
    t = np.linspace(0, made.trajectory.duration, 60)
    wrench = Dynamics(made.robot).efforts(*made.trajectory.states(t)).guardrail_wrench
    checks = list(hold_checks(made.robot, t, wrench))
    assert len(checks) == 2
    assert all(check.holds for check in checks), checks


def test_what_two_poles_pull_is_by_the_steel_below() -> None:
    """Two cross sections of the steel, the plate's width across it, at 1.6 MPa."""
    plate = {"plate_m": [0.15, 0.13], "adhesion_n": 6000, "rpy_deg": [90, 0, 0]}
    assert precheck_scene(held(**plate)).warnings == ()
    (thin,) = precheck_scene(held(**plate, steel_mm=6)).warnings
    most = 2 * 0.006 * 0.13 * 2.0**2 / (2 * 4e-7 * np.pi)
    assert thin.key == "base.hold.adhesion_n"
    assert thin.got == f"6000 N, where a magnet of two poles pulls {most:.0f} N at most"


def test_check_says_what_the_pads_bear() -> None:
    weak = held_beside(pads=PADS, adhesion_n=200, friction=0.01, rpy_deg=[90, 0, 0])
    error = precheck_scene(weak).warnings[0]
    assert error.severity == "error" and "where a foot has 200 N" in error.got
    # Where there is no other place none is named.
    assert error.key == "base.hold.adhesion_n"
    assert error.expected.endswith(" at rest")
    elsewhere = weak.changed(mounts=[{"xyz": [0, 0, 0.1]}])
    assert precheck_scene(elsewhere).warnings[0].expected.endswith("another place, which cmbot stand seeks")
    assert any(
        "feet bear" in name for name, _ in precheck_scene(held_beside(pads=PADS, adhesion_n=3000)).found
    )


@pytest.mark.parametrize(
    ("hold", "said"),
    [
        (
            {"link": "panda_link3"},
            r"base.hold.link: got panda_link3, expected a link that the arm's joints do",
        ),
        ({"pads": [{"disc_m": 0.1, "rectangle_m": [1, 1]}]}, r"base.hold.pads\[0\]: .*exactly one"),
        ({"pads": [{"disc_m": 0.01}], "adhesion_n": 5000}, r"base.hold.adhesion_n: .*1.6 MPa on the contact"),
    ],
)
def test_what_cannot_be_held_so(hold: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        robot_of(held(**hold))


def test_beside_a_guardrail_the_feet_are_its_own() -> None:
    data = cmbot.load_scene("triangle").as_data()
    with pytest.raises(SceneError, match=r"base.hold: .*expected guardrail.hold: base.hold"):
        cmbot.load_scene(data | {"base": {"name": "rail", "hold": {"kind": "clamp"}}})


@pytest.mark.parametrize(("roll", "way"), [(0, "onto"), (180, "off")])
def test_a_load_is_told_with_its_direction(roll: float, way: str) -> None:
    """What stands presses on the steel, what hangs pulls off it; a bound that is not given is not told."""
    clamp = {"kind": "clamp", "force_n": [100] * 3, "moment_nm": [800] * 3, "rpy_deg": [roll, 0, 0]}
    error = next(
        each for each in precheck_scene(held_beside(**clamp)).warnings if each.key == "base.hold.force_n"
    )
    assert re.match(rf"\d+ N {way} the steel, times safety 2, where a foot has 100 N$", error.got)
    found = dict(precheck_scene(held_beside(adhesion_n=500)).found)
    assert found["of what the feet bear there, safety included"].endswith("where a foot has 500 N")
