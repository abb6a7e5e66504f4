"""``robot.locked``: where joints are that are not the arm's, such as a lift below it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import refusal, run
from rail_arms import POSTURE, rail_data
from robot_files import replace

import cmbot
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import Sag
from cmbot.planning import precheck_scene, rigid_parts_remark, robot_of, verdict
from cmbot.robot import Kinematics
from cmbot.scene import load_scene


def on_locked_rail(folder: Path, **locked: float) -> cmbot.Scene:
    """The arm behind its rail, whose root link is at the origin of W."""
    data: dict[str, Any] = rail_data(folder, {"start": {"posture": list(POSTURE[1:])}})
    robot = {name: value for name, value in data["robot"].items() if name != "mount"}
    data["robot"] = robot | {"base_frame": "rail_link"} | ({"locked": locked} if locked else {})
    return load_scene({name: value for name, value in data.items() if name != "obstacles"})


def test_the_arm_is_where_its_rail_is_locked(tmp_path: Path) -> None:
    scenes = [on_locked_rail(tmp_path), on_locked_rail(tmp_path, rail=0.3)]
    at = [Kinematics(robot_of(scene)).tool_pose(np.array(POSTURE[1:])).translation for scene in scenes]
    np.testing.assert_allclose(at[1] - at[0], [0, 0.3, 0], atol=1e-12)
    assert any("is locked at 0.3 m" in remark for remark in robot_of(scenes[1]).remarks)
    # The second engine, which reads the URDF anew, has it there, too.
    folder = cmbot.save(cmbot.plan(scenes[1], progress=False), tmp_path / "plan")
    assert cmbot.load_plan(folder, verify=True, scene=scenes[1]).certificate.holds
    # No message moves the rail: who sends one has to know where it is.
    sent = run("export", folder, "--ros", tmp_path / "job.json", "--quiet")
    assert sent.err == "Not moved, to be there first (rad or m, robot.locked): rail at 0.3.\n"
    told = refusal("export", folder, "--ros", tmp_path / "rail.json", "--joints", "rail")
    assert "--joints: got rail, expected a joint that moves: this one is locked at 0.3" in told
    with pytest.raises(cmbot.ArchiveError, match=r"scene\.robot\.locked: got .*no such key, as asked"):
        cmbot.load_plan(folder, verify=True, scene=scenes[0])


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("rail", 0.8, r"robot\.locked\.rail: got 0\.8, expected its range, -0\.5 to 0\.7"),
        ("rial", 0.1, r"robot\.locked\.rial: got 'rial', expected a joint .*one of: rail"),
        ("pan", 0.1, r"robot\.locked\.pan: got 'pan', .*none of the arm's: .*base_frame: pan_link"),
    ],
)
def test_places_where_no_joint_is_are_refused(name: str, value: float, told: str, tmp_path: Path) -> None:
    with pytest.raises(cmbot.SceneError, match=told):
        robot_of(on_locked_rail(tmp_path, **{name: value}))


def test_the_shipped_robot_has_its_climbing_joints_by_its_stance() -> None:
    with pytest.raises(
        cmbot.SceneError, match=r"robot\.locked: got .*expected no such key beside model: cmbot"
    ):
        load_scene(load_scene("line").as_data() | {"robot": {"locked": {"climb_1": 0.1}}})


def test_a_lift_that_is_locked_is_no_spring(tmp_path: Path) -> None:
    scene = on_locked_rail(tmp_path)
    file = tmp_path / "rail.elasticity.yaml"
    file.write_text("format: cmbot-elasticity/2\njoints: {rail: {stiffness_nm_rad: 1e4}}\n", encoding="utf-8")
    with pytest.raises(
        cmbot.ModelError, match=r"joints\.rail: got a joint that slides, expected .*base\.tube"
    ):
        robot_of(scene)


SPRINGS = [2e5, 2e5, 3e5, 5e4, 4e4, 3e4]


def on_springs(folder: Path, foot_kg: float = 5.0, **robot: object) -> cmbot.Scene:
    """The arm on the carriage of its rail, rail_link, of 6 kg; its foot, `base`, is at the origin of W."""
    data = on_locked_rail(folder, rail=0.1).as_data()
    replace(folder / "rail.urdf", '<mass value="5.0"/>', f'<mass value="{foot_kg}"/>')
    data["robot"] |= robot
    return load_scene(data | {"guardrail": {"bays": 0, "stiffness": SPRINGS}})


def test_what_stands_on_the_floor_is_no_load_of_what_bends(tmp_path: Path) -> None:
    def bent(scene: cmbot.Scene) -> tuple[Any, ElasticArm]:
        robot = robot_of(scene)
        return robot, elastic_arm(robot, elastic_base(scene.elastic_guardrail))

    q = np.array(POSTURE[1:])
    robot, arm = bent(on_springs(tmp_path))
    floor, spared = bent(on_springs(tmp_path, carried_from="rail_link"))
    assert (robot.carrier_mass, floor.carrier_mass) == pytest.approx((11.0, 6.0))
    # The foot's 5 kg, 0.15 m along x, on six springs at the origin.
    more = Sag(arm).at(q[None]).tool[0] - Sag(spared).at(q[None]).tool[0]
    turned = np.cross([0, 5 * 9.81 * 0.15 / SPRINGS[4], 0], Kinematics(robot).tool_pose(q).translation)
    expected = np.array([0, 0, -5 * 9.81 / SPRINGS[2]]) + turned
    np.testing.assert_allclose(more, expected, atol=0.03 * np.linalg.norm(expected))
    # With 3 t in its place nothing is another; unsaid, it sinks by them.
    heavy, loaded = bent(on_springs(tmp_path, foot_kg=3000.0, carried_from="rail_link"))
    np.testing.assert_array_equal(heavy.carrier_torque, floor.carrier_torque)
    np.testing.assert_array_equal(arm_modes(loaded, q).frequencies, arm_modes(spared, q).frequencies)
    assert arm_modes(arm, q).frequencies[2] < 0.99 * arm_modes(spared, q).frequencies[2]


def test_a_plan_without_what_stands_on_the_floor_holds_for_the_second_engine(tmp_path: Path) -> None:
    scene = on_springs(tmp_path, foot_kg=3000.0, carried_from="rail_link")
    plan = cmbot.plan(scene, progress=False)
    folder = cmbot.save(plan, tmp_path / "plan")
    assert cmbot.load_plan(folder, verify=True, scene=scene).certificate.holds
    # The carriage's, at (0.125, 0.1) m.
    still = np.hypot(0.125, 0.1) * 6 * 9.81
    assert f"; the still part adds {still:.1f} Nm." in verdict(plan)


def test_check_says_what_loads_a_base_and_where_it_bends(tmp_path: Path) -> None:
    found = dict(precheck_scene(on_springs(tmp_path)).found)
    assert found["stiffness of the base acts at"] == "(0, 0, 0) m, 0.173 m from rail_link"
    assert (
        "5 kg before rail_link count as load of the base: base (5 kg); robot.carried_from leaves out what "
        "stands on the floor."
    ) in found["bending"]
    # The frame of the root link is W.
    beside = "The base bends at the origin of W, 0.17 m from the arm's base at (0.1, 0.1, 0.1) m: "
    assert beside in found["bending"]
    for first in ("base", "rail_link"):
        scene = on_springs(tmp_path, carried_from=first)
        assert " as load " not in rigid_parts_remark(scene, robot_of(scene))
    with pytest.raises(cmbot.SceneError, match=r"carried_from: got 'pan_link', .*one of: base, rail_link\)"):
        robot_of(on_springs(tmp_path, carried_from="pan_link"))


def test_check_warns_of_a_rail_whose_place_is_not_given(tmp_path: Path) -> None:
    unplaced, placed = (
        load_scene(scene.as_data() | {"guardrail": {"bays": 0}})
        for scene in (on_locked_rail(tmp_path), on_locked_rail(tmp_path, rail=0.0))
    )
    (warning,) = precheck_scene(unplaced).warnings
    assert (warning.key, warning.got) == ("robot.locked.rail", "nothing")
    assert not precheck_scene(placed).warnings


HERE = {"xyz": [0, 0, 0], "rpy_deg": [0, 0, 0]}


@pytest.mark.parametrize(
    ("given", "missing", "acts"),
    [
        ({}, ["robot.mount", "robot.carried_from"], "0.173 m from rail_link"),
        ({"mount": HERE}, ["robot.carried_from"], "at rail_link"),
        ({"mount": HERE | {"xyz": [0, 0, 0.4]}}, ["robot.carried_from"], "0.4 m below rail_link"),
        ({"carried_from": "base"}, ["robot.mount"], "0.173 m from rail_link"),
        ({"mount": HERE, "carried_from": "rail_link"}, [], "at rail_link"),
    ],
)
def test_check_warns_where_a_stiffness_below_a_lift_is_not_said_to_be(
    given: dict[str, object], missing: list[str], acts: str, tmp_path: Path
) -> None:
    checked = precheck_scene(on_springs(tmp_path, **given))
    assert [warning.key for warning in checked.warnings] == missing
    assert dict(checked.found)["stiffness of the base acts at"] == f"(0, 0, 0) m, {acts}"
    for warning in checked.warnings:
        assert "rail is locked before the arm" in warning.got
        first = "rail_link " if warning.key == "robot.carried_from" else "mount: {xyz: [0, 0, 0], rpy_deg: [0"
        assert warning.expected.startswith(first)


def test_a_rail_that_stands_on_nothing_heavy_needs_no_word(tmp_path: Path) -> None:
    (warning,) = precheck_scene(on_springs(tmp_path, foot_kg=0.0)).warnings
    assert warning.key == "robot.mount"
