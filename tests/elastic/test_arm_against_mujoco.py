"""MuJoCo, given the same springs' joints and the same pieces, finds the same mass matrix and bias forces."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from elastic_robots import FloatArray, make_arm, mass_matrix, random_base, random_robot
from numpy.testing import assert_allclose

from cmbot.elastic.arm import ElasticArm, cut_inertia
from cmbot.robot import Robot

AXES = np.eye(3)
SLIDE, HINGE = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE


class Twin:
    """Bodies with several joints each, straight from the robot and its tubes."""

    def __init__(self, arm: ElasticArm) -> None:
        self.arm, robot = arm, arm.robot
        self.spec = mujoco.MjSpec()
        self.spec.option.gravity = robot.model.gravity.linear
        self.inertias: list[Any] = []
        body = self.spec.worldbody
        if arm.base is not None:
            body = self._body(body, pin.SE3.Identity(), robot.model.inertias[0])
            for kind in (SLIDE, HINGE):
                for axis in AXES:
                    body.add_joint(type=kind, axis=axis)
        X = pin.SE3.Identity()  # from the last body to the link it stands for
        links = {robot.model.frames[robot.model.getFrameId(k)].parentJoint: k for k in robot.elasticity}
        for i in range(1, robot.model.njoints):
            pieces, frames = _pieces(arm, i, links.get(i))
            body = self._body(body, X * robot.model.jointPlacements[i], pieces[0])
            body.add_joint(type=HINGE, axis=_axis(robot, i))
            X = pin.SE3.Identity()
            for piece, X_JT in zip(pieces[1:], frames, strict=True):
                body = self._body(body, X * X_JT, X_JT.actInv(piece))
                for kind, axes in ((SLIDE, AXES[1:]), (HINGE, AXES)):
                    for axis in axes:
                        body.add_joint(type=kind, axis=axis)
                X = X_JT.inverse()
        self.model = self.spec.compile()
        # Past the compiler, which refuses flat bodies and rounding.
        for index, inertia in enumerate(self.inertias, start=1):
            moments, axes = np.linalg.eigh(inertia.inertia)
            axes[:, 2] *= np.linalg.det(axes)
            self.model.body_mass[index] = inertia.mass
            self.model.body_ipos[index] = inertia.lever
            self.model.body_inertia[index] = moments
            mujoco.mju_mat2Quat(self.model.body_iquat[index], axes.ravel())
        self.data = mujoco.MjData(self.model)
        # What the compiler concluded from its inertias. (mj_setConst would warn of small pieces.)
        self.model.body_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        self.model.body_simple[:] = self.model.dof_simplenum[:] = 0
        # A chain: below every body hangs what follows.
        self.model.body_subtreemass[:] = np.cumsum(self.model.body_mass[::-1])[::-1]

    def _body(self, parent: Any, X: Any, inertia: Any) -> Any:
        self.inertias.append(inertia)
        x, y, z, w = pin.Quaternion(X.rotation).coeffs()
        return parent.add_body(
            pos=X.translation, quat=[w, x, y, z], mass=1, inertia=[1, 1, 1], explicitinertial=True
        )

    def mass_and_bias(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        self.data.qpos, self.data.qvel = q, v
        # No more than is asked for: mj_forward also divides by the mass matrix, and warns of small pieces.
        make_mass_matrix = getattr(mujoco, "mj_makeM", mujoco.mj_crb)
        for step in (mujoco.mj_kinematics, mujoco.mj_comPos, make_mass_matrix, mujoco.mj_comVel):
            step(self.model, self.data)
        M, bias = np.empty((self.model.nv, self.model.nv)), np.empty(self.model.nv)
        for column, unit in zip(M, np.eye(self.model.nv), strict=True):
            mujoco.mj_mulM(self.model, self.data, column, unit)
        mujoco.mj_rne(self.model, self.data, 0, bias)
        return M, bias


def _axis(robot: Robot, joint: int) -> FloatArray:
    """Axis of a joint in its own frame, by a small turn."""
    q = np.zeros(robot.dof)
    q[joint - 1] = 0.5
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    turned = data.liMi[joint].rotation
    return np.asarray(pin.log3(robot.model.jointPlacements[joint].rotation.T @ turned) / 0.5)


def _pieces(arm: ElasticArm, joint: int, link: str | None) -> tuple[list[Any], list[Any]]:
    model, n = arm.robot.model, arm.options.segments
    if link is None:
        return [model.inertias[joint]], []
    tube, X = arm.robot.elasticity[link], model.frames[model.getFrameId(link)].placement
    start, end = X.act(np.array(tube.start)), X.act(np.array(tube.end))
    cuts = (np.arange(n) + 0.5) / n
    # Which two axes across the tube are meant is the arm's choice.
    R = _tube_axes(arm, link, joint)
    assert_allclose(R[:, 0], (end - start) / tube.length, atol=1e-12)
    frames = [pin.SE3(R, start + cut * (end - start)) for cut in cuts]
    return cut_inertia(model.inertias[joint], start, end, cuts), frames


def _tube_axes(arm: ElasticArm, link: str, joint: int) -> FloatArray:
    first = arm.model.getJointId(f"{link} segment 1 deflection y")
    return np.asarray(arm.model.jointPlacements[first].rotation)


@pytest.fixture(params=["cmbot", "cmbot, rigid hold", "random"])
def arm(
    request: pytest.FixtureRequest, cmbot_robot: Robot, tmp_path: Path, rng: np.random.Generator
) -> ElasticArm:
    if request.param == "random":
        return make_arm(random_robot(tmp_path, rng, 6), random_base(rng), segments=2)
    return make_arm(cmbot_robot, random_base(rng) if request.param == "cmbot" else None)


def test_mass_matrix_and_bias_forces(arm: ElasticArm, rng: np.random.Generator) -> None:
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
