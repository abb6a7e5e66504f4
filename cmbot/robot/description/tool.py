"""A tool on the flange: fixed to the tool frame of a URDF, as two links of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from cmbot.common.errors import ModelError
from cmbot.common.representation import short_repr

POINT = "_point"
"""Ending of the name of the tool point's frame, after that of the tool's link."""

Triple = tuple[float, float, float]
_TOP_M, _TOP_KG = 1e4, 1e4  # m, kg


@dataclass(frozen=True, kw_only=True)
class ToolShape:
    """A shape of a tool, in the frame of the flange.

    Attributes
    ----------
    kind : str
        ``box``, ``cylinder``, ``capsule``, ``sphere`` or ``mesh``.
    numbers : tuple of float, m
        Edges of a box; radius and length of a cylinder; of a capsule radius and length between the centres of
        its two half spheres; radius of a sphere; of a mesh the scale of its file, without a unit.
    path : str, pathlib.Path or None
        Of a mesh.
    xyz, rpy : three floats, m and rad
        Its pose: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
    """

    kind: Literal["box", "cylinder", "capsule", "sphere", "mesh"]
    numbers: tuple[float, ...]
    path: str | Path | None = None
    xyz: Triple = (0.0, 0.0, 0.0)
    rpy: Triple = (0.0, 0.0, 0.0)

    def elements(self) -> Iterator[tuple[ElementTree.Element, Triple]]:
        """Yield shapes of URDF that together are this one, each with its place along its own axes."""
        first = f"{self.numbers[0]!r}"
        match self.kind:
            case "box":
                yield ElementTree.Element("box", size=" ".join(map(repr, self.numbers))), (0, 0, 0)
            case "sphere":
                yield ElementTree.Element("sphere", radius=first), (0, 0, 0)
            case "mesh":
                scale = " ".join([first] * 3)
                yield ElementTree.Element("mesh", filename=str(self.path), scale=scale), (0, 0, 0)
            case _:
                length = self.numbers[1]
                yield ElementTree.Element("cylinder", radius=first, length=repr(length)), (0, 0, 0)
                for end in (-length / 2, length / 2) if self.kind == "capsule" else ():
                    yield ElementTree.Element("sphere", radius=first), (0, 0, end)


@dataclass(frozen=True, kw_only=True)
class AttachedTool:
    """A tool that is fixed to the arm's flange.

    Attributes
    ----------
    xyz, rpy : three floats, m and rad
        Pose of the tool point in the flange's frame: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
    mass : float, kg
    com : three floats or None, m
        Centre of mass in the flange's frame; None: that of the shapes, or without shapes half way to the tool
        point.
    shapes : tuple of ToolShape
        They keep the clearance from all else, and are drawn.
    """

    xyz: Triple
    rpy: Triple = (0.0, 0.0, 0.0)
    mass: float = 0.0
    com: Triple | None = None
    shapes: tuple[ToolShape, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        numbers = np.array([*self.xyz, *self.rpy, *(self.com or ())], dtype=float)
        if not (np.abs(numbers) <= _TOP_M).all():
            expected = f"finite numbers of at most {_TOP_M:g}"
            raise ModelError("AttachedTool", "xyz, rpy, com", numbers.tolist(), expected)
        if not 0 <= self.mass <= _TOP_KG:
            expected = f"a mass in kg that is not negative, at most {_TOP_KG:g}"
            raise ModelError("AttachedTool", "mass", self.mass, expected)

    def attached(self, root: ElementTree.Element, flange: str) -> tuple[ElementTree.Element, str]:
        """Fix it to a link of a URDF, in place; return its link, as yet without mass, and its frame's name.

        That link has the flange's frame and the shapes; the other one that is added is at the tool point.
        """
        names = {element.get("name", "") for tag in ("link", "joint") for element in root.findall(tag)}
        name = f"{flange}_tool"
        while any(other.startswith(name) for other in names):
            name += "_"
        point = f"{name}{POINT}"
        link = ElementTree.SubElement(root, "link", name=name)
        ElementTree.SubElement(root, "link", name=point)
        for parent, child, xyz, rpy in (
            (flange, name, (0, 0, 0), (0, 0, 0)),
            (name, point, self.xyz, self.rpy),
        ):
            joint = ElementTree.SubElement(root, "joint", name=f"{child}_joint", type="fixed")
            ElementTree.SubElement(joint, "origin", xyz=_text(xyz), rpy=_text(rpy))
            ElementTree.SubElement(joint, "parent", link=parent)
            ElementTree.SubElement(joint, "child", link=child)
        for shape in self.shapes:
            for element, along in shape.elements():
                at = np.array(shape.xyz) + pin.rpy.rpyToMatrix(np.array(shape.rpy)) @ along
                for tag in ("visual", "collision"):
                    part = ElementTree.SubElement(link, tag)
                    ElementTree.SubElement(part, "origin", xyz=_text(at.tolist()), rpy=_text(shape.rpy))
                    ElementTree.SubElement(part, "geometry").append(element)
        return link, point


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
