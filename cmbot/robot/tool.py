"""Changes to the tool: another length, a payload."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from cmbot.errors import ModelError

__all__ = ["attach_payload", "set_tool_length"]


def set_tool_length(
    model: Any, shapes: Sequence[Any], tool_frame: str, length: float, *, source: str
) -> None:
    """Move the tool point along the flange's z axis and stretch the tool's shapes with it.

    The flange is the frame that carries `tool_frame`'s link; the tool's shapes are those fixed to it.

    Parameters
    ----------
    model : pinocchio.Model
        Changed in place.
    shapes : sequence of pinocchio.GeometryModel
        Changed in place.
    tool_frame : str
        Name of the tool frame; it must lie on its flange's z axis, off the flange.
    length : float
        New distance from the flange, m.
    source : str
        File to name in an error.

    Raises
    ------
    ModelError
        When the tool point does not lie ahead of its flange.
    """
    frame = model.frames[model.getFrameId(tool_frame)]
    flange = _flange(model, frame)
    X_FT = flange.placement.inverse() * frame.placement
    old = float(X_FT.translation[2])
    if not (math.isfinite(length) and length > 0):
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
            _stretch(shape, flange.placement, ratio)


def attach_payload(model: Any, tool_frame: str, mass: float) -> None:
    """Add a point mass, kg, at the tool point of `model` (changed in place).

    Raises
    ------
    ModelError
        When the mass is negative or not finite.
    """
    if not (math.isfinite(mass) and mass >= 0):
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


def _stretch(shape: Any, X_JF: Any, ratio: float) -> None:
    """Scale a shape along the flange's z axis; the cap of a capsule keeps its radius and its far end."""
    X_FS = X_JF.inverse() * shape.placement
    geometry = shape.geometry
    if isinstance(geometry, coal.Capsule):
        # The far end of the cap scales with the tool, not its centre.
        near = X_FS.translation[2] - geometry.halfLength
        far = (X_FS.translation[2] + geometry.halfLength + geometry.radius) * ratio - geometry.radius
        far = max(far, near)
        geometry.halfLength = 0.5 * (far - near)
        X_FS.translation = np.array([*X_FS.translation[:2], 0.5 * (near + far)])
    else:
        scale = np.ones(3)
        scale[2] = ratio
        shape.meshScale = shape.meshScale * scale
        X_FS.translation = X_FS.translation * scale
    shape.placement = X_JF * X_FS
