"""What a URDF must hold before it is used: readers of URDF accept far more than can be right.

pinocchio loads a NaN mass, a zero axis, a lower limit above the upper one; yourdfpy accepts cycles and
missing links. `inspect_urdf` looks at the file itself and lists everything it finds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from cmbot.errors import ModelError

__all__ = ["Finding", "inspect_urdf", "parse_urdf"]

_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
# Tables are rounded: an inertia this close to the boundary of the possible counts as possible.
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that is wrong (``error``) or doubtful (``warning``) in a URDF.

    Attributes
    ----------
    severity : str
        ``error``: the model cannot be used. ``warning``: it can, but look at it.
    key, got, expected : str
        Where, what stands there, what should.
    """

    severity: Literal["error", "warning"]
    key: str
    got: str
    expected: str


def parse_urdf(path: Path) -> ElementTree.Element:
    """Parse a URDF file into its XML tree.

    Raises
    ------
    ModelError
        When the file is missing, unreadable, no XML or no URDF.
    """
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except OSError as error:
        raise ModelError(str(path), "", error.strerror or error, "a readable URDF file") from error
    except ElementTree.ParseError as error:
        raise ModelError(str(path), "", f"no XML ({error})", "a URDF file") from error
    if root.tag != "robot":
        raise ModelError(str(path), "", f"<{root.tag}>", "a URDF, whose root element is <robot>")
    return root


def inspect_urdf(root: ElementTree.Element) -> list[Finding]:
    """List everything that is wrong or doubtful in a URDF, errors first.

    Parameters
    ----------
    root : xml.etree.ElementTree.Element
        From `parse_urdf`.
    """
    findings = [*_numbers(root), *_tree(root)]
    for link in root.findall("link"):
        findings += _inertial(link)
    for joint in root.findall("joint"):
        findings += _joint(joint)
    return sorted(findings, key=lambda finding: finding.severity)


def _error(key: str, got: object, expected: str) -> Finding:
    return Finding(severity="error", key=key, got=str(got), expected=expected)


def _name(element: ElementTree.Element) -> str:
    return f"{element.tag}[{element.get('name', '?')}]"


def _float(element: ElementTree.Element, attribute: str, default: float) -> float:
    """Value of an attribute; NaN where it is no number (`_numbers` reports those)."""
    try:
        return float(element.get(attribute, default))
    except ValueError:
        return math.nan


def _numbers(root: ElementTree.Element) -> Iterator[Finding]:
    """Every attribute that holds numbers holds finite ones, and as many as it should."""
    counts = {"xyz": 3, "rpy": 3, "size": 3, "scale": 3, "rgba": 4, "value": 1, "mass": 1}
    counts |= dict.fromkeys((*_INERTIA, "lower", "upper", "velocity", "effort", "radius", "length"), 1)
    for parent in [*root.findall("link"), *root.findall("joint")]:
        for element in parent.iter():
            for attribute in counts.keys() & element.keys():
                text = element.get(attribute, "")
                key = f"{_name(parent)}.{element.tag}.{attribute}"
                try:
                    values = [float(word) for word in text.split()]
                except ValueError:
                    yield _error(key, repr(text), f"{counts[attribute]} number(s)")
                    continue
                if len(values) != counts[attribute] or not all(map(math.isfinite, values)):
                    yield _error(key, repr(text), f"{counts[attribute]} finite number(s)")


def _tree(root: ElementTree.Element) -> Iterator[Finding]:
    """Links and joints form one tree with unique names."""
    for tag in ("link", "joint"):
        names = [element.get("name", "") for element in root.findall(tag)]
        for name in sorted({name for name in names if names.count(name) > 1 or not name}):
            yield _error(f"{tag}[{name}]", f"{names.count(name)} of that name", "a unique name for each")
    links = {link.get("name", "") for link in root.findall("link")}
    if not links:
        yield _error("link", "none", "at least one link")
        return
    parents: dict[str, str] = {}
    for joint in root.findall("joint"):
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


def _inertial(link: ElementTree.Element) -> Iterator[Finding]:
    """Masses and inertias are those of possible rigid bodies."""
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
    I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.isfinite(I).all():
        return
    moments = np.linalg.eigvalsh(I)
    shown = "principal moments " + ", ".join(f"{moment:.4g}" for moment in moments)
    if moments[0] < -_ROUNDING * max(moments[2], 0.0) or moments[2] < 0:
        yield _error(f"{_name(link)}.inertial.inertia", shown, "none negative")
    elif moments[2] > (moments[0] + moments[1]) * (1 + _ROUNDING):
        yield Finding(
            severity="warning",
            key=f"{_name(link)}.inertial.inertia",
            got=shown,
            expected="the largest at most the sum of the others, as for any rigid body",
        )


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
        try:
            length = math.hypot(*map(float, words))
        except ValueError:
            return
        if length < 1e-9:
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
