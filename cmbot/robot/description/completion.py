"""What a URDF lacks and its user adds: masses of links, and a tool on the flange."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ModelError
from cmbot.common.reading.fields import Mass, Vector
from cmbot.common.reading.validation import CheckedFields, counted, hint, shown
from cmbot.common.representation import ShortRepr
from cmbot.robot.description.frames import links_beside, row_of
from cmbot.robot.description.limits_file import read_joint_limits
from cmbot.robot.description.mesh_file import Body, body_of, locate_meshes

if TYPE_CHECKING:
    from cmbot.robot.description.files import RobotFiles

POINT = "_point"
"""Ending of the name of the tool point's frame, after that of the tool's link."""

Triple = tuple[float, float, float]


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
class AttachedTool(CheckedFields, ShortRepr):
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

    xyz: Vector
    rpy: Vector = (0.0, 0.0, 0.0)
    mass: Mass = 0.0
    com: Vector | None = None
    shapes: tuple[ToolShape, ...] = ()

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


# A link that weighs less has no mass, kg.
_ZERO_MASS_KG = 1e-9


def add_masses(root: ElementTree.Element, files: RobotFiles) -> tuple[str, ...]:
    """Give links without a mass the one of the limits file, and a share of the total mass, in place.

    A mass is of even density in the link's shapes. What the total mass is more than all others is spread over
    the other links in proportion to their volumes.

    Returns
    -------
    tuple of str
        A remark on what is estimated; none where nothing is.

    Raises
    ------
    ModelError
        When a link that has a mass is not there or has no shape, or the total mass leaves nothing to spread.
    """
    listed: Mapping[str, float] = {}
    with suppress(ModelError):  # who reads the limits refuses it, after frames that are not there
        listed = {} if files.limits is None else read_joint_limits(files.limits).masses_kg
    if not listed and files.total_mass is None:
        return ()
    bare = {link.get("name", ""): link for link in root.findall("link") if not _mass_of(link) > _ZERO_MASS_KG}
    bodies = _bodies(root, files, bare)
    _require_links(root, files, listed, bodies)
    masses = {name: mass for name, mass in listed.items() if name in bodies}
    share = {name: body.volume for name, body in bodies.items() if name not in masses}
    if files.total_mass is not None:
        known = sum(map(_mass_of, root.findall("link"))) + sum(masses.values())
        left, volume = files.total_mass - known, sum(share.values())
        if not (share and left > 0):
            got = f"{files.total_mass:g} kg, beside {known:.4g} kg that are given"
            expected = f"more than these: {known + files.total_mass:.4g} if that is of the others alone"
            expected = expected if share else "no total mass: no link with a shape lacks a mass"
            raise ModelError(str(files.urdf), "total_mass_kg", got, expected)
        masses |= {name: left * part / volume for name, part in share.items()}
    for name, mass in masses.items():
        body = bodies[name]
        _set_mass(bare[name], mass, body.centre, mass / body.volume * body.inertia)
    estimated, mass = counted(len(masses), "link"), sum(masses.values())
    return (
        f"The masses of {estimated} are estimated, {mass:.4g} kg of even density in the convex hulls of "
        "their shapes: so is every torque, force, sag and sway.",
    )


def leave_on_floor(root: ElementTree.Element, carried_from: str, base_frame: str, source: str) -> None:
    """Take the masses from the links of a URDF that `carried_from` does not lead to, in place.

    Raises
    ------
    ModelError
        When that is no link before `base_frame` and not that one; `source` is the URDF.
    """
    beside = links_beside(root, carried_from)
    if base_frame in beside:
        expected = f"a link that leads to the base frame, {base_frame!r}, or that one"
        before = tuple(row_of(root, base_frame))
        raise ModelError(source, "carried_from", shown(carried_from), expected, before)
    for link in beside.values():
        for inertial in link.findall("inertial"):
            link.remove(inertial)


def loads_beside(root: ElementTree.Element, base_frame: str) -> dict[str, float]:
    """Return the masses, kg, of the links that `base_frame` does not lead to, by name; none of zero."""
    masses = {name: _mass_of(link) for name, link in links_beside(root, base_frame).items()}
    return {name: mass for name, mass in masses.items() if mass > _ZERO_MASS_KG}


class Lift(NamedTuple):
    """The last joint before an arm, such as a lift's, which is locked.

    Attributes
    ----------
    joint, link, root : str
        Its name, that of the link that it carries, and that of the root link.
    beside_kg : float
        Mass of what that link does not lead to, and is not said to stand on the floor.
    """

    joint: str
    link: str
    root: str
    beside_kg: float


def lift_below(root: ElementTree.Element, base_frame: str) -> Lift | None:
    """Return the last joint of a URDF before `base_frame`; None where none turns or slides."""
    row = row_of(root, base_frame)
    if not (joint := row[base_frame]):
        return None
    link = next(name for name, moved_by in row.items() if moved_by == joint)
    return Lift(joint, link, next(iter(row)), sum(loads_beside(root, link).values()))


def _bodies(
    root: ElementTree.Element, files: RobotFiles, links: Mapping[str, ElementTree.Element]
) -> dict[str, Body]:
    """The bodies of the links that have a shape."""
    located = deepcopy(root)
    locate_meshes(files.urdf, located, files.package_dirs)
    by_name = {
        link.get("name", ""): body_of(link) for link in located.findall("link") if link.get("name") in links
    }
    return {name: body for name, body in by_name.items() if body is not None}


def _require_links(
    root: ElementTree.Element, files: RobotFiles, listed: Mapping[str, float], bodies: Mapping[str, Body]
) -> None:
    names = [link.get("name", "") for link in root.findall("link")]
    for name in listed:
        if name not in names:
            expected = f"a link of the URDF{hint(name, names)}"
            raise ModelError(str(files.limits), "masses_kg", repr(name), expected, names)
        if name not in bodies:
            expected = "a link without a mass in the URDF, and with a shape"
            raise ModelError(str(files.limits), f"masses_kg.{name}", shown(listed[name]), expected)


def add_tool(root: ElementTree.Element, files: RobotFiles, flange: str) -> str:
    """Fix the robot's tool to a link of its URDF, in place; return the name of the tool's frame.

    The mass is of even density in its shapes, about its centre of mass where that is given.
    """
    tool = files.tool
    if tool is None:
        return flange
    link, frame = tool.attached(root, flange)
    name = link.get("name", "")
    body = _bodies(root, files, {name: link}).get(name) if tool.mass > 0 else None
    if tool.mass > 0:
        centre = 0.5 * np.array(tool.xyz) if body is None else body.centre
        inertia = np.zeros((3, 3)) if body is None else tool.mass / body.volume * body.inertia
        _set_mass(link, tool.mass, centre if tool.com is None else np.array(tool.com), inertia)
    return frame


def _mass_of(link: ElementTree.Element) -> float:
    """The mass of a link, kg; zero where it has none."""
    mass = link.find("inertial/mass")
    return 0.0 if mass is None else float(mass.get("value", "0"))


def _set_mass(link: ElementTree.Element, mass: float, centre: FloatArray, inertia: FloatArray) -> None:
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=" ".join(map(repr, centre.tolist())), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(float(mass)))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tolist()
    moments = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ElementTree.SubElement(inertial, "inertia", {name: repr(value) for name, value in moments.items()})
