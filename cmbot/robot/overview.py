"""What a sound URDF holds, in a few lines for a person."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

from cmbot.common.validation import counted
from cmbot.robot.limits import joints_with_limits

__all__ = ["overview"]


def overview(path: Path, root: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Yield what a URDF holds and what stands beside it, as names and values.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    root : xml.etree.ElementTree.Element
        From `parse_urdf`; `inspect_urdf` finds no error in it.

    Raises
    ------
    ModelError
        When the joint-limits file beside it cannot be read.
    """
    joints = [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]
    links = [link.get("name", "") for link in root.findall("link")]
    parents, children = _ends(root, "parent"), _ends(root, "child")
    mass = sum(float(mass.get("value", "0")) for mass in root.findall("link/inertial/mass"))
    yield "robot", root.get("name", "")
    yield "links", f"{len(links)}, {mass:.2f} kg in all"
    yield "movable joints", _kinds(joints)
    sliding = sum(joint.get("type") == "prismatic" for joint in joints)
    if sliding:
        where = (
            "not between base and tool frame: an arm that is planned has revolute or continuous joints only"
        )
        yield "prismatic joints", f"{sliding}, {where}"
    yield "limits in the URDF", _limits(joints)
    yield "joint_limits.yaml beside it", _joint_limits(path.with_name("joint_limits.yaml"), joints)
    srdf = path.with_suffix(".srdf")
    yield "SRDF beside it", srdf.name if srdf.exists() else "none: only neighbouring links may touch"
    elasticity = path.with_suffix(".elasticity.yaml")
    yield "elasticity file beside it", elasticity.name if elasticity.exists() else "none: no link bends"
    yield "base frame", f"any link; the root is {next(link for link in links if link not in children)}"
    ends = [link for link in links if link not in parents]
    yield "tool frame", f"any link that joints move below it; at the ends: {', '.join(ends)}"


def _ends(root: ElementTree.Element, end: str) -> set[str]:
    """Names of all links at that end of a joint, ``parent`` or ``child``."""
    return {element.get("link", "") for element in root.findall(f"joint/{end}")}


def _kinds(joints: Sequence[ElementTree.Element]) -> str:
    kinds = Counter(joint.get("type", "") for joint in joints)
    listed = ", ".join(f"{number} {kind}" for kind, number in kinds.items())
    return f"{len(joints)} ({listed})" if listed else "none"


def _limits(joints: Sequence[ElementTree.Element]) -> str:
    """How many joints have limits that an arm's joint needs; a continuous one needs none of its position."""
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
    known = joints_with_limits(path)
    number = sum(joint.get("name") in known for joint in joints)
    return f"acceleration and jerk of {number} of {counted(len(joints), 'movable joint')}"
