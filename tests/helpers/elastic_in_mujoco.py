"""An elastic arm as a MuJoCo model: the same bodies, joints and springs, another library's dynamics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbot.elastic.arm import ElasticArm

FloatArray = NDArray[np.float64]
# So heavy, kg m2, that nothing but the force that is applied to it moves a driven joint.
DRIVEN_ARMATURE = 1e9
TOOL = "tool"
_SPECK = 1e-13


def mujoco_model(arm: ElasticArm, timestep: float) -> Any:
    """Compile the arm; its coordinates are those of `arm.model`, in the same order.

    Springs and masses that couple coordinates are fixed tendons along the eigenvectors of their matrices.
    """
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false", balanceinertia="false")
    gravity = arm.model.gravity.linear
    ET.SubElement(
        root, "option", timestep=repr(timestep), gravity=_text(gravity), integrator="implicitfast"
    ).append(ET.Element("flag", contact="disable", energy="enable"))
    parents = [ET.SubElement(root, "worldbody")]
    for joint in range(1, arm.model.njoints):
        parents.append(_body(parents[arm.model.parents[joint]], arm, joint))
    frame = arm.model.frames[arm.tool_frame_id]
    ET.SubElement(parents[frame.parentJoint], "site", name=TOOL, pos=_text(frame.placement.translation))
    tendons = ET.SubElement(root, "tendon")
    names = [arm.model.names[int(joint) + 1] for joint in arm.elastic]
    for kind, matrix in (("stiffness", arm.stiffness), ("armature", arm.added_mass)):
        for value, along in _directions(matrix):
            tendon = ET.SubElement(tendons, "fixed", springlength="0", **{kind: repr(float(value))})
            for name, share in zip(names, along, strict=True):
                if share:
                    ET.SubElement(tendon, "joint", joint=name, coef=repr(float(share)))
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))


def drive(
    arm: ElasticArm,
    model: Any,
    states: Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
    start: FloatArray,
    steps: int,
    every: int,
) -> FloatArray:
    """Let MuJoCo integrate, the driven joints overwritten; tool points (steps/every + 1, 3), m."""
    data, h = mujoco.MjData(model), model.opt.timestep
    q, v, a = states(h * np.arange(steps + 1))
    data.qpos[arm.elastic] = start
    # Its Euler step is the leapfrog whose rates are half a step behind: so they begin there.
    data.qpos[arm.driven], data.qvel[arm.driven] = q[0], v[0]
    data.qfrc_applied[arm.driven] = DRIVEN_ARMATURE * a[0]
    mujoco.mj_forward(model, data)
    data.qvel[arm.elastic] = -0.5 * h * data.qacc[arm.elastic]
    points = np.empty((steps // every + 1, 3))
    for k in range(steps + 1):
        data.qpos[arm.driven], data.qvel[arm.driven] = q[k], v[k]
        if k % every == 0:
            mujoco.mj_kinematics(model, data)
            points[k // every] = data.site(TOOL).xpos
        # The mean acceleration of the step that follows.
        mean = (v[k + 1] - v[k]) / h if k < steps else a[k]
        data.qfrc_applied[arm.driven] = DRIVEN_ARMATURE * mean
        mujoco.mj_step(model, data)
    return points


def _body(parent: ET.Element, arm: ElasticArm, joint: int) -> ET.Element:
    model = arm.model
    X, inertia = model.jointPlacements[joint], model.inertias[joint]
    kind = model.joints[joint].shortname()
    body = ET.SubElement(
        parent, "body", name=f"body {joint}", pos=_text(X.translation), quat=_text(_quaternion(X.rotation))
    )
    axis = np.eye(3)["XYZ".index(kind[-1])]
    driven = model.joints[joint].idx_v in arm.driven.tolist()
    ET.SubElement(
        body,
        "joint",
        name=model.names[joint],
        type="slide" if "P" in kind.removeprefix("JointModel") else "hinge",
        axis=_text(axis),
        armature=repr(DRIVEN_ARMATURE if driven else 0.0),
    )
    # Between the coordinates of one spring there is nothing; MuJoCo wants at least something.
    I = inertia.inertia + _SPECK * np.eye(3)  # noqa: E741
    entries = (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
    ET.SubElement(
        body,
        "inertial",
        pos=_text(inertia.lever),
        mass=repr(float(inertia.mass + _SPECK)),
        fullinertia=_text(entries),
    )
    return body


def _directions(matrix: FloatArray) -> Iterator[tuple[float, FloatArray]]:
    """Eigenvalues that are not zero, with eigenvectors; a diagonal keeps its own axes."""
    values, vectors = np.linalg.eigh(matrix)
    for value, vector in zip(values, vectors.T, strict=True):
        if abs(value) > 1e-14 * np.abs(values).max():
            yield value, np.where(np.abs(vector) > 1e-15, vector, 0.0)


def _quaternion(R: FloatArray) -> FloatArray:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).ravel())
    return quaternion


def _text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in numbers)
