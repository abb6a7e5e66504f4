"""From a URDF, its SRDF and its joint-limits file to a `Robot`."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from cmbot.arrays import FloatArray
from cmbot.errors import ModelError
from cmbot.resources import model_folder
from cmbot.robot.hulls import convex_hull, encloses_volume
from cmbot.robot.inspection import inspect_urdf, parse_robot_xml, parse_urdf
from cmbot.robot.limits import JointLimits, read_joint_limits
from cmbot.robot.robot import Robot
from cmbot.robot.semantics import enable_pairs, stance
from cmbot.robot.tool import attach_payload, set_tool_length

__all__ = ["load_robot"]


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
    ``group_state`` for it at that state, else at zero. A collision mesh is replaced by its convex hull: a
    clearance with it is never overestimated.

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
        When a file is missing or unusable, a frame does not exist, or a joint of the arm does not turn.
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
    semantics = parse_robot_xml(srdf_path, "an SRDF") if srdf is not None or srdf_path.exists() else None
    limits_path = Path(limits) if limits is not None else urdf.with_name("joint_limits.yaml")

    full, shapes = _build(urdf, root)
    arm_joints = _chain(full, str(urdf), base_frame, tool_frame)
    _require_turning(root, str(urdf), [full.names[i] for i in arm_joints])
    locked = [i for i in range(1, full.njoints) if i not in arm_joints]
    reduced, (collision, visual) = pin.buildReducedModel(
        full, shapes, locked, stance(full, semantics, srdf_path)
    )
    if mount is not None:
        _move_root(reduced, (collision, visual), base_frame, mount)
    enable_pairs(reduced, collision, semantics, srdf_path)
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
        limits=_limits(reduced, str(urdf), acceleration, jerk),
        base_frame=base_frame,
        tool_frame=tool_frame,
        payload=payload,
        content_hash=_hash([urdf, *([] if semantics is None else [srdf_path]), limits_path]),
    )


def _hash(files: Sequence[Path]) -> str:
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()


def _build(urdf: Path, root: ElementTree.Element) -> tuple[Any, list[Any]]:
    """Build the full model with its collision and visual geometry.

    Collision meshes become their convex hulls. A continuous joint has two coordinates in pinocchio; read as a
    revolute one without limits it has one, as the splines need.
    """
    for joint in root.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", "-1e9")
            limit.set("upper", "1e9")
        # Never used here, and the reader refuses a file for a slip in them.
        for tag in ("dynamics", "calibration", "safety_controller"):
            for element in joint.findall(tag):
                joint.remove(element)
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
        raise ModelError(
            str(urdf), "", f"a file that pinocchio refuses ({text})", "a loadable URDF"
        ) from error
    for shape in shapes[0].geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry = _convex_hull(shape, str(urdf))
    return model, shapes


def _convex_hull(shape: Any, source: str) -> Any:
    vertices = shape.geometry.vertices()
    if not encloses_volume(vertices):
        expected = "a mesh that encloses a volume"
        raise ModelError(source, shape.name, f"the mesh {shape.meshPath}", expected)
    return convex_hull(vertices)


def _chain(model: Any, source: str, base_frame: str, tool_frame: str) -> list[int]:
    """Return the indices of the joints from `base_frame` to `tool_frame`."""
    for key, name in (("base_frame", base_frame), ("tool_frame", tool_frame)):
        if not model.existFrame(name, pin.FrameType.BODY):
            choices = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
            raise ModelError(source, key, repr(name), "a link of the URDF", choices)
        if [frame.name for frame in model.frames].count(name) > 1:
            raise ModelError(source, key, repr(name), "a link that shares its name with no joint")
    base = model.frames[model.getFrameId(base_frame)].parentJoint
    joint = model.frames[model.getFrameId(tool_frame)].parentJoint
    chain: list[int] = []
    while joint not in (base, 0):
        chain.insert(0, joint)
        joint = model.parents[joint]
    if joint != base or not chain:
        raise ModelError(
            source, "tool_frame", repr(tool_frame), f"a link that joints move below {base_frame!r}"
        )
    return chain


def _require_turning(root: ElementTree.Element, source: str, names: Sequence[str]) -> None:
    """Refuse an arm with a joint that slides, or that follows another one."""
    for joint in (joint for joint in root.findall("joint") if joint.get("name") in names):
        key = f"joint[{joint.get('name')}]"
        if joint.get("type") != "revolute":  # what `_build` made of a continuous one
            raise ModelError(
                source, f"{key}.type", joint.get("type"), "an arm of revolute or continuous joints"
            )
        if joint.find("mimic") is not None:
            raise ModelError(
                source, f"{key}.mimic", "a joint that follows another", "an arm of independent joints"
            )


def _move_root(model: Any, shapes: Sequence[Any], base_frame: str, mount: ArrayLike) -> None:
    """Place `base_frame` at `mount` in W by moving everything that hangs on the universe."""
    X_WU = _pose(mount) * model.frames[model.getFrameId(base_frame)].placement.inverse()
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


def _pose(mount: ArrayLike) -> Any:
    expected = "a pose: a 4 x 4 matrix of a rotation, a position and the last row 0 0 0 1"
    try:
        X = np.array(mount, dtype=float)
    except (TypeError, ValueError) as error:
        raise ModelError("load_robot", "mount", repr(mount), expected) from error
    if X.shape != (4, 4) or not np.isfinite(X).all() or (X[3] != [0, 0, 0, 1]).any():
        raise ModelError("load_robot", "mount", X.tolist(), expected)
    R = X[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-9 or np.linalg.det(R) < 0:
        raise ModelError("load_robot", "mount", X.tolist(), expected)
    return pin.SE3(X)


def _on_free_flyer(model: Any) -> Any:
    """Return `model` below a massless free-flyer at W."""
    name = "guardrail"
    while model.existFrame(name):
        name += "_"
    floating = pin.Model()
    root = floating.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
    floating.addJointFrame(root)
    floating = pin.appendModel(floating, model, floating.getFrameId(name), pin.SE3.Identity())
    floating.inertias[root] = pin.Inertia.Zero()
    floating.gravity = model.gravity
    return floating


def _limits(model: Any, source: str, acceleration: FloatArray, jerk: FloatArray) -> JointLimits:
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
