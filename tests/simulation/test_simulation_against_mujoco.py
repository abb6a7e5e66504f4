"""The same bodies, joints and springs in MuJoCo: the tool goes the same way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from elastic_in_mujoco import Twin
from small_motions import arm_on_its_guardrail, swing, tool_points

from cmbot.elastic.generalized_alpha import ElasticSystem, GeneralizedAlpha
from cmbot.elastic.sag import Sag
from cmbot.robot import JointElasticity, Kinematics, Robot

OUTPUT = 0.02
NONE, FORCE = (0.0, 0.0, 0.0), (40.0, -60.0, -300.0)


@pytest.mark.parametrize(
    ("initial", "segments", "seconds", "step", "force", "joints"),
    # The arm that is let go shakes at hundreds of hertz, too: both need finer steps.
    [
        ("equilibrium", 1, 4.0, 4e-4, NONE, None),
        ("equilibrium", 2, 2.0, 2e-4, NONE, None),
        ("undeformed", 1, 1.0, 1e-4, NONE, None),
        ("equilibrium", 1, 1.0, 2e-4, FORCE, None),
        ("equilibrium", 1, 1.0, 1e-4, NONE, JointElasticity(stiffness=5e4)),
        ("equilibrium", 1, 1.0, 1e-4, NONE, JointElasticity(stiffness=5e4, damping=40.0, tilting=2e5)),
    ],
)
def test_mujoco_moves_the_tool_alike(
    cmbot_robot: Robot,
    initial: str,
    segments: int,
    seconds: float,
    step: float,
    force: tuple[float, float, float],
    joints: JointElasticity | None,
) -> None:
    """The joints swinging, undamped but for their own damping: within 0.01 mm of millimetres of vibration."""
    springs = {} if joints is None else dict.fromkeys(cmbot_robot.joints, joints)
    robot = replace(cmbot_robot, tool_force=force, joint_elasticity=springs)
    arm, driven = arm_on_its_guardrail(robot, segments), swing(seconds)
    still = np.zeros(len(arm.elastic))
    start = Sag(arm).at(driven.states([0.0])[0]).u[0] if initial == "equilibrium" else still
    system = ElasticSystem.of(arm, arm.damping)
    integrator = GeneralizedAlpha(system, step=step, rho_inf=0.8, corrections=2, tolerance=1e-8)
    motion = integrator.run([driven], start, still)
    every = round(OUTPUT / step)
    ours = tool_points(arm, motion.joints[::every], motion.u[::every])

    twin = Twin(arm, timestep=step / 2)
    theirs = twin.drive(driven.states, start, steps=round(2 * seconds / step), every=2 * every)
    assert np.abs(ours - theirs).max() < 1e-5

    # It was not the rigid motion that was compared.
    q = motion.joints[::every]
    sag = Sag(arm).at(q).tool
    dynamic = ours - Kinematics(cmbot_robot).tool_poses(q)[0] - sag
    assert np.abs(sag).max() > 5e-3
    assert np.abs(dynamic).max() > 1e-3
