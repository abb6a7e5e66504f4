"""Locked joints below an arm: what they hold, by inverse dynamics of the whole robot."""

import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_files import replace
from small_scenes import short_scene

from cmbot import load_robot, load_scene
from cmbot.common.errors import PlanningError
from cmbot.common.installation import model_folder
from cmbot.planning import plan, precheck_scene, robot_of
from cmbot.robot import Climber, Dynamics, JointLimits, load_climbing_robot

RAIL = {"member": "top_rail", "turn_deg": 180}
TWO_FEET = {"foot_1": {**RAIL, "along_m": 3.5}, "foot_2": {**RAIL, "along_m": 3.665}}


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
    # What the file leaves out is the URDF's effort, what the joint drives.
    assert limits == {"climb_1": 200.0, "climb_2": 123.0}
    assert load_robot().holding_limits.tolist() == [460.0, 460.0]


def test_on_two_feet_each_leg_bears_what_its_foot_does(rng: np.random.Generator) -> None:
    """All five joints, against inverse dynamics of the whole robot that the rail pushes at foot 2."""
    scene = load_scene(load_scene("triangle").as_data() | {"guardrail": {"stance": TWO_FEET}})
    robot, names = robot_of(scene), [f"climb_{k}" for k in range(1, 6)]
    assert [joint.name for joint in robot.holding_joints] == names
    q = rng.uniform(robot.limits.lower, robot.limits.upper)
    wrench = Dynamics(robot).static_efforts(q[None]).guardrail_wrench
    whole = pin.buildModelFromUrdf(str(model_folder() / "urdf" / "cmbot.urdf"))
    index = {name: whole.joints[whole.getJointId(name)].idx_q for name in (*names, *robot.joints)}
    all_q = pin.neutral(whole)
    all_q[[index[name] for name in (*names, *robot.joints)]] = [*scene.stance.climber, *q]
    R, gravity = scene.stance.root[:3, :3], np.array(robot.model.gravity.linear)
    # In the frame of foot 1, the root.
    whole.gravity.linear = R.T @ gravity
    weight = np.hstack([robot.carrier_mass * gravity, robot.carrier_torque])
    push = -(robot.feet[1].share @ (wrench[0] + weight)).reshape(2, 3) @ R
    data, force = whole.createData(), [pin.Force.Zero() for _ in range(whole.njoints)]
    pin.forwardKinematics(whole, data, all_q)
    foot = whole.frames[whole.getFrameId("foot_2")].parentJoint
    force[foot] = data.oMi[foot].actInv(pin.Force(*push))
    torque = pin.rnea(whole, data, all_q, np.zeros(whole.nv), np.zeros(whole.nv), force)
    held = [torque[whole.joints[whole.getJointId(name)].idx_v] for name in names]
    np.testing.assert_allclose(np.abs(robot.holding_torque(wrench)[0]), np.abs(held), rtol=1e-6)


def test_a_plan_keeps_what_they_hold_and_its_refusal_names_them(urdf_folder: Path) -> None:
    shutil.copy(model_folder() / "urdf" / "joint_limits.yaml", urdf_folder)
    robot = {"model": str(urdf_folder / "cmbot.urdf"), "base_frame": "arm_base", "tool_frame": "tool0"}
    scene = short_scene().as_data() | {"robot": robot | {"joints": "rigid"}, "guardrail": {"bays": 0}}
    made = plan(load_scene(scene))
    t = np.linspace(0.0, made.trajectory.duration, 2001)
    wrench = Dynamics(made.robot).efforts(*made.trajectory.states(t)).guardrail_wrench
    sampled = np.abs(made.robot.holding_torque(wrench)).max(axis=0)
    np.testing.assert_allclose(made.holding_torque, sampled, rtol=1e-4)
    assert (made.holding_torque >= sampled).all()
    replace(urdf_folder / "joint_limits.yaml", "holding_torque: 460", "holding_torque: 90")
    assert "% of what the locked climb_" in precheck_scene(load_scene(scene)).warnings[0].got
    with pytest.raises(PlanningError, match=r"climb_[12]"):
        plan(load_scene(scene))


def test_an_arm_on_its_root_has_none() -> None:
    assert load_climbing_robot(1, np.eye(4), np.zeros(7)).holding_joints == ()
