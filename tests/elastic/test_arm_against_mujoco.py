"""MuJoCo, given the same springs' joints and the same pieces, finds the same mass matrix and bias forces."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from elastic_in_mujoco import Twin
from elastic_robots import make_arm, mass_matrix, random_base, random_robot
from numpy.testing import assert_allclose

from cmbot.robot import Robot


@pytest.mark.parametrize("name", ["cmbot", "cmbot, rigid hold", "random"])
def test_mass_matrix_and_bias_forces(
    cmbot_robot: Robot, tmp_path: Path, rng: np.random.Generator, name: str
) -> None:
    if name == "random":
        arm = make_arm(random_robot(tmp_path, rng, 6), random_base(rng), segments=2)
    else:
        arm = make_arm(cmbot_robot.with_rigid_joints, random_base(rng) if name == "cmbot" else None)
    twin = Twin(arm)
    assert twin.model.nv == arm.model.nv
    data = arm.model.createData()
    for _ in range(10):
        q = arm.configuration(
            rng.uniform(-2, 2, len(arm.driven)), rng.normal(scale=0.1, size=len(arm.elastic))
        )
        v = rng.normal(size=arm.model.nv)
        M, bias = twin.mass_and_bias(q, v)
        assert_allclose(mass_matrix(arm.model, q), M, rtol=0, atol=1e-10 * np.abs(M).max())
        ours = pin.nonLinearEffects(arm.model, data, q, v)
        assert_allclose(ours, bias, rtol=0, atol=1e-10 * np.abs(bias).max())
