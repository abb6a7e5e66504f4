"""Which frames bound the arm where nothing names them: by the SRDF, else by the tree of links."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

from cmbot.common.errors import ModelError
from cmbot.common.reading.validation import shown

_ROTARY_TYPES = ("revolute", "continuous")
_MOVING_TYPES = (*_ROTARY_TYPES, "prismatic")
# The name of a tool frame in ROS-Industrial's convention.
_ROS_TOOL_FRAME = "tool0"


def arm_frames(
    root: ElementTree.Element,
    semantics: ElementTree.Element | None,
    base_frame: str | None,
    tool_frame: str | None,
    source: str,
) -> tuple[str, str]:
    """Return base and tool frame of an arm, with what is not given chosen where there is one choice.

    The tool frame is the link of the SRDF's only end effector, or the tip of its only chain; without these
    the last link of the row with most joints that turn, ``tool0`` before other links fixed to it. The base
    frame is the base of that chain, else the root link. A chain in which joints slide counts where none is
    there without; what slides at the end of a row is a gripper.

    Parameters
    ----------
    root : xml.etree.ElementTree.Element
        Of a URDF without errors.
    semantics : xml.etree.ElementTree.Element or None
        Of the SRDF.
    base_frame, tool_frame : str or None
    source : str
        The URDF, for messages.

    Raises
    ------
    ModelError
        When there are several choices, or none; it lists the ends of the tree.
    """
    tree = _Tree(root)
    chains = list(dict.fromkeys(_chains(tree, semantics)))
    if base_frame is None and tool_frame is None and len(chains) == 1:
        return chains[0]
    base = tree.root if base_frame is None else base_frame
    if tool_frame is not None:
        return base, tool_frame
    ends = list(dict.fromkeys(_end_effectors(tree, semantics)))
    ends = [link for link in ends if base in tree.row(link)]
    if len(ends) == 1 and tree.moving(base, ends[0]):
        return base, ends[0]
    tips = [tip for start, tip in chains if start == base]
    return base, tips[0] if len(tips) == 1 else _last_link(tree, base, source)


def moving_links(root: ElementTree.Element, base_frame: str) -> set[str]:
    """Return the links that joints move below `base_frame`, fixed ones on them included."""
    tree = _Tree(root)
    return {link for link in tree.links if tree.joints(base_frame, link)}


def links_beside(root: ElementTree.Element, link: str) -> dict[str, ElementTree.Element]:
    """Return the links of a URDF that `link` does not lead to, by name; all where it has no such link."""
    tree = _Tree(root)
    beside = {name for name in tree.links if link not in tree.row(name)}
    return {name: each for each in root.findall("link") if (name := each.get("name", "")) in beside}


def row_of(root: ElementTree.Element, link: str) -> dict[str, str]:
    """Return the links from the root to `link`, each with the last joint before it that moves, or nothing."""
    tree = _Tree(root)
    row = tree.row(link)
    joints = {name: tree.joints(row[0], name) for name in row}
    return {name: each[-1].get("name", "") if each else "" for name, each in joints.items()}


@dataclass(frozen=True)
class Following:
    """Where a joint is: at ``multiplier * q + offset`` of the joint `leader`, which may be itself."""

    leader: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class _Misled:
    """Why a joint follows none: key, what is there, and what is expected."""

    key: str
    got: str
    expected: str


def followed(
    root: ElementTree.Element, base_frame: str, tool_frame: str, source: str
) -> dict[str, Following]:
    """Return what each joint of an arm follows at last, by its name, base to tool.

    Raises
    ------
    ModelError
        With a joint as its key that neither turns nor slides, has the name of a link, or follows no other
        joint that does.
    """
    tree = _Tree(root)
    each = {}
    for joint in tree.joints(base_frame, tool_frame):
        name, kind = joint.get("name", ""), joint.get("type")
        if name in tree.links:
            # Pinocchio finds no frame then; elsewhere such a joint is renamed.
            raise ModelError(source, f"joint[{name}]", "the name of a link", "a name that no link has")
        if kind not in _MOVING_TYPES:
            expected = "an arm of revolute, continuous or prismatic joints"
            raise ModelError(source, f"joint[{name}].type", kind, expected)
        led = tree.following(joint)
        if isinstance(led, _Misled):
            raise ModelError(source, led.key, led.got, led.expected)
        each[name] = led
    return each


class _Tree:
    """Links and the joints above them."""

    def __init__(self, root: ElementTree.Element) -> None:
        self.urdf = root
        self.links = [link.get("name", "") for link in root.findall("link")]
        self.above: dict[str, ElementTree.Element] = {}
        self.parents: dict[str, str] = {}
        for joint in root.findall("joint"):
            parent, child = joint.find("parent"), joint.find("child")
            if parent is not None and child is not None:
                self.above[child.get("link", "")] = joint
                self.parents[child.get("link", "")] = parent.get("link", "")
        self.root = next((link for link in self.links if link not in self.above), "")

    def row(self, link: str) -> list[str]:
        """The links from the root to `link`."""
        row = [link]
        while row[0] in self.parents:
            row.insert(0, self.parents[row[0]])
        return row

    def joints(self, base: str, link: str) -> list[ElementTree.Element]:
        """The movable joints from `base` to `link`, in that order; none where `base` is not above it."""
        row = self.row(link)
        below = row[row.index(base) + 1 :] if base in row else []
        return [self.above[name] for name in below if self.above[name].get("type") != "fixed"]

    def following(self, joint: ElementTree.Element) -> Following | _Misled:
        """What a joint follows at last, or why that is no joint that moves by itself."""
        found, passed, first = Following(joint.get("name", "")), list[str](), joint
        while (mimic := joint.find("mimic")) is not None:
            passed.append(found.leader)
            leader, factor = mimic.get("joint", ""), float(mimic.get("multiplier", "1"))
            found = Following(
                leader,
                found.multiplier * factor,
                found.multiplier * float(mimic.get("offset", "0")) + found.offset,
            )
            others = (each for each in self.urdf.findall("joint") if each.get("name") == leader)
            moving = next((each for each in others if each.get("type") in _MOVING_TYPES), None)
            key = f"joint[{first.get('name')}].mimic"
            if moving is None or leader in self.links or leader in passed:
                got = "joints that follow each other" if leader in passed else f"the joint {shown(leader)}"
                expected = "a joint that turns or slides by itself, or another one that follows such a joint"
                return _Misled(key, got, expected)
            if found.multiplier == 0:
                expected = "a number that is not zero, or no mimic and the type fixed"
                return _Misled(f"{key}.multiplier", "0", expected)
            joint = moving
        return found

    def moving(self, base: str, link: str) -> bool:
        """Whether there are joints from `base` to `link`, and all turn or slide, some led by others."""
        joints = self.joints(base, link)
        return bool(joints) and self.led(joints)

    def led(self, joints: Sequence[ElementTree.Element]) -> bool:
        """Whether all of some joints turn or slide, and what they follow is among them."""
        names = {joint.get("name", "") for joint in joints if _moves(joint)}
        if not all(joint.get("type") in _MOVING_TYPES for joint in joints):
            return False
        each = map(self.following, joints)
        return all(isinstance(one, Following) and one.leader in names for one in each)

    def turns(self, base: str, link: str) -> int:
        """Number of joints from `base` to `link` that turn by themselves."""
        return sum(map(_turns, self.joints(base, link)))

    def with_turns(self, base: str, links: Sequence[str], number: int) -> list[str]:
        """Those of the links to which so many joints turn, the last among them; each once."""
        return [
            link
            for link in dict.fromkeys(links)
            if self.moving(base, link)
            and _turns(self.joints(base, link)[-1])
            and self.turns(base, link) == number
        ]

    def before_gripper(self, base: str, link: str) -> str:
        """The last link towards `link` that a turning joint moves by itself."""
        while (joints := self.joints(base, link)) and not (self.led(joints) and _turns(joints[-1])):
            link = self.parents[link]
        return link

    @property
    def ends(self) -> list[str]:
        """Links without links below."""
        inner = set(self.parents.values())
        return [link for link in self.links if link not in inner]


def _turns(joint: ElementTree.Element) -> bool:
    return joint.get("type") in _ROTARY_TYPES and joint.find("mimic") is None


def _moves(joint: ElementTree.Element) -> bool:
    return joint.get("type") in _MOVING_TYPES and joint.find("mimic") is None


def _follows(joints: Sequence[ElementTree.Element]) -> bool:
    """Whether joints that turn come after one that follows another."""
    first = next((k for k, joint in enumerate(joints) if joint.find("mimic") is not None), len(joints))
    return any(map(_turns, joints[first:]))


def _chains(tree: _Tree, semantics: ElementTree.Element | None) -> list[tuple[str, str]]:
    """Base and tip of the SRDF's chains between links that are there; those that only turn, if any do."""
    found: list[tuple[str, str]] = []
    for chain in () if semantics is None else semantics.iter("chain"):
        base, tip = chain.get("base_link", ""), chain.get("tip_link", "")
        if {base, tip} <= set(tree.links) and tree.moving(base, tip):
            found.append((base, tip))
    turning = [(base, tip) for base, tip in found if all(map(_turns, tree.joints(base, tip)))]
    return turning or found


def _end_effectors(tree: _Tree, semantics: ElementTree.Element | None) -> Iterator[str]:
    """Links of the SRDF's end effectors, each as far out as the joints of its group move."""
    if semantics is None:
        return
    groups: Mapping[str, ElementTree.Element] = {
        group.get("name", ""): group for group in semantics.findall("group")
    }
    for effector in semantics.findall("end_effector"):
        group = groups.get(effector.get("group", ""))
        listed = set[str]()
        if group is not None and not _chains(tree, group):
            listed = {joint.get("name", "") for joint in group.findall("joint")}
        link = effector.get("parent_link", "")
        if link not in tree.links:
            continue
        # A gripper's joint is not the arm's.
        while listed and any(joint.get("name") not in listed for joint in tree.joints(tree.root, link)):
            link = tree.parents[link]
        yield link


def _last_link(tree: _Tree, base: str, source: str) -> str:
    """The end of the row with most turning joints below `base`."""
    ends = [link for link in tree.ends if tree.joints(base, link)]
    longest = max((tree.turns(base, link) for link in ends), default=0)
    tips = tree.with_turns(base, ends, longest)
    if not tips:
        # Of a gripper whose fingers slide or follow each other, the arm's end is the link that carries them.
        tips = tree.with_turns(base, [tree.before_gripper(base, link) for link in ends], longest)
    if not tips and (following := [link for link in ends if _follows(tree.joints(base, link))]):
        # The joint that stands in the way is named.
        followed(tree.urdf, base, following[0], source)
    last = {tree.joints(base, link)[-1].get("name") for link in tips}
    if len(last) == 1:
        if _ROS_TOOL_FRAME in tips:
            return _ROS_TOOL_FRAME
        if len(tips) == 1:
            return tips[0]
    expected = f"the last link of the arm: below {shown(base)} no end of the tree is the only choice"
    raise ModelError(source, "tool_frame", "nothing", expected, tips or ends or tree.ends)
