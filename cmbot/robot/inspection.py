"""Inspection of a URDF before it is used, and a summary of its content.

Readers of URDF accept invalid files: pinocchio loads a NaN mass, a zero axis, a lower limit above the upper
one, and drops a shape or a mass that it cannot read; yourdfpy accepts cycles and missing links.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from cmbot.common.errors import ModelError
from cmbot.common.validation import counted
from cmbot.robot.limits import read_joint_limits

__all__ = ["Finding", "inspect_urdf", "overview", "parse_urdf"]

_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_SHAPES = ("box", "cylinder", "sphere", "mesh")
_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
# Number of values of each attribute, by element.
_COUNTS = {
    "origin": {"xyz": 3, "rpy": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(_INERTIA, 1),
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
    "color": {"rgba": 4},
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(("lower", "upper", "velocity", "effort"), 1),
    "mimic": {"multiplier": 1, "offset": 1},
}
# Attributes without which the URDF reader drops the element or refuses the file.
_REQUIRED = {
    "mass": ("value",),
    "inertia": _INERTIA,
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
    "color": ("rgba",),
    "limit": ("velocity", "effort"),
    "mimic": ("joint",),
    "material": ("name",),
    "texture": ("filename",),
}
# Narrower than Python's: the URDF reader refuses 1_000 and digits of other scripts.
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
# Tables are rounded: tolerance, relative, for inertias at the boundary of the physically possible.
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True)
class Finding:
    """An error or a warning about a file.

    Attributes
    ----------
    severity : str
        ``error``: it cannot be used. ``warning``: it can, but is questionable.
    key, got, expected : str
        The place in the file, the value there, the value required.
    """

    severity: Literal["error", "warning"]
    key: str
    got: str
    expected: str


def parse_urdf(path: Path, kind: str = "a URDF") -> ElementTree.Element:
    """Parse a URDF or, as an error names its `kind`, an SRDF into its XML tree.

    Raises
    ------
    ModelError
        When the file is missing, unreadable, no XML or its root element is not ``<robot>``.
    """
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except FileNotFoundError as error:
        raise ModelError(str(path), "", "no such file", f"{kind} file") from error
    except OSError as error:
        got = f"a file that cannot be read ({error.strerror or error})"
        raise ModelError(str(path), "", got, f"{kind} file") from error
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two: unknown encodings
        got = f"text that is not well-formed XML ({error})"
        raise ModelError(str(path), "", got, f"{kind} file") from error
    if root.tag != "robot":
        raise ModelError(str(path), "", f"<{root.tag}>", f"{kind}, whose root element is <robot>")
    return root


def inspect_urdf(root: ElementTree.Element) -> list[Finding]:
    """List all errors and warnings about a URDF, errors first.

    Parameters
    ----------
    root : xml.etree.ElementTree.Element
        From `parse_urdf`.
    """
    findings = [*_header(root), *_attributes(root), *_materials(root), *_tree(root), *_joint_types(root)]
    for link in root.findall("link"):
        findings += _inertial(link)
        findings += _shapes(link)
    for joint in root.findall("joint"):
        findings += _joint(joint)
    return sorted(findings, key=lambda finding: finding.severity)


def _error(key: str, got: object, expected: str) -> Finding:
    return Finding(severity="error", key=key, got=str(got), expected=expected)


def _name(element: ElementTree.Element) -> str:
    return f"{element.tag}[{element.get('name', '?')}]"


def _float(element: ElementTree.Element, attribute: str, default: float) -> float:
    """Value of an attribute; NaN where it is not a number, which `_attributes` reports."""
    try:
        return float(element.get(attribute, default))
    except ValueError:
        return math.nan


def _header(root: ElementTree.Element) -> Iterator[Finding]:
    """The robot has a name, and a version that the URDF reader accepts."""
    if not root.get("name"):
        yield _error("robot.name", "nothing", "a name")
    version = root.get("version", "1.0")
    if version not in ("1.0", "1.1", "1.2"):
        yield _error("robot.version", repr(version), "1.0, 1.1 or 1.2")


def _attributes(root: ElementTree.Element) -> Iterator[Finding]:
    """Every element has its required attributes, with the right count of finite numbers."""
    for parent in (child for tag in ("material", "link", "joint") for child in root.findall(tag)):
        for element in parent.iter():
            key = f"{_name(parent)}.{element.tag}"
            for attribute in _REQUIRED.get(element.tag, ()):
                if not element.get(attribute):
                    yield _error(f"{key}.{attribute}", repr(element.get(attribute)), "a value")
            for attribute, count in _COUNTS.get(element.tag, {}).items():
                if element.get(attribute) is not None:
                    yield from _numbers(f"{key}.{attribute}", element.get(attribute, ""), count)


def _numbers(key: str, text: str, count: int) -> Iterator[Finding]:
    words = [word for word in text.split(" ") if word]
    well_formed = len(words) == count and all(map(_NUMBER.fullmatch, words))
    if not well_formed or not all(math.isfinite(float(word)) for word in words):
        yield _error(key, repr(text), counted(count, "finite number"))
    elif key.endswith("rgba") and not all(0 <= float(word) <= 1 for word in words):
        yield _error(key, repr(text), "4 numbers from 0 to 1")


def _materials(root: ElementTree.Element) -> Iterator[Finding]:
    """Every shared material has a colour or a texture."""
    for material in root.findall("material"):
        if material.find("color") is None and material.find("texture") is None:
            yield _error(_name(material), "neither colour nor texture", "<color> or <texture>")


def _tree(root: ElementTree.Element) -> Iterator[Finding]:
    """Links and joints form one tree with unique names."""
    for tag in ("link", "joint", "material"):
        names = [element.get("name", "") for element in root.findall(tag)]
        for name in sorted({name for name in names if names.count(name) > 1 or not name}):
            yield _error(f"{tag}[{name}]", f"{names.count(name)} of that name", "a unique name for each")
        if "universe" in names:
            yield _error(f"{tag}[universe]", "pinocchio's name for the world", "another name")
    links = {link.get("name", "") for link in root.findall("link")}
    if not links:
        yield _error("link", "none", "at least one link")
        return
    parents: dict[str, str] = {}
    for joint in root.findall("joint"):
        if joint.get("type") != "fixed" and joint.get("name") in links:
            yield _error(_name(joint), "the name of a link", "a name that no link has")
        ends = {}
        for end in ("parent", "child"):
            element = joint.find(end)
            ends[end] = "" if element is None else element.get("link", "")
            if ends[end] not in links:
                yield _error(f"{_name(joint)}.{end}", repr(ends[end]), "the name of a link of this file")
        if ends["child"] in parents:
            yield _error(f"{_name(joint)}.child", ends["child"], "a link that is no other joint's child")
        parents[ends["child"]] = ends["parent"]
    roots = sorted(links - parents.keys())
    if len(roots) != 1:
        yield _error("robot", f"root links {roots}", "exactly one link that is no joint's child")
    for link in sorted(links):
        seen = {link}
        above = parents.get(link)
        while above is not None and above not in seen:
            seen.add(above)
            above = parents.get(above)
        if above == link:
            yield _error(f"link[{link}]", "a cycle of joints", "a tree")


def _joint_types(root: ElementTree.Element) -> Iterator[Finding]:
    """Some joint is revolute or continuous: only an arm of such joints can be planned."""
    kinds = [joint.get("type") for joint in root.findall("joint")]
    prismatic = kinds.count("prismatic")
    if prismatic and not {"revolute", "continuous"} & set(kinds):
        got = f"{counted(prismatic, 'prismatic joint')} and none that turns"
        expected = "an arm of revolute or continuous joints between base and tool frame"
        yield Finding(severity="warning", key="joint", got=got, expected=expected)


def _inertial(link: ElementTree.Element) -> Iterator[Finding]:
    """Masses and inertias are physically possible."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    mass, tensor = inertial.find("mass"), inertial.find("inertia")
    if mass is None or tensor is None:
        yield _error(f"{_name(link)}.inertial", "no mass or no inertia", "both <mass> and <inertia>")
        return
    m = _float(mass, "value", math.nan)
    if m < 0:
        yield _error(f"{_name(link)}.inertial.mass", m, "a mass that is not negative")
    xx, yy, zz, xy, xz, yz = (_float(tensor, name, 0.0) for name in _INERTIA)
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.isfinite(inertia).all():
        return
    moments = np.linalg.eigvalsh(inertia)
    shown = "principal moments " + ", ".join(f"{moment:.4g}" for moment in moments)
    if moments[0] < -_ROUNDING * max(moments[2], 0.0) or moments[2] < 0:
        yield _error(f"{_name(link)}.inertial.inertia", shown, "none negative")
    elif moments[2] > (moments[0] + moments[1]) * (1 + _ROUNDING):
        expected = "the largest at most the sum of the others, as for any rigid body"
        yield Finding(severity="warning", key=f"{_name(link)}.inertial.inertia", got=shown, expected=expected)


def _shapes(link: ElementTree.Element) -> Iterator[Finding]:
    """Every collision and visual element holds one shape of a known kind and no negative size."""
    for element in (*link.findall("collision"), *link.findall("visual")):
        key = f"{_name(link)}.{element.tag}.geometry"
        shapes = [shape for geometry in element.findall("geometry") for shape in geometry]
        if len(shapes) != 1 or shapes[0].tag not in _SHAPES:
            shown = ", ".join(f"<{shape.tag}>" for shape in shapes) or "nothing"
            yield _error(key, shown, "one of " + ", ".join(_SHAPES))
            continue
        for attribute in ("size", "radius", "length"):
            text = shapes[0].get(attribute, "")
            if any(word.startswith("-") for word in text.split()):
                yield _error(f"{key}.{shapes[0].tag}.{attribute}", repr(text), "no negative size")


def _joint(joint: ElementTree.Element) -> Iterator[Finding]:
    """Types are known, axes have a direction, limits are in order."""
    kind = joint.get("type", "")
    if kind not in _JOINT_TYPES:
        yield _error(f"{_name(joint)}.type", repr(kind), "one of " + ", ".join(_JOINT_TYPES))
    if kind == "fixed":
        return
    axis = joint.find("axis")
    if axis is not None:
        words = axis.get("xyz", "1 0 0").split()
        if all(map(_NUMBER.fullmatch, words)) and math.hypot(*map(float, words)) < 1e-9:
            yield _error(f"{_name(joint)}.axis", repr(axis.get("xyz")), "a direction, not zero")
    limit = joint.find("limit")
    if limit is None:
        if kind in ("revolute", "prismatic"):
            yield _error(f"{_name(joint)}.limit", "none", "<limit> with lower, upper, velocity and effort")
        return
    lower, upper = _float(limit, "lower", 0.0), _float(limit, "upper", 0.0)
    if kind != "continuous" and lower > upper:
        yield _error(f"{_name(joint)}.limit", f"lower {lower:g} > upper {upper:g}", "lower <= upper")
    for name in ("velocity", "effort"):
        if _float(limit, name, 0.0) < 0:
            yield _error(f"{_name(joint)}.limit.{name}", limit.get(name), "a number that is not negative")


def overview(path: Path, root: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Summarise a URDF and the files beside it, as names and values.

    Parameters
    ----------
    path : pathlib.Path
    root : xml.etree.ElementTree.Element
        From `parse_urdf`, without errors in `inspect_urdf`.

    Raises
    ------
    ModelError
        When the joint-limits file beside it cannot be read.
    """
    joints = [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]
    links = [link.get("name", "") for link in root.findall("link")]
    parents, children = (
        {element.get("link", "") for element in root.findall(f"joint/{end}")} for end in ("parent", "child")
    )
    mass = sum(float(mass.get("value", "0")) for mass in root.findall("link/inertial/mass"))
    yield "robot", root.get("name", "")
    yield "links", f"{len(links)}, {mass:.2f} kg in all"
    kinds = Counter(joint.get("type", "") for joint in joints)
    listed = ", ".join(f"{number} {kind}" for kind, number in kinds.items())
    yield "movable joints", f"{len(joints)} ({listed})" if listed else "none"
    if kinds["prismatic"]:
        where = (
            "not between base and tool frame: an arm that is planned has revolute or continuous joints only"
        )
        yield "prismatic joints", f"{kinds['prismatic']}, {where}"
    yield "limits in the URDF", _limits(joints)
    yield "joint_limits.yaml beside it", _joint_limits(path.with_name("joint_limits.yaml"), joints)
    srdf = path.with_suffix(".srdf")
    yield "SRDF beside it", srdf.name if srdf.exists() else "none: only neighbouring links may touch"
    elasticity = path.with_suffix(".elasticity.yaml")
    yield "elasticity file beside it", elasticity.name if elasticity.exists() else "none: no link bends"
    yield "base frame", f"any link; the root is {next(link for link in links if link not in children)}"
    ends = [link for link in links if link not in parents]
    yield "tool frame", f"any link that joints move below it; at the ends: {', '.join(ends)}"


def _limits(joints: Sequence[ElementTree.Element]) -> str:
    """Count the joints that have each limit; a continuous one needs no range of positions."""
    numbers = {"position": 0, "velocity": 0, "effort": 0}
    for joint in joints:
        limit = joint.find("limit")
        lower, upper, velocity, effort = (
            0.0 if limit is None else float(limit.get(name, "0"))
            for name in ("lower", "upper", "velocity", "effort")
        )
        numbers["position"] += lower < upper or joint.get("type") == "continuous"
        numbers["velocity"] += velocity > 0
        numbers["effort"] += effort > 0
    listed = ", ".join(f"{name} {number}" for name, number in numbers.items())
    return f"of {counted(len(joints), 'movable joint')}: {listed}"


def _joint_limits(path: Path, joints: Sequence[ElementTree.Element]) -> str:
    if not path.exists():
        return "none: the scene has to name one, with acceleration and jerk"
    known = read_joint_limits(path)
    number = sum(joint.get("name") in known for joint in joints)
    return f"acceleration and jerk of {number} of {counted(len(joints), 'movable joint')}"
