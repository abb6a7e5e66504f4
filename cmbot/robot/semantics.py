"""What an SRDF says about a robot: the stance of its locked joints, the shapes that may touch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ModelError
from cmbot.robot.inspection import parse_robot_xml

__all__ = ["Semantics", "enable_pairs", "read_semantics", "stance"]


@dataclass(frozen=True, kw_only=True)
class Semantics:
    """An SRDF: the file, to name in an error, and what stands in it."""

    path: Path
    root: ElementTree.Element


def read_semantics(path: Path) -> Semantics:
    """Read an SRDF.

    Raises
    ------
    ModelError
        When the file is missing, unreadable, no XML or something else.
    """
    return Semantics(path=path, root=parse_robot_xml(path, "an SRDF"))


def stance(model: Any, semantics: Semantics | None) -> FloatArray:
    """Return the configuration of the full model: the SRDF's group states, zero elsewhere.

    Parameters
    ----------
    model : pinocchio.Model
        With every joint of the URDF.
    semantics : Semantics, optional

    Raises
    ------
    ModelError
        When a state names an unknown joint or holds no finite number.
    """
    q: FloatArray = pin.neutral(model)
    if semantics is None:
        return q
    path = str(semantics.path)
    for entry in semantics.root.findall("group_state/joint"):
        name, text = entry.get("name", ""), entry.get("value", "")
        if name not in list(model.names)[1:]:
            raise ModelError(path, "group_state", repr(name), "the name of a movable joint of the URDF")
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise ModelError(path, f"group_state.{name}", repr(text), "an angle, rad, or a distance, m")
        q[model.joints[model.getJointId(name)].idx_q] = value
    return q


def enable_pairs(model: Any, collision: Any, semantics: Semantics | None) -> None:
    """Let all pairs of shapes collide but those the SRDF disables (without one: neighbouring joints).

    Parameters
    ----------
    model : pinocchio.Model
    collision : pinocchio.GeometryModel
        Changed in place.
    semantics : Semantics, optional

    Raises
    ------
    ModelError
        When the SRDF disables a pair without naming both links.
    """
    collision.removeAllCollisionPairs()
    collision.addAllCollisionPairs()
    if semantics is not None:
        for pair in semantics.root.findall("disable_collisions"):
            if not (pair.get("link1") and pair.get("link2")):
                expected = "the names of link1 and link2"
                raise ModelError(str(semantics.path), "disable_collisions", pair.attrib, expected)
        text = ElementTree.tostring(semantics.root, encoding="unicode")
        pin.removeCollisionPairsFromXML(model, collision, text)
        return
    # Copied first: what pinocchio hands out are references into the list that is changed here.
    pairs = [(pair.first, pair.second) for pair in collision.collisionPairs]
    collision.removeAllCollisionPairs()
    for first, second in pairs:
        joints = [collision.geometryObjects[i].parentJoint for i in (first, second)]
        if model.parents[max(joints)] != min(joints):
            collision.addCollisionPair(pin.CollisionPair(first, second))
