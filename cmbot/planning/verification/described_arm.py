"""An arm as its files describe it, read a second time as plain XML and YAML.

What the files mean is said in `cmbot.robot.load_robot`, which has read and checked them before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from xml.etree.ElementTree import Element, fromstring

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import ModelError
from cmbot.common.reading.yaml_reader import read_yaml
from cmbot.robot import JointLimits, Robot, RobotFiles, parse_urdf, robot_files
from cmbot.scene import Scene

_FILE_FIELDS = ("model", "srdf", "limits", "elasticity", "package_dirs", "xacro", "total_mass", "tool")
_MOVABLE_TYPES = ("revolute", "continuous", "prismatic")
# A range that ends beyond this is none, and so is a smaller limit than the last.
_ENDLESS, _LEAST_LIMIT = 1e9, 1e-6


def pose_of(xyz: ArrayLike, rpy: ArrayLike) -> FloatArray:
    """Return a pose (4, 4) from URDF's position, m, and angles, rad: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_euler("xyz", np.asarray(rpy)).as_matrix(), xyz
    return X


@dataclass(frozen=True, kw_only=True, eq=False)
class DescribedLimits:
    """Limits of n joints, as `cmbot.robot.JointLimits` has them: each (n,), rad, s and Nm, or m, s and N."""

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    torque: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class DescribedArm:
    """An arm in the frame of its URDF, and where the scene has it.

    Attributes
    ----------
    files : RobotFiles
    urdf : xml.etree.ElementTree.Element
        With what was added to it, such as a tool.
    loaded : JointLimits
        The loader's, of which those that are assumed are taken.
    base, tool, carrier : str
        Links that bound the arm, and the one of the tool point that `tool_length` and `payload` are of.
    X_WB, X_WR : (4, 4) or None
        Poses of the base and of the URDF's root link in W; None: as the URDF has them.
    locked : mapping of str to float
        Positions, rad or m, of joints that are not the arm's; others are at zero.
    tool_length : float or None, m
    payload : float, kg
    range_margins : (2,), rad and m
        By which joints that turn, and those that slide, keep from the ends of their ranges.
    """

    files: RobotFiles
    urdf: Element
    loaded: JointLimits
    base: str
    tool: str
    carrier: str
    X_WB: FloatArray | None
    X_WR: FloatArray | None
    locked: Mapping[str, float]
    tool_length: float | None
    payload: float
    range_margins: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, scene: Scene, robot: Robot) -> DescribedArm:
        """Return what a scene's robot is; which files and frames are meant is no opinion: the loader's."""
        source, stance, mount = scene.robot, scene.stance, scene.robot.mount
        arm = cls.in_files(
            robot_files(**{name: source.files[name] for name in _FILE_FIELDS}),
            robot,
            X_WB=None if mount is None else pose_of(mount.xyz, np.radians(mount.rpy_deg)),
            X_WR=None if stance is None else stance.root,
            locked=dict(source.locked or ()) if stance is None else stance.locked,
            tool_length=source.tool_length_m,
            payload=source.payload_kg,
        )
        for link in arm.urdf.findall("link"):
            if not (source.carried_from is None or arm._leads(source.carried_from, link.get("name", ""))):
                # It stands on the floor.
                for inertial in link.findall("inertial"):
                    link.remove(inertial)
        return replace(arm, range_margins=(float(np.radians(source.range_margin_deg)), source.range_margin_m))

    @classmethod
    def in_files(
        cls,
        files: RobotFiles,
        robot: Robot,
        *,
        locked: Mapping[str, float],
        tool_length: float | None,
        payload: float,
        carrier: str | None = None,
        X_WB: FloatArray | None = None,
        X_WR: FloatArray | None = None,
    ) -> DescribedArm:
        """Return what files say of a robot; `locked` has the joints that do not stand as in the SRDF."""
        urdf = fromstring(robot.description) if robot.description else files.read()[1]
        return cls(
            files=files,
            urdf=urdf,
            loaded=robot.limits,
            base=robot.base_frame,
            tool=robot.tool_frame,
            carrier=carrier or robot.tool_frame,
            X_WB=X_WB,
            X_WR=X_WR,
            locked=_group_states(files, urdf) | dict(locked),
            tool_length=tool_length,
            payload=payload,
        )

    @cached_property
    def _above(self) -> dict[str, Element]:
        """The joint above each link."""
        return {_link(joint, "child"): joint for joint in self.urdf.findall("joint")}

    @property
    def root(self) -> str:
        """Name of the URDF's root link."""
        (root,) = {link.get("name", "") for link in self.urdf.findall("link")} - self._above.keys()
        return root

    def _leads(self, first: str, link: str) -> bool:
        while link != first and link in self._above:
            link = _link(self._above[link], "parent")
        return link == first

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the arm's joints that move by themselves, base to tool."""
        return tuple(joint.get("name", "") for joint in self._row if joint.find("mimic") is None)

    @property
    def moving(self) -> tuple[str, ...]:
        """Names of those and of the m joints that follow them, base to tool."""
        return tuple(joint.get("name", "") for joint in self._chain)

    @cached_property
    def _chain(self) -> list[Element]:
        return [joint for joint in self._row if self._followed(joint)[0] in self.joints]

    @property
    def resting(self) -> dict[str, float]:
        """Positions, rad or m, of all joints that do not move and of which that is said."""
        led = {joint.get("name", ""): self._followed(joint) for joint in self._row}
        fixed = {name: what for name, what in led.items() if name not in self.moving}
        places = {name: self.locked.get(of, 0.0) * by + offset for name, (of, by, offset) in fixed.items()}
        return {**self.locked, **places}

    @cached_property
    def linkage(self) -> tuple[FloatArray, FloatArray]:
        """Matrix (m, n) and offsets (m,) by which the positions of `moving` follow those of `joints`."""
        led = [self._followed(joint) for joint in self._chain]
        G = np.array([[by * (of == joint) for joint in self.joints] for of, by, _ in led])
        return G, np.array([offset for *_, offset in led])

    def _followed(self, joint: Element) -> tuple[str, float, float]:
        """The joint that one follows at last, and factor and offset of its position; itself without any."""
        factor, offset = 1.0, 0.0
        while (mimic := joint.find("mimic")) is not None:
            offset += factor * float(mimic.get("offset", 0.0))
            factor *= float(mimic.get("multiplier", 1.0))
            (joint,) = (j for j in self.urdf.findall("joint") if j.get("name") == mimic.get("joint"))
        return joint.get("name", ""), factor, offset

    @cached_property
    def _row(self) -> list[Element]:
        link, chain = self.tool, list[Element]()
        while link != self.base and link in self._above:
            chain.insert(0, self._above[link])
            link = _link(chain[0], "parent")
        return [joint for joint in chain if joint.get("type") in _MOVABLE_TYPES]

    @property
    def slides(self) -> BoolArray:
        """Which joints (n,) move along their axes."""
        return self._along[self._own]

    @property
    def _own(self) -> list[int]:
        return [self.moving.index(joint) for joint in self.joints]

    @property
    def _along(self) -> BoolArray:
        return np.array([joint.get("type") == "prismatic" for joint in self._chain])

    @property
    def foot_point(self) -> FloatArray:
        """O0 in W (3,), m."""
        return np.zeros(3) if self.X_WR is None else self.X_WR[:3, 3]

    @property
    def tool_place(self) -> tuple[str, Mapping[str, str]]:
        """The link that carries the tool point, and the point's origin there as URDF writes it."""
        if self.tool_length is None:
            return self.carrier, {}
        joint = self._above[self.carrier]
        origin = joint.find("origin")
        rpy = "0 0 0" if origin is None else origin.get("rpy", "0 0 0")
        return _link(joint, "parent"), {"xyz": f"0 0 {self.tool_length!r}", "rpy": rpy}

    @cached_property
    def limits(self) -> DescribedLimits:
        """The joints' limits; what the files do not give is twice the velocity limit and ten times that.

        Velocity and torque that no file gives are the loader's, and so is all of a limits file of MoveIt's.

        Raises
        ------
        ModelError
            When the limits file cannot be read.
        """
        file = self.files.limits
        listed = {} if file is None else read_yaml(file, ModelError)
        if file is not None and "format" not in listed:
            fields = DescribedLimits.__dataclass_fields__
            return DescribedLimits(**{name: getattr(self.loaded, name) for name in fields})
        every, single = listed.get("all") or {}, listed.get("joints") or {}
        given = [single.get(name, every) for name in self.moving]
        limit = [{} if (each := joint.find("limit")) is None else each.attrib for joint in self._chain]
        lower, upper, velocity, torque = (
            np.array([float(each.get(key, 0)) for each in limit])
            for key in ("lower", "upper", "velocity", "effort")
        )
        velocity, torque = (
            np.where(own > _LEAST_LIMIT, own, np.where(described > _LEAST_LIMIT, described, 0.0))
            for own, described in (
                (self._rates(given, "velocity_m_s", "velocity_deg"), velocity),
                (np.array([float(each.get("effort") or 0) for each in given]), torque),
            )
        )
        velocity, torque = self._least(velocity, self.loaded.velocity), torque[self._own]
        endless = [joint.get("type") == "continuous" for joint in self._chain] | (np.abs(upper) >= _ENDLESS)
        acceleration = self._rates(given, "acceleration_m_s2", "acceleration_deg")
        acceleration = self._least(acceleration, 2.0 * velocity)
        jerk = self._rates(given, "jerk_m_s3", "jerk_deg")
        margin = np.where(self.slides, *self.range_margins[::-1])
        G, offset = self.linkage
        column, factor = np.abs(G).argmax(axis=1), G.sum(axis=1)
        ends = [np.where(endless, far, end) for far, end in ((-np.inf, lower), (np.inf, upper))]
        ends = [(end - offset) / factor for end in ends]
        return DescribedLimits(
            lower=np.array([np.minimum(*ends)[column == k].max() for k in range(G.shape[1])]) + margin,
            upper=np.array([np.maximum(*ends)[column == k].min() for k in range(G.shape[1])]) - margin,
            velocity=velocity,
            acceleration=acceleration,
            jerk=self._least(jerk, 10.0 * acceleration),
            torque=np.where(torque > 0, torque, self.loaded.torque),
        )

    def _least(self, given: FloatArray, assumed: FloatArray) -> FloatArray:
        """What joints (n,) may by what is given of all (m,), zero where not; else what is assumed (n,)."""
        G = self.linkage[0]
        share = np.where(given > 0, given, np.inf)[:, None] / np.where(G == 0, np.nan, np.abs(G))
        least = np.nanmin(share, axis=0)
        return np.asarray(np.where(given[self._own] > 0, least, np.minimum(assumed, least)))

    def _rates(self, given: Sequence[Mapping[str, float]], metres: str, degrees: str) -> FloatArray:
        """Limits (n,) that a file has, SI; zero where it has none."""
        along, about = ([float(each.get(key) or 0) for each in given] for key in (metres, degrees))
        return np.where(self._along, along, np.radians(about))


def _link(joint: Element, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else found.get("link", "")


def _group_states(files: RobotFiles, urdf: Element) -> dict[str, float]:
    """Positions of the movable joints of a URDF, rad or m, that its SRDF names."""
    if files.srdf is None:
        return {}
    semantics = parse_urdf(files.srdf, "an SRDF", files.package_dirs)
    movable = {each.get("name", "") for each in urdf.findall("joint") if each.get("type") in _MOVABLE_TYPES}
    entries = {each.get("name", ""): each.get("value", "") for each in semantics.findall("group_state/joint")}
    return {name: float(entries[name]) for name in movable & entries.keys()}
