"""A second reading of a robot's files: URDF, SRDF and joint limits, read as plain XML and YAML.

What the files mean is said in `cmbot.robot.load_robot`: what it refuses is not looked for again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import ArrayLike
from ruamel.yaml import YAML

from cmbot.common.arrays import FloatArray
from oracles.convex_distance import ConvexShape, hull, smallest_distances
from oracles.multibody import Body, JointBounds, Multibody, PlacedShape, turn

__all__ = ["Near", "mesh_parts", "read_multibody"]

_MOVABLE = ("revolute", "continuous", "prismatic")


class Near(NamedTuple):
    """What is nearly always near: postures (K, n) within ranges, a distance, m, and how many are far."""

    postures: Callable[[FloatArray, FloatArray], FloatArray]
    distance: float
    most_far: int


def read_multibody(
    scene: Any, urdf: Element, srdf: Path | None, limits: Path | None, base: str, tool: str, near: Near
) -> Multibody:
    """Read a robot from its files.

    Parameters
    ----------
    scene : Scene of cmbot.scene
        With the robot's mount, stance, tool's length and payload.
    urdf : xml.etree.ElementTree.Element
        With the paths of meshes.
    srdf, limits : Path or None
    base, tool : str
        Links that bound the arm.
    near : Near
        Without an SRDF: which links need not be checked against each other.
    """
    semantics = None if srdf is None else ElementTree.parse(srdf).getroot()
    root: Any = urdf
    source, stance = scene.robot, scene.stance
    tree = _Tree(root, semantics, base, tool, {} if stance is None else stance.locked)
    if stance is not None:
        tree.move(stance.root)
    if source.mount is not None:
        tree.move(
            _pose(source.mount.xyz, np.radians(source.mount.rpy_deg)) @ np.linalg.inv(tree.placed[base][1])
        )
    X_JT, flange, ratio = tree.placed[tool][1], tree.parents[tool], 1.0
    if source.tool_length_m is not None:
        X_FT = tree.own_pose(tool)
        if tree.above[tool].get("name") in tree.chain or X_FT[2, 3] <= 0:
            raise ValueError(tool)
        ratio = source.tool_length_m / float(X_FT[2, 3])
        X_FT[2, 3] = source.tool_length_m
        X_JT = tree.placed[flange][1] @ X_FT
    shapes = tuple(_placed_shapes(tree, flange, ratio))
    load = Body(joint=len(tree.chain), mass=source.payload_kg, centre=X_JT[:3, 3], inertia=np.zeros((3, 3)))
    body = Multibody(
        joints=tuple(tree.chain),
        step=np.array(tree.step),
        axis=np.array([_axis(tree.joints[name]) for name in tree.chain]),
        slides=np.array([tree.joints[name].get("type") == "prismatic" for name in tree.chain]),
        bodies=(*tree.bodies(), load),
        shapes=shapes,
        pairs=tuple(_own_pairs(shapes, semantics)),
        X_JT=X_JT,
        bounds=_bounds(tree, limits),
    )
    if semantics is not None and semantics.find("disable_collisions") is not None:
        return body
    # As the loader, with the tool as the URDF has it.
    as_described = replace(body, shapes=tuple(_placed_shapes(tree, flange, 1.0)))
    return replace(body, pairs=tuple(_without_near_links(as_described, near)))


class _Tree:
    """The links of a URDF, each placed in the frame of the arm's joint that carries it."""

    def __init__(self, robot: Any, semantics: Any, base: str, tool: str, locked: Mapping[str, float]) -> None:
        self.links = {link.get("name"): link for link in robot.findall("link")}
        self.joints = {joint.get("name"): joint for joint in robot.findall("joint")}
        self.above = {joint.find("child").get("link"): joint for joint in self.joints.values()}
        self.parents = {link: joint.find("parent").get("link") for link, joint in self.above.items()}
        self.locked = {
            entry.get("name"): float(entry.get("value"))
            for entry in (() if semantics is None else semantics.findall("group_state/joint"))
        }
        self.locked.update(locked)
        fixed = self._movable_above(base)
        self.chain = [name for name in self._movable_above(tool) if name not in fixed]
        self.step = [np.eye(4)] * len(self.chain)
        self.placed: dict[str, tuple[int, FloatArray]] = {}
        children: dict[str, list[str]] = {link: [] for link in self.links}
        for link, parent in self.parents.items():
            children[parent].append(link)
        outward = [link for link in self.links if link not in self.above]
        while outward:
            link = outward.pop()
            self.placed[link] = self._place(link)
            outward += children[link]

    def _movable_above(self, link: str) -> list[str]:
        """Names of the movable joints from the root to a link."""
        names: list[str] = []
        while link in self.above:
            if self.above[link].get("type") in _MOVABLE:
                names.insert(0, self.above[link].get("name"))
            link = self.parents[link]
        return names

    def _place(self, link: str) -> tuple[int, FloatArray]:
        """Number of the joint that carries a link, and the link's pose in its frame; its parent is placed."""
        if link not in self.above:
            return 0, np.eye(4)
        joint, (carrier, X) = self.above[link], self.placed[self.parents[link]]
        if joint.get("name") not in self.chain:
            return carrier, X @ self.own_pose(link)
        number = self.chain.index(joint.get("name"))
        self.step[number] = X @ _origin(joint)
        return number + 1, np.eye(4)

    def own_pose(self, link: str) -> FloatArray:
        """Pose (4, 4) of a link in its parent's, the joint between them where it is locked."""
        joint = self.above[link]
        X, value = _origin(joint), self.locked.get(joint.get("name"), 0.0)
        motion = np.eye(4)
        if joint.get("type") == "prismatic":
            motion[:3, 3] = value * _axis(joint)
        elif joint.get("type") in _MOVABLE:
            motion[:3, :3] = turn(_axis(joint), value)
        return np.asarray(X @ motion)

    def move(self, X: FloatArray) -> None:
        """Move everything that no joint of the arm carries."""
        self.step[0] = X @ self.step[0]
        self.placed = {
            link: (joint, X @ pose if joint == 0 else pose) for link, (joint, pose) in self.placed.items()
        }

    def bodies(self) -> Iterator[Body]:
        """Bodies of all links that have a mass."""
        for name, link in self.links.items():
            inertial = link.find("inertial")
            if inertial is not None:
                joint, X_JL = self.placed[name]
                X = X_JL @ _origin(inertial)
                entries = inertial.find("inertia")
                xx, xy, xz, yy, yz, zz = (
                    float(entries.get(f"i{key}")) for key in ("xx", "xy", "xz", "yy", "yz", "zz")
                )
                inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
                yield Body(
                    joint=joint,
                    mass=float(inertial.find("mass").get("value")),
                    centre=X[:3, 3],
                    inertia=X[:3, :3] @ inertia @ X[:3, :3].T,
                )


def _numbers(element: Any, attribute: str, default: str) -> FloatArray:
    text = default if element is None else element.get(attribute, default)
    return np.array([float(word) for word in text.split()])


def _axis(joint: Any) -> FloatArray:
    axis = _numbers(joint.find("axis"), "xyz", "1 0 0")
    return np.asarray(axis / np.linalg.norm(axis))


def _origin(element: Any) -> FloatArray:
    origin = element.find("origin")
    return _pose(_numbers(origin, "xyz", "0 0 0"), _numbers(origin, "rpy", "0 0 0"))


def _pose(xyz: ArrayLike, rpy: ArrayLike) -> FloatArray:
    """Pose (4, 4) from URDF's position and angles: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    X = np.eye(4)
    for axis, angle in zip(np.eye(3), np.asarray(rpy, dtype=float), strict=True):
        X[:3, :3] = turn(axis, angle) @ X[:3, :3]
    X[:3, 3] = xyz
    return X


def _bounds(tree: _Tree, file: Path | None) -> JointBounds:
    listed: dict[str, Any] = {}
    if file is not None:
        with file.open("rb") as stream:
            listed = YAML(typ="safe", pure=True).load(stream)
    every, single = listed.get("all") or {}, listed.get("joints") or {}
    entries = [single.get(name, every) for name in tree.chain]
    limits = [tree.joints[name].find("limit") for name in tree.chain]
    endless = [tree.joints[name].get("type") == "continuous" for name in tree.chain]
    lower, upper, velocity, torque = (
        np.array([float("nan" if limit is None else limit.get(key, "0")) for limit in limits])
        for key in ("lower", "upper", "velocity", "effort")
    )
    # As in the package, a range that ends beyond a billion is none.
    endless = endless | (np.abs(upper) >= 1e9)
    # In degrees, or metres; what is not given is twice the velocity limit and ten times the acceleration
    # limit, per s.
    slides = np.array([tree.joints[name].get("type") == "prismatic" for name in tree.chain])
    in_degrees, in_metres = (
        np.array([[float(entry.get(key) or "nan") for entry in entries] for key in keys])
        for keys in (("acceleration_deg", "jerk_deg"), ("acceleration_m_s2", "jerk_m_s3"))
    )
    given = np.where(slides, in_metres, in_degrees * (np.pi / 180))
    acceleration = np.where(np.isnan(given[0]), 2.0 * velocity, given[0])
    jerk = np.where(np.isnan(given[1]), 10.0 * acceleration, given[1])
    return JointBounds(
        lower=np.where(endless, -np.inf, lower),
        upper=np.where(endless, np.inf, upper),
        velocity=velocity,
        acceleration=acceleration,
        jerk=jerk,
        torque=torque,
    )


def _placed_shapes(tree: _Tree, flange: str, ratio: float) -> Iterator[PlacedShape]:
    """Collision shapes of all links; those of the flange stretched along its z axis."""
    for link, (joint, X_JL) in tree.placed.items():
        for X_LS, shape in _link_shapes(tree.links[link], ratio if link == flange else 1.0):
            yield PlacedShape(link=link, joint=joint, X_JS=X_JL @ X_LS, shape=shape)


def _own_pairs(shapes: Sequence[PlacedShape], semantics: Any) -> Iterator[tuple[int, int]]:
    """Pairs of shapes that the SRDF does not disable; where it disables none, of joints not neighbouring."""
    disabled = {
        frozenset((pair.get("link1"), pair.get("link2")))
        for pair in (() if semantics is None else semantics.findall("disable_collisions"))
    }
    for j, other in enumerate(shapes):
        for i, one in enumerate(shapes[:j]):
            apart = abs(one.joint - other.joint)
            near = apart == 1 if not disabled else frozenset((one.link, other.link)) in disabled
            if apart and not near:
                # The one further out is the one that moves.
                yield (i, j) if one.joint > other.joint else (j, i)


def _without_near_links(body: Multibody, near: Near) -> Iterator[tuple[int, int]]:
    """Pairs of shapes but those of links that are nearly always near, in the loader's postures."""
    links: dict[frozenset[str], list[tuple[int, int]]] = {}
    for first, second in body.pairs:
        names = frozenset((body.shapes[first].link, body.shapes[second].link))
        links.setdefault(names, []).append((first, second))
    q = near.postures(body.bounds.lower, body.bounds.upper)
    R_WJ, p_WJ = body.frames(q)
    shapes = body.shapes
    R, p = np.empty((len(shapes), len(q), 3, 3)), np.empty((len(shapes), len(q), 3))
    for k, one in enumerate(shapes):
        R[k] = R_WJ[one.joint] @ one.X_JS[:3, :3]
        p[k] = p_WJ[one.joint] + R_WJ[one.joint] @ one.X_JS[:3, 3]
    for pairs in links.values():
        distance = smallest_distances([one.shape for one in shapes], R, p, pairs)
        if (distance.upper >= near.distance).sum() > near.most_far:
            yield from pairs


def _link_shapes(link: Any, ratio: float) -> Iterator[tuple[FloatArray, ConvexShape]]:
    """Collision shapes of a link with their poses in it, stretched along the link's z axis."""
    capsules = {entry.get("name") for entry in link.findall("collision_checking/capsule")}
    for collision in link.findall("collision"):
        (geometry,) = collision.find("geometry")
        X = _origin(collision)
        if geometry.tag == "mesh":
            scale = _numbers(geometry, "scale", "1 1 1")
            points = _mesh_points(Path(geometry.get("filename"))) * scale
            # Moved to the link's frame first, as the stretch is along that frame's axis.
            centre, shape = hull((points @ X[:3, :3].T + X[:3, 3]) * [1.0, 1.0, ratio])
            yield _pose(centre, np.zeros(3)), shape
            continue
        half, disc, radius = np.zeros(3), 0.0, 0.0
        if geometry.tag == "box":
            half = 0.5 * _numbers(geometry, "size", "")
        elif geometry.tag == "sphere":
            radius = float(geometry.get("radius"))
        else:
            half[2] = 0.5 * float(geometry.get("length"))
            disc = float(geometry.get("radius"))
            if collision.get("name") in capsules:
                disc, radius = 0.0, disc
        if ratio != 1.0:
            X, half = _stretched(X, half, radius, ratio)
        yield X, ConvexShape(half=half, disc=disc, radius=radius)


def _stretched(X: FloatArray, half: FloatArray, radius: float, ratio: float) -> tuple[FloatArray, FloatArray]:
    """Pose and half edges of a shape that is stretched along its link's z axis, as `load_robot` allows it.

    The shape's axes are the link's; the cap of a capsule keeps its radius.
    """
    axis = int(np.abs(X[2, :3]).argmax())
    low, high = X[2, 3] - half[axis], X[2, 3] + half[axis]
    if radius:
        high = max((high + radius) * ratio - radius, low)
    else:
        low, high = low * ratio, high * ratio
    X, half = X.copy(), half.copy()
    X[2, 3], half[axis] = 0.5 * (low + high), 0.5 * (high - low)
    return X, half


def _mesh_points(path: Path) -> FloatArray:
    """Vertices (V, 3) of a link's mesh file."""
    # It takes a while to come, and few robots need it.
    import trimesh

    return np.asarray(trimesh.load_mesh(path, process=False).vertices)


def mesh_parts(path: Path, scale: float = 1.0) -> list[FloatArray]:
    """Vertices (V, 3), m, of each connected part of an obstacle's mesh file, whose unit is `scale`, m."""
    import trimesh

    mesh = trimesh.load_mesh(path)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return [scale * np.asarray(part.vertices) for part in mesh.split(only_watertight=False)]
