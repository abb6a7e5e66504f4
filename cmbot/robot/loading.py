"""From a URDF, its SRDF and its joint-limits file to a `Robot`."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from cmbot.errors import ModelError
from cmbot.resources import model_folder
from cmbot.robot.inspection import inspect_urdf, parse_urdf
from cmbot.robot.limits import JointLimits, read_joint_limits
from cmbot.robot.robot import Robot
from cmbot.robot.tool import attach_payload, set_tool_length

__all__ = ["load_robot"]

FloatArray = NDArray[np.float64]


def load_robot(
    model: str | Path = "cmbot",
    *,
    base_frame: str | None = None,
    tool_frame: str | None = None,
    limits: str | Path | None = None,
    srdf: str | Path | None = None,
    mount: ArrayLike | None = None,
    tool_length: float | None = None,
    payload: float = 0.0,
) -> Robot:
    """Load a robot from its URDF.

    The joints between `base_frame` and `tool_frame` move; every other joint is locked, where the SRDF has a
    ``group_state`` for it at that state, else at zero.

    Parameters
    ----------
    model : str or pathlib.Path
        ``cmbot`` for the shipped robot, or a URDF file.
    base_frame, tool_frame : str
        Links that bound the arm; default for ``cmbot`` only.
    limits : path
        Joint-limits file (acceleration and jerk); default: ``joint_limits.yaml`` beside the URDF.
    srdf : path, optional
        Disabled collision pairs and stances; default: the file beside the URDF with its name, if there.
    mount : (4, 4), optional
        Pose of `base_frame` in W; default: the URDF's root link is W.
    tool_length : float, optional
        Distance of the tool point from the flange along its z axis, m; default: as in the URDF.
    payload : float
        Point mass at the tool point, kg.

    Raises
    ------
    ModelError
        When a file is missing or unusable, or a frame does not exist.
    """
    if str(model) == "cmbot":
        urdf = model_folder() / "urdf" / "cmbot.urdf"
        base_frame, tool_frame = base_frame or "arm_base", tool_frame or "tool0"
    else:
        urdf = Path(model)
    if base_frame is None or tool_frame is None:
        raise ModelError(str(urdf), "base_frame, tool_frame", "none", "the links that bound the arm")
    root = parse_urdf(urdf)
    for finding in inspect_urdf(root):
        if finding.severity == "error":
            raise ModelError(str(urdf), finding.key, finding.got, finding.expected)
    srdf_path = Path(srdf) if srdf is not None else urdf.with_suffix(".srdf")
    srdf_text = _read_text(srdf_path) if srdf is not None or srdf_path.exists() else None
    limits_path = Path(limits) if limits is not None else urdf.with_name("joint_limits.yaml")

    full, shapes = _build(urdf, root)
    arm_joints = _chain(full, str(urdf), base_frame, tool_frame)
    stance = _stance(full, srdf_text, str(srdf_path))
    locked = [i for i in range(1, full.njoints) if i not in arm_joints]
    reduced, (collision, visual) = pin.buildReducedModel(full, shapes, locked, stance)
    if mount is not None:
        _move_root(reduced, (collision, visual), base_frame, mount)
    _enable_pairs(reduced, collision, srdf_text)
    if tool_length is not None:
        set_tool_length(reduced, (collision, visual), tool_frame, tool_length, source=str(urdf))
    attach_payload(reduced, tool_frame, payload)
    acceleration, jerk = read_joint_limits(limits_path, tuple(reduced.names)[1:])
    return Robot(
        name=root.get("name", urdf.stem),
        urdf=urdf.resolve(),
        model=reduced,
        floating_model=_on_free_flyer(reduced),
        collision_model=collision,
        visual_model=visual,
        limits=_limits(reduced, root, str(urdf), acceleration, jerk),
        base_frame=base_frame,
        tool_frame=tool_frame,
        payload=payload,
        content_hash=_hash([urdf.read_text(), srdf_text or "", limits_path.read_text()]),
    )


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(str(path), "", error, "a readable text file") from error


def _hash(texts: Sequence[str]) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


def _build(urdf: Path, root: ElementTree.Element) -> tuple[Any, list[Any]]:
    """Build the full model with its collision and visual geometry.

    A continuous joint has two coordinates in pinocchio; read as a revolute one without limits it has one, as
    the splines need.
    """
    for joint in root.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", "-1e9")
            limit.set("upper", "1e9")
    folder = urdf.resolve().parent
    for mesh in root.iter("mesh"):
        # Mesh paths count from the URDF, package:// from a folder above it.
        name = mesh.get("filename", "")
        if "://" not in name:
            mesh.set("filename", str((folder / name).resolve()))
    xml = ElementTree.tostring(root, encoding="unicode")
    packages = [str(parent) for parent in folder.parents]
    try:
        model = pin.buildModelFromXML(xml)
        kinds = (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL)
        shapes = [pin.buildGeomFromUrdfString(model, xml, kind, package_dirs=packages) for kind in kinds]
    except (ValueError, RuntimeError, IndexError) as error:
        text = " ".join(str(error).split())
        raise ModelError(str(urdf), "", f"a file that pinocchio refuses ({text})", "a loadable URDF") from error
    return model, shapes


def _chain(model: Any, source: str, base_frame: str, tool_frame: str) -> list[int]:
    """Indices of the joints from `base_frame` to `tool_frame`."""
    for key, name in (("base_frame", base_frame), ("tool_frame", tool_frame)):
        if not model.existFrame(name):
            choices = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
            raise ModelError(source, key, repr(name), "a link of the URDF", choices)
    base = model.frames[model.getFrameId(base_frame)].parentJoint
    joint = model.frames[model.getFrameId(tool_frame)].parentJoint
    chain: list[int] = []
    while joint not in (base, 0):
        chain.insert(0, joint)
        joint = model.parents[joint]
    if joint != base or not chain:
        raise ModelError(source, "tool_frame", repr(tool_frame), f"a link that joints move below {base_frame!r}")
    return chain


def _stance(model: Any, srdf_text: str | None, source: str) -> FloatArray:
    """Configuration of the full model: the SRDF's group states, zero elsewhere."""
    q: FloatArray = pin.neutral(model)
    if srdf_text is None:
        return q
    try:
        states = ElementTree.fromstring(srdf_text).findall("group_state")
    except ElementTree.ParseError as error:
        raise ModelError(source, "", f"no XML ({error})", "an SRDF file") from error
    for entry in (joint for state in states for joint in state.findall("joint")):
        name = entry.get("name", "")
        if not model.existJointName(name):
            raise ModelError(source, "group_state", repr(name), "the name of a joint of the URDF")
        try:
            q[model.joints[model.getJointId(name)].idx_q] = float(entry.get("value", ""))
        except ValueError as error:
            raise ModelError(source, f"group_state.{name}", entry.get("value"), "an angle, rad") from error
    return q


def _move_root(model: Any, shapes: Sequence[Any], base_frame: str, mount: ArrayLike) -> None:
    """Place `base_frame` at `mount` in W by moving everything that hangs on the universe."""
    X_WB = pin.SE3(np.asarray(mount, dtype=float))
    X_WU = X_WB * model.frames[model.getFrameId(base_frame)].placement.inverse()
    for i in range(1, model.njoints):
        if model.parents[i] == 0:
            model.jointPlacements[i] = X_WU * model.jointPlacements[i]
    for frame in model.frames:
        if frame.parentJoint == 0 and frame.name != "universe":
            frame.placement = X_WU * frame.placement
    model.inertias[0] = X_WU.act(model.inertias[0])
    for shape in (shape for geometry in shapes for shape in geometry.geometryObjects):
        if shape.parentJoint == 0:
            shape.placement = X_WU * shape.placement


def _enable_pairs(model: Any, collision: Any, srdf_text: str | None) -> None:
    """Let all pairs of shapes collide but those of neighbouring joints and those the SRDF disables."""
    collision.removeAllCollisionPairs()
    collision.addAllCollisionPairs()
    if srdf_text is not None:
        pin.removeCollisionPairsFromXML(model, collision, srdf_text)
        return
    for pair in list(collision.collisionPairs):
        joints = [collision.geometryObjects[i].parentJoint for i in (pair.first, pair.second)]
        if model.parents[max(joints)] == min(joints):
            collision.removeCollisionPair(pair)


def _on_free_flyer(model: Any) -> Any:
    """Return `model` below a massless free-flyer at W."""
    floating = pin.Model()
    root = floating.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "guardrail")
    floating.addJointFrame(root)
    floating = pin.appendModel(floating, model, floating.getFrameId("guardrail"), pin.SE3.Identity())
    floating.inertias[root] = pin.Inertia.Zero()
    floating.gravity = model.gravity
    return floating


def _limits(
    model: Any, root: ElementTree.Element, source: str, acceleration: FloatArray, jerk: FloatArray
) -> JointLimits:
    for name, velocity, torque in zip(
        list(model.names)[1:], model.upperVelocityLimit, model.upperEffortLimit, strict=True
    ):
        for key, value in (("velocity", velocity), ("effort", torque)):
            if not (np.isfinite(value) and value > 0):
                raise ModelError(source, f"joint[{name}].limit.{key}", value, "a positive bound")
    unlimited = np.abs(model.upperPositionLimit) >= 1e9
    return JointLimits(
        lower=np.where(unlimited, -np.inf, model.lowerPositionLimit),
        upper=np.where(unlimited, np.inf, model.upperPositionLimit),
        velocity=model.upperVelocityLimit,
        acceleration=acceleration,
        jerk=jerk,
        torque=model.upperEffortLimit,
    )
