"""Where the bent arm holds its tool, by another route than `cmbot.elastic`: hinges and their loads in turn.

A spring is a hinge, a tube a row of them (its curvature times a piece of its length), the base one that also
gives way along the axes. Each turns by its compliance times the moment of all weights beyond it and of the
force on the tool, where these are in the bent arm. A link with a tube is a uniform rod of its mass.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.elastic.base import ElasticBase
from cmbot.robot import Robot

# Hinges of a tube and point masses of its link; rounds, after each of which about a hundredth is left.
_PIECES, _FIXED_POINT_ROUNDS = 24, 6
_IDENTITY = np.eye(3)


class _Element:
    """A hinge with compliances (3,) about axes (3, 3), or a point mass, at a place in a joint's frame."""

    def __init__(
        self, place: FloatArray, mass: float = 0.0, soft: Any = 0.0, axes: FloatArray = _IDENTITY
    ) -> None:
        self.place, self.mass, self.soft, self.axes = place, mass, np.broadcast_to(soft, 3), axes


def bent_tool_points(robot: Robot, base: ElasticBase | None, q: FloatArray) -> FloatArray:
    """Return where the bent arm holds the tool point at rest (N, 3), m, in postures `q` (N, n), rad.

    A fixed tool's point it has in the frame of the part.
    """
    model, data, N = robot.model, robot.model.createData(), len(q)
    steps = np.empty((model.njoints, N, 4, 4))
    for k, q_k in enumerate(robot.coupling.positions(q)):
        pin.forwardKinematics(model, data, q_k)
        steps[:, k] = [X.homogeneous for X in data.liMi]
    arm = [_elements(robot, joint) for joint in range(1, model.njoints)]
    tool, gravity = model.frames[robot.tool_frame_id].placement, np.array(model.gravity.linear)
    foot, carrier = np.array(robot.foot_point), model.inertias[0]
    softness = np.zeros((6, 6)) if base is None else np.linalg.inv(base.stiffness)
    shift = np.zeros((N, 6))
    turns = [[np.zeros((N, 3)) for _ in elements] for elements in arm]
    point = np.empty((N, 3))
    for _ in range(_FIXED_POINT_ROUNDS):
        # What is fixed to the base is turned about the foot.
        R = Rotation.from_rotvec(shift[:, 3:]).as_matrix()
        p = foot + shift[:, :3] - R @ foot
        placed = [(carrier.mass, p + R @ carrier.lever, R)]
        for step, elements, turned in zip(steps[1:], arm, turns, strict=True):
            R, p = R @ step[:, :3, :3], p + (R @ step[:, :3, 3:])[:, :, 0]
            for element, angle in zip(elements, turned, strict=True):
                there = p + R @ element.place
                placed.append((element.mass, there, R @ element.axes))
                if element.soft.any():
                    R = R @ Rotation.from_rotvec(angle @ element.axes.T).as_matrix()
                    p = there - R @ element.place
        point = p + R @ tool.translation
        push = R @ (tool.rotation @ np.array(robot.tool_force))
        # From the tool on: the mass beyond, and its first moment.
        mass, first = 0.0, np.zeros((N, 3))
        inner = iter(placed[:0:-1])
        for elements, turned in zip(arm[::-1], turns[::-1], strict=True):
            for k in reversed(range(len(elements))):
                own, there, axes = next(inner)
                mass, first = mass + own, first + own * there
                moment = np.cross(first - mass * there, gravity) + np.cross(point - there, push)
                turned[k] = np.einsum("nji,nj->ni", axes, moment) * elements[k].soft
        mass, first = mass + placed[0][0], first + placed[0][0] * placed[0][1]
        at = foot + shift[:, :3]
        moment = np.cross(first - mass * at, gravity) + np.cross(point - at, push)
        shift = np.hstack([mass * gravity + push, moment]) @ softness
    return seen_from_part(robot, point, R @ tool.rotation)[0]


def seen_from_part(robot: Robot, p: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a fixed tool's points (N, 3), m, and orientations (N, 3, 3) seen from parts so placed in W.

    Where no tool is fixed, `p` (N, 3) and `R` (N, 3, 3) are those of the tool itself.
    """
    if robot.fixed_tool is None:
        return p, R
    X_EW = np.linalg.inv(np.block([[R, p[:, :, None]], [np.zeros((len(p), 1, 3)), np.ones((len(p), 1, 1))]]))
    X_ET = X_EW @ robot.fixed_tool.homogeneous
    return X_ET[:, :3, 3], X_ET[:, :3, :3]


def _elements(robot: Robot, joint: int) -> list[_Element]:
    """What follows on a joint of the robot, in its frame: its springs, and its link's tube and masses."""
    model, inertia = robot.model, robot.model.inertias[joint]
    found, name = list[_Element](), model.names[joint]
    if (spring := robot.joint_elasticity.get(name)) is not None:
        tilting = 0.0 if spring.tilting is None else 1 / spring.tilting
        axes = _along(_axis(model, joint))
        found.append(
            _Element(np.zeros(3), soft=np.array([1 / spring.stiffness, tilting, tilting]), axes=axes)
        )
    frame = model.frames[robot.tool_frame_id]
    payload = robot.payload if frame.parentJoint == joint else 0.0
    links = {model.frames[model.getFrameId(link)].parentJoint: link for link in robot.elasticity}
    if joint not in links:
        return [*found, _Element(np.array(inertia.lever), inertia.mass)]
    tube = robot.elasticity[links[joint]]
    X = model.frames[model.getFrameId(links[joint])].placement
    start, end = X.act(np.array(tube.start)), X.act(np.array(tube.end))
    axes, length = _along(end - start), float(np.linalg.norm(end - start))
    EI = tube.young * np.pi / 64 * (tube.outer_diameter**4 - (tube.outer_diameter - 2 * tube.wall) ** 4)
    soft = length / _PIECES / np.array([2 * EI * tube.shear / tube.young, EI, EI])
    shares = (np.arange(_PIECES) + 0.5) / _PIECES
    along = [(share, _Element(start + share * (end - start), soft=soft, axes=axes)) for share in shares]
    body = (
        inertia - pin.Inertia(payload, frame.placement.translation, np.zeros((3, 3))) if payload else inertia
    )
    if body.mass > 0:
        # Of a uniform rod with the body's mass, its centre and the second moment along the tube.
        scatter = np.trace(body.inertia) / 2 * np.eye(3) - body.inertia
        u = (end - start) / length
        second = float(u @ scatter @ u)
        lean = scatter @ u / second if second > 0 else np.zeros(3)
        half = np.sqrt(3 * max(second, 0.0) / body.mass)
        for s in half * (2 * shares - 1):
            place = body.lever + s * lean
            along.append((float(u @ (place - start)) / length, _Element(place, body.mass / _PIECES)))
    found += [element for _, element in sorted(along, key=lambda pair: pair[0])]
    return [*found, _Element(np.array(frame.placement.translation), payload)] if payload else found


def _along(direction: FloatArray) -> FloatArray:
    """Axes (3, 3) as columns, the first one in a direction; the others may be any."""
    return np.linalg.qr(np.column_stack([direction, np.eye(3)]))[0]


def _axis(model: Any, joint: int) -> FloatArray:
    """The axis (3,) about which a joint turns, in its frame."""
    data = model.createData()
    q = np.zeros(model.nq)
    q[joint - 1] = 0.5
    pin.forwardKinematics(model, data, q)
    return np.asarray(pin.log3(model.jointPlacements[joint].rotation.T @ data.liMi[joint].rotation))
