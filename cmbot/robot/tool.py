"""Changes to the tool: another length, a payload."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from cmbot.common.errors import ModelError
from cmbot.robot.arm_model import convex_hull

__all__ = ["attach_payload", "set_tool_length"]


def set_tool_length(
    model: Any, shapes: Sequence[Any], tool_frame: str, length: float, *, source: str
) -> None:
    """Move the tool point along the flange's z axis and stretch the tool's shapes with it, in place.

    The flange is the frame that carries `tool_frame`'s link; the tool's shapes are those fixed to it.

    Parameters
    ----------
    model : pinocchio.Model
    shapes : sequence of pinocchio.GeometryModel
    tool_frame : str
        It lies on its flange's z axis, off the flange.
    length : float
        New distance from the flange, m.
    source : str
        File to name in an error.

    Raises
    ------
    ModelError
        When the tool point does not lie ahead of its flange, or a shape of the tool cannot be stretched.
    """
    frame = model.frames[model.getFrameId(tool_frame)]
    flange = _flange(model, frame)
    X_FT = flange.placement.inverse() * frame.placement
    old = float(X_FT.translation[2])
    if not (isinstance(length, int | float | np.number) and math.isfinite(length) and length > 0):
        raise ModelError(source, "tool_length", length, "a positive length in m")
    if old <= 0 or np.abs(X_FT.translation[:2]).max() > 1e-9:
        raise ModelError(
            source, "tool_length", length, f"{tool_frame!r} to lie on its flange's z axis, or no tool length"
        )
    ratio = length / old
    X_FT.translation = np.array([0.0, 0.0, length])
    frame.placement = flange.placement * X_FT
    for shape in (shape for geometry in shapes for shape in geometry.geometryObjects):
        if model.frames[shape.parentFrame].name == flange.name:
            _stretch(shape, flange.placement, ratio, source)


def attach_payload(model: Any, tool_frame: str, mass: float) -> None:
    """Add a point mass, kg, at the tool point of `model` (changed in place).

    Raises
    ------
    ModelError
        When the mass is negative or not finite.
    """
    if not (isinstance(mass, int | float | np.number) and math.isfinite(mass) and mass >= 0):
        raise ModelError("load_robot", "payload", mass, "a mass in kg that is not negative")
    if mass > 0:
        frame = model.frames[model.getFrameId(tool_frame)]
        model.appendBodyToJoint(
            frame.parentJoint, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), frame.placement
        )


def _flange(model: Any, frame: Any) -> Any:
    """Nearest frame of a link above `frame`, on the same joint."""
    flange = model.frames[frame.parentFrame]
    while flange.type != pin.FrameType.BODY and flange.parentJoint == frame.parentJoint:
        flange = model.frames[flange.parentFrame]
    return flange


def _stretch(shape: Any, X_JF: Any, ratio: float, source: str) -> None:
    """Scale a shape along the flange's z axis; the cap of a capsule keeps its radius and its far end."""
    X_FS = X_JF.inverse() * shape.placement
    geometry = shape.geometry
    if isinstance(geometry, coal.ConvexBase):
        stretched = (X_FS.act(geometry.point(i)) * [1.0, 1.0, ratio] for i in range(geometry.num_points))
        shape.geometry = convex_hull(np.array([X_FS.actInv(p_F) for p_F in stretched]))
        return
    axis = int(np.argmax(np.abs(X_FS.rotation[2])))
    long = isinstance(geometry, coal.Capsule | coal.Cylinder)
    known = long or isinstance(geometry, coal.Box | coal.BVHModelBase)
    if not known or abs(X_FS.rotation[2, axis]) < 1 - 1e-9 or (long and axis != 2):
        kind = type(geometry).__name__.lower()
        expected = "a tool of capsules, cylinders, boxes and meshes, whose axes are its flange's"
        raise ModelError(source, f"tool_length, {shape.name}", f"a {kind} that cannot be stretched", expected)
    if isinstance(geometry, coal.Capsule):
        # The tip of the cap scales with the tool, not the cap's centre.
        near = X_FS.translation[2] - geometry.halfLength
        far = (X_FS.translation[2] + geometry.halfLength + geometry.radius) * ratio - geometry.radius
        far = max(far, near)
        geometry.halfLength = 0.5 * (far - near)
        X_FS.translation = np.array([*X_FS.translation[:2], 0.5 * (near + far)])
    else:
        scale = np.ones(3)
        scale[axis] = ratio
        if isinstance(geometry, coal.Box):
            geometry.halfSide = geometry.halfSide * scale
        elif isinstance(geometry, coal.Cylinder):
            geometry.halfLength *= ratio
        else:
            shape.meshScale = shape.meshScale * scale
            # The loaded shape does not follow the scale.
            shape.geometry = coal.MeshLoader().load(shape.meshPath, shape.meshScale)
        X_FS.translation = X_FS.translation * [1.0, 1.0, ratio]
    shape.placement = X_JF * X_FS
