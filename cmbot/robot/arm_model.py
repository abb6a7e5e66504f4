"""From what stands in a URDF to pinocchio's model of the arm, all other joints locked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import pinocchio as pin

from cmbot.common.errors import ModelError
from cmbot.common.validation import hint
from cmbot.robot.hulls import convex_hull, encloses_volume
from cmbot.robot.semantics import Semantics, stance

__all__ = ["arm_model"]


def arm_model(
    urdf: Path, root: ElementTree.Element, semantics: Semantics | None, base_frame: str, tool_frame: str
) -> tuple[Any, list[Any]]:
    """Build the model of an arm: only the joints from `base_frame` to `tool_frame` move.

    Parameters
    ----------
    urdf : pathlib.Path
    root : xml.etree.ElementTree.Element
        What stands in it; changed on the way.
    semantics : Semantics, optional
        Where the other joints are locked; default: at zero.
    base_frame, tool_frame : str

    Returns
    -------
    pinocchio.Model
    list of pinocchio.GeometryModel
        Collision shapes, meshes as their convex hulls, and shapes to look at.

    Raises
    ------
    ModelError
        When pinocchio refuses the file, a frame does not exist, a joint of the arm does not turn, or a mesh
        encloses no volume.
    """
    full, shapes = _build(urdf, root)
    moving = _chain(full, str(urdf), base_frame, tool_frame)
    _require_turning(root, str(urdf), [full.names[i] for i in moving])
    locked = [i for i in range(1, full.njoints) if i not in moving]
    model, shapes = pin.buildReducedModel(full, shapes, locked, stance(full, semantics))
    return model, shapes


def _build(urdf: Path, root: ElementTree.Element) -> tuple[Any, list[Any]]:
    """Build the full model with its collision and visual geometry.

    Collision meshes become their convex hulls. A continuous joint has two coordinates in pinocchio; read as a
    revolute one without limits it has one, as the splines need. A fixed joint may share its name with a link
    in a URDF, not in pinocchio; nobody asks for it by name, so it is given another.
    """
    names = {element.get("name", "") for tag in ("link", "joint") for element in root.findall(tag)}
    links = {link.get("name", "") for link in root.findall("link")}
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        if name in links:
            while name in names:
                name += "_"
            names.add(name)
            joint.set("name", name)
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
        if not (isinstance(name, str) and model.existFrame(name, pin.FrameType.BODY)):
            choices = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
            raise ModelError(source, key, repr(name), f"a link of the URDF{hint(name, choices)}", choices)
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
