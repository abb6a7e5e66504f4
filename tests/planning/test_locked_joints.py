"""``robot.locked``: where joints are that are not the arm's, such as a lift below it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run
from rail_arms import POSTURE, rail_data

import cmbot
from cmbot.planning import robot_of
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
    with pytest.raises(cmbot.ArchiveError, match=r"scene\.robot\.locked: got .*no such key, as asked"):
        cmbot.load_plan(folder, verify=True, scene=scenes[0])


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("rail", 0.8, r"robot\.locked\.rail: got 0\.8, expected its range, -0\.5 to 0\.7"),
        ("rial", 0.1, r"robot\.locked\.rial: got 'rial', expected a joint .*one of: rail"),
        ("pan", 0.1, r"robot\.locked\.pan: got 'pan', expected .*none of the arm's"),
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
