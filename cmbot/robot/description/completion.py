"""What a URDF lacks and its user adds: masses of links, and a tool on the flange."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from copy import deepcopy
from xml.etree import ElementTree

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ModelError
from cmbot.common.validation import counted, hint, shown
from cmbot.robot.description.files import RobotFiles
from cmbot.robot.description.hulls import Body, body_of
from cmbot.robot.description.limits_file import read_joint_limits
from cmbot.robot.description.mesh_file import locate_meshes

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
            expected = "more than these" if share else "no total mass: no link with a shape lacks a mass"
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
