"""Kinematics, inverse dynamics and the base's wrench by a second engine: MuJoCo, from the URDF by its reader.

MuJoCo gets links, joints and inertias as the file has them, without shapes, which need not be found. No joint
is locked for it: those that are not the arm's rest at their values. So what the base bears is that of the
whole robot, with the foot and all that does not move.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import MissingExtra, ModelError
from cmbot.planning.verification.described_arm import DescribedArm

ENGINE = "mujoco"
"""What has to be installed, and its name on the command line."""
_VERIFY_EXTRA = "verify"
# Names of links and joints that are added; MuJoCo calls the world so.
_BASE, _POINT, _WORLD, _RENAMED = "cmbot base", "cmbot tool point", "world", "cmbot world"
# It has no bodies without mass: kg and kg m2 that are not felt.
_LEAST_MASS, _LEAST_INERTIA = "1e-12", "1e-14"
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_KEPT_ELEMENTS = {"link": ("inertial",), "joint": ("origin", "parent", "child", "axis")}
_READER = {
    **{"fusestatic": "false", "boundmass": _LEAST_MASS, "boundinertia": _LEAST_INERTIA},
    "strippath": "false",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class EngineStates:
    """What MuJoCo finds at N states of an arm of n joints.

    Attributes
    ----------
    tool_point : (N, 3), m
        In W.
    tool_rotation : (N, 3, 3)
    joint_torque : (N, n), Nm, of joints that slide N
        None where it takes the file's inertias for impossible.
    base_force, base_torque : (N, 3), N and Nm
        Wrench of the whole robot on what it stands on, about O0 in W; None as `joint_torque`.
    """

    tool_point: FloatArray
    tool_rotation: FloatArray
    joint_torque: FloatArray | None
    base_force: FloatArray | None
    base_torque: FloatArray | None


def is_installed() -> bool:
    """Return whether the second engine can be asked."""
    return find_spec(ENGINE) is not None


def require_installed() -> None:
    """Refuse to go on without the second engine.

    Raises
    ------
    MissingExtra
        When it is not installed.
    """
    if not is_installed():
        raise MissingExtra(ENGINE, _VERIFY_EXTRA)


def engine_states(
    arm: DescribedArm, motion: tuple[FloatArray, FloatArray, FloatArray], tool_force: tuple[float, ...]
) -> EngineStates:
    """Return what MuJoCo finds at N states.

    Parameters
    ----------
    arm : DescribedArm
    motion : three arrays (N, n)
        Position, velocity and acceleration of the joints.
    tool_force : three floats, N
        That acts on the tool, along its axes.

    Raises
    ------
    ModelError
        When MuJoCo cannot read the URDF.
    """
    import mujoco

    root, has_inertias = _without_shapes(arm), True
    try:
        model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    except ValueError:
        has_inertias = False
        for link in root.findall("link"):
            for inertial in link.findall("inertial"):
                link.remove(inertial)
        try:
            model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
        except ValueError as error:
            got = f"a URDF that MuJoCo cannot read ({error})"
            raise ModelError(str(arm.files.urdf), "", got, "one that it can") from error
    model.opt.gravity = (0.0, 0.0, -9.81)
    data = mujoco.MjData(model)
    _place(model, data, arm)
    body = model.body(_POINT).id
    tool = body if arm.tool == arm.carrier else model.body(arm.tool).id
    dofs = [int(model.joint(name).dofadr[0]) for name in arm.moving]
    slots, (G, offset) = [int(model.joint(name).qposadr[0]) for name in arm.moving], arm.linkage
    N, n = motion[0].shape
    point, rotation = np.empty((N, 3)), np.empty((N, 3, 3))
    tau, wrench, forces = np.empty((N, n)), np.empty((N, 6)), np.empty(model.nv)
    for k, (q, v, a) in enumerate(zip(*motion, strict=True)):
        data.qpos[slots], data.qvel[dofs], data.qacc[dofs] = G @ q + offset, G @ v, G @ a
        for step in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            step(model, data)
        point[k], rotation[k] = data.xpos[tool], data.xmat[tool].reshape(3, 3)
        push, pushed = rotation[k] @ tool_force, np.zeros(model.nv)
        mujoco.mj_applyFT(model, data, push, np.zeros(3), point[k], body, pushed)
        mujoco.mj_rne(model, data, 1, forces)
        tau[k] = (forces - pushed)[dofs] @ G
        mujoco.mj_rnePostConstraint(model, data)
        # Of the first body on the world, torque and force, about the centre of mass.
        torque, force = np.split(-data.cfrc_int[1], 2)
        torque += np.cross(data.subtree_com[1] - arm.foot_point, force)
        wrench[k] = *(force + push), *(torque + np.cross(point[k] - arm.foot_point, push))
    return EngineStates(
        tool_point=point,
        tool_rotation=rotation,
        joint_torque=tau if has_inertias else None,
        base_force=wrench[:, :3] if has_inertias else None,
        base_torque=wrench[:, 3:] if has_inertias else None,
    )


def _without_shapes(arm: DescribedArm) -> ElementTree.Element:
    """The URDF for MuJoCo, below a root of its own, with the tool point and the payload there."""
    root = ElementTree.Element("robot", name="arm")
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", _READER)
    for part in arm.urdf:
        if part.tag in _KEPT_ELEMENTS:
            kept = ElementTree.SubElement(root, part.tag, part.attrib)
            kept.extend(deepcopy(inner) for inner in part if inner.tag in _KEPT_ELEMENTS[part.tag])
    for joint in root.findall("joint"):
        if joint.get("type") in ("floating", "planar"):
            joint.set("type", "fixed")
    for element in root.iter():
        # MuJoCo has a body of that name already.
        for key in ("name", "link"):
            if element.get(key) == _WORLD:
                element.set(key, _RENAMED)
    flange, origin = arm.tool_place
    _add(root, _BASE, above=None, below=_RENAMED if arm.root == _WORLD else arm.root)
    _add(root, _POINT, above=flange, mass=arm.payload, origin=origin)
    return root


def _add(
    root: ElementTree.Element,
    name: str,
    *,
    above: str | None,
    below: str | None = None,
    mass: float = 0.0,
    origin: Mapping[str, str] | None = None,
) -> None:
    """Add a link of a point mass, and the fixed joint to the link `above` it, or to the one `below`."""
    link = ElementTree.SubElement(root, "link", name=name)
    if mass > 0:
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "mass", value=repr(mass))
        ElementTree.SubElement(inertial, "inertia", dict.fromkeys(_INERTIA, "0"))
    joint = ElementTree.SubElement(root, "joint", name=f"{name} joint", type="fixed")
    ElementTree.SubElement(joint, "parent", link=above or name)
    ElementTree.SubElement(joint, "child", link=below or name)
    ElementTree.SubElement(joint, "origin", dict(origin or {}))


def _place(model: Any, data: Any, arm: DescribedArm) -> None:
    """Hold the joints that are not the arm's, and put the robot where it stands."""
    import mujoco

    for name, value in arm.resting.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    X = arm.X_WR
    if arm.X_WB is not None:
        mujoco.mj_kinematics(model, data)
        X_RB, base = np.eye(4), model.body(arm.base).id
        X_RB[:3, :3], X_RB[:3, 3] = data.xmat[base].reshape(3, 3), data.xpos[base]
        X = arm.X_WB @ np.linalg.inv(X_RB)
    if X is not None:
        model.body_pos[1] = X[:3, 3]
        mujoco.mju_mat2Quat(model.body_quat[1], np.ascontiguousarray(X[:3, :3]).ravel())
