"""Locked joints below an arm: what they hold, by inverse dynamics of the whole robot."""

from pathlib import Path

import numpy as np
import pinocchio as pin

from cmbot import load_robot, load_scene
from cmbot.common.installation import model_folder
from cmbot.planning import robot_of
from cmbot.robot import Climber, Dynamics, JointLimits, load_climbing_robot


def test_they_hold_what_inverse_dynamics_of_all_joints_asks(rng: np.random.Generator) -> None:
    """All joints of the URDF move in this model; those that are locked have no rates in it."""
    robot = load_robot()
    assert [joint.name for joint in robot.holding_joints] == ["climb_1", "climb_2"]
    whole = pin.buildModelFromUrdf(str(model_folder() / "urdf" / "cmbot.urdf"))
    limits: JointLimits = robot.limits
    q = rng.uniform(limits.lower, limits.upper, (5, robot.dof))
    v, a = rng.normal(size=(2, 5, robot.dof))
    found = robot.holding_torque(Dynamics(robot).efforts(q, v, a).guardrail_wrench)
    all_q, all_v, all_a = (np.zeros((5, whole.nv)) for _ in range(3))
    for k, name in enumerate(robot.joints):
        index = whole.joints[whole.getJointId(name)].idx_q
        all_q[:, index], all_v[:, index], all_a[:, index] = q[:, k], v[:, k], a[:, k]
    for k, angle in enumerate(Climber().working, start=1):
        all_q[:, whole.joints[whole.getJointId(f"climb_{k}")].idx_q] = angle
    data = whole.createData()
    for row, state in enumerate(zip(all_q, all_v, all_a, strict=True)):
        torque = pin.rnea(whole, data, *state)
        held = [torque[whole.joints[whole.getJointId(name)].idx_v] for name in ("climb_1", "climb_2")]
        # The joint drives the arm; the arm loads it by the opposite.
        np.testing.assert_allclose(found[row], -np.array(held), rtol=1e-9, atol=1e-9)


def test_where_it_stands_changes_nothing_but_gravity(rng: np.random.Generator) -> None:
    scene = load_scene("triangle")
    moved = load_scene(
        scene.as_data() | {"guardrail": {"stance": {"foot_1": {"member": "post_4", "along_m": 1.10}}}}
    )
    one, other = robot_of(scene), robot_of(moved)
    q = scene.posture[None]
    each = [r.holding_torque(Dynamics(r).static_efforts(q).guardrail_wrench) for r in (one, other)]
    np.testing.assert_allclose(each[0], each[1], rtol=1e-9)


def test_a_brake_holds_what_the_limits_file_says(tmp_path: Path) -> None:
    file = tmp_path / "limits.yaml"
    file.write_text("format: cmbot-joint-limits/1\njoints:\n  climb_2: {holding_torque: 123}\n")
    limits = {joint.name: joint.limit for joint in load_robot(limits=file).holding_joints}
    assert limits == {"climb_1": 200.0, "climb_2": 123.0}


def test_an_arm_on_its_root_has_none() -> None:
    assert load_climbing_robot(1, np.eye(4), np.zeros(7)).holding_joints == ()
