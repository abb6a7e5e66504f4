"""From a URDF and its SRDF to pinocchio's model of the arm, all other joints locked, with its shapes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ModelError
from cmbot.common.validation import hint
from cmbot.robot.inspection import parse_urdf

__all__ = ["arm_model", "convex_hull", "encloses_volume"]

# Smallest thickness of points relative to their extent. At about 3e-8 coal's hull crashes the process.
_FLAT = 1e-5


def arm_model(
    urdf: Path, root: ElementTree.Element, srdf: Path | None, base_frame: str, tool_frame: str
) -> tuple[Any, Any, Any]:
    """Build the model of an arm: only the joints from `base_frame` to `tool_frame` move.

    Parameters
    ----------
    urdf : pathlib.Path
    root : xml.etree.ElementTree.Element
        Its content, which is modified.
    srdf : pathlib.Path, optional
        Its group states are where the other joints are locked, default zero; the pairs that it disables do
        not collide, default those of neighbouring joints.
    base_frame, tool_frame : str

    Returns
    -------
    pinocchio.Model
    pinocchio.GeometryModel
        Collision shapes, meshes as their convex hulls, with the pairs that may collide.
    pinocchio.GeometryModel
        Visual shapes.

    Raises
    ------
    ModelError
        When pinocchio refuses the file, a frame does not exist, a joint of the arm is not revolute, a mesh
        encloses no volume, or the SRDF is unusable.
    """
    semantics = None if srdf is None else parse_urdf(srdf, "an SRDF")
    full, shapes = _build(urdf, root)
    moving = _chain(full, str(urdf), base_frame, tool_frame)
    _require_revolute(root, str(urdf), [full.names[i] for i in moving])
    locked = [i for i in range(1, full.njoints) if i not in moving]
    model, shapes = pin.buildReducedModel(full, shapes, locked, _stance(full, str(srdf), semantics))
    _enable_pairs(model, shapes[0], str(srdf), semantics)
    return model, *shapes


def encloses_volume(points: FloatArray) -> bool:
    """Return whether the hull of `points` (N, 3) has a volume, in any orientation."""
    if len(points) < 4 or not np.isfinite(points).all():
        return False
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[2] > _FLAT * extents[0])


def convex_hull(points: FloatArray) -> Any:
    """Return the convex hull of `points` (N, 3), a `coal.ConvexBase`; they have to enclose a volume."""
    vertices = coal.StdVec_Vec3s()
    for point in points:
        vertices.append(np.array(point, dtype=float))
    return coal.Convex.convexHull(vertices, False, "Qt")


def _build(urdf: Path, root: ElementTree.Element) -> tuple[Any, list[Any]]:
    """Build the full model with its collision and visual geometry; collision meshes become convex hulls."""
    _adapt(urdf, root)
    xml = ElementTree.tostring(root, encoding="unicode")
    packages = [str(parent) for parent in urdf.resolve().parent.parents]
    try:
        model = pin.buildModelFromXML(xml)
        kinds = (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL)
        shapes = [pin.buildGeomFromUrdfString(model, xml, kind, package_dirs=packages) for kind in kinds]
    except (ValueError, RuntimeError, IndexError) as error:
        got = f"a file that pinocchio refuses ({' '.join(str(error).split())})"
        raise ModelError(str(urdf), "", got, "a loadable URDF") from error
    for shape in shapes[0].geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            vertices = shape.geometry.vertices()
            if not encloses_volume(vertices):
                expected = "a mesh that encloses a volume"
                raise ModelError(str(urdf), shape.name, f"the mesh {shape.meshPath}", expected)
            shape.geometry = convex_hull(vertices)
    return model, shapes


def _adapt(urdf: Path, root: ElementTree.Element) -> None:
    """Change what pinocchio's reader of URDF would read differently or refuse."""
    names = {element.get("name", "") for tag in ("link", "joint") for element in root.findall(tag)}
    links = {link.get("name", "") for link in root.findall("link")}
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        if name in links:
            # URDF allows it for a fixed joint, pinocchio does not. Nothing refers to a fixed joint by name.
            while name in names:
                name += "_"
            names.add(name)
            joint.set("name", name)
        if joint.get("type") == "continuous":
            # It would have two coordinates; as a revolute joint without a range it has one.
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", "-1e9")
            limit.set("upper", "1e9")
        # Not used, and an error in them would make the file unreadable.
        for tag in ("dynamics", "calibration", "safety_controller"):
            for element in joint.findall(tag):
                joint.remove(element)
    for mesh in root.iter("mesh"):
        # Relative to the URDF; package:// is relative to a folder above it.
        name = mesh.get("filename", "")
        if "://" not in name:
            mesh.set("filename", str((urdf.resolve().parent / name).resolve()))


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
        expected = f"a link that joints move below {base_frame!r}"
        raise ModelError(source, "tool_frame", repr(tool_frame), expected)
    return chain


def _require_revolute(root: ElementTree.Element, source: str, names: Sequence[str]) -> None:
    """Refuse an arm with a prismatic or a mimic joint."""
    for joint in (joint for joint in root.findall("joint") if joint.get("name") in names):
        key, kind = f"joint[{joint.get('name')}]", joint.get("type")
        if kind != "revolute":  # continuous joints have been changed by `_adapt`
            raise ModelError(source, f"{key}.type", kind, "an arm of revolute or continuous joints")
        if joint.find("mimic") is not None:
            expected = "an arm of independent joints"
            raise ModelError(source, f"{key}.mimic", "a joint that follows another", expected)


def _stance(model: Any, source: str, semantics: ElementTree.Element | None) -> FloatArray:
    """Return the configuration of the full model: the SRDF's group states, zero elsewhere."""
    q: FloatArray = pin.neutral(model)
    for entry in () if semantics is None else semantics.findall("group_state/joint"):
        name, text = entry.get("name", ""), entry.get("value", "")
        if name not in list(model.names)[1:]:
            raise ModelError(source, "group_state", repr(name), "the name of a movable joint of the URDF")
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise ModelError(source, f"group_state.{name}", repr(text), "an angle, rad, or a distance, m")
        q[model.joints[model.getJointId(name)].idx_q] = value
    return q


def _enable_pairs(model: Any, collision: Any, source: str, semantics: ElementTree.Element | None) -> None:
    """Let all pairs of shapes collide but those that the SRDF disables (without one: neighbouring joints)."""
    collision.addAllCollisionPairs()
    if semantics is not None:
        for pair in semantics.findall("disable_collisions"):
            if not (pair.get("link1") and pair.get("link2")):
                expected = "the names of link1 and link2"
                raise ModelError(source, "disable_collisions", pair.attrib, expected)
        text = ElementTree.tostring(semantics, encoding="unicode")
        pin.removeCollisionPairsFromXML(model, collision, text)
        return
    # Copied first: pinocchio returns references into the list that is changed here.
    pairs = [(pair.first, pair.second) for pair in collision.collisionPairs]
    collision.removeAllCollisionPairs()
    for first, second in pairs:
        joints = [collision.geometryObjects[i].parentJoint for i in (first, second)]
        if model.parents[max(joints)] != min(joints):
            collision.addCollisionPair(pin.CollisionPair(first, second))
