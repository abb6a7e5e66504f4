"""The arm on its guardrail as a mechanism of driven joints and springs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.elastic.base import ElasticBase
from cmbot.elastic.pieces import cut_inertia
from cmbot.robot import LinkTube, Robot

__all__ = ["ElasticArm", "ElasticOptions", "elastic_arm"]

_MOST = 50


@dataclass(frozen=True, kw_only=True)
class ElasticOptions:
    """How finely the links are cut, and how stiff everything is.

    Attributes
    ----------
    segments : int
        Segments of each link's tube. One is exact for the static deflection; more add the links' own
        vibration.
    guardrail_factor, link_factor : float
        On the stiffness of the guardrail and of the links.

    Raises
    ------
    InputError
        When a value is not positive.
    """

    segments: int = 1
    guardrail_factor: float = 1.0
    link_factor: float = 1.0

    def __post_init__(self) -> None:
        segments = self.segments
        if isinstance(segments, bool) or not isinstance(segments, int) or not 1 <= segments <= _MOST:
            raise InputError("ElasticOptions", "segments", segments, f"a whole number from 1 to {_MOST}")
        for key in ("guardrail_factor", "link_factor"):
            value = getattr(self, key)
            if not (math.isfinite(value) and value > 0):
                raise InputError("ElasticOptions", key, value, "a positive number")


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticArm:
    """The arm as driven joints and springs. The model in it is not to be changed; the arrays are read-only.

    All joints have one coordinate each, m or rad, so a configuration is a vector.

    Attributes
    ----------
    robot : Robot
    base : ElasticBase or None
        None: the hold is rigid.
    options : ElasticOptions
    model : pinocchio.Model
        Driven and elastic joints, n + f coordinates.
    driven : (n,)
        Indices of the actuated joints' coordinates, in the order of `robot.joints`.
    elastic : (f,)
        Indices of the elastic coordinates: of the base, if it is elastic, the three displacements along and
        the three small turns about the axes of W; then of every segment from base to tool two deflections
        across the tube, the twist, and the slopes about the same two axes.
    stiffness : (f, f), N/m, N/rad, Nm/rad
        Of the elastic coordinates.
    added_mass : (f, f), kg, kg m, kg m2
        What of the guardrail moves with the foot, on the first six; `model` does not know of it.
    tool_frame_id : int
        Index of the tool frame in `model`.
    """

    robot: Robot
    base: ElasticBase | None
    options: ElasticOptions
    model: Any
    driven: IntArray
    elastic: IntArray
    stiffness: FloatArray
    added_mass: FloatArray
    tool_frame_id: int

    def configuration(self, q: FloatArray, u: FloatArray) -> FloatArray:
        """Join joint angles (..., n) and elastic coordinates (..., f) to configurations (..., n + f)."""
        joined = np.empty((*q.shape[:-1], self.model.nq))
        joined[..., self.driven], joined[..., self.elastic] = q, u
        return joined


def elastic_arm(robot: Robot, base: ElasticBase | None, options: ElasticOptions | None = None) -> ElasticArm:
    """Build the mechanism of a robot's joints, its links' tubes and what its foot holds.

    Every segment of a tube has a joint of five coordinates at its middle: with 12 EI/L^3 against the two
    deflections, GJ/L against the twist and EI/L against the two slopes it is the Euler-Bernoulli beam to the
    letter for loads at its ends. Tubes do not stretch.

    Parameters
    ----------
    robot : Robot
        Its `elasticity` says which links bend.
    base : ElasticBase or None
        What the foot holds; None: a rigid hold.
    options : ElasticOptions, optional
    """
    options = options or ElasticOptions()
    builder = _Builder(robot, options)
    if base is not None:
        builder.add_base(base)
    tubes = {_joint_of(robot, tube): tube for tube in robot.elasticity}
    for joint in range(1, robot.model.njoints):
        builder.add_driven(joint)
        if joint in tubes:
            builder.add_tube(joint, tubes[joint])
        else:
            builder.add_inertia(robot.model.inertias[joint])
    return builder.finished(base)


def _joint_of(robot: Robot, tube: LinkTube) -> int:
    return int(robot.model.frames[robot.model.getFrameId(tube.link)].parentJoint)


class _Builder:
    """Adds joints to the end of the chain."""

    def __init__(self, robot: Robot, options: ElasticOptions) -> None:
        self.robot, self.options = robot, options
        self.model = pin.Model()
        self.model.name = robot.model.name
        self.model.gravity = robot.model.gravity
        self.last = 0
        # From the last joint's frame to that of the rigid body which it stands for: W, or a link's joint.
        self.X_LB = pin.SE3.Identity()
        self.driven: list[int] = []
        self.elastic: list[int] = []
        self.blocks: list[FloatArray] = []

    def add_base(self, base: ElasticBase) -> None:
        """Let W's origin move; the climbing mechanism moves with it."""
        kinds = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
        turns = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
        names = ("displacement x", "displacement y", "displacement z", "turn x", "turn y", "turn z")
        for kind, name in zip((*kinds, *turns), names, strict=True):
            self._add_elastic(kind(), pin.SE3.Identity(), f"guardrail {name}")
        self.blocks.append(self.options.guardrail_factor * base.stiffness)
        self.add_inertia(self.robot.model.inertias[0])

    def add_driven(self, joint: int) -> None:
        """Add a joint of the robot."""
        model = self.robot.model
        placement = self.X_LB * model.jointPlacements[joint]
        self.driven.append(self._add(model.joints[joint], placement, model.names[joint]))
        self.X_LB = pin.SE3.Identity()

    def add_inertia(self, inertia: Any) -> None:
        """Let the last joint carry an inertia given in the frame of the rigid body it stands for."""
        self.model.appendBodyToJoint(self.last, inertia, self.X_LB)

    def add_tube(self, joint: int, tube: LinkTube) -> None:
        """Let the link that the last joint carries bend."""
        n, model = self.options.segments, self.robot.model
        X_JL = model.frames[model.getFrameId(tube.link)].placement
        start, end = X_JL.act(np.array(tube.start)), X_JL.act(np.array(tube.end))
        cuts = (np.arange(n) + 0.5) / n
        pieces = self._pieces(joint, start, end, cuts)
        L, EI = tube.length / n, tube.young * tube.second_moment
        GJ = 2 * tube.shear * tube.second_moment
        # The order is that of the joints below.
        stiffness = np.diag([12 * EI / L**3, 12 * EI / L**3, GJ / L, EI / L, EI / L])
        kinds = (pin.JointModelPY, pin.JointModelPZ, pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
        names = ("deflection y", "deflection z", "twist", "slope y", "slope z")
        R_JT = _axes_along(end - start)
        self.add_inertia(pieces[0])
        for number, (share, piece) in enumerate(zip(cuts, pieces[1:], strict=True), start=1):
            X_JT = pin.SE3(R_JT, start + share * (end - start))
            for kind, name in zip(kinds, names, strict=True):
                self._add_elastic(kind(), self.X_LB * X_JT, f"{tube.link} segment {number} {name}")
                self.X_LB = X_JT.inverse()
            self.blocks.append(self.options.link_factor * stiffness)
            self.add_inertia(piece)

    def _pieces(self, joint: int, start: FloatArray, end: FloatArray, cuts: FloatArray) -> list[Any]:
        robot = self.robot
        body, frame = robot.model.inertias[joint], robot.model.frames[robot.tool_frame_id]
        if frame.parentJoint != joint or robot.payload == 0:
            return cut_inertia(body, start, end, cuts)
        # The payload is at the tool, not spread along the link.
        payload = pin.Inertia(robot.payload, frame.placement.translation, np.zeros((3, 3)))
        pieces = cut_inertia(body - payload, start, end, cuts)
        pieces[-1] += payload
        return pieces

    def finished(self, base: ElasticBase | None) -> ElasticArm:
        robot, f = self.robot, len(self.elastic)
        frame = robot.model.frames[robot.tool_frame_id]
        tool = pin.Frame(frame.name, self.last, 0, self.X_LB * frame.placement, pin.FrameType.OP_FRAME)
        tool_frame_id = self.model.addFrame(tool)
        stiffness, added_mass = np.zeros((f, f)), np.zeros((f, f))
        at = 0
        for block in self.blocks:
            stiffness[at : at + len(block), at : at + len(block)] = block
            at += len(block)
        if base is not None:
            added_mass[:6, :6] = base.mass
        driven, elastic = np.array(self.driven, dtype=np.intp), np.array(self.elastic, dtype=np.intp)
        for array in (driven, elastic, stiffness, added_mass):
            array.setflags(write=False)
        return ElasticArm(
            robot=robot,
            base=base,
            options=self.options,
            model=self.model,
            driven=driven,
            elastic=elastic,
            stiffness=stiffness,
            added_mass=added_mass,
            tool_frame_id=int(tool_frame_id),
        )

    def _add_elastic(self, joint: Any, placement: Any, name: str) -> None:
        self.elastic.append(self._add(joint, placement, name))

    def _add(self, joint: Any, placement: Any, name: str) -> int:
        self.last = self.model.addJoint(self.last, joint, placement, name)
        return int(self.model.joints[self.last].idx_v)


def _axes_along(direction: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) whose first column has that direction; a tube does not care for the others."""
    x = direction / np.linalg.norm(direction)
    y = np.cross(np.eye(3)[np.argmin(np.abs(x))], x)
    y /= np.linalg.norm(y)
    return np.column_stack((x, y, np.cross(x, y)))
