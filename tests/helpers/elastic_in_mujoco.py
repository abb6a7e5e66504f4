"""An elastic arm as a MuJoCo model, straight from the robot and its tubes: another library's dynamics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from cmbot.elastic.arm import ElasticArm, cut_inertia
from cmbot.robot import Robot, turn_axis

FloatArray = NDArray[np.float64]
AXES = np.eye(3)
SLIDE, HINGE = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
# So heavy, kg m2, that nothing but the force that is applied to it moves a driven joint.
DRIVEN_ARMATURE = 1e9
TOOL = "tool"


class Twin:
    """Bodies with several joints each; the coordinates are those of `arm.model`, in the same order.

    With a `timestep` it can be simulated: it has the springs, and inertia that holds the driven joints.
    """

    def __init__(self, arm: ElasticArm, timestep: float | None = None) -> None:
        self.arm, robot = arm, arm.robot
        self.spec = mujoco.MjSpec()
        self.spec.option.gravity = robot.model.gravity.linear
        self.inertias: list[Any] = []
        self.names = iter(arm.model.names[1:])
        self.drives: list[str] = []
        body = self.spec.worldbody
        if arm.base is not None:
            body = self._body(body, pin.SE3.Identity(), robot.model.inertias[0])
            self._add_joints(body, SLIDE, AXES)
            self._add_joints(body, HINGE, AXES)
        X = pin.SE3.Identity()  # from the last body to the link it stands for
        links = {robot.model.frames[robot.model.getFrameId(k)].parentJoint: k for k in robot.elasticity}
        for i in range(1, robot.model.njoints):
            pieces, frames = _pieces(arm, i, links.get(i))
            body = self._body(body, X * robot.model.jointPlacements[i], pieces[0])
            self._add_joints(body, HINGE, [_axis(robot, i)], DRIVEN_ARMATURE if timestep else 0.0)
            self._add_drive(body, i, springs=timestep is not None)
            X = pin.SE3.Identity()
            for piece, X_JT in zip(pieces[1:], frames, strict=True):
                body = self._body(body, X * X_JT, X_JT.actInv(piece))
                self._add_joints(body, SLIDE, AXES[1:])
                self._add_joints(body, HINGE, AXES)
                X = X_JT.inverse()
        tool = X * robot.model.frames[robot.tool_frame_id].placement
        x, y, z, w = pin.Quaternion(tool.rotation).coeffs()
        body.add_site(name=TOOL, pos=tool.translation, quat=[w, x, y, z])
        if robot.pushed:
            self._add_push(robot.tool_force)
        if timestep:
            self.spec.option.timestep = timestep
            self.spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
            self._add_springs()
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

    def _add_joints(self, body: Any, kind: Any, axes: Any, armature: float = 0.0) -> None:
        for axis in axes:
            body.add_joint(name=next(self.names), type=kind, axis=axis, armature=armature)

    def _add_drive(self, body: Any, joint: int, *, springs: bool) -> None:
        """Hinges without drive behind a driven one, with springs of their own, straight from the robot."""
        robot = self.arm.robot
        given = robot.joint_elasticity.get(robot.joints[joint - 1])
        if given is None:
            return
        axis = _axis(robot, joint)
        factor = self.arm.options.joint_factor
        kinds = [(axis, factor * given.stiffness, given.damping)]
        if given.tilting is not None:
            # Which two axes across the joint's are meant is the arm's choice.
            first = self.arm.model.joints[self.arm.model.getJointId(f"{robot.joints[joint - 1]} tilt y")]
            across = np.asarray(turn_axis(first))
            assert abs(across @ axis) < 1e-12
            tilting = factor * given.tilting
            kinds += [(across, tilting, 0.0), (np.cross(axis, across), tilting, 0.0)]
        for direction, stiffness, damping in kinds:
            name = next(self.names)
            self.drives.append(name)
            body.add_joint(
                name=name,
                type=HINGE,
                axis=direction,
                stiffness=stiffness if springs else 0.0,
                damping=damping if springs else 0.0,
            )

    def _add_push(self, force: tuple[float, ...]) -> None:
        """A motor that pushes the tool along its own axes: by 1 times its gear, whatever its control."""
        motor = self.spec.add_actuator(name="push", target=TOOL, trntype=mujoco.mjtTrn.mjTRN_SITE)
        motor.gear = [*force, 0.0, 0.0, 0.0]
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        motor.biasprm[0] = 1.0

    def _add_springs(self) -> None:
        """Springs and masses that couple coordinates: fixed tendons along the matrices' eigenvectors."""
        names = [self.arm.model.names[int(joint) + 1] for joint in self.arm.elastic]
        coupled = np.array([name not in self.drives for name in names])
        held = np.where(coupled[:, None] & coupled, self.arm.stiffness, 0.0)
        for kind, matrix in (("stiffness", held), ("armature", self.arm.added_mass)):
            for value, along in _directions(matrix):
                tendon = self.spec.add_tendon(springlength=[0, 0], **{kind: value})
                for name, share in zip(names, along, strict=True):
                    if share:
                        tendon.wrap_joint(name, share)

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

    def drive(
        self,
        states: Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
        start: FloatArray,
        steps: int,
        every: int,
        ground: Callable[[FloatArray], FloatArray] | None = None,
        damping: FloatArray | None = None,
        observe: Callable[[], FloatArray] | None = None,
    ) -> FloatArray:
        """Let MuJoCo integrate, the driven joints overwritten; tool points (steps/every + 1, 3), m.

        With the acceleration `ground` (N, 3) of what it stands on, it feels another gravity in each step.
        `damping` (f, f) is that of the elastic coordinates, by the rates of the step before. What is not the
        tool point but what `observe` sees is returned where that is given.
        """
        arm, model, data, h = self.arm, self.model, self.data, self.model.opt.timestep
        q, v, a = states(h * np.arange(steps + 1))
        shaken = np.zeros((steps + 1, 3)) if ground is None else ground(h * np.arange(steps + 1))
        qpos, qvel, applied, gravity = data.qpos, data.qvel, data.qfrc_applied, model.opt.gravity
        # The mean acceleration of the step that follows, and what pushes the added mass.
        mean = DRIVEN_ARMATURE * np.concatenate([np.diff(v, axis=0) / h, a[-1:]])
        felt, pushed = np.array(gravity) - shaken, -shaken @ arm.added_mass[:, :3].T
        qpos[arm.elastic] = start
        # Its Euler step is the leapfrog whose rates are half a step behind: so they begin there.
        qpos[arm.driven], qvel[arm.driven] = q[0], v[0]
        applied[arm.driven] = DRIVEN_ARMATURE * a[0]
        mujoco.mj_forward(model, data)
        qvel[arm.elastic] = -0.5 * h * data.qacc[arm.elastic]
        points = list[FloatArray]()
        for k in range(steps + 1):
            qpos[arm.driven], qvel[arm.driven] = q[k], v[k]
            if k % every == 0:
                mujoco.mj_kinematics(model, data)
                points.append(np.array(data.site(TOOL).xpos) if observe is None else observe())
            applied[arm.driven], gravity[:], applied[arm.elastic] = mean[k], felt[k], pushed[k]
            if damping is not None:
                applied[arm.elastic] -= damping @ qvel[arm.elastic]
            mujoco.mj_step(model, data)
        return np.array(points)


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
    first = arm.model.getJointId(f"{link} segment 1 deflection y")
    R = np.asarray(arm.model.jointPlacements[first].rotation)
    assert_allclose(R[:, 0], (end - start) / tube.length, atol=1e-12)
    frames = [pin.SE3(R, start + cut * (end - start)) for cut in cuts]
    return cut_inertia(model.inertias[joint], start, end, cuts), frames


def _directions(matrix: FloatArray) -> Iterator[tuple[float, FloatArray]]:
    """Eigenvalues that are not zero, with eigenvectors; a diagonal keeps its own axes."""
    values, vectors = np.linalg.eigh(matrix)
    for value, vector in zip(values, vectors.T, strict=True):
        if abs(value) > 1e-14 * np.abs(values).max():
            yield value, np.where(np.abs(vector) > 1e-15, vector, 0.0)
