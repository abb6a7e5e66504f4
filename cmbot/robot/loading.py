"""From a URDF, its SRDF, its joint-limits and its elasticity file to a `Robot`."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from cmbot.common.errors import ModelError
from cmbot.common.input_files import read_input
from cmbot.common.installation import model_folder
from cmbot.common.validation import given_path, hint
from cmbot.robot.arm_model import arm_model, attach_payload, set_tool_length
from cmbot.robot.elasticity import read_elasticity
from cmbot.robot.inspection import inspect_urdf
from cmbot.robot.limits import joint_limits
from cmbot.robot.robot import Robot
from cmbot.robot.xml_file import parse_urdf

__all__ = ["load_robot"]

# An arm that weighs less is one without masses, kg.
_LIGHTEST = 1e-3


def load_robot(
    model: str | Path = "cmbot",
    *,
    base_frame: str | None = None,
    tool_frame: str | None = None,
    limits: str | Path | None = None,
    srdf: str | Path | None = None,
    elasticity: str | Path | None = None,
    mount: ArrayLike | None = None,
    tool_length: float | None = None,
    payload: float = 0.0,
) -> Robot:
    """Load a robot from its URDF.

    The joints between `base_frame` and `tool_frame` move; every other joint is locked at its value in the
    SRDF's ``group_state``, else at zero. A collision mesh is replaced by its convex hull: a clearance with it
    is never overestimated.

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
    elasticity : path, optional
        Which links bend; default: the file beside the URDF with its name and the ending
        ``.elasticity.yaml``, if there, else none does.
    mount : (4, 4), optional
        Pose of `base_frame` in W; default: the URDF's root link is W.
    tool_length : float, optional
        Distance of the tool point from the flange along its z axis, m; default: as in the URDF.
    payload : float
        Point mass at the tool point, kg.

    Raises
    ------
    ModelError
        When a file is missing or unusable, a frame does not exist, a joint of the arm is not revolute, the
        arm has no mass or more than 100 joints, or a number is beyond any robot's.
    """
    if str(model) == "cmbot":
        urdf = model_folder() / "urdf" / "cmbot.urdf"
        base_frame, tool_frame = base_frame or "arm_base", tool_frame or "tool0"
    else:
        urdf = given_path(model, "load_robot", "model", "cmbot, or the path of a URDF")
    root = _parsed(urdf)
    if base_frame is None or tool_frame is None:
        expected = f"the links that bound the arm{hint(urdf.name, ('cmbot',))}"
        raise ModelError(str(urdf), "base_frame, tool_frame", "none", expected)
    srdf_file = _given("srdf", srdf) or _existing(urdf.with_suffix(".srdf"))
    limits_file = _given("limits", limits) or urdf.with_name("joint_limits.yaml")
    elasticity_file = _given("elasticity", elasticity) or _existing(urdf.with_suffix(".elasticity.yaml"))
    for finding in inspect_urdf(root):
        if finding.severity == "error":
            raise ModelError(str(urdf), finding.key, finding.got, finding.expected)
    arm, collision, visual = arm_model(urdf, root, srdf_file, base_frame, tool_frame)
    if mount is not None:
        _move_root(arm, (collision, visual), base_frame, mount)
    if tool_length is not None:
        set_tool_length(arm, (collision, visual), tool_frame, tool_length, source=str(urdf))
    attach_payload(arm, tool_frame, payload)
    if not (mass := sum(inertia.mass for inertia in list(arm.inertias)[1:])) >= _LIGHTEST:
        got = f"{mass:g} kg from {base_frame!r} to {tool_frame!r}"
        raise ModelError(str(urdf), "link.inertial.mass", got, f"an arm of at least {_LIGHTEST:g} kg")
    files = (urdf, srdf_file, limits_file, elasticity_file)
    contents = [read_input(file, ModelError) for file in files if file]
    return Robot(
        name=root.get("name", urdf.stem),
        urdf=urdf.resolve(),
        model=arm,
        floating_model=_on_free_flyer(arm),
        collision_model=collision,
        visual_model=visual,
        limits=joint_limits(arm, urdf, limits_file),
        elasticity={} if elasticity_file is None else read_elasticity(elasticity_file, arm),
        base_frame=base_frame,
        tool_frame=tool_frame,
        payload=payload,
        content_hash=hashlib.sha256(b"\0".join(contents)).hexdigest(),
    )


def _parsed(urdf: Path) -> ElementTree.Element:
    try:
        return parse_urdf(urdf)
    except ModelError as error:
        if error.got == "no such file" and (meant := hint(urdf.name, ("cmbot",))):
            raise ModelError(error.source, "", error.got, f"{error.expected}{meant}") from error
        raise


def _given(key: str, path: str | Path | None) -> Path | None:
    return None if path is None else given_path(path, "load_robot", key, "the path of a file")


def _existing(path: Path) -> Path | None:
    return path if path.exists() else None


def _move_root(model: Any, shapes: Sequence[Any], base_frame: str, mount: ArrayLike) -> None:
    """Place `base_frame` at `mount` in W by moving everything that is fixed to the universe."""
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
    if X.shape == (4, 4) and np.isfinite(X).all() and (X[3] == [0, 0, 0, 1]).all():
        R = X[:3, :3]
        if np.abs(R @ R.T - np.eye(3)).max() <= 1e-9 and np.linalg.det(R) > 0:
            return pin.SE3(X)
    raise ModelError("load_robot", "mount", X.tolist(), expected)


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
