"""Inspection of a URDF before it is used, and a summary of its content.

Readers of URDF accept invalid files: pinocchio loads a NaN mass, a zero axis, a lower limit above the upper
one, and drops a shape or a mass that it cannot read; yourdfpy accepts cycles and missing links.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from cmbot.common.errors import ModelError
from cmbot.common.reading.validation import counted, shown
from cmbot.robot.description.files import RobotFiles
from cmbot.robot.description.frames import arm_frames, moving_links
from cmbot.robot.description.limits_file import MoveItLimitsFile, read_joint_limits
from cmbot.robot.description.xml_file import parse_urdf

_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
# Of joints of several coordinates: they are locked, and no arm may have one.
_LOCKED_TYPES = ("floating", "planar")
_SHAPE_TAGS = ("box", "cylinder", "sphere", "mesh")
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
# Number of values of each attribute and the largest magnitude of one, by element, in URDF's units: far beyond
# any robot, but small enough that nothing made of them overflows. A range of positions may be "endless".
_ATTRIBUTE_BOUNDS = {
    "origin": {"xyz": (3, 1e4), "rpy": (3, 25)},
    "mass": {"value": (1, 1e5)},
    "inertia": dict.fromkeys(_MOMENTS, (1, 1e9)),
    "box": {"size": (3, 1e4)},
    "cylinder": {"radius": (1, 1e4), "length": (1, 1e4)},
    "sphere": {"radius": (1, 1e4)},
    "mesh": {"scale": (3, 1e4)},
    "color": {"rgba": (4, 1.0)},
    "axis": {"xyz": (3, 1e3)},
    "limit": {"lower": (1, 1e17), "upper": (1, 1e17), "velocity": (1, 1e6), "effort": (1, 1e9)},
    "mimic": {"multiplier": (1, 1e4), "offset": (1, 1e4)},
    "dynamics": {"damping": (1, 1e9), "friction": (1, 1e9)},
}
# Attributes without which the URDF reader drops the element or refuses the file.
_REQUIRED_ATTRIBUTES = {
    "mass": ("value",),
    "inertia": _MOMENTS,
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
    "color": ("rgba",),
    "limit": ("velocity", "effort"),
    "mimic": ("joint",),
}
# Narrower than Python's: the URDF reader refuses 1_000 and digits of other scripts.
_URDF_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_MAX_TEXT_CHARACTERS = 1000
# A scale or a direction that is smaller is taken for zero.
_ZERO_LENGTH = 1e-9
# Pinocchio calls itself for each link in a row, and its time grows with the square of links and joints.
_MAX_CHAIN_LINKS = 1000
_MAXIMA = {"link": 5000, "joint": 5000, "movable joint": 500, "collision shape": 1000, "visual shape": 1000}
_PLAIN_NAME = re.compile(r"[\w.\- /:]{0,60}")
# Tables are rounded: tolerance, relative, for inertias at the boundary of the physically possible.
_INERTIA_TOLERANCE = 1e-6
# A moment of inertia, kg m2, too small to be felt: that of 0.1 g at 3 cm.
_NEGLIGIBLE_INERTIA = 1e-7


@dataclass(frozen=True, kw_only=True)
class Finding:
    """An error or a warning about a file.

    Attributes
    ----------
    severity : str
        ``error``: it cannot be used. ``warning``: it can, but is questionable.
    key, got, expected : str
        The place in the file, the value there, the value required.
    remedy : str
        What would do, as `expected` says at its end; empty where that is not known.
    """

    severity: Literal["error", "warning"]
    key: str
    got: str
    expected: str
    remedy: str = ""


def inspect_urdf(root: ElementTree.Element, moving: Collection[str] | None = None) -> list[Finding]:
    """List all errors and warnings about a URDF, errors first.

    Parameters
    ----------
    root : xml.etree.ElementTree.Element
        From `parse_urdf`.
    moving : collection of str, optional
        The links that the arm's joints move; impossible inertias of others are no errors. Left out: all.
    """
    if findings := [*_sizes(root)]:
        return findings
    findings = [*_header(root), *_attributes(root), *_materials(root), *_tree(root)]
    for link in root.findall("link"):
        findings += _inertial(link, moving is None or link.get("name", "") in moving)
        findings += _shapes(link)
    for joint in root.findall("joint"):
        findings += _joint(joint)
    return sorted(findings, key=lambda finding: finding.severity)


def inspect_inertias(root: ElementTree.Element, moving: Collection[str]) -> list[Finding]:
    """List what `inspect_urdf` finds about masses and inertias of the links `moving`."""
    links = (link for link in root.findall("link") if link.get("name", "") in moving)
    return [finding for link in links for finding in _inertial(link, moves=True)]


def inspect_robot(files: RobotFiles) -> tuple[ElementTree.Element, list[Finding]]:
    """Parse a robot's URDF and list its errors and warnings, errors first.

    Where it is clear which arm is meant, impossible inertias are errors in links that its joints move;
    elsewhere they are warnings.

    Parameters
    ----------
    files : RobotFiles

    Raises
    ------
    ModelError
        When the URDF or the SRDF cannot be read.
    """
    _, root = files.read()
    findings = inspect_urdf(root, moving=())
    if any(finding.severity == "error" for finding in findings):
        return root, inspect_urdf(root)
    arm = default_arm(files, root)
    return root, findings if arm is None else inspect_urdf(root, moving_links(root, arm[0]))


def error_of(key: str, got: object, expected: str) -> Finding:
    """Return an error as a finding."""
    return Finding(severity="error", key=key, got=str(got), expected=expected)


def warning_of(key: str, got: object, expected: str) -> Finding:
    """Return a warning as a finding."""
    return Finding(severity="warning", key=key, got=str(got), expected=expected)


def _name(element: ElementTree.Element) -> str:
    return f"{element.tag}[{_plain(element.get('name', '?'))}]"


def _plain(name: str) -> str:
    return name if _PLAIN_NAME.fullmatch(name) else shown(name)


def _float(element: ElementTree.Element, attribute: str, default: float) -> float:
    """Value of an attribute; NaN where it is not a number, which `_attributes` reports."""
    try:
        return float(element.get(attribute, default))
    except ValueError:
        return math.nan


def _floats(text: str) -> list[float]:
    """The numbers in a text; none where one is no number, which `_attributes` reports."""
    words = text.split() if len(text) <= _MAX_TEXT_CHARACTERS else []
    return [float(word) for word in words] if all(map(_URDF_NUMBER.fullmatch, words)) else []


def _header(root: ElementTree.Element) -> Iterator[Finding]:
    """The robot has a name, and a version that the URDF reader accepts."""
    if not root.get("name"):
        yield error_of("robot.name", "nothing", "a name")
    version = root.get("version", "1.0")
    if version not in ("1.0", "1.1", "1.2"):
        yield error_of("robot.version", shown(version), "1.0, 1.1 or 1.2")


def _attributes(root: ElementTree.Element) -> Iterator[Finding]:
    """Every element has its required attributes, with the right count of finite numbers."""
    for parent in (child for tag in ("material", "link", "joint") for child in root.findall(tag)):
        for element in parent.iter():
            key = f"{_name(parent)}.{element.tag}"
            for attribute in _REQUIRED_ATTRIBUTES.get(element.tag, ()):
                if not element.get(attribute):
                    yield error_of(f"{key}.{attribute}", repr(element.get(attribute)), "a value")
            for attribute, (count, most) in _ATTRIBUTE_BOUNDS.get(element.tag, {}).items():
                if element.get(attribute) is not None:
                    yield from _numbers(f"{key}.{attribute}", element.get(attribute, ""), count, most)
            if element.get("quat_xyzw") is not None:
                yield error_of(f"{key}.quat_xyzw", "a quaternion", "the angles rpy in place of it")


def _numbers(key: str, text: str, count: int, most: float) -> Iterator[Finding]:
    words = [word for word in text.split(" ") if word] if len(text) <= _MAX_TEXT_CHARACTERS else []
    well_formed = len(words) == count and all(map(_URDF_NUMBER.fullmatch, words))
    if not well_formed or not all(math.isfinite(float(word)) for word in words):
        yield error_of(key, shown(text), counted(count, "finite number"))
    elif key.endswith("rgba"):
        if not all(0 <= float(word) <= most for word in words):
            yield error_of(key, shown(text), "4 numbers from 0 to 1")
    elif any(abs(float(word)) > most for word in words):
        unit = " rad (degrees?)" * key.endswith("rpy")
        yield error_of(key, shown(text), f"{counted(count, 'finite number')} of at most {most:g}{unit}")


def _materials(root: ElementTree.Element) -> Iterator[Finding]:
    """Materials have names and a look. They are only seen: what is wrong with one is left out."""
    seen = set[str]()
    for material in root.findall("material"):
        name = material.get("name", "")
        if not name:
            yield warning_of(_name(material), "no name", "a name; this material is not used")
        elif name in seen:
            yield warning_of(_name(material), "another one of that name", "a unique name; the first is used")
        elif material.find("color") is None and material.find("texture") is None:
            yield warning_of(_name(material), "neither colour nor texture", "<color> or <texture>")
        seen.add(name)
    for link in root.findall("link"):
        for material in link.iter("material"):
            if not material.get("name"):
                yield warning_of(f"{_name(link)}.material", "no name", "the name of a material")
        for texture in link.iter("texture"):
            if not texture.get("filename"):
                yield warning_of(f"{_name(link)}.texture", "no file", "the name of a picture; none is shown")


def _tree(root: ElementTree.Element) -> Iterator[Finding]:
    """Links and joints form one tree with unique names."""
    for tag in ("link", "joint"):
        names = Counter(element.get("name", "") for element in root.findall(tag))
        for name in sorted(name for name, number in names.items() if number > 1 or not name):
            yield error_of(f"{tag}[{_plain(name)}]", f"{names[name]} of that name", "a unique name for each")
        if "universe" in names:
            yield error_of(f"{tag}[universe]", "pinocchio's name for the world", "another name")
    links = {link.get("name", "") for link in root.findall("link")}
    if not links:
        yield error_of("link", "none", "at least one link")
        return
    parents: dict[str, str] = {}
    for joint in root.findall("joint"):
        if joint.get("type") != "fixed" and joint.get("name") in links:
            yield warning_of(_name(joint), "the name of a link", "a name that no link has, to be the arm's")
        ends = {}
        for end in ("parent", "child"):
            element = joint.find(end)
            ends[end] = "" if element is None else element.get("link", "")
            if ends[end] not in links:
                yield error_of(f"{_name(joint)}.{end}", shown(ends[end]), "the name of a link of this file")
        if ends["child"] in parents:
            yield error_of(
                f"{_name(joint)}.child", _plain(ends["child"]), "a link that is no other joint's child"
            )
        parents[ends["child"]] = ends["parent"]
    roots = sorted(links - parents.keys())
    if len(roots) != 1:
        yield error_of("robot", f"root links {shown(roots)}", "exactly one link that is no joint's child")
    yield from _rows(links, parents)


def _rows(links: set[str], parents: Mapping[str, str]) -> Iterator[Finding]:
    """No links form a cycle or a row that is too long, in a time that grows with their number."""
    depths: dict[str, int] = {}
    cyclic = set[str]()
    for link in links:
        row, place, above = list[str](), dict[str, int](), link
        while above in parents and above not in depths and above not in place:
            place[above] = len(row)
            row.append(above)
            above = parents[above]
        if above in place:
            cyclic.update(row[place[above] :])
        depth = depths.get(above, 0)
        for number, name in enumerate(reversed(row), start=1):
            depths[name] = depth + number
    for link in sorted(cyclic):
        yield error_of(f"link[{_plain(link)}]", "a cycle of joints", "a tree")
    if not cyclic and depths and (longest := max(depths.values())) > _MAX_CHAIN_LINKS:
        yield error_of("robot", f"{longest} joints in a row", f"at most {_MAX_CHAIN_LINKS}")


def _sizes(root: ElementTree.Element) -> Iterator[Finding]:
    """There are not too many parts."""
    joints = root.findall("joint")
    numbers = {
        "link": len(root.findall("link")),
        "joint": len(joints),
        "movable joint": sum(joint.get("type") != "fixed" for joint in joints),
        "collision shape": len(root.findall("link/collision")),
        "visual shape": len(root.findall("link/visual")),
    }
    for part, number in numbers.items():
        if number > _MAXIMA[part]:
            yield error_of("robot", counted(number, part), f"at most {_MAXIMA[part]}")


def _inertial(link: ElementTree.Element, moves: bool) -> Iterator[Finding]:
    """Masses and inertias are physically possible; only those of links that move have to be."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    mass, tensor = inertial.find("mass"), inertial.find("inertia")
    if mass is None or tensor is None:
        yield error_of(f"{_name(link)}.inertial", "no mass or no inertia", "both <mass> and <inertia>")
        return
    m = _float(mass, "value", math.nan)
    if m < 0:
        yield error_of(f"{_name(link)}.inertial.mass", m, "a mass that is not negative")
    xx, yy, zz, xy, xz, yz = (_float(tensor, name, 0.0) for name in _MOMENTS)
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.isfinite(inertia).all():
        return
    moments = np.linalg.eigvalsh(inertia)
    listed = "principal moments " + ", ".join(f"{moment:.4g}" for moment in moments)
    if moments[0] < -_INERTIA_TOLERANCE * max(moments[2], 0.0) or moments[2] < 0:
        felt = moves and moments[0] < -_NEGLIGIBLE_INERTIA
        yield (error_of if felt else warning_of)(f"{_name(link)}.inertial.inertia", listed, "none negative")
    elif moments[2] > (moments[0] + moments[1]) * (1 + _INERTIA_TOLERANCE):
        expected = "the largest at most the sum of the others, as for any rigid body"
        yield warning_of(f"{_name(link)}.inertial.inertia", listed, expected)


def _shapes(link: ElementTree.Element) -> Iterator[Finding]:
    """Every collision and visual element holds one shape of a known kind and no negative size."""
    for element in (*link.findall("collision"), *link.findall("visual")):
        key = f"{_name(link)}.{element.tag}.geometry"
        shapes = [shape for geometry in element.findall("geometry") for shape in geometry]
        if len(shapes) != 1 or shapes[0].tag not in _SHAPE_TAGS:
            listed = shown(", ".join(f"<{shape.tag}>" for shape in shapes))[1:-1] or "nothing"
            yield error_of(key, listed, "one of " + ", ".join(_SHAPE_TAGS))
            continue
        for attribute in ("size", "radius", "length"):
            text = shapes[0].get(attribute, "")
            if any(word.startswith("-") for word in text.split()):
                yield error_of(f"{key}.{shapes[0].tag}.{attribute}", shown(text), "no negative size")
        scale = shapes[0].get("scale", "1")
        if any(abs(number) < _ZERO_LENGTH for number in _floats(scale)):
            yield error_of(f"{key}.mesh.scale", shown(scale), "no scale of zero")


def _joint(joint: ElementTree.Element) -> Iterator[Finding]:
    """Types are known, axes have a direction, limits are in order."""
    kind = joint.get("type", "")
    if kind in _LOCKED_TYPES:
        expected = "a joint that turns or slides; this one is locked where it is"
        yield warning_of(f"{_name(joint)}.type", kind, expected)
        return
    if kind not in _JOINT_TYPES:
        yield error_of(f"{_name(joint)}.type", shown(kind), "one of " + ", ".join(_JOINT_TYPES))
    if kind == "fixed":
        return
    axis = joint.find("axis")
    if axis is not None:
        text = axis.get("xyz")
        # Without <axis> it is x; without its xyz readers take zero.
        numbers = [0.0] if text is None else _floats(text)
        if numbers and math.hypot(*numbers) < _ZERO_LENGTH:
            got = "no xyz" if text is None else shown(text)
            yield error_of(f"{_name(joint)}.axis", got, "a direction, not zero")
    limit = joint.find("limit")
    if limit is None:
        if kind in ("revolute", "prismatic"):
            yield error_of(f"{_name(joint)}.limit", "none", "<limit> with lower, upper, velocity and effort")
        return
    lower, upper = _float(limit, "lower", 0.0), _float(limit, "upper", 0.0)
    if kind != "continuous" and lower > upper:
        yield error_of(f"{_name(joint)}.limit", f"lower {lower:g} > upper {upper:g}", "lower <= upper")
    for name in ("velocity", "effort"):
        if _float(limit, name, 0.0) < 0:
            yield error_of(
                f"{_name(joint)}.limit.{name}", shown(limit.get(name)), "a number that is not negative"
            )


def overview(files: RobotFiles, root: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Summarise a URDF and the files that go with it, as names and values.

    Parameters
    ----------
    files : RobotFiles
    root : xml.etree.ElementTree.Element
        From `parse_urdf`, without errors in `inspect_urdf`.

    Raises
    ------
    ModelError
        When the joint-limits file or the SRDF cannot be read.
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
        yield "prismatic joints", f"{kinds['prismatic']}, in m and N; the others in rad and Nm"
    yield "limits in the URDF", _limits(joints)
    yield "joint_limits.yaml beside it", _joint_limits(files, joints)
    none = "none: links that are neighbours or nearly always near may touch"
    yield "SRDF", none if files.srdf is None else files.srdf.name
    if files.srdf is not None:
        yield "group states in it", _group_states(files.srdf)
    yield "elasticity file", "none: nothing bends" if files.elasticity is None else files.elasticity.name
    yield "base frame", f"any link; the root is {next(link for link in links if link not in children)}"
    ends = [link for link in links if link not in parents]
    yield "tool frame", f"any link that joints move below it; at the ends: {', '.join(ends)}"
    arm = default_arm(files, root)
    chosen = "none: there are several choices" if arm is None else f"from {arm[0]} to {arm[1]}"
    yield "arm where no frames are given", chosen


def _group_states(srdf: Path) -> str:
    """The names of an SRDF's group states, each with its group's."""
    states = parse_urdf(srdf, "an SRDF").findall("group_state")
    named = (f"{_plain(state.get('name', ''))} ({_plain(state.get('group', ''))})" for state in states)
    return ", ".join(named) or "none"


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


def default_arm(files: RobotFiles, root: ElementTree.Element) -> tuple[str, str] | None:
    """Base and tool frame that `load_robot` chooses; None where it cannot."""
    semantics = None if files.srdf is None else parse_urdf(files.srdf, "an SRDF")
    try:
        return arm_frames(root, semantics, files.base_frame, files.tool_frame, str(files.urdf))
    except ModelError:
        return None


def _joint_limits(files: RobotFiles, joints: Sequence[ElementTree.Element]) -> str:
    if files.limits is None:
        what = "none" if files.left_alone is None else f"left alone ({files.left_alone[1]})"
        return f"{what}: acceleration and jerk limits are assumed where the scene names none"
    known = read_joint_limits(files.limits)
    given = [known.of(joint.get("name", ""), joint.get("type") == "prismatic") for joint in joints]
    number = sum(None not in (each.acceleration, each.jerk) for each in given)
    whose = f"MoveIt's, {files.limits}: " if isinstance(known, MoveItLimitsFile) else ""
    return f"{whose}acceleration and jerk of {number} of {counted(len(joints), 'movable joint')}"
