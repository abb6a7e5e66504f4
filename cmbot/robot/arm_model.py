"""Pinocchio's model of the arm with its shapes: from a URDF and its SRDF, then another tool or a payload."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from cmbot.common.arrays import BoolArray, FloatArray, read_only
from cmbot.common.errors import ModelError
from cmbot.common.reading.validation import counted, hint, shown
from cmbot.robot.description.frames import Following, followed, row_of
from cmbot.robot.description.mesh_file import (
    FARTHEST,
    convex_hull,
    encloses_volume,
    is_mesh,
    is_near,
    locate_meshes,
    mesh_loader,
    replace_unreadable,
    require_near_meshes,
    solid_points,
    vertices_of,
)
from cmbot.robot.description.self_collision import NEAR, near_pairs
from cmbot.robot.holding_joints import HoldingJoint, holding_joints
from cmbot.robot.joint_kinds import Coupling, prismatic_joints

# As many as a posture in a scene file may have.
_MAX_JOINTS = 100
# Joint angles and distances at which other joints are locked, rad or m.
_MAX_LOCKED_POSITION = 1e4
_MAX_PAYLOAD_KG = 1e4  # kg
# Names that a remark lists.
_MAX_LISTED_NAMES = 6
# Pairs of a link that are always near, from which on it may be too large: a wrist's short links have one.
_MIN_SUSPECT_PAIRS = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmModel:
    """Pinocchio's model of an arm, only whose joints move, its shapes, and remarks on what was assumed.

    `read_visual` returns another such model with the visual shapes, whose meshes it reads. `group_states` are
    the SRDF's that set every joint of the arm that moves by itself, by their names; `coupling` says how the
    others follow; `unplaced` are sliding joints before the arm that neither it nor `locked` places.
    """

    model: Any
    coupling: Coupling
    collision: Any
    read_visual: Callable[[], tuple[Any, Any]]
    group_states: dict[str, FloatArray]
    locked_joints: tuple[HoldingJoint, ...]
    unplaced: tuple[str, ...]
    remarks: tuple[str, ...]


def arm_model(
    urdf: Path,
    root: ElementTree.Element,
    semantics: ElementTree.Element | None,
    base_frame: str,
    tool_frame: str,
    *,
    srdf: str,
    package_dirs: Sequence[Path] = (),
    locked: Mapping[str, float],
    tool: str = "",
) -> ArmModel:
    """Build the model and the shapes of an arm: only its joints move.

    `root` is the content of `urdf` and is modified; `semantics` is that of the SRDF, whose name `srdf` is for
    messages. Its group states are where the other joints are locked, default zero, but for those that
    `locked` has, rad or m; a joint of the arm that follows one of them is locked, too. The pairs that it
    disables do not collide. Where it disables none, those of neighbouring joints do not, nor those that
    `near_pairs` finds always near; so also those of the link `tool`, which no SRDF names.
    """
    following = followed(root, base_frame, tool_frame, str(urdf))
    built = build_model(urdf, root, package_dirs)
    full = built.model
    chain = _chain(full, str(urdf), base_frame, tool_frame)
    moving = [i for i in chain if following[full.names[i]].leader in following]
    others = [i for i in range(1, full.njoints) if i not in moving]
    stance, absent = _stance(full, srdf, semantics)
    names = {full.names[i]: full.joints[i].idx_q for i in others if i not in chain}
    for name, value in locked.items():
        if name not in names:
            expected = "a joint that turns or slides, and none of the arm's"
            behind = [link for link, joint in row_of(root, tool_frame).items() if joint == name]
            if behind:
                expected += f": it moves the arm from {base_frame!r}; to lock it, base_frame: {behind[-1]}"
            raise ModelError(str(urdf), f"locked.{name}", shown(name), expected, tuple(names))
        lower, upper = (float(end[names[name]]) for end in (full.lowerPositionLimit, full.upperPositionLimit))
        if not lower <= value <= upper:
            expected = f"its range, {lower:.6g} to {upper:.6g} (rad or m)"
            raise ModelError(str(urdf), f"locked.{name}", f"{value:g}", expected)
        stance[names[name]] = value
    fixed = {i: following[full.names[i]] for i in chain if i not in moving}
    for i, what in fixed.items():
        stance[full.joints[i].idx_q] = what.multiplier * stance[names[what.leader]] + what.offset

    reduced = partial(_reduced, full, others, stance, str(urdf))
    model, collision = reduced(built.collision)
    coupling = _coupling([following[name] for name in model.names[1:]], list(model.names)[1:])
    assumed = _enable_pairs(model, collision, coupling, srdf, semantics, tool)
    slides = _locked_slides(full, moving, stance, base_frame)
    in_states = () if semantics is None else semantics.findall("group_state/joint")
    placed = {*locked, *(entry.get("name", "") for entry in in_states)}
    return ArmModel(
        model=model,
        coupling=coupling,
        collision=collision,
        read_visual=partial(_visual_model, urdf, root, full, reduced),
        group_states=_group_states([model.names[i + 1] for i in coupling.own.tolist()], semantics),
        locked_joints=holding_joints(full, moving, stance, base_frame),
        unplaced=tuple(name for name in slides if name not in placed),
        remarks=(
            *(*absent, *assumed, *_drawn_as_boxes(built.unusable), *_thick(built.flat)),
            *(
                f"{full.names[i]} follows {what.leader}, which does not move the arm: it is locked, too."
                for i, what in fixed.items()
            ),
            *slides.values(),
        ),
    )


def _coupling(following: Sequence[Following], joints: Sequence[str]) -> Coupling:
    """How joints follow those among them that move by themselves."""
    own = [k for k, what in enumerate(following) if what.leader == joints[k]]
    leaders = [joints[k] for k in own]
    return Coupling(
        own=np.array(own, dtype=np.intp),
        leader=np.array([leaders.index(what.leader) for what in following], dtype=np.intp),
        multiplier=np.array([what.multiplier for what in following]),
        offset=np.array([what.offset for what in following]),
    )


def _reduced(full: Any, others: list[int], stance: FloatArray, where: str, shapes: Any) -> tuple[Any, Any]:
    """The model, and shapes, in which only the arm's joints move."""
    model, (shapes,) = pin.buildReducedModel(full, [shapes], others, stance)
    _require_extent(model, shapes, where)
    return model, shapes


def _visual_model(
    urdf: Path, root: ElementTree.Element, full: Any, reduced: Callable[[Any], tuple[Any, Any]]
) -> tuple[Any, Any]:
    """What is drawn of the arm, read where that is asked for."""
    return reduced(_visual_shapes(urdf, root, full))


def _locked_slides(full: Any, moving: Collection[int], stance: FloatArray, base_frame: str) -> dict[str, str]:
    """Say of each sliding joint before the arm, such as a lift, that it does not move."""
    told: dict[str, str] = {}
    before = full.supports[full.frames[full.getFrameId(base_frame)].parentJoint].tolist()[1:]
    for k, slides in enumerate(prismatic_joints(full), start=1):
        if slides and k in before and k not in moving:
            name, i = full.names[k], full.joints[k].idx_q
            lower, upper = full.lowerPositionLimit[i], full.upperPositionLimit[i]
            told[name] = (
                f"{name}, which slides from {lower:g} to {upper:g} m, is locked at {stance[i]:g} m; "
                "robot.locked of a scene says where else, and a base frame before it lets it move."
            )
    return told


class Built(NamedTuple):
    """The full model of a URDF, and its collision shapes.

    Attributes
    ----------
    model, collision
        Pinocchio's.
    unusable : tuple of (str, str)
        As from `locate_meshes`.
    flat : tuple of str
        Links with a collision mesh that was flat.
    """

    model: Any
    collision: Any
    unusable: tuple[tuple[str, str], ...]
    flat: tuple[str, ...]


def build_model(urdf: Path, root: ElementTree.Element, package_dirs: Sequence[Path] = ()) -> Built:
    """Build the full model and its collision shapes; collision meshes become convex hulls.

    `root` is the content of `urdf`, without errors in `inspect_urdf`, and is modified. Meshes that are flat
    get a thickness.
    """
    unusable = _adapt(urdf, root, package_dirs)
    with _refusals_named(urdf):
        model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    collision, flat = _shapes(urdf, root, model, "collision"), list[str]()
    for shape in collision.geometryObjects:
        if is_mesh(shape.geometry):
            vertices = vertices_of(shape.geometry)
            if not encloses_volume(vertices) and len(vertices):
                flat.append(model.frames[shape.parentFrame].name)
                vertices = solid_points(vertices)
            if not encloses_volume(vertices):
                expected = "a mesh that encloses a volume"
                raise ModelError(str(urdf), shape.name, f"the mesh {shape.meshPath}", expected)
            try:
                shape.geometry = convex_hull(vertices)
            except RuntimeError as error:
                got, expected = f"the mesh {shape.meshPath}", "one whose convex hull coal can hold"
                raise ModelError(str(urdf), shape.name, got, expected) from error
    return Built(model=model, collision=collision, unusable=unusable, flat=tuple(flat))


def _visual_shapes(urdf: Path, root: ElementTree.Element, model: Any) -> Any:
    """Visual shapes of the adapted `root`; meshes that cannot be read become boxes, with a warning."""
    try:
        return _shapes(urdf, root, model, "visual")
    except ModelError:
        told = list(_drawn_as_boxes(replace_unreadable(root, str(urdf))))
        if not told:
            raise
    for text in told:
        warnings.warn(text, stacklevel=2)
    return _shapes(urdf, root, model, "visual")


def _drawn_as_boxes(unusable: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Yield a remark on visual meshes, with what is the matter with the first one; none without any."""
    for key, got in unusable[:1]:
        more = f" and {counted(len(unusable) - 1, 'other')}" if unusable[1:] else ""
        yield f"Visual meshes that cannot be used are drawn as boxes: {key}, {got}{more}."


def _thick(flat: Sequence[str]) -> Iterator[str]:
    if flat:
        yield f"Flat collision meshes count as 1 mm thick: of {_listed(flat)}."


def _shapes(urdf: Path, root: ElementTree.Element, model: Any, tag: Literal["collision", "visual"]) -> Any:
    """Shapes of the adapted `root`, from which the full `model` was built."""
    kind = {"collision": pin.GeometryType.COLLISION, "visual": pin.GeometryType.VISUAL}[tag]
    xml = ElementTree.tostring(root, encoding="unicode")
    try:
        with _refusals_named(urdf):
            shapes = pin.buildGeomFromUrdfString(model, xml, kind, mesh_loader=mesh_loader(root))
    except ModelError:
        # Names the mesh, where one is the cause.
        require_near_meshes(root, tag, str(urdf))
        raise
    if not all(is_near(shape.geometry) for shape in shapes.geometryObjects if is_mesh(shape.geometry)):
        require_near_meshes(root, tag, str(urdf))
    return shapes


@contextmanager
def _refusals_named(urdf: Path) -> Iterator[None]:
    try:
        yield
    except (ValueError, RuntimeError, IndexError) as error:
        got = f"a file that pinocchio refuses ({' '.join(str(error).split())})"
        raise ModelError(str(urdf), "", got, "a loadable URDF") from error


def _adapt(
    urdf: Path, root: ElementTree.Element, package_dirs: Sequence[Path]
) -> tuple[tuple[str, str], ...]:
    """Change what pinocchio's reader of URDF would read differently or refuse; as `locate_meshes`."""
    names = {element.get("name", "") for tag in ("link", "joint") for element in root.findall(tag)}
    links = {link.get("name", "") for link in root.findall("link")}
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        if name in links:
            # URDF allows it, pinocchio does not. Nothing refers by name to a joint that is not the arm's.
            while name in names:
                name += "_"
            names.add(name)
            joint.set("name", name)
        if joint.get("type") in ("floating", "planar"):
            # It has several coordinates; it is locked, and no joint of the arm.
            joint.set("type", "fixed")
        elif joint.get("type") == "continuous":
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
    _adapt_materials(root)
    return locate_meshes(urdf, root, package_dirs)


def _adapt_materials(root: ElementTree.Element) -> None:
    """Leave out textures, which are not shown, and materials without a name or a colour."""
    coloured = set[str]()
    for material in root.findall("material"):
        name = material.get("name", "")
        if not name or name in coloured or material.find("color") is None:
            root.remove(material)
        else:
            coloured.add(name)
    visuals = root.findall("link/visual")
    for number, visual in enumerate(visuals):
        for material in visual.findall("material"):
            for texture in material.findall("texture"):
                material.remove(texture)
            if material.find("color") is not None:
                material.set("name", material.get("name") or f"nameless {number}")
                coloured.add(material.get("name", ""))
    for parent in visuals:
        for material in parent.findall("material"):
            if material.find("color") is None and material.get("name", "") not in coloured:
                parent.remove(material)


def _chain(model: Any, source: str, base_frame: str, tool_frame: str) -> list[int]:
    """Return the indices of the joints from `base_frame` to `tool_frame`."""
    for key, name in (("base_frame", base_frame), ("tool_frame", tool_frame)):
        if not (isinstance(name, str) and model.existFrame(name, pin.FrameType.BODY)):
            choices = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
            raise ModelError(source, key, repr(name), f"a link of the URDF{hint(name, choices)}", choices)
    base, tool = (model.frames[model.getFrameId(name)].parentJoint for name in (base_frame, tool_frame))
    supports = list(model.supports[tool])
    if base not in supports[:-1]:
        expected = f"a link that joints move below {base_frame!r}"
        raise ModelError(source, "tool_frame", repr(tool_frame), expected)
    chain = supports[supports.index(base) + 1 :]
    if len(chain) > _MAX_JOINTS:
        got = f"{tool_frame!r}, {len(chain)} joints above {base_frame!r}"
        raise ModelError(source, "tool_frame", got, f"an arm of at most {_MAX_JOINTS} joints")
    return chain


def _stance(
    model: Any, source: str, semantics: ElementTree.Element | None
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the configuration of the full model: the SRDF's group states, zero elsewhere; and remarks."""
    q: FloatArray = pin.neutral(model)
    joints = {name: index for index, name in enumerate(model.names) if index}
    absent: dict[str, None] = {}
    for entry in () if semantics is None else semantics.findall("group_state/joint"):
        name, text = entry.get("name", ""), entry.get("value", "")
        if name not in joints:
            absent[name] = None
            continue
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not abs(value) <= _MAX_LOCKED_POSITION:
            expected = f"an angle, rad, or a distance, m, of at most {_MAX_LOCKED_POSITION:g}"
            raise ModelError(source, f"group_state.{name}", shown(text), expected)
        q[model.joints[joints[name]].idx_q] = value
    if not absent:
        return q, ()
    names = _listed(list(map(shown, absent)))
    return q, (f"The SRDF's group states name {names}: no movable joint of the URDF, not used.",)


def _listed(names: Sequence[str]) -> str:
    """Some of the names, and whether there are more."""
    names = list(dict.fromkeys(names))
    return f"{', '.join(names[:_MAX_LISTED_NAMES])}{', …' if len(names) > _MAX_LISTED_NAMES else ''}"


def _group_states(joints: Sequence[str], semantics: ElementTree.Element | None) -> dict[str, FloatArray]:
    """The group states, checked by `_stance`, that set all of `joints`; the first of each name."""
    states: dict[str, FloatArray] = {}
    for state in () if semantics is None else semantics.findall("group_state"):
        given = {entry.get("name", ""): entry.get("value", "") for entry in state.findall("joint")}
        if given.keys() >= set(joints):
            states.setdefault(
                state.get("name", ""), read_only(np.array([float(given[name]) for name in joints]))
            )
    return states


def _enable_pairs(
    model: Any,
    collision: Any,
    coupling: Coupling,
    source: str,
    semantics: ElementTree.Element | None,
    tool: str,
) -> tuple[str, ...]:
    """Let all pairs of shapes collide but those that the SRDF disables; return remarks.

    Where it disables none, those of neighbouring joints, and of links that are always near, do not collide.
    """
    joints = np.array([shape.parentJoint for shape in collision.geometryObjects], dtype=int)
    enabled = joints[:, None] != joints
    listed = [] if semantics is None else semantics.findall("disable_collisions")
    names = [model.frames[shape.parentFrame].name for shape in collision.geometryObjects]
    # What no SRDF can name, where there is one, is the tool.
    unnamed = np.array([not listed or name == tool for name in names], dtype=np.bool_)
    sampled = unnamed[:, None] | unnamed
    parents = np.array(model.parents, dtype=int)[joints]
    # Neighbours: the joint of one is the parent of the other's. That of the universe is itself.
    enabled &= ~sampled | ((parents[:, None] != joints) & (parents != joints[:, None]))
    assumed: tuple[str, ...] = ()
    if unnamed.any():
        near = near_pairs(model, collision, enabled & sampled, lambda q: coupling.positions(q[coupling.own]))
        assumed = tuple(_near_remarks(near, enabled & sampled, names, tool if listed else ""))
        for first, second in (pair for shapes in near.values() for pair in shapes):
            enabled[first, second] = enabled[second, first] = False
    links: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        links.setdefault(name, []).append(index)
    for pair in listed:
        one, other = pair.get("link1"), pair.get("link2")
        if not (one and other):
            raise ModelError(source, "disable_collisions", shown(pair.attrib), "the names of link1 and link2")
        for index in links.get(one, ()):
            for second in links.get(other, ()):
                enabled[index, second] = enabled[second, index] = False
    collision.setCollisionPairs(enabled)
    return assumed


def _near_remarks(
    near: Mapping[tuple[str, str], object], looked_at: BoolArray, names: Sequence[str], tool: str
) -> Iterator[str]:
    """Say which pairs of links are not checked, for want of an SRDF, or which of the `tool` beside one."""
    pairs = ", ".join(f"{one} and {other}" for one, other in list(near)[:_MAX_LISTED_NAMES])
    if (more := len(near) - _MAX_LISTED_NAMES) > 0:
        pairs += f" and {more} more"
    if tool:
        if near:
            yield f"The tool is not checked against what it is nearly always near: {pairs}."
        return
    also = f", and links that are nearly always nearer than {1e3 * NEAR:g} mm: {pairs}" if near else ""
    yield (
        f"No SRDF says which links may touch; not checked are those of neighbouring joints{also}. "
        "An SRDF that robot.srdf names would say it."
    )
    others: dict[str, set[str]] = {}
    for first, second in zip(*np.nonzero(looked_at), strict=True):
        others.setdefault(names[first], set()).add(names[second])
    for link, each in others.items():
        count = sum(link in pair for pair in near)
        if count >= _MIN_SUSPECT_PAIRS and count * 3 >= len(each):
            yield (
                f"Warning: {link} is nearly always near {count} of the {len(each)} links that it is checked "
                "against, and these pairs are not checked: its shapes may be too large (millimetres?)."
            )


def _require_extent(model: Any, shapes: Any, source: str) -> None:
    """Refuse frames and shapes that are too far from the joint that carries them, by origins that add up."""
    placed = [(frame.name, frame.placement) for frame in model.frames]
    placed += [(name, X) for name, X in zip(model.names, model.jointPlacements, strict=True)]
    placed += [(shape.name, shape.placement) for shape in shapes.geometryObjects]
    for name, X in placed:
        if not np.abs(X.translation).max() <= FARTHEST:
            got = f"{shown(name)}, {np.abs(X.translation).max():g} m from its joint"
            raise ModelError(
                source, "origin", got, f"frames and shapes within {FARTHEST:g} m of their joints"
            )


def set_tool_length(model: Any, shapes: Any, tool_frame: str, length: float, *, source: str) -> None:
    """Move the tool point along the flange's z axis and stretch the tool's shapes with it, in place.

    The flange is the frame that carries `tool_frame`'s link, on whose z axis the tool point lies; the tool's
    shapes are those fixed to it. `length`, m, is the new distance of the tool point from the flange. Shapes
    and masses of `tool_frame`'s own link stay where they were.
    """
    frame = model.frames[model.getFrameId(tool_frame)]
    flange = _flange(model, frame)
    if flange.parentJoint != frame.parentJoint:
        # Its pose in the frame of another joint says nothing about where the tool lies.
        expected = f"{tool_frame!r} to be fixed to its flange, not moved by a joint, or no tool length"
        raise ModelError(source, "tool_length", length, expected)
    X_FT = flange.placement.inverse() * frame.placement
    old = float(X_FT.translation[2])
    if not (isinstance(length, int | float | np.number) and 0 < length <= FARTHEST):
        raise ModelError(source, "tool_length", length, f"a positive length in m, at most {FARTHEST:g}")
    if old <= 0 or np.abs(X_FT.translation[:2]).max() > 1e-9:
        expected = f"{tool_frame!r} to lie on its flange's z axis, or no tool length"
        raise ModelError(source, "tool_length", length, expected)
    ratio = length / old
    X_FT.translation = np.array([0.0, 0.0, length])
    frame.placement = flange.placement * X_FT
    for shape in shapes.geometryObjects:
        if model.frames[shape.parentFrame].name == flange.name:
            _stretch(shape, flange.placement, ratio, source)


def attach_payload(model: Any, tool_frame: str, mass: float) -> None:
    """Add a point mass, kg, at the tool point, in place."""
    if not (isinstance(mass, int | float | np.number) and 0 <= mass <= _MAX_PAYLOAD_KG):
        expected = f"a mass in kg that is not negative, at most {_MAX_PAYLOAD_KG:g}"
        raise ModelError("load_robot", "payload", mass, expected)
    if mass > 0:
        frame = model.frames[model.getFrameId(tool_frame)]
        point_mass = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
        model.appendBodyToJoint(frame.parentJoint, point_mass, frame.placement)


def _flange(model: Any, frame: Any) -> Any:
    """Nearest frame of a link above `frame`, on the same joint."""
    flange = model.frames[frame.parentFrame]
    while flange.type != pin.FrameType.BODY and flange.parentJoint == frame.parentJoint:
        flange = model.frames[flange.parentFrame]
    return flange


def _stretch(shape: Any, X_JF: Any, ratio: float, source: str) -> None:
    """Scale a shape along the flange's z axis; the cap of a capsule keeps its radius and its far end."""
    X_FS = X_JF.inverse() * shape.placement
    geometry = shape.geometry
    if isinstance(geometry, coal.ConvexBase):
        stretched = (X_FS.act(geometry.point(i)) * [1.0, 1.0, ratio] for i in range(geometry.num_points))
        shape.geometry = convex_hull(np.array([X_FS.actInv(p_F) for p_F in stretched]))
        return
    axis = int(np.argmax(np.abs(X_FS.rotation[2])))
    long = isinstance(geometry, coal.Capsule | coal.Cylinder)
    known = long or isinstance(geometry, coal.Box) or is_mesh(geometry)
    if not known or abs(X_FS.rotation[2, axis]) < 1 - 1e-9 or (long and axis != 2):
        kind = type(geometry).__name__.lower()
        expected = "a tool of capsules, cylinders, boxes and meshes, whose axes are its flange's"
        raise ModelError(source, f"tool_length, {shape.name}", f"a {kind} that cannot be stretched", expected)
    if isinstance(geometry, coal.Capsule):
        # The tip of the cap scales with the tool, not the cap's centre.
        near = X_FS.translation[2] - geometry.halfLength
        far = (X_FS.translation[2] + geometry.halfLength + geometry.radius) * ratio - geometry.radius
        far = max(far, near)
        geometry.halfLength = 0.5 * (far - near)
        X_FS.translation = np.array([*X_FS.translation[:2], 0.5 * (near + far)])
    else:
        scale = np.ones(3)
        scale[axis] = ratio
        if isinstance(geometry, coal.Box):
            geometry.halfSide = geometry.halfSide * scale
        elif isinstance(geometry, coal.Cylinder):
            geometry.halfLength *= ratio
        else:
            shape.meshScale = shape.meshScale * scale
            # The loaded shape does not follow the scale.
            shape.geometry = mesh_loader().load(shape.meshPath, shape.meshScale)
        X_FS.translation = X_FS.translation * [1.0, 1.0, ratio]
    shape.placement = X_JF * X_FS
